//! Reads a trajectory from a text file, which other programs for localisation and mapping write.
//!
//! | columns | format |
//! |---|---|
//! | 8 | TUM: stamp, x, y, z, qx, qy, qz, qw (TUM RGB-D benchmark, "File Formats") |
//! | 29 | TUM, and the upper triangle of the (6, 6) covariance of x, y, z and the rotations about x, y, z |
//! | 44 | TUM, and the whole covariance, row by row |
//! | 13 | KITTI with stamps: stamp, and the 12 numbers of the matrix \[R t\], row by row (KITTI odometry benchmark) |
//!
//! Columns are separated by spaces, tabs or commas. Lines that start with `#` are comments. The poses are
//! those of the robot, with x forward and z up.

use std::path::Path;

use dataset::{LossKind, Losses, Pose2, StampedPose};

use crate::pose::message::{check_position, planar_covariance, unit_quaternion, yaw_rad};
use crate::time_unit::TimeUnit;

/// Why a trajectory file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PoseFileError {
    /// The file cannot be read.
    #[error("cannot read the file of `ingest.pose.file`")]
    Read(#[source] std::io::Error),
    /// The file has no poses.
    #[error("the file has no line with a pose")]
    Empty,
    /// A line has another number of columns than a known format, or than the first line.
    #[error("line {line} has {found} columns, expected {expected}")]
    Columns {
        /// Counted from 1.
        line: usize,
        /// The number of columns.
        found: usize,
        /// The numbers of columns that can be read, and what to do.
        expected: String,
    },
    /// A column is not a number.
    #[error("line {line}, column {column}: `{found}` is not a number")]
    NotANumber {
        /// Counted from 1.
        line: usize,
        /// Counted from 1.
        column: usize,
        /// The text.
        found: String,
    },
    /// The stamps do not increase.
    #[error(
        "line {line}: stamp {stamp_s:.6} s is before the stamp of the previous pose, {previous_s:.6} s; sort the file by stamp"
    )]
    Unordered {
        /// Counted from 1.
        line: usize,
        /// \[s\]
        stamp_s: f64,
        /// \[s\]
        previous_s: f64,
    },
    /// The stamps are too large for seconds.
    #[error(
        "line {line}: stamp {found} is not a time in {unit}{}",
        likely.map_or(String::new(), |likely| format!("; it seems to be in {0}: set `ingest.pose.file_time_unit = \"{0}\"`", likely.name()))
    )]
    TimeUnit {
        /// Counted from 1.
        line: usize,
        /// The stamp.
        found: String,
        /// The unit of the options.
        unit: &'static str,
        /// The unit in which the stamp is a time of this century.
        likely: Option<TimeUnit>,
    },
    /// A matrix is not a rotation.
    #[error(
        "line {line}: the matrix is not a rotation, expected r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"
    )]
    NotARotation {
        /// Counted from 1.
        line: usize,
    },
    /// The robot does not stand upright.
    #[error(
        "in {n_tilted} of {n_poses} poses, the z axis of the robot is tilted by more than 45 deg; {likely}"
    )]
    Tilted {
        /// Number of tilted poses.
        n_tilted: usize,
        /// Number of poses.
        n_poses: usize,
        /// The likely cause, and what to do.
        likely: &'static str,
    },
    /// The file and the scans have no time in common.
    #[error(
        "its poses are from {first_s:.3} to {last_s:.3} s, but the scans are from {first_scan_s:.3} to {last_scan_s:.3} s; {likely}"
    )]
    NoOverlap {
        /// \[s\]
        first_s: f64,
        /// \[s\]
        last_s: f64,
        /// \[s\]
        first_scan_s: f64,
        /// \[s\]
        last_scan_s: f64,
        /// The likely cause, and what to do.
        likely: String,
    },
}

/// The most poses with a tilted z axis, as a share. Robots on wheels do not tilt by 45 deg. A quaternion
/// in another order, or camera axes, tilts most poses.
const MAX_TILTED_SHARE: f64 = 0.1;
/// Cosine of the largest tilt, 45 deg.
const MIN_UPRIGHT: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Largest accepted entry of `R^T R - I`. Files have three decimals or more.
const MAX_ROTATION_ERROR: f64 = 0.02;
const EXPECTED_COLUMNS: &str = "8 (TUM: stamp x y z qx qy qz qw), 29 or 44 (TUM with covariance) or 13 (stamp and a KITTI matrix)";
const KITTI_WITHOUT_STAMPS: &str = "13: a KITTI matrix needs a stamp in front, for example with \
                                    `paste -d ' ' times.txt poses.txt`";

/// Reads the poses of a file, in order of time. Rows that cannot be used are counted in `losses`.
pub(crate) fn read(
    path: &Path,
    unit: TimeUnit,
    losses: &mut Losses,
) -> Result<Vec<StampedPose>, PoseFileError> {
    let text = std::fs::read(path).map_err(PoseFileError::Read)?;
    parse(&String::from_utf8_lossy(&text), unit, losses)
}

fn parse(
    text: &str,
    unit: TimeUnit,
    losses: &mut Losses,
) -> Result<Vec<StampedPose>, PoseFileError> {
    let mut poses: Vec<StampedPose> = Vec::new();
    let mut tilts = Tilts::default();
    let mut n_columns = None;
    for (line, row) in text.lines().enumerate().map(|(k, row)| (k + 1, row.trim())) {
        if row.is_empty() || row.starts_with(['#', '%']) {
            continue;
        }
        let words: Vec<&str> =
            row.split([' ', '\t', ',']).filter(|word| !word.is_empty()).collect();
        let layout = Layout::of(words.len(), line, &mut n_columns)?;
        let numbers = numbers(&words, line)?;
        let stamp_ns = stamp_ns(words[0], unit, line)?;
        if !numbers.iter().all(|number| number.is_finite()) {
            losses.add(LossKind::RowsWithNan, 1);
            continue;
        }
        let rotation = match layout.rotation(&numbers, line)? {
            Ok(rotation) => rotation,
            Err(kind) => {
                losses.add(kind, 1);
                continue;
            }
        };
        if let Some(previous) = poses.last()
            && stamp_ns < previous.stamp_ns
        {
            let [stamp_s, previous_s] = [stamp_ns, previous.stamp_ns].map(|ns| ns as f64 * 1e-9);
            return Err(PoseFileError::Unordered { line, stamp_s, previous_s });
        }
        let position = layout.position(&numbers);
        if let Err(kind) = check_position(&position) {
            losses.add(kind, 1);
            continue;
        }
        tilts.add(&rotation);
        let [x_m, y_m, z_m] = position;
        let pose = Pose2 { x_m, y_m, heading_rad: rotation.heading_rad };
        poses.push(StampedPose {
            covariance: layout.covariance(&numbers),
            z_m: Some(z_m),
            ..StampedPose::new(stamp_ns, pose)
        });
    }
    if poses.is_empty() && losses.is_empty() {
        return Err(PoseFileError::Empty);
    }
    tilts.check()?;
    Ok(poses)
}

/// What the columns contain.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Layout {
    Tum,
    TumUpper,
    TumFull,
    Kitti,
}

impl Layout {
    /// The layout of a line. All lines must have the number of columns of the first line.
    fn of(found: usize, line: usize, n_columns: &mut Option<usize>) -> Result<Self, PoseFileError> {
        let first = *n_columns.get_or_insert(found);
        let expected = match (found, first) {
            (found, first) if found != first => format!("{first} as in the lines before"),
            (8, _) => return Ok(Self::Tum),
            (29, _) => return Ok(Self::TumUpper),
            (44, _) => return Ok(Self::TumFull),
            (13, _) => return Ok(Self::Kitti),
            (12, _) => KITTI_WITHOUT_STAMPS.to_owned(),
            _ => EXPECTED_COLUMNS.to_owned(),
        };
        Err(PoseFileError::Columns { line, found, expected })
    }

    fn position(self, numbers: &[f64]) -> [f64; 3] {
        match self {
            Self::Kitti => [numbers[4], numbers[8], numbers[12]],
            _ => [numbers[1], numbers[2], numbers[3]],
        }
    }

    /// The rotation of a line. The inner error is a line that is left out.
    fn rotation(
        self,
        numbers: &[f64],
        line: usize,
    ) -> Result<Result<Rotation, LossKind>, PoseFileError> {
        if self == Self::Kitti {
            let m = |row: usize, column: usize| numbers[1 + 4 * row + column];
            return match is_rotation(m) {
                true => Ok(Ok(Rotation {
                    heading_rad: libm::atan2(m(1, 0), m(0, 0)),
                    up: [m(1, 1), m(2, 2)],
                    up_if_wxyz: None,
                })),
                false => Err(PoseFileError::NotARotation { line }),
            };
        }
        let q = [numbers[4], numbers[5], numbers[6], numbers[7]];
        Ok(unit_quaternion(q).map(|q @ [a, b, c, d]| Rotation {
            heading_rad: yaw_rad(q),
            up: diagonal(q),
            up_if_wxyz: Some(diagonal([b, c, d, a])[1]),
        }))
    }

    /// The covariance of x, y and heading.
    fn covariance(self, numbers: &[f64]) -> Option<[f64; 6]> {
        let given = numbers.get(8..)?;
        let mut full = [0.0; 36];
        match self {
            Self::TumFull => full.copy_from_slice(given),
            Self::TumUpper => {
                let upper = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
                for ((row, column), &value) in upper.zip(given) {
                    (full[6 * row + column], full[6 * column + row]) = (value, value);
                }
            }
            Self::Tum | Self::Kitti => return None,
        }
        planar_covariance(&full)
    }
}

/// What is needed of a rotation.
struct Rotation {
    heading_rad: f64,
    /// Entries (2, 2) and (3, 3) of the matrix: 1 if the y axis, or the z axis, has the direction of that
    /// axis of the map.
    up: [f64; 2],
    /// Entry (3, 3) if the numbers were a quaternion in the order w, x, y, z.
    up_if_wxyz: Option<f64>,
}

/// Entries (2, 2) and (3, 3) of the matrix of a unit quaternion.
fn diagonal([x, y, z, _w]: [f64; 4]) -> [f64; 2] {
    [1.0 - 2.0 * (x * x + z * z), 1.0 - 2.0 * (x * x + y * y)]
}

/// Whether the columns of a matrix have length 1, are orthogonal, and are a right-handed system.
fn is_rotation(m: impl Fn(usize, usize) -> f64) -> bool {
    let dot = |a: usize, b: usize| (0..3).map(|row| m(row, a) * m(row, b)).sum::<f64>();
    let is_orthonormal = (0..3).all(|a| {
        (a..3).all(|b| (dot(a, b) - f64::from(u8::from(a == b))).abs() <= MAX_ROTATION_ERROR)
    });
    let cross = m(1, 0) * m(2, 1) - m(2, 0) * m(1, 1);
    is_orthonormal
        && 0.0
            < cross * m(0, 2)
                + (m(2, 0) * m(0, 1) - m(0, 0) * m(2, 1)) * m(1, 2)
                + (m(0, 0) * m(1, 1) - m(1, 0) * m(0, 1)) * m(2, 2)
}

/// How many poses are upright.
#[derive(Debug, Default)]
struct Tilts {
    n: usize,
    n_tilted: usize,
    n_upside_down: usize,
    n_tilted_if_wxyz: usize,
    has_quaternions: bool,
    /// Poses whose y axis keeps its direction, as the vertical axis of a camera does.
    n_along_y: usize,
}

impl Tilts {
    fn add(&mut self, rotation: &Rotation) {
        let [along_y, up] = rotation.up;
        self.n += 1;
        self.n_tilted += usize::from(up < MIN_UPRIGHT);
        self.n_upside_down += usize::from(up < -MIN_UPRIGHT);
        self.n_along_y += usize::from(MIN_UPRIGHT < along_y);
        self.has_quaternions |= rotation.up_if_wxyz.is_some();
        self.n_tilted_if_wxyz +=
            usize::from(rotation.up_if_wxyz.is_some_and(|up| up < MIN_UPRIGHT));
    }

    fn check(&self) -> Result<(), PoseFileError> {
        let is_many = |n: usize| MAX_TILTED_SHARE * (self.n as f64) < n as f64;
        if !is_many(self.n_tilted) {
            return Ok(());
        }
        let likely = if self.has_quaternions && !is_many(self.n_tilted_if_wxyz) {
            "the quaternions seem to have the order w x y z, expected x y z w: exchange the columns"
        } else if !is_many(self.n - self.n_along_y) {
            "the poses seem to have camera axes (x right, y down, z forward), expected x forward and z up: rotate them"
        } else if !is_many(self.n - self.n_upside_down) {
            "the poses are upside down, expected the pose of the robot with z up"
        } else {
            "expected the pose of a robot with x forward and z up, and quaternions in the order x y z w"
        };
        Err(PoseFileError::Tilted { n_tilted: self.n_tilted, n_poses: self.n, likely })
    }
}

fn numbers(words: &[&str], line: usize) -> Result<Vec<f64>, PoseFileError> {
    let parse = |(k, word): (usize, &&str)| {
        let found = || word.chars().take(40).collect();
        word.parse().map_err(|_| PoseFileError::NotANumber { line, column: k + 1, found: found() })
    };
    words.iter().enumerate().map(parse).collect()
}

/// The stamp of a line \[ns\].
fn stamp_ns(word: &str, unit: TimeUnit, line: usize) -> Result<i64, PoseFileError> {
    let decimal = Decimal::parse(word);
    let not_a_time = || PoseFileError::TimeUnit {
        line,
        found: word.to_owned(),
        unit: unit.name(),
        likely: decimal.and_then(Decimal::likely_unit),
    };
    let ns = decimal.and_then(|decimal| decimal.to_integer(unit.decimals_of_ns()));
    let ns = ns.and_then(|ns| i64::try_from(ns).ok()).ok_or_else(not_a_time)?;
    // The largest time of a ROS message: seconds are a signed 32-bit number.
    match (0..=i64::from(i32::MAX) * 1_000_000_000).contains(&ns) {
        true => Ok(ns),
        false => Err(not_a_time()),
    }
}

/// A decimal number, exactly: `digits * 10^exponent`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Decimal {
    digits: i128,
    exponent: i32,
}

impl Decimal {
    fn parse(text: &str) -> Option<Self> {
        let (mantissa, exponent) = match text.split_once(['e', 'E']) {
            Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
            None => (text, 0),
        };
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let digits = format!("{whole}{fraction}").parse().ok()?;
        let exponent = exponent.checked_sub(i32::try_from(fraction.len()).ok()?)?;
        Some(Self { digits, exponent })
    }

    /// The number times `10^decimals`, rounded toward zero. `None` if it is too large.
    fn to_integer(self, decimals: i32) -> Option<i128> {
        let exponent = self.exponent.checked_add(decimals)?;
        let power = |n: u32| 10i128.checked_pow(n);
        match u32::try_from(exponent) {
            Ok(n) if self.digits != 0 => self.digits.checked_mul(power(n)?),
            Ok(_) => Some(0),
            Err(_) => Some(power(exponent.unsigned_abs()).map_or(0, |power| self.digits / power)),
        }
    }

    /// The unit in which the number is a time between 2001 and 2037.
    fn likely_unit(self) -> Option<TimeUnit> {
        let is_recent = |unit: &TimeUnit| {
            let s = self.to_integer(unit.decimals_of_ns() - 9);
            s.is_some_and(|s| (1_000_000_000..i128::from(i32::MAX)).contains(&s))
        };
        TimeUnit::ALL.into_iter().find(is_recent)
    }
}

/// Checks that the poses and the scans have times in common \[ns\]. `None` means that there are none.
pub(crate) fn check_overlap(
    poses: Option<(i64, i64)>,
    scans: Option<(i64, i64)>,
    unit: TimeUnit,
) -> Result<(), PoseFileError> {
    let (Some((first, last)), Some((first_scan, last_scan))) = (poses, scans) else {
        return Ok(());
    };
    let overlaps =
        |first: i128, last: i128| first <= i128::from(last_scan) && i128::from(first_scan) <= last;
    if overlaps(first.into(), last.into()) {
        return Ok(());
    }
    let in_unit = |other: &TimeUnit| {
        let change = other.decimals_of_ns() - unit.decimals_of_ns();
        let convert = |ns: i64| Decimal { digits: ns.into(), exponent: 0 }.to_integer(change);
        convert(first).zip(convert(last)).is_some_and(|(first, last)| overlaps(first, last))
    };
    const SECOND_NS: i64 = 1_000_000_000;
    /// A clock that counts from its start shows less than this \[ns\]: a day.
    const DAY_NS: i64 = 86_400 * SECOND_NS;
    let likely = if let Some(likely) = TimeUnit::ALL.into_iter().find(in_unit) {
        let name = likely.name();
        format!("the stamps seem to be in {name}: set `ingest.pose.file_time_unit = \"{name}\"`")
    } else if first < DAY_NS && DAY_NS < first_scan {
        "the stamps of the file count from the start of the recording, expected the clock of the log: \
         add the time of the start"
            .to_owned()
    } else {
        "check that the file belongs to this log and that both use one clock".to_owned()
    };
    let [first_s, last_s, first_scan_s, last_scan_s] =
        [first, last, first_scan, last_scan].map(|ns| ns as f64 * 1e-9);
    Err(PoseFileError::NoOverlap { first_s, last_s, first_scan_s, last_scan_s, likely })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<StampedPose>, String> {
        read_in(text, TimeUnit::S)
    }

    fn read_in(text: &str, unit: TimeUnit) -> Result<Vec<StampedPose>, String> {
        parse(text, unit, &mut Losses::default()).map_err(|error| error.to_string())
    }

    /// A heading of 90 deg: the quaternion (0, 0, sin 45 deg, cos 45 deg).
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

    fn check(pose: &StampedPose, stamp_ns: i64, [x, y, z, heading]: [f64; 4]) {
        assert_eq!(
            (pose.stamp_ns, pose.pose.x_m, pose.pose.y_m, pose.z_m),
            (stamp_ns, x, y, Some(z))
        );
        assert!((pose.pose.heading_rad - heading).abs() < 1e-9, "{pose:?}");
    }

    #[test]
    fn tum_files_are_read_with_or_without_covariance() {
        let tum = format!("# stamp x y z q\n\n1700000000.123456789 1 2 0.5 0 0 {HALF} {HALF}\n");
        let quarter = std::f64::consts::FRAC_PI_2;
        let poses = read(&tum).unwrap();
        check(&poses[0], 1_700_000_000_123_456_789, [1.0, 2.0, 0.5, quarter]);
        assert_eq!(poses[0].covariance, None);
        let comma = format!("1.7e9,1,2,0.5,0,0,{HALF},{HALF}\r\n");
        check(&read(&comma).unwrap()[0], 1_700_000_000_000_000_000, [1.0, 2.0, 0.5, quarter]);
        // numpy.savetxt writes this for 1403636579763555584 ns.
        let numpy = "1.403636579763555527e+09 0 0 0 0 0 0 1\n";
        assert_eq!(read(numpy).unwrap()[0].stamp_ns, 1_403_636_579_763_555_527);

        // Entry (i, j) is 10 i + j + 1, and the same for (j, i).
        let entry = |i: usize, j: usize| 10 * i.min(j) + i.max(j) + 1;
        let full: Vec<String> = (0..36).map(|k| entry(k / 6, k % 6).to_string()).collect();
        let upper: Vec<String> =
            (0..6).flat_map(|i| (i..6).map(move |j| entry(i, j).to_string())).collect();
        for covariance in [full, upper] {
            let line = format!("1 0 0 0 0 0 0 1 {}\n", covariance.join(" "));
            // xx, xy, xh, yy, yh, hh.
            let expected = Some([1.0, 2.0, 6.0, 12.0, 16.0, 56.0]);
            assert_eq!(read(&line).unwrap()[0].covariance, expected);
        }
    }

    #[test]
    fn kitti_matrices_with_stamps_are_read() {
        let poses = read("5.5 0 -1 0 7  1 0 0 8  0 0 1 9\n").unwrap();
        check(&poses[0], 5_500_000_000, [7.0, 8.0, 9.0, std::f64::consts::FRAC_PI_2]);
        let error = read("1 0 0 7 0 1 0 8 0 0 1 9\n").unwrap_err();
        assert!(error.contains("line 1 has 12 columns") && error.contains("paste"), "{error}");
        let error = read("5 1 0 0 7 0 2 0 8 0 0 1 9\n").unwrap_err();
        assert!(error.contains("not a rotation"), "{error}");
        let mirrored = read("5 1 0 0 7 0 1 0 8 0 0 -1 9\n").unwrap_err();
        assert!(mirrored.contains("not a rotation"), "{mirrored}");
    }

    #[test]
    fn a_file_that_is_not_a_trajectory_is_an_error_with_the_line() {
        for (text, expected) in [
            ("", "no line with a pose"),
            ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2 has 7 columns, expected 8 as in"),
            ("1 2 3\n", "line 1 has 3 columns, expected 8 (TUM"),
            ("stamp x y z qx qy qz qw\n", "line 1, column 1: `stamp` is not a number"),
            ("2 0 0 0 0 0 0 1\n1.5 0 0 0 0 0 0 1\n", "line 2: stamp 1.500000 s is before"),
            ("-2 0 0 0 0 0 0 1\n", "line 1: stamp -2 is not a time in s"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn rows_that_are_not_poses_are_counted() {
        let mut losses = Losses::default();
        let text = "1 0 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n3 0 0 0 0 0 0 0\n4 0 0 0 0 0 0 1\n";
        assert_eq!(parse(text, TimeUnit::S, &mut losses).unwrap().len(), 2);
        let codes: Vec<_> = losses.iter().map(|(loss, n)| (loss.kind.code(), n)).collect();
        assert_eq!(codes, [("quaternion_not_normalized", 1), ("rows_with_nan", 1)]);
    }

    #[test]
    fn stamps_in_another_unit_are_named() {
        for (stamp, unit) in [
            ("1700000000123", TimeUnit::Ms),
            ("1700000000123456", TimeUnit::Us),
            ("1700000000123456789", TimeUnit::Ns),
        ] {
            let line = format!("{stamp} 0 0 0 0 0 0 1\n");
            let error = read(&line).unwrap_err();
            let remedy = format!("set `ingest.pose.file_time_unit = \"{}\"`", unit.name());
            assert!(error.contains(&remedy), "{error}");
            let stamp_ns = read_in(&line, unit).unwrap()[0].stamp_ns;
            assert_eq!(stamp_ns / 1_000_000, 1_700_000_000_123);
        }
    }

    /// A drive through all headings, with the numbers in other orders and axes.
    #[test]
    fn a_quaternion_in_another_order_and_other_axes_are_named() {
        let drive = |line: fn(f64, f64) -> String| {
            let lines = (0..36).map(|k| {
                let (sin, cos) = (f64::from(k) * 5f64.to_radians()).sin_cos();
                format!("{k} {}\n", line(sin, cos))
            });
            read(&lines.collect::<String>())
        };
        assert_eq!(drive(|s, c| format!("0 0 0 0 0 {s} {c}")).unwrap().len(), 36);
        for (line, expected) in [
            ((|s, c| format!("0 0 0 {c} 0 0 {s}")) as fn(f64, f64) -> String, "order w x y z"),
            (|s, c| format!("0 0 0 0 {s} 0 {c}"), "camera axes"),
            (|s, c| format!("0 0 0 {c} {s} 0 0"), "upside down"),
            (|s, c| format!("0 0 0 {s} 0 0 {c}"), "tilted by more than 45 deg"),
        ] {
            let error = drive(line).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_file_of_another_time_is_an_error_with_the_likely_cause() {
        let s = |first: i64, last: i64| Some((first * 1_000_000_000, last * 1_000_000_000));
        let scans = s(1_700_000_000, 1_700_000_100);
        assert!(check_overlap(s(1_700_000_099, 1_700_000_200), scans, TimeUnit::S).is_ok());
        assert!(check_overlap(None, scans, TimeUnit::S).is_ok());
        let error =
            |poses, scans| check_overlap(poses, scans, TimeUnit::S).unwrap_err().to_string();
        let relative = error(s(0, 100), scans);
        assert!(relative.contains("count from the start of the recording"), "{relative}");
        assert!(relative.contains("from 0.000 to 100.000 s, but the scans"), "{relative}");
        assert!(error(s(1_600_000_000, 1_600_000_100), scans).contains("belongs to this log"));
        // Stamps of 1000 to 90000 ms, read as seconds, of a log from 0 to 100 s.
        let milliseconds = error(s(1000, 90_000), s(0, 100));
        assert!(milliseconds.contains("file_time_unit = \"ms\""), "{milliseconds}");
    }
}
