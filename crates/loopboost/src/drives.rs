//! The drives of a run: continuous pieces of logs, with their registered scans.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use dataset::tables::scans::{read_scan_headers, read_scans};
use dataset::tables::{TableError, read_poses, read_registered};
use dataset::{RangeLimits, RegisteredScan, Scan, ScanClosure, ScanId, StampedPose};
use model::Evidence;
use nalgebra::Matrix3;
use optimize::Proposal;
use register::{Drive, ScanSource, is_decided};

use crate::config::Config;
use crate::run::Run;
use crate::scan_cache::{DriveScans, ScanCache};
use crate::stage::Artifact;

/// The points of a closure do not determine the position if the ratio of the smallest to the largest
/// information is less than this. A bare corridor has 0 to 0.05, a room 0.5 and more.
pub(crate) const DEGENERATE_RATIO: f64 = 0.1;

/// The registered scans of a segment of a log.
pub(crate) struct RegisteredDrive {
    /// One row per registered scan, in the order of time.
    pub(crate) rows: Vec<RegisteredScan>,
    /// The scans of the rows.
    scans: Arc<DriveScans>,
}

impl RegisteredDrive {
    /// The drive as the crates know it.
    pub(crate) fn drive(&self) -> Drive {
        Drive::new(
            self.scans.clone(),
            self.rows.iter().map(|row| row.odometry).collect(),
            self.rows.iter().map(|row| row.pose).collect(),
            self.rows.iter().map(|row| row.is_keyframe).collect(),
            self.rows.iter().map(|row| is_decided(row.near_share, row.weakness)).collect(),
        )
    }

    /// The log.
    pub(crate) fn log(&self) -> Option<&Arc<str>> {
        self.rows.first().map(|row| &row.id.log)
    }

    /// Angle that the scans cover \[deg\].
    pub(crate) fn coverage_deg(&self) -> Option<f32> {
        (0 < self.scans.n).then(|| self.scans.scan(0).scan().coverage_deg)
    }

    /// Number of the continuous piece of the log.
    pub(crate) fn segment(&self) -> u32 {
        self.rows.first().map_or(0, |row| row.segment)
    }
}

/// The registered drives of a log, one per segment.
pub(crate) fn registered_drives(run: &Run, log: &str) -> Result<Vec<RegisteredDrive>> {
    let (rows, _) = read_registered(&run.path_of_log(Artifact::Registered, log))?;
    let limits = registration_limits(&run.config, log)?;
    drives_of(&run.scan_cache, &run.scans(log), &rows, limits)
}

/// The drives of the rows of a log, one per segment. The scans of the rows are in the table at `path`.
pub(crate) fn drives_of(
    cache: &Arc<ScanCache>,
    path: &Path,
    rows: &[RegisteredScan],
    limits: RangeLimits,
) -> Result<Vec<RegisteredDrive>> {
    let numbers: Vec<u32> = rows.iter().map(|row| row.id.scan).collect();
    let of_log = Arc::new(cache.open(path, &numbers, limits)?);
    let mut first = 0;
    let of_rows = |rows: &[RegisteredScan]| {
        let scans = Arc::new(DriveScans { of_log: of_log.clone(), first, n: rows.len() });
        first += rows.len();
        RegisteredDrive { rows: rows.to_vec(), scans }
    };
    Ok(rows.chunk_by(|a, b| a.segment == b.segment).map(of_rows).collect())
}

/// The scans with these numbers, which need not be sorted.
pub(crate) fn scans_of(path: &Path, numbers: &[u32]) -> Result<Vec<Scan>, TableError> {
    let mut sorted: Vec<(u32, usize)> = numbers.iter().copied().zip(0..).collect();
    sorted.sort_unstable();
    let ascending: Vec<u32> = sorted.iter().map(|&(number, _)| number).collect();
    let mut scans = vec![Scan::default(); numbers.len()];
    let mut rows = sorted.into_iter();
    read_scans(path, &ascending, |batch| {
        for (scan, (_, row)) in batch.into_iter().zip(&mut rows) {
            scans[row] = scan;
        }
        Ok::<_, TableError>(())
    })?;
    Ok(scans)
}

/// A scan without its points, with its pose by odometry.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PosedScan {
    /// Number of the scan in its log.
    pub(crate) scan: u32,
    /// Time of the scan and pose of the lidar, with covariance and segment.
    pub(crate) odometry: StampedPose,
    /// Angle that the scan covers \[deg\].
    pub(crate) coverage_deg: f32,
    /// Whether features can be computed from the scan.
    pub(crate) is_usable: bool,
}

/// All scans of a log that have a pose, in the order of time, one list per segment. `subsample` has
/// counted those that have none.
pub(crate) fn posed_scans(run: &Run, log: &str) -> Result<Vec<Vec<PosedScan>>> {
    let (headers, _) = read_scan_headers(&run.scans(log))?;
    let (trajectory, _) = read_poses(&run.poses(log))?;
    let max_gap_ns = (run.config.subsample.max_pose_gap_secs * 1e9) as i64;
    let mut scans: Vec<PosedScan> = (0..)
        .zip(&headers)
        .filter_map(|(scan, header)| {
            let odometry = trajectory.stamped_pose_at(header.stamp_ns, max_gap_ns).ok()?;
            let (coverage_deg, is_usable) = (header.coverage_deg, header.usable);
            Some(PosedScan { scan, odometry, coverage_deg, is_usable })
        })
        .collect();
    scans.sort_by_key(|scan| (scan.odometry.stamp_ns, scan.scan));
    Ok(scans.chunk_by(|a, b| a.odometry.segment == b.odometry.segment).map(<[_]>::to_vec).collect())
}

/// The same, split as the registered scans are: `register` begins a new segment where the scans show another place
/// than those before. Scans between two registered ones belong to the first of them. Those between two segments are
/// left out: it is not known which of the two places they show. `register` counts them.
pub(crate) fn posed_scans_of(
    run: &Run,
    log: &str,
    rows: &[RegisteredScan],
) -> Result<Vec<Vec<PosedScan>>> {
    let segment_of: HashMap<u32, u32> = rows.iter().map(|row| (row.id.scan, row.segment)).collect();
    let mut pieces = Vec::new();
    for scans in posed_scans(run, log)? {
        let registered = |scan: &PosedScan| segment_of.get(&scan.scan).copied();
        let Some(mut segment) = scans.iter().find_map(registered) else { continue };
        let mut next = vec![None; scans.len()];
        for k in (0..scans.len()).rev() {
            next[k] = registered(&scans[k]).or_else(|| *next.get(k + 1)?);
        }
        let mut kept: Vec<PosedScan> = Vec::with_capacity(scans.len());
        for (mut scan, next) in scans.into_iter().zip(next) {
            let own = registered(&scan);
            segment = own.unwrap_or(segment);
            if own.is_some() || next.is_none_or(|next| next == segment) {
                scan.odometry.segment = segment;
                kept.push(scan);
            }
        }
        let pieces_of = kept.chunk_by(|a, b| a.odometry.segment == b.odometry.segment);
        pieces.extend(pieces_of.map(<[_]>::to_vec));
    }
    Ok(pieces)
}

/// The range limits of the registration of a log: those of its lidar, up to `register.max_range_m`.
pub(crate) fn registration_limits(config: &Config, log: &str) -> Result<RangeLimits> {
    let lidar = config.for_log(log)?.lidar;
    let limits = RangeLimits { min_m: lidar.range_min_m, max_m: lidar.range_max_m };
    Ok(config.register.limits(limits))
}

/// The row of a closure between two of the registered scans of a drive.
pub(crate) fn closure_row(rows: &[RegisteredScan], proposal: &Proposal) -> ScanClosure {
    let Evidence { overlap, known_overlap, n_known, conflict, margin, weakness, classifier } =
        proposal.evidence;
    ScanClosure {
        query: rows[proposal.query].id.clone(),
        reference: rows[proposal.reference].id.clone(),
        reference_from_query: proposal.reference_from_query,
        covariance: upper_triangle(&proposal.covariance),
        confidence: proposal.confidence,
        overlap,
        known_overlap,
        n_known,
        conflict,
        margin,
        weakness,
        classifier,
        is_degenerate: weakness < DEGENERATE_RATIO,
    }
}

/// The evidence of a closure.
pub(crate) fn evidence(closure: &ScanClosure) -> Evidence {
    Evidence {
        overlap: closure.overlap,
        known_overlap: closure.known_overlap,
        n_known: closure.n_known,
        conflict: closure.conflict,
        margin: closure.margin,
        weakness: closure.weakness,
        classifier: closure.classifier,
    }
}

/// The positions of registered scans.
pub(crate) fn by_id(rows: &[RegisteredScan]) -> HashMap<&ScanId, usize> {
    rows.iter().map(|row| &row.id).zip(0..).collect()
}

/// The upper triangle of a covariance, row by row.
pub(crate) fn upper_triangle(covariance: &Matrix3<f64>) -> [f64; 6] {
    let entries = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    entries.map(|entry| covariance[entry])
}

/// The covariance with this upper triangle.
pub(crate) fn matrix([xx, xy, xh, yy, yh, hh]: [f64; 6]) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xh, xy, yy, yh, xh, yh, hh)
}
