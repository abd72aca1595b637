//! Changes of axes between the z-down frames of some data sets and the z-up frames of ROS (REP 103),
//! and rotations from angles.
//!
//! The sines come from `libm` instead of the system, because the system's results differ between
//! processors. The constructors of nalgebra use the system's sines.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Quaternion, Unit, UnitQuaternion};

/// `flu_from_frd`: half a revolution about x, from forward-right-down to forward-left-up axes. It is
/// its own inverse.
pub(crate) const FLU_FROM_FRD: UnitQuaternion<f64> =
    Unit::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0));
/// `enu_from_ned`: half a revolution about the diagonal between x and y, from north-east-down to
/// east-north-up axes. It is its own inverse.
pub(crate) const ENU_FROM_NED: UnitQuaternion<f64> =
    Unit::new_unchecked(Quaternion::new(0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0));

/// The rotation by `roll` about x, then `pitch` about y, then `heading` about z, all about fixed
/// axes \[rad\].
pub(crate) fn from_roll_pitch_heading(roll: f64, pitch: f64, heading: f64) -> UnitQuaternion<f64> {
    let (sr, cr) = libm::sincos(roll / 2.0);
    let (sp, cp) = libm::sincos(pitch / 2.0);
    let (sh, ch) = libm::sincos(heading / 2.0);
    Unit::new_unchecked(Quaternion::new(
        cr * cp * ch + sr * sp * sh,
        sr * cp * ch - cr * sp * sh,
        cr * sp * ch + sr * cp * sh,
        cr * cp * sh - sr * sp * ch,
    ))
}

/// The rotation by a heading about z \[rad\].
pub(crate) fn from_heading(heading: f64) -> UnitQuaternion<f64> {
    from_roll_pitch_heading(0.0, 0.0, heading)
}

/// A vector in forward-left-up axes from one in forward-right-down axes, or the reverse. Exact,
/// unlike a product with [`FLU_FROM_FRD`].
pub(crate) fn flu_from_frd([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, -y, -z]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_close(a: UnitQuaternion<f64>, b: UnitQuaternion<f64>) {
        let dot = a.coords.dot(&b.coords);
        assert!((dot.abs() - 1.0).abs() < 1e-12, "{a:?} {b:?}");
    }

    /// A heading of 30 deg clockwise from north is 60 deg counter-clockwise from east.
    #[test]
    fn a_heading_of_30_deg_from_north_is_60_deg_from_east() {
        let ned = from_heading(30f64.to_radians());
        let enu = ENU_FROM_NED * ned * FLU_FROM_FRD;
        assert_close(enu, from_heading(60f64.to_radians()));
    }

    #[test]
    fn pitch_and_heading_change_sign_between_frd_and_flu() {
        let frd = from_roll_pitch_heading(0.1, 0.2, 0.3);
        let flu = FLU_FROM_FRD * frd * FLU_FROM_FRD;
        assert_close(flu, from_roll_pitch_heading(0.1, -0.2, -0.3));
    }
}
