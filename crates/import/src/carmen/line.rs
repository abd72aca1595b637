//! Parses the lines of a CARMEN log.

use std::f64::consts::{FRAC_PI_2, PI};
use std::str::SplitAsciiWhitespace;

use dataset::LossKind;
use nalgebra::{Isometry3, Translation3};

use crate::axes::from_heading;
use crate::record::{Scan, Twist};

/// The maximum range of a `FLASER` scan \[m\]. CARMEN uses the same value (`readlog.c`,
/// `config.maximum_range`). A SICK LMS reports 81.83 m or more if there is no return.
const SICK_RANGE_MAX_M: f32 = 80.0;
/// A larger number of readings is treated as damage. No scanner has as many.
const MAX_READINGS: usize = 1 << 16;
/// Keywords of lines without sensor data.
const WITHOUT_SENSOR_DATA: [&str; 2] = ["PARAM", "SYNC"];
/// The keywords that are imported.
const IMPORTED: [&str; 8] =
    ["FLASER", "RLASER", "ROBOTLASER1", "ROBOTLASER2", "RAWLASER1", "RAWLASER2", "ODOM", "TRUEPOS"];

/// Whether a line is a message that can be imported: one of the keywords, followed by a number.
pub(crate) fn is_message(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace();
    words.next().is_some_and(|keyword| IMPORTED.contains(&keyword))
        && words.next().is_some_and(|word| word.parse::<f64>().is_ok())
}

/// A parsed line.
pub(super) struct Message {
    /// The time of the line \[ns\]. It can be negative, or later than a ROS message can contain.
    pub stamp_ns: i64,
    pub content: Content,
}

pub(super) enum Content {
    Odometry {
        pose: PlanarPose,
        twist: Twist,
    },
    GroundTruth(PlanarPose),
    Scan {
        scan: Scan,
        rear: bool,
        /// The first pose of a `FLASER` or `RLASER` line. It may be a corrected pose.
        laser: Option<PlanarPose>,
        /// The pose of the robot. `RAWLASER` lines have none.
        robot: Option<PlanarPose>,
    },
}

/// Why a line gives no message.
pub(super) enum NoMessage {
    /// The line is empty or a comment.
    Empty,
    Loss(LossKind),
}

/// A pose in the plane \[m, rad\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlanarPose {
    pub x: f64,
    pub y: f64,
    pub theta: f64,
}

impl PlanarPose {
    pub fn to_3d(self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::new(self.x, self.y, 0.0), from_heading(self.theta))
    }
}

/// Parses a line.
pub(super) fn message(line: &str) -> Result<Message, NoMessage> {
    let mut words = Words(line.split_ascii_whitespace());
    let Some(keyword) = words.0.next() else { return Err(NoMessage::Empty) };
    if keyword.starts_with('#') {
        return Err(NoMessage::Empty);
    }
    let Some(known) = IMPORTED.iter().find(|known| **known == keyword) else {
        return Err(NoMessage::Loss(unknown_keyword(keyword)));
    };
    let message = match keyword {
        "FLASER" => words.old_scan(false),
        "RLASER" => words.old_scan(true),
        "ROBOTLASER1" => words.scan(false),
        "ROBOTLASER2" => words.scan(true),
        "RAWLASER1" => words.raw_scan(false),
        "RAWLASER2" => words.raw_scan(true),
        "ODOM" => words.odometry(),
        _ => words.true_pose(),
    };
    let malformed = || LossKind::MalformedLines { keyword: (*known).to_owned() };
    message.ok_or_else(|| NoMessage::Loss(malformed()))
}

/// The loss for a line that starts with `word`, which is not one of the imported keywords.
fn unknown_keyword(word: &str) -> LossKind {
    let is_keyword =
        word.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_');
    let keyword = word.to_owned();
    match is_keyword && word.len() <= 32 {
        true if WITHOUT_SENSOR_DATA.contains(&word) => LossKind::LinesWithoutSensorData { keyword },
        true => LossKind::LinesNotImported { keyword },
        false => LossKind::MalformedLines { keyword: "unknown".to_owned() },
    }
}

/// The words of a line after its keyword. Each method consumes the words that it parses. It returns
/// `None` if a word is missing or is not a finite number.
struct Words<'a>(SplitAsciiWhitespace<'a>);

impl Words<'_> {
    fn old_scan(&mut self, rear: bool) -> Option<Message> {
        let ranges = self.counted()?;
        let (angle_min, angle_increment) = angles_of(ranges.len());
        let (laser, robot) = (self.pose()?, self.pose()?);
        let stamp_ns = self.time()?;
        let scan = Scan { angle_min, angle_increment, range_max: SICK_RANGE_MAX_M, ranges };
        let content = Content::Scan { scan, rear, laser: Some(laser), robot: Some(robot) };
        Some(Message { stamp_ns, content })
    }

    fn scan(&mut self, rear: bool) -> Option<Message> {
        let scan = self.measured()?;
        let (_laser, robot) = (self.pose()?, self.pose()?);
        let [_tv, _rv, _forward, _side, _turn_axis] = self.numbers()?;
        let stamp_ns = self.time()?;
        let content = Content::Scan { scan, rear, laser: None, robot: Some(robot) };
        Some(Message { stamp_ns, content })
    }

    fn raw_scan(&mut self, rear: bool) -> Option<Message> {
        let scan = self.measured()?;
        let stamp_ns = self.time()?;
        Some(Message { stamp_ns, content: Content::Scan { scan, rear, laser: None, robot: None } })
    }

    /// The scanner, its readings and its remissions.
    fn measured(&mut self) -> Option<Scan> {
        let [_type, angle_min, _fov, angle_increment, range_max, _accuracy, _remission_mode] =
            self.numbers()?;
        let ranges = self.counted()?;
        let _remissions = self.counted()?;
        Some(Scan { angle_min, angle_increment, range_max: range_max as f32, ranges })
    }

    fn odometry(&mut self) -> Option<Message> {
        let pose = self.pose()?;
        let [forward, yaw_rate, _acceleration] = self.numbers()?;
        let twist = Twist { forward, yaw_rate };
        Some(Message { stamp_ns: self.time()?, content: Content::Odometry { pose, twist } })
    }

    fn true_pose(&mut self) -> Option<Message> {
        let (pose, _odometry) = (self.pose()?, self.pose()?);
        Some(Message { stamp_ns: self.time()?, content: Content::GroundTruth(pose) })
    }

    /// A count, followed by that many numbers.
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

    /// Seconds, followed by the host. If the host is missing, the line may end within the number.
    fn time(&mut self) -> Option<i64> {
        let stamp_ns = seconds_ns(self.0.next()?)?;
        self.0.next()?;
        Some(stamp_ns)
    }
}

/// The angle of the first reading and the angle between readings \[rad\], for scans that do not
/// contain them (`readlog.c`, `carmen_laser_guess_angle_increment`).
///
/// SICK scanners cover 180 deg in steps of 1 or 0.5 deg, starting at -90 deg. If the number of
/// readings is even, the last reading at +90 deg is missing. Scanners with steps of 0.25 deg cover
/// 100 deg. CARMEN lets them start at -90 deg; here they start at -50 deg.
fn angles_of(n_readings: usize) -> (f64, f64) {
    match n_readings {
        180 | 181 => (-FRAC_PI_2, PI / 180.0),
        360 | 361 => (-FRAC_PI_2, PI / 360.0),
        400 | 401 => (-PI / 3.6, PI / 720.0),
        n => (-FRAC_PI_2, PI / n.saturating_sub(1).max(1) as f64),
    }
}

/// Decimal seconds as exact nanoseconds. Digits after the ninth decimal place are ignored. Seconds in
/// scientific notation are rounded. A time beyond 292 years becomes the earliest or the latest time.
fn seconds_ns(text: &str) -> Option<i64> {
    if text.contains(['e', 'E']) {
        let seconds: f64 = text.parse().ok()?;
        return seconds.is_finite().then_some((seconds * 1e9).round() as i64);
    }
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let is_number = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    if !is_number(whole) || !is_number(fraction) || whole.is_empty() {
        return None;
    }
    let ns = fraction.bytes().chain(std::iter::repeat(b'0')).take(9);
    let ns = ns.fold(0, |ns, digit| ns * 10 + i64::from(digit - b'0'));
    let seconds = whole.parse().unwrap_or(i64::MAX);
    Some(sign * seconds.saturating_mul(1_000_000_000).saturating_add(ns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_parsed_exactly() {
        assert_eq!(seconds_ns("976052857.245617"), Some(976_052_857_245_617_000));
        assert_eq!(seconds_ns("1.0000000019"), Some(1_000_000_001));
        assert_eq!(seconds_ns("12"), Some(12_000_000_000));
        assert_eq!(seconds_ns("-1.5"), Some(-1_500_000_000));
        assert_eq!(seconds_ns("-0.25"), Some(-250_000_000));
        assert_eq!(seconds_ns("1e9"), Some(1_000_000_000_000_000_000));
        assert_eq!(seconds_ns("99999999999999999999"), Some(i64::MAX));
        for text in [".", "", "-", "+1", "1.2.3", "nan", "inf", "1e999", "e"] {
            assert_eq!(seconds_ns(text), None, "{text}");
        }
    }

    #[test]
    fn scans_without_angles_cover_180_deg() {
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
    fn a_message_starts_with_a_keyword_and_a_number() {
        assert!(is_message("ODOM 0.0 0.0"));
        assert!(!is_message("ODOM"));
        assert!(!is_message("ODOMETRY 1"));
        assert!(!is_message("# FLASER num_readings [range_readings] x y theta"));
        assert!(!is_message("PARAM robot_length 0.5"));
    }
}
