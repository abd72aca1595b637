//! Samples -> signals that can be integrated over any time span.

use dataset::{LossKind, Losses};
use serde::{Deserialize, Serialize};

use crate::samples::{ImuSample, WheelSample};

/// Time spans without samples that are longer than `max_gap_secs`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Gaps {
    /// Number of gaps.
    pub n: usize,
    /// Their total duration \[s\].
    pub secs: f64,
}

/// A sample with a stamp and values that can be integrated.
pub(crate) trait Sampled<const N: usize> {
    /// The name of the sensor in losses.
    const SENSOR: &'static str;
    fn stamp_ns(&self) -> i64;
    fn values(&self) -> [f64; N];
}

impl Sampled<2> for WheelSample {
    const SENSOR: &'static str = "wheel";

    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
    fn values(&self) -> [f64; 2] {
        [self.left_m_s, self.right_m_s]
    }
}

impl Sampled<1> for ImuSample {
    const SENSOR: &'static str = "imu";

    fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }
    fn values(&self) -> [f64; 1] {
        [self.yaw_rate_rad_s]
    }
}

/// Returns the samples with increasing stamps and finite values, and counts the others.
pub(crate) fn in_order<S: Sampled<N> + Copy, const N: usize>(
    samples: &[S],
    losses: &mut Losses,
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
    let sensor = || S::SENSOR.to_owned();
    losses.add(LossKind::DuplicateSampleStamps { sensor: sensor() }, n_repeated);
    losses.add(LossKind::SampleStampsStepBack { sensor: sensor() }, n_back);
    losses.add(LossKind::NonFiniteSamples { sensor: sensor() }, n_not_finite);
    kept
}

/// Seconds from one stamp to a later one.
pub(crate) fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

/// Integrals over a time span.
pub(crate) struct Integral<const N: usize> {
    pub(crate) values: [f64; N],
    /// The largest absolute value in the span.
    pub(crate) largest: f64,
    /// Integral of [`missed_variance_s2`] over the span \[s^3\].
    pub(crate) missed_s3: f64,
}

/// A signal that is linear between two samples. It is read from front to back.
pub(crate) struct Signal<'a, S, const N: usize> {
    samples: &'a [S],
    /// The last span ended at this sample, or between this sample and the next.
    at: usize,
    response_secs: f64,
}

impl<'a, S: Sampled<N>, const N: usize> Signal<'a, S, N> {
    pub(crate) fn new(samples: &'a [S], response_secs: f64) -> Self {
        Self { samples, at: 0, response_secs }
    }

    /// Integrates from one stamp to a later one. The result is `None` if there are no samples
    /// before or after the span. Consecutive calls must ask for spans in order of time.
    pub(crate) fn integrate(&mut self, from_ns: i64, to_ns: i64) -> Option<Integral<N>> {
        let (first, last) = (self.samples.first()?, self.samples.last()?);
        if from_ns < first.stamp_ns() || last.stamp_ns() < to_ns {
            return None;
        }
        while self.samples.get(self.at + 1).is_some_and(|next| next.stamp_ns() <= from_ns) {
            self.at += 1;
        }
        let mut integral = Integral { values: [0.0; N], largest: 0.0, missed_s3: 0.0 };
        let mut from_ns = from_ns;
        while from_ns < to_ns {
            let (before, after) = (&self.samples[self.at], &self.samples[self.at + 1]);
            let until_ns = to_ns.min(after.stamp_ns());
            let gap = seconds(before.stamp_ns(), after.stamp_ns());
            let dt_secs = seconds(from_ns, until_ns);
            let share = |stamp_ns| seconds(before.stamp_ns(), stamp_ns) / gap;
            let (a, b) = (share(from_ns), share(until_ns));
            for (k, (before, after)) in before.values().into_iter().zip(after.values()).enumerate()
            {
                let value = |share: f64| before + share * (after - before);
                integral.values[k] += 0.5 * (value(a) + value(b)) * dt_secs;
                integral.largest = integral.largest.max(value(a).abs()).max(value(b).abs());
            }
            integral.missed_s3 += missed_variance_s2(gap, self.response_secs) * dt_secs;
            if until_ns == after.stamp_ns() && self.at + 2 < self.samples.len() {
                self.at += 1;
            }
            from_ns = until_ns;
        }
        Some(integral)
    }
}

/// Variance per second of the integral of a rate by the trapezoidal rule, for samples that are
/// `gap` \[s\] apart and an acceleration of density 1 \[s^2\].
///
/// If the acceleration is white noise, the rate between two samples is a Brownian bridge, and the
/// integral of the bridge has the variance gap^3 / 12. If the acceleration is the integral of noise
/// of density 1 / response, the error of the rule, -1/2 int t (gap - t) da, has the variance
/// gap^5 / (120 response^2). A first-order Gauss-Markov acceleration of that density behaves like
/// the first case over long gaps and like the second case over short gaps. This formula blends the
/// two.
fn missed_variance_s2(gap: f64, response: f64) -> f64 {
    let square = gap * gap;
    square / 12.0 * (square / (square + 10.0 * response * response))
}

/// The gaps between the samples of a source, from start to end.
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
