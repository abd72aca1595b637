//! Search of the best pose in a window, by correlation with blurred points.

use dataset::{Pose2, wrap_angle};

use crate::points::{Motion, Points};

/// The most squares per side of a blurred map. Points farther from the lower corner are left out.
const MAX_SQUARES: usize = 4096;
/// A point is blurred up to this many standard deviations.
const BLUR_REACH: f64 = 2.2;

/// A map of points, blurred with a Gaussian: 1 at a point, 0 far from all points.
#[derive(Debug, Clone)]
pub struct BlurredMap {
    square_m: f64,
    corner_m: [f64; 2],
    n_squares: [usize; 2],
    /// Row-major values, `(n_squares[0], n_squares[1])`.
    values: Vec<f32>,
}

impl BlurredMap {
    /// Blurs points with a Gaussian of standard deviation `blur_m`, sampled every `square_m`. The value
    /// of a square is that of the nearest point.
    ///
    /// # Panics
    /// If `square_m` is not positive.
    pub fn new(points: &Points, square_m: f64, blur_m: f64) -> Self {
        assert!(0.0 < square_m, "squares have a size");
        let reach = (BLUR_REACH * blur_m / square_m).ceil() as usize;
        let fold = |of: fn(f64, f64) -> f64| {
            let first = points.positions_m.first().copied().unwrap_or_default();
            points.positions_m.iter().fold(first, |a, b| [of(a[0], b[0]), of(a[1], b[1])])
        };
        let margin_m = (reach + 1) as f64 * square_m;
        let corner_m = fold(f64::min).map(|v| v - margin_m);
        let far_m = fold(f64::max).map(|v| v + margin_m);
        let n_squares = [0, 1].map(|axis| {
            (((far_m[axis] - corner_m[axis]) / square_m) as usize + 1).min(MAX_SQUARES)
        });
        let mut map =
            Self { square_m, corner_m, n_squares, values: vec![0.0; n_squares[0] * n_squares[1]] };
        let kernel = kernel(reach, square_m, blur_m);
        for p in &points.positions_m {
            if let Some(square) = map.square(*p) {
                map.stamp(square, reach, &kernel);
            }
        }
        map
    }

    /// Raises the squares around a point to the values of the kernel.
    fn stamp(&mut self, [a, b]: [usize; 2], reach: usize, kernel: &[f32]) {
        let [rows, columns] = self.n_squares;
        let inside = reach <= a && reach <= b && a + reach < rows && b + reach < columns;
        if !inside || self.values[a * columns + b] == 1.0 {
            return;
        }
        let width = 2 * reach + 1;
        for row in 0..width {
            let first = (a + row - reach) * columns + b - reach;
            let values = &mut self.values[first..first + width];
            for (value, weight) in values.iter_mut().zip(&kernel[row * width..]) {
                *value = value.max(*weight);
            }
        }
    }

    /// A position in squares from the lower corner.
    #[inline]
    fn in_squares(&self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (p[axis] - self.corner_m[axis]) / self.square_m)
    }

    fn square(&self, p: [f64; 2]) -> Option<[usize; 2]> {
        self.containing(self.in_squares(p))
    }

    /// The square that contains a position in squares.
    #[inline]
    fn containing(&self, [a, b]: [f64; 2]) -> Option<[usize; 2]> {
        let is_inside =
            0.0 <= a && 0.0 <= b && a < self.n_squares[0] as f64 && b < self.n_squares[1] as f64;
        is_inside.then_some([a as usize, b as usize])
    }

    /// The value at a position. 0 outside the map.
    #[inline]
    pub fn at(&self, p: [f64; 2]) -> f32 {
        self.value(self.in_squares(p))
    }

    /// The value at a position in squares.
    #[inline]
    fn value(&self, p: [f64; 2]) -> f32 {
        self.containing(p).map_or(0.0, |[a, b]| self.values[a * self.n_squares[1] + b])
    }
}

fn kernel(reach: usize, square_m: f64, blur_m: f64) -> Vec<f32> {
    let side = 0..2 * reach + 1;
    let offset_m = |k: usize| (k as f64 - reach as f64) * square_m;
    side.clone()
        .flat_map(|a| side.clone().map(move |b| (offset_m(a), offset_m(b))))
        .map(|(dx, dy)| libm::exp(-0.5 * (dx * dx + dy * dy) / (blur_m * blur_m)) as f32)
        .collect()
}

/// The poses to search: a centre, and how far and in which steps to go from it on either side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// The centre.
    pub centre: Pose2,
    /// Half of the width along x and y \[m\].
    pub half_width_m: f64,
    /// Step along x and y \[m\].
    pub step_m: f64,
    /// Half of the range of headings \[rad\].
    pub half_turn_rad: f64,
    /// Step of the heading \[rad\].
    pub step_rad: f64,
}

/// A small preference for poses near an expected one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preference {
    /// The expected pose.
    pub pose: Pose2,
    /// Reduction of the score per squared distance \[1/m^2\].
    pub per_m2: f64,
    /// Reduction of the score per squared angle \[1/rad^2\].
    pub per_rad2: f64,
}

/// The best pose of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BestPose {
    /// The pose.
    pub pose: Pose2,
    /// Mean value of the map at the points, minus the reductions.
    pub score: f64,
}

/// Searches the pose of a window with the best score: the mean value of the map at the moved points.
///
/// Of equally good poses, the first one counts, in the order heading, x, y. Without points, the result
/// is the centre with score 0.
pub fn search(
    map: &BlurredMap,
    points: &Points,
    window: &Window,
    preference: &Preference,
) -> BestPose {
    if points.is_empty() {
        return BestPose { pose: window.centre, score: 0.0 };
    }
    let steps = |half: f64, step: f64| (half / step).round() as i64;
    let n = steps(window.half_width_m, window.step_m);
    let n_turn = steps(window.half_turn_rad, window.step_rad);
    let mut best = BestPose { pose: window.centre, score: f64::NEG_INFINITY };
    let mut turned: Vec<[f64; 2]> = Vec::with_capacity(points.len());
    for turn in -n_turn..=n_turn {
        let heading_rad = window.centre.heading_rad + turn as f64 * window.step_rad;
        let motion = Motion::new(&Pose2 { x_m: 0.0, y_m: 0.0, heading_rad });
        turned.clear();
        turned.extend(points.positions_m.iter().map(|&p| map.in_squares(motion.direction(p))));
        let off_rad = wrap_angle(heading_rad - preference.pose.heading_rad);
        for a in -n..=n {
            let x_m = window.centre.x_m + a as f64 * window.step_m;
            for b in -n..=n {
                let y_m = window.centre.y_m + b as f64 * window.step_m;
                let [rows, columns] = [x_m, y_m].map(|v| v / map.square_m);
                let sum: f64 = turned
                    .iter()
                    .map(|p| f64::from(map.value([p[0] + rows, p[1] + columns])))
                    .sum();
                let (dx, dy) = (x_m - preference.pose.x_m, y_m - preference.pose.y_m);
                let score = sum / points.len() as f64
                    - preference.per_m2 * (dx * dx + dy * dy)
                    - preference.per_rad2 * off_rad * off_rad;
                if best.score < score {
                    let heading_rad = wrap_angle(heading_rad);
                    best = BestPose { pose: Pose2 { x_m, y_m, heading_rad }, score };
                }
            }
        }
    }
    best
}
