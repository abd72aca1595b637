//! A drive: the robot's path along the corridors, its clock, and the building on that day.

use std::f64::consts::TAU;

use dataset::Pose2;

use crate::Options;
use crate::clutter::{Person, people_of_day, walls_of_day};
use crate::plan::Plan;
use crate::random::{Purpose, Random};
use crate::sensor::MAX_RANGE_M;
use crate::walls::{Point, Segment, Vector, Walls};

/// The first drive's day and hour: 2024-03-04 08:00 UTC \[s since the epoch\]. Every further drive
/// is a day later.
const FIRST_HOUR_S: i64 = 1_709_539_200;
const HOUR_S: i64 = 3_600;
const DAY_S: i64 = 24 * HOUR_S;
/// The first drive passes the top of the hour at this share of its duration.
const HOUR_PASSED_AT: f64 = 0.4;
/// The sensor starts this much after the robot and stops at least this much before it, so that
/// there is a true pose before the first firing and after the last \[ns\].
pub(crate) const MARGIN_NS: i64 = 100_000_000;

/// One drive through the building.
#[derive(Debug, Clone)]
pub struct Drive {
    path: Path,
    speed_m_s: f64,
    start_ns: i64,
    end_ns: i64,
    walls: Walls,
    people: Vec<Person>,
    start_azimuth_counts: f64,
}

impl Drive {
    pub(crate) fn new(plan: &Plan, options: &Options, seed: u64, log: usize) -> Self {
        let random = |purpose| Random::new(seed, purpose, log, 0);
        let mut draws = random(Purpose::Drive);
        let path = Path::new(plan, options.length_m, log % 2 == 1, &mut draws);

        let duration_ns = (options.duration_s() * 1e9).floor() as i64;
        let hour_ns = (FIRST_HOUR_S + HOUR_S + log as i64 * DAY_S) * 1_000_000_000;
        let start_ns = match log {
            0 => hour_ns - (HOUR_PASSED_AT * duration_ns as f64) as i64,
            _ => hour_ns + (draws.uniform(300.0, 2700.0) * 1e9) as i64,
        };
        Self {
            path,
            speed_m_s: options.speed_m_s,
            start_ns,
            end_ns: start_ns + duration_ns,
            walls: walls_of_day(plan, &mut random(Purpose::Day)),
            people: people_of_day(plan, options.people, &mut random(Purpose::People)),
            start_azimuth_counts: draws.uniform(0.0, 36_000.0),
        }
    }

    /// When the robot starts \[ns since the epoch\].
    pub fn start_ns(&self) -> i64 {
        self.start_ns
    }

    /// When it arrives \[ns since the epoch\].
    pub fn end_ns(&self) -> i64 {
        self.end_ns
    }

    /// When the sensor fires first \[ns since the epoch\].
    pub fn first_firing_ns(&self) -> i64 {
        self.start_ns + MARGIN_NS
    }

    /// The true pose of the robot, and of the sensor at its origin, in the map frame; before the
    /// start and after the end the robot stands still.
    pub fn pose_at(&self, stamp_ns: i64) -> Pose2 {
        let (position, forward) = self.position_at(stamp_ns);
        let heading_rad = libm::atan2(forward.y, forward.x);
        Pose2 { x_m: position.x, y_m: position.y, heading_rad }
    }

    /// Position and the unit vector forward.
    pub(crate) fn position_at(&self, stamp_ns: i64) -> (Point, Vector) {
        self.path.at(self.speed_m_s * self.seconds_since_start(stamp_ns))
    }

    /// All walls of the day: of the building, its doors and its furniture.
    pub fn segments(&self) -> &[Segment] {
        self.walls.segments()
    }

    /// Distance from a position to the nearest wall in a direction (counter-clockwise from x of
    /// the map frame), none beyond the sensor's range; people do not count.
    pub fn range_m(&self, position: Point, bearing_rad: f64) -> Option<f64> {
        let (sin, cos) = libm::sincos(bearing_rad);
        self.walls.cast(position, Vector::new(cos, sin), MAX_RANGE_M).map(|hit| hit.range_m)
    }

    pub(crate) fn walls(&self) -> &Walls {
        &self.walls
    }

    /// Where everybody is.
    pub(crate) fn people_at(&self, stamp_ns: i64) -> Vec<Point> {
        let time_s = self.seconds_since_start(stamp_ns);
        self.people.iter().map(|person| person.position(time_s)).collect()
    }

    /// Azimuth of the first firing \[0.01 deg\].
    pub(crate) fn start_azimuth_counts(&self) -> f64 {
        self.start_azimuth_counts
    }

    fn seconds_since_start(&self, stamp_ns: i64) -> f64 {
        (stamp_ns - self.start_ns) as f64 * 1e-9
    }
}

/// Nodes (column, row) of the loops that a drive goes around, one after the other, for ever. All
/// share the corner (0, 0) and the corridors beside it, so that every loop revisits parts of those
/// before it. Counter-clockwise; every other drive takes them the other way around.
const LOOPS: [&[(usize, usize)]; 4] = [
    &[(0, 0), (1, 0), (1, 1), (0, 1)],
    &[(0, 0), (1, 0), (1, 1), (1, 2), (0, 2), (0, 1)],
    &[(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)],
    &[(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)],
];
/// Distance between control points, about \[m\].
///
/// Between two corridors at a right angle, control points at half this distance before and after
/// the corner give a smallest radius of spacing / sqrt(2) = 1.3 m, and cut the corner by
/// 0.383 x spacing = 0.7 m: 0.6 m from the inner corner of two corridors 1.8 m wide.
const SPACING_M: f64 = 1.8;
/// Steps of the table of path lengths in a span between control points.
const STEPS_PER_SPAN: usize = 8;
/// The robot sways about the middle of the corridor: two waves of these amplitudes \[m\] and of
/// wavelengths drawn from these limits \[m\].
const SWAY: [(f64, (f64, f64)); 2] = [(0.12, (18.0, 30.0)), (0.08, (7.0, 12.0))];

/// A smooth path: a uniform cubic B-spline, so curvature is continuous, by length along it.
///
/// Memory: about 45 bytes per metre.
#[derive(Debug, Clone)]
struct Path {
    control: Vec<Point>,
    /// Length from the start to each step of each span \[m\].
    lengths: Vec<f64>,
}

impl Path {
    fn new(plan: &Plan, length_m: f64, is_clockwise: bool, random: &mut Random) -> Self {
        let lap = lap(plan, is_clockwise);
        // Somewhere in the first corridor; both that a drive can begin with are longer.
        let start = random.index(lap.len() / 32);
        let waves = SWAY.map(|(amplitude_m, (low, high))| {
            (amplitude_m, TAU * SPACING_M / random.uniform(low, high), random.uniform(0.0, TAU))
        });
        let control_point = |k: usize| {
            let (middle, left) = lap[(start + k) % lap.len()];
            let wave =
                |(amplitude_m, rate, phase)| amplitude_m * libm::sin(rate * k as f64 + phase);
            middle + left * waves.iter().map(|&w| wave(w)).sum::<f64>()
        };

        let mut path = Self { control: (0..3).map(control_point).collect(), lengths: vec![0.0] };
        let mut total_m = 0.0;
        while total_m <= length_m {
            path.control.push(control_point(path.control.len()));
            let span = path.control.len() - 4;
            for step in 0..STEPS_PER_SPAN {
                let h = 1.0 / STEPS_PER_SPAN as f64;
                total_m += path.stretch_m(span, step as f64 * h, h);
                path.lengths.push(total_m);
            }
        }
        path
    }

    /// Position and unit tangent after `length_m`.
    fn at(&self, length_m: f64) -> (Point, Vector) {
        let after = self.lengths.partition_point(|&l| l <= length_m);
        let step = after.clamp(1, self.lengths.len() - 1) - 1;
        let (from, to) = (self.lengths[step], self.lengths[step + 1]);
        let rest_m = (length_m - from).clamp(0.0, to - from);
        // In proportion first, then one step of Newton's method: good to a millionth of the step.
        let h = 1.0 / STEPS_PER_SPAN as f64;
        let (span, u0) = (step / STEPS_PER_SPAN, (step % STEPS_PER_SPAN) as f64 * h);
        let guess = h * rest_m / (to - from);
        let error_m = self.stretch_m(span, u0, guess) - rest_m;
        let u = u0 + guess - error_m / self.spline(span, u0 + guess).1.norm();
        let (position, tangent) = self.spline(span, u);
        (position, tangent.normalize())
    }

    /// Length of span `k` from `u` to `u + h`, by Simpson's rule \[m\].
    fn stretch_m(&self, k: usize, u: f64, h: f64) -> f64 {
        let speed = |u: f64| self.spline(k, u).1.norm();
        h / 6.0 * (speed(u) + 4.0 * speed(u + h / 2.0) + speed(u + h))
    }

    /// Value and derivative of the B-spline's span between control points `k + 1` and `k + 2`, at
    /// `u` from 0 to 1.
    fn spline(&self, k: usize, u: f64) -> (Point, Vector) {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| self.control[k + i].coords);
        let v = 1.0 - u;
        let position = a * (v * v * v)
            + b * (3.0 * u * u * u - 6.0 * u * u + 4.0)
            + c * (3.0 * v * v * v - 6.0 * v * v + 4.0)
            + d * (u * u * u);
        let derivative =
            d * (u * u) - a * (v * v) + b * (3.0 * u * u - 4.0 * u) - c * (3.0 * v * v - 4.0 * v);
        (Point::from(position / 6.0), derivative / 2.0)
    }
}

/// Control points in the middle of the corridors, each with the direction to its left, once
/// through all loops.
fn lap(plan: &Plan, is_clockwise: bool) -> Vec<(Point, Vector)> {
    let order = if is_clockwise { [0, 3, 2, 1] } else { [0, 1, 2, 3] };
    let nodes = order.into_iter().flat_map(|k| {
        let mut nodes = LOOPS[k].to_vec();
        if is_clockwise {
            nodes[1..].reverse();
        }
        nodes
    });
    let nodes: Vec<Point> = nodes.map(|(column, row)| plan.nodes[column][row]).collect();

    let mut points = Vec::new();
    for (a, b) in nodes.iter().zip(nodes.iter().cycle().skip(1)) {
        let edge = b - a;
        let forward = edge.normalize();
        let n = (edge.norm() / SPACING_M).round() as usize;
        points.extend((0..n).map(|k| {
            let share = (k as f64 + 0.5) / n as f64;
            (a + edge * share, Vector::new(-forward.y, forward.x))
        }));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(seed: u64, log: usize, length_m: f64) -> Drive {
        let options = Options { length_m, people: 0, ..Options::default() };
        Drive::new(&Plan::new(&mut Random::new(seed, Purpose::Plan, 0, 0)), &options, seed, log)
    }

    #[test]
    fn speed_is_constant_and_turns_are_smooth() {
        for log in 0..2 {
            let drive = drive(5, log, 400.0);
            let step_ns = 5_000_000;
            let (mut turned_rad, mut fastest_rad) = (0.0, 0.0f64);
            for k in 0..(drive.end_ns() - drive.start_ns()) / step_ns {
                let at = drive.start_ns() + k * step_ns;
                let (a, b) = (drive.pose_at(at), drive.pose_at(at + step_ns));
                let moved_m = a.distance_m(&b);
                assert!((moved_m - 0.010).abs() < 0.000_000_5, "{moved_m} m at step {k}");
                let turn = dataset::wrap_angle(b.heading_rad - a.heading_rad);
                fastest_rad = fastest_rad.max(turn.abs());
                turned_rad += turn;
            }
            // 0.010 m at the smallest radius of 1.27 m, less the sway's, is 0.0079 rad.
            assert!(fastest_rad < 0.010, "{fastest_rad} rad in 10 mm");
            // More than one loop, in the direction of the drive.
            let direction = if log % 2 == 0 { 1.0 } else { -1.0 };
            assert!(TAU < direction * turned_rad, "{turned_rad} rad");
        }
    }

    /// All around the lap, about 980 m, in several buildings and on several days.
    #[test]
    fn the_robot_keeps_clear_of_walls() {
        for (seed, log) in [(1, 0), (2, 1), (3, 2), (4, 3), (2436, 0), (2436, 1)] {
            let drive = drive(seed, log, 1000.0);
            for k in 0..5000 {
                let at = drive.start_ns() + (drive.end_ns() - drive.start_ns()) * k / 5000;
                let (position, _) = drive.position_at(at);
                let clear_m = (drive.segments().iter())
                    .map(|segment| segment.distance_m(position))
                    .fold(f64::MAX, f64::min);
                assert!(0.4 < clear_m, "seed {seed}, log {log}: {clear_m} m at {position}");
            }
        }
    }

    #[test]
    fn places_are_revisited_and_far_apart() {
        for log in 0..2 {
            let drive = drive(9, log, 400.0);
            let places: Vec<Pose2> =
                (0..800) // every 0.5 m
                    .map(|k| drive.pose_at(drive.start_ns() + k * 250_000_000))
                    .collect();
            let is_revisit = |k: usize| {
                let earlier = &places[..k.saturating_sub(100)];
                earlier.iter().any(|place| place.distance_m(&places[k]) < 1.0)
            };
            let n_revisits = (0..places.len()).filter(|&k| is_revisit(k)).count();
            assert!(100 < n_revisits, "{n_revisits} of {}", places.len());
            let farthest_m = (places.iter())
                .flat_map(|a| places.iter().map(|b| a.distance_m(b)))
                .fold(0.0, f64::max);
            assert!(60.0 < farthest_m, "{farthest_m} m");
        }
    }

    #[test]
    fn the_first_drive_passes_the_top_of_the_hour_and_others_come_a_day_later_each() {
        let hour = |ns: i64| ns.div_euclid(3_600_000_000_000);
        let drives = [0, 1, 2].map(|log| drive(1, log, 400.0));
        assert_eq!(hour(drives[0].first_firing_ns()) + 1, hour(drives[0].end_ns()));
        assert_eq!(hour(drives[1].start_ns()), hour(drives[0].end_ns()) + 24);
        assert_eq!(hour(drives[2].start_ns()), hour(drives[0].end_ns()) + 48);
    }
}
