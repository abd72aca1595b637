//! The ring of each laser, told by where its hits lie.
//!
//! The files number the lasers from 0 to 31, and their documentation does not say in which order.
//! An HDL-32E has its beams every 4/3 deg, fires them interleaved ([`ELEVATION_DEG`]), and may hang
//! upside down; so the elevations of a turn's hits are held against every order that a driver could
//! have meant, and the one that fits is taken.

use messages::hdl32e::{ELEVATION_DEG, LASERS};

use super::hits::Hit;

/// Ring of each laser, 0 the lowest in z-up axes.
pub(super) type Rings = [u16; LASERS];

/// Elevation of the lowest beam of an upright sensor, and from one to the next \[deg\] (manual,
/// "Laser angles").
const LOWEST_DEG: f64 = -92.0 / 3.0;
const STEP_DEG: f64 = 4.0 / 3.0;
/// Nearer hits say little: at 2 m the file's 5 mm are 0.14 deg, a tenth of a step \[m\].
const MIN_RANGE_M: f64 = 2.0;
/// Hits needed to tell: one a laser.
const MIN_HITS: usize = LASERS;
/// What an order that fits may be off on average \[deg\]: three quarters of a step, which allows for
/// a sensor that leans. Another order is off by some steps.
const MAX_MEAN_DEG: f64 = 1.0;

/// The rings that fit the hits best; none where no order fits or there are too few hits.
pub(super) fn tell(hits: &[Hit]) -> Option<Rings> {
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

/// Elevation of each laser \[deg\], in firing order, from the lowest up, from the highest down; and
/// each of a sensor that hangs upside down.
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
    let level = libm::hypot(x, y);
    let far = MIN_RANGE_M <= libm::hypot(level, z);
    far.then(|| (usize::from(hit.laser), libm::atan2(z, level).to_degrees()))
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
    fn every_order_is_told() {
        for expected in orders() {
            // Leaning by half a degree.
            let rings = tell(&hits(expected.map(|deg| deg + 0.5))).unwrap();
            assert_eq!(rings, ranks(&expected));
        }
        // Firing order: laser 0 is the lowest, laser 15 the horizontal one, ring 23; hanging upside
        // down that is ring 8.
        assert_eq!(tell(&hits(ELEVATION_DEG)).unwrap()[15], 23);
        assert_eq!(tell(&hits(ELEVATION_DEG.map(|deg| -deg))).unwrap()[15], 8);
    }

    #[test]
    fn hits_of_no_order_tell_nothing() {
        let far_from_all = std::array::from_fn(|laser| if laser % 3 == 0 { 60.0 } else { -60.0 });
        assert_eq!(tell(&hits(far_from_all)), None);
        assert_eq!(tell(&hits(ELEVATION_DEG)[..31]), None);
    }
}
