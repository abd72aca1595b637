//! A place and the drives through it.

use crate::drive::Drive;
use crate::map::Map;
use crate::plane::Point;
use crate::random::{Purpose, Random};
use crate::site::Site;
use crate::{Options, SimulateError};

/// A place, and a drive through it for each log, each on a day of its own.
#[derive(Debug, Clone)]
pub struct Campus {
    options: Options,
    seed: u64,
    buildings: Vec<(Point, Point)>,
    drives: Vec<Drive>,
}

impl Campus {
    /// Checks the options, then builds the place and every drive.
    pub fn new(options: &Options, seed: u64) -> Result<Self, SimulateError> {
        options.check()?;
        if options.map.is_some() {
            return Err(SimulateError::MapNotLoaded);
        }
        let mut random = Random::new(seed, Purpose::Plan, 0, 0);
        let site = match options.buildings {
            1 => Site::building(&mut random),
            n => Site::campus(n, &mut random),
        };
        Ok(Self::on_site(&site, options, seed))
    }

    /// Checks the options, then builds every drive on a map; `buildings` plays no part.
    pub fn on_map(options: &Options, seed: u64, map: Map) -> Result<Self, SimulateError> {
        options.check()?;
        let mut random = Random::new(seed, Purpose::Plan, 0, 0);
        Ok(Self::on_site(&Site::on_map(map, &mut random), options, seed))
    }

    fn on_site(site: &Site, options: &Options, seed: u64) -> Self {
        let drives =
            (0..options.logs.len()).map(|log| Drive::new(site, options, seed, log)).collect();
        Self { options: options.clone(), seed, buildings: site.outlines(), drives }
    }

    /// The options it was built from.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The seed it was built from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The south-western and north-eastern corners of every building.
    pub fn buildings(&self) -> &[(Point, Point)] {
        &self.buildings
    }

    /// The drive of log number `log`, an index into [`Options::logs`].
    ///
    /// # Panics
    /// If there is no such log.
    pub fn drive(&self, log: usize) -> &Drive {
        &self.drives[log]
    }
}
