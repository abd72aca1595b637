//! What of the scans themselves the report draws: a few pairs, and the ground they saw.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{Label, Pose2, Scan};

use crate::figures::Ground;
use crate::{Evaluation, Input};

/// Returns drawn of one scan, about; the rest would be dots upon dots.
const MAX_RETURNS: usize = 360;
/// Pairs drawn of each kind.
const PAIRS_OF_A_KIND: usize = 3;

/// A kind of drawn pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    /// Rightly called the same place, most confidently.
    Match,
    /// Rightly called another place.
    NonMatch,
    /// Called the same place, but another.
    FalseAlarm,
    /// Called another place, but the same.
    Missed,
}

/// A pair to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DrawnPair {
    pub(crate) kind: Kind,
    /// Index of the pair.
    pub(crate) pair: usize,
    pub(crate) confidence: f64,
}

/// Takes scans, one after the other, and keeps what is drawn of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Sketches {
    /// Learner and grouping whose confidences chose the pairs.
    pub(crate) by: Option<(String, String)>,
    pub(crate) pairs: Vec<DrawnPair>,
    wanted: BTreeSet<usize>,
    pub(crate) returns: BTreeMap<usize, Vec<[f64; 2]>>,
    pub(crate) grounds: BTreeMap<String, Ground>,
}

impl Sketches {
    /// Chooses the pairs: of each kind the most confident, no scan twice in a kind.
    pub fn new(input: &Input<'_>, evaluation: &Evaluation) -> Self {
        let best = evaluation.best_boosted(input);
        let scores = best.and_then(|best| {
            input.scores.iter().find(|s| s.learner == best.learner && s.grouping == best.grouping)
        });
        let confidences: Vec<f64> =
            scores.map(|s| s.after(s.n_rounds).collect()).unwrap_or_default();
        let pairs: Vec<DrawnPair> = [Kind::Match, Kind::NonMatch, Kind::FalseAlarm, Kind::Missed]
            .into_iter()
            .flat_map(|kind| most_confident(input, &confidences, kind))
            .collect();
        let ends = |p: &DrawnPair| [input.pairs[p.pair].query, input.pairs[p.pair].reference];
        let mut poses: BTreeMap<String, Vec<Pose2>> = BTreeMap::new();
        for keyframe in input.keyframes {
            poses.entry(keyframe.site.to_string()).or_default().push(keyframe.pose);
        }
        Self {
            by: best.map(|best| (best.learner.clone(), best.grouping.clone())),
            wanted: pairs.iter().flat_map(ends).collect(),
            pairs,
            returns: BTreeMap::new(),
            grounds: poses.into_iter().map(|(site, poses)| (site, Ground::new(&poses))).collect(),
        }
    }

    /// Takes the scan of a keyframe.
    pub fn add(&mut self, input: &Input<'_>, keyframe: usize, scan: &Scan) {
        let k = &input.keyframes[keyframe];
        if let Some(ground) = self.grounds.get_mut(&*k.site) {
            ground.add(&k.pose, scan);
        }
        if self.wanted.contains(&keyframe) {
            let every = scan.len().div_ceil(MAX_RETURNS).max(1);
            self.returns.insert(keyframe, scan.points().step_by(every).collect());
        }
    }
}

fn most_confident(input: &Input<'_>, confidences: &[f64], kind: Kind) -> Vec<DrawnPair> {
    let (label, sign) = match kind {
        Kind::Match => (Label::Positive, 1.0),
        Kind::NonMatch => (Label::Negative, -1.0),
        Kind::FalseAlarm => (Label::Negative, 1.0),
        Kind::Missed => (Label::Positive, -1.0),
    };
    let mut of_kind: Vec<(f64, usize)> = confidences
        .iter()
        .enumerate()
        .map(|(pair, confidence)| (sign * confidence, pair))
        .filter(|&(sureness, pair)| 0.0 <= sureness && input.pairs[pair].label == label)
        .collect();
    of_kind.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut drawn: Vec<DrawnPair> = Vec::new();
    let mut seen = BTreeSet::new();
    for (sureness, pair) in of_kind {
        let ends = [input.pairs[pair].query, input.pairs[pair].reference];
        if drawn.len() < PAIRS_OF_A_KIND && ends.iter().all(|end| !seen.contains(end)) {
            seen.extend(ends);
            drawn.push(DrawnPair { kind, pair, confidence: sign * sureness });
        }
    }
    drawn
}
