//! Search of the best pose in a window, by correlation with blurred points.

use dataset::{Pose2, wrap_angle};
use rayon::prelude::*;

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

    /// The number along an axis of the square that contains a position in squares.
    #[inline]
    fn along(&self, axis: usize, v: f64) -> Option<usize> {
        // False for NaN.
        (0.0 <= v && v < self.n_squares[axis] as f64).then_some(v as usize)
    }

    fn square(&self, p: [f64; 2]) -> Option<[usize; 2]> {
        let [a, b] = self.in_squares(p);
        Some([self.along(0, a)?, self.along(1, b)?])
    }

    /// The value at a position. 0 outside the map.
    #[inline]
    pub fn at(&self, p: [f64; 2]) -> f32 {
        self.square(p).map_or(0.0, |[a, b]| self.values[a * self.n_squares[1] + b])
    }

    /// Sums of the values at points that are turned and then moved, `(xs_m.len(), ys_m.len())`.
    fn sums(&self, points: &Points, turned: &Motion, xs_m: &[f64], ys_m: &[f64]) -> Vec<f64> {
        let in_squares = |of: &[f64]| of.iter().map(|v| v / self.square_m).collect::<Vec<f64>>();
        let (rows, columns) = (in_squares(xs_m), in_squares(ys_m));
        let mut sums = vec![0.0; rows.len() * columns.len()];
        let mut at = vec![None; columns.len()];
        for &p in &points.positions_m {
            let [row, column] = self.in_squares(turned.direction(p));
            for (at, moved) in at.iter_mut().zip(&columns) {
                *at = self.along(1, column + moved);
            }
            for (moved, sums) in rows.iter().zip(sums.chunks_exact_mut(columns.len())) {
                let Some(row) = self.along(0, row + moved) else { continue };
                let values = &self.values[row * self.n_squares[1]..][..self.n_squares[1]];
                for (sum, at) in sums.iter_mut().zip(&at) {
                    *sum += at.map_or(0.0, |column| f64::from(values[column]));
                }
            }
        }
        sums
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
    let n_turn = steps(window.half_turn_rad, window.step_rad);
    let turns: Vec<i64> = (-n_turn..=n_turn).collect();
    let best_of = |&turn: &i64| search_heading(map, points, window, preference, turn);
    let of_headings: Vec<BestPose> = turns.par_iter().map(best_of).collect();
    let none = BestPose { pose: window.centre, score: f64::NEG_INFINITY };
    of_headings.into_iter().fold(none, |best, next| match best.score < next.score {
        true => next,
        false => best,
    })
}

/// Number of steps to one side. A negative half counts as 0.
fn steps(half: f64, step: f64) -> i64 {
    ((half / step).round() as i64).max(0)
}

/// The best pose with one heading.
fn search_heading(
    map: &BlurredMap,
    points: &Points,
    window: &Window,
    preference: &Preference,
    turn: i64,
) -> BestPose {
    let n = steps(window.half_width_m, window.step_m);
    let heading_rad = window.centre.heading_rad + turn as f64 * window.step_rad;
    let motion = Motion::new(&Pose2 { x_m: 0.0, y_m: 0.0, heading_rad });
    let offsets_m = |centre_m: f64| -> Vec<f64> {
        (-n..=n).map(|k| centre_m + k as f64 * window.step_m).collect()
    };
    let (xs_m, ys_m) = (offsets_m(window.centre.x_m), offsets_m(window.centre.y_m));
    let sums = map.sums(points, &motion, &xs_m, &ys_m);
    let off_rad = wrap_angle(heading_rad - preference.pose.heading_rad);
    let heading_rad = wrap_angle(heading_rad);
    let mut best = BestPose { pose: window.centre, score: f64::NEG_INFINITY };
    for (&x_m, sums) in xs_m.iter().zip(sums.chunks_exact(ys_m.len())) {
        for (&y_m, sum) in ys_m.iter().zip(sums) {
            let (dx, dy) = (x_m - preference.pose.x_m, y_m - preference.pose.y_m);
            let score = sum / points.len() as f64
                - preference.per_m2 * (dx * dx + dy * dy)
                - preference.per_rad2 * off_rad * off_rad;
            if best.score < score {
                best = BestPose { pose: Pose2 { x_m, y_m, heading_rad }, score };
            }
        }
    }
    best
}
