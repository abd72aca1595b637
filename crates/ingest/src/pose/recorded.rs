//! One transform between two frames, recorded over time.

use dataset::Pose2;
use nalgebra::{Isometry3, UnitQuaternion};

use crate::pose::message::yaw_rad;

/// Longest mean time between the samples of a regular transform \[ns\].
const REGULAR_PERIOD_NS: i64 = 1_000_000_000;
/// Two samples that are closer together than this have no gap between them \[ns\].
const MIN_GAP_NS: i64 = 2_000_000_000;
/// A transform is silent if the time between two samples is longer than this number of its own periods.
/// Transforms that are published when they change have no fixed period: if they are exponentially
/// distributed, 1.6 % of the times are longer than three times the period below.
const GAP_PERIODS: i64 = 3;
/// The period of a transform: this share of the times between its samples is not longer.
const PERIOD_SHARE: f64 = 0.75;

/// The samples of one transform, `parent_from_child`.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct RecordedTransform {
    /// Stamps \[ns\] and transforms, in the order of the log.
    samples: Vec<(i64, Isometry3<f64>)>,
    /// Whether the transform is valid at all times. Only the last sample is kept then.
    is_static: bool,
    /// Length of the motion so far: metres plus radians.
    path_m_rad: f64,
    /// A longer time between two samples is a gap \[ns\]. Known after [`RecordedTransform::sorted`].
    gap_ns: i64,
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
    pub(crate) fn sorted(mut self) -> Self {
        self.samples.sort_by_key(|(stamp_ns, _)| *stamp_ns);
        let pairs = self.samples.windows(2);
        let mut periods_ns: Vec<i64> = pairs.map(|p| p[1].0.saturating_sub(p[0].0)).collect();
        periods_ns.sort_unstable();
        let at = (PERIOD_SHARE * periods_ns.len().saturating_sub(1) as f64) as usize;
        let period_ns = periods_ns.get(at).copied().unwrap_or(0);
        self.gap_ns = period_ns.saturating_mul(GAP_PERIODS).max(MIN_GAP_NS);
        self
    }

    /// The samples, in the order of the log.
    pub(crate) fn samples(&self) -> &[(i64, Isometry3<f64>)] {
        &self.samples
    }

    /// Removes the samples at some times. Returns their number.
    pub(crate) fn remove(&mut self, is_removed: impl Fn(i64) -> bool) -> u64 {
        let before = self.samples.len();
        if 1 < before {
            self.samples.retain(|(stamp_ns, _)| !is_removed(*stamp_ns));
        }
        (before - self.samples.len()) as u64
    }

    /// The last sample before a stamp and the first sample at or after it, if the samples are in order
    /// of time.
    pub(crate) fn around(&self, stamp_ns: i64) -> Option<[(i64, Isometry3<f64>); 2]> {
        let after = self.samples.partition_point(|(ns, _)| *ns < stamp_ns);
        Some([*self.samples.get(after.checked_sub(1)?)?, *self.samples.get(after)?])
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

    /// Whether a stamp is in a gap between two samples: the time between them is much longer than the
    /// period of the transform. The transform must be [`sorted`](RecordedTransform::sorted).
    pub(crate) fn is_in_gap(&self, stamp_ns: i64) -> bool {
        self.around(stamp_ns).is_some_and(|[(before_ns, _), (after_ns, _)]| {
            after_ns != stamp_ns && self.gap_ns < after_ns.saturating_sub(before_ns)
        })
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

    fn recorded(stamps_s: impl IntoIterator<Item = f64>) -> RecordedTransform {
        let mut recorded = RecordedTransform::default();
        for s in stamps_s {
            recorded.push((s * 1e9) as i64, transform([s, 0.0, 0.0], 0.0));
        }
        recorded
    }

    #[test]
    fn only_regular_transforms_have_an_end() {
        assert_eq!(recorded([0.0, 0.5, 1.0, 2.5]).at_or_last(5_000_000_000), None);
        let last = recorded([0.0, 4.0]).at_or_last(5_000_000_000).unwrap();
        assert_eq!(last.translation.x, 4.0);
    }

    /// A transform is silent if it pauses for three of its own periods, and for 2 s at least.
    #[test]
    fn the_gaps_of_a_transform_are_judged_by_its_own_period() {
        for (period_s, pause_s, is_silent) in [
            (0.1, 1.9, false),
            (0.1, 2.1, true),
            (0.9, 2.6, false),
            (0.9, 60.0, true),
            (10.0, 29.0, false),
            (10.0, 31.0, true),
        ] {
            let before = (0..20).map(|k| period_s * f64::from(k));
            let resumed_s = 19.0 * period_s + pause_s;
            let after = (0..20).map(|k| resumed_s + period_s * f64::from(k));
            let sorted = recorded(before.chain(after)).sorted();
            let middle_ns = (1e9 * (resumed_s - pause_s / 2.0)) as i64;
            assert_eq!(sorted.is_in_gap(middle_ns), is_silent, "{period_s} s, {pause_s} s");
            assert!(!sorted.is_in_gap((1.5e9 * period_s) as i64));
            assert!(!sorted.is_in_gap(i64::MAX), "after the last sample there is no value");
        }
        // Two samples do not show a period.
        assert!(!recorded([0.0, 100.0]).sorted().is_in_gap(50_000_000_000));
        assert!(recorded([0.0, 1.0, 61.0]).sorted().is_in_gap(30_000_000_000));
    }
}
