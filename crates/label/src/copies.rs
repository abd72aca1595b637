//! Logs with the same scans: copies of a drive that differ in their bytes, for example because one
//! of them was compressed again or is cut off.

use std::collections::BTreeMap;

use dataset::{Keyframe, Note, NoteKind, Subject};
use rayon::prelude::*;

/// Least share of the keyframes of the shorter log that the longer one must also have. Two drives
/// never have the same stamps and, to the last bit, the same poses, except where both stand still
/// at the start.
const SHARED: f64 = 0.5;

/// A warning for each two logs with the same scans at the same poses.
pub(crate) fn notes(keyframes: &[Keyframe]) -> Vec<Note> {
    let moment = |k: &u32| {
        let Keyframe { stamp_ns, pose, .. } = &keyframes[*k as usize];
        (*stamp_ns, [pose.x_m, pose.y_m, pose.heading_rad].map(f64::to_bits))
    };
    let log_of = |k: &u32| &*keyframes[*k as usize].id.log;
    let mut by_moment: Vec<u32> = (0..keyframes.len() as u32).collect();
    by_moment.par_sort_unstable_by_key(moment);
    let mut n_shared: BTreeMap<[&str; 2], u64> = BTreeMap::new();
    let at_once = by_moment.chunk_by(|a, b| moment(a) == moment(b));
    for keyframes in at_once.filter(|keyframes| 1 < keyframes.len()) {
        let mut logs: Vec<&str> = keyframes.iter().map(log_of).collect();
        logs.sort_unstable();
        logs.dedup();
        for (k, &first) in logs.iter().enumerate() {
            for &second in &logs[k + 1..] {
                *n_shared.entry([first, second]).or_default() += 1;
            }
        }
    }
    let mut n_of_log: BTreeMap<&str, u64> = BTreeMap::new();
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        *n_of_log.entry(&of_log[0].id.log).or_default() += of_log.len() as u64;
    }
    let note = |([first, second], n_keyframes): ([&str; 2], u64)| {
        let shorter = n_of_log[first].min(n_of_log[second]);
        let kind = NoteKind::SameScansInTwoLogs {
            other: first.to_owned(),
            n_keyframes,
            share: n_keyframes as f64 / shorter as f64,
        };
        (SHARED * shorter as f64 <= n_keyframes as f64)
            .then(|| Note::new(kind, Subject::log(second)))
    };
    n_shared.into_iter().filter_map(note).collect()
}
