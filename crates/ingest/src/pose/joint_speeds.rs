//! Wheel joints over time -> wheel speeds.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use dataset::{LossKind, Losses, NoteKind};
use fuse::WheelSample;

use crate::pose::joints::Naming;
use crate::pose::wheel_error::WheelError;
use crate::pose_options::PoseOptions;

/// Positions that stay within one turn, up to rounding to `f32`, can be wrapped \[rad\].
const ONE_TURN_RAD: f64 = TAU + 1e-3;
/// A wrapped joint that turns by more than this from one message to the next is close to half a
/// turn, where the direction is no longer known \[rad\]. The margin is for changes of speed.
const MAX_STEP_RAD: f64 = 0.75 * PI;
/// A time between two messages is longer than usual if it is more than this many times the median.
const LONG_STEP: f64 = 1.5;
/// Messages within this share of the mean time between two messages are a burst: they waited somewhere,
/// and were stamped on arrival. Times of drivers that stamp at the measurement vary by less.
const BURST_SHARE: f64 = 0.25;
/// Longer times between two messages are pauses, which do not count in the mean \[ns\].
const PAUSE_NS: i64 = 1_000_000_000;
/// A step of a joint is a jump if it is this many times the usual step, and neither of its
/// neighbours is a third as long. The speed of a robot changes within several messages.
const JUMP: f64 = 5.0;
/// Velocities and positions contradict each other if their ratio is farther from 1 than this
/// factor. Filters and rounding in drivers change it by a few percent.
const MAX_VELOCITY_RATIO: f64 = 1.5;
/// Shorter paths of a wheel are too short to check its velocities \[rad or m\].
const MIN_PATH: f64 = 0.5;

/// Whether a step of a position can come from wrapping it to one turn.
pub(crate) fn is_wrap(from_rad: f64, to_rad: f64) -> bool {
    let is_in_turn = |p: f64| (-PI - 1e-3..=ONE_TURN_RAD).contains(&p);
    PI < (to_rad - from_rad).abs() && is_in_turn(from_rad) && is_in_turn(to_rad)
}

/// The wheels among the joints of a message.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct JointSet {
    pub(crate) naming: Naming,
    /// The names of the wheels on the left, in alphabetical order.
    pub(crate) left: Vec<String>,
    /// The names of the wheels on the right, in alphabetical order.
    pub(crate) right: Vec<String>,
}

/// The wheels in one message: the left ones, then the right ones.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct JointReading {
    pub(crate) stamp_ns: i64,
    pub(crate) joints: Arc<JointSet>,
    /// \[rad or m\]; empty if the message has none.
    pub(crate) positions: Vec<f64>,
    /// \[rad/s or m/s\]; empty if the message has none.
    pub(crate) velocities: Vec<f64>,
}

impl JointReading {
    /// The speeds of the left and the right side in the velocities, times `scale`.
    pub(crate) fn speeds(&self, scale: f64) -> Option<WheelSample> {
        let [left, right] = self.means(&self.velocities)?;
        let (left_m_s, right_m_s) = (left * scale, right * scale);
        Some(WheelSample { stamp_ns: self.stamp_ns, left_m_s, right_m_s })
    }

    /// The means of values over the wheels of each side.
    fn means(&self, values: &[f64]) -> Option<[f64; 2]> {
        let (left, right) = values.split_at_checked(self.joints.left.len())?;
        let mean = |side: &[f64]| side.iter().sum::<f64>() / side.len() as f64;
        (!left.is_empty() && !right.is_empty()).then(|| [mean(left), mean(right)])
    }
}

/// The wheel speeds in the messages of a topic.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct WheelSpeeds {
    pub(crate) samples: Vec<WheelSample>,
    pub(crate) notes: Vec<NoteKind>,
    pub(crate) losses: Losses,
}

/// Computes the wheel speeds of a topic.
///
/// The velocities are used if there are any. The positions are used if there are no velocities, if
/// the velocities are zero while the positions change, or if the two contradict each other.
pub(crate) fn joint_speeds(
    readings: &[JointReading],
    options: &PoseOptions,
) -> Result<WheelSpeeds, WheelError> {
    let mut speeds = WheelSpeeds::default();
    let Some(best) = readings.iter().map(|reading| reading.joints.naming).min() else {
        return Ok(speeds);
    };
    let mut sets: BTreeMap<&JointSet, Vec<&JointReading>> = BTreeMap::new();
    for reading in readings {
        // Joints with a less clear name are those of an arm. The notes list the ones that are used.
        if reading.joints.naming == best {
            sets.entry(&reading.joints).or_default().push(reading);
        }
    }
    for (set, readings) in &sets {
        let [left, right] = [&set.left, &set.right].map(|side| format!("`{}`", side.join("`, `")));
        let before = speeds.samples.len();
        let source = add_set(readings, options, &mut speeds)?;
        let n_messages = readings.len() as u64;
        if before < speeds.samples.len() {
            speeds.notes.push(NoteKind::WheelJoints { left, right, source, n_messages });
        }
    }
    if 1 < sets.len() {
        speeds.samples.sort_by_key(|sample| sample.stamp_ns);
    }
    Ok(speeds)
}

/// Adds the speeds of one set of wheels. Returns what they were computed from.
fn add_set(
    readings: &[&JointReading],
    options: &PoseOptions,
    speeds: &mut WheelSpeeds,
) -> Result<String, WheelError> {
    let scale = options.wheel_radius_m.unwrap_or(1.0);
    let velocities: Vec<WheelSample> = readings.iter().filter_map(|r| r.speeds(scale)).collect();
    let has_velocities = velocities.iter().any(|v| (v.left_m_s + v.right_m_s).is_finite());
    let positions = Positions::new(readings, options);
    let track = match &positions {
        Some(positions) if positions.path() < MIN_PATH && has_velocities => None,
        Some(positions) => Some(positions),
        None => None,
    };
    let contradiction = track.filter(|_| has_velocities).and_then(|positions| {
        // Without a radius, the unit of the velocities can differ from that of the positions.
        positions.contradiction(readings, options.wheel_radius_m.is_some())
    });
    // Velocities that contradict ambiguous positions are better than these, unless they are 0.
    let needs_positions = |positions: &Positions| match &contradiction {
        None => !has_velocities,
        Some(NoteKind::ZeroWheelVelocities { .. }) => true,
        Some(_) => positions.ambiguous_rad.is_none(),
    };
    match track {
        Some(positions) if needs_positions(positions) => {
            if let Some(found_rad) = positions.ambiguous_rad {
                let period_s = positions.period_s;
                return Err(WheelError::AmbiguousPositions { found_rad, period_s });
            }
            speeds.notes.extend(contradiction);
            if 0 < positions.n_wraps {
                speeds.notes.push(NoteKind::WheelPositionsUnwrapped { n_turns: positions.n_wraps });
            }
            speeds.losses.add(LossKind::WheelPositionJumps, positions.n_dropped);
            let sensor = || "wheel".to_owned();
            let repeated = LossKind::DuplicateSampleStamps { sensor: sensor() };
            speeds.losses.add(repeated, positions.n_repeated);
            let back = LossKind::SampleStampsStepBack { sensor: sensor() };
            speeds.losses.add(back, positions.n_back);
            speeds.samples.extend(positions.speeds(scale));
            Ok("positions".to_owned())
        }
        _ => {
            speeds.samples.extend(velocities);
            Ok("velocities".to_owned())
        }
    }
}

/// The last message of each burst. Positions add up, so it includes the motion of the others.
fn last_of_bursts<'a>(readings: &[&'a JointReading]) -> Vec<&'a JointReading> {
    let times = readings.windows(2).map(|pair| pair[1].stamp_ns.saturating_sub(pair[0].stamp_ns));
    let times: Vec<i64> = times.filter(|ns| (0..=PAUSE_NS).contains(ns)).collect();
    let mean_ns = times.iter().sum::<i64>() as f64 / times.len() as f64;
    let mut kept: Vec<&JointReading> = Vec::new();
    let mut start_ns = None;
    for &reading in readings {
        let since = start_ns.map(|start_ns| reading.stamp_ns.saturating_sub(start_ns));
        if since.is_some_and(|ns| 0 <= ns && (ns as f64) < BURST_SHARE * mean_ns) {
            kept.pop();
        } else {
            start_ns = Some(reading.stamp_ns);
        }
        kept.push(reading);
    }
    kept
}

/// The steps of the joints of a set from message to message.
struct Positions {
    /// Stamps at the start and the end \[ns\], and the step of each joint; `None` for a step that
    /// is not known.
    steps: Vec<(i64, i64, Option<Vec<f64>>)>,
    n_left: usize,
    n_joints: usize,
    /// How many times a position was unwrapped.
    n_wraps: u64,
    /// Steps that are not known.
    n_dropped: u64,
    /// Messages whose stamp is that of the message before, or earlier.
    n_repeated: u64,
    n_back: u64,
    /// The largest step of a wrapped joint, if it is too large \[rad\].
    ambiguous_rad: Option<f64>,
    /// Median time between two messages \[s\].
    period_s: f64,
}

impl Positions {
    /// `None` without two messages with positions.
    fn new(readings: &[&JointReading], options: &PoseOptions) -> Option<Self> {
        let n_left = readings.first()?.joints.left.len();
        let n_joints = readings.iter().map(|reading| reading.positions.len()).max()?;
        let is_complete = |reading: &&JointReading| {
            reading.positions.len() == n_joints && reading.positions.iter().all(|p| p.is_finite())
        };
        let complete: Vec<&JointReading> = readings.iter().copied().filter(is_complete).collect();
        if n_joints <= n_left || complete.len() < 2 {
            return None;
        }
        let n_with = |is_it: fn(i64, i64) -> bool| {
            let pairs = complete.windows(2);
            pairs.filter(|pair| is_it(pair[0].stamp_ns, pair[1].stamp_ns)).count() as u64
        };
        let (n_repeated, n_back) = (n_with(|from, to| from == to), n_with(|from, to| to < from));
        let complete = last_of_bursts(&complete);
        let pairs = complete.windows(2).filter(|pair| pair[0].stamp_ns < pair[1].stamp_ns);
        let steps = pairs.map(|pair| {
            let steps = pair[0].positions.iter().zip(&pair[1].positions).map(|(a, b)| b - a);
            (pair[0].stamp_ns, pair[1].stamp_ns, Some(steps.collect()))
        });
        let steps: Vec<_> = steps.collect();
        let mut periods: Vec<i64> = steps.iter().map(|(from, to, _)| to - from).collect();
        periods.sort_unstable();
        let period_s = *periods.get(periods.len() / 2)? as f64 * 1e-9;
        let mut positions = Self {
            steps,
            n_left,
            n_joints,
            n_wraps: 0,
            n_dropped: 0,
            n_repeated,
            n_back,
            ambiguous_rad: None,
            period_s,
        };
        // Positions in metres are not wrapped.
        let are_angles = options.wheel_speed_unit.is_none();
        for joint in 0..n_joints {
            let values = || complete.iter().map(|reading| reading.positions[joint]);
            let span =
                values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min);
            let has_long_step = positions.steps_of(joint).any(|(_, step)| PI < step.abs());
            if are_angles && has_long_step && span <= ONE_TURN_RAD {
                positions.unwrap(joint);
            } else {
                let scale = options.wheel_radius_m.unwrap_or(1.0);
                positions.drop_jumps(joint, options.max_speed_m_s / scale);
            }
        }
        positions.n_dropped = positions.steps.iter().filter(|(.., s)| s.is_none()).count() as u64;
        Some(positions)
    }

    /// The known steps of a joint, each with its index.
    fn steps_of(&self, joint: usize) -> impl Iterator<Item = (usize, f64)> {
        let known = self.steps.iter().enumerate();
        known.filter_map(move |(k, (.., steps))| steps.as_ref().map(|steps| (k, steps[joint])))
    }

    fn secs(&self, k: usize) -> f64 {
        (self.steps[k].1 - self.steps[k].0) as f64 * 1e-9
    }

    /// Unwraps a joint by 2 pi. A step after a long time is dropped if the wheel can have turned by
    /// more than half a turn in it.
    fn unwrap(&mut self, joint: usize) {
        let mut fastest: f64 = 0.0;
        let mut last: Option<f64> = None;
        for k in 0..self.steps.len() {
            let is_long = LONG_STEP * self.period_s < self.secs(k);
            let Some(steps) = &mut self.steps[k].2 else { continue };
            let step = dataset::wrap_angle(steps[joint]);
            self.n_wraps += u64::from(step != steps[joint] && PI < steps[joint].abs());
            steps[joint] = step;
            if is_long {
                last = None;
                continue;
            }
            let change = last.map_or(0.0, |last| (step - last).abs());
            let found = step.abs().max(change);
            if MAX_STEP_RAD < found {
                self.ambiguous_rad = Some(self.ambiguous_rad.unwrap_or(0.0).max(found.min(PI)));
            }
            fastest = fastest.max(step.abs());
            last = Some(step);
        }
        for k in 0..self.steps.len() {
            let periods = self.secs(k) / self.period_s;
            if LONG_STEP < periods && PI < fastest * periods {
                self.steps[k].2 = None;
            }
        }
    }

    /// Drops steps that no wheel can make: faster than the robot, or isolated and much longer than
    /// the usual step. The usual step is the shortest one with which a quarter of the path was
    /// driven.
    fn drop_jumps(&mut self, joint: usize, max_speed: f64) {
        let steps: Vec<(usize, f64)> = self.steps_of(joint).collect();
        let rate = |at: usize| steps[at].1.abs() / self.secs(steps[at].0);
        let mut sorted: Vec<f64> = steps.iter().map(|(_, step)| step.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        let quarter = 0.25 * sorted.iter().sum::<f64>();
        let mut path = 0.0;
        let usual = sorted.into_iter().find(|step| {
            path += step;
            quarter <= path
        });
        let usual_rate = usual.unwrap_or(0.0) / self.period_s;
        let is_jump = |at: usize| {
            let neighbours = [at.checked_sub(1), Some(at + 1).filter(|&next| next < steps.len())];
            let is_isolated =
                neighbours.into_iter().flatten().all(|other| 3.0 * rate(other) < rate(at));
            max_speed < rate(at) || (is_isolated && JUMP * usual_rate < rate(at))
        };
        let jumps: Vec<usize> =
            (0..steps.len()).filter(|&at| is_jump(at)).map(|at| steps[at].0).collect();
        jumps.into_iter().for_each(|k| self.steps[k].2 = None);
    }

    /// Mean path of the joints \[rad or m\].
    fn path(&self) -> f64 {
        let of_step = |steps: &Vec<f64>| steps.iter().map(|step| step.abs()).sum::<f64>();
        let sum: f64 =
            self.steps.iter().filter_map(|(.., steps)| steps.as_ref()).map(of_step).sum();
        sum / self.n_joints as f64
    }

    /// Whether the velocities of the same messages contradict the positions: they are all zero, or
    /// their integral is not the step of the positions. The latter is only checked if both have
    /// the same unit.
    fn contradiction(&self, readings: &[&JointReading], is_same_unit: bool) -> Option<NoteKind> {
        let path = self.path();
        let n_messages = readings.len() as u64;
        let is_zero = |reading: &&JointReading| reading.velocities.iter().all(|v| *v == 0.0);
        if readings.iter().all(is_zero) {
            return Some(NoteKind::ZeroWheelVelocities { n_messages, path });
        }
        let by_stamp: BTreeMap<i64, &JointReading> =
            readings.iter().map(|reading| (reading.stamp_ns, *reading)).collect();
        let (mut product, mut of_velocities, mut of_positions) = (0.0, 0.0, 0.0);
        for (from_ns, to_ns, steps) in &self.steps {
            let Some(steps) = steps else { continue };
            let (Some(from), Some(to)) = (by_stamp.get(from_ns), by_stamp.get(to_ns)) else {
                continue;
            };
            let secs = (to_ns - from_ns) as f64 * 1e-9;
            for ((a, b), step) in from.velocities.iter().zip(&to.velocities).zip(steps) {
                let driven = 0.5 * (a + b) * secs;
                if driven.is_finite() {
                    product += driven * step;
                    of_velocities += driven * driven;
                    of_positions += step * step;
                }
            }
        }
        let ratio = product / of_velocities;
        let is_correlated = 0.81 * of_velocities * of_positions < product * product;
        let is_far = !(1.0 / MAX_VELOCITY_RATIO..=MAX_VELOCITY_RATIO).contains(&ratio);
        (is_correlated && is_far && is_same_unit)
            .then_some(NoteKind::WheelVelocitiesContradictPositions { ratio })
    }

    /// The mean speeds of the sides between two messages, at the middle of their stamps.
    fn speeds(&self, scale: f64) -> impl Iterator<Item = WheelSample> {
        self.steps.iter().filter_map(move |(from_ns, to_ns, steps)| {
            let (left, right) = steps.as_ref()?.split_at(self.n_left);
            let dt_ns = to_ns - from_ns;
            let speed = |side: &[f64]| {
                side.iter().sum::<f64>() / side.len() as f64 * scale / (dt_ns as f64 * 1e-9)
            };
            Some(WheelSample {
                stamp_ns: from_ns + dt_ns / 2,
                left_m_s: speed(left),
                right_m_s: speed(right),
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wheel_options::WheelSpeedUnit;

    const RADIUS_M: f64 = 0.1;

    /// Two wheels at 20 Hz for 30 s: the left one drives 0.5 m/s, the right one up to 1 m/s.
    /// `message` makes positions and velocities from the angles and rates.
    fn made(message: &dyn Fn([f64; 2], [f64; 2]) -> (Vec<f64>, Vec<f64>)) -> Vec<JointReading> {
        made_at(20.0, Naming::Wheel, message)
    }

    fn made_at(
        hz: f64,
        naming: Naming,
        message: &dyn Fn([f64; 2], [f64; 2]) -> (Vec<f64>, Vec<f64>),
    ) -> Vec<JointReading> {
        let joints = Arc::new(JointSet {
            naming,
            left: vec!["left".to_owned()],
            right: vec!["right".to_owned()],
        });
        let n = (30.0 * hz) as i64;
        (0..=n)
            .map(|k| {
                let t = k as f64 / hz;
                let right_rad = 10.0 * (0.75 * t - 0.25 * libm::sin(t));
                let right_rad_s = 10.0 * (0.75 - 0.25 * libm::cos(t));
                let (positions, velocities) = message([5.0 * t, right_rad], [5.0, right_rad_s]);
                let stamp_ns = (t * 1e9).round() as i64;
                JointReading { stamp_ns, joints: Arc::clone(&joints), positions, velocities }
            })
            .collect()
    }

    fn options() -> PoseOptions {
        PoseOptions { wheel_radius_m: Some(RADIUS_M), ..PoseOptions::default() }
    }

    /// The paths of both sides \[m\], and the codes of notes and losses.
    fn paths(readings: &[JointReading], options: &PoseOptions) -> ([f64; 2], Vec<&'static str>) {
        let speeds = joint_speeds(readings, options).unwrap();
        let mut paths = [0.0; 2];
        for pair in speeds.samples.windows(2) {
            let secs = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
            paths[0] += 0.5 * (pair[0].left_m_s + pair[1].left_m_s) * secs;
            paths[1] += 0.5 * (pair[0].right_m_s + pair[1].right_m_s) * secs;
        }
        let notes = speeds.notes.iter().map(NoteKind::code).filter(|code| *code != "wheel_joints");
        (paths, notes.chain(speeds.losses.iter().map(|(loss, _)| loss.kind.code())).collect())
    }

    /// 15 m on the left. On the right 0.75 * 30 - 0.25 sin(30) = 22.75 m. From positions, half a
    /// period is missing at both ends.
    #[track_caller]
    fn check(readings: &[JointReading], codes: &[&str]) {
        let (paths, found) = paths(readings, &options());
        let expected = [15.0, 22.5 - 0.25 * libm::sin(30.0)];
        for (path, expected) in paths.iter().zip(expected) {
            assert!((path - expected).abs() < 0.1, "{paths:?}, expected {expected}");
        }
        assert_eq!(found, codes);
    }

    fn wrapped(rad: f64) -> f64 {
        dataset::wrap_angle(rad)
    }

    #[test]
    fn velocities_and_positions_give_the_same_path() {
        check(&made(&|_, rates| (vec![], rates.to_vec())), &[]);
        check(&made(&|angles, _| (angles.to_vec(), vec![])), &[]);
        check(&made(&|angles, rates| (angles.to_vec(), rates.to_vec())), &[]);
        // Positions that are never filled.
        check(&made(&|_, rates| (vec![0.0; 2], rates.to_vec())), &[]);
        check(&made(&|_, rates| (vec![f64::NAN; 2], rates.to_vec())), &[]);
    }

    #[test]
    fn wrapped_positions_are_unwrapped() {
        let codes = ["wheel_positions_unwrapped"];
        check(&made(&|angles, _| (angles.map(wrapped).to_vec(), vec![])), &codes);
        let from_zero = |rad: f64| rad.rem_euclid(TAU);
        check(&made(&|angles, _| (angles.map(from_zero).to_vec(), vec![])), &codes);
        // Backward, and rounded to f32.
        let backward = |rad: f64| f64::from(wrapped(-rad) as f32);
        let readings = made(&|angles, _| (angles.map(backward).to_vec(), vec![]));
        let (paths, _) = paths(&readings, &options());
        assert!((paths[0] + 15.0).abs() < 0.1, "{paths:?}");
        // Only one wheel is wrapped.
        check(&made(&|[left, right], _| (vec![wrapped(left), right], vec![])), &codes);
    }

    /// At 2 Hz the right wheel turns by up to 5 rad between two messages. Positions that are not
    /// wrapped are fine at any rate.
    #[test]
    fn wrapped_positions_with_long_steps_are_refused() {
        let slow = |message: &dyn Fn([f64; 2]) -> Vec<f64>| {
            made_at(2.0, Naming::Wheel, &|angles, _| (message(angles), vec![]))
        };
        let error = joint_speeds(&slow(&|a| a.map(wrapped).to_vec()), &options()).unwrap_err();
        assert!(matches!(error, WheelError::AmbiguousPositions { .. }), "{error}");
        assert_eq!(paths(&slow(&|a| a.to_vec()), &options()).1, [""; 0]);
        // With velocities the positions are not needed.
        let both = made_at(2.0, Naming::Wheel, &|a, r| (a.map(wrapped).to_vec(), r.to_vec()));
        assert_eq!(paths(&both, &options()).1, [""; 0]);
    }

    /// In a pause of 1 s the wheels turn by more than half a turn.
    #[test]
    fn a_step_of_wrapped_positions_after_a_pause_is_dropped() {
        let mut readings = made(&|angles, _| (angles.map(wrapped).to_vec(), vec![]));
        readings.drain(200..220);
        check(&readings, &["wheel_positions_unwrapped", "wheel_position_jumps"]);
    }

    #[test]
    fn zero_velocities_are_replaced_by_positions() {
        check(&made(&|angles, _| (angles.to_vec(), vec![0.0; 2])), &["zero_wheel_velocities"]);
        check(&made(&|angles, _| (angles.to_vec(), vec![f64::NAN; 2])), &[]);
        let wrapped = made(&|angles, _| (angles.map(wrapped).to_vec(), vec![0.0; 2]));
        check(&wrapped, &["zero_wheel_velocities", "wheel_positions_unwrapped"]);
        // A robot at rest.
        let at_rest =
            joint_speeds(&made(&|_, _| (vec![1.0; 2], vec![0.0; 2])), &options()).unwrap();
        assert!(at_rest.samples.len() == 601 && at_rest.notes.len() == 1, "{:?}", at_rest.notes);
    }

    /// Zero velocities and positions that cannot be unwrapped: nothing is left.
    #[test]
    fn zero_velocities_with_ambiguous_positions_are_refused() {
        let zero = made_at(2.0, Naming::Wheel, &|a, _| (a.map(wrapped).to_vec(), vec![0.0; 2]));
        let error = joint_speeds(&zero, &options()).unwrap_err();
        assert!(matches!(error, WheelError::AmbiguousPositions { .. }), "{error}");
    }

    /// Velocities in m/s and positions in rad: the ratio is 1 / 0.1.
    #[test]
    fn velocities_that_contradict_the_positions_are_not_used() {
        let readings = made(&|angles, rates| (angles.to_vec(), rates.map(|r| r * 0.1).to_vec()));
        check(&readings, &["wheel_velocities_contradict_positions"]);
        // The option states that they are in m/s.
        let unit = Some(WheelSpeedUnit::MetresPerSecond);
        let stated = PoseOptions { wheel_speed_unit: unit, ..PoseOptions::default() };
        let (paths, codes) = paths(&readings, &stated);
        assert!((paths[0] - 15.0).abs() < 0.1 && codes.is_empty(), "{paths:?} {codes:?}");
    }

    /// The counters start again at 0, or wrap at two turns.
    #[test]
    fn jumps_of_positions_are_dropped_and_counted() {
        let mut readings = made(&|angles, _| (angles.to_vec(), vec![]));
        let at = readings[300].positions.clone();
        for reading in &mut readings[300..] {
            reading.positions.iter_mut().zip(&at).for_each(|(position, at)| *position -= at);
        }
        check(&readings, &["wheel_position_jumps"]);
        let two_turns = |rad: f64| rad.rem_euclid(2.0 * TAU);
        let readings = made(&|angles, _| (angles.map(two_turns).to_vec(), vec![]));
        check(&readings, &["wheel_position_jumps"]);
    }

    /// Positions at 100 Hz that arrive four at a time, 20 us apart, with arrival as the stamp.
    #[test]
    fn positions_that_arrive_in_bursts_are_used() {
        let in_bursts = |message: &dyn Fn([f64; 2]) -> Vec<f64>| {
            let mut readings = made_at(100.0, Naming::Wheel, &|a, _| (message(a), vec![]));
            for (k, reading) in (0..).zip(&mut readings) {
                reading.stamp_ns = k / 4 * 40_000_000 + k % 4 * 20_000;
            }
            readings
        };
        let readings = in_bursts(&|angles| angles.to_vec());
        check(&readings, &[]);
        assert_eq!(joint_speeds(&readings, &options()).unwrap().samples.len(), 750);
        check(&in_bursts(&|a| a.map(wrapped).to_vec()), &["wheel_positions_unwrapped"]);
    }

    /// Messages at 100 Hz before a slow part, or before a pause, are not a burst.
    #[test]
    fn fast_messages_before_slow_ones_are_kept() {
        let mut readings = made_at(100.0, Naming::Wheel, &|angles, _| (angles.to_vec(), vec![]));
        let all = readings.iter().collect::<Vec<_>>();
        let slow = all.iter().enumerate().filter(|(k, _)| *k < 200 || k % 50 == 0);
        let slow: Vec<_> = slow.map(|(_, reading)| *reading).collect();
        let longest = last_of_bursts(&slow).windows(2).map(|w| w[1].stamp_ns - w[0].stamp_ns).max();
        assert_eq!(longest, Some(500_000_000));
        let n_early = last_of_bursts(&slow).iter().filter(|r| r.stamp_ns < 2_000_000_000).count();
        assert!(50 < n_early, "{n_early}");
        readings.iter_mut().skip(1000).for_each(|reading| reading.stamp_ns += 3_600_000_000_000);
        assert_eq!(last_of_bursts(&readings.iter().collect::<Vec<_>>()).len(), readings.len());
    }

    /// The joints of another publisher are named less clearly. The robot can have an arm.
    #[test]
    fn joints_of_another_publisher_are_not_used() {
        let mut readings = made(&|_, rates| (vec![], rates.to_vec()));
        let others = made_at(20.0, Naming::Side, &|_, _| (vec![], vec![0.0; 2]));
        for (k, other) in others.into_iter().enumerate() {
            readings.insert(2 * k, other);
        }
        check(&readings, &[]);
    }
}
