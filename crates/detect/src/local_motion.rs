//! The motion of the last metres by scan matching, and the scans of these metres joined.

use std::collections::VecDeque;

use dataset::{FULL_RING_DEG, Pose2, RangeLimits, Scan};
use model::OdometryNoise;
use register::{Node, NodeMember, Points, RegisterOptions, ScanMatcher, SubmapOptions, points_of};

/// The scans of this path are joined \[m\]: as much as a place of the map has.
const WINDOW_M: f64 = 10.0;
/// The most scans that are joined. A robot that turns on the spot drives no path.
const MAX_SCANS: usize = 64;
/// Scans with fewer points than this are not joined.
const MIN_POINTS: usize = 15;
/// Error of the expected step without odometry: the step is that of the scan before. A guess that is
/// wide, so that the scans decide.
const WITHOUT_ODOMETRY: OdometryNoise =
    OdometryNoise { std_m_per_m: 0.5, std_m: 0.1, std_rad_per_sqrt_m: 0.2, std_rad: 0.05 };

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
    noise: OdometryNoise,
    matcher: ScanMatcher,
    /// The sum of the steps.
    odometry: Pose2,
    /// Its value at the last scan that was matched, and the pose of that scan.
    matched: Option<[Pose2; 2]>,
    /// The pose of the last scan, and that of the scan before it.
    poses: [Pose2; 2],
    window: VecDeque<Kept>,
    path_m: f64,
}

/// The scans of the last metres, joined.
pub(crate) struct LocalPlace {
    pub(crate) node: Node,
    /// The pose of the node in the local frame.
    pub(crate) local_from_node: Pose2,
}

impl LocalMotion {
    /// `limits` are the range limits of the lidar, `noise` the error of the odometry.
    pub(crate) fn new(
        options: &RegisterOptions,
        limits: RangeLimits,
        noise: OdometryNoise,
    ) -> Self {
        Self {
            options: *options,
            limits: options.limits(limits),
            noise,
            matcher: ScanMatcher::new(options.matcher, noise),
            odometry: Pose2::default(),
            matched: None,
            poses: [Pose2::default(); 2],
            window: VecDeque::new(),
            path_m: 0.0,
        }
    }

    /// Adds a scan, and returns its pose in the local frame. Without `step`, the motion since the last scan by
    /// odometry, it is expected to be that of the scan before.
    pub(crate) fn add(&mut self, scan: &Scan, step: Option<Pose2>) -> Pose2 {
        let [before, last] = self.poses;
        self.odometry = self.odometry * step.unwrap_or_else(|| before.inverse() * last);
        let (spacing_m, turn_rad) = self.spacing(scan);
        let pose = match self.matched {
            Some([odometry, pose])
                if step.is_some()
                    && odometry.distance_m(&self.odometry) < spacing_m
                    && odometry.heading_difference_rad(&self.odometry) < turn_rad =>
            {
                pose * (odometry.inverse() * self.odometry)
            }
            _ => self.match_scan(scan, step.is_some(), spacing_m, turn_rad),
        };
        self.poses = [last, pose];
        pose
    }

    fn spacing(&self, scan: &Scan) -> (f64, f64) {
        let options = &self.options;
        let (spacing_m, turn_deg) = match scan.coverage_deg < FULL_RING_DEG {
            true => (options.spacing_m, options.turn_deg),
            false => (options.full_circle_spacing_m, options.full_circle_turn_deg),
        };
        (spacing_m, turn_deg.to_radians())
    }

    fn match_scan(
        &mut self,
        scan: &Scan,
        has_odometry: bool,
        spacing_m: f64,
        turn_rad: f64,
    ) -> Pose2 {
        let points = points_of(scan, self.limits);
        let usual = if has_odometry { self.noise } else { WITHOUT_ODOMETRY };
        self.matcher.set_usual_noise(usual);
        let pose = self.matcher.add(points.clone(), &self.odometry).pose;
        // With odometry, scans are matched only when they are due.
        if !has_odometry {
            self.matcher.leave_out_close(spacing_m, turn_rad);
        }
        self.matched = Some([self.odometry, pose]);
        let is_due = self.window.back().is_none_or(|last| {
            has_odometry
                || spacing_m <= last.pose.distance_m(&pose)
                || turn_rad <= last.pose.heading_difference_rad(&pose)
        });
        if is_due && MIN_POINTS <= points.len() {
            self.path_m += self.window.back().map_or(0.0, |last| last.pose.distance_m(&pose));
            self.window.push_back(Kept { scan: scan.clone(), points, pose, path_m: self.path_m });
            let from_m = self.path_m - WINDOW_M;
            while MAX_SCANS < self.window.len()
                || self.window.front().is_some_and(|scan| scan.path_m < from_m)
            {
                self.window.pop_front();
            }
        }
        pose
    }

    /// The path of the scans so far \[m\].
    pub(crate) fn path_m(&self) -> f64 {
        self.path_m
    }

    /// The scans of the last metres, joined in the frame of the one in the middle of the path.
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
        let node = Node::new(&members, &SubmapOptions::default());
        Some(LocalPlace { node, local_from_node: middle.pose })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A round room of 3 m.
    fn scan() -> Scan {
        let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
        for k in 0..360 {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) / 360.0);
            scan.x_m.push((3.0 * cos) as f32);
            scan.y_m.push((3.0 * sin) as f32);
        }
        scan
    }

    /// A robot that turns on the spot by 30 deg per scan, and one that drives 0.5 m per scan by odometry.
    #[test]
    fn the_number_of_scans_is_bounded() {
        let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
        let noise = OdometryNoise {
            std_m_per_m: 1e-6,
            std_m: 1e-6,
            std_rad_per_sqrt_m: 1e-6,
            std_rad: 1e-6,
        };
        let turn = Pose2 { heading_rad: TAU / 12.0, ..Pose2::default() };
        let mut motion = LocalMotion::new(&RegisterOptions::default(), limits, noise);
        for _ in 0..2 * MAX_SCANS {
            motion.add(&scan(), Some(turn));
            assert!(motion.window.len() <= MAX_SCANS);
        }
        let drive = Pose2 { x_m: 0.5, ..Pose2::default() };
        for _ in 0..2 * MAX_SCANS {
            motion.add(&scan(), Some(drive));
            assert!(motion.window.len() <= MAX_SCANS);
        }
        assert!(motion.window.len() < MAX_SCANS / 2);
        assert!(motion.place().is_some());
    }
}
