//! `detect`: places of a drive that may be the same.
//!
//! ```text
//! Drive ──Places──► nodes ──Describer──► descriptors ──Descriptors──► places with similar descriptors
//!                   (points,                                              │ (classifier, optional)
//!                   submaps) ──────────── correlation of submaps ◄────────┘
//!                     │                             │
//!                     │                     best places, poses
//!                     └──────── register::fit ◄─────┘
//!                                     └──► Candidate: pose, covariance, evidence, confidence
//! ```
//!
//! [`Places`] joins the scans of a few metres of path into one node, because single scans of different
//! places look too much alike. [`find_candidates`] compares each place with the most similar earlier
//! places. The correlation of two submaps counts the walls that lie on walls, and subtracts the walls
//! that lie in free space, in both directions. Its best poses are aligned and measured with
//! [`register::fit`].
//!
//! A candidate is not a closure. Wrong candidates are expected: places with the same layout have the
//! same evidence. `optimize` decides which candidates agree with each other and with the odometry.
//!
//! [`Locator`] takes one scan at a time, and finds and follows its position in a [`LocatorMap`] in the same way.
//!
//! The crate depends on neither Arrow, Parquet nor MCAP. Results do not depend on the number of threads
//! or on the processor: sums whose order matters are in a fixed order, and the fast steps
//! (product of matrices, correlation) are either exact or only a filter.

mod candidates;
mod correlation;
mod descriptor;
mod estimate;
mod local_motion;
mod locator;
mod locator_map;
mod places;
mod retrieval;
mod votes;

pub use candidates::{Candidate, Classify, find_candidates, find_candidates_between};
pub use descriptor::{DESCRIPTOR_LEN, Describer};
pub use local_motion::{ScanStep, ScanSteps};
pub use locator::{Locator, Position};
pub use locator_map::{LocatorMap, MapDrive};
pub use places::{Places, PlacesOfDrive};
pub use retrieval::{Descriptors, Similar};
