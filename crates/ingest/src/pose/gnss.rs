//! Satellite fixes -> poses in a local map frame: x points east and y north of an origin.
//!
//! A fix has no heading. The heading of a pose is the course: the direction of motion over a
//! distance of [`COURSE_M`]. If the robot drives backward, the heading is reversed.

use dataset::{LossKind, Pose2, StampedPose};
use messages::NavSatFix;

use crate::pose_options::Origin;

/// The course is the direction of a chord of at least this length \[m\]. The noise of a receiver, a
/// few centimetres between two fixes, changes this direction only slightly.
const COURSE_M: f64 = 2.0;

/// The ellipsoid of WGS 84 (NIMA TR8350.2, 3rd edition, table 3.1): semi-major axis \[m\] and
/// flattening.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// `sensor_msgs/NavSatStatus`: lower values mean that there is no fix.
const STATUS_FIX: i8 = 0;

/// Positions closer to latitude 0, longitude 0 than this are not fixes \[deg\].
const NULL_ISLAND_DEG: f64 = 1e-6;

/// Larger altitudes are not those of a vehicle \[m\]: aircraft fly below 2e4 m. An unknown altitude is
/// NaN.
const MAX_ALTITUDE_M: f64 = 1e5;

/// A height is used if its standard deviation is known and below this \[m\], a third of the height of a
/// floor. Receivers without corrections are off by several metres from one drive to the next.
const MAX_HEIGHT_STD_M: f64 = 1.0;

/// Checks that a message contains a valid fix. The error is the kind of loss that the message is
/// counted as.
pub(crate) fn check(fix: &NavSatFix) -> Result<(), LossKind> {
    if fix.status < STATUS_FIX {
        return Err(LossKind::NoGnssFix);
    }
    // This position is in the Gulf of Guinea, 600 km from land. Some receivers send it without a
    // fix.
    if fix.latitude_deg.abs() < NULL_ISLAND_DEG && fix.longitude_deg.abs() < NULL_ISLAND_DEG {
        return Err(LossKind::GnssFixAtZero);
    }
    let is_on_earth = fix.latitude_deg.abs() <= 90.0 && fix.longitude_deg.abs() <= 360.0;
    if !is_on_earth || MAX_ALTITUDE_M < fix.altitude_m.abs() {
        return Err(LossKind::GnssFixOutOfRange);
    }
    Ok(())
}

/// The position of a fix, as the origin of a map frame.
pub(crate) fn origin(fix: &NavSatFix) -> Origin {
    Origin {
        latitude_deg: fix.latitude_deg,
        longitude_deg: fix.longitude_deg,
        altitude_m: if fix.altitude_m.is_finite() { fix.altitude_m } else { 0.0 },
    }
}

/// East and north of an origin \[m\]. An unknown altitude is that of the origin.
pub(crate) fn east_north(origin: &Origin, point: &Origin) -> [f64; 2] {
    let altitude_m =
        if point.altitude_m.is_finite() { point.altitude_m } else { origin.altitude_m };
    let [x_m, y_m, _] = LocalPlane::new(origin).east_north_up(&Origin { altitude_m, ..*point });
    [x_m, y_m]
}

/// The pose of the receiver for each fix, in the order of the fixes and with their frames. The headings
/// are not known yet: [`set_courses`] sets them.
pub(crate) fn poses(fixes: &[(NavSatFix, u32)], origin: &Origin) -> Vec<StampedPose> {
    let plane = LocalPlane::new(origin);
    let pose = |(fix, frame): &(NavSatFix, u32)| {
        let altitude_m =
            if fix.altitude_m.is_finite() { fix.altitude_m } else { origin.altitude_m };
        let [x_m, y_m, up_m] = plane.east_north_up(&Origin { altitude_m, ..self::origin(fix) });
        let up_variance = fix.covariance[8];
        let is_height_known = fix.altitude_m.is_finite()
            && 0.0 < up_variance
            && up_variance <= MAX_HEIGHT_STD_M * MAX_HEIGHT_STD_M;
        let z_m = is_height_known.then_some(up_m);
        let pose = Pose2 { x_m, y_m, heading_rad: 0.0 };
        StampedPose { z_m, frame: *frame, ..StampedPose::new(fix.stamp_ns, pose) }
    };
    fixes.iter().map(pose).collect()
}

/// Sets the headings of poses in order of time, separately for each segment.
pub(crate) fn set_courses(poses: &mut [StampedPose]) {
    poses.chunk_by_mut(|a, b| a.segment == b.segment).for_each(set_courses_of_segment);
}

/// Sets the heading of each pose to the direction of its chord. The poses after the last chord get
/// the direction of the last chord.
fn set_courses_of_segment(poses: &mut [StampedPose]) {
    let mut start = 0;
    let mut course = None;
    for end in 1..poses.len() {
        let (from, to) = (poses[start].pose, poses[end].pose);
        if COURSE_M <= from.distance_m(&to) {
            let heading_rad = libm::atan2(to.y_m - from.y_m, to.x_m - from.x_m);
            poses[start..end].iter_mut().for_each(|p| p.pose.heading_rad = heading_rad);
            start = end;
            course = Some(heading_rad);
        }
    }
    if let Some(heading_rad) = course {
        poses[start..].iter_mut().for_each(|p| p.pose.heading_rad = heading_rad);
    }
}

/// The plane parallel to the ellipsoid at the origin.
struct LocalPlane {
    origin: [f64; 3],
    /// Sine and cosine of the latitude and the longitude of the origin.
    latitude: (f64, f64),
    longitude: (f64, f64),
}

impl LocalPlane {
    fn new(origin: &Origin) -> Self {
        Self {
            origin: earth_centered(origin),
            latitude: libm::sincos(origin.latitude_deg.to_radians()),
            longitude: libm::sincos(origin.longitude_deg.to_radians()),
        }
    }

    /// East, north and up of a point \[m\] (Hofmann-Wellenhof, Lichtenegger and Wasle 2008, "GNSS",
    /// eq. 8.7).
    fn east_north_up(&self, point: &Origin) -> [f64; 3] {
        let p = earth_centered(point);
        let [dx, dy, dz]: [f64; 3] = std::array::from_fn(|k| p[k] - self.origin[k]);
        let ((sin_lat, cos_lat), (sin_lon, cos_lon)) = (self.latitude, self.longitude);
        [
            -sin_lon * dx + cos_lon * dy,
            -sin_lat * cos_lon * dx - sin_lat * sin_lon * dy + cos_lat * dz,
            cos_lat * cos_lon * dx + cos_lat * sin_lon * dy + sin_lat * dz,
        ]
    }
}

/// Earth-centered, earth-fixed coordinates \[m\] (the same book, eq. 8.4).
fn earth_centered(point: &Origin) -> [f64; 3] {
    let e2 = FLATTENING * (2.0 - FLATTENING);
    let (sin_lat, cos_lat) = libm::sincos(point.latitude_deg.to_radians());
    let (sin_lon, cos_lon) = libm::sincos(point.longitude_deg.to_radians());
    let n = SEMI_MAJOR_M / (1.0 - e2 * sin_lat * sin_lat).sqrt();
    let h = point.altitude_m;
    [(n + h) * cos_lat * cos_lon, (n + h) * cos_lat * sin_lon, (n * (1.0 - e2) + h) * sin_lat]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn fix(stamp_ns: i64, latitude_deg: f64, longitude_deg: f64) -> NavSatFix {
        NavSatFix {
            stamp_ns,
            status: 0,
            latitude_deg,
            longitude_deg,
            altitude_m: f64::NAN,
            covariance: [0.0; 9],
        }
    }

    /// Radii of curvature on WGS 84: along a meridian a (1 - e^2) / (1 - e^2 sin^2)^(3/2), along a
    /// parallel a cos / sqrt(1 - e^2 sin^2). At latitude 0 one degree is 110 574.3 m north and
    /// 111 319.5 m east; at latitude 60 deg it is 111 412.2 m and 55 800.0 m (published tables).
    #[test]
    fn distances_agree_with_the_radii_of_curvature() {
        for (latitude, north_m, east_m) in [(0.0, 110.5743, 111.3195), (60.0, 111.4122, 55.8000)] {
            let place = Origin { latitude_deg: latitude, longitude_deg: -83.7, altitude_m: 0.0 };
            let fixes = [(latitude + 1e-3, -83.7), (latitude, -83.7 + 1e-3)];
            let fixes = fixes.map(|(latitude, longitude)| (fix(0, latitude, longitude), 0));
            let poses = poses(&fixes, &place);
            assert!(poses[0].pose.x_m.abs() < 1e-6 && (poses[0].pose.y_m - north_m).abs() < 2e-3);
            assert!((poses[1].pose.x_m - east_m).abs() < 2e-3 && poses[1].pose.y_m.abs() < 2e-3);
        }
        // At the equator the distance to the center of the earth is the semi-major axis.
        let equator = Origin { latitude_deg: 0.0, longitude_deg: 90.0, altitude_m: 5.0 };
        let [x, y, z] = earth_centered(&equator);
        assert!(x.abs() < 1e-8 && (y - SEMI_MAJOR_M - 5.0).abs() < 1e-8 && z == 0.0);
    }

    /// 5 fixes north, 1.1 m apart, then 3 fixes at standstill, then 4 fixes east.
    #[test]
    fn the_heading_is_the_course() {
        let step_north = 1.1 / 110_574.3;
        let step_east = 1.1 / 111_319.5;
        let mut fixes: Vec<_> = (0..5).map(|k| fix(k, k as f64 * step_north, 0.0)).collect();
        fixes.extend((5..8).map(|k| fix(k, 4.0 * step_north, 0.0)));
        fixes.extend((8..12).map(|k| fix(k, 4.0 * step_north, (k - 7) as f64 * step_east)));
        let fixes: Vec<_> = fixes.into_iter().map(|fix| (fix, 0)).collect();
        let place = Origin { latitude_deg: 0.0, longitude_deg: 0.0, altitude_m: 0.0 };
        let headings_of = |fixes: &[(NavSatFix, u32)]| -> Vec<f64> {
            let mut poses = poses(fixes, &place);
            set_courses(&mut poses);
            poses.iter().map(|p| p.pose.heading_rad).collect()
        };
        let headings = headings_of(&fixes);
        for (k, heading) in headings.iter().enumerate() {
            let expected = if k < 4 { FRAC_PI_2 } else { 0.0 };
            assert!((heading - expected).abs() < 1e-3, "{k}: {headings:?}");
        }
        assert_eq!(headings_of(&fixes[5..8]), [0.0; 3]);
        // Two segments. The first one goes only north.
        let mut poses = poses(&fixes, &place);
        poses[8..].iter_mut().for_each(|p| p.segment = 1);
        set_courses(&mut poses);
        assert!((poses[7].pose.heading_rad - FRAC_PI_2).abs() < 1e-3);
        assert!(poses[8].pose.heading_rad.abs() < 1e-3);
    }

    /// The height of a fix is used if its accuracy is known: 0.5 m is enough, 3 m is not.
    #[test]
    fn heights_are_used_if_they_are_accurate() {
        let place = Origin { latitude_deg: 1.0, longitude_deg: 2.0, altitude_m: 10.0 };
        let height = |altitude_m: f64, std_m: f64| {
            let mut fix = NavSatFix { altitude_m, ..fix(0, 1.0, 2.0) };
            fix.covariance[8] = std_m * std_m;
            poses(&[(fix, 0)], &place)[0].z_m
        };
        assert!((height(14.0, 0.5).unwrap() - 4.0).abs() < 1e-6);
        assert_eq!(
            (height(14.0, 3.0), height(14.0, 0.0), height(f64::NAN, 0.5)),
            (None, None, None)
        );
    }

    #[test]
    fn invalid_fixes_are_refused() {
        let no_fix = NavSatFix { status: -1, ..fix(0, 1.0, 1.0) };
        assert_eq!(check(&no_fix), Err(LossKind::NoGnssFix));
        assert_eq!(check(&fix(0, f64::NAN, 0.0)), Err(LossKind::GnssFixOutOfRange));
        assert_eq!(check(&fix(0, 0.0, 0.0)), Err(LossKind::GnssFixAtZero));
        assert_eq!(check(&fix(0, -90.0, 180.0)), Ok(()));
        assert_eq!(check(&fix(0, 0.0, 32.6)), Ok(()));
        let absurd = NavSatFix { altitude_m: 1e300, ..fix(0, 1.0, 1.0) };
        assert_eq!(check(&absurd), Err(LossKind::GnssFixOutOfRange));
        assert_eq!(check(&fix(0, 1e300, 1.0)), Err(LossKind::GnssFixOutOfRange));
    }
}
