//! Points that scans are aligned with, sorted into squares for the search of the nearest point.

use crate::points::Points;

/// The most squares per side. A larger area gets larger squares.
const MAX_SQUARES: usize = 2048;

/// Points with an index for the search of the nearest one.
#[derive(Debug, Clone)]
pub struct Target {
    points: Points,
    square_m: f64,
    /// Lower corner of the first square \[m\].
    corner_m: [f64; 2],
    /// Squares along x and y.
    n_squares: [usize; 2],
    /// The points of square `k` are `order[starts[k]..starts[k + 1]]`.
    starts: Vec<u32>,
    order: Vec<u32>,
}

impl Target {
    /// Indexes points. Searches reach at most `reach_m` far.
    ///
    /// # Panics
    /// If a position is not finite, or if `reach_m` is not positive.
    pub fn new(points: Points, reach_m: f64) -> Self {
        assert!(0.0 < reach_m && reach_m.is_finite(), "the reach is positive");
        let positions = &points.positions_m;
        assert!(positions.iter().flatten().all(|v| v.is_finite()), "positions are finite");
        let fold = |of: fn(f64, f64) -> f64| {
            let first = positions.first().copied().unwrap_or_default();
            positions.iter().fold(first, |a, b| [of(a[0], b[0]), of(a[1], b[1])])
        };
        let (corner_m, far_m) = (fold(f64::min), fold(f64::max));
        let extent_m = (far_m[0] - corner_m[0]).max(far_m[1] - corner_m[1]);
        let square_m = reach_m.max(extent_m / (MAX_SQUARES - 1) as f64);
        let n_squares = [0, 1].map(|axis| ((far_m[axis] - corner_m[axis]) / square_m) as usize + 1);
        let mut target = Self {
            points,
            square_m,
            corner_m,
            n_squares,
            starts: vec![0; n_squares[0] * n_squares[1] + 1],
            order: Vec::new(),
        };
        target.sort();
        target
    }

    /// Sorts the points by square, and by index within a square.
    fn sort(&mut self) {
        let squares: Vec<usize> = self.points.positions_m.iter().map(|p| self.square(p)).collect();
        for &square in &squares {
            self.starts[square + 1] += 1;
        }
        for k in 1..self.starts.len() {
            self.starts[k] += self.starts[k - 1];
        }
        let mut next = self.starts.clone();
        self.order = vec![0; squares.len()];
        for (point, &square) in squares.iter().enumerate() {
            self.order[next[square] as usize] = point as u32;
            next[square] += 1;
        }
    }

    fn square(&self, p: &[f64; 2]) -> usize {
        let [a, b] = [0, 1].map(|axis| ((p[axis] - self.corner_m[axis]) / self.square_m) as usize);
        a * self.n_squares[1] + b
    }

    /// The points.
    pub fn points(&self) -> &Points {
        &self.points
    }

    /// The longest distance of a search \[m\].
    pub fn reach_m(&self) -> f64 {
        self.square_m
    }

    /// The point nearest to a position, if one is nearer than `max_m`. Of two equally near points,
    /// the one that is found first: by square, then by index. `max_m` is at most [`Target::reach_m`].
    #[inline]
    pub fn nearest(&self, [x, y]: [f64; 2], max_m: f64) -> Option<usize> {
        debug_assert!(max_m <= self.square_m, "a search does not reach past the next square");
        let square = |v: f64, axis: usize| (v - self.corner_m[axis]) / self.square_m;
        let range = |v: f64, axis: usize| {
            let k = square(v, axis);
            // Also false for NaN.
            let is_near = -1.0 < k && k < self.n_squares[axis] as f64 + 1.0;
            is_near.then(|| {
                let k = libm::floor(k) as i64;
                (k - 1).max(0) as usize..((k + 2).max(0) as usize).min(self.n_squares[axis])
            })
        };
        let (rows, columns) = (range(x, 0)?, range(y, 1)?);
        if columns.is_empty() {
            return None;
        }
        let mut nearest = None;
        let mut best_m2 = max_m * max_m;
        for row in rows {
            // The squares of a row follow each other.
            let first = row * self.n_squares[1];
            let from = self.starts[first + columns.start] as usize;
            let to = self.starts[first + columns.end] as usize;
            for &k in &self.order[from..to] {
                let p = self.points.positions_m[k as usize];
                let (dx, dy) = (p[0] - x, p[1] - y);
                let m2 = dx * dx + dy * dy;
                if m2 < best_m2 {
                    best_m2 = m2;
                    nearest = Some(k as usize);
                }
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::SplitMix64;

    fn random_points(n: usize, side_m: f64) -> Points {
        let mut random = SplitMix64::new(3);
        let mut coordinate = || side_m * random.unit();
        let positions_m: Vec<_> =
            (0..n).map(|_| [coordinate() - 2.0, coordinate() + 5.0]).collect();
        Points { normals: vec![None; n], positions_m }
    }

    #[test]
    fn the_nearest_point_is_that_of_an_exhaustive_search() {
        let points = random_points(400, 4.0);
        let target = Target::new(points.clone(), 0.3);
        let mut n_found = 0;
        for (k, query) in random_points(900, 6.0).positions_m.into_iter().enumerate() {
            let max_m = [0.05, 0.15, 0.3][k % 3];
            let distance = |p: &[f64; 2]| libm::hypot(p[0] - query[0], p[1] - query[1]);
            let expected = (0..points.len())
                .filter(|&k| distance(&points.positions_m[k]) < max_m)
                .min_by(|&a, &b| {
                    distance(&points.positions_m[a]).total_cmp(&distance(&points.positions_m[b]))
                });
            assert_eq!(target.nearest(query, max_m), expected, "{query:?}");
            n_found += usize::from(expected.is_some());
        }
        assert!((200..700).contains(&n_found), "{n_found}");
    }

    #[test]
    fn nothing_is_near_an_empty_target_or_a_position_that_is_not_finite() {
        let empty = Target::new(Points::default(), 0.5);
        assert_eq!(empty.nearest([0.0, 0.0], 0.5), None);
        let target = Target::new(random_points(10, 1.0), 0.5);
        for query in [[f64::NAN, 0.0], [f64::INFINITY, 0.0], [1e300, 5.5], [0.0, -1e300]] {
            assert_eq!(target.nearest(query, 0.5), None);
        }
    }

    /// Two points 1000 km apart: the squares become larger than asked for.
    #[test]
    fn distant_points_do_not_need_much_memory() {
        let points = Points { positions_m: vec![[0.0, 0.0], [1e6, 1e6]], normals: vec![None; 2] };
        let target = Target::new(points, 0.5);
        assert!(target.starts.len() <= MAX_SQUARES * MAX_SQUARES + 1);
        assert_eq!(target.nearest([1e6 - 0.1, 1e6], 0.5), Some(1));
    }
}
