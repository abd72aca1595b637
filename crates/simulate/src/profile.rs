//! The speed of the robot along its path: slower in turns, with regular stops.

use crate::path::Path;
use crate::random::Random;

/// Limits of the acceleration along and across the path, relative to the square of the cruising
/// speed \[1/m\]. At 2.4 m/s these are 0.3 and 1.3 m/s^2.
const ALONG: f64 = 0.05;
const ACROSS: f64 = 0.22;
/// The robot finishes slowing down this far before a turn, and speeds up this far after it \[m\].
const BEFORE_TURN_M: f64 = 3.0;
/// Minimum and maximum distance between two stops \[m\].
const STOP_EVERY_M: (f64, f64) = (45.0, 85.0);
/// Minimum and maximum duration of a stop, as the distance that the robot would cruise in that time
/// \[m\]. At 2.4 m/s these are 2 and 4 s.
const STOP: (f64, f64) = (4.8, 9.6);

/// Time, distance and speed at one point of the profile. The acceleration is constant up to the next
/// knot.
#[derive(Debug, Clone, Copy)]
struct Knot {
    time_s: f64,
    travel_m: f64,
    speed_m_s: f64,
    acceleration: f64,
}

/// Distance as a function of time. Before the start and after the end the speed is constant.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    knots: Vec<Knot>,
}

impl Profile {
    /// A profile that covers the first `length_m` of a path in `duration_s`.
    pub(crate) fn new(path: &Path, length_m: f64, duration_s: f64, random: &mut Random) -> Self {
        // All speeds are relative to the cruising speed, until they are scaled to the duration below.
        let mut travels_m = Vec::new();
        let mut limits = Vec::new();
        let mut stops = Vec::new();
        let mut stop_m = random.uniform(STOP_EVERY_M.0, STOP_EVERY_M.1);
        let curvatures: Vec<(f64, f64)> =
            path.curvatures().take_while(|(travel_m, _)| *travel_m < length_m).collect();
        for (k, &(travel_m, _)) in curvatures.iter().enumerate() {
            let near = |(other_m, _): &&(f64, f64)| (other_m - travel_m).abs() <= BEFORE_TURN_M;
            let around = curvatures[..k].iter().rev().take_while(near);
            let around = around.chain(curvatures[k..].iter().take_while(near));
            let curvature = around.map(|(_, curvature)| *curvature).fold(0.0, f64::max);
            let is_stop = stop_m <= travel_m && curvature < 0.1;
            if is_stop {
                stops.push((travels_m.len(), random.uniform(STOP.0, STOP.1)));
                stop_m = travel_m + random.uniform(STOP_EVERY_M.0, STOP_EVERY_M.1);
            }
            travels_m.push(travel_m);
            let limit = (ACROSS / curvature.max(1e-9)).sqrt().min(1.0);
            limits.push(if is_stop { 0.0 } else { limit });
        }
        travels_m.push(length_m);
        limits.push(1.0);
        // v^2 grows by at most 2 a ds, forwards and backwards.
        let reach = |from: f64, ds: f64| (from * from + 2.0 * ALONG * ds).sqrt();
        for k in 1..limits.len() {
            limits[k] = limits[k].min(reach(limits[k - 1], travels_m[k] - travels_m[k - 1]));
        }
        for k in (1..limits.len()).rev() {
            limits[k - 1] = limits[k - 1].min(reach(limits[k], travels_m[k] - travels_m[k - 1]));
        }
        let mut knots = Vec::with_capacity(travels_m.len() + stops.len());
        let mut time_s = 0.0;
        let mut stops = stops.into_iter().peekable();
        for (k, (&travel_m, &speed)) in travels_m.iter().zip(&limits).enumerate() {
            if 0 < k {
                time_s += 2.0 * (travel_m - travels_m[k - 1]) / (speed + limits[k - 1]);
            }
            if let Some((_, wait_s)) = stops.next_if(|(at, _)| *at == k) {
                knots.push(Knot { time_s, travel_m, speed_m_s: 0.0, acceleration: 0.0 });
                time_s += wait_s;
            }
            knots.push(Knot { time_s, travel_m, speed_m_s: speed, acceleration: 0.0 });
        }
        let scale = duration_s / time_s;
        for knot in &mut knots {
            knot.time_s *= scale;
            knot.speed_m_s /= scale;
        }
        for k in 1..knots.len() {
            let (a, b) = (knots[k - 1], knots[k]);
            knots[k - 1].acceleration = (b.speed_m_s - a.speed_m_s) / (b.time_s - a.time_s);
        }
        Self { knots }
    }

    /// Distance and speed at a time \[m, m/s\].
    pub(crate) fn at(&self, time_s: f64) -> (f64, f64) {
        let after = self.knots.partition_point(|knot| knot.time_s <= time_s);
        let knot = &self.knots[after.max(1) - 1];
        let dt = time_s - knot.time_s;
        let acceleration = if time_s < 0.0 { 0.0 } else { knot.acceleration };
        let travel_m = knot.travel_m + dt * (knot.speed_m_s + 0.5 * acceleration * dt);
        (travel_m, knot.speed_m_s + acceleration * dt)
    }
}
