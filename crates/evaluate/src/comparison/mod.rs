//! What changed between two runs of loop detection, such as two days or two versions of the program.
//!
//! [`compare`] matches logs by their names, and scans by their numbers and stamps.
//!
//! ```
//! use std::collections::BTreeMap;
//! use dataset::{MapPose, Pose2, ScanId, StampedPose, Trajectory};
//! use evaluate::comparison::{ComparedRun, MappedRun, PlaceRule, Tolerances, compare};
//!
//! // Two drives 1 m to the right and back. In B, the scan in the middle lies 0.1 m higher.
//! let poses = |y_m| [(0, 0.0, 0.0), (1, 1.0, y_m), (2, 0.0, 0.0)];
//! let keyframes = |y_m| {
//!     poses(y_m).map(|(scan, x_m, y_m)| MapPose {
//!         id: ScanId { log: "monday".into(), scan },
//!         stamp_ns: i64::from(scan),
//!         pose: Pose2 { x_m, y_m, heading_rad: 0.0 },
//!         covariance: None,
//!         is_degenerate: false,
//!         segment: 0,
//!         travel_m: f64::from(scan),
//!         map: 0,
//!     })
//! };
//! let trajectories = |keyframes: &[MapPose]| {
//!     let poses = keyframes.iter().map(|k| StampedPose::new(k.stamp_ns, k.pose)).collect();
//!     BTreeMap::from([("monday".into(), Trajectory::new(poses).0)])
//! };
//! let (a, b) = (keyframes(0.0), keyframes(0.1));
//! let [poses_a, poses_b] = [&a, &b].map(|keyframes| trajectories(keyframes));
//! let run = |keyframes, trajectories| MappedRun { keyframes, closures: &[], trajectories, pairs: None };
//! let name = |folder: &str| ComparedRun {
//!     folder: folder.to_owned(),
//!     program_version: "1.0.0".to_owned(),
//!     seed: 0,
//! };
//! let rule = PlaceRule { positive_radius_m: 1.5, positive_heading_deg: 180.0 };
//! let tolerances = Tolerances { max_turn_deg: 10.0, ..Tolerances::default() };
//! let runs = [(name("a"), run(&a, &poses_a)), (name("b"), run(&b, &poses_b))];
//! let found = compare(runs, Vec::new(), tolerances, rule);
//! // The alignment turns B by atan(0.1) to the right, which removes the difference.
//! assert!(found.trajectories[0].max_m < 0.01 && !found.is_changed());
//! ```

mod changes;
mod closures;
mod input;
mod labels;
mod result;
mod scans;
mod trajectories;

pub use closures::{ChangeOfClosure, ClosureChange, ComparedClosures, Motion, ReasonCount};
pub use input::{LabelledPair, MappedRun, PlaceRule, Tolerances};
pub use labels::{ComparedLabels, ComparedPlaces, FlippedPair};
pub use result::{COMPARISON_VERSION, ComparedRun, Comparison, Origin};
pub use scans::{ComparedLog, ComparedMaps, Presence};
pub use trajectories::{ComparedTrajectory, FarthestScan, Transform};

/// Compares two runs. `origins` are the differences of what they were made from and made with.
pub fn compare(
    [(a, run_a), (b, run_b)]: [(ComparedRun, MappedRun<'_>); 2],
    origins: Vec<Origin>,
    tolerances: Tolerances,
    place_rule: PlaceRule,
) -> Comparison {
    let matched = scans::Matched::new(&run_a, &run_b);
    let mut comparison = Comparison {
        format_version: COMPARISON_VERSION,
        a,
        b,
        origins,
        tolerances,
        place_rule,
        changes: Vec::new(),
        logs: matched.logs(),
        maps: matched.joined(),
        closures: ComparedClosures::new(&run_a, &run_b, &matched, &tolerances),
        trajectories: trajectories::trajectories(&run_a, &run_b),
        labels: ComparedLabels::new(&run_a, &run_b, &matched),
        places: ComparedPlaces::new(&matched, &place_rule),
    };
    let mut codes: Vec<String> =
        comparison.notes().iter().map(|note| note.code().to_owned()).collect();
    codes.dedup();
    comparison.changes = codes;
    comparison
}
