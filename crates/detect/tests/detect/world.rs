//! Worlds of walls, the scans of a sensor in them, and drives.

use dataset::{Pose2, RangeLimits, Scan, SplitMix64};
use register::{Drive, Points};

/// Walls as pairs of end points \[m\].
#[derive(Clone)]
pub struct World(pub Vec<[[f64; 2]; 2]>);

pub fn pose(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad: dataset::wrap_angle(heading_deg.to_radians()) }
}

impl World {
    /// The four walls of a rectangle.
    pub fn add_rectangle(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) {
        let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
        self.0.extend((0..4).map(|k| [corners[k], corners[(k + 1) % 4]]));
    }

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

    /// A scan with a step of 1 deg over `coverage_deg`, with Gaussian range noise. Beams without a wall
    /// within 30 m have no return.
    pub fn scan(
        &self,
        map_from_lidar: &Pose2,
        coverage_deg: u32,
        noise_m: f64,
        random: &mut SplitMix64,
    ) -> Scan {
        let mut scan = Scan { coverage_deg: coverage_deg as f32, ..Scan::default() };
        for k in 0..coverage_deg {
            let bearing_rad = (f64::from(k) - f64::from(coverage_deg) / 2.0).to_radians();
            let (sin, cos) = (map_from_lidar.heading_rad + bearing_rad).sin_cos();
            let origin = [map_from_lidar.x_m, map_from_lidar.y_m];
            let hits = self.0.iter().filter_map(|wall| range_m(origin, [cos, sin], wall));
            let nearest_m = hits.fold(f64::INFINITY, f64::min);
            if nearest_m < 30.0 {
                let range_m = nearest_m + noise_m * gaussian(random);
                scan.x_m.push((range_m * bearing_rad.cos()) as f32);
                scan.y_m.push((range_m * bearing_rad.sin()) as f32);
            }
        }
        scan
    }

    /// Scans at poses, with 1 cm of noise.
    pub fn scans(&self, poses: &[Pose2], coverage_deg: u32, seed: u64) -> Vec<Scan> {
        let mut random = SplitMix64::new(seed);
        poses.iter().map(|pose| self.scan(pose, coverage_deg, 0.01, &mut random)).collect()
    }
}

/// Distance along a ray to a wall \[m\].
fn range_m([x, y]: [f64; 2], [dx, dy]: [f64; 2], [a, b]: &[[f64; 2]; 2]) -> Option<f64> {
    let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
    let determinant = dx * ey - dy * ex;
    let (fx, fy) = (a[0] - x, a[1] - y);
    let along_ray = (fx * ey - fy * ex) / determinant;
    let along_wall = (fx * dy - fy * dx) / determinant;
    (along_ray > 0.0 && (0.0..=1.0).contains(&along_wall)).then_some(along_ray)
}

/// A sample of the standard normal distribution: the sum of 12 uniform samples, minus 6.
fn gaussian(random: &mut SplitMix64) -> f64 {
    (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
}

/// A drive whose odometry and scan matching are without error. Every scan is a keyframe.
pub fn drive<'a>(scans: &'a [Scan], poses: &[Pose2]) -> Drive<'a> {
    let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
    let mut path_m: Vec<f64> = Vec::new();
    for (k, pose) in poses.iter().enumerate() {
        path_m.push(if k == 0 { 0.0 } else { path_m[k - 1] + poses[k - 1].distance_m(pose) });
    }
    Drive {
        scans: scans.iter().collect(),
        points: scans.iter().map(|scan| Points::from_scan(scan, limits)).collect(),
        odometry: poses.to_vec(),
        poses: poses.to_vec(),
        path_m,
        is_keyframe: vec![true; scans.len()],
    }
}
