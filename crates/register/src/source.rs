//! Where the scans of a drive come from.

use std::sync::{Arc, OnceLock};

use dataset::{RangeLimits, Scan};

use crate::points::Points;

/// One point per square of this size is kept of a scan \[m\]. A scanner with thousands of returns per
/// scan would otherwise need more time for the same result.
const SCAN_VOXEL_M: f64 = 0.05;

/// A scan of a drive, with its points.
#[derive(Debug)]
pub struct DriveScan {
    scan: Scan,
    limits: RangeLimits,
    points: OnceLock<Points>,
}

impl DriveScan {
    /// A scan, and the range limits of its points.
    pub fn new(scan: Scan, limits: RangeLimits) -> Self {
        Self { scan, limits, points: OnceLock::new() }
    }

    /// The scan.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// The points of the scan as registration uses them: within the limits, one per square of 0.05 m, with
    /// normals. They are computed when they are asked for the first time.
    pub fn points(&self) -> &Points {
        self.points.get_or_init(|| points_of(&self.scan, self.limits))
    }
}

/// The points of a scan as registration uses them, see [`DriveScan::points`].
pub fn points_of(scan: &Scan, limits: RangeLimits) -> Points {
    Points::from_scan(scan, limits).thin(SCAN_VOXEL_M)
}

/// Gives the scans of a drive, in the order of time.
///
/// The scans of a long drive do not fit into memory. A source can read a scan each time it is asked for, and
/// keep some. Scans that are close together in time are asked for together.
///
/// A source that cannot read a scan returns one without returns, and keeps the error for its owner.
/// The owner must not use any result then.
pub trait ScanSource: Send + Sync {
    /// Number of scans.
    fn len(&self) -> usize;

    /// Whether there are no scans.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A scan, by its index.
    fn scan(&self, index: usize) -> Arc<DriveScan>;
}

/// Scans in memory.
#[derive(Debug)]
pub struct HeldScans(Vec<Arc<DriveScan>>);

impl HeldScans {
    /// Scans, and the range limits of their points.
    pub fn new(scans: impl IntoIterator<Item = Scan>, limits: RangeLimits) -> Self {
        Self(scans.into_iter().map(|scan| Arc::new(DriveScan::new(scan, limits))).collect())
    }
}

impl ScanSource for HeldScans {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn scan(&self, index: usize) -> Arc<DriveScan> {
        self.0[index].clone()
    }
}

/// Some consecutive scans of a source.
pub(crate) struct Stretch<'a> {
    pub(crate) source: &'a dyn ScanSource,
    pub(crate) first: usize,
    pub(crate) n: usize,
}

impl ScanSource for Stretch<'_> {
    fn len(&self) -> usize {
        self.n
    }

    fn scan(&self, index: usize) -> Arc<DriveScan> {
        self.source.scan(self.first + index)
    }
}
