//! Logs of CARMEN, the Carnegie Mellon Robot Navigation Toolkit: a message a line.
//!
//! Source: CARMEN's reader, `src/logger/readlog.c`, and the description that its logger writes at a
//! log's start. Metres, radians; the robot's frame has x forward, y left.
//!
//! ```text
//! FLASER n range.. laser_x laser_y laser_theta x y theta time host logger_time      RLASER the same
//! ROBOTLASER1 type start_angle fov angular_resolution maximum_range accuracy remission_mode
//!     n range.. m remission.. laser_x laser_y laser_theta x y theta
//!     tv rv forward_safety side_safety turn_axis time host logger_time              ROBOTLASER2 too
//! ODOM x y theta tv rv acceleration time host logger_time
//! TRUEPOS x y theta odom_x odom_y odom_theta time host logger_time
//! ```
//!
//! - `FLASER` and `ROBOTLASER1` become `LaserScan`, `RLASER` and `ROBOTLASER2` those of the rear
//!   scanner. Readings are left as they are: a scanner that saw nothing gives one of `range_max` or
//!   more.
//! - `ODOM` becomes `Odometry`; in a log without, the robot's pose of each front scan does.
//! - In a corrected log the first pose of `FLASER` is the corrected one, the second the odometry's.
//!   Where the two differ in any line of a log, the first becomes `PoseStamped` for each of them.
//!   (In a raw log they may differ by where the scanner is mounted; so does that pose then.)
//! - `TRUEPOS`, which a simulator writes, becomes the `PoseStamped` of the ground truth.
//! - The time is that of the sensor (`time`), not the logger's.

use std::collections::VecDeque;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;
use std::str::SplitAsciiWhitespace;

use crate::error::ImportError;
use crate::input::{Lines, Meter};
use crate::options::Topic;
use crate::record::{Body, Losses, Pose, Record, Scan, Source, Twist, representable};
use crate::rotation::from_heading;

/// Range beyond which `FLASER` saw nothing \[m\]: what CARMEN fills in (`readlog.c`,
/// `config.maximum_range`); a SICK LMS reports 81.83 m and more for no return.
const SICK_RANGE_MAX_M: f32 = 80.0;
/// More readings a scan than any scanner has: such a number is no number of readings.
const MAX_READINGS: usize = 1 << 16;
/// Lines that hold no sensor data.
const SILENT: [&str; 2] = ["PARAM", "SYNC"];
/// The keywords that are imported.
const IMPORTED: [&str; 6] = ["FLASER", "RLASER", "ROBOTLASER1", "ROBOTLASER2", "ODOM", "TRUEPOS"];

/// Whether a line is a message that is imported: keyword and numbers.
pub(crate) fn is_message(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace();
    words.next().is_some_and(|keyword| IMPORTED.contains(&keyword))
        && words.next().is_some_and(|word| word.parse::<f64>().is_ok())
}

/// One log.
pub(crate) struct Log {
    lines: Lines,
    /// Whether it has `ODOM` lines.
    has_odom: bool,
    /// Whether the poses of its `FLASER` lines differ anywhere.
    is_corrected: bool,
    ready: VecDeque<Record>,
}

impl Log {
    /// Reads the log once to see what it holds; [`Source::next`] reads it again.
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        let mut ahead = Lines::open(path, &Meter::default())?;
        let (mut has_odom, mut is_corrected) = (false, false);
        while let Some(line) = ahead.next()?
            && !(has_odom && is_corrected)
        {
            match message(&line.text) {
                Ok(Message { what: What::Odometry { .. }, .. }) => has_odom = true,
                Ok(Message { what: What::Scan { laser: Some(laser), robot, .. }, .. }) => {
                    is_corrected |= laser != robot;
                }
                _ => {}
            }
        }
        let lines = Lines::open(path, meter)?;
        Ok(Self { lines, has_odom, is_corrected, ready: VecDeque::new() })
    }

    fn take_in(&mut self, Message { stamp_ns, what }: Message) {
        let mut push = |topic, body| self.ready.push_back(Record { topic, stamp_ns, body });
        match what {
            What::Odometry { pose, twist } => {
                push(Topic::Odom, Body::Odometry(pose.in_space(), twist));
            }
            What::True(pose) => push(Topic::GroundTruth, Body::Pose(pose.in_space())),
            What::Scan { scan, rear, laser, robot } => {
                // The poses first: a reader that goes by order has them when the scan comes.
                if !rear && !self.has_odom {
                    push(Topic::Odom, Body::Odometry(robot.in_space(), Twist::default()));
                }
                if let Some(laser) = laser
                    && !rear
                    && self.is_corrected
                {
                    push(Topic::Pose, Body::Pose(laser.in_space()));
                }
                push(if rear { Topic::RearScan } else { Topic::Scan }, Body::Scan(scan));
            }
        }
    }
}

impl Source for Log {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while self.ready.is_empty() {
            let Some(line) = self.lines.next()? else { break };
            match message(&line.text) {
                Ok(message) if representable(message.stamp_ns) => self.take_in(message),
                Ok(_) => losses.dropped.add("lines before 1970 or after 2037", 1),
                Err(Unused::Empty) => {}
                Err(Unused::Other(keyword)) => {
                    losses.remarks.add(format!("{keyword} lines, which are not imported"), 1);
                }
                Err(Unused::Damaged(keyword)) => {
                    losses.dropped.add(format!("{keyword} lines that are cut or damaged"), 1);
                }
            }
        }
        Ok(self.ready.pop_front())
    }
}

/// A line that is understood.
struct Message {
    stamp_ns: i64,
    what: What,
}

enum What {
    Odometry {
        pose: PlanarPose,
        twist: Twist,
    },
    True(PlanarPose),
    Scan {
        scan: Scan,
        rear: bool,
        /// The first pose of `FLASER` and `RLASER`, which may be corrected.
        laser: Option<PlanarPose>,
        robot: PlanarPose,
    },
}

/// A line that gives no message.
enum Unused {
    Empty,
    Other(String),
    Damaged(&'static str),
}

/// A pose in the plane \[m, rad\].
#[derive(Debug, Clone, Copy, PartialEq)]
struct PlanarPose {
    x: f64,
    y: f64,
    theta: f64,
}

impl PlanarPose {
    fn in_space(self) -> Pose {
        Pose { position: [self.x, self.y, 0.0], orientation: from_heading(self.theta) }
    }
}

fn message(line: &str) -> Result<Message, Unused> {
    let mut words = Words(line.split_ascii_whitespace());
    let Some(keyword) = words.0.next() else { return Err(Unused::Empty) };
    if keyword.starts_with('#') {
        return Err(Unused::Empty);
    }
    let Some(known) = IMPORTED.iter().find(|known| **known == keyword) else {
        return Err(other(keyword));
    };
    let message = match keyword {
        "FLASER" => words.old_scan(false),
        "RLASER" => words.old_scan(true),
        "ROBOTLASER1" => words.scan(false),
        "ROBOTLASER2" => words.scan(true),
        "ODOM" => words.odometry(),
        _ => words.true_pose(),
    };
    message.ok_or(Unused::Damaged(known))
}

/// A keyword of another line, or what stands in its place.
fn other(word: &str) -> Unused {
    let is_keyword =
        word.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_');
    match is_keyword && word.len() <= 32 {
        true if SILENT.contains(&word) => Unused::Other(format!("{word} (no sensor data)")),
        true => Unused::Other(word.to_owned()),
        false => Unused::Damaged("unknown"),
    }
}

/// The words of a line after its keyword. Each method takes what it reads, none where that is cut
/// or no finite number.
struct Words<'a>(SplitAsciiWhitespace<'a>);

impl Words<'_> {
    fn old_scan(&mut self, rear: bool) -> Option<Message> {
        let ranges = self.counted()?;
        let (angle_min, angle_increment) = angles_of(ranges.len());
        let (laser, robot) = (self.pose()?, self.pose()?);
        let stamp_ns = self.time()?;
        let scan = Scan { angle_min, angle_increment, range_max: SICK_RANGE_MAX_M, ranges };
        Some(Message { stamp_ns, what: What::Scan { scan, rear, laser: Some(laser), robot } })
    }

    fn scan(&mut self, rear: bool) -> Option<Message> {
        let [_type, angle_min, _fov, angle_increment, range_max, _accuracy, _remission_mode] =
            self.numbers()?;
        let ranges = self.counted()?;
        let _remissions = self.counted()?;
        let (_laser, robot) = (self.pose()?, self.pose()?);
        let [_tv, _rv, _forward, _side, _turn_axis] = self.numbers()?;
        let stamp_ns = self.time()?;
        let scan = Scan { angle_min, angle_increment, range_max: range_max as f32, ranges };
        Some(Message { stamp_ns, what: What::Scan { scan, rear, laser: None, robot } })
    }

    fn odometry(&mut self) -> Option<Message> {
        let pose = self.pose()?;
        let [forward, turn, _acceleration] = self.numbers()?;
        let twist = Twist { forward, turn };
        Some(Message { stamp_ns: self.time()?, what: What::Odometry { pose, twist } })
    }

    fn true_pose(&mut self) -> Option<Message> {
        let (pose, _odometry) = (self.pose()?, self.pose()?);
        Some(Message { stamp_ns: self.time()?, what: What::True(pose) })
    }

    /// How many there are, and they.
    fn counted(&mut self) -> Option<Vec<f32>> {
        let n: usize = self.0.next()?.parse().ok()?;
        if MAX_READINGS < n {
            return None;
        }
        (0..n).map(|_| self.0.next()?.parse().ok()).collect()
    }

    fn pose(&mut self) -> Option<PlanarPose> {
        let [x, y, theta] = self.numbers()?;
        Some(PlanarPose { x, y, theta })
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0_f64; N];
        for number in &mut numbers {
            *number = self.0.next()?.parse().ok()?;
        }
        numbers.iter().all(|number| number.is_finite()).then_some(numbers)
    }

    /// Seconds, with host and logger time behind them: without those the line may have been cut
    /// within the number.
    fn time(&mut self) -> Option<i64> {
        let stamp_ns = seconds_ns(self.0.next()?)?;
        self.0.next()?;
        Some(stamp_ns)
    }
}

/// Angle of the first reading, and from one to the next \[rad\], of a scan that does not say
/// (`readlog.c`, `carmen_laser_guess_angle_increment`): SICK scanners see 180 deg in steps of 1 or
/// 0.5 deg, from -90 deg on; where the number is even the last reading, at +90 deg, was left out.
/// Those in steps of 0.25 deg see 100 deg; where CARMEN has them begin at -90 deg all the same,
/// they begin at -50 deg here.
fn angles_of(n_readings: usize) -> (f64, f64) {
    match n_readings {
        180 | 181 => (-FRAC_PI_2, PI / 180.0),
        360 | 361 => (-FRAC_PI_2, PI / 360.0),
        400 | 401 => (-PI / 3.6, PI / 720.0),
        n => (-FRAC_PI_2, PI / n.saturating_sub(1).max(1) as f64),
    }
}

/// Seconds in decimals, exactly; digits beyond the ninth are left out \[ns\].
fn seconds_ns(text: &str) -> Option<i64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if !fraction.bytes().all(|b| b.is_ascii_digit()) || whole.starts_with(['-', '+']) {
        return None;
    }
    let seconds: i64 = whole.parse().ok()?;
    let ns = fraction.bytes().chain(std::iter::repeat(b'0')).take(9);
    let ns = ns.fold(0, |ns, digit| ns * 10 + i64::from(digit - b'0'));
    seconds.checked_mul(1_000_000_000)?.checked_add(ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_read_exactly() {
        assert_eq!(seconds_ns("976052857.245617"), Some(976_052_857_245_617_000));
        assert_eq!(seconds_ns("1.0000000019"), Some(1_000_000_001));
        assert_eq!(seconds_ns("12"), Some(12_000_000_000));
        assert_eq!(seconds_ns("-1.5"), None);
        assert_eq!(seconds_ns("1e9"), None);
        assert_eq!(seconds_ns("."), None);
        assert_eq!(seconds_ns("99999999999999999999"), None);
    }

    #[test]
    fn scans_that_do_not_say_see_half_a_circle() {
        let degrees = |n| {
            let (first, step) = angles_of(n);
            let last = first + step * (n - 1) as f64;
            [first, step, last].map(|angle| (angle.to_degrees() * 1e6).round() / 1e6)
        };
        assert_eq!(degrees(180), [-90.0, 1.0, 89.0]);
        assert_eq!(degrees(181), [-90.0, 1.0, 90.0]);
        assert_eq!(degrees(360), [-90.0, 0.5, 89.5]);
        assert_eq!(degrees(361), [-90.0, 0.5, 90.0]);
        assert_eq!(degrees(401), [-50.0, 0.25, 50.0]);
        assert_eq!(degrees(91), [-90.0, 2.0, 90.0]);
        angles_of(0);
        angles_of(1);
    }

    #[test]
    fn a_line_is_a_message_with_keyword_and_number() {
        assert!(is_message("ODOM 0.0 0.0"));
        assert!(!is_message("ODOM"));
        assert!(!is_message("ODOMETRY 1"));
        assert!(!is_message("# FLASER num_readings [range_readings] x y theta"));
        assert!(!is_message("PARAM robot_length 0.5"));
    }
}
