//! Checks that clouds are in the frame of their sensor.
//!
//! Each ring of a rotating lidar sweeps a cone around the sensor. In the frame of the sensor, all
//! points of a ring therefore have one elevation. In another frame they do not: a driver or a filter
//! has moved the points. They are then not seen from the origin of the cloud.

use std::collections::BTreeMap;

/// Names of frames that do not move with the robot (REP 105), and of the start of a LOAM.
const FIXED_FRAMES: [&str; 12] = [
    "map",
    "odom",
    "world",
    "earth",
    "utm",
    "global",
    "local",
    "enu",
    "ned",
    "map_frame",
    "odom_frame",
    "camera_init",
];
/// Names of the frame of the robot (REP 105).
const BASE_FRAMES: [&str; 5] = ["base_link", "base_footprint", "base", "base_frame", "body"];
/// Three in four points of a ring are nearer to their cone than this, in the frame of a sensor \[m\].
/// Its apex is off by 0.04 m in the clouds of an Ouster, by up to 0.2 m in those of an HDL-64E, and by
/// the path during a revolution in clouds that are already deskewed.
const MAX_SPREAD_M: f64 = 0.3;
/// The same, if the name is that of the robot or of a map \[m\].
const MAX_NAMED_SPREAD_M: f64 = 0.1;
/// The clouds are in another frame if this share of them is. A robot can start at the origin of `odom`.
const MIN_SHARE: f64 = 0.25;
/// Number of points of a ring that are needed.
const MIN_POINTS: usize = 20;
/// About this many points of a cloud are used.
const MAX_POINTS: usize = 20_000;
/// A horizontal ring shows only a change of height. Steeper rings show all motions \[deg\].
const MIN_SLOPE_DEG: f64 = 1.5;

/// What a name says about a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FrameName {
    /// Any other name, such as that of a sensor.
    Other,
    /// A frame of the robot.
    Base,
    /// The frame that the poses are in, without another known name.
    Poses,
    /// The name of a frame that does not move.
    Fixed,
}

impl FrameName {
    /// Judges a name without a leading slash. `of_poses` are the frames that the poses are in.
    pub(crate) fn of<'a>(frame_id: &str, mut of_poses: impl Iterator<Item = &'a str>) -> Self {
        // A robot's name can come first: `robot1/odom`.
        let last = frame_id.rsplit('/').next().unwrap_or(frame_id);
        match () {
            () if FIXED_FRAMES.contains(&last) => Self::Fixed,
            () if !frame_id.is_empty() && of_poses.any(|name| name == frame_id) => Self::Poses,
            () if BASE_FRAMES.contains(&last) => Self::Base,
            () => Self::Other,
        }
    }
}

/// The shape of the rings of the sampled clouds.
#[derive(Debug, Clone, Default)]
pub(crate) struct ConeCheck {
    /// For each cloud, its ring with the widest spread.
    clouds: Vec<Ring>,
}

/// A ring of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ring {
    ring: u32,
    /// Median \[deg\].
    elevation_deg: f64,
    /// Distance of the points from the cone of the median elevation: the upper quartile \[m\].
    spread_m: f64,
    /// Whether the cloud has a ring that is not horizontal.
    has_slope: bool,
}

impl ConeCheck {
    /// Adds a cloud with `n` points. `point` gives ring, elevation \[rad\] and range \[m\] of a point, if
    /// it is a return.
    pub(crate) fn add(&mut self, n: usize, point: impl Fn(usize) -> Option<(u32, f64, f64)>) {
        let mut rings: BTreeMap<u32, Vec<(f64, f64)>> = BTreeMap::new();
        // An odd stride does not always select the same rings of a cloud in firing order.
        let stride = (n / MAX_POINTS) | 1;
        for (ring, elevation, range) in (0..n).step_by(stride).filter_map(point) {
            rings.entry(ring).or_default().push((elevation, range));
        }
        let rings = rings.into_iter().filter(|(_, points)| MIN_POINTS <= points.len());
        let mut rings: Vec<Ring> = rings.map(|(ring, points)| Ring::of(ring, points)).collect();
        let has_slope = rings.iter().any(|ring| MIN_SLOPE_DEG < ring.elevation_deg.abs());
        rings.iter_mut().for_each(|ring| ring.has_slope = has_slope);
        let widest = rings.into_iter().max_by(|a, b| a.spread_m.total_cmp(&b.spread_m));
        self.clouds.extend(widest);
    }

    pub(crate) fn merge(&mut self, later: Self) {
        self.clouds.extend(later.clouds);
    }

    /// Why the clouds of a frame are not in the frame of their sensor, or `None`.
    pub(crate) fn fault(&self, name: FrameName) -> Option<String> {
        let max_m = if name == FrameName::Other { MAX_SPREAD_M } else { MAX_NAMED_SPREAD_M };
        let wide = || self.clouds.iter().filter(|ring| max_m < ring.spread_m);
        let (n_wide, n) = (wide().count(), self.clouds.len());
        let widest = wide().max_by(|a, b| a.spread_m.total_cmp(&b.spread_m))?;
        (MIN_SHARE * n as f64 <= n_wide as f64).then(|| {
            format!(
                "in {n_wide} of {n} sampled clouds, the points of a ring are not at one elevation (ring {} at {:.1} deg: one in four of its points is {:.2} m or more from the cone of that elevation, expected less than {max_m} m)",
                widest.ring, widest.elevation_deg, widest.spread_m
            )
        })
    }

    /// Whether the rings show that the origin of the clouds is the sensor. Horizontal rings alone do
    /// not.
    pub(crate) fn confirms_sensor(&self) -> bool {
        self.clouds.iter().any(|ring| ring.has_slope) && self.fault(FrameName::Fixed).is_none()
    }
}

impl Ring {
    fn of(ring: u32, mut points: Vec<(f64, f64)>) -> Self {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let elevation = points[points.len() / 2].0;
        let mut distances: Vec<f64> = points
            .iter()
            .map(|&(of_point, range)| range * libm::sin((of_point - elevation).abs()))
            .collect();
        distances.sort_by(f64::total_cmp);
        let spread_m = distances[distances.len() * 3 / 4];
        Self { ring, elevation_deg: elevation.to_degrees(), spread_m, has_slope: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lidar in a room of 20 x 10 m whose walls are 6 m high. The points are in a frame with the
    /// lidar at `at`, rolled by `roll_deg`.
    fn check(clouds: &[([f64; 3], f64)]) -> ConeCheck {
        let mut check = ConeCheck::default();
        for &([x0, y0, z0], roll_deg) in clouds {
            let mut points = Vec::new();
            for (ring, elevation) in [-15.0f64, -7.0, 0.0, 7.0].into_iter().enumerate() {
                for degree in 0..360 {
                    let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                    let range = (10.0 / cos.abs()).min(5.0 / sin.abs());
                    let (x, y, z) =
                        (range * cos, range * sin, range * elevation.to_radians().tan());
                    let (s, c) = roll_deg.to_radians().sin_cos();
                    let (x, y, z) = (x0 + x, y0 + c * y - s * z, z0 + s * y + c * z);
                    let r = x.hypot(y);
                    points.push((ring as u32, z.atan2(r), r.hypot(z)));
                }
            }
            check.add(points.len(), |k| Some(points[k]));
        }
        check
    }

    #[test]
    fn clouds_of_a_sensor_pass_under_any_name() {
        let in_sensor = check(&[([0.0; 3], 0.0); 4]);
        // The apex of an Ouster is 0.036 m above the origin of its clouds.
        let ouster = check(&[([0.0, 0.0, 0.036], 0.0); 4]);
        for name in [FrameName::Other, FrameName::Base, FrameName::Fixed] {
            assert_eq!(in_sensor.fault(name), None);
            assert_eq!(ouster.fault(name), None);
        }
        assert!(in_sensor.confirms_sensor());
        assert!(!ConeCheck::default().confirms_sensor(), "without points nothing is shown");
    }

    #[test]
    fn clouds_in_odom_are_found_although_the_robot_starts_at_its_origin() {
        let driving: Vec<_> = (0..10).map(|k| ([f64::from(k), 0.0, 0.0], 0.0)).collect();
        let text = check(&driving).fault(FrameName::Fixed).unwrap();
        assert!(text.contains("of 10 sampled clouds") && text.contains("ring"), "{text}");
        assert!(check(&driving).fault(FrameName::Other).is_some());
    }

    #[test]
    fn clouds_in_base_link_are_found_by_the_mount() {
        for (at, roll_deg) in [([0.3, 0.0, 0.6], 0.0), ([0.0, 0.0, 0.5], 0.0), ([0.0; 3], 10.0)] {
            let moved = check(&[(at, roll_deg); 3]);
            assert!(moved.fault(FrameName::Base).is_some(), "{at:?} {roll_deg}");
        }
    }

    #[test]
    fn names_are_judged_without_the_name_of_the_robot() {
        let name = |frame| FrameName::of(frame, ["slam_map"].into_iter());
        assert_eq!(name("velodyne"), FrameName::Other);
        assert_eq!(name("odom"), FrameName::Fixed);
        assert_eq!(name("robot1/odom"), FrameName::Fixed);
        assert_eq!(name("slam_map"), FrameName::Poses);
        assert_eq!(name("base_link"), FrameName::Base);
        assert_eq!(name(""), FrameName::Other);
    }
}
