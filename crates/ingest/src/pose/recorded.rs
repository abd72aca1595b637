//! One transform between two frames, recorded over time.

use dataset::Pose2;
use nalgebra::{Isometry3, UnitQuaternion};

use crate::pose::message::yaw_rad;

/// Longest mean time between the samples of a regular transform \[ns\].
const REGULAR_PERIOD_NS: i64 = 1_000_000_000;
/// A longer time between two samples of a regular transform is a gap \[ns\].
const GAP_NS: i64 = 2_000_000_000;

/// The samples of one transform, `parent_from_child`.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct RecordedTransform {
    /// Stamps \[ns\] and transforms, in the order of the log.
    samples: Vec<(i64, Isometry3<f64>)>,
    /// Whether the transform is valid at all times. Only the last sample is kept then.
    is_static: bool,
    /// Length of the motion so far: metres plus radians.
    path_m_rad: f64,
}

impl RecordedTransform {
    /// Adds a sample.
    pub(crate) fn push(&mut self, stamp_ns: i64, parent_from_child: Isometry3<f64>) {
        if self.is_static {
            self.samples.clear();
        } else if let Some((_, last)) = self.samples.last() {
            self.path_m_rad += difference_m_rad(last, &parent_from_child);
        }
        self.samples.push((stamp_ns, parent_from_child));
    }

    /// Adds the samples of a later part of the log.
    pub(crate) fn extend(&mut self, later: Self) {
        self.is_static |= later.is_static;
        for (stamp_ns, parent_from_child) in later.samples {
            self.push(stamp_ns, parent_from_child);
        }
    }

    /// Marks the transform as valid at all times.
    pub(crate) fn set_static(&mut self) {
        self.is_static = true;
    }

    pub(crate) fn n_samples(&self) -> usize {
        self.samples.len()
    }

    /// Stamps of the samples, in the order of the log \[ns\].
    pub(crate) fn stamps_ns(&self) -> impl DoubleEndedIterator<Item = i64> {
        self.samples.iter().map(|(stamp_ns, _)| *stamp_ns)
    }

    /// Length of the motion so far: metres plus radians.
    pub(crate) fn path_m_rad(&self) -> f64 {
        self.path_m_rad
    }

    /// The same samples in order of time.
    pub(crate) fn sorted(&self) -> Self {
        let mut sorted = self.clone();
        sorted.samples.sort_by_key(|(stamp_ns, _)| *stamp_ns);
        sorted
    }

    /// The stamp of the last sample of a regular transform; `None` for other transforms \[ns\].
    pub(crate) fn newest_regular_ns(&self) -> Option<i64> {
        self.samples.last().filter(|_| self.is_regular()).map(|(stamp_ns, _)| *stamp_ns)
    }

    /// Whether the mean time between samples is at most [`REGULAR_PERIOD_NS`].
    fn is_regular(&self) -> bool {
        let n = self.samples.len() as i64;
        let [(first_ns, _), .., (last_ns, _)] = self.samples.as_slice() else { return false };
        last_ns.saturating_sub(*first_ns) / (n - 1) <= REGULAR_PERIOD_NS
    }

    /// Whether a stamp is in a gap between two samples of a regular transform. The samples must be
    /// in order of time.
    pub(crate) fn is_in_gap(&self, stamp_ns: i64) -> bool {
        let after = self.samples.partition_point(|(ns, _)| *ns < stamp_ns);
        match (after.checked_sub(1).and_then(|k| self.samples.get(k)), self.samples.get(after)) {
            (Some((before_ns, _)), Some((after_ns, _))) => {
                *after_ns != stamp_ns
                    && GAP_NS < after_ns.saturating_sub(*before_ns)
                    && self.is_regular()
            }
            _ => false,
        }
    }

    /// The transform at a stamp, interpolated between samples in order of time. It is `None` before
    /// the first and after the last sample. A single sample is valid at all times.
    pub(crate) fn at(&self, stamp_ns: i64) -> Option<Isometry3<f64>> {
        if let [(_, only)] = self.samples.as_slice() {
            return Some(*only);
        }
        let after = self.samples.partition_point(|(ns, _)| *ns < stamp_ns);
        let (after_ns, next) = self.samples.get(after)?;
        if *after_ns == stamp_ns {
            return Some(*next);
        }
        let (before_ns, previous) = self.samples.get(after.checked_sub(1)?)?;
        let share = (stamp_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
        // If the samples are out of order, the stamp may be outside of the two samples.
        (0.0..=1.0).contains(&share).then(|| interpolate(previous, next, share))
    }

    /// The transform at a stamp. A transform that is not regular keeps the value of the last sample
    /// before the stamp.
    pub(crate) fn at_or_last(&self, stamp_ns: i64) -> Option<Isometry3<f64>> {
        if self.is_regular() {
            return self.at(stamp_ns);
        }
        let after = self.samples.partition_point(|(ns, _)| *ns <= stamp_ns);
        self.samples.get(after.saturating_sub(1)).map(|(_, transform)| *transform)
    }
}

/// The x, y and heading of a pose in space.
pub(crate) fn planar(pose: &Isometry3<f64>) -> Pose2 {
    let heading_rad = yaw_rad(pose.rotation.coords.into());
    Pose2 { x_m: pose.translation.x, y_m: pose.translation.y, heading_rad }
}

/// Whether the z axis of the child frame points down: entry (3, 3) of the rotation matrix.
pub(crate) fn points_down(pose: &Isometry3<f64>) -> bool {
    let (x, y) = (pose.rotation.i, pose.rotation.j);
    1.0 - 2.0 * (x * x + y * y) < 0.0
}

/// The difference between two transforms: metres plus radians. The angle is approximated by twice
/// the distance between the quaternions, which is exact for small angles.
fn difference_m_rad(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let (p, q) = (a.rotation.coords, b.rotation.coords);
    (a.translation.vector - b.translation.vector).norm() + 2.0 * (p - q).norm().min((p + q).norm())
}

/// Interpolates between two transforms, from `a` (share 0) to `b` (share 1). The translation is
/// interpolated linearly. The rotation follows the shorter arc as a normalized linear interpolation
/// of the quaternions. For rotations of up to 0.1 rad it differs by less than 1e-5 rad from a
/// rotation at constant rate.
fn interpolate(a: &Isometry3<f64>, b: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let (p, q) = (a.rotation.into_inner(), b.rotation.into_inner());
    let q_share = if p.dot(&q) < 0.0 { -share } else { share };
    let (from, to) = (a.translation.vector, b.translation.vector);
    Isometry3::from_parts(
        (from + share * (to - from)).into(),
        UnitQuaternion::new_normalize(p * (1.0 - share) + q * q_share),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, Vector3};
    use std::f64::consts::PI;

    fn transform(translation: [f64; 3], yaw_rad: f64) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        Isometry3::from_parts(Translation3::from(translation), rotation)
    }

    #[test]
    fn samples_are_interpolated_along_the_shorter_arc() {
        let mut recorded = RecordedTransform::default();
        recorded.push(0, transform([0.0, 2.0, 0.0], 3.0));
        recorded.push(10, transform([4.0, 0.0, 0.0], -3.0));
        let half = planar(&recorded.at(5).unwrap());
        assert_eq!((half.x_m, half.y_m), (2.0, 1.0));
        assert!((half.heading_rad.abs() - PI).abs() < 1e-12, "across pi: {half:?}");
        assert_eq!((recorded.at(-1), recorded.at(11)), (None, None));
        // A quarter of 0.1 rad: linear interpolation of the quaternions is 1.2e-6 rad off.
        let rotated = transform([0.0; 3], 0.1);
        let quarter = planar(&interpolate(&Isometry3::identity(), &rotated, 0.25)).heading_rad;
        assert!((quarter - 0.025).abs() < 1e-5 && quarter != 0.025);
    }

    #[test]
    fn only_regular_transforms_have_gaps_and_an_end() {
        let regular = |stamps_s: &[i64]| {
            let mut recorded = RecordedTransform::default();
            for s in stamps_s {
                recorded.push(s * 1_000_000_000, transform([*s as f64, 0.0, 0.0], 0.0));
            }
            recorded
        };
        let dense = regular(&[0, 0, 0, 0, 1, 4]);
        assert!(dense.is_in_gap(2_000_000_000) && !dense.is_in_gap(500_000_000));
        assert_eq!(dense.at_or_last(5_000_000_000), None);
        let sparse = regular(&[0, 4]);
        assert!(!sparse.is_in_gap(2_000_000_000));
        let last = sparse.at_or_last(5_000_000_000).unwrap();
        assert_eq!(last.translation.x, 4.0);
    }
}
