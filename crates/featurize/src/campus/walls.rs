//! Features of the walls: gaps, runs of wall without a gap, how pieces of wall face each other, and
//! chords along the walls. Walls are weighted by their length, not by the angle that they cover as
//! seen from the sensor. The features therefore change little when the sensor moves to the side.

use super::describe::{Out, add_soft, ln_all, shares};
use super::signature::Signature;

const GAPS_M: [f64; 7] = [0.6, 1.0, 1.6, 2.5, 4.0, 7.0, 15.0];
const RUNS_M: [f64; 8] = [0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
const FACING_M: [f64; 17] =
    [0.5, 1.0, 1.4, 1.7, 2.0, 2.3, 2.6, 3.0, 3.5, 4.2, 5.0, 6.5, 8.5, 11.0, 15.0, 20.0, 30.0];
const OFFSET_M: [f64; 11] = [0.0, 0.1, 0.25, 0.5, 0.8, 1.2, 1.8, 2.5, 4.0, 7.0, 12.0];
const ACROSS_M: [f64; 12] = [1.0, 1.4, 1.7, 2.0, 2.3, 2.7, 3.2, 4.0, 5.0, 7.0, 10.0, 15.0];
/// A step is a gap if it is longer than this and longer than [`GAP_SHARE`] of its range \[m\].
const GAP_M: f64 = 0.5;
const GAP_SHARE: f64 = 0.12;
/// Two pieces are parallel if the cosine between them is at least this (about 45 deg).
const PARALLEL_COS: f64 = 0.7;
/// Two pieces face each other directly if they are less than this far apart along the wall \[m\].
const ACROSS_ALONG_M: f64 = 3.0;
/// Number of bins on each side of an axis whose chords belong to the axis \[deg\].
const WINDOW: usize = 4;

/// A step from the point of one bin to the point of the next.
#[derive(Debug, Clone, Copy)]
struct Step {
    d: [f64; 2],
    middle: [f64; 2],
    length: f64,
    /// Longest step that counts as wall \[m\].
    limit: f64,
    /// Length of wall; about 0 for a gap \[m\].
    weight: f64,
}

/// A piece of wall: one step of an open scan, two steps of a ring.
#[derive(Debug, Clone, Copy)]
struct Piece {
    at: [f64; 2],
    /// Direction of the wall, a unit vector.
    along: [f64; 2],
    weight: f64,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Walls {
    steps: Vec<Step>,
    pieces: Vec<Piece>,
}

impl Walls {
    pub(super) fn measure(&mut self, signature: &Signature) {
        let points = &signature.points;
        self.steps.clear();
        let next = points.iter().skip(1);
        let closing = points.iter().take(usize::from(signature.is_ring));
        self.steps.extend(points.iter().zip(next.chain(closing)).map(|(p, q)| step(p, q)));
        self.pieces.clear();
        let n = if signature.is_ring { 2 } else { 1 };
        self.pieces.extend(self.steps.chunks_exact(n).map(piece));
    }

    /// Writes the features `gaps_*`, `runs_*`, `facing_*`, `offset_*`, `across_*` and
    /// `perpendicular`.
    pub(super) fn describe(&self, signature: &Signature, out: &mut Out<'_>) {
        self.describe_gaps(signature.is_ring, out);
        let mut all = 0.0;
        let (mut faced, mut square) = (0.0, 0.0);
        let (mut facing, mut offset, mut across) = ([0.0; 17], [0.0; 11], [0.0; 12]);
        for (k, a) in self.pieces.iter().enumerate() {
            for b in &self.pieces[k + 1..] {
                let weight = a.weight * b.weight;
                all += weight;
                let cos = dot(a.along, b.along);
                let sin2 = 1.0 - (cos * cos).min(1.0);
                square += weight * pow8(sin2);
                if cos.abs() < PARALLEL_COS {
                    continue;
                }
                let weight = weight * pow8(cos * cos);
                let apart = [a.at[0] - b.at[0], a.at[1] - b.at[1]];
                let off = 0.5 * (cross(a.along, apart).abs() + cross(b.along, apart).abs());
                if 0.0 < cos {
                    add_soft(&mut offset, &OFFSET_M, off, weight);
                    continue;
                }
                faced += weight;
                add_soft(&mut facing, &FACING_M, off, weight);
                let along = 0.5 * (dot(a.along, apart).abs() + dot(b.along, apart).abs());
                let share = (along / ACROSS_ALONG_M).powi(2);
                if share < 1.0 {
                    add_soft(&mut across, &ACROSS_M, off, weight * (1.0 - share).powi(2));
                }
            }
        }
        out.push(&facing.map(|h| (h / all).sqrt()));
        out.push(&[(faced / all).sqrt()]);
        out.push(&shares(offset, all));
        out.push(&shares(across, all));
        out.push(&[(square / all).sqrt()]);
    }

    fn describe_gaps(&self, is_ring: bool, out: &mut Out<'_>) {
        let (mut gaps, mut runs) = ([0.0; 7], [0.0; 8]);
        let (gap_centres, run_centres) = (ln_all(GAPS_M), ln_all(RUNS_M));
        let mut run = |length: f64| {
            add_soft(&mut runs, &run_centres, libm::log(length + 1e-3), length);
        };
        // In a ring, the wall before the first gap continues the wall after the last gap.
        let mut first = None;
        let mut length = 0.0;
        for step in &self.steps {
            if step.length <= step.limit {
                length += step.length;
                continue;
            }
            add_soft(&mut gaps, &gap_centres, libm::log(step.length), 1.0);
            match first {
                None if is_ring => first = Some(length),
                _ => run(length),
            }
            length = 0.0;
        }
        run(length + first.unwrap_or(0.0));
        out.push(&gaps.map(libm::log1p));
        out.push(&runs.map(libm::log1p));
    }

    /// Writes the features of chords near the main direction of the walls. The phase of the fourth
    /// harmonic of the wall directions gives two perpendicular axes. The main direction is the axis
    /// that more wall is parallel to.
    pub(super) fn describe_chords(&self, signature: &Signature, out: &mut Out<'_>) {
        if !signature.is_ring {
            out.push(&[0.0; 8]);
            return;
        }
        let (mut re, mut im) = (0.0, 0.0);
        for step in &self.steps {
            // ((dx + i dy) / length)^4
            let [x, y] = step.d.map(|d| d / step.length);
            let [x, y] = [x * x - y * y, 2.0 * x * y];
            re += step.weight * (x * x - y * y);
            im += step.weight * (2.0 * x * y);
        }
        let axis_rad = libm::atan2(im, re) / 4.0;
        let axis = [libm::cos(axis_rad), libm::sin(axis_rad)];
        let (mut main, mut other) = (0.0, 0.0);
        for step in &self.steps {
            let squares = step.length * step.length;
            main += step.weight * pow8(dot(step.d, axis).powi(2) / squares);
            other += step.weight * pow8(cross(axis, step.d).powi(2) / squares);
        }
        let right_deg = if main < other { 90.0 } else { 0.0 };
        let n = signature.chords.len();
        let k = (axis_rad.to_degrees() + right_deg).floor().rem_euclid(n as f64) as usize % n;
        let window = |offset: usize| {
            let mut chords: [f64; 2 * WINDOW + 1] =
                std::array::from_fn(|i| signature.chords[(k + offset + n + i - WINDOW) % n]);
            chords.sort_unstable_by(f64::total_cmp);
            (chords[WINDOW], chords[2 * WINDOW])
        };
        let [main, other, one, two] = [0, 90, 45, 135].map(window);
        out.push(&[main.1, main.0, other.1, other.0]);
        out.push(&[one.0.min(two.0), one.0.max(two.0), main.0.min(other.0), main.0.max(other.0)]);
    }
}

fn step(p: &[f64; 2], q: &[f64; 2]) -> Step {
    let d = [q[0] - p[0], q[1] - p[1]];
    let middle = [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
    // Neighbours have different azimuths, but ranges can round to 0; the least length covers that.
    let length = dot(d, d).sqrt().max(1e-9);
    let limit = GAP_M.max(GAP_SHARE * dot(middle, middle).sqrt());
    let weight = length / (1.0 + (length / limit).powi(4)) + 1e-9;
    Step { d, middle, length, limit, weight }
}

fn piece(steps: &[Step]) -> Piece {
    let (mut at, mut along, mut weight) = ([0.0; 2], [0.0; 2], 0.0);
    for step in steps {
        weight += step.weight;
        for k in 0..2 {
            at[k] += step.middle[k] * step.weight;
            along[k] += step.d[k];
        }
    }
    let length = dot(along, along).sqrt() + 1e-9;
    Piece { at: at.map(|v| v / weight), along: along.map(|v| v / length), weight }
}

fn pow8(x: f64) -> f64 {
    let square = x * x;
    let fourth = square * square;
    fourth * fourth
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}
