//! Summarizes the poses of a topic.

use dataset::{Losses, Pose2, StampedPose, Trajectory};

use crate::pose::segments::{SegmentOptions, segments};
use crate::pose_options::PoseOptions;
use crate::survey::report::PosesSurvey;

/// Summarizes poses in the order of the file. Also returns what `ingest` would leave out.
pub(crate) fn poses_survey(poses: &[StampedPose]) -> (PosesSurvey, Losses) {
    let PoseOptions { max_speed_m_s, .. } = PoseOptions::default();
    let options = SegmentOptions { max_speed_m_s, same_frame: false };
    let segmented = segments(poses.to_vec(), &options, Vec::new());
    let mut remarks: Vec<String> = segmented.notes.iter().map(ToString::to_string).collect();
    if let Some((n_contradictory, n_poses)) = segmented.contradiction() {
        remarks.push(format!(
            "{n_contradictory} of {n_poses} poses are outliers or jump: not the path of one robot"
        ));
    }
    let (trajectory, _) = Trajectory::new(segmented.poses);
    let poses = trajectory.poses();
    let extent = |along: fn(&Pose2) -> f64| {
        let limits = poses
            .iter()
            .map(|p| along(&p.pose))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
                (least.min(value), most.max(value))
            });
        (limits.1 - limits.0).max(0.0)
    };
    let steps = || {
        let pairs = poses.windows(2).map(|pair| (&pair[0], &pair[1]));
        pairs.filter(|(a, b)| a.segment == b.segment)
    };
    let survey = PosesSurvey {
        // From 0, since the sum of nothing is -0.
        path_m: steps().fold(0.0, |path, (a, b)| path + a.pose.distance_m(&b.pose)),
        widest_gap_s: steps()
            .map(|(a, b)| b.stamp_ns.saturating_sub(a.stamp_ns) as f64 * 1e-9)
            .fold(0.0, f64::max),
        extent_m: (extent(|pose| pose.x_m), extent(|pose| pose.y_m)),
        n_segments: poses.last().map_or(0, |last| last.segment + 1),
        remarks,
        trajectory,
    };
    (survey, segmented.losses)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 m/s along x for 100 s, with a step of 40 m to the side half way: two segments of 49 and 50 m.
    #[test]
    fn a_jump_is_described_and_adds_no_path() {
        let pose = |k: i64| {
            let y_m = if k < 50 { 0.0 } else { 40.0 };
            let pose = Pose2 { x_m: k as f64, y_m, heading_rad: 0.0 };
            StampedPose::new(k * 1_000_000_000, pose)
        };
        let poses: Vec<StampedPose> = (0..=100).map(pose).collect();
        let (survey, losses) = poses_survey(&poses);
        assert!(losses.is_empty(), "{losses}");
        assert_eq!((survey.n_segments, survey.path_m), (2, 99.0));
        assert_eq!(survey.extent_m, (100.0, 40.0));
        assert_eq!(survey.remarks.len(), 1, "{:?}", survey.remarks);
        let (regular, _) = poses_survey(&poses[..50]);
        assert_eq!((regular.n_segments, regular.remarks.len()), (1, 0));
        assert_eq!(poses_survey(&[]).0, PosesSurvey::default());
    }
}
