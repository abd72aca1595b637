//! A building and the drives through it.

use crate::drive::Drive;
use crate::plan::Plan;
use crate::random::{Purpose, Random};
use crate::{Options, SimulateError};

/// A building, and a drive through it for each log, each on a day of its own.
#[derive(Debug, Clone)]
pub struct Campus {
    options: Options,
    seed: u64,
    drives: Vec<Drive>,
}

impl Campus {
    /// Checks the options, then builds the floor plan and every drive.
    pub fn new(options: &Options, seed: u64) -> Result<Self, SimulateError> {
        options.check()?;
        let plan = Plan::new(&mut Random::new(seed, Purpose::Plan, 0, 0));
        let drives =
            (0..options.logs.len()).map(|log| Drive::new(&plan, options, seed, log)).collect();
        Ok(Self { options: options.clone(), seed, drives })
    }

    /// The options it was built from.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The seed it was built from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The drive of log number `log`, an index into [`Options::logs`].
    ///
    /// # Panics
    /// If there is no such log.
    pub fn drive(&self, log: usize) -> &Drive {
        &self.drives[log]
    }
}
