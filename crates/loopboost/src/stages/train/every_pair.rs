//! Every pair of keyframes of a log, scored by classifiers that saw neither place: how well they
//! find the positives at their natural prevalence.

use anyhow::{Result, anyhow};
use dataset::tables::FeatureTable;
use dataset::{Keyframe, Label, Retrieval};
use label::{Folds, Grouping, label_of};
use rayon::prelude::*;
use train::{FoldError, FoldFit, Learner, Matrix};

use super::{Fitted, Options, folded};

/// The rows of `retrieval.parquet`; none where this is switched off, or only the grouping `pair`,
/// which keeps no scan apart, is asked for.
pub(super) fn retrieval(
    options: &Options<'_>,
    keyframes: &[Keyframe],
    features: &FeatureTable,
    data: &Matrix,
    groupings: &[(Grouping, Folds)],
    fitted: &[Fitted],
) -> Result<Vec<Retrieval>> {
    // The one that a report speaks of first, of those that keep scans apart.
    let strictest = [Grouping::Place, Grouping::Log, Grouping::Scan]
        .into_iter()
        .find_map(|wanted| groupings.iter().find(|(grouping, _)| *grouping == wanted));
    let Some(&(grouping, ref folds)) = strictest.filter(|_| options.evaluate.every_pair) else {
        return Ok(Vec::new());
    };
    let logs = by_log(keyframes);
    let n_pairs: u64 = logs.iter().map(|log| (log.len() * (log.len() - 1) / 2) as u64).sum();
    let stride = n_pairs.div_ceil(options.evaluate.max_pairs).max(1);
    let mut rows = Vec::new();
    for fitted in fitted {
        // k-NN compares a pair with every training pair: too slow for millions.
        if fitted.learner == Learner::Knn {
            continue;
        }
        let fits = Fits::new(options, fitted, data, grouping, folds)?;
        let mut all = Confidences::default();
        for log in &logs {
            let scored =
                confidences(options, keyframes, features, folds, &fits, log, stride as usize);
            let name = &keyframes[log[0]].id.log;
            all.extend(&scored);
            rows.extend(measure(fitted.learner, grouping, Some(&**name), stride, scored));
        }
        if logs.len() > 1 {
            rows.extend(measure(fitted.learner, grouping, None, stride, all));
        }
    }
    Ok(rows)
}

/// Indices of each log's keyframes, in order of the path.
fn by_log(keyframes: &[Keyframe]) -> Vec<Vec<usize>> {
    let mut logs: Vec<Vec<usize>> = Vec::new();
    for (k, keyframe) in keyframes.iter().enumerate() {
        match logs.iter_mut().find(|log| keyframes[log[0]].id.log == keyframe.id.log) {
            Some(log) => log.push(k),
            None => logs.push(vec![k]),
        }
    }
    logs
}

/// A classifier for each two folds; none where what is left to train on lacks a class.
struct Fits {
    n_folds: usize,
    fits: Vec<Option<FoldFit>>,
}

impl Fits {
    fn new(
        options: &Options<'_>,
        fitted: &Fitted,
        data: &Matrix,
        grouping: Grouping,
        folds: &Folds,
    ) -> Result<Self> {
        let known = fitted.fits.iter().find(|(g, _)| *g == grouping).map(|(_, fits)| fits);
        let known = known.ok_or_else(|| anyhow!("no fits of grouping `{}`", grouping.name()))?;
        let n_folds = folds.n_folds;
        let (learner, n_rounds) = (fitted.learner, options.train.rounds_of(fitted.learner));
        let fits = (0..n_folds)
            .flat_map(|a| (0..n_folds).map(move |b| [a, b]))
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|[a, b]| {
                if b < a {
                    return Ok(None); // the same as without b and a
                }
                if let Some(fit) = known.iter().find(|fit| fit.held_out == [a, b]) {
                    return Ok(Some(fit.clone()));
                }
                match train::fit_without(learner, n_rounds, &folded(data, folds), [a, b]) {
                    Ok(fit) => Ok(Some(fit)),
                    Err(FoldError::OneClass { .. }) => Ok(None),
                    Err(error) => Err(error.into()),
                }
            })
            .collect::<Vec<Result<_>>>()
            .into_iter()
            .collect::<Result<Vec<_>>>()?;
        Ok(Self { n_folds: n_folds as usize, fits })
    }

    fn without(&self, a: u32, b: u32) -> Option<&FoldFit> {
        self.fits[a.min(b) as usize * self.n_folds + a.max(b) as usize].as_ref()
    }
}

/// Confidences of pairs, by what the pairs are.
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

    /// Both; in which order does not matter to what is measured.
    fn union(self, other: Self) -> Self {
        let (mut more, less) =
            if self.negative.len() < other.negative.len() { (other, self) } else { (self, other) };
        more.extend(&less);
        more
    }
}

/// Scores the pairs of one log that are more than the recent path apart.
fn confidences(
    options: &Options<'_>,
    keyframes: &[Keyframe],
    features: &FeatureTable,
    folds: &Folds,
    fits: &Fits,
    log: &[usize],
    stride: usize,
) -> Confidences {
    // Less path than a true revisit has would be neither positive nor negative.
    let recent_m = options.evaluate.recent_m.max(options.label.min_travel_gap_m);
    let queries: Vec<usize> = (0..log.len()).step_by(stride).collect();
    queries
        .into_par_iter()
        .fold(
            || (Confidences::default(), vec![0.0; features.names.len()]),
            |(mut scored, mut difference), place| {
                let query = &keyframes[log[place]];
                for &other in &log[..place] {
                    let reference = &keyframes[other];
                    if (query.travel_m - reference.travel_m).abs() < recent_m {
                        continue;
                    }
                    let of = |k: usize| folds.keyframe_folds[k];
                    featurize::difference(
                        features.row(log[place]),
                        features.row(other),
                        &mut difference,
                    );
                    let fit = fits.without(of(log[place]), of(other));
                    let Some(confidence) = fit.and_then(|fit| fit.confidence(&difference)) else {
                        scored.n_unscored += 1;
                        continue;
                    };
                    match label_of(options.label, query, reference) {
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

/// Both readings of the pairs that are neither positive nor negative.
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
