//! Points that scans are aligned with, sorted into squares for the search of the nearest point.

use crate::points::Points;

/// Side of a square \[m\]. Returns on a wall are 0.05 m apart or more, so that a square has one or two.
const SQUARE_M: f64 = 0.1;
/// The most squares per side. A larger area gets larger squares.
const MAX_SQUARES: usize = 2048;

/// Points with an index for the search of the nearest one.
///
/// Most squares have no point. One bit per square says whether it has, and only those that have take
/// more memory.
#[derive(Debug, Clone)]
pub struct Target {
    points: Points,
    reach_m: f64,
    square_m: f64,
    /// Lower corner of the first square \[m\].
    corner_m: [f64; 2],
    /// Squares along x and y.
    n_squares: [usize; 2],
    /// Bit `k % 64` of word `k / 64`: whether square `k` has points.
    has_points: Vec<u64>,
    /// Number of squares with points before each word.
    ranks: Vec<u32>,
    /// The points of the n-th square with points are `order[starts[n]..starts[n + 1]]`.
    starts: Vec<u32>,
    order: Vec<u32>,
    /// The positions in this order.
    sorted_m: Vec<[f64; 2]>,
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
        let square_m = SQUARE_M.max(extent_m / (MAX_SQUARES - 1) as f64);
        let n_squares = [0, 1].map(|axis| ((far_m[axis] - corner_m[axis]) / square_m) as usize + 1);
        let n_words = (n_squares[0] * n_squares[1]).div_ceil(64);
        let mut target = Self {
            points,
            reach_m,
            square_m,
            corner_m,
            n_squares,
            has_points: vec![0; n_words],
            ranks: Vec::with_capacity(n_words),
            starts: Vec::new(),
            order: Vec::new(),
            sorted_m: Vec::new(),
        };
        target.sort();
        target
    }

    /// Sorts the points by square, and by index within a square.
    fn sort(&mut self) {
        let squares: Vec<usize> = self.points.positions_m.iter().map(|p| self.square(p)).collect();
        for &square in &squares {
            self.has_points[square / 64] |= 1 << (square % 64);
        }
        let mut n_before = 0;
        for word in &self.has_points {
            self.ranks.push(n_before);
            n_before += word.count_ones();
        }
        self.starts = vec![0; n_before as usize + 1];
        let ranks: Vec<usize> = squares.iter().map(|&square| self.rank(square)).collect();
        for &rank in &ranks {
            self.starts[rank + 1] += 1;
        }
        for k in 1..self.starts.len() {
            self.starts[k] += self.starts[k - 1];
        }
        let mut next = self.starts.clone();
        self.order = vec![0; ranks.len()];
        for (point, &rank) in ranks.iter().enumerate() {
            self.order[next[rank] as usize] = point as u32;
            next[rank] += 1;
        }
        let positions = &self.points.positions_m;
        self.sorted_m = self.order.iter().map(|&point| positions[point as usize]).collect();
    }

    fn square(&self, p: &[f64; 2]) -> usize {
        let [a, b] = [0, 1].map(|axis| ((p[axis] - self.corner_m[axis]) / self.square_m) as usize);
        a * self.n_squares[1] + b
    }

    /// Number of squares with points before a square.
    #[inline]
    fn rank(&self, square: usize) -> usize {
        let before = self.has_points[square / 64] & ((1 << (square % 64)) - 1);
        (self.ranks[square / 64] + before.count_ones()) as usize
    }

    /// The points.
    pub fn points(&self) -> &Points {
        &self.points
    }

    /// The longest distance of a search \[m\].
    pub fn reach_m(&self) -> f64 {
        self.reach_m
    }

    /// The point nearest to a position, if one is nearer than `max_m`. Of two equally near points, one
    /// of them; always the same one. `max_m` is at most [`Target::reach_m`].
    ///
    /// Rows of squares are searched from the inside out, as far as a point can still be nearer.
    #[inline]
    pub fn nearest(&self, position_m: [f64; 2], max_m: f64) -> Option<usize> {
        self.search(position_m, max_m, None, 0.0).point.map(|point| point as usize)
    }

    /// Searches the nearest point. A `seed` that is near makes the search short. The search goes `margin_m` farther
    /// than to the nearest point, to find the second one if it is hardly farther away.
    #[inline]
    fn search(&self, [x, y]: [f64; 2], max_m: f64, seed: Option<u32>, margin_m: f64) -> Best {
        debug_assert!(max_m <= self.reach_m, "the search does not reach farther than the target");
        let [a, b] =
            [(x - self.corner_m[0]) / self.square_m, (y - self.corner_m[1]) / self.square_m];
        let reach = max_m / self.square_m;
        // Also false for NaN.
        let is_near =
            |at: f64, axis: usize| -reach <= at && at <= self.n_squares[axis] as f64 + reach;
        let m2 = max_m * max_m;
        let mut best = Best { m2, second_m2: m2, margin_m, reach, point: None };
        if !(is_near(a, 0) && is_near(b, 1)) {
            return best;
        }
        if let Some(point) = seed {
            let p = self.points.positions_m[point as usize];
            best.offer(p, [x, y], self.square_m, || point);
        }
        // The largest integer that is not above `a`, without a call of `floor`.
        let row = a as i64 - i64::from(a < (a as i64) as f64);
        let inside = a - row as f64;
        self.search_row(row, 0.0, b, [x, y], &mut best);
        for step in 1..=(reach as i64 + 1) {
            // Distances from the position to the rows, in squares.
            let (to_below, to_above) = (inside + (step - 1) as f64, step as f64 - inside);
            if best.reach <= to_below && best.reach <= to_above {
                break;
            }
            self.search_row(row - step, to_below, b, [x, y], &mut best);
            self.search_row(row + step, to_above, b, [x, y], &mut best);
        }
        best
    }

    /// Searches the squares of a row that may have a nearer point. `to_row` is the distance from the
    /// position to the row and `column` the position along it, in squares.
    #[inline]
    fn search_row(&self, row: i64, to_row: f64, column: f64, [x, y]: [f64; 2], best: &mut Best) {
        if row < 0 || self.n_squares[0] as i64 <= row || best.reach <= to_row {
            return;
        }
        // A negative number becomes 0.
        let least = (column - best.reach) as usize;
        let most = ((column + best.reach) as i64).min(self.n_squares[1] as i64 - 1);
        if most < least as i64 {
            return;
        }
        let first = row as usize * self.n_squares[1] + least;
        let mut rest = most as usize - least + 1;
        let mut from = first;
        while 0 < rest {
            let n = rest.min(64);
            let mut bits = self.bits(from, n);
            while bits != 0 {
                let square = from + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let rank = self.rank(square);
                for entry in self.starts[rank]..self.starts[rank + 1] {
                    let entry = entry as usize;
                    let point = || self.order[entry];
                    best.offer(self.sorted_m[entry], [x, y], self.square_m, point);
                }
            }
            from += n;
            rest -= n;
        }
    }

    /// Whether each of up to 64 squares has points, one bit per square.
    #[inline]
    fn bits(&self, first: usize, n: usize) -> u64 {
        let (word, shift) = (first / 64, first % 64);
        let mut bits = self.has_points[word] >> shift;
        if 64 - shift < n {
            bits |= self.has_points[word + 1] << (64 - shift);
        }
        if n < 64 { bits & ((1 << n) - 1) } else { bits }
    }
}

/// Squared distance \[m^2\].
#[inline]
fn squared(p: [f64; 2], [x, y]: [f64; 2]) -> f64 {
    let (dx, dy) = (p[0] - x, p[1] - y);
    dx * dx + dy * dy
}

/// The nearest point so far.
struct Best {
    m2: f64,
    /// Of the second nearest point, or of the end of the search.
    second_m2: f64,
    /// The search goes so much farther than to the nearest point \[m\].
    margin_m: f64,
    /// How far the search goes, in squares.
    reach: f64,
    point: Option<u32>,
}

impl Best {
    /// Takes a point if it is nearer.
    #[inline]
    fn offer(&mut self, p: [f64; 2], at: [f64; 2], square_m: f64, point: impl Fn() -> u32) {
        let m2 = squared(p, at);
        if m2 < self.m2 {
            self.second_m2 = self.m2;
            self.m2 = m2;
            self.reach = (m2.sqrt() + self.margin_m) / square_m;
            self.point = Some(point());
        } else if m2 < self.second_m2 && self.point != Some(point()) {
            self.second_m2 = m2;
        }
    }

    /// All other points are at least this far away \[m\].
    #[inline]
    fn others_m(&self) -> f64 {
        self.second_m2.sqrt().min(self.m2.sqrt() + self.margin_m)
    }
}

/// Repeated searches of the nearest points to the points of a scan that moves a little between them. What
/// the last search found shortens the next one, or replaces it. The results are those of [`Target::nearest`]; of two
/// equally near points, it can be the other one.
pub(crate) struct Searches<'a> {
    target: &'a Target,
    /// The last search of each point.
    last: Vec<Search>,
    /// The point that was found last. Neighbouring points of a scan have neighbouring partners.
    found: Option<u32>,
}

#[derive(Clone, Copy)]
struct Search {
    position_m: [f64; 2],
    point: Option<u32>,
    /// All other points are at least this far from the position \[m\].
    others_m: f64,
}

/// A search goes so much farther than to the nearest point \[m\]. While a scan moves by less than about half of it,
/// most points need no other search. The points on a wall are about 0.05 m apart.
const MARGIN_M: f64 = 0.03;
/// Rounding errors of the distances that [`Searches`] compares are smaller \[m\].
const ROUNDING_M: f64 = 1e-9;

impl<'a> Searches<'a> {
    pub(crate) fn new(target: &'a Target, n_points: usize) -> Self {
        let nothing = Search { position_m: [0.0; 2], point: None, others_m: 0.0 };
        Self { target, last: vec![nothing; n_points], found: None }
    }

    /// The target point nearest to the point `k` at a position, if one is nearer than `max_m`.
    #[inline]
    pub(crate) fn nearest(&mut self, k: usize, position_m: [f64; 2], max_m: f64) -> Option<usize> {
        let last = self.last[k];
        let moved_m = squared(position_m, last.position_m).sqrt();
        // The other points are outside a circle around the last position. A circle around the new one is inside of it.
        let inside_m = last.others_m - moved_m - ROUNDING_M;
        match last.point {
            None if max_m < inside_m => return None,
            Some(point) => {
                let m2 = squared(self.target.points.positions_m[point as usize], position_m);
                if m2.sqrt() < inside_m {
                    return (m2 < max_m * max_m).then_some(point as usize);
                }
            }
            None => {}
        }
        let best = self.target.search(position_m, max_m, last.point.or(self.found), MARGIN_M);
        self.found = best.point.or(self.found);
        self.last[k] = Search { position_m, point: best.point, others_m: best.others_m() };
        best.point.map(|point| point as usize)
    }
}

/// Searches of the nearest points to the points of a scan, one after the other. The points of the target are also
/// those of a scan, so that the next one is often a few points after the last one.
pub(crate) struct AlongScan<'a> {
    target: &'a Target,
    last: Option<u32>,
}

/// The most points that are tried after the last one.
const MAX_STEPS: usize = 8;

impl<'a> AlongScan<'a> {
    pub(crate) fn new(target: &'a Target) -> Self {
        Self { target, last: None }
    }

    /// The target point nearest to the next position, if one is nearer than `max_m`. Of two equally near points, it can
    /// be another one than that of [`Target::nearest`].
    #[inline]
    pub(crate) fn nearest(&mut self, position_m: [f64; 2], max_m: f64) -> Option<usize> {
        let positions = &self.target.points.positions_m;
        let seed = self.last.map(|last| {
            let (mut seed, mut m2) = (last, squared(positions[last as usize], position_m));
            for (next, &p) in positions[last as usize..].iter().enumerate().skip(1).take(MAX_STEPS)
            {
                let next_m2 = squared(p, position_m);
                if m2 <= next_m2 {
                    break;
                }
                (seed, m2) = (last + next as u32, next_m2);
            }
            seed
        });
        let found = self.target.search(position_m, max_m, seed, 0.0).point;
        self.last = found.or(self.last);
        found.map(|point| point as usize)
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

    /// Points that move by small and by large steps, with a shrinking and a growing reach.
    #[test]
    fn repeated_searches_find_the_same_as_single_ones() {
        let target = Target::new(random_points(400, 4.0), 0.5);
        let queries = random_points(300, 6.0).positions_m;
        let mut searches = Searches::new(&target, queries.len());
        let mut n_found = 0;
        for round in 0..40 {
            let max_m = [0.5, 0.4, 0.3, 0.05, 0.5][round % 5];
            let step_m = if round % 7 == 6 { 0.7 } else { 0.01 };
            for (k, query) in queries.iter().enumerate() {
                let at = [query[0] + step_m * round as f64, query[1]];
                let expected = target.nearest(at, max_m);
                assert_eq!(searches.nearest(k, at, max_m), expected);
                n_found += usize::from(expected.is_some());
            }
        }
        assert!((2000..11_000).contains(&n_found), "{n_found}");
    }

    /// The points of a wall in the order of a scan, and in the opposite order.
    #[test]
    fn searches_along_a_scan_find_the_same_as_single_ones() {
        let wall: Vec<[f64; 2]> = (0..200).map(|k| [0.05 * f64::from(k), 2.0]).collect();
        let target = Target::new(Points { normals: vec![None; 200], positions_m: wall }, 0.35);
        let mut queries: Vec<[f64; 2]> =
            (0..90).map(|k| [0.13 * f64::from(k) - 0.5, 2.0 + 0.005 * f64::from(k)]).collect();
        for _ in 0..2 {
            let mut searches = AlongScan::new(&target);
            let mut n_found = 0;
            for query in &queries {
                let expected = target.nearest(*query, 0.35);
                assert_eq!(searches.nearest(*query, 0.35), expected, "{query:?}");
                n_found += usize::from(expected.is_some());
            }
            assert!((60..80).contains(&n_found), "{n_found}");
            queries.reverse();
        }
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
        assert!(target.has_points.len() <= MAX_SQUARES * MAX_SQUARES / 64 + 1);
        assert_eq!(target.nearest([1e6 - 0.1, 1e6], 0.5), Some(1));
    }
}
