//! Logs of CARMEN, the Carnegie Mellon Robot Navigation Toolkit. Each line is a message.
//!
//! Sources: CARMEN's reader, `src/logger/readlog.c`, and the comments that its logger writes at the
//! start of a log. Units are metres and radians. The robot's frame has x forward and y left.
//!
//! ```text
//! FLASER n range.. laser_x laser_y laser_theta x y theta time host logger_time
//! RLASER (same fields)
//! ROBOTLASER1 type start_angle fov angular_resolution maximum_range accuracy remission_mode
//!     n range.. m remission.. laser_x laser_y laser_theta x y theta
//!     tv rv forward_safety side_safety turn_axis time host logger_time
//! ROBOTLASER2 (same fields)
//! RAWLASER1 type start_angle fov angular_resolution maximum_range accuracy remission_mode
//!     n range.. m remission.. time host logger_time
//! RAWLASER2 (same fields)
//! ODOM x y theta tv rv acceleration time host logger_time
//! TRUEPOS x y theta odom_x odom_y odom_theta time host logger_time
//! ```
//!
//! - `FLASER` and `ROBOTLASER1` become `LaserScan`. `RLASER` and `ROBOTLASER2` become `LaserScan` of
//!   the rear scanner. Readings are copied unchanged: a reading of `range_max` or more means no return.
//!   `RAWLASER1` and `RAWLASER2` have no poses. They are the source of the other scans, and are used
//!   only if the log does not have those.
//! - `ODOM` becomes `Odometry`. In a log without `ODOM`, the robot's pose of each front scan becomes
//!   `Odometry`.
//! - In a corrected log, the first pose of a `FLASER` line is the corrected pose, and the second is
//!   the odometry. If the two differ in any line of the log, the first pose of every `FLASER` line
//!   becomes `PoseStamped`. (In a raw log, the two may differ by the mounting position of the scanner.
//!   The `PoseStamped` then differs from the odometry by the same offset.)
//! - Other corrected logs have the corrected pose in both places, next to `ODOM` lines that were not
//!   corrected. Such a log is recognised by poses that contradict the `ODOM` lines (`corrections.rs`).
//!   `Odometry` and `PoseStamped` then have the poses of the scans. The `ODOM` lines become `Odometry`
//!   on a topic of their own.
//! - `TRUEPOS`, which a simulator writes, becomes the `PoseStamped` of the ground truth.
//! - The stamp is the time of the sensor (`time`), not the time of the logger. If the times of the
//!   scans cannot be used (`times.rs`), every message is stamped by its line, and the poses are those
//!   of the scans: each scan has the pose on its own line.

mod corrections;
mod line;
mod preview;
mod times;

use std::collections::VecDeque;
use std::path::Path;

use dataset::{Loss, LossKind, Losses, Note, Subject};

use crate::error::ImportError;
use crate::input::{Lines, Meter, file_name};
use crate::options::{Options, Topic};
use crate::record::{Body, Record, Source, Twist, is_representable};
use line::{Content, Message, NoMessage, message};
use preview::{Preview, SENSORS, Sensor, index};
use times::{Clock, MAX_STEP_BACK_NS};

pub(crate) use line::is_message;

/// Reads one log.
pub(crate) struct Log {
    lines: Lines,
    preview: Preview,
    clock: Clock,
    /// The latest stamp so far of each kind of line \[ns\].
    latest_ns: [i64; SENSORS.len()],
    ready: VecDeque<Record>,
}

impl Log {
    /// Opens a log and reads it once to find out which of its times and poses can be used.
    /// [`Source::next`] reads it again. Remarks go to `notes`.
    ///
    /// `after_ns` is the end of the previous log. A log that is stamped by its lines starts there.
    pub fn open(
        path: &Path,
        options: &Options,
        meter: &Meter,
        after_ns: i64,
        notes: &mut Vec<Note>,
    ) -> Result<Self, ImportError> {
        let mut ahead = Lines::open(path, &Meter::default())?;
        let mut preview = Preview::default();
        while let Some(line) = ahead.next()? {
            if let Ok(message) = message(&line.text) {
                preview.add(&message);
            }
        }
        preview.finish();
        let subject = Subject::file(file_name(path));
        let kinds = preview.notes(&options.topics);
        notes.extend(kinds.into_iter().map(|kind| Note::new(kind, subject.clone())));
        let clock = preview.clock(after_ns);
        let lines = Lines::open(path, meter)?;
        Ok(Self { lines, preview, clock, latest_ns: [0; SENSORS.len()], ready: VecDeque::new() })
    }

    /// The stamp of the last line, if the log is stamped by its lines \[ns\].
    pub fn end_by_line_ns(&self) -> Option<i64> {
        self.preview.end_by_line_ns(&self.clock)
    }

    /// Queues the records of a message. Returns the loss if it is not used.
    fn push(&mut self, Message { stamp_ns, content }: Message) -> Result<(), LossKind> {
        let sensor = Sensor::of(&content);
        let stamp_ns = self.clock.stamp_ns(stamp_ns);
        if !is_representable(stamp_ns) {
            return Err(LossKind::TimesOutOfRange { item: "line".to_owned() });
        }
        if let Some(kind) = self.preview.reason_to_drop(sensor) {
            return Err(kind);
        }
        let latest_ns = &mut self.latest_ns[index(sensor)];
        if stamp_ns < *latest_ns - MAX_STEP_BACK_NS {
            return Err(LossKind::LinesWithoutTime {
                item: sensor.item().to_owned(),
                fault: "more than 10 s earlier than the line before".to_owned(),
            });
        }
        *latest_ns = stamp_ns.max(*latest_ns);
        let preview = &self.preview;
        let mut push = |topic, body| self.ready.push_back(Record { topic, stamp_ns, body });
        match content {
            Content::Odometry { pose, twist } => {
                let topic = if preview.is_contradicted { Topic::OdomLines } else { Topic::Odom };
                push(topic, Body::Odometry(pose.to_3d(), twist));
            }
            Content::GroundTruth(pose) => push(Topic::GroundTruth, Body::Pose(pose.to_3d())),
            Content::Scan { scan, laser, robot, .. } => {
                // The poses come first, because some readers need a pose before its scan.
                if let Some(robot) = robot
                    && preview.gives_odometry(sensor)
                {
                    push(Topic::Odom, Body::Odometry(robot.to_3d(), Twist::default()));
                }
                if let Some(pose) = laser.or(robot.filter(|_| preview.is_contradicted))
                    && preview.gives_corrected_poses(sensor)
                {
                    push(Topic::Pose, Body::Pose(pose.to_3d()));
                }
                let topic = if sensor.is_rear() { Topic::RearScan } else { Topic::Scan };
                push(topic, Body::Scan(scan));
            }
        }
        Ok(())
    }

    fn loss(&self, kind: LossKind) -> Loss {
        Loss::new(kind, Subject::file(file_name(self.lines.path())))
    }
}

impl Source for Log {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while self.ready.is_empty() {
            let Some(line) = self.lines.next()? else { break };
            let kind = match message(&line.text) {
                Ok(message) => self.push(message).err(),
                Err(NoMessage::Empty) => None,
                Err(NoMessage::Loss(kind)) => Some(kind),
            };
            if let Some(kind) = kind {
                losses.add(self.loss(kind), 1);
            }
        }
        Ok(self.ready.pop_front())
    }
}
