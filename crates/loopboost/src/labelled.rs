//! The keyframes that pairs are made of, with the poses that they are labelled by.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use anyhow::Result;
use dataset::tables::{FeatureTable, read_poses};
use dataset::{Keyframe, Note, NoteKind, ScanId, Subject, Trajectory};

use crate::partitions;
use crate::run::Run;
use crate::stage::Artifact;

/// The keyframes that pairs are made of, and remarks about them.
///
/// If the pipeline names the ground truth, pairs are labelled by it: the poses of `ingest.pose` may
/// drift. Keyframes without a true pose are left out. Logs in the map of a finished run are labelled by the
/// map, and the ground truth is only compared with their labels.
pub(crate) fn labelled_keyframes(run: &Run) -> Result<(Vec<Keyframe>, Vec<Note>)> {
    let keyframes = partitions::keyframes(run)?;
    if !run.goal.has(Artifact::Truth) {
        return Ok((keyframes, Vec::new()));
    }
    let max_gap_ns = (run.config.subsample.max_pose_gap_secs * 1e9) as i64;
    let (mut labelled, mut notes) = (Vec::new(), Vec::new());
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        let log: &Arc<str> = &of_log[0].id.log;
        if of_log[0].map.is_some() {
            labelled.extend_from_slice(of_log);
            continue;
        }
        let (truth, _) = read_poses(&run.path_of_log(Artifact::Truth, log))?;
        let before = labelled.len();
        labelled
            .extend(of_log.iter().filter_map(|keyframe| at_truth(keyframe, &truth, max_gap_ns)));
        let (n_all, n_known) = (of_log.len() as u64, (labelled.len() - before) as u64);
        if n_known < n_all {
            let kind = NoteKind::KeyframesWithoutTruth { n_keyframes: n_all - n_known, n_all };
            notes.push(Note::new(kind, Subject::log(&**log)));
        }
    }
    Ok((labelled, notes))
}

/// The keyframe with its true pose, if that is known.
fn at_truth(keyframe: &Keyframe, truth: &Trajectory, max_gap_ns: i64) -> Option<Keyframe> {
    let known = truth.stamped_pose_at(keyframe.stamp_ns, max_gap_ns).ok()?;
    Some(Keyframe {
        pose: known.pose,
        covariance: known.covariance,
        z_m: known.z_m,
        segment: known.segment,
        frame: known.frame,
        map: None,
        ..keyframe.clone()
    })
}

/// The rows of these keyframes, which have the same order.
pub(crate) fn features_of(table: FeatureTable, keyframes: &[Keyframe]) -> FeatureTable {
    if table.ids.len() == keyframes.len() {
        return table;
    }
    let kept: HashSet<&ScanId> = keyframes.iter().map(|keyframe| &keyframe.id).collect();
    let rows: BTreeMap<usize, &ScanId> =
        (0..).zip(&table.ids).filter(|(_, id)| kept.contains(id)).collect();
    FeatureTable {
        names: table.names.clone(),
        values: rows.keys().flat_map(|&row| table.row(row)).copied().collect(),
        ids: rows.values().map(|&id| id.clone()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use dataset::{Pose2, StampedPose};

    use super::*;

    fn keyframe(scan: u32) -> Keyframe {
        Keyframe {
            id: ScanId { log: "monday".into(), scan },
            site: "campus".into(),
            stamp_ns: i64::from(scan) * 100,
            pose: Pose2::default(),
            covariance: Some([1.0; 6]),
            z_m: None,
            segment: 0,
            frame: 0,
            map: None,
            travel_m: f64::from(scan),
            coverage_deg: 360.0,
        }
    }

    /// True poses at 0, 100, 300: the keyframe at 50 is half way between two, the one at 200 is in a gap
    /// of 200, and the one at 400 is after the last.
    #[test]
    fn a_keyframe_has_its_true_pose_or_is_left_out() {
        let at =
            |stamp_ns, x_m| StampedPose::new(stamp_ns, Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 });
        let (truth, _) = Trajectory::new(vec![at(0, 0.0), at(100, 4.0), at(300, 8.0)]);
        let with = |stamp_ns| {
            let keyframe = Keyframe { stamp_ns, ..keyframe(1) };
            at_truth(&keyframe, &truth, 150).map(|k| (k.pose.x_m, k.covariance, k.travel_m))
        };
        assert_eq!(with(50), Some((2.0, None, 1.0)));
        assert_eq!((with(200), with(400)), (None, None));
    }

    #[test]
    fn features_are_those_of_the_keyframes_that_are_left() {
        let all: Vec<Keyframe> = (0..3).map(keyframe).collect();
        let table = FeatureTable {
            names: vec!["a".to_owned(), "b".to_owned()],
            ids: all.iter().map(|k| k.id.clone()).collect(),
            values: vec![0.0, 0.5, 1.0, 1.5, 2.0, 2.5],
        };
        assert_eq!(features_of(table.clone(), &all), table);
        let left = features_of(table, &[all[0].clone(), all[2].clone()]);
        assert_eq!(left.values, [0.0, 0.5, 2.0, 2.5]);
        assert_eq!(left.ids, [all[0].id.clone(), all[2].id.clone()]);
    }
}
