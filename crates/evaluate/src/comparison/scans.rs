//! Which logs and scans two runs have in common.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use dataset::{MapPose, ScanId};
use serde::Serialize;

use super::input::MappedRun;

/// Which runs have a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Presence {
    /// Both runs.
    Both,
    /// Only the first one.
    OnlyA,
    /// Only the second one.
    OnlyB,
}

/// A log of one or both runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedLog {
    /// Name of the log.
    pub log: String,
    /// Which runs have it.
    pub presence: Presence,
    /// Keyframes in A.
    pub n_keyframes_a: usize,
    /// Keyframes in B.
    pub n_keyframes_b: usize,
    /// Keyframes in both, with the same number and stamp.
    pub n_common_keyframes: usize,
    /// Keyframes in both with the same number and another stamp: other scans.
    pub n_other_stamps: usize,
    /// Maps in A that contain a part of the log.
    pub n_maps_a: usize,
    /// Maps in B that contain a part of the log.
    pub n_maps_b: usize,
}

/// Logs of both runs that share a map in one of them only.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedMaps {
    /// Pairs of logs that share a map in A, and none in B.
    pub joined_only_in_a: Vec<[String; 2]>,
    /// Pairs of logs that share a map in B, and none in A.
    pub joined_only_in_b: Vec<[String; 2]>,
}

/// What the other run has in place of a keyframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Counterpart {
    /// The same scan.
    Same,
    /// A scan with the same number and another stamp.
    OtherScan,
    /// The log, without this keyframe.
    NoKeyframe,
    /// The log is missing.
    NoLog,
}

/// The keyframes of two runs.
pub(super) struct Matched<'a> {
    /// By scan, the keyframes of A and of B.
    keyframes: [HashMap<&'a ScanId, &'a MapPose>; 2],
    logs: [BTreeSet<&'a str>; 2],
    /// The keyframes of A.
    all_a: &'a [MapPose],
}

impl<'a> Matched<'a> {
    pub(super) fn new(a: &MappedRun<'a>, b: &MappedRun<'a>) -> Self {
        let by_scan = |run: &MappedRun<'a>| {
            run.keyframes.iter().map(|keyframe| (&keyframe.id, keyframe)).collect()
        };
        let logs = |run: &MappedRun<'a>| {
            let logs = run.keyframes.iter().map(|keyframe| &*keyframe.id.log);
            logs.chain(run.trajectories.keys().map(|log| &**log)).collect()
        };
        Self { keyframes: [by_scan(a), by_scan(b)], logs: [logs(a), logs(b)], all_a: a.keyframes }
    }

    /// The keyframes that are the same scan in both runs, in the order of A.
    pub(super) fn common(&self) -> impl Iterator<Item = (&'a MapPose, &'a MapPose)> {
        self.all_a.iter().filter_map(|a| {
            let b = self.keyframes[1].get(&a.id)?;
            (a.stamp_ns == b.stamp_ns).then_some((a, *b))
        })
    }

    /// What the other run has in place of a keyframe of one of the runs.
    pub(super) fn counterpart(&self, id: &ScanId) -> Counterpart {
        let [a, b] = self.keyframes.each_ref().map(|of| of.get(id));
        match (a, b) {
            (Some(a), Some(b)) if a.stamp_ns == b.stamp_ns => Counterpart::Same,
            (Some(_), Some(_)) => Counterpart::OtherScan,
            _ if self.is_common(&id.log) => Counterpart::NoKeyframe,
            _ => Counterpart::NoLog,
        }
    }

    /// Whether both runs have a log.
    pub(super) fn is_common(&self, log: &str) -> bool {
        self.logs.iter().all(|logs| logs.contains(log))
    }

    /// All logs of both runs, by name.
    pub(super) fn logs(&self) -> Vec<ComparedLog> {
        let mut logs: BTreeMap<&str, ComparedLog> = BTreeMap::new();
        for log in self.logs[0].union(&self.logs[1]) {
            let presence = match self.logs.each_ref().map(|logs| logs.contains(log)) {
                [true, true] => Presence::Both,
                [true, false] => Presence::OnlyA,
                _ => Presence::OnlyB,
            };
            let [n_maps_a, n_maps_b] = [0, 1].map(|run| self.maps(run, log).len());
            let compared = ComparedLog {
                log: (*log).to_owned(),
                presence,
                n_keyframes_a: 0,
                n_keyframes_b: 0,
                n_common_keyframes: 0,
                n_other_stamps: 0,
                n_maps_a,
                n_maps_b,
            };
            logs.insert(log, compared);
        }
        for id in self.keyframes[0].keys() {
            let Some(log) = logs.get_mut(&*id.log) else { continue };
            log.n_keyframes_a += 1;
            match self.counterpart(id) {
                Counterpart::Same => log.n_common_keyframes += 1,
                Counterpart::OtherScan => log.n_other_stamps += 1,
                Counterpart::NoKeyframe | Counterpart::NoLog => {}
            }
        }
        for id in self.keyframes[1].keys() {
            if let Some(log) = logs.get_mut(&*id.log) {
                log.n_keyframes_b += 1;
            }
        }
        logs.into_values().collect()
    }

    /// The maps of a run that contain a part of a log.
    fn maps(&self, run: usize, log: &str) -> BTreeSet<u32> {
        let of_log = self.keyframes[run].values().filter(|keyframe| *keyframe.id.log == *log);
        of_log.map(|keyframe| keyframe.map).collect()
    }

    /// Which logs of both runs share a map in one of them only.
    pub(super) fn joined(&self) -> ComparedMaps {
        let common: Vec<&str> = self.logs[0].intersection(&self.logs[1]).copied().collect();
        let maps = [0, 1].map(|run| {
            common.iter().map(|log| self.maps(run, log)).collect::<Vec<BTreeSet<u32>>>()
        });
        let mut compared = ComparedMaps::default();
        for (k, first) in common.iter().enumerate() {
            for (l, second) in common.iter().enumerate().skip(k + 1) {
                let pair = || [(*first).to_owned(), (*second).to_owned()];
                match maps.each_ref().map(|maps| !maps[k].is_disjoint(&maps[l])) {
                    [true, false] => compared.joined_only_in_a.push(pair()),
                    [false, true] => compared.joined_only_in_b.push(pair()),
                    _ => {}
                }
            }
        }
        compared
    }
}
