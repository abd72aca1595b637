//! The range signature: the mean ln r in each degree of azimuth, and the features that need nothing
//! else.

use dataset::Scan;

use super::describe::{Out, add_soft, ln_all, percentiles};

/// 90 deg in bins.
const QUARTER: usize = 90;
const CHORD_PERCENTS: [f64; 11] = [0., 5., 10., 25., 40., 50., 60., 75., 90., 95., 100.];
const QUARTER_PERCENTS: [f64; 7] = [0., 10., 25., 50., 75., 90., 100.];
const SPREAD_LIMITS_M: [f64; 4] = [2.0, 4.0, 8.0, 16.0];
const STEPS: [f64; 6] = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0];
/// Number of bins in a sector.
const SECTOR: usize = 5;
/// Position of the first beam of an open scan within its bin, as a share of the bin width.
const BORDER: f64 = 0.3;

#[derive(Debug, Clone, Default)]
pub(super) struct Signature {
    /// Whether the last bin is a neighbour of the first.
    pub(super) is_ring: bool,
    /// Mean ln r \[ln m\] by bin, `(n_bins,)`.
    pub(super) ln_r: Vec<f64>,
    /// exp of `ln_r` \[m\].
    pub(super) r: Vec<f64>,
    /// The point in the middle of each bin, at the range of the bin \[m\].
    pub(super) points: Vec<[f64; 2]>,
    /// ln of r(a) + r(a + 180 deg) \[ln m\], `(n_bins / 2,)`; empty for an open scan.
    pub(super) chords: Vec<f64>,
    /// Share of the sectors with a return.
    seen: f64,
    counts: Vec<u32>,
    returns: Vec<Polar>,
}

#[derive(Debug, Clone, Copy)]
struct Polar {
    azimuth_deg: f64,
    ln_r: f64,
}

/// The azimuth bins.
struct Bins {
    n: usize,
    /// Lower border of the first bin \[deg\].
    first_deg: f64,
    width_deg: f64,
}

impl Signature {
    /// Computes the signature of a scan. A ring has 360 bins of 1 deg from azimuth 0. An open scan
    /// has one bin more than the number of degrees it covers, centred on its returns. An empty bin
    /// is interpolated between its neighbours, linearly in ln r.
    pub(super) fn measure(&mut self, scan: &Scan) {
        self.is_ring = scan.is_ring();
        self.returns.clear();
        let polar = |x: f64, y: f64| Polar {
            azimuth_deg: libm::atan2(y, x).to_degrees(),
            // A return at the sensor itself has no azimuth. The least range of 1 mm keeps ln r finite.
            ln_r: 0.5 * libm::log((x * x + y * y).max(1e-6)),
        };
        let bins = if self.is_ring {
            self.returns.extend(scan.points().map(|[x, y]| {
                let polar = polar(x, y);
                let azimuth_deg = polar.azimuth_deg.rem_euclid(360.0);
                Polar { azimuth_deg, ..polar }
            }));
            Bins { n: 360, first_deg: 0.0, width_deg: 1.0 }
        } else {
            // Azimuths are relative to the mean direction, so the scan does not cross 180 deg.
            let (mut mx, mut my) = (0.0, 0.0);
            for [x, y] in scan.points() {
                let r = (x * x + y * y).max(1e-6).sqrt();
                mx += x / r;
                my += y / r;
            }
            let azimuth_deg =
                |[x, y]: [f64; 2]| polar(mx * x + my * y, mx * y - my * x).azimuth_deg;
            self.returns.extend(
                scan.points()
                    .map(|p| Polar { azimuth_deg: azimuth_deg(p), ln_r: polar(p[0], p[1]).ln_r }),
            );
            open_bins(&self.returns, f64::from(scan.coverage_deg))
        };
        self.fill(&bins);
        self.r.clear();
        self.r.extend(self.ln_r.iter().map(|&m| libm::exp(m)));
        self.points.clear();
        self.points.extend(self.r.iter().enumerate().map(|(k, &r)| {
            let azimuth = (bins.first_deg + (k as f64 + 0.5) * bins.width_deg).to_radians();
            [r * libm::cos(azimuth), r * libm::sin(azimuth)]
        }));
        self.chords.clear();
        if self.is_ring {
            let (first, second) = self.r.split_at(self.r.len() / 2);
            self.chords.extend(first.iter().zip(second).map(|(a, b)| libm::log(a + b)));
        }
    }

    fn fill(&mut self, bins: &Bins) {
        let Self { ln_r, counts, .. } = self;
        ln_r.clear();
        ln_r.resize(bins.n, 0.0);
        counts.clear();
        counts.resize(bins.n, 0);
        for p in &self.returns {
            let place = (p.azimuth_deg - bins.first_deg) / bins.width_deg;
            let bin = (place.max(0.0) as usize).min(bins.n - 1);
            ln_r[bin] += p.ln_r;
            counts[bin] += 1;
        }
        for (sum, &n) in ln_r.iter_mut().zip(&*counts) {
            *sum /= f64::from(n.max(1));
        }
        let sectors = counts.chunks(SECTOR);
        let n_sectors = sectors.len() as f64;
        self.seen =
            sectors.filter(|sector| sector.iter().any(|&n| 0 < n)).count() as f64 / n_sectors;

        let is_full = |k: &usize| 0 < counts[*k];
        let (Some(first), Some(last)) = ((0..bins.n).find(is_full), (0..bins.n).rfind(is_full))
        else {
            return; // unreachable: a scan without returns is not usable
        };
        let mut before = first;
        for k in first + 1..=last {
            if is_full(&k) {
                interpolate_bins(ln_r, before, k, bins.n);
                before = k;
            }
        }
        if self.is_ring {
            interpolate_bins(ln_r, last, first + bins.n, bins.n);
        } else {
            let ends = (ln_r[first], ln_r[last]);
            ln_r[..first].fill(ends.0);
            ln_r[last + 1..].fill(ends.1);
        }
    }

    /// Writes the features `range_*`, `chord_*`, `oddness_*`, `quarter_*`, `spread_*`, `seen` and
    /// `step_*`.
    pub(super) fn describe(&self, out: &mut Out<'_>, scratch: &mut Vec<f64>) {
        let n = self.ln_r.len();
        let one = 1.0 / n as f64;
        let mut by_range = [0.0; 13];
        let centres: [f64; 13] =
            std::array::from_fn(|k| (k as f64 - 1.0) * 0.5 * std::f64::consts::LN_2);
        for &m in &self.ln_r {
            add_soft(&mut by_range, &centres, m, one);
        }
        out.push(&by_range);

        if self.is_ring {
            sort(scratch, self.chords.iter().copied());
            out.push(&percentiles(scratch, &CHORD_PERCENTS));
            let (first, second) = self.ln_r.split_at(n / 2);
            scratch.clear();
            scratch.extend(first.iter().zip(second).map(|(a, b)| (a - b).abs()));
            let (mean, deviation) = mean_deviation(scratch);
            out.push(&[mean, libm::log(deviation + 1e-3)]);
            let quarters = (0..n).map(|k| self.r[k] + self.r[(k + QUARTER) % n]);
            sort(scratch, quarters.map(libm::log));
        } else {
            out.push(&[0.0; CHORD_PERCENTS.len() + 2]);
            let quarters = self.r.iter().zip(self.r.iter().skip(QUARTER)).map(|(a, b)| a + b);
            sort(scratch, quarters.map(libm::log));
            if scratch.is_empty() {
                scratch.push(0.0);
            }
        }
        out.push(&percentiles(scratch, &QUARTER_PERCENTS));

        out.push(&SPREAD_LIMITS_M.map(|limit_m| {
            scratch.clear();
            scratch.extend(self.r.iter().map(|r| r.min(limit_m)));
            libm::log(mean_deviation(scratch).1 + 0.01)
        }));
        out.push(&[self.seen]);

        let mut by_step = [0.0; STEPS.len()];
        let centres = ln_all(STEPS);
        let n_steps = if self.is_ring { n } else { n - 1 };
        for k in 0..n_steps {
            let step = (self.ln_r[(k + 1) % n] - self.ln_r[k]).abs();
            add_soft(&mut by_step, &centres, libm::log(step + 1e-4), 1.0 / n_steps as f64);
        }
        out.push(&by_step);
    }
}

/// Bins of about 1 deg. There is one bin more than the number of degrees that the scan covers, or
/// that its returns span if that is more. Planar scanners fire at each half or whole degree. The bin
/// borders avoid these angles; otherwise rounding would decide which bin a return falls into.
fn open_bins(returns: &[Polar], coverage_deg: f64) -> Bins {
    let azimuths = returns.iter().map(|p| p.azimuth_deg);
    let (low, high) =
        azimuths.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let span_deg = coverage_deg.max(high - low).clamp(8.0, 360.0);
    let n_swept = (span_deg + 0.5).floor();
    let width_deg = span_deg / n_swept;
    let first_deg = (low + high) / 2.0 - span_deg / 2.0 - BORDER * width_deg;
    Bins { n: n_swept as usize + 1, first_deg, width_deg }
}

/// Interpolates the bins between two filled ones. Bin numbers wrap at `n`, for a ring.
fn interpolate_bins(ln_r: &mut [f64], before: usize, after: usize, n: usize) {
    let (from, to) = (ln_r[before % n], ln_r[after % n]);
    for k in before + 1..after {
        let share = (k - before) as f64 / (after - before) as f64;
        ln_r[k % n] = from + (to - from) * share;
    }
}

fn sort(scratch: &mut Vec<f64>, values: impl Iterator<Item = f64>) {
    scratch.clear();
    scratch.extend(values);
    scratch.sort_unstable_by(f64::total_cmp);
}

/// Mean and standard deviation. The deviation divides by the count.
fn mean_deviation(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    (mean, (squares / n).sqrt())
}
