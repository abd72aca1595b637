//! Converts the firings of one revolution into a scan.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use dataset::{RangeLimits, Scan};
use messages::hdl32e::{AZIMUTH_COUNTS, BLOCK_PERIOD_NS, METRES_PER_COUNT, PERIODS_PER_BLOCK};

use crate::deskew::motion::ScanMotion;
use crate::options::LidarOptions;
use crate::velodyne::model::Laser;

/// Fine azimuth counts per count of 0.01 deg. Laser `k` fires `k / 40` of a block period after the
/// azimuth of its block was read, so the azimuth of every laser is a whole number of fine counts.
pub(crate) const FINE_PER_COUNT: u32 = PERIODS_PER_BLOCK as u32;
/// Fine azimuth counts per revolution.
pub(crate) const FINE_PER_REVOLUTION: u32 = AZIMUTH_COUNTS as u32 * FINE_PER_COUNT;

/// One firing of the laser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Firing {
    /// Azimuth, less than a full revolution \[1/40 of 0.01 deg, clockwise\].
    pub(crate) fine_azimuth: u32,
    /// Distance \[2 mm\], 0 for no return.
    pub(crate) distance: u16,
    /// Time of the firing, in block periods since the first firing of the revolution. Missing packets
    /// count too.
    pub(crate) slot: u16,
}

/// The firings between two passes of azimuth 0.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Revolution {
    /// Time of the first firing of the laser \[ns\].
    pub(crate) stamp_ns: i64,
    pub(crate) firings: Vec<Firing>,
    /// The farthest azimuth reached \[fine counts\].
    pub(crate) reached: u32,
    /// Sum of the azimuth steps after each firing \[0.01 deg\].
    pub(crate) swept: u64,
    /// Azimuth without packets \[0.01 deg\].
    pub(crate) missed: u64,
    /// The widest azimuth range without packets \[0.01 deg\].
    pub(crate) widest_gap: u64,
    /// Azimuth step after the last firing \[0.01 deg\].
    pub(crate) last_step: u32,
    /// The slot of the next firing.
    pub(crate) next_slot: u16,
    /// Whether the revolution is known to start at azimuth 0: the firing before its first one lies
    /// in another revolution.
    pub(crate) starts_at_zero: bool,
}

impl Revolution {
    /// Records an azimuth range without packets \[0.01 deg\].
    pub(crate) fn add_gap(&mut self, azimuth: u64) {
        self.missed += azimuth;
        self.widest_gap = self.widest_gap.max(azimuth);
    }

    /// Advances the time by the firings of missing packets.
    pub(crate) fn skip_slots(&mut self, n_firings: u64) {
        let n = u16::try_from(n_firings).unwrap_or(u16::MAX);
        self.next_slot = self.next_slot.saturating_add(n);
    }

    /// Time of the last firing \[ns\].
    pub(crate) fn end_ns(&self) -> i64 {
        let last = self.firings.last().map_or(0, |firing| firing.slot);
        self.stamp_ns.saturating_add(i64::from(last) * BLOCK_PERIOD_NS)
    }

    /// Share of the circle without packets. One or two missing firings at azimuth 0 do not count.
    pub(crate) fn missing_share(&self) -> f64 {
        let slack = 2 * u64::from(self.last_step).min(100);
        let missing = u64::from(AZIMUTH_COUNTS).saturating_sub(self.swept + slack);
        missing as f64 / f64::from(AZIMUTH_COUNTS)
    }

    /// Angle from the first firing to the last \[deg\]. It includes gaps: a revolution with missing
    /// packets is still a full circle.
    fn coverage_deg(&self) -> f32 {
        (self.swept + self.missed).saturating_sub(u64::from(self.last_step)) as f32 / 100.0
    }
}

/// Converts revolutions into scans.
pub(crate) struct ScanBuilder {
    limits: RangeLimits,
    /// Sign of y for an azimuth that is clockwise seen from above.
    side: f64,
    /// Cosine of the elevation of the beam: projects a range onto the plane.
    horizontal: f64,
    /// Cosine and sine of every tenth of a degree.
    directions: &'static [[f64; 2]],
}

/// Azimuth counts per table entry. With so few entries the table stays in the L1 cache.
const COUNTS_PER_ENTRY: u32 = 10;
const FINE_PER_ENTRY: u32 = FINE_PER_COUNT * COUNTS_PER_ENTRY;

/// Cosine and sine of the table angles, shared by all logs.
static DIRECTIONS: LazyLock<Vec<[f64; 2]>> = LazyLock::new(|| {
    let n_entries = u32::from(AZIMUTH_COUNTS) / COUNTS_PER_ENTRY;
    let direction = |entry| {
        let (sin, cos) = libm::sincos(f64::from(entry) * TAU / f64::from(n_entries));
        [cos, sin]
    };
    (0..n_entries).map(direction).collect()
});

impl ScanBuilder {
    pub(crate) fn new(options: &LidarOptions, laser: Laser) -> Self {
        Self {
            limits: RangeLimits { min_m: options.range_min_m, max_m: options.range_max_m },
            side: if options.upside_down { 1.0 } else { -1.0 },
            horizontal: match laser.elevation_deg {
                0.0 => 1.0,
                deg => libm::cos(deg.to_radians()),
            },
            directions: &DIRECTIONS,
        }
    }

    /// Converts a revolution into a scan.
    ///
    /// x points forward and y left (REP 103). Azimuth 0 is forward, and azimuth grows clockwise:
    /// x = r cos e cos a, y = -r cos e sin a, where r is the range and e the elevation of the beam.
    /// If the sensor is mounted upside down (rolled about x), azimuth grows counter-clockwise. The
    /// range limits apply to r.
    ///
    /// If the motion during the revolution is given, each return is moved to the lidar frame at the
    /// stamp of the scan.
    pub(crate) fn scan(&self, revolution: &Revolution, motion: Option<&ScanMotion>) -> Scan {
        let n_returns = revolution.firings.iter().filter(|firing| firing.distance != 0).count();
        let mut scan = Scan {
            stamp_ns: revolution.stamp_ns,
            x_m: Vec::with_capacity(n_returns),
            y_m: Vec::with_capacity(n_returns),
            coverage_deg: revolution.coverage_deg(),
            hole_deg: revolution.widest_gap as f32 / 100.0,
        };
        for firing in &revolution.firings {
            let range_m = f64::from(firing.distance) * METRES_PER_COUNT;
            if firing.distance != 0 && self.limits.contains(range_m) {
                let planar_m = range_m * self.horizontal;
                let [x_m, y_m] = match motion {
                    None => {
                        let [cos, sin] = self.direction(firing.fine_azimuth);
                        [planar_m * cos, self.side * planar_m * sin]
                    }
                    Some(motion) => self.deskewed(firing, planar_m, motion),
                };
                scan.x_m.push(x_m as f32);
                scan.y_m.push(y_m as f32);
            }
        }
        scan
    }

    /// Position of a return in the lidar frame at the stamp of the scan. If the lidar has rotated
    /// left by h since the stamp, the return lies h farther left.
    fn deskewed(&self, firing: &Firing, planar_m: f64, motion: &ScanMotion) -> [f64; 2] {
        let [dx, dy, heading] = motion.at(i64::from(firing.slot) * BLOCK_PERIOD_NS);
        let rotation = self.side * heading * (f64::from(FINE_PER_REVOLUTION) / TAU);
        let mut fine = f64::from(firing.fine_azimuth) + rotation;
        let revolution = f64::from(FINE_PER_REVOLUTION);
        if !(0.0..revolution).contains(&fine) {
            fine = fine.rem_euclid(revolution);
        }
        // The table covers whole counts, the series the rest. `rem_euclid` can round up to a full
        // revolution, so limit the index.
        let whole = (fine as u32).min(FINE_PER_REVOLUTION - 1);
        let [cos, sin] = self.direction_near(whole, fine - f64::from(whole));
        [dx + planar_m * cos, dy + self.side * planar_m * sin]
    }

    /// Cosine and sine of an azimuth.
    ///
    /// The table entry before the azimuth is rotated by the remaining angle d. d is less than
    /// 1.8e-3 rad, so the series up to d^4 and d^5 are exact in f64.
    #[inline]
    fn direction(&self, fine_azimuth: u32) -> [f64; 2] {
        self.direction_near(fine_azimuth, 0.0)
    }

    /// Cosine and sine of an azimuth plus a part of a fine count.
    #[inline]
    fn direction_near(&self, fine_azimuth: u32, part: f64) -> [f64; 2] {
        let [cos, sin] = self.directions[(fine_azimuth / FINE_PER_ENTRY) as usize];
        let fine = f64::from(fine_azimuth % FINE_PER_ENTRY) + part;
        let d = fine * (TAU / f64::from(FINE_PER_REVOLUTION));
        let d2 = d * d;
        let cos_d = 1.0 - d2 * (0.5 - d2 / 24.0);
        let sin_d = d * (1.0 - d2 * (1.0 / 6.0 - d2 / 120.0));
        [cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn builder(options: &LidarOptions) -> ScanBuilder {
        ScanBuilder::new(options, Laser::HORIZONTAL)
    }

    /// A return at 5 m and azimuth 90 deg (clockwise) lies to the right, y = -5; mounted upside down
    /// it lies to the left.
    #[test]
    fn azimuth_is_clockwise_and_mirrored_if_mounted_upside_down() {
        let firing = |deg: u32, distance| Firing { fine_azimuth: deg * 4000, distance, slot: 0 };
        let revolution = Revolution {
            firings: vec![
                firing(0, 2500),
                firing(90, 2500),
                firing(91, 0),
                firing(180, 449),
                firing(181, 450),
            ],
            ..Revolution::default()
        };
        for (upside_down, y) in [(false, -5.0), (true, 5.0)] {
            let scan = builder(&LidarOptions { upside_down, ..LidarOptions::default() })
                .scan(&revolution, None);
            assert_eq!(scan.len(), 3, "the missing return and 0.898 m are left out, 0.9 m is kept");
            assert_eq!((scan.x_m[0], scan.y_m[0].abs()), (5.0, 0.0));
            assert!(scan.x_m[1].abs() < 1e-6 && (scan.y_m[1] - y).abs() < 1e-6);
        }
    }

    #[test]
    fn directions_are_exact_between_the_counts() {
        let builder = builder(&LidarOptions::default());
        for fine in (0..FINE_PER_REVOLUTION).step_by(97) {
            let angle = f64::from(fine) * TAU / f64::from(FINE_PER_REVOLUTION);
            let [cos, sin] = builder.direction(fine);
            // The angle has a rounding error of 9e-16.
            assert!((cos - angle.cos()).abs() < 2e-15 && (sin - angle.sin()).abs() < 2e-15);
        }
    }

    /// Laser 1 points down by 28/3 deg. In the plane, 10 m become 10 m cos(28/3 deg) = 9.86762 m.
    #[test]
    fn a_slanted_beam_is_projected_and_limited_by_its_range() {
        let options = LidarOptions { range_max_m: 10.0, ..LidarOptions::default() };
        let firings = vec![
            Firing { fine_azimuth: 0, distance: 5000, slot: 0 },
            Firing { fine_azimuth: 90 * 4000, distance: 5001, slot: 1 },
        ];
        let revolution = Revolution { firings, ..Revolution::default() };
        let scan = ScanBuilder::new(&options, Laser::new(1)).scan(&revolution, None);
        assert_eq!(
            scan.len(),
            1,
            "the range of 10.002 m is over the limit, although its projection is not"
        );
        assert!((scan.x_m[0] - 9.867_62).abs() < 1e-5);
    }
}
