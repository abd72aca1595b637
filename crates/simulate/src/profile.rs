//! How fast a drive goes along its path: slower in turns, with stops on longer ways.

use crate::path::Path;
use crate::random::Random;

/// Limits of the acceleration along the path and across it, relative to the square of the cruising
/// speed \[1/m\]: 0.3 and 1.3 m/s^2 at 2.4 m/s.
const ALONG: f64 = 0.05;
const ACROSS: f64 = 0.22;
/// The robot has slowed down this much before a turn, and speeds up this much after it \[m\].
const BEFORE_TURN_M: f64 = 3.0;
/// Way between two stops, drawn from these limits \[m\].
const STOP_EVERY_M: (f64, f64) = (45.0, 85.0);
/// Time of a stop, relative to cruising for a metre, drawn from these limits \[m\]: 2 to 4 s at
/// 2.4 m/s.
const STOP: (f64, f64) = (4.8, 9.6);

/// From when on the robot is where, with constant acceleration to the next.
#[derive(Debug, Clone, Copy)]
struct Knot {
    time_s: f64,
    way_m: f64,
    speed_m_s: f64,
    acceleration: f64,
}

/// Way by time. Before the start and after the end the robot keeps its speed there.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    knots: Vec<Knot>,
}

impl Profile {
    /// Along the first `length_m` of a path in `duration_s`.
    pub(crate) fn new(path: &Path, length_m: f64, duration_s: f64, random: &mut Random) -> Self {
        // All speeds are relative to the cruising speed until the duration settles it.
        let mut ways = Vec::new();
        let mut limits = Vec::new();
        let mut stops = Vec::new();
        let mut stop_m = random.uniform(STOP_EVERY_M.0, STOP_EVERY_M.1);
        let curvatures: Vec<(f64, f64)> =
            path.curvatures().take_while(|(way_m, _)| *way_m < length_m).collect();
        for (k, &(way_m, _)) in curvatures.iter().enumerate() {
            let near = |(other_m, _): &&(f64, f64)| (other_m - way_m).abs() <= BEFORE_TURN_M;
            let around = curvatures[..k].iter().rev().take_while(near);
            let around = around.chain(curvatures[k..].iter().take_while(near));
            let curvature = around.map(|(_, curvature)| *curvature).fold(0.0, f64::max);
            let is_stop = stop_m <= way_m && curvature < 0.1;
            if is_stop {
                stops.push((ways.len(), random.uniform(STOP.0, STOP.1)));
                stop_m = way_m + random.uniform(STOP_EVERY_M.0, STOP_EVERY_M.1);
            }
            ways.push(way_m);
            let limit = (ACROSS / curvature.max(1e-9)).sqrt().min(1.0);
            limits.push(if is_stop { 0.0 } else { limit });
        }
        ways.push(length_m);
        limits.push(1.0);
        // v^2 grows by no more than 2 a ds, forwards and backwards.
        let reach = |from: f64, ds: f64| (from * from + 2.0 * ALONG * ds).sqrt();
        for k in 1..limits.len() {
            limits[k] = limits[k].min(reach(limits[k - 1], ways[k] - ways[k - 1]));
        }
        for k in (1..limits.len()).rev() {
            limits[k - 1] = limits[k - 1].min(reach(limits[k], ways[k] - ways[k - 1]));
        }
        let mut knots = Vec::with_capacity(ways.len() + stops.len());
        let mut time_s = 0.0;
        let mut stops = stops.into_iter().peekable();
        for (k, (&way_m, &speed)) in ways.iter().zip(&limits).enumerate() {
            if 0 < k {
                time_s += 2.0 * (way_m - ways[k - 1]) / (speed + limits[k - 1]);
            }
            if let Some((_, wait_s)) = stops.next_if(|(at, _)| *at == k) {
                knots.push(Knot { time_s, way_m, speed_m_s: 0.0, acceleration: 0.0 });
                time_s += wait_s;
            }
            knots.push(Knot { time_s, way_m, speed_m_s: speed, acceleration: 0.0 });
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

    /// Way and speed after some time \[s -> m, m/s\].
    pub(crate) fn at(&self, time_s: f64) -> (f64, f64) {
        let after = self.knots.partition_point(|knot| knot.time_s <= time_s);
        let knot = &self.knots[after.max(1) - 1];
        let dt = time_s - knot.time_s;
        let acceleration = if time_s < 0.0 { 0.0 } else { knot.acceleration };
        let way_m = knot.way_m + dt * (knot.speed_m_s + 0.5 * acceleration * dt);
        (way_m, knot.speed_m_s + acceleration * dt)
    }
}
