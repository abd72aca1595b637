//! A site and the drives through it.

use crate::drive::Drive;
use crate::map::Map;
use crate::plane::Point;
use crate::random::{Purpose, Random};
use crate::site::Site;
use crate::{Options, SimulateError};

/// A site, and for each log one drive through it, each on a different day.
#[derive(Debug, Clone)]
pub struct Campus {
    options: Options,
    seed: u64,
    buildings: Vec<(Point, Point)>,
    drives: Vec<Drive>,
}

impl Campus {
    /// Checks the options, then builds the site and every drive.
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

    /// Checks the options, then builds every drive on a map. Ignores [`Options::buildings`].
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

    /// The options of the simulation.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The seed of the simulation.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The south-west and north-east corners of every building.
    pub fn buildings(&self) -> &[(Point, Point)] {
        &self.buildings
    }

    /// The drive of a log; `log` is an index into [`Options::logs`].
    ///
    /// # Panics
    /// If `log` is out of range.
    pub fn drive(&self, log: usize) -> &Drive {
        &self.drives[log]
    }
}
