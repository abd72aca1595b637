//! One return in `velodyne_hits.bin`.
//!
//! Layout (the data set's `read_vel_hits.py`), little endian:
//!
//! ```text
//! x, y, z u16 [5 mm from -100 m] | intensity u8 | laser u8
//! ```
//!
//! The coordinates are in the frame of the sensor. According to the calibration of the data set, the
//! rotation from the sensor to the body (x forward, y right, z down) is (0.807, 0.166, -90.703) deg.
//! The y axis of the sensor therefore points forward, its x axis left and its z axis down. This is an
//! HDL-32E, which has x right, y forward, z up, mounted upside down. [`Hit`] has x forward (y in the
//! file), y left (x in the file) and z up (-z in the file).

/// The size of a hit \[bytes\].
pub(super) const HIT_BYTES: usize = 8;
const METRES_PER_COUNT: f64 = 0.005;
const OFFSET_M: f64 = -100.0;

/// One return, in x-forward, y-left, z-up axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hit {
    pub stamp_ns: i64,
    /// \[m\]
    pub position: [f64; 3],
    pub intensity: u8,
    pub laser: u8,
}

impl Hit {
    /// Parses a hit of [`HIT_BYTES`] bytes.
    pub fn parse(stamp_ns: i64, raw: &[u8]) -> Self {
        let metres = |at: usize| {
            f64::from(u16::from_le_bytes([raw[at], raw[at + 1]])) * METRES_PER_COUNT + OFFSET_M
        };
        let (left, forward, down) = (metres(0), metres(2), metres(4));
        Self { stamp_ns, position: [forward, left, -down], intensity: raw[6], laser: raw[7] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 21,000 is 5 m, 20,400 is 2 m, 19,000 is -5 m.
    #[test]
    fn coordinates_of_an_inverted_sensor_become_forward_left_up() {
        let raw = [21_000u16, 20_400, 19_000].map(u16::to_le_bytes).concat();
        let hit = Hit::parse(7, &[&raw[..], &[200, 31]].concat());
        let expected = [2.0, 5.0, 5.0];
        for (found, expected) in hit.position.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{hit:?}");
        }
        assert_eq!((hit.intensity, hit.laser), (200, 31));
    }
}
