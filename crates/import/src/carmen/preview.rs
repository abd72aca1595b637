//! What a log contains, found by reading it once before the messages are converted.

use dataset::{LossKind, NoteKind};

use super::corrections::Corrections;
use super::line::{Content, Message};
use super::times::{Clock, Times};
use crate::options::{Topic, Topics};

/// A kind of line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sensor {
    /// `FLASER`, `ROBOTLASER1`.
    Front,
    /// `RLASER`, `ROBOTLASER2`.
    Rear,
    /// `RAWLASER1`.
    RawFront,
    /// `RAWLASER2`.
    RawRear,
    Odometry,
    GroundTruth,
}

/// The kinds in the order in which they decide about the clock of the log: scans first.
pub(super) const SENSORS: [Sensor; 6] = [
    Sensor::Front,
    Sensor::RawFront,
    Sensor::Rear,
    Sensor::RawRear,
    Sensor::Odometry,
    Sensor::GroundTruth,
];

impl Sensor {
    pub fn of(content: &Content) -> Self {
        match content {
            Content::Odometry { .. } => Self::Odometry,
            Content::GroundTruth(_) => Self::GroundTruth,
            Content::Scan { rear: false, robot: Some(_), .. } => Self::Front,
            Content::Scan { rear: true, robot: Some(_), .. } => Self::Rear,
            Content::Scan { rear: false, robot: None, .. } => Self::RawFront,
            Content::Scan { rear: true, robot: None, .. } => Self::RawRear,
        }
    }

    pub fn is_rear(self) -> bool {
        matches!(self, Self::Rear | Self::RawRear)
    }

    /// What its lines contain, for messages.
    pub fn item(self) -> &'static str {
        match self {
            Self::Front | Self::RawFront => "scan",
            Self::Rear | Self::RawRear => "rear scan",
            Self::Odometry => "ODOM",
            Self::GroundTruth => "TRUEPOS",
        }
    }
}

/// What a log contains.
#[derive(Debug, Clone, Default)]
pub(super) struct Preview {
    /// By [`SENSORS`].
    times: [Times; SENSORS.len()],
    /// Whether the two poses of any `FLASER` line differ.
    has_two_poses: bool,
    corrections: Corrections,
    /// Whether the poses of the scans contradict the `ODOM` lines.
    pub is_contradicted: bool,
    /// Why messages are stamped by line, with the kind of line that decides it.
    by_line: Option<(Sensor, String)>,
}

impl Preview {
    pub fn add(&mut self, message: &Message) {
        let Message { stamp_ns, content } = message;
        self.times[index(Sensor::of(content))].add(*stamp_ns);
        match content {
            Content::Odometry { pose, .. } => self.corrections.add_odometry(*stamp_ns, *pose),
            Content::Scan { rear: false, laser, robot: Some(robot), .. } => {
                self.has_two_poses |= laser.is_some_and(|laser| laser != *robot);
                self.corrections.add_scan(*stamp_ns, *robot);
            }
            _ => {}
        }
    }

    /// Decides what is used.
    pub fn finish(&mut self) {
        let main = SENSORS.into_iter().find(|&sensor| self.has(sensor));
        self.by_line = main.and_then(|main| Some((main, self.times[index(main)].fault()?)));
        self.is_contradicted = self.by_line.is_none()
            && self.times[index(Sensor::Odometry)].fault().is_none()
            && self.corrections.are_there();
    }

    /// Remarks about the poses and times.
    pub fn notes(&self, topics: &Topics) -> Vec<NoteKind> {
        let mut notes = Vec::new();
        if let Some((sensor, fault)) = &self.by_line {
            notes.push(NoteKind::StampedByLine {
                item: sensor.item().to_owned(),
                n_lines: self.times[index(*sensor)].n,
                fault: fault.clone(),
            });
        }
        if self.is_contradicted {
            notes.push(NoteKind::CorrectedScanPoses {
                n_scans: self.corrections.n_contradicted,
                n_compared: self.corrections.n_compared,
                largest_m: self.corrections.largest_m,
                topic: topics.name(Topic::Odom).to_owned(),
                odom_topic: topics.name(Topic::OdomLines).to_owned(),
            });
        }
        notes
    }

    /// The clock of the log. Stamps by line start after `after_ns`.
    pub fn clock(&self, after_ns: i64) -> Clock {
        match &self.by_line {
            None => Clock::Recorded,
            Some((main, _)) => Clock::by_line(after_ns, self.times[index(*main)].n, self.n_lines()),
        }
    }

    /// The stamp of the last line for a clock that was not used yet \[ns\].
    pub fn end_by_line_ns(&self, clock: &Clock) -> Option<i64> {
        match clock {
            Clock::Recorded => None,
            Clock::Line { next_ns, step_ns } => {
                let n_steps = i64::try_from(self.n_lines()).unwrap_or(i64::MAX).saturating_sub(1);
                Some(next_ns.saturating_add(step_ns.saturating_mul(n_steps.max(0))))
            }
        }
    }

    /// Why the lines of a kind are not used.
    pub fn reason_to_drop(&self, sensor: Sensor) -> Option<LossKind> {
        let keyword = |keyword: &str| keyword.to_owned();
        match (sensor, &self.by_line) {
            (Sensor::RawFront, _) if self.has(Sensor::Front) => {
                return Some(LossKind::RepeatedScanLines { keyword: keyword("RAWLASER1") });
            }
            (Sensor::RawRear, _) if self.has(Sensor::Rear) => {
                return Some(LossKind::RepeatedScanLines { keyword: keyword("RAWLASER2") });
            }
            // The poses of the scans are used. Without times, odometry has no relation to them.
            (Sensor::Odometry, Some(_)) if self.has_poses_of_scans() => {
                return Some(LossKind::LinesWithoutTime {
                    item: keyword("ODOM"),
                    fault: "all messages are stamped by their line".to_owned(),
                });
            }
            (_, Some(_)) => return None,
            (_, None) => {}
        }
        let fault = self.times[index(sensor)].fault()?;
        Some(LossKind::LinesWithoutTime { item: keyword(sensor.item()), fault })
    }

    /// Whether the robot's poses of these scans become odometry.
    pub fn gives_odometry(&self, sensor: Sensor) -> bool {
        let is_first =
            sensor == Sensor::Front || (sensor == Sensor::Rear && !self.has(Sensor::Front));
        let odometry_is_used =
            self.has(Sensor::Odometry) && self.reason_to_drop(Sensor::Odometry).is_none();
        match (self.by_line.is_some() || self.is_contradicted, odometry_is_used) {
            (true, _) => is_first,
            // A log with odometry of its own, or only with rear scans.
            (false, is_used) => sensor == Sensor::Front && !is_used,
        }
    }

    /// Whether the first pose of these scans is a corrected pose.
    pub fn gives_corrected_poses(&self, sensor: Sensor) -> bool {
        sensor == Sensor::Front && (self.has_two_poses || self.is_contradicted)
    }

    fn has_poses_of_scans(&self) -> bool {
        self.has(Sensor::Front) || self.has(Sensor::Rear)
    }

    fn has(&self, sensor: Sensor) -> bool {
        0 < self.times[index(sensor)].n
    }

    fn n_lines(&self) -> u64 {
        self.times.iter().map(|times| times.n).sum()
    }
}

/// The place of a kind in [`SENSORS`].
pub(super) fn index(sensor: Sensor) -> usize {
    SENSORS.iter().position(|&other| other == sensor).unwrap_or_default()
}
