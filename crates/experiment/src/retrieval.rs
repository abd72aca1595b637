//! Retrieval at natural prevalence: all pairs of keyframes of a log are scored by classifiers that
//! held out the folds of both keyframes.

use std::collections::BTreeMap;

use dataset::{Keyframe, Label, Note, NoteKind, Retrieval};
use label::{Folds, Grouping, Rules};
use rayon::prelude::*;
use train::{FoldError, FoldFit, Learner};

use crate::cross_validation::folded;
use crate::{CrossValidation, Data, ExperimentError, GroupingResult, LearnerResult, Setup};

/// How well each learner finds the positives among all pairs of each log, and of all logs together.
///
/// Empty if retrieval is switched off, or if no grouping but `pair` was evaluated: that grouping
/// holds out no scans.
pub fn retrieval(
    setup: &Setup<'_>,
    data: &Data<'_>,
    validation: &CrossValidation,
) -> Result<Vec<Retrieval>, ExperimentError> {
    let Some(result) = strictest(validation).filter(|_| setup.options.retrieval) else {
        return Ok(Vec::new());
    };
    let rules = Rules::new(setup.label, data.keyframes);
    let logs = by_log(data.keyframes);
    let n_pairs = n_pairs(&logs);
    let stride = n_pairs.div_ceil(setup.options.max_pairs).max(1);
    let mut rows = Vec::new();
    for of_learner in &result.learners {
        let learner = of_learner.learner;
        // k-NN compares a pair with every training pair, which is too slow for millions of pairs.
        if learner == Learner::Knn {
            continue;
        }
        let fits = Fits::new(setup, data, result, of_learner)?;
        let mut all = Confidences::default();
        for log in &logs {
            let scored = score_log(setup, data, &rules, &result.folds, &fits, log, stride as usize);
            let name = &data.keyframes[log[0]].id.log;
            all.extend(&scored);
            rows.extend(measure(learner, result.grouping, Some(&**name), stride, scored));
        }
        if logs.len() > 1 {
            rows.extend(measure(learner, result.grouping, None, stride, all));
        }
    }
    Ok(rows)
}

/// Least number of matches for a useful recall. The 95 % interval of a share that is observed on n
/// independent matches is up to 1/sqrt(n) to each side: 10 % for 100.
const MIN_MATCHES: u64 = 100;

/// A warning if the limit on the number of pairs leaves too few matches.
pub fn few_matches(data: &Data<'_>, rows: &[Retrieval]) -> Option<Note> {
    let over_all = rows.iter().find(|row| row.log.is_none()).or(rows.first())?;
    let (n_matches, query_stride) = (over_all.n_positive, over_all.query_stride);
    (1 < query_stride && n_matches < MIN_MATCHES).then(|| {
        let n_pairs = n_pairs(&by_log(data.keyframes));
        NoteKind::FewMatchesScored { n_matches, query_stride, n_pairs }.into()
    })
}

/// Number of pairs within logs.
fn n_pairs(logs: &[Vec<usize>]) -> u64 {
    logs.iter().map(|log| (log.len() * (log.len() - 1) / 2) as u64).sum()
}

/// The grouping that the report puts first, of those that hold out scans.
pub(crate) fn strictest(validation: &CrossValidation) -> Option<&GroupingResult> {
    let find = |wanted| validation.groupings.iter().find(|result| result.grouping == wanted);
    [Grouping::Place, Grouping::Log, Grouping::Scan].into_iter().find_map(find)
}

/// Indices of the keyframes of each log, in order along the path.
fn by_log(keyframes: &[Keyframe]) -> Vec<Vec<usize>> {
    let mut logs: Vec<Vec<usize>> = Vec::new();
    let mut numbers: BTreeMap<&str, usize> = BTreeMap::new();
    for (k, keyframe) in keyframes.iter().enumerate() {
        let number = *numbers.entry(&keyframe.id.log).or_insert(logs.len());
        if number == logs.len() {
            logs.push(Vec::new());
        }
        logs[number].push(k);
    }
    logs
}

/// One fit for each two folds; `None` if the remaining pairs lack a class.
pub(crate) struct Fits {
    n_folds: usize,
    fits: Vec<Option<FoldFit>>,
}

impl Fits {
    /// Takes the fits of the cross-validation, and fits those that no labelled pair needed.
    pub(crate) fn new(
        setup: &Setup<'_>,
        data: &Data<'_>,
        result: &GroupingResult,
        of_learner: &LearnerResult,
    ) -> Result<Self, ExperimentError> {
        let learner = of_learner.learner;
        let n_rounds = setup.train.rounds_of(learner);
        let folded = folded(data.differences, &result.folds);
        let n_folds = result.folds.n_folds;
        let fit = |[a, b]: [u32; 2]| {
            if b < a {
                return Ok(None); // `holding_out` looks up ascending folds only
            }
            if let Some(fit) = of_learner.fits.iter().find(|fit| fit.held_out == [a, b]) {
                return Ok(Some(fit.clone()));
            }
            match train::fit_without(learner, n_rounds, &folded, [a, b]) {
                Ok(fit) => Ok(Some(fit)),
                Err(FoldError::OneClass { .. }) => Ok(None),
                Err(source) => Err(ExperimentError::Fold { grouping: result.grouping, source }),
            }
        };
        let fits = (0..n_folds)
            .flat_map(|a| (0..n_folds).map(move |b| [a, b]))
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(fit)
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self { n_folds: n_folds as usize, fits })
    }

    pub(crate) fn holding_out(&self, a: u32, b: u32) -> Option<&FoldFit> {
        self.fits[a.min(b) as usize * self.n_folds + a.max(b) as usize].as_ref()
    }
}

/// The confidences of pairs, by their label.
#[derive(Default)]
struct Confidences {
    positive: Vec<f64>,
    negative: Vec<f64>,
    ambiguous: Vec<f64>,
    n_unscored: u64,
}

impl Confidences {
    fn extend(&mut self, other: &Self) {
        self.positive.extend(&other.positive);
        self.negative.extend(&other.negative);
        self.ambiguous.extend(&other.ambiguous);
        self.n_unscored += other.n_unscored;
    }

    /// The union of both. The order does not matter: the measures sort the confidences.
    fn union(self, other: Self) -> Self {
        let (mut more, less) =
            if self.negative.len() < other.negative.len() { (other, self) } else { (self, other) };
        more.extend(&less);
        more
    }
}

/// Scores the pairs of one log that are at least the minimum separation apart along the path. It is
/// not known whether pairs between two coordinate frames match, so they are left out. Every
/// `stride`-th keyframe is a query and is paired with all keyframes before it.
fn score_log(
    setup: &Setup<'_>,
    data: &Data<'_>,
    rules: &Rules<'_>,
    folds: &Folds,
    fits: &Fits,
    log: &[usize],
    stride: usize,
) -> Confidences {
    // A pair with less path than `min_travel_gap_m` between its scans has no label.
    let min_separation_m = setup.options.min_separation_m.max(setup.label.min_travel_gap_m);
    let queries: Vec<usize> = (0..log.len()).step_by(stride).collect();
    queries
        .into_par_iter()
        .fold(
            || (Confidences::default(), vec![0.0; data.features.names.len()]),
            |(mut scored, mut difference), place| {
                let query = log[place];
                for &reference in &log[..place] {
                    let [a, b] = [query, reference].map(|k| &data.keyframes[k]);
                    let is_recent = (a.travel_m - b.travel_m).abs() < min_separation_m;
                    if is_recent || !rules.shares_frame(query, reference) {
                        continue;
                    }
                    let [row_a, row_b] = [query, reference].map(|k| data.features.row(k));
                    featurize::difference(row_a, row_b, &mut difference);
                    let [fold_a, fold_b] = [query, reference].map(|k| folds.keyframe_folds[k]);
                    let fit = fits.holding_out(fold_a, fold_b);
                    let Some(confidence) = fit.and_then(|fit| fit.confidence(&difference)) else {
                        scored.n_unscored += 1;
                        continue;
                    };
                    match rules.label_of(query, reference) {
                        Some(Label::Positive) => scored.positive.push(confidence),
                        Some(Label::Negative) => scored.negative.push(confidence),
                        None => scored.ambiguous.push(confidence),
                    }
                }
                (scored, difference)
            },
        )
        .map(|(scored, _)| scored)
        .reduce(Confidences::default, Confidences::union)
}

/// The measures with ambiguous pairs left out, and with ambiguous pairs as negatives.
fn measure(
    learner: Learner,
    grouping: Grouping,
    log: Option<&str>,
    query_stride: u64,
    scored: Confidences,
) -> [Retrieval; 2] {
    let Confidences { mut positive, mut negative, ambiguous, n_unscored } = scored;
    let n_ambiguous = ambiguous.len() as u64;
    let mut row = |ambiguous_as_negative: bool, negative: &mut [f64]| {
        let ranked = evaluate::rank(&mut positive, negative);
        let measures = ranked.measures;
        Retrieval {
            learner: learner.name().to_owned(),
            grouping: grouping.name().to_owned(),
            log: log.map(str::to_owned),
            ambiguous_as_negative,
            n_positive: positive.len() as u64,
            n_negative: negative.len() as u64,
            n_ambiguous: if ambiguous_as_negative { 0 } else { n_ambiguous },
            n_unscored,
            query_stride,
            average_precision: measures.map(|m| m.average_precision),
            recall_at_full_precision: measures.map(|m| m.recall_at_full_precision),
            detection_at_1_percent: measures.map(|m| m.detection_at_1_percent),
            max_f1: measures.map(|m| m.max_f1),
            curve: ranked.curve,
        }
    };
    let without = row(false, &mut negative);
    negative.extend(ambiguous);
    let with = row(true, &mut negative);
    [without, with]
}
