//! The types that pass between the stages: [`Scan`], [`Pose2`], [`Keyframe`], [`Pair`].
//!
//! With the default feature `parquet`, [`tables`] reads and writes them. Without it this crate is
//! small enough for a robot: no Arrow, no Parquet.
//!
//! Units: metres, radians and nanoseconds since the epoch, unless a name says otherwise.

mod codes;
mod keyframe;
mod losses;
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

pub use codes::{Severity, Subject};
pub use keyframe::{Keyframe, ScanId};
pub use losses::{Loss, LossKind, Losses};
pub use notes::{Note, NoteKind};
pub use out_of_range::OutOfRange;
pub use pair::{Label, Pair};
pub use pose::{NoPose, Pose2, StampedPose, Trajectory, wrap_angle};
pub use quantile::{quantile, value_at_rank};
pub use random::SplitMix64;
pub use scan::{FULL_RING_DEG, RangeLimits, Scan, Unusable};
pub use scores::{
    BoostingRound, FeatureUsefulness, GridCell, HeldOut, Retrieval, RetrievalPoint, Scores,
};
