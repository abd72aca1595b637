//! Worlds of walls, the scans of a sensor in them, and drives.

use dataset::{Pose2, RangeLimits, Scan, SplitMix64};
use register::Drive;

pub use crate::walls::World;

pub fn pose(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad: dataset::wrap_angle(heading_deg.to_radians()) }
}

impl World {
    /// A room of 12 m by 8 m around the origin with boxes along the walls and one that stands free. No
    /// turn maps it onto itself.
    pub fn room() -> Self {
        let mut world = Self(Vec::new());
        world.add_rectangle([-6.0, -4.0], [6.0, 4.0]);
        world.add_rectangle([-6.0, 1.0], [-4.2, 4.0]);
        world.add_rectangle([1.0, -4.0], [2.2, -2.6]);
        world.add_rectangle([3.1, 1.2], [4.3, 2.0]);
        world.add_rectangle([5.0, -4.0], [6.0, -3.0]);
        world
    }

    /// A room with boxes at other places, of about the same size.
    pub fn other_room(seed: u64) -> Self {
        let mut random = SplitMix64::new(seed);
        let mut world = Self(Vec::new());
        let (half_x, half_y) = (4.5 + 3.0 * random.unit(), 3.0 + 2.0 * random.unit());
        world.add_rectangle([-half_x, -half_y], [half_x, half_y]);
        for _ in 0..4 {
            // At the lower or the upper wall, so that the middle stays empty.
            let x_m = -half_x + (2.0 * half_x - 1.5) * random.unit();
            let depth_m = 0.8 + random.unit();
            let y_m = if random.unit() < 0.5 { -half_y } else { half_y - depth_m };
            world.add_rectangle([x_m, y_m], [x_m + 1.5, y_m + depth_m]);
        }
        world
    }

    /// A hall along x from 0 to `length_m`, with niches and columns in irregular distances on both sides.
    pub fn hall(length_m: f64, half_width_m: f64, seed: u64) -> Self {
        let mut random = SplitMix64::new(seed);
        let end = |x_m: f64| [[x_m, -half_width_m], [x_m, half_width_m]];
        let mut world = Self(vec![end(0.0), end(length_m)]);
        for side in [-half_width_m, half_width_m] {
            let mut x_m = 0.0;
            while x_m < length_m {
                let next_m = (x_m + 0.8 + 2.5 * random.unit()).min(length_m);
                let depth_m = if random.unit() < 0.5 { 0.0 } else { random.unit() };
                let y_m = side + depth_m * side.signum();
                world.0.push([[x_m, y_m], [next_m, y_m]]);
                world.0.push([[x_m, side], [x_m, y_m]]);
                world.0.push([[next_m, side], [next_m, y_m]]);
                if random.unit() < 0.4 {
                    let middle_m = (x_m + next_m) / 2.0;
                    world.add_rectangle(
                        [middle_m, y_m - 0.3 * side.signum()],
                        [middle_m + 0.3, y_m],
                    );
                }
                x_m = next_m;
            }
        }
        world
    }

    /// Scans at poses, with 1 cm of noise.
    pub fn scans(&self, poses: &[Pose2], coverage_deg: u32, seed: u64) -> Vec<Scan> {
        let mut random = SplitMix64::new(seed);
        poses.iter().map(|pose| self.scan(pose, coverage_deg, 0.01, &mut random)).collect()
    }
}

/// A drive whose odometry and scan matching are without error. Every scan is a keyframe.
pub fn drive(scans: &[Scan], poses: &[Pose2]) -> Drive {
    let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
    let mut path_m: Vec<f64> = Vec::new();
    for (k, pose) in poses.iter().enumerate() {
        path_m.push(if k == 0 { 0.0 } else { path_m[k - 1] + poses[k - 1].distance_m(pose) });
    }
    let all = vec![true; scans.len()];
    let odometry = poses.to_vec();
    let mut drive = Drive::of_scans(
        scans.iter().collect(),
        odometry.clone(),
        odometry,
        all.clone(),
        all,
        limits,
    );
    drive.path_m = path_m;
    drive
}
