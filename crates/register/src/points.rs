//! The returns of scans, with the direction of the surface at each return.

use std::ops::Range;

use dataset::{Pose2, RangeLimits, Scan};

/// Returns between two neighbours of a surface are at most this far apart \[m\], or
/// [`REACH_PER_RANGE`] times the range.
const REACH_M: f64 = 0.25;
/// The reach grows with the range, because the returns of a scanner with a step of 1 deg are
/// 0.0175 times the range apart: three neighbours on either side.
const REACH_PER_RANGE: f64 = 0.055;
/// The most neighbours on either side that are used for a normal.
const MAX_NEIGHBOURS: usize = 64;
/// A normal needs this many returns, including the return itself.
const MIN_NEIGHBOURS: usize = 4;
/// The returns are on a line if the ratio of the variances across and along it is less than this
/// value: a deviation of a quarter of the length.
const LINE_VARIANCE_RATIO: f64 = 0.06;
/// Returns with smaller squared deviations are one point, and have no direction \[m^2\].
const LEAST_DEVIATIONS_M2: f64 = 1e-6;

/// The most squares in a table (1 MB).
const MAX_THIN_SQUARES: f64 = 8_388_608.0;

/// Points in one frame. `positions_m` and `normals` have the same length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Points {
    /// x and y \[m\], `(n, 2)`.
    pub positions_m: Vec<[f64; 2]>,
    /// Unit normal of the surface, towards the sensor. `None` where the returns around the point are
    /// not on a line: at corners, in foliage, far away. `(n,)`.
    pub normals: Vec<Option<[f64; 2]>>,
}

impl Points {
    /// The returns of a scan within the range limits, in firing order.
    ///
    /// The normal of a return is the direction of the smallest variance of the returns around it.
    pub fn from_scan(scan: &Scan, limits: RangeLimits) -> Self {
        let is_kept = |p: &[f64; 2]| limits.contains(length(*p));
        let positions_m: Vec<[f64; 2]> = scan.points().filter(is_kept).collect();
        let sums = Sums::of(&positions_m);
        let normals = (0..positions_m.len()).map(|k| normal_at(&positions_m, &sums, k)).collect();
        Self { positions_m, normals }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions_m.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions_m.is_empty()
    }

    /// Appends points that are given in another frame.
    pub fn extend_from(&mut self, self_from_other: &Pose2, other: &Self) {
        let motion = Motion::new(self_from_other);
        self.positions_m.extend(other.positions_m.iter().map(|&p| motion.point(p)));
        self.normals.extend(other.normals.iter().map(|n| n.map(|n| motion.direction(n))));
    }

    /// Keeps one point per square of `voxel_m`: the first one with a normal, or else the first one.
    /// The order of the points is kept.
    pub fn thin(&self, voxel_m: f64) -> Self {
        let squares: Vec<[f64; 2]> =
            self.positions_m.iter().map(|p| p.map(|v| (v / voxel_m).floor())).collect();
        let fold = |of: fn(f64, f64) -> f64| {
            let first = squares.first().copied().unwrap_or_default();
            squares.iter().fold(first, |a, b| [of(a[0], b[0]), of(a[1], b[1])])
        };
        let (least, most) = (fold(f64::min), fold(f64::max));
        let sides = [0, 1].map(|axis| most[axis] - least[axis] + 1.0);
        let mut kept = match sides[0] * sides[1] <= MAX_THIN_SQUARES {
            true => self.first_per_square(&squares, least, sides.map(|side| side as usize)),
            false => self.first_per_sorted_square(&squares),
        };
        kept.sort_unstable();
        self.select(&kept)
    }

    /// The point to keep of each square, with a table of all squares.
    fn first_per_square(
        &self,
        squares: &[[f64; 2]],
        least: [f64; 2],
        sides: [usize; 2],
    ) -> Vec<usize> {
        let mut kept: Vec<usize> = Vec::new();
        // One bit per square.
        let mut has_point = vec![0u64; (sides[0] * sides[1]).div_ceil(64)];
        for with_normal in [true, false] {
            for (k, square) in squares.iter().enumerate() {
                if self.normals[k].is_some() != with_normal {
                    continue;
                }
                let [a, b] = [0, 1].map(|axis| (square[axis] - least[axis]) as usize);
                let at = a * sides[1] + b;
                let (word, bit) = (&mut has_point[at / 64], 1 << (at % 64));
                if *word & bit == 0 {
                    *word |= bit;
                    kept.push(k);
                }
            }
        }
        kept
    }

    /// The same, for an area with too many squares for a table.
    fn first_per_sorted_square(&self, squares: &[[f64; 2]]) -> Vec<usize> {
        let square = |k: usize| squares[k].map(|v| v as i64);
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_unstable_by_key(|&k| (square(k), self.normals[k].is_none(), k));
        order.dedup_by_key(|k| square(*k));
        order
    }

    /// The points with these indices.
    fn select(&self, indices: &[usize]) -> Self {
        Self {
            positions_m: indices.iter().map(|&k| self.positions_m[k]).collect(),
            normals: indices.iter().map(|&k| self.normals[k]).collect(),
        }
    }

    /// Keeps the points for which the predicate is true.
    pub fn retain(&mut self, mut is_kept: impl FnMut([f64; 2]) -> bool) {
        let kept: Vec<usize> = (0..self.len()).filter(|&k| is_kept(self.positions_m[k])).collect();
        if kept.len() < self.len() {
            *self = self.select(&kept);
        }
    }
}

/// Length of a vector. Square roots are exact on every machine, and faster than `libm::hypot`.
#[inline]
pub(crate) fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// A pose with the cosine and sine of its heading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    x_m: f64,
    y_m: f64,
    cos: f64,
    sin: f64,
}

impl Motion {
    pub(crate) fn new(pose: &Pose2) -> Self {
        let (sin, cos) = libm::sincos(pose.heading_rad);
        Self { x_m: pose.x_m, y_m: pose.y_m, cos, sin }
    }

    #[inline]
    pub(crate) fn direction(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.cos * x - self.sin * y, self.sin * x + self.cos * y]
    }

    #[inline]
    pub(crate) fn point(&self, p: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.direction(p);
        [x + self.x_m, y + self.y_m]
    }
}

/// Sums over the first returns: of 1, x, y, x^2, x y and y^2. The sums over any stretch of returns are the
/// difference of two of them.
///
/// The sums of thousands of returns within 100 m are below 1e8 m^2, so that rounding changes the deviations by less
/// than 1e-6 m^2. The noise of a few returns of 0.01 m adds 1e-4 m^2 or more.
struct Sums(Vec<[f64; 5]>);

impl Sums {
    fn of(points: &[[f64; 2]]) -> Self {
        let mut sums = Vec::with_capacity(points.len() + 1);
        let mut sum = [0.0; 5];
        sums.push(sum);
        for &[x, y] in points {
            for (sum, value) in sum.iter_mut().zip([x, y, x * x, x * y, y * y]) {
                *sum += value;
            }
            sums.push(sum);
        }
        Self(sums)
    }

    /// Sums of the squares and products of the deviations from the mean of a stretch of returns: xx, xy, yy.
    fn deviations(&self, stretch: Range<usize>) -> [f64; 3] {
        let n = stretch.len() as f64;
        let (from, to) = (&self.0[stretch.start], &self.0[stretch.end]);
        let [x, y, xx, xy, yy] = std::array::from_fn(|k| to[k] - from[k]);
        [xx - x * x / n, xy - x * y / n, yy - y * y / n]
    }
}

/// Cosine and sine of half of an angle between -180 and 180 deg, from those of the angle. Square roots and divisions
/// give the same on every machine. The larger one of the two is a root, because the root of a small number is less
/// accurate.
fn half_angle([cos, sin]: [f64; 2]) -> [f64; 2] {
    if 0.0 <= cos {
        let half_cos = ((1.0 + cos) / 2.0).sqrt();
        [half_cos, sin / (2.0 * half_cos)]
    } else {
        let half_sin = ((1.0 - cos) / 2.0).sqrt().copysign(sin);
        [sin / (2.0 * half_sin), half_sin]
    }
}

/// The normal at one return from its neighbours in firing order.
fn normal_at(points: &[[f64; 2]], sums: &Sums, k: usize) -> Option<[f64; 2]> {
    let [x, y] = points[k];
    let reach_m = (REACH_PER_RANGE * length([x, y])).max(REACH_M);
    let reach_m2 = reach_m * reach_m;
    let is_near = |p: &&[f64; 2]| {
        let [dx, dy] = [p[0] - x, p[1] - y];
        dx * dx + dy * dy < reach_m2
    };
    let before = points[..k].iter().rev().take(MAX_NEIGHBOURS).take_while(is_near).count();
    let after = points[k + 1..].iter().take(MAX_NEIGHBOURS).take_while(is_near).count();
    let around = k - before..k + after + 1;
    if around.len() < MIN_NEIGHBOURS {
        return None;
    }
    let [xx, xy, yy] = sums.deviations(around);
    let (half_difference, half_sum) = ((xx - yy) / 2.0, (xx + yy) / 2.0);
    let radius = length([half_difference, xy]);
    let (along, across) = (half_sum + radius, half_sum - radius);
    if along < LEAST_DEVIATIONS_M2 || LINE_VARIANCE_RATIO * along <= across {
        return None;
    }
    let [cos, sin] = half_angle([half_difference / radius, xy / radius]);
    let faces_away = -sin * x + cos * y > 0.0;
    Some(if faces_away { [sin, -cos] } else { [-sin, cos] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

    fn scan(points: &[[f64; 2]]) -> Scan {
        Scan {
            x_m: points.iter().map(|p| p[0] as f32).collect(),
            y_m: points.iter().map(|p| p[1] as f32).collect(),
            coverage_deg: 360.0,
            ..Scan::default()
        }
    }

    /// A wall at x = 2 and a wall at y = 3 meet in a corner. The normals point to the sensor in the
    /// origin. Both walls are in reach of the corner, so it has no normal.
    #[test]
    fn normals_of_walls_point_to_the_sensor_and_corners_have_none() {
        let mut walls: Vec<[f64; 2]> = (0..=30).map(|k| [2.0, 0.1 * f64::from(k)]).collect();
        walls.extend((1..=20).map(|k| [2.0 - 0.1 * f64::from(k), 3.0]));
        let points = Points::from_scan(&scan(&walls), LIMITS);
        let check = |k: usize, expected: [f64; 2]| {
            let normal = points.normals[k].unwrap();
            assert!((normal[0] - expected[0]).abs() < 1e-6, "{k}: {normal:?}");
            assert!((normal[1] - expected[1]).abs() < 1e-6, "{k}: {normal:?}");
        };
        (1..=25).for_each(|k| check(k, [-1.0, 0.0]));
        (35..=48).for_each(|k| check(k, [0.0, -1.0]));
        assert_eq!(points.normals[30], None);
    }

    #[test]
    fn half_of_an_angle_has_its_cosine_and_sine() {
        for k in -180..=180 {
            let angle = f64::from(k).to_radians();
            let [cos, sin] = half_angle([angle.cos(), angle.sin()]);
            assert!((cos - (angle / 2.0).cos()).abs() < 1e-12, "{k}");
            // At -180 and 180 deg, the sign is that of a rounding error.
            assert!((sin - (angle / 2.0).sin()).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn returns_outside_the_limits_are_left_out_and_lone_returns_have_no_normal() {
        let points = Points::from_scan(&scan(&[[0.05, 0.0], [5.0, 0.0], [30.0, 0.0]]), LIMITS);
        assert_eq!((points.positions_m, points.normals), (vec![[5.0, 0.0]], vec![None]));
    }

    /// Two points share a square, and only the second one has a normal.
    #[test]
    fn thinning_prefers_points_with_a_normal() {
        let points = Points {
            positions_m: vec![[0.01, 0.01], [0.02, 0.02], [-0.01, 0.0], [0.03, 0.03]],
            normals: vec![None, Some([1.0, 0.0]), None, Some([0.0, 1.0])],
        };
        let thin = points.thin(0.1);
        assert_eq!(thin.positions_m, [[0.02, 0.02], [-0.01, 0.0]]);
        assert_eq!(thin.normals, [Some([1.0, 0.0]), None]);
    }

    #[test]
    fn points_are_appended_in_the_frame_of_the_first() {
        let mut points = Points::default();
        let other = Points { positions_m: vec![[1.0, 0.0]], normals: vec![Some([-1.0, 0.0])] };
        points.extend_from(&Pose2 { x_m: 5.0, y_m: 6.0, heading_rad: FRAC_PI_2 }, &other);
        let ([x, y], [nx, ny]) = (points.positions_m[0], points.normals[0].unwrap());
        assert!((x - 5.0).abs() < 1e-12 && (y - 7.0).abs() < 1e-12);
        assert!(nx.abs() < 1e-12 && (ny + 1.0).abs() < 1e-12);
    }
}
