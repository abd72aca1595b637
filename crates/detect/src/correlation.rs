//! Relative poses of two submaps by correlation.

use std::f64::consts::TAU;
use std::ops::AddAssign;

use dataset::{Pose2, wrap_angle};
use register::{Square, Submap};

/// Headings that are compared, over a full circle: every 5 deg.
pub(crate) const N_HEADINGS: usize = 72;
/// Shifts along x and along y that are compared: -7 to 7 squares, which are 2.8 m.
pub(crate) const REACH: usize = 7;
/// Number of shifts along an axis.
pub(crate) const N_SHIFTS: usize = 2 * REACH + 1;
/// A wall on a wall counts as this value. Scores are sums of integers, so that they are exact.
pub(crate) const UNIT: i32 = 64;
/// Another pose differs by more than this many headings (15 deg) ...
const OTHER_HEADINGS: usize = 3;
/// ... or is farther away than this many squares (1.2 m).
const OTHER_SQUARES: usize = 3;
/// Standard deviation of the blur of the walls \[squares\], and its factor: a wall one square away counts
/// about 0.6.
const BLUR_SQUARES: f64 = 0.7;
const BLUR_FACTOR: f64 = 3.0;
/// Reach of the blur. Farther away, the blur is less than half of 1 / 64.
const BLUR_REACH: usize = 2;

/// Values that are added at once: the shifts of one row, rounded up to whole registers.
const LANES: usize = 16;
/// Shifts along x whose sums are made at once.
const ROWS: usize = 4;
/// Sums of this many values fit into 16 bits.
const MAX_VALUES: usize = 256;
/// Sums of this many values of 0 or 1 fit into 8 bits.
const MAX_FREE: usize = 255;

/// A submap that others are laid onto.
#[derive(Debug, Clone)]
pub(crate) struct Reference {
    /// Blurred walls minus free space, with a margin of [`REACH`] squares.
    values: Vec<i16>,
    /// Squares between two rows of `values`.
    stride: usize,
    /// Index of each wall in [`Turned::free`], without the margin.
    walls: Vec<u32>,
}

/// A submap at each of the headings.
#[derive(Debug, Clone)]
pub(crate) struct Query {
    /// Squares between two rows of [`Turned::free`].
    stride: usize,
    square_m: f64,
    n_walls: usize,
    headings: Vec<Turned>,
}

/// A submap at one heading.
#[derive(Debug, Clone)]
struct Turned {
    /// Index of each wall in [`Reference::values`], without the margin.
    walls: Vec<u32>,
    /// 1 for free squares, with a margin of [`REACH`] squares.
    free: Vec<u8>,
}

/// A pose with a high score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peak {
    /// Score, in units of [`UNIT`].
    pub(crate) score: i32,
    /// The pose of the query in the frame of the reference.
    pub(crate) pose: Pose2,
}

/// The scores of all poses, `(N_HEADINGS, N_SHIFTS, N_SHIFTS)`.
///
/// The score of a pose is the number of walls of the query that lie on walls of the reference (on blurred
/// ones, as a fraction), minus the number of its walls in the free space of the reference, minus the number
/// of walls of the reference in its free space. The squares of the query are turned, and those that fall
/// into the same square count once.
#[derive(Debug, Clone)]
pub(crate) struct Scores {
    values: Vec<i32>,
    square_m: f64,
}

impl Reference {
    pub(crate) fn new(submap: &Submap) -> Self {
        let n = submap.n_squares();
        let stride = n + LANES;
        let mut values = vec![0i16; (n + 2 * REACH) * stride];
        let walls = squares(submap, Square::Occupied);
        let kernel = blur_kernel();
        for &[a, b] in &walls {
            for (row, weights) in kernel.iter().enumerate() {
                // BLUR_REACH is less than REACH, so the margin has room.
                let at = (a as usize + REACH + row - BLUR_REACH) * stride;
                let first = at + b as usize + REACH - BLUR_REACH;
                for (value, weight) in values[first..].iter_mut().zip(weights) {
                    *value = (*value + weight).min(UNIT as i16);
                }
            }
        }
        for [a, b] in squares(submap, Square::Free) {
            values[(a as usize + REACH) * stride + b as usize + REACH] -= UNIT as i16;
        }
        clear_margin(&mut values, n, stride);
        let walls = walls.into_iter().map(|wall| flat(wall, n + LANES)).collect();
        Self { values, stride, walls }
    }

    /// Number of walls.
    pub(crate) fn n_walls(&self) -> usize {
        self.walls.len()
    }
}

/// Index of a square in an image with this many squares per row.
fn flat([row, column]: [u32; 2], stride: usize) -> u32 {
    row * stride as u32 + column
}

/// What is outside the submap is unknown.
fn clear_margin(values: &mut [i16], n: usize, stride: usize) {
    for (row, values) in values.chunks_exact_mut(stride).enumerate() {
        let is_inside = (REACH..REACH + n).contains(&row);
        let inside = if is_inside { REACH..REACH + n } else { 0..0 };
        values[..inside.start].fill(0);
        values[inside.end..].fill(0);
    }
}

impl Query {
    pub(crate) fn new(submap: &Submap) -> Self {
        let n = submap.n_squares();
        let (walls, free) = (squares(submap, Square::Occupied), squares(submap, Square::Free));
        let headings = (0..N_HEADINGS).map(|k| Turned::new(n, &walls, &free, heading_rad(k)));
        Self {
            stride: n + LANES,
            square_m: submap.square_m(),
            n_walls: walls.len(),
            headings: headings.collect(),
        }
    }

    /// Number of walls.
    pub(crate) fn n_walls(&self) -> usize {
        self.n_walls
    }
}

impl Turned {
    fn new(n: usize, walls: &[[u32; 2]], free: &[[u32; 2]], heading_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(heading_rad);
        let middle = n as f64 / 2.0;
        // The square that contains the turned centre.
        let turn = |[a, b]: [u32; 2]| {
            let (x, y) = (f64::from(a) + 0.5 - middle, f64::from(b) + 0.5 - middle);
            let (row, column) = (cos * x - sin * y + middle, sin * x + cos * y + middle);
            let is_inside = 0.0 <= row && 0.0 <= column && row < n as f64 && column < n as f64;
            is_inside.then_some([row as u32, column as u32])
        };
        let mut turned: Vec<[u32; 2]> = walls.iter().filter_map(|&w| turn(w)).collect();
        turned.sort_unstable();
        turned.dedup();
        let stride = n + LANES;
        let mut image = vec![0u8; (n + 2 * REACH) * stride];
        for [a, b] in free.iter().filter_map(|&f| turn(f)) {
            image[(a as usize + REACH) * stride + b as usize + REACH] = 1;
        }
        Self { walls: turned.into_iter().map(|wall| flat(wall, n + LANES)).collect(), free: image }
    }
}

impl Scores {
    /// The scores of a query on a reference.
    pub(crate) fn new(reference: &Reference, query: &Query) -> Self {
        Self { values: all_scores(reference, query), square_m: query.square_m }
    }

    /// The poses with the highest scores: the best one, then the best one elsewhere (more than 15 deg or
    /// 1.2 m from the ones before), and so on. Of equal scores, the first one counts, in the order heading,
    /// x, y.
    pub(crate) fn peaks(mut self, n: usize) -> Vec<Peak> {
        let mut peaks = Vec::with_capacity(n);
        for _ in 0..n {
            let score = self.values.iter().copied().max().unwrap_or(i32::MIN);
            let at = self.values.iter().position(|&value| value == score);
            let Some(at) = at.filter(|_| i32::MIN < score) else { break };
            let (heading, x, y) = position(at);
            let metres = |shift: usize| (shift as f64 - REACH as f64) * self.square_m;
            let pose = Pose2 { x_m: metres(x), y_m: metres(y), heading_rad: heading_rad(heading) };
            peaks.push(Peak { score, pose });
            self.remove_around(heading, x, y);
        }
        peaks
    }

    /// Removes the scores of a peak.
    fn remove_around(&mut self, heading: usize, x: usize, y: usize) {
        let around =
            |v: usize| v.saturating_sub(OTHER_SQUARES)..(v + OTHER_SQUARES + 1).min(N_SHIFTS);
        for turn in 0..=2 * OTHER_HEADINGS {
            let heading = (heading + N_HEADINGS + turn - OTHER_HEADINGS) % N_HEADINGS;
            for other_x in around(x) {
                for other_y in around(y) {
                    let (dx, dy) = (x.abs_diff(other_x), y.abs_diff(other_y));
                    if dx * dx + dy * dy <= OTHER_SQUARES * OTHER_SQUARES {
                        self.values[(heading * N_SHIFTS + other_x) * N_SHIFTS + other_y] = i32::MIN;
                    }
                }
            }
        }
    }
}

/// All scores, with wider registers if the processor has them. Sums of integers do not depend on it.
fn all_scores(reference: &Reference, query: &Query) -> Vec<i32> {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { all_scores_avx2(reference, query) };
    }
    sum_all(reference, query)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn all_scores_avx2(reference: &Reference, query: &Query) -> Vec<i32> {
    sum_all(reference, query)
}

#[inline(always)]
fn sum_all(reference: &Reference, query: &Query) -> Vec<i32> {
    let mut values = Vec::with_capacity(N_HEADINGS * N_SHIFTS * N_SHIFTS);
    for turned in &query.headings {
        for next in (0..N_SHIFTS).step_by(ROWS) {
            // The last block overlaps the one before.
            let shift = next.min(N_SHIFTS - ROWS);
            let shifted = &reference.values[shift * reference.stride..];
            let on_walls = sum_rows(shifted, reference.stride, &turned.walls, MAX_VALUES);
            // The first row is that of the last shift.
            let shifted = &turned.free[(N_SHIFTS - ROWS - shift) * query.stride..];
            let in_free = sum_rows(shifted, query.stride, &reference.walls, MAX_FREE);
            for row in next - shift..ROWS {
                // The row k of `in_free` is the shift ROWS - 1 - k, and its lane k the shift 2 REACH - k.
                let (on_walls, in_free) = (&on_walls[row], &in_free[ROWS - 1 - row]);
                let score = |k: usize| on_walls[k] - UNIT * in_free[2 * REACH - k];
                values.extend((0..N_SHIFTS).map(score));
            }
        }
    }
    values
}

/// Heading, shift along x and shift along y of a score.
fn position(k: usize) -> (usize, usize, usize) {
    (k / (N_SHIFTS * N_SHIFTS), k / N_SHIFTS % N_SHIFTS, k % N_SHIFTS)
}

fn heading_rad(k: usize) -> f64 {
    wrap_angle(TAU * k as f64 / N_HEADINGS as f64)
}

/// Sums of the values at the walls, shifted by each lane along y, and by each row along x. Up to `most` values can be
/// added without overflow.
#[inline(always)]
fn sum_rows<T: Copy + Default + AddAssign + Into<i32>>(
    values: &[T],
    stride: usize,
    walls: &[u32],
    most: usize,
) -> [[i32; LANES]; ROWS] {
    let mut sums = [[0i32; LANES]; ROWS];
    for walls in walls.chunks(most) {
        // Four variables and no loop over them: then the compiler keeps them in registers.
        let [mut a, mut b, mut c, mut d] = [[T::default(); LANES]; ROWS];
        for &at in walls {
            // The margin has room for all lanes.
            let rows = &values[at as usize..][..(ROWS - 1) * stride + LANES];
            add(&mut a, rows);
            add(&mut b, &rows[stride..]);
            add(&mut c, &rows[2 * stride..]);
            add(&mut d, &rows[3 * stride..]);
        }
        for (sums, row) in sums.iter_mut().zip([a, b, c, d]) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += value.into();
            }
        }
    }
    sums
}

#[inline(always)]
fn add<T: Copy + AddAssign>(sums: &mut [T; LANES], values: &[T]) {
    let values = &values[..LANES];
    for k in 0..LANES {
        sums[k] += values[k];
    }
}

/// Row and column of the squares of a kind.
fn squares(submap: &Submap, kind: Square) -> Vec<[u32; 2]> {
    submap.of_kind(kind).map(|square| square.map(|k| k as u32)).collect()
}

/// The blur of a single wall, times [`UNIT`] and rounded.
fn blur_kernel() -> [[i16; 2 * BLUR_REACH + 1]; 2 * BLUR_REACH + 1] {
    let weight = |k: i32| libm::exp(-0.5 * (f64::from(k) / BLUR_SQUARES).powi(2));
    // The sum over four standard deviations.
    let sum: f64 = (-3..=3).map(weight).sum();
    let at = |k: usize| weight(k as i32 - BLUR_REACH as i32) / sum;
    let value = |a: usize, b: usize| libm::round(f64::from(UNIT) * BLUR_FACTOR * at(a) * at(b));
    std::array::from_fn(|a| std::array::from_fn(|b| value(a, b) as i16))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::{Scan, SplitMix64};
    use register::{Member, SubmapOptions};

    /// A submap of a scan in a room of 10 m by 6 m, with a box at a random place.
    fn submap(seed: u64) -> Submap {
        let mut random = SplitMix64::new(seed);
        let (x, y) = (1.0 + 3.0 * random.unit(), 2.0 * random.unit() - 1.0);
        let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
        for k in 0..720 {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) / 720.0);
            let to_x = (if cos > 0.0 { 5.5 } else { -4.5 }) / cos;
            let to_y = (if sin > 0.0 { 2.0 } else { -4.0 }) / sin;
            let behind_box = (sin * x - cos * y).abs() < 0.6 && 0.0 < cos * x + sin * y;
            let to_box = if behind_box { libm::hypot(x, y) - 0.3 } else { f64::INFINITY };
            let range_m = to_x.min(to_y).min(to_box);
            scan.x_m.push((range_m * cos) as f32);
            scan.y_m.push((range_m * sin) as f32);
        }
        let node_from_scan = Pose2 { x_m: 0.3, y_m: -0.2, heading_rad: 4.0 * random.unit() };
        Submap::new(&[Member { node_from_scan, scan: &scan }], &SubmapOptions::default())
    }

    /// Blurred walls: three times a Gaussian filter of 0.7 squares, at most 1.
    fn blurred(submap: &Submap, a: i64, b: i64) -> f64 {
        let weight = |k: i64| libm::exp(-0.5 * (k as f64 / 0.7).powi(2));
        let sum: f64 = (-3..=3).map(weight).sum();
        let mut value = 0.0;
        for (da, db) in (-3..=3).flat_map(|da| (-3..=3).map(move |db| (da, db))) {
            let is_wall = at(submap, a + da, b + db) == Square::Occupied;
            value += f64::from(u8::from(is_wall)) * weight(da) * weight(db) / (sum * sum);
        }
        (3.0 * value).min(1.0)
    }

    fn at(submap: &Submap, a: i64, b: i64) -> Square {
        let middle = submap.n_squares() as f64 / 2.0;
        submap.at([a, b].map(|k| (k as f64 + 0.5 - middle) * submap.square_m()))
    }

    /// The squares of a kind, turned, as a set.
    fn turned(submap: &Submap, kind: Square, heading: usize) -> Vec<(i64, i64)> {
        let (sin, cos) = libm::sincos(TAU * heading as f64 / N_HEADINGS as f64);
        let square = |v: f64| libm::floor(v / 0.4 + 64.0) as i64;
        let mut squares: Vec<(i64, i64)> = submap
            .centres(kind)
            .map(|[x, y]| (square(cos * x - sin * y), square(sin * x + cos * y)))
            .collect();
        squares.sort_unstable();
        squares.dedup();
        squares
    }

    /// The blurred walls are rounded to 1 / 64, up to 25 times, so a wall counts within 0.05 of its value.
    #[test]
    fn scores_are_those_of_the_definition() {
        let (a, b) = (submap(1), submap(2));
        let (reference, query) = (Reference::new(&a), Query::new(&b));
        let scores = Scores::new(&reference, &query);
        let n_walls = query.n_walls() as f64;
        let (mut best, mut best_direct) = ((i32::MIN, 0), (f64::MIN, 0));
        for (k, &score) in scores.values.iter().enumerate() {
            let (heading, x, y) = position(k);
            // Every fifth heading, because the direct sums are slow.
            if heading % 5 != 0 {
                continue;
            }
            let (dx, dy) = (x as i64 - REACH as i64, y as i64 - REACH as i64);
            let walls = turned(&b, Square::Occupied, heading);
            let free = turned(&b, Square::Free, heading);
            let on_walls: f64 = walls.iter().map(|(p, q)| blurred(&a, p + dx, q + dy)).sum();
            let count = |squares: &[(i64, i64)], kind: Square| {
                squares.iter().filter(|(p, q)| at(&a, p + dx, q + dy) == kind).count()
            };
            let n_conflicts = count(&walls, Square::Free) + count(&free, Square::Occupied);
            let direct = on_walls - n_conflicts as f64;
            let difference = f64::from(score) / f64::from(UNIT) - direct;
            assert!(difference.abs() < 0.02 * n_walls, "{k}: {score} {direct}");
            if best.0 < score {
                best = (score, k);
            }
            if best_direct.0 < direct {
                best_direct = (direct, k);
            }
        }
        assert_eq!(best.1, best_direct.1);
    }

    #[test]
    fn wider_registers_give_the_same_scores() {
        let (reference, query) = (Reference::new(&submap(1)), Query::new(&submap(4)));
        assert_eq!(all_scores(&reference, &query), sum_all(&reference, &query));
    }

    /// A submap on itself: each wall lies on a wall, nothing is in free space.
    #[test]
    fn a_submap_fits_itself_best() {
        let submap = submap(3);
        let (reference, query) = (Reference::new(&submap), Query::new(&submap));
        let peaks = Scores::new(&reference, &query).peaks(3);
        assert_eq!(peaks[0].pose, Pose2::default());
        let share = f64::from(peaks[0].score) / f64::from(UNIT) / query.n_walls() as f64;
        assert!((0.9..=1.0).contains(&share), "{share}");
        assert!(peaks[1].score < peaks[0].score && peaks[2].score <= peaks[1].score);
    }

    /// The best score is at heading 0, where scores at 355 deg and 1.2 m away belong to the same peak. At
    /// 20 deg and at 1.6 m, they do not.
    #[test]
    fn peaks_are_15_deg_or_1_2_m_apart() {
        let mut values = vec![0; N_HEADINGS * N_SHIFTS * N_SHIFTS];
        let k = |heading: usize, x: usize, y: usize| (heading * N_SHIFTS + x) * N_SHIFTS + y;
        for (at, score) in [
            (k(0, REACH, REACH), 100),
            (k(71, REACH, REACH + 3), 99),
            (k(69, REACH + 2, REACH + 2), 98),
            (k(4, REACH, REACH), 97),
            (k(0, REACH, REACH + 4), 96),
            (k(4, REACH + 1, REACH + 1), 95),
        ] {
            values[at] = score;
        }
        let peaks = Scores { values, square_m: 0.4 }.peaks(3);
        let found: Vec<i32> = peaks.iter().map(|peak| peak.score).collect();
        assert_eq!(found, [100, 97, 96]);
        let second = peaks[1].pose;
        assert!((second.heading_rad - 20f64.to_radians()).abs() < 1e-12);
        assert_eq!((second.x_m, second.y_m), (0.0, 0.0));
        assert!((peaks[2].pose.y_m - 1.6).abs() < 1e-12);
    }

    #[test]
    fn a_blurred_wall_is_at_most_one() {
        let kernel = blur_kernel();
        // 192 / (1 + 2 exp(-1 / 0.98) + 2 exp(-4 / 0.98) + ..)^2 = 192 * 0.5698^2 = 62.3.
        assert_eq!(kernel[2][2], 62);
        assert_eq!((kernel[2][1], kernel[1][1], kernel[0][0]), (22, 8, 0));
    }
}
