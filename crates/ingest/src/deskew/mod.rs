//! Corrects scans for the motion of the lidar while it measured them.
//!
//! ```text
//! readings ──feed──► recent_poses ──motion──┐
//! scans ─────────────────queue──────────────┴──► scans, each with the motion during it
//! ```

pub(crate) mod feed;
pub(crate) mod motion;
pub(crate) mod queue;
pub(crate) mod recent_poses;
pub(crate) mod timed_scan;
