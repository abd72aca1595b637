//! A drive: the motion of the robot along its path, its clock, and the world on that day.

use std::f64::consts::TAU;

use dataset::{Pose2, wrap_angle};

use crate::Options;
use crate::path::Path;
use crate::people::{Person, people_of_day};
use crate::plane::{Point, Vector};
use crate::profile::Profile;
use crate::random::{Purpose, Random};
use crate::site::Site;
use crate::world::{Surface, World};

/// Hour of the first drive: 2024-03-04 08:00 UTC \[s since the epoch\]. Each further drive is one day
/// later.
const FIRST_HOUR_S: i64 = 1_709_539_200;
const HOUR_S: i64 = 3_600;
const DAY_S: i64 = 24 * HOUR_S;
/// The first drive passes the top of the hour at this fraction of its duration.
const HOUR_PASSED_AT: f64 = 0.4;
/// The lidar starts this much after the robot and stops at least this much before it \[ns\]. There is
/// therefore a ground-truth pose before the first firing and after the last.
pub(crate) const MARGIN_NS: i64 = 100_000_000;
/// Height of the lidar above the floor; the base pitches about the point on the floor below the axle
/// \[m\].
pub const SENSOR_HEIGHT_M: f64 = 0.8;
/// Standard gravity \[m/s^2\].
pub(crate) const GRAVITY_M_S2: f64 = 9.80665;
/// Distance between the points of the path at which furniture keeps clear of the robot \[m\].
const CLEAR_PATH_STEP_M: f64 = 0.2;
/// Half of the window over which the acceleration is computed for the pitch \[s\].
const PITCH_WINDOW_S: f64 = 0.35;
/// Largest pitch of the base \[rad\].
pub(crate) const MAX_PITCH_RAD: f64 = 0.12;

/// Pose, pitch and speed of the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Position of the point midway between the wheels, and heading, in the map frame.
    pub pose: Pose2,
    /// Pitch about the y axis (left): positive when the base leans forward \[rad\].
    pub pitch_rad: f64,
    /// Speed along the path \[m/s\].
    pub speed_m_s: f64,
}

impl Motion {
    /// Position of the lidar in the map frame \[m\]. The base pitches about the point on the floor
    /// below the axle.
    pub fn sensor_position_m(&self) -> [f64; 3] {
        let (sin, cos) = libm::sincos(self.pose.heading_rad);
        let (lean, upright) = libm::sincos(self.pitch_rad);
        [
            self.pose.x_m + SENSOR_HEIGHT_M * lean * cos,
            self.pose.y_m + SENSOR_HEIGHT_M * lean * sin,
            SENSOR_HEIGHT_M * upright,
        ]
    }
}

/// One drive through a site.
#[derive(Debug, Clone)]
pub struct Drive {
    path: Path,
    profile: Profile,
    oscillation: PitchOscillation,
    start_ns: i64,
    end_ns: i64,
    world: World,
    people: Vec<Person>,
    start_azimuth_counts: f64,
}

/// Pitch oscillation of the self-balancing base: the sum of two sines.
#[derive(Debug, Clone, Copy)]
struct PitchOscillation {
    amplitude_rad: f64,
    /// Frequencies \[Hz\] and phases \[rad\].
    waves: [(f64, f64); 2],
}

impl PitchOscillation {
    fn draw(options: &Options, random: &mut Random) -> Self {
        let mut wave = |low, high| (random.uniform(low, high), random.uniform(0.0, TAU));
        let waves = [wave(0.8, 1.3), wave(1.8, 2.6)];
        Self { amplitude_rad: options.rocking_deg.to_radians(), waves }
    }

    fn at(&self, time_s: f64) -> f64 {
        let sine = |(hz, phase): (f64, f64)| libm::sin(TAU * hz * time_s + phase);
        self.amplitude_rad * (0.7 * sine(self.waves[0]) + 0.3 * sine(self.waves[1]))
    }
}

impl Drive {
    pub(crate) fn new(site: &Site, options: &Options, seed: u64, log: usize) -> Self {
        let random = |purpose| Random::new(seed, purpose, log, 0);
        let mut draws = random(Purpose::Drive);
        let route = site.route(log, &mut draws);
        let path = Path::new(&route, options.length_m);

        let duration_ns = (options.duration_s() * 1e9).floor() as i64;
        let hour_ns = (FIRST_HOUR_S + HOUR_S + log as i64 * DAY_S) * 1_000_000_000;
        let start_ns = match log {
            0 => hour_ns - (HOUR_PASSED_AT * duration_ns as f64) as i64,
            _ => hour_ns + (draws.uniform(300.0, 2700.0) * 1e9) as i64,
        };
        let n_steps = (options.length_m / CLEAR_PATH_STEP_M).ceil() as usize;
        let path_points: Vec<Point> =
            (0..=n_steps).map(|k| path.at(k as f64 * CLEAR_PATH_STEP_M).0).collect();
        Self {
            profile: Profile::new(&path, options.length_m, options.duration_s(), &mut draws),
            path,
            oscillation: PitchOscillation::draw(options, &mut draws),
            start_ns,
            end_ns: start_ns + duration_ns,
            world: site.day(&path_points, &mut random(Purpose::Day)),
            people: people_of_day(site.lanes(), options.people, &mut random(Purpose::People)),
            start_azimuth_counts: draws.uniform(0.0, 36_000.0),
        }
    }

    /// Start of the log \[ns since the epoch\].
    pub fn start_ns(&self) -> i64 {
        self.start_ns
    }

    /// End of the log \[ns since the epoch\].
    pub fn end_ns(&self) -> i64 {
        self.end_ns
    }

    /// Time of the first firing of the lidar \[ns since the epoch\].
    pub fn first_firing_ns(&self) -> i64 {
        self.start_ns + MARGIN_NS
    }

    /// Ground truth: the pose of `base_link` in the map frame.
    pub fn pose_at(&self, stamp_ns: i64) -> Pose2 {
        let (travel_m, _) = self.profile.at(self.seconds_since_start(stamp_ns));
        self.pose_on_path(travel_m)
    }

    /// Ground truth: pose, pitch and speed of the base.
    pub fn motion_at(&self, stamp_ns: i64) -> Motion {
        let time_s = self.seconds_since_start(stamp_ns);
        let (travel_m, speed_m_s) = self.profile.at(time_s);
        let pitch_rad = self.pitch_rad(time_s);
        Motion { pose: self.pose_on_path(travel_m), pitch_rad, speed_m_s }
    }

    /// Distance along the path \[m\].
    pub(crate) fn travel_m(&self, stamp_ns: i64) -> f64 {
        self.profile.at(self.seconds_since_start(stamp_ns)).0
    }

    fn pose_on_path(&self, travel_m: f64) -> Pose2 {
        let (position, forward) = self.path.at(travel_m);
        let heading_rad = wrap_angle(libm::atan2(forward.y, forward.x));
        Pose2 { x_m: position.x, y_m: position.y, heading_rad }
    }

    /// A balancing base pitches by acceleration / gravity. The acceleration is the second difference
    /// of the distance over a window. The base therefore leans smoothly, and before it speeds up.
    pub(crate) fn pitch_rad(&self, time_s: f64) -> f64 {
        if self.oscillation.amplitude_rad <= 0.0 {
            return 0.0;
        }
        let travel_m = |time_s| self.profile.at(time_s).0;
        let second = travel_m(time_s + PITCH_WINDOW_S) - 2.0 * travel_m(time_s)
            + travel_m(time_s - PITCH_WINDOW_S);
        let pitch =
            second / (PITCH_WINDOW_S * PITCH_WINDOW_S * GRAVITY_M_S2) + self.oscillation.at(time_s);
        let share = pitch / MAX_PITCH_RAD;
        pitch / (1.0 + share * share).sqrt()
    }

    /// Ground truth: all vertical surfaces on that day.
    pub fn surfaces(&self) -> &[Surface] {
        self.world.surfaces()
    }

    /// Height of the ceiling above a position; infinite outdoors \[m\].
    pub fn ceiling_m(&self, at: Point) -> f64 {
        self.world.ceiling_m(at)
    }

    pub(crate) fn world(&self) -> &World {
        &self.world
    }

    /// Positions of all people.
    pub(crate) fn people_at(&self, stamp_ns: i64) -> Vec<Point> {
        let time_s = self.seconds_since_start(stamp_ns);
        self.people.iter().map(|person| person.position(time_s)).collect()
    }

    /// Azimuth of the first firing \[0.01 deg\].
    pub(crate) fn start_azimuth_counts(&self) -> f64 {
        self.start_azimuth_counts
    }

    pub(crate) fn seconds_since_start(&self, stamp_ns: i64) -> f64 {
        (stamp_ns - self.start_ns) as f64 * 1e-9
    }
}

/// Unit vector in the direction of a heading.
pub(crate) fn forward(heading_rad: f64) -> Vector {
    let (sin, cos) = libm::sincos(heading_rad);
    Vector::new(cos, sin)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(seed: u64, log: usize, buildings: u32, length_m: f64) -> Drive {
        let options = Options { length_m, people: 0, buildings, ..Options::default() };
        let mut random = Random::new(seed, Purpose::Plan, 0, 0);
        let site = match buildings {
            1 => Site::building(&mut random),
            n => Site::campus(n, &mut random),
        };
        Drive::new(&site, &options, seed, log)
    }

    #[test]
    fn speed_and_heading_change_smoothly_and_the_robot_stops_sometimes() {
        for (log, buildings) in [(0, 1), (1, 1), (0, 3), (1, 3)] {
            let drive = drive(5, log, buildings, 400.0);
            let step_ns = 5_000_000;
            let (mut travel_m, mut n_still, mut fastest_rad) = (0.0, 0, 0.0f64);
            let mut last_m = None;
            let n = (drive.end_ns() - drive.start_ns()) / step_ns;
            for k in 0..n {
                let at = drive.start_ns() + k * step_ns;
                let (a, b) = (drive.pose_at(at), drive.pose_at(at + step_ns));
                let moved_m = a.distance_m(&b);
                travel_m += moved_m;
                n_still += i32::from(moved_m < 1e-9);
                // At most 0.021 m in 5 ms, and at most 1.5 m/s^2.
                assert!(moved_m < 0.021, "{moved_m} m at step {k}");
                let change_m: f64 = last_m.map_or(0.0, |last: f64| moved_m - last);
                assert!(change_m.abs() < 1.5 * 0.005 * 0.005, "{change_m} m at step {k}");
                last_m = Some(moved_m);
                let turned_rad = wrap_angle(b.heading_rad - a.heading_rad);
                fastest_rad = fastest_rad.max(turned_rad.abs());
            }
            // Mean speed and length match the options.
            assert!((travel_m - 400.0).abs() < 0.05, "{travel_m} m");
            assert!(400 < n_still, "{n_still} steps without motion"); // 2 s
            assert!(fastest_rad < 0.01, "{fastest_rad} rad in 5 ms");
        }
    }

    /// A full lap, at several sites and on several days.
    #[test]
    fn the_robot_keeps_clear_of_walls() {
        for (seed, log, buildings) in [
            (1, 0, 1),
            (2, 1, 1),
            (3, 2, 1),
            (4, 3, 1),
            (2436, 0, 1),
            (2436, 1, 1),
            (2436, 0, 7),
            (2436, 1, 7),
            (1, 0, 2),
            (2, 1, 3),
            (3, 0, 9),
        ] {
            let drive = drive(seed, log, buildings, if buildings == 1 { 1000.0 } else { 2200.0 });
            for k in 0..5000 {
                let at = drive.start_ns() + (drive.end_ns() - drive.start_ns()) * k / 5000;
                let pose = drive.pose_at(at);
                let position = Point::new(pose.x_m, pose.y_m);
                // Surfaces above the robot do not block it.
                let clear_m = (drive.surfaces().iter())
                    .filter(|surface| surface.z_low_m < 1.5)
                    .map(|surface| surface.segment.distance_m(position))
                    .fold(f64::MAX, f64::min);
                assert!(0.4 < clear_m, "seed {seed}, log {log}: {clear_m} m at {position}");
            }
        }
    }

    #[test]
    fn the_robot_revisits_places_and_also_sees_distant_ones() {
        for (log, buildings, length_m, far_m) in
            [(0, 1, 400.0, 60.0), (1, 1, 400.0, 60.0), (0, 2, 900.0, 70.0)]
        {
            let drive = drive(9, log, buildings, length_m);
            let n = (length_m / 0.5) as i64;
            let at = |k: i64| drive.start_ns() + (drive.end_ns() - drive.start_ns()) * k / n;
            let places: Vec<Pose2> = (0..n).map(|k| drive.pose_at(at(k))).collect();
            let is_revisit = |k: usize| {
                let earlier = &places[..k.saturating_sub(100)];
                earlier.iter().any(|place| place.distance_m(&places[k]) < 1.0)
            };
            let n_revisits = (0..places.len()).filter(|&k| is_revisit(k)).count();
            assert!(100 < n_revisits, "{n_revisits} of {}", places.len());
            let farthest_m = (places.iter())
                .flat_map(|a| places.iter().map(|b| a.distance_m(b)))
                .fold(0.0, f64::max);
            assert!(far_m < farthest_m, "{farthest_m} m");
        }
    }

    /// Poses fused from wheels and gyroscope start at the origin. They therefore share a frame.
    #[test]
    fn every_drive_on_a_campus_starts_at_the_origin() {
        for log in 0..3 {
            let drive = drive(2436, log, 7, 100.0);
            let pose = drive.pose_at(drive.start_ns());
            assert!(pose.distance_m(&Pose2::default()) < 1e-9, "{pose:?}");
            assert!(pose.heading_rad.abs() < 1e-9, "{pose:?}");
        }
    }

    /// The base pitches by about acceleration / gravity, oscillates by 0.4 deg, and stays below the
    /// largest pitch.
    #[test]
    fn the_base_pitches_when_it_accelerates() {
        let drive = drive(5, 0, 7, 300.0);
        let dt = 0.01;
        let times = || (100..14_900).map(|k| f64::from(k) * dt);
        let (mut sum_ap, mut sum_aa, mut most) = (0.0, 0.0, 0.0f64);
        for time_s in times() {
            let speed = |time_s| drive.profile.at(time_s).1;
            let acceleration = (speed(time_s + 0.3) - speed(time_s - 0.3)) / 0.6;
            let pitch = drive.pitch_rad(time_s);
            sum_ap += acceleration * pitch;
            sum_aa += acceleration * acceleration;
            most = most.max(pitch.abs());
        }
        let lean = sum_ap / sum_aa * GRAVITY_M_S2;
        assert!((0.75..1.1).contains(&lean), "{lean}");
        assert!(0.02 < most && most < MAX_PITCH_RAD, "{most}");
    }

    #[test]
    fn the_first_drive_passes_the_top_of_the_hour_and_later_drives_are_one_day_apart() {
        let hour = |ns: i64| ns.div_euclid(3_600_000_000_000);
        let drives = [0, 1, 2].map(|log| drive(1, log, 1, 400.0));
        assert_eq!(hour(drives[0].first_firing_ns()) + 1, hour(drives[0].end_ns()));
        assert_eq!(hour(drives[1].start_ns()), hour(drives[0].end_ns()) + 24);
        assert_eq!(hour(drives[2].start_ns()), hour(drives[0].end_ns()) + 48);
    }
}
