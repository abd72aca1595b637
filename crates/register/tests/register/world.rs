//! Worlds of walls, and the scans that a sensor in them takes.

use dataset::{Pose2, Scan, SplitMix64};

/// Walls as pairs of end points \[m\].
#[derive(Clone)]
pub struct World(pub Vec<[[f64; 2]; 2]>);

impl World {
    /// The four walls of a rectangle.
    pub fn add_rectangle(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) {
        let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
        self.0.extend((0..4).map(|k| [corners[k], corners[(k + 1) % 4]]));
    }

    /// A corridor around a block of 12 m by 8 m, 2.5 m wide, with columns along the outer wall in
    /// irregular distances.
    pub fn ring_corridor() -> Self {
        let mut world = Self(Vec::new());
        world.add_rectangle([0.0, 0.0], [12.0, 8.0]);
        world.add_rectangle([-2.5, -2.5], [14.5, 10.5]);
        for x_m in [0.7, 2.2, 5.1, 6.3, 9.8, 12.9] {
            world.add_rectangle([x_m, -2.5], [x_m + 0.3, -2.2]);
            world.add_rectangle([x_m + 0.9, 10.2], [x_m + 1.2, 10.5]);
        }
        for y_m in [1.1, 4.2, 6.0, 8.3] {
            world.add_rectangle([14.2, y_m], [14.5, y_m + 0.4]);
            world.add_rectangle([-2.5, y_m + 0.6], [-2.1, y_m + 1.0]);
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
pub fn gaussian(random: &mut SplitMix64) -> f64 {
    (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
}

/// Poses every 0.2 m along the middle of the ring corridor, counter-clockwise from (0, -1.25), with
/// corners of radius 1.25 m.
pub fn lap() -> Vec<Pose2> {
    let mut pose = Pose2 { x_m: 0.0, y_m: -1.25, heading_rad: 0.0 };
    let mut poses = vec![pose];
    for side_m in [12.0, 8.0, 12.0, 8.0] {
        for _ in 0..(side_m / 0.2) as usize {
            pose = pose * Pose2 { x_m: 0.2, y_m: 0.0, heading_rad: 0.0 };
            poses.push(pose);
        }
        // A quarter circle of 1.25 m in 10 chords of about 0.196 m.
        let turn_rad = std::f64::consts::FRAC_PI_2 / 10.0;
        let chord_m = 2.0 * 1.25 * (turn_rad / 2.0).sin();
        let (sin, cos) = (turn_rad / 2.0).sin_cos();
        let step = Pose2 { x_m: chord_m * cos, y_m: chord_m * sin, heading_rad: turn_rad };
        for _ in 0..10 {
            pose = pose * step;
            poses.push(pose);
        }
    }
    poses
}
