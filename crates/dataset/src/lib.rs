//! The data types that the stages exchange: [`Scan`], [`Pose2`], [`Keyframe`], [`Pair`].
//!
//! With the default feature `parquet`, the module `tables` reads and writes these types. Without
//! this feature, the crate does not depend on Arrow and Parquet and is small enough for a robot.
//!
//! Units are metres, radians and nanoseconds since the epoch, unless the suffix of a name gives
//! another unit.
//!
//! # Example
//!
//! Interpolate the pose of the robot at the time of a scan, and check that features can be computed
//! from the scan:
//!
//! ```
//! use dataset::{NoPose, Pose2, Scan, StampedPose, Trajectory};
//!
//! let pose = |x_m| Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 };
//! let poses = vec![StampedPose::new(0, pose(1.0)), StampedPose::new(100, pose(2.0))];
//! let (trajectory, n_duplicates) = Trajectory::new(poses);
//! assert_eq!(n_duplicates, 0);
//!
//! let scan = Scan {
//!     stamp_ns: 50,
//!     x_m: vec![1.0, 0.0, -1.0],
//!     y_m: vec![0.0, 1.0, 0.0],
//!     coverage_deg: 360.0,
//!     hole_deg: 0.0,
//! };
//! assert_eq!(scan.check_usable(), Ok(()));
//!
//! let max_gap_ns = 100;
//! assert_eq!(trajectory.pose_at(scan.stamp_ns, max_gap_ns), Ok(pose(1.5)));
//! assert_eq!(trajectory.pose_at(101, max_gap_ns), Err(NoPose::AfterLast));
//! ```

mod codes;
mod drive_map;
mod ground;
mod keyframe;
mod located;
mod loss_kind;
mod losses;
mod note_kind;
mod notes;
mod out_of_range;
mod pair;
mod pose;
mod quantile;
mod random;
mod scan;
mod scores;
#[cfg(feature = "parquet")]
pub mod tables;
mod tum;
mod words;

pub use codes::{Severity, Subject};
pub use drive_map::{
    CandidateClosure, GraphEdge, JudgedClosure, MapPose, RegisteredScan, ScanClosure,
};
pub use ground::{Squares, common_frames};
pub use keyframe::{Keyframe, ScanId};
pub use located::{LocatedPose, LocatedScan, LocatedState};
pub use loss_kind::LossKind;
pub use losses::{Loss, Losses};
pub use note_kind::NoteKind;
pub use notes::Note;
pub use out_of_range::OutOfRange;
pub use pair::{Label, NEIGHBOUR_GAP_M, Pair};
pub use pose::{NoPose, Pose2, StampedPose, Trajectory, wrap_angle};
pub use quantile::{quantile, value_at_rank};
pub use random::SplitMix64;
pub use scan::{FULL_RING_DEG, RangeLimits, Scan, Unusable};
pub use scores::{
    BoostingRound, FeatureUsefulness, GridCell, HeldOut, Retrieval, RetrievalPoint, Scores,
};
pub use tum::tum;
