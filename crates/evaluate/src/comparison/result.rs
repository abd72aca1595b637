//! All differences of two runs.

use serde::Serialize;

use super::closures::ComparedClosures;
use super::input::{PlaceRule, Tolerances};
use super::labels::{ComparedLabels, ComparedPlaces};
use super::scans::{ComparedLog, ComparedMaps};
use super::trajectories::ComparedTrajectory;

/// Version of the layout of [`Comparison`] as JSON.
pub const COMPARISON_VERSION: u32 = 1;

/// A run that is compared.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedRun {
    /// The run folder, as it was given.
    pub folder: String,
    /// Version of the program that wrote its trajectory.
    pub program_version: String,
    /// Seed of the run.
    pub seed: u64,
}

/// A difference of what two runs were made from or made with. It can explain other differences, but is
/// none itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Origin {
    /// A table of the runs, such as `candidates.parquet`.
    pub table: String,
    /// What differs: the key of an option, a file name, `program_version` or `seed`.
    pub key: String,
    /// Value or digest in A; `null` if A has none.
    pub a: Option<String>,
    /// Value or digest in B; `null` if B has none.
    pub b: Option<String>,
}

/// What changed from a run A to a run B.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Comparison {
    /// Version of this layout. A field that is renamed, removed or gets another meaning makes a new version.
    pub format_version: u32,
    /// The first run.
    pub a: ComparedRun,
    /// The second run.
    pub b: ComparedRun,
    /// Differences of program, seed, options and input files.
    pub origins: Vec<Origin>,
    /// The largest differences that do not count as a change.
    pub tolerances: Tolerances,
    /// When two keyframes are at the same place.
    pub place_rule: PlaceRule,
    /// Codes of the changes beyond the tolerances, as in docs/messages.md. Empty if nothing changed.
    pub changes: Vec<String>,
    /// The logs of both runs, by name.
    pub logs: Vec<ComparedLog>,
    /// Logs that share a map in one run only.
    pub maps: ComparedMaps,
    /// The accepted closures.
    pub closures: ComparedClosures,
    /// The optimized poses of all scans, by map and log.
    pub trajectories: Vec<ComparedTrajectory>,
    /// The labelled pairs; `null` if one of the runs has no `pairs.parquet`.
    pub labels: Option<ComparedLabels>,
    /// Pairs of keyframes at the same place by the optimized poses.
    pub places: ComparedPlaces,
}

impl Comparison {
    /// Whether anything changed beyond the tolerances.
    pub fn is_changed(&self) -> bool {
        !self.changes.is_empty()
    }
}
