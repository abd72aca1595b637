//! Poses as text that other tools read.

use std::fmt::Write;

use crate::Pose2;

/// Poses in the format of the TUM RGB-D benchmark, as evo reads it, one line per pose: stamp \[s\], x, y and z \[m\], and
/// the unit quaternion x, y, z, w. A pose is a stamp \[ns\] and the pose in the plane.
pub fn tum(poses: impl IntoIterator<Item = (i64, Pose2)>) -> String {
    const SECOND_NS: u64 = 1_000_000_000;
    let mut text = String::new();
    for (stamp_ns, Pose2 { x_m, y_m, heading_rad }) in poses {
        let sign = if stamp_ns < 0 { "-" } else { "" };
        let ns = stamp_ns.unsigned_abs();
        let (seconds, rest) = (ns / SECOND_NS, ns % SECOND_NS);
        let (sin, cos) = libm::sincos(heading_rad / 2.0);
        // Writing to a string does not fail.
        let _ =
            writeln!(text, "{sign}{seconds}.{rest:09} {x_m:.9} {y_m:.9} 0 0 0 {sin:.12} {cos:.12}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A turn by 60 deg to the left: the sine of half of it is 0.5. The time before 1970 is negative.
    #[test]
    fn poses_have_nanoseconds_and_quaternions() {
        let heading_rad = std::f64::consts::FRAC_PI_3;
        let pose = Pose2 { x_m: 1.5, y_m: -2.0, heading_rad };
        let stamps = [-1, -1_500_000_000, 1_500_000_000_000_000_005];
        let text = tum(stamps.map(|stamp_ns| (stamp_ns, pose)));
        let rest = "1.500000000 -2.000000000 0 0 0 0.500000000000 0.866025403784";
        let expected = ["-0.000000001", "-1.500000000", "1500000000.000000005"];
        assert_eq!(text, expected.map(|stamp| format!("{stamp} {rest}\n")).concat());
    }
}
