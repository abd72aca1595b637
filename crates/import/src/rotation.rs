//! Quaternions (x, y, z, w), and the two changes of axes that robots' z-down frames need.

/// A half turn about x: forward-right-down axes seen from forward-left-up ones, and back.
pub(crate) const FLU_FROM_FRD: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
/// A half turn about the diagonal between x and y: north-east-down axes seen from east-north-up
/// ones, and back. The numbers are sqrt(1/2).
pub(crate) const ENU_FROM_NED: [f64; 4] =
    [std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0];

/// First `b`, then `a`.
pub(crate) fn multiply(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let ([ax, ay, az, aw], [bx, by, bz, bw]) = (a, b);
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// Roll about x, then pitch about y, then heading about z, about fixed axes \[rad\].
pub(crate) fn from_roll_pitch_heading(roll: f64, pitch: f64, heading: f64) -> [f64; 4] {
    let (sr, cr) = libm::sincos(roll / 2.0);
    let (sp, cp) = libm::sincos(pitch / 2.0);
    let (sh, ch) = libm::sincos(heading / 2.0);
    [
        sr * cp * ch - cr * sp * sh,
        cr * sp * ch + sr * cp * sh,
        cr * cp * sh - sr * sp * ch,
        cr * cp * ch + sr * sp * sh,
    ]
}

/// A heading alone \[rad, counter-clockwise about z up\].
pub(crate) fn from_heading(heading: f64) -> [f64; 4] {
    from_roll_pitch_heading(0.0, 0.0, heading)
}

/// Forward-right-down to forward-left-up, and back.
pub(crate) fn flip([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 4], b: [f64; 4]) {
        let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        assert!((dot.abs() - 1.0).abs() < 1e-12, "{a:?} {b:?}");
    }

    /// A robot that faces north-east and down seen from above: heading 45 deg clockwise from north
    /// is 45 deg counter-clockwise from east.
    #[test]
    fn a_heading_of_30_deg_from_north_is_60_deg_from_east() {
        let ned = from_heading(30f64.to_radians());
        let enu = multiply(multiply(ENU_FROM_NED, ned), FLU_FROM_FRD);
        close(enu, from_heading(60f64.to_radians()));
    }

    #[test]
    fn a_turn_to_the_right_is_positive_in_frd_and_negative_in_flu() {
        let frd = from_roll_pitch_heading(0.1, 0.2, 0.3);
        let flu = multiply(multiply(FLU_FROM_FRD, frd), FLU_FROM_FRD);
        close(flu, from_roll_pitch_heading(0.1, -0.2, -0.3));
    }
}
