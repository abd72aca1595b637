//! Holds scans until the motion of the lidar during them is known.

use std::collections::VecDeque;

use dataset::{NoteKind, Pose2, Scan};

use crate::deskew::feed::PoseFeed;
use crate::deskew::motion::{LidarSpeed, ScanMotion};
use crate::deskew::recent_poses::RecentPoses;
use crate::deskew::timed_scan::TimedScan;
use crate::options::Options;
use crate::pose::readings::MotionReadings;
use crate::velodyne::revolution::{Revolution, ScanBuilder};

/// Largest number of held scans: 100 s of a lidar at 10 Hz. If the poses come later than that, the
/// scans are not deskewed.
const MAX_HELD: usize = 1000;

/// The measurements of one scan.
#[derive(Debug)]
pub(crate) enum MeasuredScan {
    Revolution(Revolution),
    Timed(TimedScan),
}

/// A scan that is ready to be built.
pub(crate) struct ReadyScan {
    pub(crate) measured: MeasuredScan,
    /// The motion during the scan; `None` if the scan is not deskewed.
    pub(crate) motion: Option<ScanMotion>,
}

/// Holds scans until their poses have been read, and finds the motion during each scan.
pub(crate) struct Deskewer {
    /// `None` if the log has no poses, or if scans are not deskewed.
    feed: Option<PoseFeed>,
    is_enabled: bool,
    /// The speeds of the lidar during the next scans, if they are known from elsewhere.
    speeds: Option<VecDeque<Option<LidarSpeed>>>,
    recent_poses: RecentPoses,
    held: VecDeque<MeasuredScan>,
    n_deskewed: u64,
    /// Number of scans without the times of their returns.
    n_without_times: u64,
    /// Number of scans with an unknown motion.
    n_without_motion: u64,
}

impl Deskewer {
    pub(crate) fn new(options: &Options) -> Self {
        let is_enabled = options.lidar.deskew;
        let pose = options.pose.as_ref().filter(|_| is_enabled);
        let base_from_lidar = options.lidar.mount.map_or(Pose2::default(), |mount| mount.pose());
        let max_speed_m_s = pose.map_or(f64::INFINITY, |pose| pose.max_speed_m_s);
        Self {
            feed: pose.map(|pose| PoseFeed::new(pose, base_from_lidar)),
            is_enabled,
            speeds: None,
            recent_poses: RecentPoses::new(max_speed_m_s),
            held: VecDeque::new(),
            n_deskewed: 0,
            n_without_times: 0,
            n_without_motion: 0,
        }
    }

    /// Deskews the scans by these speeds of the lidar, one for each scan. Those without one are not deskewed.
    pub(crate) fn deskew_by(&mut self, speeds: &[Option<LidarSpeed>]) {
        self.speeds = self.is_enabled.then(|| speeds.iter().copied().collect());
    }

    /// Whether scans are deskewed.
    fn is_used(&self) -> bool {
        self.speeds.is_some() || self.feed.is_some()
    }

    /// Adds a scan.
    pub(crate) fn push(&mut self, measured: MeasuredScan) {
        self.held.push_back(measured);
    }

    /// Adds the readings of the next part of the log. `all` contains the transforms so far.
    pub(crate) fn add_readings(&mut self, next: &MotionReadings, all: &MotionReadings) {
        if let Some(feed) = &mut self.feed {
            feed.advance(next, &all.transforms, &mut self.recent_poses);
        }
    }

    /// Appends the scans to `ready` for which the poses are known or will never be known, in order.
    /// At the end of the log these are all scans.
    pub(crate) fn release(&mut self, is_end: bool, ready: &mut Vec<ReadyScan>) {
        let before = ready.len();
        while let Some(measured) = self.held.front() {
            let range_ns = measured.range_ns();
            let is_ready = self.feed.is_none()
                || range_ns.is_none_or(|(_, end_ns)| self.recent_poses.has_reached(end_ns))
                || MAX_HELD < self.held.len();
            if !is_ready && !is_end {
                break;
            }
            let speed = self.speeds.as_mut().map(|speeds| speeds.pop_front().flatten());
            let motion = match range_ns {
                _ if !self.is_used() => None,
                None => {
                    self.n_without_times += 1;
                    None
                }
                Some((start_ns, end_ns)) => {
                    let motion = match &speed {
                        Some(speed) => speed.as_ref().map(ScanMotion::constant),
                        None => self.recent_poses.motion(measured.stamp_ns(), start_ns, end_ns),
                    };
                    match motion {
                        Some(_) => self.n_deskewed += 1,
                        None => self.n_without_motion += 1,
                    }
                    motion
                }
            };
            ready.extend(self.held.pop_front().map(|measured| ReadyScan { measured, motion }));
        }
        if let Some(last) = ready[before..].last() {
            self.recent_poses.forget_before(last.measured.stamp_ns());
        }
    }

    /// Notes about how many scans were deskewed. There are none without poses and speeds.
    pub(crate) fn notes(&self) -> Vec<NoteKind> {
        if !self.is_used() {
            return if self.is_enabled { Vec::new() } else { vec![NoteKind::DeskewOff] };
        }
        let mut notes = Vec::new();
        if let n_scans @ 1.. = self.n_deskewed {
            notes.push(NoteKind::Deskewed { n_scans });
        }
        if let n_scans @ 1.. = self.n_without_motion {
            notes.push(NoteKind::NotDeskewedNoMotion { n_scans });
        }
        if let n_scans @ 1.. = self.n_without_times {
            notes.push(NoteKind::NotDeskewedNoTimes { n_scans });
        }
        notes
    }
}

impl MeasuredScan {
    fn stamp_ns(&self) -> i64 {
        match self {
            Self::Revolution(revolution) => revolution.stamp_ns,
            Self::Timed(timed) => timed.scan.stamp_ns,
        }
    }

    /// The times of the first and the last return, if they are known \[ns since the epoch\].
    fn range_ns(&self) -> Option<(i64, i64)> {
        match self {
            Self::Revolution(revolution) => Some((revolution.stamp_ns, revolution.end_ns())),
            Self::Timed(timed) => timed.range_ns(),
        }
    }
}

impl ReadyScan {
    /// Builds the scan, deskewed if the motion is known.
    pub(crate) fn build(self, builder: &ScanBuilder) -> Scan {
        match (self.measured, &self.motion) {
            (MeasuredScan::Revolution(revolution), motion) => {
                builder.scan(&revolution, motion.as_ref())
            }
            (MeasuredScan::Timed(timed), Some(motion)) => timed.deskewed(motion),
            (MeasuredScan::Timed(timed), None) => timed.scan,
        }
    }
}
