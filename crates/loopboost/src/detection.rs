//! The sections `[register]`, `[detect]` and `[optimize]` of the pipeline file.

use anyhow::Result;
use dataset::OutOfRange;
use ingest::Origin;
use register::{MatcherOptions, RegisterOptions};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reference_options::ReferenceOptions;

/// `[detect]`: which places are compared. With this section, `run` also finds loop closures: it runs the
/// stages `register`, `detect` and `optimize`.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct DetectSection {
    /// Least path between the two scans of a closure \[m\].
    pub(crate) min_path_m: f64,
    /// Path from one place to the next \[m\]. Places are compared, and each is a keyframe with the scans
    /// around it.
    pub(crate) place_step_m: f64,
    /// The scans up to this much path before and after a keyframe belong to its place \[m\].
    pub(crate) place_half_m: f64,
    /// Whether `loopboost detect --model` uses the classifier of the model, besides its detector. The
    /// classifier sorts the candidates, and its confidence is a part of the evidence.
    pub(crate) classifier: bool,
    /// The folders of finished runs, relative to the pipeline file: a run with a map, and runs whose logs were
    /// added to it. The logs of the pipeline, all of one site, are added to that map. Its poses stay, and
    /// its drives are not computed again.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) maps: Vec<String>,
}

impl Default for DetectSection {
    fn default() -> Self {
        Self {
            min_path_m: 30.0,
            place_step_m: 2.5,
            place_half_m: 5.0,
            classifier: true,
            maps: Vec::new(),
        }
    }
}

impl DetectSection {
    /// Checks that every value is in range.
    fn check(&self) -> Result<(), OutOfRange> {
        for (key, found) in [
            ("min_path_m", self.min_path_m),
            ("place_step_m", self.place_step_m),
            ("place_half_m", self.place_half_m),
        ] {
            if !(found.is_finite() && 0.0 < found) {
                return Err(OutOfRange::new(format!("detect.{key}"), found, "more than 0"));
            }
        }
        // Two places that share scans always match.
        if self.min_path_m < 2.0 * self.place_half_m {
            return Err(OutOfRange::new(
                "detect.min_path_m".to_owned(),
                self.min_path_m,
                "twice `detect.place_half_m` or more",
            ));
        }
        Ok(())
    }
}

/// `[optimize]`: the estimate of the trajectory.
#[derive(Debug, Clone, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct OptimizeSection {
    /// Whether to align every scan with the finished map. Without this, the poses of the scans between
    /// two registered scans are interpolated with the odometry.
    pub(crate) every_scan: bool,
    /// Origin of the frame of the references: x points east and y north. Without it, the first satellite fix of
    /// the first log of a site is the origin, or that of the map in `detect.maps`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) origin: Option<Origin>,
    /// Absolute positions and poses, which put the maps into their frame.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) references: Vec<ReferenceOptions>,
}

impl Default for OptimizeSection {
    fn default() -> Self {
        Self { every_scan: true, origin: None, references: Vec::new() }
    }
}

impl OptimizeSection {
    fn check(&self) -> Result<()> {
        if let Some(origin) = &self.origin {
            origin.check("optimize")?;
        }
        self.references.iter().try_for_each(ReferenceOptions::check)
    }
}

/// Checks `[register]`, `[detect]` and `[optimize]`.
pub(crate) fn check(
    register: &RegisterOptions,
    detect: &DetectSection,
    optimize: &OptimizeSection,
) -> Result<()> {
    check_register(register)?;
    detect.check()?;
    optimize.check()
}

fn check_register(options: &RegisterOptions) -> Result<(), OutOfRange> {
    let MatcherOptions { align, .. } = options.matcher;
    for (key, found) in [
        ("matcher.target_path_m", options.matcher.target_path_m),
        ("matcher.target_voxel_m", options.matcher.target_voxel_m),
        ("matcher.target_half_width_m", options.matcher.target_half_width_m),
        ("matcher.search_m", options.matcher.search_m),
        ("matcher.search_deg", options.matcher.search_deg),
        ("matcher.align.first_gate_m", align.first_gate_m),
        ("matcher.align.last_gate_m", align.last_gate_m),
        ("matcher.align.huber_m", align.huber_m),
        ("matcher.align.noise_m", align.noise_m),
        ("matcher.align.points_per_measurement", align.points_per_measurement),
        ("spacing_m", options.spacing_m),
        ("turn_deg", options.turn_deg),
        ("full_circle_spacing_m", options.full_circle_spacing_m),
        ("full_circle_turn_deg", options.full_circle_turn_deg),
        ("max_range_m", options.max_range_m),
    ] {
        if !(found.is_finite() && 0.0 < found) {
            return Err(OutOfRange::new(format!("register.{key}"), found, "more than 0"));
        }
    }
    Ok(())
}
