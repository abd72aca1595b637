//! Turns and scans wait until it is known how the lidar moved during them.

use std::collections::VecDeque;

use dataset::{Note, NoteKind, Pose2, Scan};

use crate::deskew::feed::Follower;
use crate::deskew::motion::{Smear, TimedScan, Track};
use crate::options::Options;
use crate::pose::readings::Motion;
use crate::velodyne::revolution::{Revolution, ScanBuilder};

/// Scans that wait at most: 100 s of a lidar at 10 Hz. Where the poses come later than that, scans
/// stay as they are.
const MAX_HELD: usize = 1000;

/// What a scan is made of.
#[derive(Debug)]
pub(crate) enum Raw {
    Revolution(Revolution),
    Scan(TimedScan),
}

/// A scan to be made, and the motion during it where it is to be deskewed.
pub(crate) type Released = (Raw, Option<Smear>);

/// Holds scans back until their poses have been read.
pub(crate) struct Deskewer {
    /// None where scans are to stay as they are.
    follower: Option<Follower>,
    is_wanted: bool,
    track: Track,
    held: VecDeque<Raw>,
    n_straight: u64,
    /// Scans whose messages do not tell the times of their returns.
    n_untimed: u64,
    /// Scans around which the motion is not known.
    n_unknown: u64,
}

impl Deskewer {
    pub(crate) fn new(options: &Options) -> Self {
        let is_wanted = options.lidar.deskew;
        let pose = options.pose.as_ref().filter(|_| is_wanted);
        let mount = options.lidar.mount.map_or(Pose2::default(), |mount| mount.pose());
        Self {
            follower: pose.map(|pose| Follower::new(pose, mount)),
            is_wanted,
            track: Track::new(pose.map_or(f64::INFINITY, |pose| pose.max_speed_m_s)),
            held: VecDeque::new(),
            n_straight: 0,
            n_untimed: 0,
            n_unknown: 0,
        }
    }

    pub(crate) fn hold(&mut self, raw: Raw) {
        self.held.push_back(raw);
    }

    /// Goes on with what comes next in the log; `all` is what has come so far.
    pub(crate) fn follow(&mut self, next: &Motion, all: &Motion) {
        if let Some(follower) = &mut self.follower {
            follower.follow(next, &all.frames, &mut self.track);
        }
    }

    /// The scans whose poses have come, or will not, in order; at the end all of them.
    pub(crate) fn release(&mut self, is_end: bool, released: &mut Vec<Released>) {
        let before = released.len();
        while let Some(raw) = self.held.front() {
            let range_ns = raw.range_ns();
            let is_settled = self.follower.is_none()
                || range_ns.is_none_or(|(_, end_ns)| self.track.has_reached(end_ns))
                || MAX_HELD < self.held.len();
            if !is_settled && !is_end {
                break;
            }
            let smear = match (&self.follower, range_ns) {
                (None, _) => None,
                (Some(_), None) => {
                    self.n_untimed += 1;
                    None
                }
                (Some(_), Some((start_ns, end_ns))) => {
                    let smear = self.track.smear(raw.stamp_ns(), start_ns, end_ns);
                    *(if smear.is_some() { &mut self.n_straight } else { &mut self.n_unknown }) +=
                        1;
                    smear
                }
            };
            released.extend(self.held.pop_front().map(|raw| (raw, smear)));
        }
        if let Some((raw, _)) = released[before..].last() {
            self.track.forget_before(raw.stamp_ns());
        }
    }

    /// How many scans were deskewed, and why others were not. Empty if there are no poses either.
    pub(crate) fn notes(&self) -> Vec<Note> {
        if self.follower.is_none() {
            let note = NoteKind::DeskewOff.into();
            return if self.is_wanted { Vec::new() } else { vec![note] };
        }
        let mut notes = vec![NoteKind::Deskewed { n_scans: self.n_straight }.into()];
        if 0 < self.n_unknown {
            notes.push(NoteKind::NotDeskewedNoMotion { n_scans: self.n_unknown }.into());
        }
        if 0 < self.n_untimed {
            notes.push(NoteKind::NotDeskewedNoTimes { n_scans: self.n_untimed }.into());
        }
        notes
    }
}

impl Raw {
    fn stamp_ns(&self) -> i64 {
        match self {
            Self::Revolution(revolution) => revolution.stamp_ns,
            Self::Scan(timed) => timed.scan.stamp_ns,
        }
    }

    /// The times of its first and last return, as far as they are known \[ns since the epoch\].
    fn range_ns(&self) -> Option<(i64, i64)> {
        match self {
            Self::Revolution(revolution) => Some((revolution.stamp_ns, revolution.end_ns())),
            Self::Scan(timed) => timed.range_ns(),
        }
    }

    /// The scan, deskewed where the motion is given.
    pub(crate) fn scan(self, maker: &ScanBuilder, smear: Option<&Smear>) -> Scan {
        match (self, smear) {
            (Self::Revolution(revolution), smear) => maker.scan(&revolution, smear),
            (Self::Scan(timed), Some(smear)) => timed.deskewed(smear),
            (Self::Scan(timed), None) => timed.scan,
        }
    }
}
