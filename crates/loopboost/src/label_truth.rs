//! Labels that rest on a map, compared with the ground truth.

use std::sync::Arc;

use anyhow::Result;
use dataset::tables::read_poses;
use dataset::{Keyframe, Note, NoteKind, Pair, Trajectory};
use label::Rules;

use crate::labelled::at_truth;
use crate::run::Run;
use crate::stage::Artifact;

/// Compares the labels of pairs with the labels by the ground truth, if the labels rest on a map and the
/// pipeline names the ground truth. The labels do not change.
pub(crate) fn compare_with_truth(
    run: &Run,
    keyframes: &[Keyframe],
    pairs: &[Pair],
) -> Result<Option<Note>> {
    if !run.goal.has(Artifact::Truth) || keyframes.iter().all(|keyframe| keyframe.map.is_none()) {
        return Ok(None);
    }
    let max_gap_ns = (run.config.subsample.max_pose_gap_secs * 1e9) as i64;
    let mut truth: Vec<Option<Keyframe>> = Vec::with_capacity(keyframes.len());
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        let log: &Arc<str> = &of_log[0].id.log;
        let (trajectory, _): (Trajectory, _) = read_poses(&run.path_of_log(Artifact::Truth, log))?;
        truth.extend(of_log.iter().map(|keyframe| at_truth(keyframe, &trajectory, max_gap_ns)));
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
