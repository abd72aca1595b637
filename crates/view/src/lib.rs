//! Shows the results of loop detection in other programs.
//!
//! ```text
//! closures, optimized poses, scans ─┬─write_overlay──► overlay.mcap, layout()──► Foxglove
//!                                   └─Grid::new──────► PNG, YAML────────────────► map_server
//! ```
//!
//! [`write_overlay`] writes an MCAP file that is opened together with the log. [`Grid`] is a map of
//! occupied, free and unknown squares in the format of ROS. The same input gives the same bytes, on any
//! number of threads.
//!
//! # Example
//!
//! The map of one scan, 1 m in front of a wall:
//!
//! ```
//! use dataset::{Pose2, Scan};
//! use view::{Grid, PlacedScan};
//!
//! let y_m: Vec<f32> = (-50..50).map(|k| 0.01 * k as f32).collect();
//! let scan = Scan { x_m: vec![1.0; y_m.len()], y_m, ..Scan::default() };
//! let pose = Pose2 { x_m: 10.0, ..Pose2::default() };
//! let grid = Grid::new(&[PlacedScan { stamp_ns: 0, pose, scan: &scan }])?;
//! assert!(grid.occupied_m().all(|[x, y]| (x - 11.0).abs() < 0.05 && y.abs() < 0.55));
//! assert!(grid.yaml("map.png").starts_with("image: map.png\n"));
//! # Ok::<(), view::ViewError>(())
//! ```

mod error;
mod grid;
mod layout;
mod overlay;
mod placed;
mod schemas;
mod wire;

pub use error::ViewError;
pub use grid::Grid;
pub use layout::layout;
pub use overlay::{ClosureLine, MapPart, Overlay, OverlaySummary, write_overlay};
pub use placed::PlacedScan;
