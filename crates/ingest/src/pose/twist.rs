//! Odometry messages -> wheel speeds.
//!
//! The twist of a `nav_msgs/Odometry` is in its child frame: x forward, y left. Some drivers write
//! it in the parent frame instead. The poses of the same messages show which of the two it is.

use dataset::{NoteKind, Pose2};
use fuse::WheelSample;
use messages::Odometry;

use crate::pose::joint_speeds::WheelSpeeds;
use crate::pose::message::{unit_quaternion, yaw_rad};
use crate::pose::wheel_error::WheelError;
use crate::pose_options::PoseOptions;

/// The twist explains the poses if at most this share of their squared steps is left: 22 % of the
/// length of a step.
const EXPLAINED: f64 = 0.05;
/// It contradicts them if half of the length of a step is left.
const CONTRADICTED: f64 = 0.25;
/// Steps are compared with the twist over at most this time \[s\], in which the speed is about
/// constant.
const MAX_STEP_S: f64 = 1.0;
/// Steps are added up for this time before they are compared \[s\]. The noise of the poses and of the
/// twist is larger than a single step at 50 Hz, but much smaller than the motion in a second. A turn of
/// a robot takes longer than this.
const WINDOW_S: f64 = 1.0;
/// A velocity along x and y below this is noise of a robot at rest \[m/s\].
const AT_REST_M_S: f64 = 0.02;
/// Largest share of the speed that can be sideways: above it, 2 % of the path would be lost. A base
/// frame ahead of the wheels moves sideways in turns, by less than this.
const MAX_SIDEWAYS_SHARE: f64 = 0.2;

/// The turns of the poses and of the twist are compared if the heading changes by more than this in
/// the whole drive \[rad\].
const MIN_TURN_RAD: f64 = 1.0;
/// Turns of the poses over turns by the twist, or the inverse, from which they contradict each other.
/// Noise of the twist lowers the ratio.
const MAX_TURN_RATIO: f64 = 2.0;

/// The pose and the twist of an odometry message in the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct OdometryReading {
    pub(crate) stamp_ns: i64,
    /// `None` if the message has no valid pose.
    pub(crate) pose: Option<Pose2>,
    /// Along x and y \[m/s\].
    pub(crate) velocity_m_s: [f64; 2],
    pub(crate) yaw_rate_rad_s: f64,
}

impl OdometryReading {
    /// Reads a message in the plane.
    pub(crate) fn new(odometry: &Odometry, stamp_ns: i64) -> Self {
        let [x_m, y_m, _] = odometry.pose.position;
        let heading = unit_quaternion(odometry.pose.orientation).map(yaw_rad);
        let pose = heading.ok().map(|heading_rad| Pose2 { x_m, y_m, heading_rad });
        let [x, y, _] = odometry.linear_velocity;
        Self {
            stamp_ns,
            pose: pose.filter(|pose| (pose.x_m + pose.y_m).is_finite()),
            velocity_m_s: [x, y],
            yaw_rate_rad_s: odometry.angular_velocity[2],
        }
    }
}

/// How well the twist explains the steps of the poses, as twist of the child or of the parent frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct TwistEvidence {
    last: Option<OdometryReading>,
    /// The windows that are complete, and the one at the end.
    complete: Sums,
    open: Window,
    /// Turn of the poses so far, and its smallest and largest value \[rad\].
    turned_rad: f64,
    least_rad: f64,
    most_rad: f64,
    /// Whether any twist is not 0.
    has_twist: bool,
}

/// The motion in a time of [`WINDOW_S`], by the poses and by the twist.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Window {
    secs: f64,
    /// By the poses \[m\].
    moved_m: [f64; 2],
    /// By the twist, as twist of the child or of the parent frame \[m\].
    by_child_m: [f64; 2],
    by_parent_m: [f64; 2],
    /// By the twist, and by the poses \[rad\].
    turn_rad: f64,
    pose_turn_rad: f64,
}

/// Sums over windows.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Sums {
    /// Squared motion of the poses \[m^2\].
    steps_m2: f64,
    /// What is left of it \[m^2\].
    left_child_m2: f64,
    left_parent_m2: f64,
    /// The squared turn by the twist, and its product with the turn of the poses \[rad^2\].
    turns_rad2: f64,
    product_rad2: f64,
}

impl Sums {
    fn with(self, window: &Window) -> Self {
        let squared = |[x, y]: [f64; 2]| x * x + y * y;
        let left_m2 =
            |by_m: [f64; 2]| squared([window.moved_m[0] - by_m[0], window.moved_m[1] - by_m[1]]);
        Self {
            steps_m2: self.steps_m2 + squared(window.moved_m),
            left_child_m2: self.left_child_m2 + left_m2(window.by_child_m),
            left_parent_m2: self.left_parent_m2 + left_m2(window.by_parent_m),
            turns_rad2: self.turns_rad2 + window.turn_rad * window.turn_rad,
            product_rad2: self.product_rad2 + window.turn_rad * window.pose_turn_rad,
        }
    }
}

/// The frame of a twist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TwistFrame {
    Child,
    Parent,
    /// The poses do not show it: they are missing, do not move, or have heading 0.
    Unknown,
    /// Neither frame explains the poses.
    Neither,
}

impl TwistEvidence {
    /// Adds the next message.
    pub(crate) fn add(&mut self, next: &OdometryReading, max_speed_m_s: f64) {
        let [x, y] = next.velocity_m_s;
        self.has_twist |= x != 0.0 || y != 0.0 || next.yaw_rate_rad_s != 0.0;
        if let Some(last) = self.last.replace(*next)
            && let Some(step) = Step::new(&last, next)
            && step.secs <= MAX_STEP_S
            && step.length_m() <= max_speed_m_s * step.secs
        {
            let mean = [0, 1].map(|k| 0.5 * (last.velocity_m_s[k] + next.velocity_m_s[k]));
            if !mean.iter().all(|v| v.is_finite()) {
                return;
            }
            let window = &mut self.open;
            let add = |to: &mut [f64; 2], [x, y]: [f64; 2]| *to = [to[0] + x, to[1] + y];
            let in_step = |[x, y]: [f64; 2]| [x * step.secs, y * step.secs];
            add(&mut window.moved_m, step.moved_m);
            add(&mut window.by_child_m, in_step(rotated(mean, step.heading_rad)));
            add(&mut window.by_parent_m, in_step(mean));
            let turn = 0.5 * (last.yaw_rate_rad_s + next.yaw_rate_rad_s) * step.secs;
            if turn.is_finite() {
                window.turn_rad += turn;
                window.pose_turn_rad += step.turn_rad;
                self.turned_rad += step.turn_rad;
                self.least_rad = self.least_rad.min(self.turned_rad);
                self.most_rad = self.most_rad.max(self.turned_rad);
            }
            window.secs += step.secs;
            if WINDOW_S <= window.secs {
                self.complete = self.sums();
                self.open = Window::default();
            }
        }
    }

    /// The sums over all windows. The one at the end counts as well: a short drive has no other.
    fn sums(&self) -> Sums {
        self.complete.with(&self.open)
    }

    fn frame(&self) -> TwistFrame {
        let sums = self.sums();
        let share = |left_m2: f64| left_m2 / sums.steps_m2;
        let (child, parent) = (share(sums.left_child_m2), share(sums.left_parent_m2));
        if sums.steps_m2 <= 0.0 || (child - parent).abs() < 0.01 {
            TwistFrame::Unknown
        } else if parent <= EXPLAINED && 4.0 * parent < child {
            TwistFrame::Parent
        } else if child.min(parent) <= CONTRADICTED {
            TwistFrame::Child
        } else {
            TwistFrame::Neither
        }
    }

    /// Turns of the poses over turns by the twist, if they are far from 1.
    fn wrong_turn_ratio(&self) -> Option<f64> {
        let sums = self.sums();
        let ratio = match sums.turns_rad2 {
            0.0 => f64::INFINITY,
            turns_rad2 => sums.product_rad2 / turns_rad2,
        };
        let has_turned = MIN_TURN_RAD < self.most_rad - self.least_rad;
        (has_turned && !(1.0 / MAX_TURN_RATIO..=MAX_TURN_RATIO).contains(&ratio)).then_some(ratio)
    }

    /// The wheel speeds of a message, after it was added: from its twist, or, while all twists are
    /// 0, from the step of the poses since `last`.
    pub(crate) fn speeds(
        &self,
        last: Option<&OdometryReading>,
        reading: &OdometryReading,
        track_m: f64,
    ) -> Option<WheelSample> {
        if !self.has_twist && 0.0 < self.sums().steps_m2 {
            return speeds_of_step(last?, reading, track_m);
        }
        let [forward_m_s, _] = in_child_frame(reading, self.frame());
        let rate = reading.yaw_rate_rad_s;
        Some(WheelSample::from_twist(reading.stamp_ns, forward_m_s, rate, track_m))
    }
}

/// Computes the wheel speeds of all odometry messages of a topic. `frames` are the parent and the
/// child frame.
pub(crate) fn twist_speeds(
    readings: &[OdometryReading],
    frames: [&str; 2],
    options: &PoseOptions,
) -> Result<WheelSpeeds, WheelError> {
    let mut evidence = TwistEvidence::default();
    readings.iter().for_each(|reading| evidence.add(reading, options.max_speed_m_s));
    let track_m = options.track_m.unwrap_or_default();
    let mut speeds = WheelSpeeds::default();
    let sums = evidence.sums();
    if !evidence.has_twist && 0.0 < sums.steps_m2 {
        let pairs = readings.windows(2);
        let of_pair = |pair: &[OdometryReading]| speeds_of_step(&pair[0], &pair[1], track_m);
        speeds.samples = pairs.filter_map(of_pair).collect();
        let n_messages = readings.len() as u64;
        speeds.notes.push(NoteKind::ZeroTwists { n_messages });
        return Ok(speeds);
    }
    if let Some(ratio) = evidence.wrong_turn_ratio() {
        return Err(WheelError::TwistTurns { ratio });
    }
    let frame = evidence.frame();
    let [parent, child] = frames.map(str::to_owned);
    let (mut forward, mut sideways, mut n) = (0.0, 0.0, 0.0);
    for reading in readings {
        let [x, y] = in_child_frame(reading, frame);
        if x.is_finite() && y.is_finite() {
            forward += x * x;
            sideways += y * y;
            n += 1.0;
        }
        let rate = reading.yaw_rate_rad_s;
        speeds.samples.push(WheelSample::from_twist(reading.stamp_ns, x, rate, track_m));
    }
    let speed_m_s = f64::sqrt((forward + sideways) / n);
    let share = (sideways / (forward + sideways)).sqrt();
    // The velocities of a robot at rest are noise, as large along y as along x.
    if AT_REST_M_S < speed_m_s && MAX_SIDEWAYS_SHARE < share {
        return Err(WheelError::Sideways {
            forward_m_s: f64::sqrt(forward / n),
            sideways_m_s: f64::sqrt(sideways / n),
            frame: if child.is_empty() {
                "the child frame".to_owned()
            } else {
                format!("`{child}`")
            },
            is_frame_known: matches!(frame, TwistFrame::Child | TwistFrame::Parent),
        });
    }
    match frame {
        TwistFrame::Parent => speeds.notes.push(NoteKind::TwistInParentFrame { parent, child }),
        TwistFrame::Neither => {
            let left_m2 = sums.left_child_m2.min(sums.left_parent_m2);
            let left_share = (left_m2 / sums.steps_m2).sqrt();
            speeds.notes.push(NoteKind::TwistContradictsPoses { left_share });
        }
        TwistFrame::Child | TwistFrame::Unknown => {}
    }
    Ok(speeds)
}

/// The velocity along x and y of the child frame.
fn in_child_frame(reading: &OdometryReading, frame: TwistFrame) -> [f64; 2] {
    match (frame, reading.pose) {
        (TwistFrame::Parent, Some(pose)) => rotated(reading.velocity_m_s, -pose.heading_rad),
        _ => reading.velocity_m_s,
    }
}

/// A vector rotated counter-clockwise.
fn rotated([x, y]: [f64; 2], by_rad: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(by_rad);
    [cos * x - sin * y, sin * x + cos * y]
}

/// The motion from one pose to the next.
struct Step {
    secs: f64,
    /// In the parent frame.
    moved_m: [f64; 2],
    turn_rad: f64,
    /// Heading half-way.
    heading_rad: f64,
}

impl Step {
    fn new(from: &OdometryReading, to: &OdometryReading) -> Option<Self> {
        let (a, b) = (from.pose?, to.pose?);
        let secs = to.stamp_ns.saturating_sub(from.stamp_ns) as f64 * 1e-9;
        let turn_rad = dataset::wrap_angle(b.heading_rad - a.heading_rad);
        let moved_m = [b.x_m - a.x_m, b.y_m - a.y_m];
        (0.0 < secs).then_some(Self {
            secs,
            moved_m,
            turn_rad,
            heading_rad: a.heading_rad + 0.5 * turn_rad,
        })
    }

    fn length_m(&self) -> f64 {
        (self.moved_m[0] * self.moved_m[0] + self.moved_m[1] * self.moved_m[1]).sqrt()
    }
}

/// Mean wheel speeds between two poses, at the middle of their stamps.
fn speeds_of_step(
    from: &OdometryReading,
    to: &OdometryReading,
    track_m: f64,
) -> Option<WheelSample> {
    let step = Step::new(from, to)?;
    let [forward_m, _] = rotated(step.moved_m, -step.heading_rad);
    let stamp_ns = from.stamp_ns + (to.stamp_ns - from.stamp_ns) / 2;
    let (forward_m_s, rate) = (forward_m / step.secs, step.turn_rad / step.secs);
    Some(WheelSample::from_twist(stamp_ns, forward_m_s, rate, track_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HZ: f64 = 20.0;

    /// 30 s on a circle at 1 m/s, from heading 60 deg, turning by 0.1 rad/s.
    fn circle() -> Vec<OdometryReading> {
        (0..=600)
            .map(|k| {
                let t = f64::from(k) / HZ;
                let heading = 1.0 + 0.1 * t;
                let (sin, cos) = libm::sincos(heading);
                OdometryReading {
                    stamp_ns: (t * 1e9).round() as i64,
                    pose: Some(Pose2 { x_m: 10.0 * sin, y_m: -10.0 * cos, heading_rad: heading }),
                    velocity_m_s: [1.0, 0.0],
                    yaw_rate_rad_s: 0.1,
                }
            })
            .collect()
    }

    fn with(change: impl Fn(&mut OdometryReading)) -> Vec<OdometryReading> {
        let mut readings = circle();
        readings.iter_mut().for_each(change);
        readings
    }

    /// Turns the velocity from the child frame to the parent frame.
    fn to_parent(reading: &mut OdometryReading) {
        let heading_rad = reading.pose.unwrap().heading_rad;
        reading.velocity_m_s = rotated(reading.velocity_m_s, heading_rad);
    }

    fn speeds(readings: &[OdometryReading]) -> Result<WheelSpeeds, WheelError> {
        let options = PoseOptions { track_m: Some(0.5), ..PoseOptions::default() };
        twist_speeds(readings, ["odom", "base"], &options)
    }

    /// With a track width of 0.5 m the wheels drive at 1 -+ 0.025 m/s.
    #[track_caller]
    fn check(readings: &[OdometryReading], codes: &[&str]) {
        let speeds = speeds(readings).unwrap();
        assert!(600 <= speeds.samples.len());
        for sample in &speeds.samples {
            let [left, right] = [sample.left_m_s - 0.975, sample.right_m_s - 1.025];
            assert!(left.abs() < 1e-3 && right.abs() < 1e-3, "{sample:?}");
        }
        let found: Vec<_> = speeds.notes.iter().map(NoteKind::code).collect();
        assert_eq!(found, codes);
    }

    #[test]
    fn a_twist_in_the_child_frame_is_used_as_it_is() {
        check(&circle(), &[]);
        check(&with(|reading| reading.pose = None), &[]);
        // A localisation that jumps does not matter.
        let mut jumping = circle();
        for reading in &mut jumping[300..] {
            reading.pose = reading.pose.map(|pose| Pose2 { x_m: pose.x_m + 3.0, ..pose });
        }
        check(&jumping, &[]);
    }

    #[test]
    fn a_twist_in_the_parent_frame_is_rotated() {
        check(&with(to_parent), &["twist_in_parent_frame"]);
        // Away from the sideways component: headings of about 180 deg, where x is reversed.
        let west = |reading: &mut OdometryReading| {
            let heading_rad = std::f64::consts::PI;
            let x_m = -reading.stamp_ns as f64 * 1e-9;
            reading.pose = Some(Pose2 { x_m, y_m: 0.0, heading_rad });
            to_parent(reading);
        };
        check(&with(west), &["twist_in_parent_frame"]);
    }

    #[test]
    fn sideways_motion_is_refused() {
        let sideways = with(|reading| reading.velocity_m_s = [0.8, 0.6]);
        let error = speeds(&sideways).unwrap_err();
        assert!(matches!(error, WheelError::Sideways { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains("0.80 m/s along x and 0.60 m/s along y of `base`"), "{text}");
        // Without poses the frame cannot be determined.
        let unknown = with(|reading| {
            to_parent(reading);
            reading.pose = None;
        });
        let error = speeds(&unknown).unwrap_err();
        assert!(matches!(error, WheelError::Sideways { is_frame_known: false, .. }), "{error}");
    }

    #[test]
    fn a_twist_that_is_zero_is_replaced_by_the_poses() {
        let zero = with(|reading| {
            reading.velocity_m_s = [0.0; 2];
            reading.yaw_rate_rad_s = 0.0;
        });
        check(&zero, &["zero_twists"]);
    }

    /// The yaw rate is not written, has the wrong sign, or is in deg/s.
    #[test]
    fn a_yaw_rate_that_contradicts_the_headings_is_refused() {
        for factor in [0.0, -1.0, 57.3] {
            let error = speeds(&with(|reading| reading.yaw_rate_rad_s *= factor)).unwrap_err();
            assert!(matches!(error, WheelError::TwistTurns { .. }), "{factor}: {error}");
        }
    }

    /// Numbers from -1 to 1 that look random, with a mean square of 1/3.
    fn noise(k: usize) -> f64 {
        let x = libm::sin(12.9898 * (k as f64 + 1.0)) * 43_758.545_3;
        2.0 * (x - x.floor()) - 1.0
    }

    /// In 0.05 s the poses move by 5 cm and 0.005 rad. Their noise is 2 cm in x and y, and that of the
    /// yaw rate is 0.2 rad/s, or 0.01 rad in 0.05 s.
    #[test]
    fn noise_that_is_larger_than_a_step_is_not_a_contradiction() {
        let mut readings = circle();
        for (k, reading) in readings.iter_mut().enumerate() {
            let Pose2 { x_m, y_m, heading_rad } = reading.pose.unwrap();
            let [x_m, y_m] = [x_m + 0.035 * noise(3 * k), y_m + 0.035 * noise(3 * k + 1)];
            reading.pose = Some(Pose2 { x_m, y_m, heading_rad });
            reading.yaw_rate_rad_s += 0.35 * noise(3 * k + 2);
        }
        let speeds = speeds(&readings).unwrap();
        assert_eq!(speeds.notes, []);
    }

    /// Noise of the twist of 1 mm/s along x and y.
    #[test]
    fn a_robot_at_rest_does_not_move_sideways() {
        let mut readings = circle();
        let pose = readings[0].pose;
        for (k, reading) in readings.iter_mut().enumerate() {
            reading.pose = pose;
            reading.velocity_m_s = [0.002 * noise(3 * k), 0.002 * noise(3 * k + 1)];
            reading.yaw_rate_rad_s = 0.002 * noise(3 * k + 2);
        }
        assert_eq!(speeds(&readings).unwrap().notes, []);
    }

    /// In km/h: 1 m/s is 3.6, so 2.6 of 1 m is not explained.
    #[test]
    fn a_twist_in_another_unit_is_reported() {
        let speeds = speeds(&with(|reading| reading.velocity_m_s = [3.6, 0.0])).unwrap();
        let [NoteKind::TwistContradictsPoses { left_share }] = speeds.notes[..] else {
            panic!("{:?}", speeds.notes);
        };
        assert!((left_share - 2.6).abs() < 1e-2, "{left_share}");
    }

    /// The decision is made from the messages so far: after the first step it is right.
    #[test]
    fn the_frame_is_found_while_the_log_is_read() {
        for readings in [circle(), with(to_parent)] {
            let mut evidence = TwistEvidence::default();
            let mut last = None;
            for (k, reading) in readings.iter().enumerate() {
                evidence.add(reading, 15.0);
                let sample = evidence.speeds(last.as_ref(), reading, 0.5).unwrap();
                assert!(k == 0 || (sample.left_m_s - 0.975).abs() < 1e-3, "{k}: {sample:?}");
                last = Some(*reading);
            }
        }
    }
}
