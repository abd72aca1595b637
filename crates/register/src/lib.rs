//! `register`: how one planar scan lies to others.
//!
//! ```text
//! Scan ──Points──► BlurredMap, Target ──search──► start ──align──► pose, covariance
//!                                                              └─ScanMatcher──► odometry
//!                                          poses + scans ──Submap──► occupied, free, unknown
//! ```
//!
//! [`align`] moves points onto the lines of a target (point-to-line ICP). [`search`] finds a start for
//! it by correlation. [`ScanMatcher`] does both for each scan of a drive, against the scans of the last
//! metres, with the odometry as prior: in an empty corridor the position along the corridor stays that
//! of the odometry, and the covariance says so. [`OdometryModel`] is what the scans of a
//! drive say about the errors of its odometry. [`Submap`] joins the scans of a few metres into a map of
//! occupied, free and unknown squares.
//!
//! The crate depends on neither Arrow, Parquet nor MCAP. It can be used on a robot. All computations are in
//! f64, with the functions of `libm`: the same input gives the same bytes on every machine, with any number
//! of threads.
//!
//! # Example
//!
//! The sensor has moved by 0.3 m along x in a room of 6 m by 4 m:
//!
//! ```
//! use dataset::{Pose2, RangeLimits, Scan};
//! use register::{AlignOptions, Points, Prior, Target, align};
//!
//! /// A scan in a room with walls at x = -3, x = 3, y = -2 and y = 2, seen from (x, 0).
//! fn scan(x_m: f64) -> Scan {
//!     let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
//!     for degree in 0..360 {
//!         let (sin, cos) = f64::from(degree).to_radians().sin_cos();
//!         let to_x = if cos > 0.0 { (3.0 - x_m) / cos } else { (-3.0 - x_m) / cos };
//!         let to_y = if sin > 0.0 { 2.0 / sin } else { -2.0 / sin };
//!         let range_m = to_x.min(to_y);
//!         scan.x_m.push((range_m * cos) as f32);
//!         scan.y_m.push((range_m * sin) as f32);
//!     }
//!     scan
//! }
//!
//! let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
//! let options = AlignOptions::default();
//! let target = Target::new(Points::from_scan(&scan(0.0), limits), options.first_gate_m);
//! let start = Pose2::default();
//! let aligned =
//!     align(&Points::from_scan(&scan(0.3), limits), &target, &start, &Prior::none(start), &options);
//! assert!((aligned.target_from_source.x_m - 0.3).abs() < 1e-3, "{aligned:?}");
//! assert!(aligned.weakness.unwrap().ratio > 0.2);
//! ```

mod align;
mod breaks;
mod correlate;
mod drive;
mod joint;
mod kept;
mod map_order;
mod matcher;
mod node;
mod odometry;
mod panel;
mod points;
mod source;
mod sparse;
mod still;
mod stretches;
mod submap;
mod target;
mod uncertainty;

pub use align::{
    AlignOptions, Alignment, Explained, NEAR_M, Prior, Weakness, align, align_and_explain,
    align_roughly, near_share,
};
pub use correlate::{BestPose, BlurredMap, Preference, Window, search};
pub use drive::{
    Drive, NEW_DRIVE_M, OdometryScan, RegisterOptions, Registered, register_drive,
    scans_to_register,
};
pub use joint::{JointOptions, JointScans, align_jointly, pairs_along_path, relative_derivatives};
pub use kept::Kept;
pub use map_order::map_order;
pub use matcher::{Matched, MatcherOptions, ScanMatcher, is_decided};
pub use node::{Fit, Node, NodeMember, fit, fit_options, places};
pub use odometry::{OdometryModel, OdometryStep};
pub use points::Points;
pub use source::{DriveScan, HeldScans, ScanSource, points_of};
pub use sparse::BlockSystem;
pub use submap::{Member, Square, Submap, SubmapOptions};
pub use target::Target;
pub use uncertainty::closure_covariance;
