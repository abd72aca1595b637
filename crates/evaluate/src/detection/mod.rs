//! Measures of loop closures and trajectories, with and without ground truth.
//!
//! [`measure`] takes what the stages `register`, `detect` and `optimize` found in a [`Drive`] and
//! compares it with the ground truth. All poses are those of the robot. The errors of trajectories are
//! those of evo (<https://github.com/MichaelGrupp/evo>): [`align`] and [`relative_errors`] give the same
//! numbers as `evo_ape` and `evo_rpe`.
//!
//! ```
//! use dataset::Pose2;
//! use evaluate::detection::align;
//!
//! // The estimate is the truth, moved by 5 m and turned by 90 deg: alignment removes both.
//! let truth = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)].map(|(x_m, y_m)| Pose2 { x_m, y_m, ..Pose2::default() });
//! let estimate = truth.map(|p| Pose2 { x_m: 5.0 - p.y_m, y_m: p.x_m, ..p });
//! assert!(align(&truth, &estimate).unwrap().rmse_m < 1e-12);
//! ```

mod calibration;
mod closures;
mod input;
mod measure;
mod revisits;
mod sites;
mod tables;
mod trajectory;
mod truth;

pub use calibration::{Calibration, chi_square_quantile, normalized_error};
pub use closures::{
    CandidateErrors, ClosureErrors, FALSE_DEG, FALSE_M, Judged, PLACE_M, RIGHT_DEG, RIGHT_M,
    Verdict,
};
pub use input::{Drive, Evidence, FoundCandidate, FoundClosure, KeyframePoses, ScanPoses};
pub use measure::{
    AgainstTruth, DriveMeasures, PoseSource, Rejected, TrajectoryErrors, differences, measure,
};
pub use revisits::{
    NEAR_PATH_M, REVISIT_M, REVISIT_PATH_M, Revisit, RevisitCounts, Revisits, revisits,
};
pub use sites::{
    ClosureBetween, DriveKeyframe, MapMeasures, SiteDrives, SiteErrors, SiteMeasures, measure_site,
};
pub use tables::write_detection;
pub use trajectory::{Alignment, DRIFT_PATHS_M, Drift, align, relative_errors};
pub use truth::{DOUBTFUL_DEG, DOUBTFUL_M, MAX_CARRY_NS, MAX_INTERPOLATION_NS, TruePose, Truth};
