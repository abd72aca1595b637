//! The tables of the data set -> messages.

use std::path::Path;

use crate::error::ImportError;
use crate::input::Meter;
use crate::options::Topic;
use crate::record::{Body, Fix, Imu, Losses, Pose, Record, Source, Twist};
use crate::rotation::{
    ENU_FROM_NED, FLU_FROM_FRD, flip, from_heading, from_roll_pitch_heading, multiply,
};

use super::table::{Row, Table};

/// An attitude is taken for a reading of `ms25.csv` up to this age \[ns\]; both come at 47 Hz.
const MAX_ATTITUDE_AGE_NS: i64 = 50_000_000;
/// Headings of the KVH further apart give no rate \[ns\]; they come at 100 Hz.
const MAX_STEP_NS: i64 = 500_000_000;

/// What becomes of one row of numbers.
enum Made {
    Body(Body),
    /// It says that there is nothing, in these words (in the plural).
    Nothing(&'static str),
    NotANumber,
}

/// A table of which every row is a message of its own.
struct Series<const N: usize> {
    table: Table<N>,
    topic: Topic,
    make: fn([f64; N]) -> Made,
}

impl<const N: usize> Source for Series<N> {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(Row { stamp_ns, values }) = self.table.next(losses)? {
            match (self.make)(values) {
                Made::Body(body) => return Ok(Some(Record { topic: self.topic, stamp_ns, body })),
                Made::NotANumber => self.table.not_a_number(losses),
                Made::Nothing(what) => {
                    losses.remarks.add(format!("rows of {} {what}", self.table.name()), 1);
                }
            }
        }
        Ok(None)
    }
}

type Opened = Result<Box<dyn Source>, ImportError>;

fn series<const N: usize>(
    path: &Path,
    columns: &'static str,
    topic: Topic,
    make: fn([f64; N]) -> Made,
    meter: &Meter,
) -> Opened {
    Ok(Box::new(Series { table: Table::open(path, columns, meter)?, topic, make }))
}

/// `odometry_mu.csv`: the integrated odometry, in a frame of its own.
pub(super) fn odometry(path: &Path, meter: &Meter) -> Opened {
    let columns = "utime [us], x, y, z [m], roll, pitch, heading [rad]";
    series(path, columns, Topic::Odom, odometry_of, meter)
}

fn odometry_of(values: [f64; 6]) -> Made {
    if !values.iter().all(|value| value.is_finite()) {
        return Made::NotANumber;
    }
    let [x, y, z, roll, pitch, heading] = values;
    let frd = from_roll_pitch_heading(roll, pitch, heading);
    let pose = Pose {
        position: flip([x, y, z]),
        orientation: multiply(multiply(FLU_FROM_FRD, frd), FLU_FROM_FRD),
    };
    Made::Body(Body::Odometry(pose, Twist::default()))
}

/// `groundtruth_DATE.csv`: the body's pose in the map, north-east-down turned to east-north-up.
pub(super) fn ground_truth(path: &Path, meter: &Meter) -> Opened {
    let columns = "utime [us], x, y, z [m], roll, pitch, heading [rad]";
    series(path, columns, Topic::GroundTruth, ground_truth_of, meter)
}

fn ground_truth_of(values: [f64; 6]) -> Made {
    if !values.iter().all(|value| value.is_finite()) {
        return Made::NotANumber;
    }
    let [north, east, down, roll, pitch, heading] = values;
    let position = [east, north, -down];
    Made::Body(Body::Pose(Pose { position, orientation: enu(roll, pitch, heading) }))
}

/// Attitude of a forward-left-up body in east-north-up axes, from that of a forward-right-down one
/// in north-east-down axes.
fn enu(roll: f64, pitch: f64, heading: f64) -> [f64; 4] {
    let ned = from_roll_pitch_heading(roll, pitch, heading);
    multiply(multiply(ENU_FROM_NED, ned), FLU_FROM_FRD)
}

/// `wheels.csv`: speeds of the wheels over ground.
pub(super) fn wheels(path: &Path, meter: &Meter) -> Opened {
    series(path, "utime [us], left, right [m/s]", Topic::Wheels, wheels_of, meter)
}

fn wheels_of([left, right]: [f64; 2]) -> Made {
    match left.is_finite() && right.is_finite() {
        true => Made::Body(Body::Wheels { left, right }),
        false => Made::NotANumber,
    }
}

/// `gps.csv` and `gps_rtk.csv`. Mode 0 and 1 are no fix, 2 has no altitude (gpsd's numbers).
pub(super) fn gps(path: &Path, topic: Topic, meter: &Meter) -> Opened {
    let columns = "utime [us], mode, satellites, latitude, longitude [rad], altitude [m], ...";
    series(path, columns, topic, gps_of, meter)
}

fn gps_of([mode, _, latitude, longitude, altitude]: [f64; 5]) -> Made {
    if mode < 2.0 {
        return Made::Nothing("without a fix");
    }
    let fix = Fix {
        latitude: latitude.to_degrees(),
        longitude: longitude.to_degrees(),
        altitude: if altitude.is_finite() { altitude } else { f64::NAN },
    };
    match fix.latitude.is_finite() && fix.longitude.is_finite() {
        true => Made::Body(Body::Fix(fix)),
        false => Made::NotANumber,
    }
}

/// `ms25.csv`, with the attitude of `ms25_euler.csv` where there is one of that time.
pub(super) struct Ms25 {
    readings: Table<9>,
    attitudes: Option<Table<3>>,
    /// The latest attitude that is not after the reading, and the one after it.
    held: Option<Row<3>>,
    ahead: Option<Row<3>>,
}

impl Ms25 {
    pub fn open(path: &Path, euler: Option<&Path>, meter: &Meter) -> Result<Self, ImportError> {
        let columns = "utime [us], magnetic field x, y, z, acceleration x, y, z [m/s^2], rates \
                       about x, y, z [rad/s]";
        let attitude_columns = "utime [us], roll, pitch, heading [rad]";
        let readings = Table::open(path, columns, meter)?;
        let attitudes = euler.map(|path| Table::open(path, attitude_columns, meter)).transpose()?;
        Ok(Self { readings, attitudes, held: None, ahead: None })
    }

    fn attitude_at(
        &mut self,
        stamp_ns: i64,
        losses: &mut Losses,
    ) -> Result<Option<[f64; 4]>, ImportError> {
        let Some(attitudes) = &mut self.attitudes else { return Ok(None) };
        loop {
            if self.ahead.is_none() {
                self.ahead = attitudes.next(losses)?;
            }
            match self.ahead.take_if(|ahead| ahead.stamp_ns <= stamp_ns) {
                Some(row) if row.values.iter().all(|value| value.is_finite()) => {
                    self.held = Some(row);
                }
                Some(_) => attitudes.not_a_number(losses),
                None => break,
            }
        }
        let held = self.held.filter(|held| stamp_ns - held.stamp_ns <= MAX_ATTITUDE_AGE_NS);
        Ok(held.map(|Row { values: [roll, pitch, heading], .. }| enu(roll, pitch, heading)))
    }
}

impl Source for Ms25 {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(Row { stamp_ns, values }) = self.readings.next(losses)? {
            let [_, _, _, ax, ay, az, rx, ry, rz] = values;
            if ![ax, ay, az, rx, ry, rz].iter().all(|value| value.is_finite()) {
                self.readings.not_a_number(losses);
                continue;
            }
            let imu = Imu {
                orientation: self.attitude_at(stamp_ns, losses)?,
                angular_velocity: flip([rx, ry, rz]),
                linear_acceleration: Some(flip([ax, ay, az])),
            };
            return Ok(Some(Record { topic: Topic::Imu, stamp_ns, body: Body::Imu(imu) }));
        }
        Ok(None)
    }
}

/// `kvh.csv`: the heading that the fibre-optic gyro's rates add up to, from an arbitrary zero.
///
/// The orientation is that heading alone, the angular velocity about z its change since the row
/// before; the first row, and one after a pause, has no rate and gives no message.
pub(super) struct Kvh {
    table: Table<1>,
    before: Option<Row<1>>,
}

impl Kvh {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        Ok(Self { table: Table::open(path, "utime [us], heading [rad]", meter)?, before: None })
    }
}

impl Source for Kvh {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(row) = self.table.next(losses)? {
            if !row.values[0].is_finite() {
                self.table.not_a_number(losses);
                continue;
            }
            let before = self.before.replace(row);
            let step = before.map(|before| {
                (
                    row.stamp_ns - before.stamp_ns,
                    dataset::wrap_angle(row.values[0] - before.values[0]),
                )
            });
            let Some((step_ns, turned)) =
                step.filter(|(step_ns, _)| (1..=MAX_STEP_NS).contains(step_ns))
            else {
                let reason = format!("rows of {} without one shortly before", self.table.name());
                losses.remarks.add(reason, 1);
                continue;
            };
            // The heading turns clockwise seen from above, about z down.
            let imu = Imu {
                orientation: Some(from_heading(-row.values[0])),
                angular_velocity: [0.0, 0.0, -turned / (step_ns as f64 * 1e-9)],
                linear_acceleration: None,
            };
            let body = Body::Imu(imu);
            return Ok(Some(Record { topic: Topic::Kvh, stamp_ns: row.stamp_ns, body }));
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(made: &Made) -> Pose {
        match made {
            Made::Body(Body::Pose(pose) | Body::Odometry(pose, _)) => *pose,
            _ => panic!(),
        }
    }

    /// 3 m north, 2 m east, 1 m up, facing east: from north-east-down to east-north-up, where east
    /// is heading 0.
    #[test]
    fn ground_truth_is_turned_to_east_north_up() {
        let facing_east = std::f64::consts::FRAC_PI_2;
        let pose = pose(&ground_truth_of([3.0, 2.0, -1.0, 0.0, 0.0, facing_east]));
        assert_eq!(pose.position, [2.0, 3.0, 1.0]);
        let [x, y, z, w] = pose.orientation;
        assert!(x.abs() < 1e-12 && y.abs() < 1e-12 && z.abs() < 1e-12, "{:?}", pose.orientation);
        assert!((w.abs() - 1.0).abs() < 1e-12);
    }

    /// A drive ahead and to the right, facing right.
    #[test]
    fn odometry_to_the_right_is_to_the_negative_left() {
        let pose = pose(&odometry_of([5.0, 2.0, 0.0, 0.0, 0.0, 0.2]));
        assert_eq!(pose.position, [5.0, -2.0, 0.0]);
        let expected = from_heading(-0.2);
        for (a, b) in pose.orientation.iter().zip(expected) {
            assert!((a.abs() - b.abs()).abs() < 1e-12, "{:?} {expected:?}", pose.orientation);
        }
    }

    #[test]
    fn rows_without_numbers_or_a_fix_give_nothing() {
        assert!(matches!(ground_truth_of([f64::NAN; 6]), Made::NotANumber));
        assert!(matches!(wheels_of([0.1, f64::INFINITY]), Made::NotANumber));
        assert!(matches!(gps_of([1.0, 0.0, 0.7, -1.4, 270.0]), Made::Nothing(_)));
        assert!(matches!(gps_of([2.0, 5.0, f64::NAN, -1.4, 270.0]), Made::NotANumber));
    }
}
