//! Finds the ring of each laser from the elevations of its hits.
//!
//! The files number the lasers from 0 to 31, and the documentation does not state the order. An
//! HDL-32E has a beam every 4/3 deg, fires the beams interleaved ([`ELEVATION_DEG`]), and may be
//! mounted upside down. The elevations of the hits of one revolution are compared with every
//! plausible order, and the order that fits is used.

use messages::hdl32e::{ELEVATION_DEG, LASERS};

use super::hit::Hit;

/// The ring of each laser. Ring 0 is the lowest in z-up axes.
pub(super) type Rings = [u16; LASERS];

/// The elevation of the lowest beam of an upright sensor, and the step between beams \[deg\]
/// (manual, "Laser angles").
const LOWEST_DEG: f64 = -92.0 / 3.0;
const STEP_DEG: f64 = 4.0 / 3.0;
/// The minimum range of a hit \[m\]. At 2 m the resolution of 5 mm is 0.14 deg, a tenth of a step.
const MIN_RANGE_M: f64 = 2.0;
/// The minimum number of hits: one per laser.
const MIN_HITS: usize = LASERS;
/// The maximum mean deviation of an order that fits \[deg\]: three quarters of a step, for a sensor
/// that is tilted. Every other order deviates by several steps.
const MAX_MEAN_DEG: f64 = 1.0;

/// The rings that fit the hits best, or `None` if no order fits or there are too few hits.
pub(super) fn identify(hits: &[Hit]) -> Option<Rings> {
    let measured: Vec<(usize, f64)> = hits.iter().filter_map(elevation_deg).collect();
    if measured.len() < MIN_HITS {
        return None;
    }
    let mean_deg = |expected: &[f64; LASERS]| {
        let sum: f64 = measured.iter().map(|&(laser, deg)| (deg - expected[laser]).abs()).sum();
        sum / measured.len() as f64
    };
    let best = orders()
        .map(|expected| (mean_deg(&expected), expected))
        .into_iter()
        .min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (best.0 <= MAX_MEAN_DEG).then(|| ranks(&best.1))
}

/// The elevation of each laser \[deg\] in every plausible order: in firing order, from the lowest up,
/// from the highest down, and each of these for a sensor mounted upside down.
fn orders() -> [[f64; LASERS]; 6] {
    let up = std::array::from_fn(|laser| LOWEST_DEG + laser as f64 * STEP_DEG);
    let mut down: [f64; LASERS] = up;
    down.reverse();
    let inverted = |order: [f64; LASERS]| order.map(|deg| -deg);
    [ELEVATION_DEG, up, down, inverted(ELEVATION_DEG), inverted(up), inverted(down)]
}

fn ranks(elevations: &[f64; LASERS]) -> Rings {
    elevations.map(|deg| elevations.iter().filter(|&&other| other < deg).count() as u16)
}

fn elevation_deg(hit: &Hit) -> Option<(usize, f64)> {
    let [x, y, z] = hit.position;
    let horizontal = libm::hypot(x, y);
    let is_far = MIN_RANGE_M <= libm::hypot(horizontal, z);
    is_far.then(|| (usize::from(hit.laser), libm::atan2(z, horizontal).to_degrees()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hits(elevations: [f64; LASERS]) -> Vec<Hit> {
        let hit = |laser: usize| {
            let elevation = elevations[laser].to_radians();
            let position = [10.0 * libm::cos(elevation), 0.0, 10.0 * libm::sin(elevation)];
            Hit { stamp_ns: 0, position, intensity: 0, laser: laser as u8 }
        };
        (0..LASERS).map(hit).collect()
    }

    #[test]
    fn every_order_is_identified() {
        for expected in orders() {
            // The sensor is tilted by half a degree.
            let rings = identify(&hits(expected.map(|deg| deg + 0.5))).unwrap();
            assert_eq!(rings, ranks(&expected));
        }
        // In firing order, laser 0 is the lowest, and laser 15 is the horizontal one, ring 23. Upside
        // down it is ring 8.
        assert_eq!(identify(&hits(ELEVATION_DEG)).unwrap()[15], 23);
        assert_eq!(identify(&hits(ELEVATION_DEG.map(|deg| -deg))).unwrap()[15], 8);
    }

    #[test]
    fn unknown_order_or_too_few_hits_give_no_rings() {
        let far_from_all = std::array::from_fn(|laser| if laser % 3 == 0 { 60.0 } else { -60.0 });
        assert_eq!(identify(&hits(far_from_all)), None);
        assert_eq!(identify(&hits(ELEVATION_DEG)[..31]), None);
    }
}
