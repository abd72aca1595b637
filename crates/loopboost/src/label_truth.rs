//! Labels that rest on a map, compared with the ground truth.

use std::collections::BTreeMap;

use anyhow::Result;
use dataset::tables::read_poses;
use dataset::{Keyframe, Note, NoteKind, Pair, StampedPose, Trajectory};
use evaluate::detection::{MAX_INTERPOLATION_NS, ScanPoses, Truth};
use label::Rules;

use crate::run::Run;
use crate::stage::Artifact;

/// Compares the labels of pairs with the labels by the ground truth, if the labels rest on a map and the
/// pipeline names the ground truth. The labels do not change. The true pose of a scan is that of the evaluation of
/// closures: measured, or carried over at most 4 s along the map.
pub(crate) fn compare_with_truth(
    run: &Run,
    keyframes: &[Keyframe],
    pairs: &[Pair],
) -> Result<Option<Note>> {
    if !run.goal.has(Artifact::Truth) || keyframes.iter().all(|keyframe| keyframe.map.is_none()) {
        return Ok(None);
    }
    let mut truth: Vec<Option<Keyframe>> = Vec::with_capacity(keyframes.len());
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        let log = &*of_log[0].id.log;
        let (measured, _) = read_poses(&run.path_of_log(Artifact::Truth, log))?;
        let (optimized, _) = read_poses(&run.poses(log))?;
        let of_maps = truth_of_maps(&measured, &optimized);
        truth.extend(of_log.iter().map(|keyframe| {
            let pose = of_maps.get(&keyframe.map?)?.at(keyframe.stamp_ns)?.pose;
            let z_m = measured.stamped_pose_at(keyframe.stamp_ns, MAX_INTERPOLATION_NS);
            let z_m = z_m.ok().and_then(|stamped| stamped.z_m);
            Some(Keyframe { pose, covariance: None, z_m, map: None, frame: 0, ..keyframe.clone() })
        }));
    }
    let known: Vec<Keyframe> = truth.iter().flatten().cloned().collect();
    let mut n_known = 0;
    let number = |is_known: bool| {
        n_known += usize::from(is_known);
        is_known.then(|| n_known - 1)
    };
    let numbers: Vec<Option<usize>> = truth.iter().map(Option::is_some).map(number).collect();
    let rules = Rules::new(&run.config.label, &known);
    let (mut n_pairs, mut n_without_truth, mut n_wrong, mut n_opposite) = (0, 0, 0, 0);
    for pair in pairs {
        let ends = numbers[pair.query].zip(numbers[pair.reference]);
        match ends.filter(|&(query, reference)| rules.shares_frame(query, reference)) {
            None => n_without_truth += 1,
            Some((query, reference)) => {
                let label = rules.label_of(query, reference);
                n_pairs += 1;
                n_wrong += u64::from(label != Some(pair.label));
                n_opposite += u64::from(label.is_some_and(|label| label != pair.label));
            }
        }
    }
    let kind = NoteKind::LabelsCompared { n_pairs, n_without_truth, n_wrong, n_opposite };
    Ok(Some(kind.into()))
}

/// The ground truth of a log for each of its maps: between the true poses, it is carried along the map.
fn truth_of_maps(measured: &Trajectory, optimized: &Trajectory) -> BTreeMap<u32, Truth> {
    let mut scans_of: BTreeMap<u32, Vec<ScanPoses>> = BTreeMap::new();
    for StampedPose { stamp_ns, pose, frame, .. } in optimized.poses() {
        scans_of.entry(*frame).or_default().push(ScanPoses {
            stamp_ns: *stamp_ns,
            odometry: *pose,
            scan_matched: None,
            optimized: *pose,
        });
    }
    scans_of.into_iter().map(|(map, scans)| (map, Truth::new(measured, &scans))).collect()
}
