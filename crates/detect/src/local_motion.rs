//! The motion of the last metres by scan matching, and the scans of these metres joined.

use std::collections::VecDeque;

use dataset::{FULL_RING_DEG, Pose2, RangeLimits, Scan};
use model::OdometryNoise;
use register::{
    MatcherOptions, Node, NodeMember, Points, RegisterOptions, ScanMatcher, SubmapOptions,
    is_decided, points_of,
};

/// The scans of this path are joined \[m\]: as much as a place of the map has.
const WINDOW_M: f64 = 10.0;
/// The most scans that are joined. A robot that turns on the spot drives no path.
const MAX_SCANS: usize = 64;
/// Scans with fewer points than this are not joined, and not matched without odometry.
const MIN_POINTS: usize = 15;
/// What a robot can do: the changes of its speed \[m/s^2, rad/s^2\], and its speed before anything is known of it
/// \[m/s, rad/s\]. Wide guesses, so that the scans decide; but a robot does not jump where they say little.
const CHANGE_M: f64 = 3.0;
const CHANGE_RAD: f64 = 6.0;
const SPEED_M: f64 = 2.0;
const SPEED_RAD: f64 = 1.0;
/// The least error of the expected step.
const LEAST_M: f64 = 0.02;
const LEAST_RAD: f64 = 0.02;
/// Time between two scans, if their stamps do not say, and the longest time over which the speed is kept \[s\].
const USUAL_SECS: f64 = 0.1;
const LONGEST_SECS: f64 = 1.0;
/// The turn goes on by this share per scan, where the scans do not show it.
const KEPT_TURN: f64 = 0.8;

/// A scan with a smaller share of points near those of the last metres has no known relation to them.
const CONNECTED_SHARE: f64 = 0.5;

/// The speed of the lidar, in its own frame.
#[derive(Debug, Clone, Copy, Default)]
struct Speed {
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
}

/// A scan that is joined with others.
struct Kept {
    scan: Scan,
    points: Points,
    pose: Pose2,
    path_m: f64,
}

/// Where the last scans lie relative to each other. The local frame is that of the first scan. It drifts
/// slowly, as scan matching does.
pub(crate) struct LocalMotion {
    options: RegisterOptions,
    limits: RangeLimits,
    /// The range limits of scans that are matched without odometry.
    far_limits: RangeLimits,
    noise: OdometryNoise,
    matcher: ScanMatcher,
    /// The sum of the steps.
    odometry: Pose2,
    /// Its value at the last scan that was matched, and the pose of that scan.
    matched: Option<[Pose2; 2]>,
    /// The pose of the last scan, and its stamp.
    last: Pose2,
    stamp_ns: Option<i64>,
    /// The speed by the last scan that determined its position.
    speed: Option<Speed>,
    /// The time of the scans since the last one that was matched, without odometry \[s\].
    unmatched_secs: f64,
    /// The near points of the last scan, if there was no odometry and it was matched.
    points: Option<Points>,
    window: VecDeque<Kept>,
    path_m: f64,
    /// Whether the last scan determined its position.
    is_decided: bool,
    /// Whether the last scan has no known relation to those before.
    is_broken: bool,
}

/// The scans of the last metres, joined.
pub(crate) struct LocalPlace {
    pub(crate) node: Node,
    /// The pose of the node in the local frame.
    pub(crate) local_from_node: Pose2,
}

/// The steps of the lidar from scan to scan, by matching each with those before, without odometry.
pub struct ScanSteps {
    motion: LocalMotion,
    /// The pose and the stamp of the scan before.
    before: Option<(Pose2, i64)>,
}

/// A step of the lidar from one scan to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanStep {
    /// The pose of the lidar at the next scan, in its frame at the first one.
    pub step: Pose2,
    /// The time between the two. It can be negative, if the clock stepped back \[ns\].
    pub time_ns: i64,
}

impl ScanSteps {
    /// `limits` are the range limits of the lidar.
    pub fn new(options: &RegisterOptions, limits: RangeLimits) -> Self {
        // The noise of odometry is not used without it.
        let noise =
            OdometryNoise { std_m_per_m: 0.0, std_m: 0.0, std_rad_per_sqrt_m: 0.0, std_rad: 0.0 };
        Self { motion: LocalMotion::new(options, limits, noise), before: None }
    }

    /// Adds the next scan. Returns the step to it from the scan before, `None` if it is the first one, or if it does
    /// not continue those before.
    pub fn add(&mut self, scan: &Scan) -> Option<ScanStep> {
        let pose = self.motion.add(scan, None);
        let (before, before_ns) = self.before.replace((pose, scan.stamp_ns))?;
        let time_ns = scan.stamp_ns.saturating_sub(before_ns);
        let step = ScanStep { step: before.inverse() * pose, time_ns };
        (!self.motion.is_broken()).then_some(step)
    }
}

impl Speed {
    fn of(step: &Pose2, secs: f64) -> Self {
        Self { x_m: step.x_m / secs, y_m: step.y_m / secs, heading_rad: step.heading_rad / secs }
    }

    fn step(&self, secs: f64) -> Pose2 {
        Pose2 { x_m: self.x_m * secs, y_m: self.y_m * secs, heading_rad: self.heading_rad * secs }
    }
}

impl LocalMotion {
    /// `limits` are the range limits of the lidar, `noise` the error of the odometry.
    pub(crate) fn new(
        options: &RegisterOptions,
        limits: RangeLimits,
        noise: OdometryNoise,
    ) -> Self {
        let far_m = options.matcher.target_half_width_m.max(limits.max_m);
        let matcher = MatcherOptions { target_half_width_m: far_m, ..options.matcher };
        Self {
            options: *options,
            limits: options.limits(limits),
            noise,
            far_limits: limits,
            matcher: ScanMatcher::new(matcher, noise),
            odometry: Pose2::default(),
            matched: None,
            last: Pose2::default(),
            stamp_ns: None,
            speed: None,
            unmatched_secs: 0.0,
            points: None,
            window: VecDeque::new(),
            path_m: 0.0,
            is_decided: true,
            is_broken: false,
        }
    }

    /// Adds a scan, and returns its pose in the local frame. Without `step`, the motion since the last scan by
    /// odometry, the speed is expected to be that of the scan before.
    pub(crate) fn add(&mut self, scan: &Scan, step: Option<Pose2>) -> Pose2 {
        let since_ns = self.stamp_ns.replace(scan.stamp_ns).map_or(0, |last| scan.stamp_ns - last);
        let secs = match since_ns as f64 * 1e-9 {
            secs if 0.0 < secs => secs.min(LONGEST_SECS),
            _ => USUAL_SECS,
        };
        (self.is_decided, self.is_broken) = (true, false);
        self.points = None;
        let Some(step) = step else { return self.add_without_odometry(scan, secs) };
        self.odometry = self.odometry * step;
        let (spacing_m, turn_rad) = self.spacing(scan);
        self.last = match self.matched {
            Some([odometry, pose])
                if odometry.distance_m(&self.odometry) < spacing_m
                    && odometry.heading_difference_rad(&self.odometry) < turn_rad =>
            {
                pose * (odometry.inverse() * self.odometry)
            }
            _ => {
                let points = points_of(scan, self.limits);
                self.matcher.set_usual_noise(self.noise);
                let pose = self.matcher.add(points.clone(), &self.odometry).pose;
                self.matched = Some([self.odometry, pose]);
                self.keep(scan, points, pose);
                pose
            }
        };
        self.last
    }

    /// Each scan is matched. One that does not determine its position does not change the speed. One with too few
    /// points says nothing: the robot is where the speed takes it, and the path goes on.
    fn add_without_odometry(&mut self, scan: &Scan, secs: f64) -> Pose2 {
        let (spacing_m, turn_rad) = self.spacing(scan);
        let expected = self.speed.unwrap_or_default().step(secs);
        self.odometry = self.odometry * expected;
        let secs = self.unmatched_secs + secs;
        let points = points_of(scan, self.far_limits);
        if points.len() < MIN_POINTS {
            self.unmatched_secs = secs;
            self.is_decided = false;
            self.last = self.last * expected;
            return self.last;
        }
        self.unmatched_secs = 0.0;
        let noise_secs = secs.min(LONGEST_SECS);
        let [std_m, std_rad] = match self.speed {
            Some(_) => [CHANGE_M * noise_secs * noise_secs, CHANGE_RAD * noise_secs * noise_secs],
            None => [SPEED_M * noise_secs, SPEED_RAD * noise_secs],
        };
        self.matcher.set_usual_noise(OdometryNoise {
            std_m_per_m: 0.1,
            std_m: std_m.max(LEAST_M),
            std_rad_per_sqrt_m: 0.05,
            std_rad: std_rad.max(LEAST_RAD),
        });
        let near_points = points_of(scan, self.limits);
        let matched = self.matcher.add(points, &self.odometry);
        self.matcher.leave_out_close(spacing_m, turn_rad);
        self.last = matched.pose;
        let before = self.matched.replace([self.odometry, self.last]).map(|[_, pose]| pose);
        self.is_decided = before.is_none()
            || is_decided(matched.near_share, matched.weakness.map(|weakness| weakness.ratio));
        match before.filter(|_| self.is_decided) {
            Some(before) => self.speed = Some(Speed::of(&(before.inverse() * self.last), secs)),
            None => {
                if let Some(speed) = &mut self.speed {
                    speed.heading_rad *= KEPT_TURN;
                }
            }
        }
        // A scan that was not used has no near points, and says nothing either.
        self.is_broken = matched.is_used && matched.near_share < CONNECTED_SHARE;
        if self.is_broken {
            self.window.clear();
        }
        let is_due = self.window.back().is_none_or(|kept| {
            spacing_m <= kept.pose.distance_m(&self.last)
                || turn_rad <= kept.pose.heading_difference_rad(&self.last)
        });
        if is_due {
            self.keep(scan, near_points.clone(), self.last);
        }
        self.points = Some(near_points);
        self.last
    }

    /// Adds a scan to those of the last metres.
    fn keep(&mut self, scan: &Scan, points: Points, pose: Pose2) {
        if points.len() < MIN_POINTS {
            return;
        }
        self.path_m += self.window.back().map_or(0.0, |last| last.pose.distance_m(&pose));
        self.window.push_back(Kept { scan: scan.clone(), points, pose, path_m: self.path_m });
        let from_m = self.path_m - WINDOW_M;
        while MAX_SCANS < self.window.len()
            || self.window.front().is_some_and(|scan| scan.path_m < from_m)
        {
            self.window.pop_front();
        }
    }

    fn spacing(&self, scan: &Scan) -> (f64, f64) {
        let options = &self.options;
        let (spacing_m, turn_deg) = match scan.coverage_deg < FULL_RING_DEG {
            true => (options.spacing_m, options.turn_deg),
            false => (options.full_circle_spacing_m, options.full_circle_turn_deg),
        };
        (spacing_m, turn_deg.to_radians())
    }

    /// The near points of the last scan. `None` if there was odometry, or if the scan has too few points.
    pub(crate) fn points_without_odometry(&self) -> Option<&Points> {
        self.points.as_ref()
    }

    /// Whether the last scan determined its position. The odometry determines it, too.
    pub(crate) fn is_decided(&self) -> bool {
        self.is_decided
    }

    /// Whether the last scan has no known relation to those before: there was no odometry, and most of its points
    /// are where the scans before saw nothing. Such a scan begins the path anew.
    pub(crate) fn is_broken(&self) -> bool {
        self.is_broken
    }

    /// The path of the scans so far \[m\].
    pub(crate) fn path_m(&self) -> f64 {
        self.path_m
    }

    /// The scans of the last metres, joined in the frame of the one in the middle of the path, without what moved.
    pub(crate) fn place(&self) -> Option<LocalPlace> {
        let middle_m = (self.window.front()?.path_m + self.window.back()?.path_m) / 2.0;
        let middle = self.window.iter().find(|scan| middle_m <= scan.path_m)?;
        let node_from_local = middle.pose.inverse();
        let members: Vec<NodeMember<'_>> = self
            .window
            .iter()
            .map(|kept| NodeMember {
                node_from_scan: node_from_local * kept.pose,
                scan: &kept.scan,
                points: &kept.points,
            })
            .collect();
        let node = Node::of_still(&members, &SubmapOptions::default());
        Some(LocalPlace { node, local_from_node: middle.pose })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const WITHOUT_NOISE: OdometryNoise =
        OdometryNoise { std_m_per_m: 1e-6, std_m: 1e-6, std_rad_per_sqrt_m: 1e-6, std_rad: 1e-6 };

    /// A round room.
    fn room(radius_m: f64) -> Scan {
        let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
        for k in 0..360 {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) / 360.0);
            scan.x_m.push((radius_m * cos) as f32);
            scan.y_m.push((radius_m * sin) as f32);
        }
        scan
    }

    /// A robot that turns on the spot by 30 deg per scan, and one that drives 0.5 m per scan by odometry.
    #[test]
    fn the_number_of_scans_is_bounded() {
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let noise = WITHOUT_NOISE;
        let turn = Pose2 { heading_rad: TAU / 12.0, ..Pose2::default() };
        let mut motion = LocalMotion::new(&RegisterOptions::default(), limits, noise);
        for _ in 0..2 * MAX_SCANS {
            motion.add(&room(3.0), Some(turn));
            assert!(motion.window.len() <= MAX_SCANS);
        }
        let drive = Pose2 { x_m: 0.5, ..Pose2::default() };
        for _ in 0..2 * MAX_SCANS {
            motion.add(&room(3.0), Some(drive));
            assert!(motion.window.len() <= MAX_SCANS);
        }
        assert!(motion.window.len() < MAX_SCANS / 2);
        assert!(motion.place().is_some());
    }

    /// A robot drives through a round room of 6 m, and a person walks at its side. In the joined scans, there are only
    /// walls.
    #[test]
    fn a_person_who_walks_along_is_left_out() {
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let mut motion = LocalMotion::new(&RegisterOptions::default(), limits, WITHOUT_NOISE);
        for k in 0..25 {
            let x_m = -3.0 + 0.25 * f64::from(k);
            let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
            for degree in 0..360 {
                let (sin, cos) = libm::sincos(f64::from(degree).to_radians());
                let wall_m = (36.0 - x_m * x_m * sin * sin).sqrt() - x_m * cos;
                let range_m = if (25..40).contains(&degree) { 1.8 } else { wall_m };
                scan.x_m.push((range_m * cos) as f32);
                scan.y_m.push((range_m * sin) as f32);
            }
            motion.add(&scan, Some(Pose2 { x_m: 0.25, ..Pose2::default() }));
        }
        let place = motion.place().unwrap();
        let points = &place.node.sample().positions_m;
        assert!(points.len() > 100, "{}", points.len());
        for &[x_m, y_m] in points {
            let at = place.local_from_node * Pose2 { x_m, y_m, heading_rad: 0.0 };
            // The first scan was 3 m before the centre, after a step of 0.25 m.
            let from_centre_m = libm::hypot(at.x_m - 3.25, at.y_m);
            assert!((from_centre_m - 6.0).abs() < 0.3, "{at:?}");
        }
    }

    /// Someone stands close to the lidar, so that some scans have few points.
    #[test]
    fn a_scan_with_few_points_does_not_end_the_path() {
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let mut motion = LocalMotion::new(&RegisterOptions::default(), limits, WITHOUT_NOISE);
        let few = Scan { x_m: vec![0.5; 3], y_m: vec![-0.1, 0.0, 0.1], ..room(3.0) };
        for (k, scan) in [room(3.0), room(3.0), few.clone(), few, room(3.0)].iter().enumerate() {
            motion.add(scan, None);
            assert!(!motion.is_broken(), "{k}");
            assert_eq!(motion.is_decided(), scan.len() > 3, "{k}");
        }
        assert_eq!(motion.window.len(), 1);
        assert!(motion.last.distance_m(&Pose2::default()) < 1e-3);
    }

    /// Two scans of a room, one of another room, and one more of that room after the clock stepped back.
    #[test]
    fn there_is_no_step_to_a_scan_that_continues_nothing() {
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let mut steps = ScanSteps::new(&RegisterOptions::default(), limits);
        let scans = [(3.0, 0), (3.0, 100), (9.0, 200), (9.0, 50)];
        let times = scans.map(|(radius_m, stamp_ns)| {
            let step = steps.add(&Scan { stamp_ns, ..room(radius_m) })?;
            assert!(step.step.distance_m(&Pose2::default()) < 1e-3, "{step:?}");
            Some(step.time_ns)
        });
        assert_eq!(times, [None, Some(100), None, Some(-150)]);
    }

    /// The lidar sees another room from one scan to the next.
    #[test]
    fn a_scan_that_continues_nothing_begins_a_new_path() {
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let noise = WITHOUT_NOISE;
        let mut motion = LocalMotion::new(&RegisterOptions::default(), limits, noise);
        for (radius_m, is_broken) in [(3.0, false), (3.0, false), (9.0, true), (9.0, false)] {
            motion.add(&room(radius_m), None);
            assert_eq!(motion.is_broken(), is_broken, "{radius_m}");
        }
        // Only the scan with which the new path began is left.
        assert_eq!(motion.window.len(), 1);
        // With odometry, the relation is known.
        motion.add(&room(3.0), Some(Pose2 { x_m: 0.5, ..Pose2::default() }));
        assert!(!motion.is_broken() && motion.window.len() == 2);
    }
}
