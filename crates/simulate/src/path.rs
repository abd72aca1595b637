//! A smooth path through control points, parametrized by arc length.

use crate::plane::{Point, Vector, cross};
use crate::route::Route;

/// Entries of the arc length table per span between control points.
const STEPS_PER_SPAN: usize = 8;

/// A smooth path: a uniform cubic B-spline, parametrized by arc length. Its curvature is continuous.
///
/// Memory: about 45 bytes per metre.
#[derive(Debug, Clone)]
pub(crate) struct Path {
    control: Vec<Point>,
    /// Arc length from the start to each step of each span \[m\].
    lengths: Vec<f64>,
}

impl Path {
    /// A path of at least `length_m` along a route.
    pub(crate) fn new(route: &Route, length_m: f64) -> Self {
        let control_point = |k: usize| route.control_point(k);
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

    /// Arc length and curvature at each step \[m, 1/m\].
    pub(crate) fn curvatures(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.lengths[..self.lengths.len() - 1].iter().enumerate().map(|(step, &length_m)| {
            let u = (step % STEPS_PER_SPAN) as f64 / STEPS_PER_SPAN as f64;
            (length_m, self.curvature(step / STEPS_PER_SPAN, u))
        })
    }

    /// Curvature in a span: |p' x p''| / |p'|^3.
    fn curvature(&self, k: usize, u: f64) -> f64 {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| self.control[k + i].coords);
        let second = a * (1.0 - u) + b * (3.0 * u - 2.0) + c * (1.0 - 3.0 * u) + d * u;
        let first = self.spline(k, u).1;
        let speed = first.norm();
        cross(first, second).abs() / (speed * speed * speed)
    }

    /// Position and unit tangent at an arc length.
    pub(crate) fn at(&self, length_m: f64) -> (Point, Vector) {
        let after = self.lengths.partition_point(|&l| l <= length_m);
        let step = after.clamp(1, self.lengths.len() - 1) - 1;
        let (from, to) = (self.lengths[step], self.lengths[step + 1]);
        let rest_m = (length_m - from).clamp(0.0, to - from);
        // Linear interpolation, then one step of Newton's method: accurate to a millionth of a step.
        let h = 1.0 / STEPS_PER_SPAN as f64;
        let (span, u0) = (step / STEPS_PER_SPAN, (step % STEPS_PER_SPAN) as f64 * h);
        let guess = h * rest_m / (to - from);
        let error_m = self.stretch_m(span, u0, guess) - rest_m;
        let u = u0 + guess - error_m / self.spline(span, u0 + guess).1.norm();
        let (position, tangent) = self.spline(span, u);
        (position, tangent.normalize())
    }

    /// Arc length of span `k` from `u` to `u + h`, by Simpson's rule \[m\].
    fn stretch_m(&self, k: usize, u: f64, h: f64) -> f64 {
        let speed = |u: f64| self.spline(k, u).1.norm();
        h / 6.0 * (speed(u) + 4.0 * speed(u + h / 2.0) + speed(u + h))
    }

    /// Value and derivative of the B-spline in the span between control points `k + 1` and `k + 2`,
    /// for `u` from 0 to 1.
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
