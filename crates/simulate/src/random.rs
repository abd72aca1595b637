//! Random numbers from independent ChaCha8 streams.
//!
//! The key of a stream is the seed of the run, the purpose, the log, and an index. The numbers of a
//! stream therefore do not depend on the order of draws from other streams or on threads.
//! Transcendental functions come from `libm`, which gives the same numbers on every machine of an
//! architecture.

use std::f64::consts::TAU;

use chacha20::ChaCha8Rng;
use chacha20::rand_core::{Rng, SeedableRng};

/// The purpose of a stream.
#[derive(Debug, Clone, Copy)]
#[repr(u64)]
pub(crate) enum Purpose {
    /// The site. It is the same for all logs.
    Plan = 1,
    /// Doors, furniture and boxes on the day of a log.
    Day = 2,
    /// Lanes and speeds of people.
    People = 3,
    /// Start, sway and clock of a drive.
    Drive = 4,
    /// Range noise and dropouts. The index is the message.
    Noise = 5,
    /// The wheel encoders.
    Wheels = 6,
    /// The inertial measurement unit.
    Imu = 7,
}

/// A stream of random numbers.
pub(crate) struct Random {
    stream: ChaCha8Rng,
    /// The Box-Muller transform makes two normal numbers at a time. This is the second.
    spare_normal: Option<f64>,
}

impl Random {
    /// The stream of one purpose in one log. `index` selects one of several streams of that purpose.
    pub(crate) fn new(seed: u64, purpose: Purpose, log: usize, index: u64) -> Self {
        let mut key = [0; 32];
        let words = [seed, purpose as u64, log as u64, index];
        for (bytes, word) in key.chunks_exact_mut(8).zip(words) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        Self { stream: ChaCha8Rng::from_seed(key), spare_normal: None }
    }

    /// Uniform in [0, 1), 53 bits.
    fn unit(&mut self) -> f64 {
        (self.stream.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// True with the given probability (to 2^-32).
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        f64::from(self.stream.next_u32()) < probability * 4_294_967_296.0
    }

    /// Uniform in 0..n (n > 0).
    pub(crate) fn index(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n - 1)
    }

    /// Approximately normal with mean 0 and standard deviation 1, ten times faster than
    /// [`normal`](Self::normal). The absolute value is at most 3.46.
    ///
    /// This is the scaled sum of four uniform 16-bit numbers (Irwin 1927, Hall 1927). The variance of
    /// that sum is 4/12.
    #[inline]
    pub(crate) fn fast_normal(&mut self) -> f64 {
        let bits = self.stream.next_u64();
        let sum: u64 = (0..4).map(|k| bits >> (16 * k) & 0xFFFF).sum();
        (sum as f64 * (1.0 / 65536.0) - (2.0 - 2.0 / 65536.0)) * 1.732_050_807_568_877_2
    }

    /// Normal with mean 0 and standard deviation 1.
    ///
    /// Box and Muller (1958): sqrt(-2 ln u) cos(2 pi v) and sqrt(-2 ln u) sin(2 pi v) are normal
    /// and independent for u, v uniform in (0, 1].
    pub(crate) fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare_normal.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(1.0 - self.unit())).sqrt();
        let (sin, cos) = libm::sincos(TAU * self.unit());
        self.spare_normal = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_of_the_key_changes_the_stream() {
        let first = |seed, purpose, log, index| Random::new(seed, purpose, log, index).unit();
        let draws = [
            first(1, Purpose::Plan, 0, 0),
            first(2, Purpose::Plan, 0, 0),
            first(1, Purpose::Day, 0, 0),
            first(1, Purpose::Plan, 1, 0),
            first(1, Purpose::Plan, 0, 1),
        ];
        for (k, a) in draws.iter().enumerate() {
            assert!(draws[..k].iter().all(|b| a.to_bits() != b.to_bits()));
        }
        assert_eq!(first(1, Purpose::Plan, 0, 0).to_bits(), draws[0].to_bits());
    }

    /// With 100 000 draws the standard deviations of the mean, of the variance, and of the share
    /// within one standard deviation (0.6827) are 0.0032, 0.0045 and 0.0015. The limits are four
    /// standard deviations.
    #[test]
    fn normal_draws_are_normal() {
        let draw_all = |draw: fn(&mut Random) -> f64| -> Vec<f64> {
            let mut random = Random::new(7, Purpose::Noise, 0, 0);
            (0..100_000).map(|_| draw(&mut random)).collect()
        };
        check_normal(&draw_all(Random::normal), 0.6827);
        // For the sum of four the share is 0.6692, from its distribution function.
        check_normal(&draw_all(Random::fast_normal), 0.6692);
    }

    fn check_normal(draws: &[f64], share_within: f64) {
        let n = draws.len() as f64;
        let mean = draws.iter().sum::<f64>() / n;
        let variance = draws.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / (n - 1.0);
        let within = draws.iter().filter(|d| d.abs() < 1.0).count() as f64 / n;
        assert!(mean.abs() < 0.0128, "{mean}");
        assert!((variance - 1.0).abs() < 0.018, "{variance}");
        assert!((within - share_within).abs() < 0.006, "{within}");
    }
}
