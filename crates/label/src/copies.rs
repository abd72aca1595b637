//! Logs with the same scans: copies of a drive that differ in their bytes, for example because one
//! of them was compressed again or is cut off.

use std::collections::BTreeMap;

use dataset::{Keyframe, Note, NoteKind, Subject};

/// Least share of the keyframes of the shorter log that the longer one must also have. Two drives
/// never have the same stamps and, to the last bit, the same poses, except where both stand still
/// at the start.
const SHARED: f64 = 0.5;

/// A warning for each two logs with the same scans at the same poses.
pub(crate) fn notes(keyframes: &[Keyframe]) -> Vec<Note> {
    type Moment = (i64, [u64; 3]);
    let mut n_of_log: BTreeMap<&str, u64> = BTreeMap::new();
    let mut by_moment: BTreeMap<Moment, Vec<&str>> = BTreeMap::new();
    for Keyframe { id, stamp_ns, pose, .. } in keyframes {
        *n_of_log.entry(&id.log).or_default() += 1;
        let pose = [pose.x_m, pose.y_m, pose.heading_rad].map(f64::to_bits);
        by_moment.entry((*stamp_ns, pose)).or_default().push(&id.log);
    }
    let mut n_shared: BTreeMap<[&str; 2], u64> = BTreeMap::new();
    for mut logs in by_moment.into_values().filter(|logs| 1 < logs.len()) {
        logs.sort_unstable();
        logs.dedup();
        for (k, &first) in logs.iter().enumerate() {
            for &second in &logs[k + 1..] {
                *n_shared.entry([first, second]).or_default() += 1;
            }
        }
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
