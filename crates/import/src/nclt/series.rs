//! Converts the tables of the data set to messages.

use std::path::Path;

use dataset::{LossKind, Losses, wrap_angle};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};

use crate::axes::{
    ENU_FROM_NED, FLU_FROM_FRD, flu_from_frd, from_heading, from_roll_pitch_heading,
};
use crate::error::ImportError;
use crate::input::Meter;
use crate::options::Topic;
use crate::record::{Body, Fix, Imu, Record, Source, Twist};

use super::table::{Row, Table};

/// The maximum age of an attitude when it is added to a reading of `ms25.csv` \[ns\]. Both have a
/// rate of 47 Hz.
const MAX_ATTITUDE_AGE_NS: i64 = 50_000_000;
/// The maximum time between two KVH headings that give a yaw rate \[ns\]. They have a rate of 100 Hz.
const MAX_STEP_NS: i64 = 500_000_000;

/// The result of converting a row: a message or a loss.
type Converted = Result<Body, LossKind>;

/// A table in which each row is a message.
struct Series<const N: usize> {
    table: Table<N>,
    topic: Topic,
    convert: fn([f64; N]) -> Converted,
}

impl<const N: usize> Source for Series<N> {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(Row { stamp_ns, values }) = self.table.next(losses)? {
            match (self.convert)(values) {
                Ok(body) => return Ok(Some(Record { topic: self.topic, stamp_ns, body })),
                Err(kind) => losses.add(self.table.loss(kind), 1),
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
    convert: fn([f64; N]) -> Converted,
    meter: &Meter,
) -> Opened {
    Ok(Box::new(Series { table: Table::open(path, columns, meter)?, topic, convert }))
}

/// `odometry_mu_100hz.csv`: the integrated odometry, in its own frame.
pub(super) fn odometry(path: &Path, meter: &Meter) -> Opened {
    let columns = "utime [us], x, y, z [m], roll, pitch, heading [rad]";
    series(path, columns, Topic::Odom, odometry_of, meter)
}

fn odometry_of(values: [f64; 6]) -> Converted {
    Ok(Body::Odometry(flu_of(values)?, Twist::default()))
}

/// A pose with its axes and those of its frame pointing up.
fn flu_of(values: [f64; 6]) -> Result<Isometry3<f64>, LossKind> {
    let [x, y, z, roll, pitch, heading] = finite(values)?;
    let frd = from_roll_pitch_heading(roll, pitch, heading);
    let position = Translation3::from(flu_from_frd([x, y, z]));
    Ok(Isometry3::from_parts(position, FLU_FROM_FRD * frd * FLU_FROM_FRD))
}

/// `odometry_mu.csv`: the odometry as the motion from row to row, at the times of the images ("relative to the previous
/// image event", Carlevaris-Bianco et al. 2016). The pose is the sum of the motions.
pub(super) struct Motions {
    table: Table<6>,
    pose: Isometry3<f64>,
}

impl Motions {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        let columns = "utime [us], x, y, z [m], roll, pitch, heading [rad] since the row before";
        Ok(Self { table: Table::open(path, columns, meter)?, pose: Isometry3::identity() })
    }
}

impl Source for Motions {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(Row { stamp_ns, values }) = self.table.next(losses)? {
            match flu_of(values) {
                Ok(motion) => {
                    self.pose *= motion;
                    let body = Body::Odometry(self.pose, Twist::default());
                    return Ok(Some(Record { topic: Topic::Odom, stamp_ns, body }));
                }
                Err(kind) => losses.add(self.table.loss(kind), 1),
            }
        }
        Ok(None)
    }
}

/// `groundtruth_DATE.csv`: the pose of the body in the map, converted from north-east-down to
/// east-north-up axes.
pub(super) fn ground_truth(path: &Path, meter: &Meter) -> Opened {
    let columns = "utime [us], x, y, z [m], roll, pitch, heading [rad]";
    series(path, columns, Topic::GroundTruth, ground_truth_of, meter)
}

fn ground_truth_of(values: [f64; 6]) -> Converted {
    let [north, east, down, roll, pitch, heading] = finite(values)?;
    let position = Translation3::new(east, north, -down);
    Ok(Body::Pose(Isometry3::from_parts(position, enu_from_flu(roll, pitch, heading))))
}

/// The attitude of the body with z-up axes, from its roll, pitch and heading with z-down axes:
/// `enu_from_ned * ned_from_frd * frd_from_flu`.
fn enu_from_flu(roll: f64, pitch: f64, heading: f64) -> UnitQuaternion<f64> {
    let ned_from_frd = from_roll_pitch_heading(roll, pitch, heading);
    ENU_FROM_NED * ned_from_frd * FLU_FROM_FRD
}

/// The values of a row, or the loss if any of them is NaN or infinite.
fn finite<const N: usize>(values: [f64; N]) -> Result<[f64; N], LossKind> {
    match values.iter().all(|value| value.is_finite()) {
        true => Ok(values),
        false => Err(LossKind::RowsWithNan),
    }
}

/// `wheels.csv`: the speeds of the wheels over ground.
pub(super) fn wheels(path: &Path, meter: &Meter) -> Opened {
    series(path, "utime [us], left, right [m/s]", Topic::Wheels, wheels_of, meter)
}

fn wheels_of(values: [f64; 2]) -> Converted {
    let [left, right] = finite(values)?;
    Ok(Body::Wheels { left, right })
}

/// `gps.csv` and `gps_rtk.csv`. The modes are those of gpsd: 0 and 1 mean no fix, and 2 means a fix
/// without altitude.
pub(super) fn gps(path: &Path, topic: Topic, meter: &Meter) -> Opened {
    let columns = "utime [us], mode, satellites, latitude, longitude [rad], altitude [m], ...";
    series(path, columns, topic, gps_of, meter)
}

fn gps_of([mode, _, latitude, longitude, altitude]: [f64; 5]) -> Converted {
    if mode < 2.0 {
        return Err(LossKind::RowsWithoutFix);
    }
    let [latitude, longitude] = finite([latitude.to_degrees(), longitude.to_degrees()])?;
    let fix = Fix {
        latitude,
        longitude,
        altitude: if altitude.is_finite() { altitude } else { f64::NAN },
    };
    Ok(Body::Fix(fix))
}

/// `ms25.csv`, with the attitudes of `ms25_euler.csv` if that file is given.
pub(super) struct Ms25 {
    readings: Table<9>,
    attitudes: Option<Table<3>>,
    /// The latest attitude that is not later than the reading.
    current: Option<Row<3>>,
    /// The attitude after that.
    next: Option<Row<3>>,
}

impl Ms25 {
    pub fn open(path: &Path, euler: Option<&Path>, meter: &Meter) -> Result<Self, ImportError> {
        let columns = "utime [us], magnetic field x, y, z, acceleration x, y, z [m/s^2], rates \
                       about x, y, z [rad/s]";
        let attitude_columns = "utime [us], roll, pitch, heading [rad]";
        let readings = Table::open(path, columns, meter)?;
        let attitudes = euler.map(|path| Table::open(path, attitude_columns, meter)).transpose()?;
        Ok(Self { readings, attitudes, current: None, next: None })
    }

    fn attitude_at(
        &mut self,
        stamp_ns: i64,
        losses: &mut Losses,
    ) -> Result<Option<UnitQuaternion<f64>>, ImportError> {
        let Some(attitudes) = &mut self.attitudes else { return Ok(None) };
        loop {
            if self.next.is_none() {
                self.next = attitudes.next(losses)?;
            }
            let Some(row) = self.next.take_if(|next| next.stamp_ns <= stamp_ns) else { break };
            match finite(row.values) {
                Ok(_) => self.current = Some(row),
                Err(kind) => losses.add(attitudes.loss(kind), 1),
            }
        }
        let current = self.current.filter(|row| stamp_ns - row.stamp_ns <= MAX_ATTITUDE_AGE_NS);
        Ok(current
            .map(|Row { values: [roll, pitch, heading], .. }| enu_from_flu(roll, pitch, heading)))
    }
}

impl Source for Ms25 {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(Row { stamp_ns, values }) = self.readings.next(losses)? {
            let [_, _, _, ax, ay, az, rx, ry, rz] = values;
            if let Err(kind) = finite([ax, ay, az, rx, ry, rz]) {
                losses.add(self.readings.loss(kind), 1);
                continue;
            }
            let imu = Imu {
                orientation: self.attitude_at(stamp_ns, losses)?,
                angular_velocity: flu_from_frd([rx, ry, rz]),
                linear_acceleration: Some(flu_from_frd([ax, ay, az])),
            };
            return Ok(Some(Record { topic: Topic::Imu, stamp_ns, body: Body::Imu(imu) }));
        }
        Ok(None)
    }
}

/// `kvh.csv`: the heading from the integrated rates of the fibre-optic gyro, with an arbitrary zero.
///
/// The orientation is the rotation by this heading. The angular velocity about z is the change of the
/// heading since the previous row. The first row and a row after a pause have no angular velocity and
/// give no message.
pub(super) struct Kvh {
    table: Table<1>,
    previous: Option<Row<1>>,
}

impl Kvh {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        Ok(Self { table: Table::open(path, "utime [us], heading [rad]", meter)?, previous: None })
    }
}

impl Source for Kvh {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while let Some(row) = self.table.next(losses)? {
            if let Err(kind) = finite(row.values) {
                losses.add(self.table.loss(kind), 1);
                continue;
            }
            let step = self.previous.replace(row).map(|previous| {
                let heading_change = wrap_angle(row.values[0] - previous.values[0]);
                (row.stamp_ns - previous.stamp_ns, heading_change)
            });
            let Some((step_ns, heading_change)) =
                step.filter(|(step_ns, _)| (1..=MAX_STEP_NS).contains(step_ns))
            else {
                losses.add(self.table.loss(LossKind::RowsWithoutPredecessor), 1);
                continue;
            };
            // The heading is clockwise seen from above, about z down.
            let imu = Imu {
                orientation: Some(from_heading(-row.values[0])),
                angular_velocity: [0.0, 0.0, -heading_change / (step_ns as f64 * 1e-9)],
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

    fn pose(converted: Converted) -> Isometry3<f64> {
        match converted {
            Ok(Body::Pose(pose) | Body::Odometry(pose, _)) => pose,
            other => panic!("{other:?}"),
        }
    }

    /// The body is 3 m north, 2 m east and 1 m up, and faces east. East is heading 0 in
    /// east-north-up axes.
    #[test]
    fn ground_truth_is_converted_to_east_north_up() {
        let facing_east = std::f64::consts::FRAC_PI_2;
        let pose = pose(ground_truth_of([3.0, 2.0, -1.0, 0.0, 0.0, facing_east]));
        assert_eq!(pose.translation.vector.as_slice(), [2.0, 3.0, 1.0]);
        assert!(pose.rotation.angle() < 1e-12, "{:?}", pose.rotation);
    }

    /// The robot drives ahead and to the right, and faces right.
    #[test]
    fn odometry_to_the_right_has_negative_y_and_heading() {
        let pose = pose(odometry_of([5.0, 2.0, 0.0, 0.0, 0.0, 0.2]));
        assert_eq!(pose.translation.vector.as_slice(), [5.0, -2.0, 0.0]);
        let expected = from_heading(-0.2);
        assert!(pose.rotation.angle_to(&expected) < 1e-12, "{:?} {expected:?}", pose.rotation);
    }

    #[test]
    fn rows_with_nan_or_without_a_fix_are_losses() {
        assert_eq!(ground_truth_of([f64::NAN; 6]), Err(LossKind::RowsWithNan));
        assert_eq!(wheels_of([0.1, f64::INFINITY]), Err(LossKind::RowsWithNan));
        assert_eq!(gps_of([1.0, 0.0, 0.7, -1.4, 270.0]), Err(LossKind::RowsWithoutFix));
        assert_eq!(gps_of([2.0, 5.0, f64::NAN, -1.4, 270.0]), Err(LossKind::RowsWithNan));
    }
}
