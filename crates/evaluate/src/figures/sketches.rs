//! The parts of the scans that figures show: example pairs and the ground of each site.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{Label, Pose2, Scan};

use super::closure_sketches::ClosureSketches;
use super::ground::Ground;
use crate::{Evaluation, Input};

/// Approximate number of returns drawn per scan. More would overlap.
const MAX_RETURNS: usize = 360;
/// Example pairs of each kind.
const PAIRS_PER_KIND: usize = 3;

/// The outcome of an example pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum PairKind {
    /// A match classified as a match.
    CorrectMatch,
    /// A non-match classified as a non-match.
    CorrectNonMatch,
    /// A non-match classified as a match.
    FalseAlarm,
    /// A match classified as a non-match.
    MissedMatch,
}

impl PairKind {
    /// The first part of the figure's id.
    pub(crate) fn id(self) -> &'static str {
        match self {
            Self::CorrectMatch => "match",
            Self::CorrectNonMatch => "non-match",
            Self::FalseAlarm => "false-alarm",
            Self::MissedMatch => "missed",
        }
    }

    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::CorrectMatch => "correct match",
            Self::CorrectNonMatch => "correct non-match",
            Self::FalseAlarm => "false alarm",
            Self::MissedMatch => "missed match",
        }
    }
}

/// A pair to draw as an example.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ExamplePair {
    pub(crate) kind: PairKind,
    /// Index of the pair.
    pub(crate) pair: usize,
    pub(crate) confidence: f64,
}

/// Collects what the figures show of the scans, one scan at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct Sketches {
    /// Learner and grouping whose confidences selected the pairs.
    pub(crate) selected_by: Option<(String, String)>,
    pub(crate) pairs: Vec<ExamplePair>,
    /// Keyframes of the pairs.
    wanted: BTreeSet<usize>,
    /// Returns to draw, by keyframe.
    pub(crate) returns: BTreeMap<usize, Vec<[f64; 2]>>,
    /// By site.
    pub(crate) grounds: BTreeMap<String, Ground>,
    pub(crate) closures: ClosureSketches,
}

impl Sketches {
    /// Selects the most confident pairs of each kind. A scan appears at most once per kind.
    pub fn new(input: &Input<'_>, evaluation: &Evaluation) -> Self {
        let best = evaluation.best_boosted(input);
        let scores = best.and_then(|best| {
            input.scores.iter().find(|s| s.learner == best.learner && s.grouping == best.grouping)
        });
        let confidences: Vec<f64> =
            scores.map(|s| s.after(s.n_rounds).collect()).unwrap_or_default();
        let pairs: Vec<ExamplePair> = [
            PairKind::CorrectMatch,
            PairKind::CorrectNonMatch,
            PairKind::FalseAlarm,
            PairKind::MissedMatch,
        ]
        .into_iter()
        .flat_map(|kind| most_confident(input, &confidences, kind))
        .collect();
        let ends = |p: &ExamplePair| [input.pairs[p.pair].query, input.pairs[p.pair].reference];
        let mut poses: BTreeMap<String, Vec<Pose2>> = BTreeMap::new();
        for keyframe in input.keyframes {
            poses.entry(keyframe.site.to_string()).or_default().push(keyframe.pose);
        }
        Self {
            selected_by: best.map(|best| (best.learner.clone(), best.grouping.clone())),
            wanted: pairs.iter().flat_map(ends).collect(),
            pairs,
            returns: BTreeMap::new(),
            grounds: poses.into_iter().map(|(site, poses)| (site, Ground::new(&poses))).collect(),
            closures: ClosureSketches::new(input.detection),
        }
    }

    /// Adds the scan of a keyframe.
    pub fn add(&mut self, input: &Input<'_>, keyframe: usize, scan: &Scan) {
        let k = &input.keyframes[keyframe];
        if let Some(ground) = self.grounds.get_mut(&*k.site) {
            ground.add(&k.pose, scan);
        }
        self.closures.add(input.detection, &k.id, scan);
        if self.wanted.contains(&keyframe) {
            let every = scan.len().div_ceil(MAX_RETURNS).max(1);
            self.returns.insert(keyframe, scan.points().step_by(every).collect());
        }
    }
}

fn most_confident(input: &Input<'_>, confidences: &[f64], kind: PairKind) -> Vec<ExamplePair> {
    let (label, sign) = match kind {
        PairKind::CorrectMatch => (Label::Positive, 1.0),
        PairKind::CorrectNonMatch => (Label::Negative, -1.0),
        PairKind::FalseAlarm => (Label::Negative, 1.0),
        PairKind::MissedMatch => (Label::Positive, -1.0),
    };
    let mut of_kind: Vec<(f64, usize)> = confidences
        .iter()
        .enumerate()
        .map(|(pair, confidence)| (sign * confidence, pair))
        .filter(|&(certainty, pair)| 0.0 <= certainty && input.pairs[pair].label == label)
        .collect();
    of_kind.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut examples: Vec<ExamplePair> = Vec::new();
    let mut seen = BTreeSet::new();
    for (certainty, pair) in of_kind {
        let ends = [input.pairs[pair].query, input.pairs[pair].reference];
        if examples.len() < PAIRS_PER_KIND && ends.iter().all(|end| !seen.contains(end)) {
            seen.extend(ends);
            examples.push(ExamplePair { kind, pair, confidence: sign * certainty });
        }
    }
    examples
}
