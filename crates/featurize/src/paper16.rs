//! The 16 features of the paper (Appendix A). docs/features.md, "`paper16` v1", contains the
//! formulas and the choices that the paper leaves open.
//!
//! Notation: there are `n` returns `p_i` in measured order, with mean `mu` and ranges `r_i`. A step
//! leads from one return to the next; `d_i` is its length and `a_i` is the angle between the two
//! returns, seen from the sensor. A closed ring has `m = n` steps, and the last step leads back to
//! the first return. An open scan has `m = n - 1` steps. `g` is the gate. Sample standard deviations
//! divide by the count minus 1.

use dataset::{Scan, Unusable};

use crate::lanes::{count, deviations, fill, sums};

/// Names, in order; the columns of `features/<log>.parquet`.
pub const PAPER16_NAMES: [&str; 16] = [
    "centroid",
    "close_area",
    "close_distance",
    "circle_radius",
    "circle_residual",
    "curvature_mean",
    "curvature_std",
    "distance",
    "groups",
    "mean_group_size",
    "mean_angular_difference",
    "mean_deviation",
    "regularity",
    "size",
    "std_of_mean",
    "std_of_ranges",
];

/// Computes the features of one scan after another. It reuses its memory.
///
/// Each step of the computation runs over whole columns, so the compiler can use vector
/// instructions.
#[derive(Debug, Clone)]
pub struct Paper16 {
    gate_m: f64,
    /// Coordinates of the returns \[m\]. In a ring, the first returns are repeated after the last
    /// one, as many as a step or a triple needs to cross the end.
    x: Vec<f64>,
    y: Vec<f64>,
    steps_m: Vec<f64>,
    crosses: Vec<f64>,
    angles_rad: Vec<f64>,
    scratch: Vec<f64>,
    squares: Vec<f64>,
}

impl Paper16 {
    /// See [`Options::gate_m`](crate::Options::gate_m) for the meaning of `gate_m`.
    pub fn new(gate_m: f64) -> Self {
        Self {
            gate_m,
            x: Vec::new(),
            y: Vec::new(),
            steps_m: Vec::new(),
            crosses: Vec::new(),
            angles_rad: Vec::new(),
            scratch: Vec::new(),
            squares: Vec::new(),
        }
    }

    /// The features of a scan, in the order of [`PAPER16_NAMES`]. They are always finite.
    ///
    /// Angles are in rad, lengths in m, areas in m^2, curvatures in 1/m.
    pub fn features(&mut self, scan: &Scan) -> Result<[f64; 16], Unusable> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the function only requires AVX2, and the processor has it.
            return unsafe { self.features_avx2(scan) };
        }
        self.compute(scan)
    }

    /// The same computation with wider vectors. The bits are the same: each operation is rounded
    /// separately, and the number of lanes in a sum does not depend on the width of the vectors.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn features_avx2(&mut self, scan: &Scan) -> Result<[f64; 16], Unusable> {
        self.compute(scan)
    }

    #[inline(always)]
    fn compute(&mut self, scan: &Scan) -> Result<[f64; 16], Unusable> {
        if scan.len() < 3 {
            return Err(Unusable::TooFewReturns);
        }
        let n_points = scan.len();
        let n = n_points as f64;
        refill(&mut self.x, scan.x_m.iter().map(|&x| f64::from(x)));
        refill(&mut self.y, scan.y_m.iter().map(|&y| f64::from(y)));
        let mu = sums([&self.x, &self.y], |point| point).map(|sum| sum / n);
        let circle = self.fit_circle(scan, mu)?;
        let is_ring = scan.is_ring();
        self.measure_steps(is_ring);
        let m = self.steps_m.len();

        let gate_m = self.gate_m;
        let n_breaks = m - count(&self.steps_m, |d| d <= gate_m);
        let groups = if is_ring { n_breaks.max(1) } else { n_breaks + 1 } as f64;
        let close = |d: f64, value: f64| if d <= gate_m { value } else { 0.0 };
        let steps = [&self.steps_m[..]];
        let [close_area] =
            sums([&self.steps_m, &self.crosses], |[d, cross]| [close(d, 0.5 * cross)]);
        let [close_distance] = sums(steps, |[d]| [close(d, d)]);
        let [distance] = sums(steps, |d| d);
        let [angles] = sums([&self.angles_rad], |angle| angle);
        let regularity = sample_std(&self.steps_m, distance);

        let points = [&self.x[..n_points], &self.y[..n_points]];
        let scratch = &mut self.scratch;
        let Circle { centre: [cx, cy], radius, squared_deviations } = circle;
        fill(scratch, points, |[x, y]| radius - length(x - cx, y - cy));
        let [circle_residual] = sums([scratch], |[off]| [off * off]);
        let [mx, my] = mu;
        fill(scratch, points, |[x, y]| length(x - mx, y - my));
        let [sum] = sums([scratch], |off| off);
        let std_of_mean = sample_std(scratch, sum);
        fill(scratch, points, |[x, y]| length(x, y));
        let [sum] = sums([scratch], |r| r);
        let std_of_ranges = sample_std(scratch, sum);

        let curvature = match curvature_stride(&self.angles_rad, &mut self.scratch) {
            Some(stride) => self.menger_curvatures(n_points, is_ring, stride),
            None => MeanStd { mean: 0.0, std: 0.0 },
        };

        Ok([
            length(mu[0], mu[1]),                    // 1 centroid: |mu|
            close_area,                              // 2 sum over close steps of 1/2 |p x q|
            close_distance,                          // 3 sum of close d_i
            radius,                                  // 4 circle_radius
            circle_residual,                         // 5 sum of (R - |p_i - c|)^2
            curvature.mean,                          // 6 curvature_mean
            curvature.std,                           // 7 curvature_std
            distance,                                // 8 sum of all d_i
            groups,                                  // 9 groups
            n / groups,                              // 10 mean_group_size
            angles / m as f64,                       // 11 mean_angular_difference
            (squared_deviations / (n - 1.0)).sqrt(), // 12 mean_deviation
            regularity,                              // 13 sample deviation of the d_i
            n,                                       // 14 size
            std_of_mean,                             // 15 sample deviation of |p_i - mu|
            std_of_ranges,                           // 16 sample deviation of r_i
        ])
    }

    /// Computes the lengths d_i, the cross products |p_i x p_i+1| and the angles a_i of the steps.
    #[inline(always)]
    fn measure_steps(&mut self, is_ring: bool) {
        let Self { x, y, steps_m, crosses, angles_rad, .. } = self;
        if is_ring {
            x.push(x[0]);
            y.push(y[0]);
        }
        let m = x.len() - 1;
        let ends = [&x[..m], &y[..m], &x[1..], &y[1..]];
        fill(steps_m, ends, |[x, y, next_x, next_y]| length(next_x - x, next_y - y));
        fill(crosses, ends, |[x, y, next_x, next_y]| (x * next_y - next_x * y).abs());
        fill(angles_rad, ends, |[x, y, next_x, next_y]| {
            (x * next_y - next_x * y).abs() / (x * next_x + y * next_y)
        });
        // -0.0 means an angle of 180 deg. NaN means that a return is at the sensor itself.
        let is_small = |t: f64| t.is_sign_positive() && t < SMALL_TANGENT;
        let all_small = count(angles_rad, is_small) == m;
        if all_small {
            angles_rad.iter_mut().for_each(|t| *t = small_atan(*t));
            return;
        }
        for (k, t) in angles_rad.iter_mut().enumerate() {
            let dot = x[k] * x[k + 1] + y[k] * y[k + 1];
            *t = if is_small(*t) { small_atan(*t) } else { libm::atan2(crosses[k], dot) };
        }
    }

    /// The circle that minimises the sum of (|p - c|^2 - R^2)^2 (Kasa 1976, "A circle fitting
    /// procedure and its error analysis"), in coordinates (u, v) about the mean, where the normal
    /// equations are
    ///
    /// ```text
    /// | Suu Suv | |uc|   1 | Suuu + Suvv |
    /// | Suv Svv | |vc| = - | Svvv + Suuv |     R^2 = uc^2 + vc^2 + (Suu + Svv) / n
    ///                    2
    /// ```
    ///
    /// The determinant is positive unless all points are on one line. `Scan::check_usable` decides
    /// about that, but only if the determinant is too small to be sure.
    #[inline(always)]
    fn fit_circle(&self, scan: &Scan, mu: [f64; 2]) -> Result<Circle, Unusable> {
        // A separate loop for each sum: the compiler would not vectorise five sums in one loop.
        let points = [&self.x[..], &self.y[..]];
        let about = |[x, y]: [f64; 2]| (x - mu[0], y - mu[1]);
        let [suu] = sums(points, |p| [about(p).0 * about(p).0]);
        let [suv] = sums(points, |p| [about(p).0 * about(p).1]);
        let [svv] = sums(points, |p| [about(p).1 * about(p).1]);
        let square = |p: [f64; 2]| square(about(p).0, about(p).1);
        let [bu] = sums(points, |p| [about(p).0 * square(p)]);
        let [bv] = sums(points, |p| [about(p).1 * square(p)]);
        let (det, trace) = (suu * svv - suv * suv, suu + svv);
        let is_certain = det.is_finite() && CLEARLY_NOT_ONE_LINE * trace * trace < det;
        if !is_certain {
            scan.check_usable()?;
        }
        let uc = 0.5 * (bu * svv - bv * suv) / det;
        let vc = 0.5 * (bv * suu - bu * suv) / det;
        let radius = (uc * uc + vc * vc + (suu + svv) / scan.len() as f64).sqrt();
        Ok(Circle { centre: [mu[0] + uc, mu[1] + vc], radius, squared_deviations: trace })
    }

    /// Menger curvatures 4 A / (a b c) of the triples (i - s, i, i + s), where A is the area of the
    /// triangle and a, b, c are its sides. Only triples with all sides in (0, g] count. Without any,
    /// the result is 0.
    #[inline(always)]
    fn menger_curvatures(&mut self, n: usize, is_ring: bool, stride: usize) -> MeanStd {
        let Self { gate_m, x, y, scratch, squares, .. } = self;
        let gate_m = *gate_m;
        // In a ring, a stride longer than the ring wraps around.
        let stride = if is_ring { stride % n } else { stride };
        let n_triples = if is_ring { n } else { n.saturating_sub(stride.saturating_mul(2)) };
        if n_triples == 0 {
            return MeanStd { mean: 0.0, std: 0.0 };
        }
        for column in [&mut *x, &mut *y] {
            column.truncate(n);
            while column.len() < n_triples + 2 * stride {
                column.push(column[column.len() - n]);
            }
        }
        let n_chords = n_triples + stride;
        let [x0, y0] = [&x[..n_chords], &y[..n_chords]];
        let [x1, y1] = [&x[stride..][..n_chords], &y[stride..][..n_chords]];
        fill(squares, [x0, y0, x1, y1], |[x0, y0, x1, y1]| square(x1 - x0, y1 - y0));
        let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(|column| &column[..n_triples]);
        let [x2, y2] = [&x[2 * stride..][..n_triples], &y[2 * stride..][..n_triples]];
        let [a2, b2] = [&squares[..n_triples], &squares[stride..][..n_triples]];
        // With squared lengths, the three sides need only one square root.
        let gate = gate_m * gate_m;
        let within = |square: f64| (0.0 < square) & (square <= gate);
        fill(scratch, [x0, y0, x1, y1, x2, y2, a2, b2], |[x0, y0, x1, y1, x2, y2, a2, b2]| {
            let c2 = square(x2 - x0, y2 - y0);
            let doubled_area = ((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)).abs();
            let curvature = 2.0 * doubled_area / (a2 * b2 * c2).sqrt();
            if within(a2) & within(b2) & within(c2) { curvature } else { NO_CURVATURE }
        });
        let is_curvature = |v: f64| 0.0 <= v;
        let [n_within, sum] = sums([scratch], |[v]| {
            [f64::from(is_curvature(v)), if is_curvature(v) { v } else { 0.0 }]
        });
        if n_within < 1.0 {
            return MeanStd { mean: 0.0, std: 0.0 };
        }
        let mean = sum / n_within;
        let [squares] = sums([scratch], |[v]| {
            let off = if is_curvature(v) { v - mean } else { 0.0 };
            [off * off]
        });
        let std = if n_within < 2.0 { 0.0 } else { (squares / (n_within - 1.0)).sqrt() };
        MeanStd { mean, std }
    }
}

/// Marks a triple with a side outside (0, g]. Curvatures are 0 or more.
const NO_CURVATURE: f64 = -1.0;

/// If det / trace^2 of the scatter matrix is more than this, the points are certainly not on one
/// line, whatever the rounding. It is ten times the limit of [`Scan::check_usable`].
const CLEARLY_NOT_ONE_LINE: f64 = 1e-11;

/// For tangents below this, four terms of the series of atan are enough: the fifth term, t^9 / 9,
/// is less than 1e-17 of t.
const SMALL_TANGENT: f64 = 0.009;

/// atan t = t - t^3 / 3 + t^5 / 5 - t^7 / 7, for t below [`SMALL_TANGENT`].
#[inline(always)]
fn small_atan(t: f64) -> f64 {
    let square = t * t;
    t - t * square * (1.0 / 3.0 - square * (0.2 - square / 7.0))
}

#[inline(always)]
fn refill(column: &mut Vec<f64>, values: impl Iterator<Item = f64>) {
    column.clear();
    column.extend(values);
}

#[inline(always)]
fn square(dx: f64, dy: f64) -> f64 {
    dx * dx + dy * dy
}

#[inline(always)]
fn length(dx: f64, dy: f64) -> f64 {
    square(dx, dy).sqrt()
}

/// Sample standard deviation: the square root of the sum of squared deviations over count - 1.
/// `sum` is the sum of the values. 0 for fewer than 2 values.
#[inline(always)]
fn sample_std(values: &[f64], sum: f64) -> f64 {
    if values.len() < 2 {
        return 0.0;
    }
    (deviations(values, sum) / (values.len() as f64 - 1.0)).sqrt()
}

struct Circle {
    centre: [f64; 2],
    radius: f64,
    /// Suu + Svv: the sum of squared distances of the points from their mean.
    squared_deviations: f64,
}

struct MeanStd {
    mean: f64,
    std: f64,
}

/// The number of returns in about one degree: max(1, round(1 deg / median a_i)). `None` if the
/// median is 0, because returns in the same direction span no angle, no matter how many there are.
#[inline(always)]
fn curvature_stride(angles_rad: &[f64], scratch: &mut Vec<f64>) -> Option<usize> {
    let one = 1f64.to_radians();
    let stride_of = |median: f64| ((one / median).round() as usize).max(1);
    // The median of a few angles gives a guess. If both middle angles of all are well within the
    // range of angles that give the guessed stride, the guess is right and nothing is sorted.
    refill(scratch, angles_rad.iter().copied().step_by(SAMPLE_STEP));
    let guess = median(scratch);
    if 0.0 < guess {
        let stride = stride_of(guess);
        let low = one / (stride as f64 + 0.5) * (1.0 + 1e-9);
        let high =
            if stride == 1 { f64::INFINITY } else { one / (stride as f64 - 0.5) * (1.0 - 1e-9) };
        let n = angles_rad.len();
        if count(angles_rad, |a| a <= low) <= (n - 1) / 2 && n / 2 < count(angles_rad, |a| a < high)
        {
            return Some(stride);
        }
    }
    refill(scratch, angles_rad.iter().copied());
    let median = median(scratch);
    (0.0 < median).then(|| stride_of(median))
}

/// One angle in this many is used for the guess.
const SAMPLE_STEP: usize = 32;

/// The middle value, or the mean of the two middle values. Reorders the values.
///
/// `dataset::quantile` would need sorted values. Selecting the middle one is faster.
fn median(values: &mut [f64]) -> f64 {
    let (middle, is_odd) = (values.len() / 2, values.len() % 2 == 1);
    let (below, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    if is_odd {
        return upper;
    }
    let lower = below.iter().copied().max_by(f64::total_cmp).unwrap_or(upper);
    0.5 * (lower + upper)
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::{Just, Strategy, prop_oneof};
    use proptest::{prop_assert_eq, proptest};

    use super::*;

    /// Asserts that [`Paper16::features`], which uses the widest vectors of the processor, and
    /// [`Paper16::compute`] give the same bits or the same error.
    fn check_same_bits(features: &mut Paper16, scan: &Scan) {
        let [wide, plain] = [features.features(scan), features.compute(scan)]
            .map(|found| found.map(|values| values.map(f64::to_bits)));
        assert_eq!(wide, plain, "{} returns, {} deg", scan.len(), scan.coverage_deg);
    }

    /// Open scans and rings with 0 to `max_returns` returns: random points, points on a lattice
    /// (equal points, lines, the sensor itself), and circles with noise. Many have 3 returns or a
    /// few more, where vectors are not full.
    fn any_scan(max_returns: usize) -> impl Strategy<Value = Scan> {
        let metres = || prop_oneof![-70f32..70.0, -1f32..1.0, (-2..3).prop_map(|v| v as f32)];
        let n_returns = || prop_oneof![Just(3), 0..20usize, 0..=max_returns];
        let points = n_returns().prop_flat_map(move |n| vec((metres(), metres()), n));
        let circle = n_returns().prop_flat_map(|n| {
            vec(4f32..4.2, n).prop_map(move |ranges| {
                let angle = |k: usize| k as f32 / n as f32 * std::f32::consts::TAU;
                let point = |(k, r): (usize, f32)| (r * angle(k).cos(), r * angle(k).sin());
                ranges.into_iter().enumerate().map(point).collect()
            })
        });
        let coverage_deg = prop_oneof![Just(360f32), Just(355.0), Just(354.9), 0f32..360.0];
        (prop_oneof![points, circle], coverage_deg).prop_map(|(points, coverage_deg)| {
            let points: Vec<(f32, f32)> = points;
            let (x_m, y_m) = points.into_iter().unzip();
            Scan { x_m, y_m, coverage_deg, ..Scan::default() }
        })
    }

    proptest! {
        #[test]
        fn wider_vectors_give_the_same_bits_for_any_scans(
            scans in vec(any_scan(300), 1..6),
            gate_m in prop_oneof![Just(2.5), 0.01..5.0],
        ) {
            let mut features = Paper16::new(gate_m);
            for scan in &scans {
                check_same_bits(&mut features, scan);
            }
        }

        /// The stride from a guess equals the stride from the median of all angles, sorted.
        #[test]
        fn the_guessed_stride_is_the_stride_of_the_median(
            angles_deg in vec(prop_oneof![0.0..3.0, Just(0.0), Just(0.2), 0.1995..0.2005, Just(1.0)], 1..200),
        ) {
            let angles_rad: Vec<f64> = angles_deg.iter().map(|a: &f64| a.to_radians()).collect();
            let found = curvature_stride(&angles_rad, &mut vec![7.0; 3]);
            let mut sorted = angles_rad;
            sorted.sort_by(f64::total_cmp);
            let (lower, upper) = (sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2]);
            let median = if sorted.len() % 2 == 1 { upper } else { 0.5 * (lower + upper) };
            let stride = (1f64.to_radians() / median).round() as usize;
            prop_assert_eq!(found, (0.0 < median).then_some(stride.max(1)));
        }
    }

    /// Rooms with any number of returns, with people and gaps. On a processor without AVX2 both
    /// results come from the same code.
    #[test]
    fn wider_vectors_give_the_same_bits() {
        let mut features = Paper16::new(2.5);
        for n in 3..200u32 {
            let at = |k: u32| {
                let angle = f64::from(k) * std::f64::consts::TAU / f64::from(n);
                let range =
                    3.0 + f64::from(k * k * 7919 % 101) * if k % 5 < 2 { 0.1 } else { 0.001 };
                (range * libm::cos(angle), range * libm::sin(angle))
            };
            let scan = Scan {
                x_m: (0..n).map(|k| at(k).0 as f32).collect(),
                y_m: (0..n).map(|k| at(k).1 as f32).collect(),
                coverage_deg: if n % 2 == 0 { 359.0 } else { 180.0 },
                ..Scan::default()
            };
            assert!(scan.check_usable().is_ok());
            check_same_bits(&mut features, &scan);
        }
    }
}
