//! Samples -> signals that can be integrated over any stretch of time.

use dataset::Dropped;

use crate::{Gaps, ImuSample, WheelSample};

/// A sample with a stamp and some values that are integrated.
pub(crate) trait Sampled<const N: usize> {
    fn stamp_ns(&self) -> i64;
    fn values(&self) -> [f64; N];
}

impl Sampled<2> for WheelSample {
    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
    fn values(&self) -> [f64; 2] {
        [self.left_m_per_s, self.right_m_per_s]
    }
}

impl Sampled<1> for ImuSample {
    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
    fn values(&self) -> [f64; 1] {
        [self.yaw_rate_rad_s]
    }
}

/// The samples whose stamps advance and whose values are finite; the others are counted.
pub(crate) fn in_order<S: Sampled<N> + Copy, const N: usize>(
    samples: &[S],
    name: &str,
    dropped: &mut Dropped,
) -> Vec<S> {
    let mut kept: Vec<S> = Vec::with_capacity(samples.len());
    let (mut n_repeated, mut n_back, mut n_not_finite) = (0, 0, 0);
    for sample in samples {
        match kept.last().map(Sampled::stamp_ns) {
            _ if !sample.values().iter().all(|value| value.is_finite()) => n_not_finite += 1,
            Some(last) if sample.stamp_ns() == last => n_repeated += 1,
            Some(last) if sample.stamp_ns() < last => n_back += 1,
            _ => kept.push(*sample),
        }
    }
    dropped.add(format!("{name} samples whose stamp repeats"), n_repeated);
    dropped.add(format!("{name} samples whose stamp steps back"), n_back);
    dropped.add(format!("{name} samples with a value that is not finite"), n_not_finite);
    kept
}

/// Seconds from one stamp to a later one.
pub(crate) fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

/// Integrals over a stretch of time.
pub(crate) struct Stretch<const N: usize> {
    pub(crate) integrals: [f64; N],
    /// The largest absolute value at the stretch's ends and between them.
    pub(crate) largest: f64,
    /// Integral of [`missed`] over the stretch \[s^3\].
    pub(crate) missed: f64,
}

/// Reads a signal from front to back; linear between two samples.
pub(crate) struct Signal<'a, S, const N: usize> {
    samples: &'a [S],
    /// The stretch last read ended between this sample and the next, or at this one.
    at: usize,
    response_secs: f64,
}

impl<'a, S: Sampled<N>, const N: usize> Signal<'a, S, N> {
    pub(crate) fn new(samples: &'a [S], response_secs: f64) -> Self {
        Self { samples, at: 0, response_secs }
    }

    /// Integrals from one stamp to a later one, where there are samples on both sides; the
    /// stretches asked for must be in order of time.
    pub(crate) fn integrate(&mut self, from_ns: i64, to_ns: i64) -> Option<Stretch<N>> {
        let (first, last) = (self.samples.first()?, self.samples.last()?);
        if from_ns < first.stamp_ns() || last.stamp_ns() < to_ns {
            return None;
        }
        while self.samples.get(self.at + 1).is_some_and(|next| next.stamp_ns() <= from_ns) {
            self.at += 1;
        }
        let mut stretch = Stretch { integrals: [0.0; N], largest: 0.0, missed: 0.0 };
        let mut from_ns = from_ns;
        while from_ns < to_ns {
            let (before, after) = (&self.samples[self.at], &self.samples[self.at + 1]);
            let until_ns = to_ns.min(after.stamp_ns());
            let gap = seconds(before.stamp_ns(), after.stamp_ns());
            let dt = seconds(from_ns, until_ns);
            let share = |stamp_ns| seconds(before.stamp_ns(), stamp_ns) / gap;
            let (a, b) = (share(from_ns), share(until_ns));
            for (k, (before, after)) in before.values().into_iter().zip(after.values()).enumerate()
            {
                let value = |share: f64| before + share * (after - before);
                stretch.integrals[k] += 0.5 * (value(a) + value(b)) * dt;
                stretch.largest = stretch.largest.max(value(a).abs()).max(value(b).abs());
            }
            stretch.missed += missed(gap, self.response_secs) * dt;
            if until_ns == after.stamp_ns() && self.at + 2 < self.samples.len() {
                self.at += 1;
            }
            from_ns = until_ns;
        }
        Some(stretch)
    }
}

/// Variance per second of a rate's integral by the trapezoidal rule, for samples `gap` apart and
/// an acceleration of density 1 \[s^2\].
///
/// Between two samples the rate is a Brownian bridge where the acceleration is white, and the
/// integral of the bridge has the variance gap^3 / 12. Where the acceleration is itself the
/// integral of noise of density 1 / response, the rule's error -1/2 int t (gap - t) da has the
/// variance gap^5 / (120 response^2). A first-order Gauss-Markov acceleration of that density
/// looks like the first over long gaps and like the second over short ones; this joins the two.
fn missed(gap: f64, response: f64) -> f64 {
    let square = gap * gap;
    square / 12.0 * (square / (square + 10.0 * response * response))
}

/// Stretches from start to end without a sample of a source.
pub(crate) fn gaps<S: Sampled<N>, const N: usize>(
    samples: &[S],
    start_ns: i64,
    end_ns: i64,
    max_gap_secs: f64,
) -> Gaps {
    let mut gaps = Gaps::default();
    let mut last_ns = start_ns;
    let stamps = samples.iter().map(Sampled::stamp_ns).chain([end_ns]);
    for stamp_ns in stamps.map(|stamp_ns| stamp_ns.clamp(start_ns, end_ns)) {
        let gap_secs = seconds(last_ns, stamp_ns);
        if max_gap_secs < gap_secs {
            gaps.n += 1;
            gaps.secs += gap_secs;
        }
        last_ns = stamp_ns;
    }
    gaps
}
