use serde::{Deserialize, Serialize};

/// A scan that covers at least this angle is a closed ring \[deg\]: its last return is a neighbour
/// of its first return. See `docs/features.md`.
pub const FULL_RING_DEG: f32 = 355.0;

/// The smallest and largest range of a valid return. Both limits are included.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RangeLimits {
    /// Smallest range that is kept \[m\].
    pub min_m: f64,
    /// Largest range that is kept \[m\].
    pub max_m: f64,
}

impl RangeLimits {
    /// Whether a range is within the limits. Returns false for NaN.
    pub fn contains(&self, range_m: f64) -> bool {
        self.min_m <= range_m && range_m <= self.max_m
    }
}

/// One planar scan: the returns of one revolution of one laser, or of one sweep of a planar
/// scanner.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scan {
    /// Time at which the first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// x (forward) of the returns in the lidar frame, in firing order \[m\], `(n_returns,)`.
    pub x_m: Vec<f32>,
    /// y (left) of the returns in the lidar frame, in firing order \[m\], `(n_returns,)`.
    pub y_m: Vec<f32>,
    /// Angle covered by the firings, with or without a return \[deg\].
    pub coverage_deg: f32,
    /// The largest angle without packets \[deg\]; 0 if no packets are missing.
    pub hole_deg: f32,
}

/// The reason why no features can be computed from a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum Unusable {
    /// A coordinate is NaN or infinite.
    #[error("a coordinate that is not finite")]
    NotFinite,
    /// There are fewer than three returns. The fit of a circle needs three points.
    #[error("fewer than 3 returns")]
    TooFewReturns,
    /// All returns are on one line. No circle can be fitted to a line.
    #[error("all returns on one line")]
    OneLine,
}

/// Points are on one line if the ratio of the smaller to the larger eigenvalue of their scatter
/// matrix is at most this value.
///
/// Points on an exact line have a ratio of about 4e-15 after their coordinates are rounded to f32
/// (relative error 6e-8). A real wall of 10 m, measured with 1 mm of noise, has a ratio of 1e-8.
const ONE_LINE_EIGENVALUE_RATIO: f64 = 1e-12;

impl Scan {
    /// Number of returns.
    pub fn len(&self) -> usize {
        self.x_m.len()
    }

    /// Whether the scan has no returns.
    pub fn is_empty(&self) -> bool {
        self.x_m.is_empty()
    }

    /// Whether the scan is a closed ring.
    pub fn is_ring(&self) -> bool {
        FULL_RING_DEG <= self.coverage_deg
    }

    /// The returns as points \[m\].
    pub fn points(&self) -> impl ExactSizeIterator<Item = [f64; 2]> + '_ {
        self.x_m.iter().zip(&self.y_m).map(|(&x, &y)| [f64::from(x), f64::from(y)])
    }

    /// Checks that features can be computed from this scan: it needs at least three finite returns
    /// that are not all on one line.
    pub fn check_usable(&self) -> Result<(), Unusable> {
        if self.len() < 3 {
            return Err(Unusable::TooFewReturns);
        }
        let n = self.len() as f64;
        let (sum_x, sum_y) = self.points().fold((0.0, 0.0), |(x, y), p| (x + p[0], y + p[1]));
        let (mean_x, mean_y) = (sum_x / n, sum_y / n);
        let (mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0);
        for [x, y] in self.points() {
            let (dx, dy) = (x - mean_x, y - mean_y);
            sxx += dx * dx;
            sxy += dx * dy;
            syy += dy * dy;
        }
        // The eigenvalues a >= b of the scatter matrix satisfy a b = det and a + b = trace.
        // Therefore b / a is about det / trace^2 if it is small.
        let (det, trace) = (sxx * syy - sxy * sxy, sxx + syy);
        if !det.is_finite() {
            return Err(Unusable::NotFinite);
        }
        if det <= ONE_LINE_EIGENVALUE_RATIO * trace * trace {
            return Err(Unusable::OneLine);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(points: &[(f32, f32)]) -> Scan {
        let (x_m, y_m) = points.iter().copied().unzip();
        Scan { x_m, y_m, ..Scan::default() }
    }

    #[test]
    fn a_line_is_unusable_at_any_slope_and_distance() {
        assert_eq!(scan(&[(0.0, 1.0), (1.0, 2.0)]).check_usable(), Err(Unusable::TooFewReturns));
        assert_eq!(scan(&[(3.0, 1.0); 4]).check_usable(), Err(Unusable::OneLine));
        for slope in [0.0f32, 0.3, 1.0, 17.0] {
            let wall: Vec<_> =
                (0..500).map(|k| (k as f32 * 0.01, 30.0 + slope * k as f32 * 0.01)).collect();
            assert_eq!(scan(&wall).check_usable(), Err(Unusable::OneLine), "slope {slope}");
            let mut corner = wall.clone();
            corner.push((2.0, 29.0));
            assert_eq!(scan(&corner).check_usable(), Ok(()), "slope {slope}");
        }
    }

    #[test]
    fn a_scan_with_a_coordinate_that_is_not_finite_is_unusable() {
        for bad in [f32::NAN, f32::INFINITY] {
            let scan = scan(&[(1.0, 0.0), (0.0, bad), (-1.0, 0.5), (0.0, -1.0)]);
            assert_eq!(scan.check_usable(), Err(Unusable::NotFinite));
        }
    }

    #[test]
    fn a_wall_with_millimetre_noise_is_usable() {
        let wall: Vec<_> =
            (0..500).map(|k| (k as f32 * 0.02, 5.0 + 0.001 * (k % 2) as f32)).collect();
        assert_eq!(scan(&wall).check_usable(), Ok(()));
    }

    #[test]
    fn range_limits_include_both_limits_and_exclude_nan() {
        let limits = RangeLimits { min_m: 0.9, max_m: 70.0 };
        assert!(limits.contains(0.9) && limits.contains(70.0));
        assert!(!limits.contains(0.899) && !limits.contains(70.01));
        assert!(!limits.contains(f64::NAN) && !limits.contains(f64::INFINITY));
    }
}
