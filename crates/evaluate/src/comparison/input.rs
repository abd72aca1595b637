//! What is compared, and which differences are tolerated.

use std::collections::BTreeMap;
use std::sync::Arc;

use dataset::{JudgedClosure, Label, MapPose, OutOfRange, ScanId, Trajectory};
use serde::Serialize;

/// The results of loop detection in one run.
#[derive(Debug, Clone, Copy)]
pub struct MappedRun<'a> {
    /// The optimized poses of the keyframes.
    pub keyframes: &'a [MapPose],
    /// The accepted and rejected closures.
    pub closures: &'a [JudgedClosure],
    /// The optimized poses of all scans of each log.
    pub trajectories: &'a BTreeMap<Arc<str>, Trajectory>,
    /// The labelled pairs, if the run has any.
    pub pairs: Option<&'a [LabelledPair]>,
}

/// Two scans and their label.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LabelledPair {
    /// Query and reference.
    pub scans: [ScanId; 2],
    /// The label.
    pub label: Label,
}

/// The largest differences that do not count as a change.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Tolerances {
    /// Largest shift of a scan after the alignment of the trajectories, and of the relative pose of a
    /// closure \[m\]. The default is the width of a square of the map that `view` writes.
    pub max_shift_m: f64,
    /// Largest turn of a scan after the alignment, and of the relative pose of a closure \[deg\]. The
    /// default moves a wall 6 m away by the width of a square of the map.
    pub max_turn_deg: f64,
    /// Largest number of closures that only A accepts.
    pub max_lost: usize,
    /// Largest number of closures that only B accepts.
    pub max_gained: usize,
    /// Largest number of pairs with other labels, by the tables of pairs and by the optimized poses.
    pub max_flips: usize,
    /// Whether B may have logs that A does not have.
    pub allow_new_logs: bool,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            max_shift_m: 0.05,
            max_turn_deg: 0.5,
            max_lost: 0,
            max_gained: 0,
            max_flips: 0,
            allow_new_logs: false,
        }
    }
}

impl Tolerances {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        for (key, value) in
            [("--max-shift-m", self.max_shift_m), ("--max-turn-deg", self.max_turn_deg)]
        {
            check_not_negative(key, value)?;
        }
        Ok(())
    }
}

/// When two keyframes show the same place, by their optimized poses: the rule of the section `[label]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlaceRule {
    /// Largest distance between the two keyframes \[m\].
    pub positive_radius_m: f64,
    /// Largest difference between their headings \[deg\]; 180 is no limit.
    pub positive_heading_deg: f64,
}

impl PlaceRule {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        check_not_negative("--positive-heading-deg", self.positive_heading_deg)?;
        let radius_m = self.positive_radius_m;
        match radius_m.is_finite() && 0.0 < radius_m {
            true => Ok(()),
            false => Err(OutOfRange::new("--positive-radius-m", radius_m, "more than 0")),
        }
    }
}

fn check_not_negative(key: &str, value: f64) -> Result<(), OutOfRange> {
    match value.is_finite() && 0.0 <= value {
        true => Ok(()),
        false => Err(OutOfRange::new(key, value, "0 or more")),
    }
}
