//! `optimize`: the poses of a drive and its loop closures, estimated together.
//!
//! ```text
//! Drive, proposals ──reject_false_closures──► poses ──compare what they predict──► supported?
//!                          ▲                                                        │ no: drop a group
//!                          └────────────────────────────────────────────────────────┘
//!                                       yes ──joint alignment──► poses ──compare keyframes──► closures
//!                                                                  └──align_every_scan──► a pose per scan
//! ```
//!
//! [`place_by_references`] moves a finished map into the frame of satellite fixes and surveyed poses.
//!
//! [`close_loops`] does all of this but the last step. It decides with the odometry, with all closures
//! together and with the scans at every place that the result predicts to be the same: no closure is
//! accepted for its own score alone.

mod agreement;
mod certainty;
mod every_scan;
mod gnc;
mod graph;
mod guided;
mod places;
mod reference;
mod reference_fit;
mod references;
mod site;
mod solve;
mod support;
mod trusted;

use dataset::Pose2;
use model::Evidence;
use nalgebra::Matrix3;

pub use every_scan::align_every_scan;
pub use gnc::{MAX_CHI2, Robust, reject_false_closures};
pub use graph::{Edge, covariances, optimize};
pub use reference::{Reference, n_correlated};
pub use reference_fit::{Cause, Contradiction};
pub use references::{Placed, Placement, ReferencedMap, Residual, place_by_references};
pub use site::{Join, JoinOutcome, Known, Site, join_drives};
pub use solve::close_loops;

/// A possible closure between two scans of a drive, as `detect` finds it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal {
    /// Index of the later scan in the drive.
    pub query: usize,
    /// Index of the earlier scan in the drive.
    pub reference: usize,
    /// Pose of the lidar at the query in the frame of the lidar at the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose.
    pub covariance: Matrix3<f64>,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
}

/// Why a closure was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reason {
    /// Its confidence is too low.
    LowConfidence,
    /// It contradicts the odometry and the closures that were kept. Or there are very many candidates, and too few of
    /// those near it agree with it.
    Inconsistent,
    /// Too few of the pairs of places that it predicts to be the same are confirmed by their scans.
    Unsupported,
    /// Its scans do not confirm the relative pose that the map predicts.
    NotConfirmed,
    /// By the absolute references of its drives, its places are far from each other.
    FarByReferences,
}

impl Reason {
    /// The code in `closures.parquet`.
    pub fn code(self) -> &'static str {
        match self {
            Self::LowConfidence => "low_confidence",
            Self::Inconsistent => "inconsistent",
            Self::Unsupported => "unsupported",
            Self::NotConfirmed => "not_confirmed",
            Self::FarByReferences => "far_by_references",
        }
    }
}

/// A closure, accepted or rejected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closure {
    /// The closure.
    pub proposal: Proposal,
    /// Why it was rejected; `None` if it was accepted.
    pub rejected: Option<Reason>,
}

/// A drive with its closures.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Accepted and rejected closures, ordered by query and reference.
    pub closures: Vec<Closure>,
    /// Optimized pose of the lidar at each scan of the drive.
    pub poses: Vec<Pose2>,
    /// Covariance of x, y and heading of each pose relative to the first one, in the frame of the map.
    pub covariances: Vec<Matrix3<f64>>,
    /// The pose graph of the accepted closures. Its vertices are scans of the drive.
    pub edges: Vec<Edge>,
    /// What happened, for the report.
    pub rounds: Vec<Round>,
}

/// A round of the optimization.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// Closures offered to the pose graph.
    pub n_offered: usize,
    /// Closures that it kept.
    pub n_kept: usize,
    /// Pairs of places that its poses predict to be the same.
    pub n_predicted: usize,
    /// Those that their scans confirm.
    pub n_confirmed: usize,
}
