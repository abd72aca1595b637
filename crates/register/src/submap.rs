//! Submaps: which squares around a node are occupied, free or unknown.

use std::ops::Range;

use dataset::{Pose2, Scan};
use serde::{Deserialize, Serialize};

use crate::points::{Motion, length};

/// How submaps are made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SubmapOptions {
    /// Side of a square \[m\].
    pub square_m: f64,
    /// Squares per side of the submap. The node is in the middle.
    pub n_squares: u32,
    /// Returns farther than this are not used \[m\].
    pub max_range_m: f64,
    /// The space of a ray is free up to this distance before its return \[m\].
    pub free_margin_m: f64,
    /// A square is occupied if it has at least this many hits per scan that sees through it. Smaller
    /// values keep people, larger ones lose thin objects.
    pub min_hits_per_free: f64,
    /// Angle of the sectors in which the nearest return limits the free space \[deg\].
    pub sector_deg: f64,
}

impl Default for SubmapOptions {
    fn default() -> Self {
        Self {
            square_m: 0.4,
            n_squares: 128,
            max_range_m: 15.0,
            free_margin_m: 0.5,
            min_hits_per_free: 0.35,
            sector_deg: 2.0,
        }
    }
}

/// A scan of a submap.
#[derive(Debug, Clone, Copy)]
pub struct Member<'a> {
    /// The pose of the scan in the frame of the node.
    pub node_from_scan: Pose2,
    /// The scan.
    pub scan: &'a Scan,
}

/// What is known about a square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Square {
    /// It contains a surface.
    Occupied,
    /// The sensor has seen through it, and no neighbour is occupied.
    Free,
    /// Not seen, or next to something occupied.
    Unknown,
}

/// A map of squares around a node.
#[derive(Debug, Clone, PartialEq)]
pub struct Submap {
    square_m: f64,
    n_squares: usize,
    occupied: Bits,
    free: Bits,
}

/// One bit per square, row-major, x first. A drive has thousands of submaps, which should fit into memory.
#[derive(Debug, Clone, PartialEq)]
struct Bits(Vec<u64>);

impl Bits {
    fn of(values: impl ExactSizeIterator<Item = bool>) -> Self {
        let mut words = vec![0; values.len().div_ceil(64)];
        for (k, value) in values.enumerate() {
            words[k / 64] |= u64::from(value) << (k % 64);
        }
        Self(words)
    }

    #[inline]
    fn at(&self, k: usize) -> bool {
        self.0[k / 64] >> (k % 64) & 1 == 1
    }
}

impl Submap {
    /// Joins scans. The result does not depend on the order of the scans.
    ///
    /// A square is occupied if `hits >= min_hits_per_free * free`, where `hits` and `free` are the
    /// numbers of scans that have a return in it, and that see through it. In a sector without a return
    /// nothing is free: the beam may have met glass, or something too far away.
    ///
    /// # Panics
    /// If the options have no squares or sectors.
    pub fn new(members: &[Member<'_>], options: &SubmapOptions) -> Self {
        let n = options.n_squares as usize;
        assert!(0 < n && 0.0 < options.square_m, "a submap has squares");
        let mut counts = Counts { hits: vec![0; n * n], free: vec![0; n * n] };
        let mut last_hit = vec![u32::MAX; n * n];
        let mut nearest_m = vec![f64::INFINITY; sectors(options)];
        for (member, number) in members.iter().zip(0..) {
            count_hits(member, number, options, &mut counts.hits, &mut last_hit);
        }
        for member in members {
            nearest_returns(member.scan, options, &mut nearest_m);
            count_free(member, options, &nearest_m, &mut counts);
        }
        let is_occupied = |k: usize| {
            let (hits, free) = (counts.hits[k], counts.free[k]);
            0 < hits && options.min_hits_per_free * f64::from(free) <= f64::from(hits)
        };
        let occupied: Vec<bool> = (0..n * n).map(is_occupied).collect();
        let is_free =
            |k: usize| !occupied[k] && 0 < counts.free[k] && !has_neighbour(&occupied, n, k);
        Self {
            square_m: options.square_m,
            n_squares: n,
            free: Bits::of((0..n * n).map(is_free)),
            occupied: Bits::of(occupied.iter().copied()),
        }
    }

    /// Squares per side.
    pub fn n_squares(&self) -> usize {
        self.n_squares
    }

    /// Side of a square \[m\].
    pub fn square_m(&self) -> f64 {
        self.square_m
    }

    /// All squares, row-major, x first, `(n_squares, n_squares)`.
    pub fn squares(&self) -> impl Iterator<Item = Square> + '_ {
        (0..self.n_squares * self.n_squares).map(|k| self.square(k))
    }

    fn square(&self, k: usize) -> Square {
        match (self.occupied.at(k), self.free.at(k)) {
            (true, _) => Square::Occupied,
            (false, true) => Square::Free,
            (false, false) => Square::Unknown,
        }
    }

    /// The squares of a kind, as row and column, in the order of [`Submap::squares`].
    pub fn of_kind(&self, kind: Square) -> impl Iterator<Item = [usize; 2]> + '_ {
        let n = self.n_squares;
        let words = self.occupied.0.iter().zip(&self.free.0).enumerate();
        let bits = words.flat_map(move |(word, (occupied, free))| {
            let mut left = match kind {
                Square::Occupied => *occupied,
                Square::Free => *free,
                Square::Unknown => !(occupied | free),
            };
            std::iter::from_fn(move || {
                let next = (left != 0).then(|| 64 * word + left.trailing_zeros() as usize);
                left &= left.wrapping_sub(1);
                next
            })
        });
        // The last word has more bits than squares.
        bits.take_while(move |&k| k < n * n).map(move |k| [k / n, k % n])
    }

    /// The square at a position in the frame of the node. [`Square::Unknown`] outside the submap.
    pub fn at(&self, position_m: [f64; 2]) -> Square {
        index(position_m, self.n_squares, self.square_m).map_or(Square::Unknown, |k| self.square(k))
    }

    /// Whether the square at a position or one of its 8 neighbours is occupied.
    pub fn is_near_occupied(&self, position_m: [f64; 2]) -> bool {
        index(position_m, self.n_squares, self.square_m).is_some_and(|k| {
            let n = self.n_squares;
            let around = |v: usize| v.saturating_sub(1)..(v + 2).min(n);
            around(k / n).any(|a| around(k % n).any(|b| self.occupied.at(a * n + b)))
        })
    }

    /// The centres of the squares of a kind \[m\], in the frame of the node.
    pub fn centres(&self, kind: Square) -> impl Iterator<Item = [f64; 2]> + '_ {
        let centre =
            |square: [usize; 2]| centre_m(square.map(|k| k as f64), self.n_squares, self.square_m);
        self.of_kind(kind).map(centre)
    }
}

struct Counts {
    /// Number of scans with a return in each square.
    hits: Vec<u32>,
    /// Number of scans that see through each square. Of a square without hits, it matters only whether there is one.
    free: Vec<u32>,
}

fn sectors(options: &SubmapOptions) -> usize {
    assert!(0.0 < options.sector_deg && options.sector_deg <= 360.0, "a submap has sectors");
    (360.0 / options.sector_deg).ceil() as usize
}

fn index([x, y]: [f64; 2], n: usize, square_m: f64) -> Option<usize> {
    let along = |v: f64| v / square_m + n as f64 / 2.0;
    let (a, b) = (along(x), along(y));
    // False for NaN.
    let is_inside = 0.0 <= a && 0.0 <= b && a < n as f64 && b < n as f64;
    is_inside.then(|| a as usize * n + b as usize)
}

/// The centre of a square, from its numbers along x and y. Those of a block lie between the numbers of its squares.
fn centre_m(square: [f64; 2], n: usize, square_m: f64) -> [f64; 2] {
    square.map(|k| (k + 0.5 - n as f64 / 2.0) * square_m)
}

/// Counts each square with a return once.
fn count_hits(
    member: &Member<'_>,
    number: u32,
    options: &SubmapOptions,
    hits: &mut [u32],
    last_hit: &mut [u32],
) {
    let motion = Motion::new(&member.node_from_scan);
    for p in member.scan.points() {
        // False for NaN.
        let is_used = length(p) < options.max_range_m;
        let square = index(motion.point(p), options.n_squares as usize, options.square_m);
        if let Some(k) = square.filter(|&k| is_used && last_hit[k] != number) {
            last_hit[k] = number;
            hits[k] += 1;
        }
    }
}

/// The range of the nearest return in each sector and its two neighbours; 0 in a sector without a
/// return.
fn nearest_returns(scan: &Scan, options: &SubmapOptions, nearest_m: &mut [f64]) {
    let n = nearest_m.len();
    let mut ranges_m = vec![f64::INFINITY; n];
    for p in scan.points() {
        let range_m = length(p);
        if range_m < options.max_range_m {
            let range = &mut ranges_m[sector(p, n)];
            *range = range.min(range_m);
        }
    }
    for k in 0..n {
        let around = [ranges_m[(k + n - 1) % n], ranges_m[k], ranges_m[(k + 1) % n]];
        nearest_m[k] = match ranges_m[k].is_finite() {
            true => around.into_iter().fold(f64::INFINITY, f64::min),
            false => 0.0,
        };
    }
}

/// The sector of a direction.
pub(crate) fn sector(p: [f64; 2], n: usize) -> usize {
    ((turns(p) * n as f64) as usize) % n
}

/// The direction of a vector in turns from the negative x axis, 0 to 1.
///
/// Within 2e-6 turns of the right value (Abramowitz and Stegun 1964, formula 4.4.49), which is
/// enough to find a sector, and several times faster than `libm::atan2`.
fn turns([x, y]: [f64; 2]) -> f64 {
    let (least, most) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    if most == 0.0 {
        return 0.5;
    }
    let t = least / most;
    let t2 = t * t;
    let series =
        0.999_866 + t2 * (-0.330_299_5 + t2 * (0.180_141 + t2 * (-0.085_133 + t2 * 0.020_835_1)));
    let eighth = t * series / std::f64::consts::TAU;
    let quarter = if x.abs() < y.abs() { 0.25 - eighth } else { eighth };
    let half = if x < 0.0 { 0.5 - quarter } else { quarter };
    0.5 + if y < 0.0 { -half } else { half }
}

/// Squares per side of a block that is left out at once if all of it is behind the nearest returns.
const BLOCK: usize = 8;

/// Counts each square whose centre is before the nearest return of its sector.
fn count_free(
    member: &Member<'_>,
    options: &SubmapOptions,
    nearest_m: &[f64],
    counts: &mut Counts,
) {
    let n = options.n_squares as usize;
    let scan_from_node = Motion::new(&member.node_from_scan.inverse());
    let middle = |v: f64| v / options.square_m + n as f64 / 2.0;
    let reach = options.max_range_m / options.square_m + 1.0;
    let range = |v: f64| {
        let (from, to) = (middle(v) - reach, middle(v) + reach + 1.0);
        from.clamp(0.0, n as f64) as usize..to.clamp(0.0, n as f64) as usize
    };
    let [rows, columns] = [member.node_from_scan.x_m, member.node_from_scan.y_m].map(range);
    let blocks = |of: &Range<usize>| {
        let end = of.end;
        of.clone().step_by(BLOCK).map(move |from| from..(from + BLOCK).min(end))
    };
    let point = |square: [f64; 2]| scan_from_node.point(centre_m(square, n, options.square_m));
    for rows in blocks(&rows) {
        for columns in blocks(&columns) {
            let middle = [&rows, &columns].map(|of| (of.start + of.end - 1) as f64 / 2.0);
            let half_m = options.square_m * (BLOCK - 1) as f64 * std::f64::consts::FRAC_1_SQRT_2;
            if is_behind(point(middle), half_m, nearest_m, options.free_margin_m) {
                continue;
            }
            for a in rows.clone() {
                for b in columns.clone() {
                    let k = a * n + b;
                    // Most squares are seen by many scans and have no hit.
                    if counts.hits[k] == 0 && 0 < counts.free[k] {
                        continue;
                    }
                    let p = point([a, b].map(|k| k as f64));
                    let nearest_m = nearest_m[sector(p, nearest_m.len())];
                    counts.free[k] += u32::from(length(p) < nearest_m - options.free_margin_m);
                }
            }
        }
    }
}

/// Whether all points within `radius_m` of a point are behind the nearest returns of their sectors.
fn is_behind(p: [f64; 2], radius_m: f64, nearest_m: &[f64], margin_m: f64) -> bool {
    let n = nearest_m.len();
    let range_m = length(p);
    if range_m <= 2.0 * radius_m {
        return false;
    }
    // The angle of a chord of this size is less than 1.05 times its ratio to the range. One sector more for
    // rounding.
    let turns = 1.05 * radius_m / range_m / std::f64::consts::TAU;
    let n_around = ((turns * n as f64) as usize + 2).min(n / 2);
    let middle = sector(p, n);
    let around = (middle + n - n_around..=middle + n + n_around).map(|k| nearest_m[k % n]);
    around.fold(0.0, f64::max) - margin_m <= range_m - radius_m
}

/// Whether one of the 8 neighbours is occupied.
fn has_neighbour(occupied: &[bool], n: usize, k: usize) -> bool {
    let (row, column) = (k / n, k % n);
    let around = |v: usize| v.saturating_sub(1)..(v + 2).min(n);
    around(row).any(|a| around(column).any(|b| occupied[a * n + b]))
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;

    use super::*;

    #[test]
    fn the_direction_in_turns_is_that_of_atan2() {
        for k in 0..10_000 {
            let angle = (f64::from(k) - 4999.5) / 5000.0 * std::f64::consts::PI;
            let found = turns([2.0 * angle.cos(), 2.0 * angle.sin()]);
            let expected = angle / std::f64::consts::TAU + 0.5;
            assert!((found - expected).abs() < 2e-6, "{angle}: {found}, expected {expected}");
        }
        assert_eq!(turns([0.0, 0.0]), 0.5);
        assert!(sector([-1.0, 0.0], 180) == 0);
    }

    /// Points around a block's middle, where the nearest return of each sector is known.
    #[test]
    fn nothing_of_a_block_behind_the_returns_is_before_them() {
        let mut random = SplitMix64::new(5);
        let mut n_behind = 0;
        for _ in 0..2000 {
            let nearest_m: Vec<f64> = (0..180).map(|_| 2.0 + 8.0 * random.unit()).collect();
            let [x, y] = [0, 1].map(|_| 30.0 * random.unit() - 15.0);
            let radius_m = 2.0 * random.unit();
            if !is_behind([x, y], radius_m, &nearest_m, 0.5) {
                continue;
            }
            n_behind += 1;
            for k in 0..64 {
                let (sin, cos) = libm::sincos(f64::from(k) / 64.0 * std::f64::consts::TAU);
                let p = [x + radius_m * cos, y + radius_m * sin];
                assert!(nearest_m[sector(p, 180)] - 0.5 <= length(p), "{p:?}");
            }
        }
        assert!((300..1900).contains(&n_behind), "{n_behind}");
    }
}
