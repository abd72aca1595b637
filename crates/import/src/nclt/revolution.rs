//! Splits a stream of hits into revolutions of the sensor.

use std::f64::consts::{PI, TAU};

use super::hit::Hit;

/// A longer pause ends a revolution \[ns\]. The slowest revolution, at 5 Hz, takes 0.2 s.
const MAX_PAUSE_NS: u64 = 200_000_000;
/// The maximum number of hits in a revolution: twice the number that an HDL-32E can return at 5 Hz
/// (1.39 million points per second).
const MAX_HITS: usize = 560_000;
/// Hits with a smaller horizontal distance have no meaningful azimuth \[m\].
const MIN_HORIZONTAL_M: f64 = 0.05;

/// The hits since azimuth 0 (straight ahead) was passed.
#[derive(Debug, Default)]
pub(super) struct Revolution {
    hits: Vec<Hit>,
    /// The azimuth of the last hit, from 0 to 2π \[rad\].
    azimuth: Option<f64>,
    /// The number of times that azimuth 0 was passed: counter-clockwise minus clockwise. The lasers
    /// of a block differ by a fraction of a degree, and the azimuth therefore passes 0 several times
    /// in both directions. A new revolution starts when this number leaves the range that it has had
    /// so far, `least` to `most`.
    passes: i64,
    least: i64,
    most: i64,
}

impl Revolution {
    /// Adds a hit. Returns the previous revolution if the hit starts a new one.
    pub fn push(&mut self, hit: Hit) -> Option<Vec<Hit>> {
        let paused = self
            .hits
            .last()
            .is_some_and(|last| MAX_PAUSE_NS < hit.stamp_ns.abs_diff(last.stamp_ns));
        let ends = self.passes_0(hit.position) || paused || MAX_HITS <= self.hits.len();
        let ended = (ends && !self.hits.is_empty()).then(|| self.finish());
        self.hits.push(hit);
        ended
    }

    /// Returns the hits since the last revolution.
    pub fn finish(&mut self) -> Vec<Hit> {
        std::mem::take(&mut self.hits)
    }

    fn passes_0(&mut self, [x, y, _]: [f64; 3]) -> bool {
        if libm::hypot(x, y) < MIN_HORIZONTAL_M {
            return false;
        }
        let azimuth = libm::atan2(y, x).rem_euclid(TAU);
        let previous = self.azimuth.replace(azimuth).unwrap_or(azimuth);
        if PI < previous - azimuth {
            self.passes += 1;
        } else if PI < azimuth - previous {
            self.passes -= 1;
        }
        let is_new = self.passes < self.least || self.most < self.passes;
        self.least = self.least.min(self.passes);
        self.most = self.most.max(self.passes);
        is_new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(azimuth_deg: f64) -> Hit {
        let azimuth = azimuth_deg.to_radians();
        let position = [10.0 * libm::cos(azimuth), 10.0 * libm::sin(azimuth), 0.0];
        Hit { stamp_ns: 0, position, intensity: 0, laser: 0 }
    }

    /// The numbers of hits of the revolutions.
    fn lengths(azimuths: &[f64]) -> Vec<usize> {
        let mut revolution = Revolution::default();
        let ended = azimuths.iter().filter_map(|&deg| revolution.push(at(deg)));
        let mut lengths: Vec<usize> = ended.map(|hits| hits.len()).collect();
        lengths.push(revolution.finish().len());
        lengths
    }

    #[test]
    fn a_revolution_ends_at_azimuth_0_in_either_direction() {
        assert_eq!(lengths(&[200.0, 300.0, 10.0, 130.0, 250.0, 5.0]), [2, 3, 1]);
        assert_eq!(lengths(&[100.0, 20.0, 350.0, 230.0, 110.0, 355.0]), [2, 3, 1]);
    }

    #[test]
    fn jitter_around_azimuth_0_ends_one_revolution() {
        assert_eq!(lengths(&[250.0, 359.9, 0.1, 359.9, 0.1, 120.0, 240.0, 359.8, 0.2]), [2, 6, 1]);
    }
}
