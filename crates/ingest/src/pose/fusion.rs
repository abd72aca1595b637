//! Wheel and IMU readings -> poses of the robot, and the checks of both sensors.

use dataset::{Losses, Note, NoteKind, Severity, StampedPose, Subject};
use fuse::{FusedPose, ImuSample, InertialReading, TurnComparison, TurnComparisons, WheelSample};

use crate::error::IngestError;
use crate::pose::joint_speeds::{WheelSpeeds, joint_speeds};
use crate::pose::readings::{ImuReading, MotionReadings};
use crate::pose::twist::twist_speeds;
use crate::pose::wheel_error::WheelError;
use crate::pose_options::PoseOptions;

/// The ratio of deg/s to rad/s.
const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// A ratio of turns agrees with an expected one if it differs by less than this factor. Track
/// widths of tires that scrub differ from the measured ones by up to a third.
const AGREES: f64 = 4.0 / 3.0;
/// Turns that differ by more than this factor are an error. The effective track width of skid-steer
/// robots is up to twice the measured one.
const RELATED: f64 = 2.5;
/// The unit of joints is m/s if gyroscope and wheels differ by less than this factor then. Wheels of
/// robots have a radius of much less than 0.8 m.
const CONFIRMS_UNIT: f64 = 1.25;
/// Turns with a smaller correlation are not related. The correlations in logs at 1 Hz, which miss
/// much of the motion, are 0.83 or more.
const CORRELATED: f64 = 0.5;
/// A negative correlation of more than this is a wrong sign. A smaller one is chance, as with stamps
/// of different clocks.
const OPPOSITE: f64 = 0.75;
/// A sensor that turns less than this times the other one, and not with it, does not turn.
const DEAD: f64 = 0.1;
/// A side is stuck if it drives less than this times the path of the other side, and the other side
/// drives more than this \[m\].
const STUCK: f64 = 1e-3;
const MIN_PATH_M: f64 = 1.0;
/// A measured heading turns less than the robot if it is below this ratio. The headings of a
/// magnetometer at 1 Hz turn 0.4 to 0.8 times as much as the gyroscope.
const HEADING_TURNS: f64 = 0.2;
/// Turns with which a measured heading changes at all \[rad\].
const SLIGHT_TURN_RAD: f64 = 0.1;
/// The sensors contradict each other if a larger share of the comparisons of the filter are outliers.
/// With noise alone, the share is 0.3 % at a gate of 3.
const MANY_OUTLIERS: f64 = 0.3;
/// Sensors and options contradict each other if a calibrated constant deviates from its prior by more
/// than this number of standard deviations.
const MANY_DEVIATIONS: f64 = 5.0;
/// If only one of the sensors measures for more than this share of the drive, and for more than this
/// time \[s\], there is a warning. Drivers of a robot start within seconds of each other.
const ALONE_SHARE: f64 = 0.05;
const ALONE_SECS: f64 = 2.0;
/// Time outside of the wheels from which IMU samples are mentioned at all \[s\]: every log has a few.
const WORTH_A_REMARK_SECS: f64 = 0.5;

/// The topics in messages.
pub(crate) struct FusedTopics<'a> {
    pub(crate) path: &'a std::path::Path,
    pub(crate) wheels: &'a str,
    pub(crate) imu: Option<&'a str>,
}

/// Fuses poses from wheels and an IMU.
pub(crate) fn fused_poses(
    readings: &MotionReadings,
    topics: &FusedTopics<'_>,
    options: &PoseOptions,
    losses: &mut Losses,
    notes: &mut Vec<Note>,
) -> Result<Vec<StampedPose>, IngestError> {
    let refuse = |source: WheelError| IngestError::Wheels {
        path: topics.path.to_owned(),
        topic: topics.wheels.to_owned(),
        source,
    };
    let fail = |source: fuse::FuseError| IngestError::Fuse {
        path: topics.path.to_owned(),
        topic: topics.wheels.to_owned(),
        source,
    };
    let mut wheels = wheel_speeds(readings, options).map_err(refuse)?;
    let has_joints = !readings.joints.is_empty();
    if wheels.samples.is_empty() && !has_joints && readings.odometry.is_empty() {
        let mut losses = losses.clone();
        losses.merge(readings.without_wheels.clone().on_topic(topics.wheels));
        return Err(refuse(WheelError::NoWheels { losses }));
    }
    check_sides(&wheels.samples).map_err(refuse)?;
    losses.merge(std::mem::take(&mut wheels.losses).on_topic(topics.wheels));
    let on_wheels = |kind| Note::new(kind, Subject::topic(topics.wheels));
    notes.extend(std::mem::take(&mut wheels.notes).into_iter().map(on_wheels));

    if 1 < readings.imu_frames.len() {
        let one = |(frame, n): (&String, &u64)| format!("`{frame}` ({n} messages)");
        let frames = readings.imu_frames.iter().map(one).collect::<Vec<_>>().join(", ");
        let imu = topics.imu.unwrap_or_default().to_owned();
        return Err(refuse(WheelError::SeveralImus { imu, frames }));
    }
    let mut imu = imu_samples(readings, &wheels.samples, options);
    let fuse_options = options.fuse_options();
    let turns = fuse::compare_turns(&fuse_options, &wheels.samples, &imu).map_err(fail)?;
    let has_unit = options.wheel_radius_m.is_some() || options.wheel_speed_unit.is_some();
    let checked = check_turns(&turns, topics.imu, has_joints && !has_unit).map_err(refuse)?;
    let is_doubtful = checked.iter().any(|note| note.severity() != Severity::Info);
    notes.extend(checked.into_iter().map(on_wheels));
    if let Some(why) = heading_fault(&turns) {
        imu.iter_mut().for_each(|sample| sample.heading_rad = None);
        notes.push(Note::new(why, Subject::topic(topics.imu.unwrap_or_default())));
    }

    let start = options.start.map(|start| start.pose());
    let fuse = |imu: &[ImuSample]| fuse::fuse(&fuse_options, &wheels.samples, imu, start, None);
    let mut fused = fuse(&imu).map_err(fail)?;
    notes.extend(notes_of_fusion(&fused.report).into_iter().map(Note::from));
    let contradictions = contradictions(&fused.report, &fuse_options);
    if is_doubtful || !contradictions.is_empty() {
        notes.extend(contradictions.into_iter().map(on_wheels));
        // The other estimates, each without one of the sources that contradict each other.
        let without_imu = fuse(&[]).map_err(fail)?;
        imu.iter_mut().for_each(|sample| sample.heading_rad = None);
        let without_headings = fuse(&imu).map_err(fail)?;
        widen(&mut fused.poses, &[&without_imu.poses, &without_headings.poses]);
    }
    losses.merge(fused.report.losses);
    let pose = |fused: &FusedPose| StampedPose {
        covariance: Some(fused.covariance),
        ..StampedPose::new(fused.stamp_ns, fused.pose)
    };
    Ok(fused.poses.iter().map(pose).collect())
}

/// The wheel speeds in all messages.
fn wheel_speeds(
    readings: &MotionReadings,
    options: &PoseOptions,
) -> Result<WheelSpeeds, WheelError> {
    if readings.joints.is_empty() {
        let frames: Vec<_> = readings.odometry_frames.iter().collect();
        return match frames.as_slice() {
            [] => Ok(WheelSpeeds::default()),
            [([parent, child], _)] => twist_speeds(&readings.odometry, [parent, child], options),
            several => Err(WheelError::SeveralFrames { frames: named(several) }),
        };
    }
    joint_speeds(&readings.joints, options)
}

/// Checks that both sides move. No robot turns about one wheel for a whole drive.
fn check_sides(samples: &[WheelSample]) -> Result<(), WheelError> {
    let path = |of: fn(&WheelSample) -> f64| {
        let pairs = samples.windows(2).filter(|pair| pair[0].stamp_ns < pair[1].stamp_ns);
        let step = |pair: &[WheelSample]| {
            let secs = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
            0.5 * (of(&pair[0]).abs() + of(&pair[1]).abs()) * secs
        };
        pairs.map(step).filter(|step| step.is_finite()).sum::<f64>()
    };
    let (left, right) = (path(|sample| sample.left_m_s), path(|sample| sample.right_m_s));
    let side = if left < right { "left" } else { "right" };
    let path = left.max(right);
    match MIN_PATH_M < path && left.min(right) < STUCK * path {
        true => Err(WheelError::StuckWheel { side, path }),
        false => Ok(()),
    }
}

/// Pairs of frames with their counts.
fn named(frames: &[(&[String; 2], &u64)]) -> String {
    let one = |([parent, child], n): &(&[String; 2], &u64)| {
        format!("`{child}` in `{parent}` ({n} message{})", if **n == 1 { "" } else { "s" })
    };
    frames.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// The yaw rates and the headings of the IMU.
fn imu_samples(
    readings: &MotionReadings,
    wheels: &[WheelSample],
    options: &PoseOptions,
) -> Vec<ImuSample> {
    let inertial: Vec<InertialReading> =
        readings.imu.iter().map(|reading| reading.inertial).collect();
    let yaw_rates = fuse::yaw_rates_rad_s(&inertial, wheels);
    let sample = |(reading, yaw_rate): (&ImuReading, f64)| ImuSample {
        stamp_ns: reading.inertial.stamp_ns,
        yaw_rate_rad_s: yaw_rate * 1f64.copysign(options.gyro_scale),
        heading_rad: reading.heading_rad,
    };
    readings.imu.iter().zip(yaw_rates).map(sample).collect()
}

/// Whether a ratio is within a factor of an expected one.
fn is_near(ratio: f64, expected: f64, factor: f64) -> bool {
    (1.0 / factor..=factor).contains(&(ratio / expected))
}

/// Compares gyroscope and wheels over the whole drive. If `needs_unit` is true, the unit of
/// the wheels is not known: m/s is assumed, and the gyroscope must confirm it.
fn check_turns(
    turns: &TurnComparisons,
    imu: Option<&str>,
    needs_unit: bool,
) -> Result<Vec<NoteKind>, WheelError> {
    let unknown_unit = |gyro_ratio| Err(WheelError::UnknownUnit { gyro_ratio });
    let imu = imu.unwrap_or_default().to_owned();
    let Some(found) = turns.gyro_by_wheels else {
        return if needs_unit { unknown_unit(None) } else { Ok(Vec::new()) };
    };
    let TurnComparison { ratio, correlation, .. } = found;
    if !found.is_reference_resolved && !found.is_sensor_resolved {
        return if needs_unit { unknown_unit(None) } else { Ok(Vec::new()) };
    }
    let is_correlated = CORRELATED <= correlation.abs();
    if is_correlated && is_near(ratio.abs(), DEGREES, CONFIRMS_UNIT) {
        return Err(WheelError::GyroInDegrees { imu, ratio });
    }
    if correlation < -OPPOSITE && is_near(ratio, -1.0, RELATED) {
        return Err(WheelError::OppositeTurns { imu, ratio });
    }
    if needs_unit {
        let is_confirmed = is_correlated && is_near(ratio, 1.0, CONFIRMS_UNIT);
        return match is_confirmed {
            true => Ok(vec![NoteKind::WheelUnitConfirmed { ratio }]),
            false => unknown_unit(is_correlated.then_some(ratio)),
        };
    }
    if !is_correlated && !found.is_sensor_resolved && ratio.abs() < DEAD {
        let (gyro_rad, wheels_rad) = (found.sensor_rad, found.reference_rad);
        let secs = found.n_windows as f64 * found.window_secs;
        return Err(WheelError::DeadGyro { imu, ratio, gyro_rad, wheels_rad, secs });
    }
    if !found.is_reference_resolved && !is_correlated {
        return Ok(vec![NoteKind::WheelsDoNotTurn {
            gyro_rad: found.sensor_rad,
            wheels_rad: found.reference_rad,
        }]);
    }
    if !is_correlated || !is_near(ratio, 1.0, RELATED) {
        let is_one_reversed = turns.gyro_by_wheel_sum.is_some_and(|sum| {
            correlation.abs() < sum.correlation.abs() && is_near(sum.ratio.abs(), 1.0, AGREES)
        });
        return Err(WheelError::Unrelated { imu, ratio, correlation, is_one_reversed });
    }
    match is_near(ratio, 1.0, AGREES) {
        true => Ok(Vec::new()),
        false => Ok(vec![NoteKind::TurnRatio { ratio }]),
    }
}

/// Why the measured headings cannot be used, if they do not turn with the robot.
fn heading_fault(turns: &TurnComparisons) -> Option<NoteKind> {
    // The gyroscope is the better reference, if it turns. A heading that is measured is never constant
    // to the last bit, even in slow turns.
    let is_constant = turns.heading_span_rad == Some(0.0);
    let is_reference = |by: &TurnComparison| {
        by.is_reference_resolved || (is_constant && SLIGHT_TURN_RAD < by.reference_rad)
    };
    let by_gyro = turns.heading_by_gyro.filter(is_reference);
    let by = by_gyro.or(turns.heading_by_wheels.filter(is_reference))?;
    let slope = by.ratio * by.correlation.abs();
    let reference = if by_gyro.is_some() { "gyroscope" } else { "wheels" };
    let (reference, reference_rad) = (reference.to_owned(), by.reference_rad);
    let heading_rad = turns.heading_span_rad?;
    if is_constant {
        Some(NoteKind::ConstantHeading { reference, reference_rad })
    } else if slope < -HEADING_TURNS {
        Some(NoteKind::HeadingTurnsOpposite { reference, ratio: by.ratio })
    } else if slope < HEADING_TURNS {
        Some(NoteKind::HeadingDoesNotTurn { reference, reference_rad, heading_rad })
    } else {
        None
    }
}

fn notes_of_fusion(report: &fuse::Report) -> Vec<NoteKind> {
    let mut notes = vec![NoteKind::PosesFused {
        n_wheel_samples: report.n_wheel_samples as u64,
        n_imu_samples: report.n_imu_samples as u64,
        distance_m: report.distance_m,
        still_share: report.still_share,
        track_m: report.track_m.value,
        track_std_m: report.track_m.std,
        gyro_bias_rad_s: report.gyro_bias_mean_rad_s,
    }];
    if report.n_headings > 0 {
        notes.push(NoteKind::HeadingsUsed {
            n_headings: report.n_headings,
            n_outliers: report.n_heading_outliers,
        });
    }
    if report.n_turn_outliers > 0 {
        notes.push(NoteKind::WheelSlip { secs: report.n_turn_outliers });
    }
    let alone_s = report.wheels_alone_secs;
    if ALONE_SECS.max(ALONE_SHARE * report.duration_secs) < alone_s {
        notes.push(NoteKind::WheelsWithoutImu { alone_s, duration_s: report.duration_secs });
    }
    let (n_used, n_outside) = (report.n_imu_samples as u64, report.n_imu_outside as u64);
    let period_s = report.duration_secs / report.n_imu_samples.max(1) as f64;
    let outside_s = n_outside as f64 * period_s;
    if WORTH_A_REMARK_SECS < outside_s {
        let n_samples = n_used + n_outside;
        let is_many = ALONE_SHARE * (n_used as f64) < n_outside as f64 && ALONE_SECS < outside_s;
        notes.push(match is_many {
            true => NoteKind::ImuOutsideWheels { n_outside, n_samples },
            false => NoteKind::ImuBeforeOrAfterWheels { n_outside, n_samples },
        });
    }
    for (gaps, sensor) in [(report.wheel_gaps, "wheel"), (report.imu_gaps, "imu")] {
        if gaps.n > 0 {
            let (sensor, n_gaps) = (sensor.to_owned(), gaps.n as u64);
            notes.push(NoteKind::SampleGaps { sensor, n_gaps, secs: gaps.secs });
        }
    }
    notes
}

/// What the filter found that its options do not explain.
fn contradictions(report: &fuse::Report, options: &fuse::Options) -> Vec<NoteKind> {
    let is_many = |n: u64, of: u64| 3 <= n && MANY_OUTLIERS * (of as f64) < n as f64;
    let mut found = Vec::new();
    // Windows of one second in motion. Those in which the samples are too sparse are not compared, but
    // count.
    let moving_secs = report.duration_secs * (1.0 - report.still_share);
    let (n_windows, n_outliers) = (moving_secs.round() as u64, report.n_moving_outliers);
    if is_many(n_outliers, n_windows) {
        found.push(NoteKind::MostlySlip { n_outliers, n_windows });
    }
    let (n_headings, n_outliers) = (report.n_headings, report.n_heading_outliers);
    if is_many(n_outliers, n_headings) {
        found.push(NoteKind::HeadingsContradict { n_outliers, n_headings });
    }
    let mut deviates = |name: &str, value: f64, expected: f64, std: f64, unit: &str| {
        if MANY_DEVIATIONS * std < (value - expected).abs() {
            let (name, unit) = (name.to_owned(), unit.to_owned());
            found.push(NoteKind::CalibrationDeviates { name, value, expected, std, unit });
        }
    };
    if let Some(bias) = report.gyro_bias_mean_rad_s {
        deviates("gyroscope bias", bias, 0.0, options.gyro_bias_std, "rad/s");
    }
    let track_m = options.track_m;
    deviates("track width", report.track_m.value, track_m, options.track_std * track_m, "m");
    found
}

/// Adds the differences to other estimates of the same poses to the covariances. Each estimate that
/// leaves out one of two sources that contradict each other can be the right one.
fn widen(poses: &mut [FusedPose], others: &[&[FusedPose]]) {
    for other in others {
        for (pose, other) in poses.iter_mut().zip(*other) {
            let turn = dataset::wrap_angle(other.pose.heading_rad - pose.pose.heading_rad);
            let d = [other.pose.x_m - pose.pose.x_m, other.pose.y_m - pose.pose.y_m, turn];
            let products =
                [d[0] * d[0], d[0] * d[1], d[0] * d[2], d[1] * d[1], d[1] * d[2], d[2] * d[2]];
            pose.covariance.iter_mut().zip(products).for_each(|(c, product)| *c += product);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::path::Path;
    use std::sync::Arc;

    use crate::pose::joint_speeds::{JointReading, JointSet};
    use crate::pose::joints::Naming;
    use crate::wheel_options::WheelSpeedUnit;

    /// A drive of 60 s at 1 m/s that turns to both sides, with wheels at 20 Hz and an IMU at 50 Hz.
    struct Made {
        /// Turns of the wheels and of the gyroscope, as factors of the true ones.
        wheel_turns: f64,
        gyro_turns: f64,
        /// Factor for the speeds of each side.
        sides: [f64; 2],
        /// Factor for the measured headings; `None` without headings.
        heading_turns: Option<f64>,
        /// Amplitude of an error of the headings that is not related to the turns \[rad\].
        heading_error_rad: f64,
        /// The IMU is stamped later \[s\].
        imu_late_s: f64,
        options: PoseOptions,
    }

    impl Default for Made {
        fn default() -> Self {
            Self {
                wheel_turns: 1.0,
                gyro_turns: 1.0,
                sides: [1.0; 2],
                heading_turns: None,
                heading_error_rad: 0.0,
                imu_late_s: 0.0,
                options: PoseOptions {
                    wheels: Some("/wheels".into()),
                    imu: Some("/imu".to_owned()),
                    track_m: Some(0.5),
                    wheel_speed_unit: Some(WheelSpeedUnit::MetresPerSecond),
                    ..PoseOptions::default()
                },
            }
        }
    }

    /// The true heading is sin(0.4 t); the yaw rate is its derivative.
    fn heading_rad(t: f64) -> f64 {
        libm::sin(0.4 * t)
    }

    fn yaw_rate(t: f64) -> f64 {
        0.4 * libm::cos(0.4 * t)
    }

    impl Made {
        fn fuse(&self) -> Result<(Vec<StampedPose>, Vec<&'static str>), IngestError> {
            let joints = Arc::new(JointSet {
                naming: Naming::Wheel,
                left: vec!["left".to_owned()],
                right: vec!["right".to_owned()],
            });
            let mut readings = MotionReadings::default();
            for k in 0..=1200 {
                let t = f64::from(k) / 20.0;
                let half = 0.25 * self.wheel_turns * yaw_rate(t);
                readings.joints.push(JointReading {
                    stamp_ns: i64::from(k) * 50_000_000,
                    joints: Arc::clone(&joints),
                    positions: Vec::new(),
                    velocities: vec![self.sides[0] * (1.0 - half), self.sides[1] * (1.0 + half)],
                });
            }
            let scale = self.options.gyro_scale.abs();
            for k in 0..=3000 {
                let t = f64::from(k) / 50.0;
                let inertial = InertialReading {
                    stamp_ns: i64::from(k) * 20_000_000 + (self.imu_late_s * 1e9) as i64,
                    angular_velocity_rad_s: [0.0, 0.0, scale * self.gyro_turns * yaw_rate(t)],
                    acceleration_m_s2: None,
                };
                let error_rad = self.heading_error_rad * libm::sin(1.7 * t);
                let heading_rad =
                    self.heading_turns.map(|turns| turns * heading_rad(t) + error_rad);
                readings.imu.push(ImuReading { inertial, heading_rad });
            }
            let path = Path::new("drive.mcap");
            let topics = FusedTopics { path, wheels: "/wheels", imu: Some("/imu") };
            let (mut losses, mut notes) = (Losses::default(), Vec::new());
            let poses = fused_poses(&readings, &topics, &self.options, &mut losses, &mut notes)?;
            let is_noted = |note: &&Note| note.severity() != Severity::Info;
            Ok((poses, notes.iter().filter(is_noted).map(Note::code).collect()))
        }

        #[track_caller]
        fn expect_error(&self, code: &str, text: &str) {
            let error = self.fuse().unwrap_err();
            let IngestError::Wheels { source, .. } = &error else { panic!("{error}") };
            assert_eq!(error.code(), code);
            assert!(source.to_string().contains(text), "{source}");
        }

        #[track_caller]
        fn expect(&self, notes: &[&str]) -> Vec<StampedPose> {
            let (poses, found) = self.fuse().unwrap();
            assert_eq!(found, notes);
            poses
        }
    }

    /// The end of the true path, integrated in steps of 1 ms.
    fn true_end() -> [f64; 2] {
        (0..60_000).fold([0.0; 2], |[x, y], k| {
            let (sin, cos) = libm::sincos(heading_rad((f64::from(k) + 0.5) * 1e-3));
            [x + 1e-3 * cos, y + 1e-3 * sin]
        })
    }

    fn error_m(poses: &[StampedPose]) -> f64 {
        let end = poses.last().unwrap().pose;
        let [x_m, y_m] = true_end();
        end.distance_m(&dataset::Pose2 { x_m, y_m, heading_rad: 0.0 })
    }

    #[test]
    fn sensors_that_agree_give_no_warning() {
        assert!(error_m(&Made::default().expect(&[])) < 0.2);
        // The track width is 10 % too large: the filter calibrates it.
        assert!(error_m(&Made { wheel_turns: 0.9, ..Made::default() }.expect(&[])) < 0.5);
        let headings = Made { heading_turns: Some(1.0), ..Made::default() };
        assert!(error_m(&headings.expect(&[])) < 0.2);
    }

    #[test]
    fn a_gyroscope_that_contradicts_the_wheels_is_refused() {
        let made = |gyro_turns| Made { gyro_turns, ..Made::default() };
        made(-1.0).expect_error("opposite_turns", "-1.00 times as much as the wheels");
        made(-0.8).expect_error("opposite_turns", "gyro_scale = -1");
        made(DEGREES).expect_error("gyro_in_degrees", "turns 57.3 times as much");
        made(0.0).expect_error("dead_gyro", "turns 0.000 times as much");
        made(5.0).expect_error("unrelated_turns", "turns 5.00 times as much");
    }

    /// The option corrects the unit and the sign.
    #[test]
    fn the_gyroscope_can_be_scaled() {
        for gyro_scale in [-1.0, 1.0 / DEGREES, -1.0 / DEGREES] {
            let mut made = Made { gyro_turns: 1.0 / gyro_scale, ..Made::default() };
            made.options.gyro_scale = gyro_scale;
            assert!(error_m(&made.expect(&[])) < 0.2, "{gyro_scale}");
        }
    }

    #[test]
    fn an_encoder_that_does_not_count_is_refused() {
        let stuck = |sides| Made { sides, ..Made::default() };
        stuck([0.0, 1.0]).expect_error("stuck_wheel", "on the left stand still");
        stuck([1.0, 0.0]).expect_error("stuck_wheel", "on the right stand still");
    }

    #[test]
    fn a_reversed_encoder_is_refused_and_a_wrong_track_width_reported() {
        let reversed = Made { sides: [1.0, -1.0], ..Made::default() };
        reversed.expect_error("unrelated_turns", "If one wheel counts backward, they agree");
        let exchanged = Made { wheel_turns: -1.0, ..Made::default() };
        exchanged.expect_error("opposite_turns", "left and right wheels are exchanged");
        // Turns 0.5 times as much: the track width in the options is half of the true one.
        let poses = Made { wheel_turns: 2.0, ..Made::default() }
            .expect(&["turn_ratio", "calibration_deviates"]);
        let [xx, _, _, yy, ..] = poses.last().unwrap().covariance.unwrap();
        assert!(error_m(&poses) < 3.0 * (xx + yy).sqrt(), "{xx} {yy}");
        let straight = Made { wheel_turns: 0.0, ..Made::default() };
        assert!(straight.fuse().unwrap().1.contains(&"wheels_do_not_turn"));
    }

    #[test]
    fn the_unit_of_joints_must_be_stated_or_confirmed() {
        let made = |sides, imu_late_s| {
            let mut made = Made { sides, imu_late_s, ..Made::default() };
            made.options.wheel_speed_unit = None;
            made
        };
        assert!(error_m(&made([1.0; 2], 0.0).expect(&[])) < 0.2);
        // rad/s of wheels with a radius of 0.1 m.
        made([10.0; 2], 0.0).expect_error("unknown_wheel_unit", "a radius of 0.100 m");
        let mut with_radius = made([10.0; 2], 0.0);
        with_radius.options.wheel_radius_m = Some(0.1);
        assert!(error_m(&with_radius.expect(&[])) < 0.2);
    }

    #[test]
    fn headings_that_do_not_turn_with_the_robot_are_not_used() {
        let made = |turns| Made { heading_turns: Some(turns), ..Made::default() };
        assert!(error_m(&made(0.0).expect(&[])) < 0.2, "constant: a remark");
        assert!(error_m(&made(-1.0).expect(&["heading_turns_opposite"])) < 0.2);
        assert!(error_m(&made(0.05).expect(&["heading_does_not_turn"])) < 0.2);
    }

    /// A magnetometer that is disturbed all the time: the claimed uncertainty covers the error.
    #[test]
    fn headings_that_contradict_the_other_sensors_raise_the_uncertainty() {
        let disturbed =
            Made { heading_turns: Some(1.0), heading_error_rad: 1.2, ..Made::default() };
        let poses = disturbed.expect(&["headings_contradict"]);
        let [xx, _, _, yy, ..] = poses.last().unwrap().covariance.unwrap();
        assert!(error_m(&poses) < 3.0 * (xx + yy).sqrt(), "{xx} {yy}");
    }

    #[test]
    fn samples_outside_of_the_time_of_the_other_sensor_are_reported() {
        let late = |imu_late_s| Made { imu_late_s, ..Made::default() };
        let error = late(100.0).fuse().unwrap_err();
        let IngestError::Fuse { source, .. } = &error else { panic!("{error}") };
        let expected = "0 of 3001 IMU samples are used: the wheels are stamped from 0.000 to 60.000 s and the IMU from 100.000 to 160.000 s";
        assert!(source.to_string().contains(expected), "{source}");
        // One period of the turns late: they agree where both are.
        let period_s = std::f64::consts::TAU / 0.4;
        let (_, notes) = late(period_s).fuse().unwrap();
        assert_eq!(notes, ["wheels_without_imu", "imu_outside_wheels"]);
    }

    /// Two estimates that are 3 m apart along x and 0.1 rad in heading.
    #[test]
    fn the_difference_to_another_estimate_is_added_to_the_covariance() {
        let pose = |x_m, heading_rad| FusedPose {
            stamp_ns: 0,
            pose: dataset::Pose2 { x_m, y_m: 0.0, heading_rad },
            covariance: [1.0, 0.0, 0.0, 1.0, 0.0, 0.5],
        };
        let mut poses = vec![pose(1.0, 0.0)];
        widen(&mut poses, &[&[pose(4.0, 0.1)]]);
        let expected = [10.0, 0.0, 0.3, 1.0, 0.0, 0.51];
        for (found, expected) in poses[0].covariance.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{poses:?}");
        }
    }
}
