//! The 16 features of the paper (Appendix A), as DESIGN, "The 16 features", decides what the
//! paper leaves open.
//!
//! Notation: `n` returns `p_i` in measured order, `mu` their mean, `r_i` their ranges. A step
//! leads from a return to the next; `d_i` is its length and `a_i` the angle it subtends at the
//! sensor. A closed ring has `m = n` steps, the last one back to the first return; an open scan
//! has `m = n - 1`. `g` is the gate. Sample deviations divide by count - 1.

use dataset::{Scan, Unusable};

/// Names, in order; the columns of `features.parquet`.
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

/// Computes the features of one scan after another, reusing its memory.
#[derive(Debug, Clone)]
pub struct Paper16 {
    gate_m: f64,
    points: Vec<[f64; 2]>,
    steps_m: Vec<f64>,
    angles_rad: Vec<f64>,
    scratch: Vec<f64>,
}

impl Paper16 {
    /// `gate_m` separates groups; see [`Options::gate_m`](crate::Options::gate_m).
    pub fn new(gate_m: f64) -> Self {
        Self {
            gate_m,
            points: Vec::new(),
            steps_m: Vec::new(),
            angles_rad: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// The features of a scan, in the order of [`PAPER16_NAMES`]; always finite.
    ///
    /// Angles in rad, lengths in m, areas in m^2, curvatures in 1/m.
    pub fn features(&mut self, scan: &Scan) -> Result<[f64; 16], Unusable> {
        scan.check_usable()?;
        self.points.clear();
        self.points.extend(scan.points());
        let is_ring = scan.is_ring();
        self.measure_steps(is_ring);

        let Self { gate_m, points, steps_m, angles_rad, scratch } = self;
        let gate_m = *gate_m;
        let n = points.len() as f64;
        let m = steps_m.len() as f64;

        let [sum_x, sum_y] = points.iter().fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
        let mu = [sum_x / n, sum_y / n];

        let close = || steps_m.iter().filter(|&&d| d <= gate_m);
        let n_breaks = steps_m.len() - close().count();
        let groups = if is_ring { n_breaks.max(1) } else { n_breaks + 1 } as f64;

        let close_area: f64 = steps(points, is_ring)
            .zip(steps_m.iter())
            .filter(|&(_, &d)| d <= gate_m)
            .map(|((p, q), _)| 0.5 * cross(p, q).abs())
            .sum();

        let circle = fit_circle(points, mu);
        let circle_residual: f64 =
            points.iter().map(|p| (circle.radius - distance(p, &circle.centre)).powi(2)).sum();

        let curvature = match curvature_stride(angles_rad, scratch) {
            Some(stride) => menger_curvatures(points, is_ring, stride, gate_m, scratch),
            None => MeanStd { mean: 0.0, std: 0.0 },
        };

        scratch.clear();
        scratch.extend(points.iter().map(|p| distance(p, &mu)));
        let squared_deviations: f64 = scratch.iter().map(|d| d * d).sum();
        let std_of_mean = sample_std(scratch);

        scratch.clear();
        scratch.extend(points.iter().map(|p| distance(p, &[0.0; 2])));
        let std_of_ranges = sample_std(scratch);

        Ok([
            distance(&mu, &[0.0; 2]),                // 1 centroid: |mu|
            close_area,                              // 2 sum over close steps of 1/2 |p x q|
            close().sum(),                           // 3 close_distance: sum of close d_i
            circle.radius,                           // 4 circle_radius
            circle_residual,                         // 5 sum of (R - |p_i - c|)^2
            curvature.mean,                          // 6 curvature_mean
            curvature.std,                           // 7 curvature_std
            steps_m.iter().sum(),                    // 8 distance: sum of all d_i
            groups,                                  // 9 groups
            n / groups,                              // 10 mean_group_size
            angles_rad.iter().sum::<f64>() / m,      // 11 mean_angular_difference
            (squared_deviations / (n - 1.0)).sqrt(), // 12 mean_deviation
            sample_std(steps_m),                     // 13 regularity
            n,                                       // 14 size
            std_of_mean,                             // 15 sample deviation of |p_i - mu|
            std_of_ranges,                           // 16 sample deviation of r_i
        ])
    }

    fn measure_steps(&mut self, is_ring: bool) {
        self.steps_m.clear();
        self.steps_m.extend(steps(&self.points, is_ring).map(|(p, q)| distance(p, q)));
        // Tangents first, for all at once; the few angles that are not small then one by one.
        self.angles_rad.clear();
        self.angles_rad
            .extend(steps(&self.points, is_ring).map(|(p, q)| cross(p, q).abs() / dot(p, q)));
        for (angle, (p, q)) in self.angles_rad.iter_mut().zip(steps(&self.points, is_ring)) {
            let t = *angle;
            *angle = if (0.0..SMALL_TANGENT).contains(&t) && 0.0 < dot(p, q) {
                small_atan(t)
            } else {
                libm::atan2(cross(p, q).abs(), dot(p, q))
            };
        }
    }
}

/// Tangents below this are angles by four terms: the fifth, t^9 / 9, is less than 1e-17 of t.
const SMALL_TANGENT: f64 = 0.009;

/// atan t = t - t^3 / 3 + t^5 / 5 - t^7 / 7, for t below [`SMALL_TANGENT`].
#[inline]
fn small_atan(t: f64) -> f64 {
    let square = t * t;
    t - t * square * (1.0 / 3.0 - square * (0.2 - square / 7.0))
}

/// Each return with the next; in a closed ring the last one with the first too.
fn steps(points: &[[f64; 2]], is_ring: bool) -> impl Iterator<Item = (&[f64; 2], &[f64; 2])> {
    let closing = if is_ring { points.last().zip(points.first()) } else { None };
    points.iter().zip(points.iter().skip(1)).chain(closing)
}

fn distance(p: &[f64; 2], q: &[f64; 2]) -> f64 {
    ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)).sqrt()
}

fn cross(p: &[f64; 2], q: &[f64; 2]) -> f64 {
    p[0] * q[1] - q[0] * p[1]
}

fn dot(p: &[f64; 2], q: &[f64; 2]) -> f64 {
    p[0] * q[0] + p[1] * q[1]
}

/// Square root of the sum of squared deviations over count - 1; 0 for fewer than 2 values.
fn sample_std(values: &[f64]) -> f64 {
    if values.len() < 2 {
        return 0.0;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
}

struct Circle {
    centre: [f64; 2],
    radius: f64,
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
/// The points are not on one line (`Scan::check_usable`), so that the determinant is positive.
fn fit_circle(points: &[[f64; 2]], mu: [f64; 2]) -> Circle {
    let (mut suu, mut suv, mut svv, mut bu, mut bv) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for p in points {
        let (u, v) = (p[0] - mu[0], p[1] - mu[1]);
        let square = u * u + v * v;
        suu += u * u;
        suv += u * v;
        svv += v * v;
        bu += u * square;
        bv += v * square;
    }
    let det = suu * svv - suv * suv;
    let uc = 0.5 * (bu * svv - bv * suv) / det;
    let vc = 0.5 * (bv * suu - bu * suv) / det;
    let radius = (uc * uc + vc * vc + (suu + svv) / points.len() as f64).sqrt();
    Circle { centre: [mu[0] + uc, mu[1] + vc], radius }
}

/// How many returns make about one degree: max(1, round(1 deg / median a_i)). None where the
/// median is 0: returns that lie behind one another span no angle, however many.
fn curvature_stride(angles_rad: &[f64], scratch: &mut Vec<f64>) -> Option<usize> {
    scratch.clear();
    scratch.extend_from_slice(angles_rad);
    let median_rad = median(scratch);
    (0.0 < median_rad).then(|| ((1f64.to_radians() / median_rad).round() as usize).max(1))
}

/// The middle value, or the mean of the two middle ones; reorders the values.
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

struct MeanStd {
    mean: f64,
    std: f64,
}

/// Menger curvature 4 A / (a b c) of the triples (i - s, i, i + s), A the triangle's area and
/// a, b, c its sides, over the triples with all sides in (0, g]; 0 where there is none.
fn menger_curvatures(
    points: &[[f64; 2]],
    is_ring: bool,
    stride: usize,
    gate_m: f64,
    scratch: &mut Vec<f64>,
) -> MeanStd {
    scratch.clear();
    let n = points.len();
    let within = |side: f64| 0.0 < side && side <= gate_m;
    let mut triple = |p: &[f64; 2], q: &[f64; 2], r: &[f64; 2]| {
        let (a, b, c) = (distance(p, q), distance(q, r), distance(r, p));
        if within(a) && within(b) && within(c) {
            let doubled_area =
                ((q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])).abs();
            scratch.push(2.0 * doubled_area / (a * b * c));
        }
    };
    if is_ring {
        // Around the ring, as often as it takes.
        let stride = stride % n;
        for (i, q) in points.iter().enumerate() {
            triple(&points[(i + n - stride) % n], q, &points[(i + stride) % n]);
        }
    } else {
        for window in points.windows(stride.saturating_mul(2).saturating_add(1)) {
            triple(&window[0], &window[stride], &window[2 * stride]);
        }
    }
    if scratch.is_empty() {
        return MeanStd { mean: 0.0, std: 0.0 };
    }
    let mean = scratch.iter().sum::<f64>() / scratch.len() as f64;
    MeanStd { mean, std: sample_std(scratch) }
}
