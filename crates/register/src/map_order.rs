//! An order in which neighbours on the map come close together.

use dataset::Pose2;

/// Side of a square \[m\]. What is in one square comes in a row.
const SQUARE_M: f64 = 10.0;

/// The indices of poses in an order in which poses near each other on the map mostly come close together, whenever
/// they were driven: by squares of 10 m along a Z-order curve (Morton 1966), and by index within a square.
///
/// What is compared in this order needs few scans at a time.
pub fn map_order(poses: impl Iterator<Item = Pose2>) -> Vec<usize> {
    let mut order: Vec<(u64, usize)> =
        poses.enumerate().map(|(k, pose)| (z_order([pose.x_m, pose.y_m]), k)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, k)| k).collect()
}

/// The position of the square of a point along the curve: the bits of both coordinates in turns.
fn z_order(point_m: [f64; 2]) -> u64 {
    let [x, y] = point_m.map(|v| {
        // Far away, the order does not matter.
        let square = (v / SQUARE_M).floor().clamp(f64::from(i32::MIN), f64::from(i32::MAX));
        spread((square as i32 as u32) ^ (1 << 31))
    });
    x << 1 | y
}

/// The bits of a number, each followed by a zero.
fn spread(v: u32) -> u64 {
    let mut v = u64::from(v);
    for (shift, mask) in [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ] {
        v = (v | v << shift) & mask;
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four squares of 10 m around the origin, visited twice.
    #[test]
    fn neighbours_of_two_passes_come_in_a_row() {
        let corners =
            [[5.0, 5.0], [-5.0, 5.0], [5.0, -5.0], [-5.0, -5.0], [6.0, 6.0], [-6.0, -4.0]];
        let poses = corners.map(|[x_m, y_m]| Pose2 { x_m, y_m, heading_rad: 0.0 });
        assert_eq!(map_order(poses.into_iter()), [3, 5, 1, 2, 0, 4]);
    }

    #[test]
    fn bits_are_spread() {
        assert_eq!(spread(0b1011), 0b100_0101);
        assert_eq!(spread(u32::MAX), 0x5555_5555_5555_5555);
        assert!(z_order([f64::NAN, 0.0]) <= z_order([f64::INFINITY, f64::INFINITY]));
    }
}
