//! The feature set `campus` v1. It describes a place, and changes little when the sensor moves by a
//! metre or two, when people walk past, when the scanner spins faster, or when it faces another
//! direction. docs/features.md contains the formula, unit, source and reason of each feature.
//!
//! All features are computed from the range signature, the mean logarithm of the range in each
//! degree of azimuth. The number of returns therefore has little effect. Histograms are soft: a
//! value is split between the two bin centres next to it.

mod describe;
mod signature;
mod walls;

use dataset::{Scan, Unusable};

use describe::Out;
use signature::Signature;
use walls::Walls;

/// Number of features.
const N: usize = 109;

/// Names, in order; the columns of `features/<log>.parquet`.
pub const CAMPUS_NAMES: [&str; N] = [
    // Share of the angle by range, with 13 bin centres, a factor of sqrt 2 apart.
    "range_0_7m",
    "range_1m",
    "range_1_4m",
    "range_2m",
    "range_2_8m",
    "range_4m",
    "range_5_7m",
    "range_8m",
    "range_11m",
    "range_16m",
    "range_23m",
    "range_32m",
    "range_45m",
    // Percentiles of ln of the chord r(a) + r(a + 180 deg).
    "chord_p0",
    "chord_p5",
    "chord_p10",
    "chord_p25",
    "chord_p40",
    "chord_p50",
    "chord_p60",
    "chord_p75",
    "chord_p90",
    "chord_p95",
    "chord_p100",
    // How much opposite ranges differ.
    "oddness_mean",
    "oddness_spread",
    // Percentiles of ln of r(a) + r(a + 90 deg).
    "quarter_p0",
    "quarter_p10",
    "quarter_p25",
    "quarter_p50",
    "quarter_p75",
    "quarter_p90",
    "quarter_p100",
    // ln of the standard deviation of ranges capped at a limit.
    "spread_2m",
    "spread_4m",
    "spread_8m",
    "spread_16m",
    // Share of the 5 deg sectors with a return.
    "seen",
    // Share of the degrees by the change of ln r to the next degree.
    "step_0_01",
    "step_0_03",
    "step_0_1",
    "step_0_3",
    "step_1",
    "step_3",
    // ln of (1 + number of gaps in the wall), by width.
    "gaps_0_6m",
    "gaps_1m",
    "gaps_1_6m",
    "gaps_2_5m",
    "gaps_4m",
    "gaps_7m",
    "gaps_15m",
    // ln of (1 + metres of wall), by the length of the run between two gaps.
    "runs_0_2m",
    "runs_0_5m",
    "runs_1m",
    "runs_2m",
    "runs_4m",
    "runs_8m",
    "runs_16m",
    "runs_32m",
    // Square root of the share of pairs of wall pieces that face each other: by distance, and all.
    "facing_0_5m",
    "facing_1m",
    "facing_1_4m",
    "facing_1_7m",
    "facing_2m",
    "facing_2_3m",
    "facing_2_6m",
    "facing_3m",
    "facing_3_5m",
    "facing_4_2m",
    "facing_5m",
    "facing_6_5m",
    "facing_8_5m",
    "facing_11m",
    "facing_15m",
    "facing_20m",
    "facing_30m",
    "facing",
    // Pairs of pieces that face the same way: shares by offset.
    "offset_0m",
    "offset_0_1m",
    "offset_0_25m",
    "offset_0_5m",
    "offset_0_8m",
    "offset_1_2m",
    "offset_1_8m",
    "offset_2_5m",
    "offset_4m",
    "offset_7m",
    "offset_12m",
    // Pairs of pieces that face each other directly: shares by distance.
    "across_1m",
    "across_1_4m",
    "across_1_7m",
    "across_2m",
    "across_2_3m",
    "across_2_7m",
    "across_3_2m",
    "across_4m",
    "across_5m",
    "across_7m",
    "across_10m",
    "across_15m",
    // Square root of the share of pairs at right angles.
    "perpendicular",
    // ln of chords along the main direction of the walls, across it, and on its diagonals.
    "main_longest",
    "main_median",
    "cross_longest",
    "cross_median",
    "diagonal_shorter",
    "diagonal_longer",
    "axis_shorter",
    "axis_longer",
];

/// Computes the features of one scan after another. It reuses its memory.
#[derive(Debug, Clone, Default)]
pub struct Campus {
    signature: Signature,
    walls: Walls,
    scratch: Vec<f64>,
}

impl Campus {
    /// Creates an instance that can be used for any number of scans.
    pub fn new() -> Self {
        Self::default()
    }

    /// The features of a scan, in the order of [`CAMPUS_NAMES`]. They are always finite.
    pub fn features(&mut self, scan: &Scan) -> Result<[f64; N], Unusable> {
        scan.check_usable()?;
        self.signature.measure(scan);
        self.walls.measure(&self.signature);
        let mut features = [0.0; N];
        let mut out = Out::new(&mut features);
        self.signature.describe(&mut out, &mut self.scratch);
        self.walls.describe(&self.signature, &mut out);
        self.walls.describe_chords(&self.signature, &mut out);
        debug_assert!(out.is_full());
        Ok(features)
    }
}
