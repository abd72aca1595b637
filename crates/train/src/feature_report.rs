//! What each feature is worth: by itself, and to the learners.

use dataset::Label;

use crate::{Matrix, Round};

/// The evidence for one feature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureEvidence {
    /// How often a positive pair differs less in it than a negative one, ties counting half: the
    /// area under the ROC curve of the feature alone, 0.5 for a feature that tells nothing.
    pub auc: f64,
    /// Splits that look at it, over all rounds given.
    pub n_chosen: usize,
    /// [`n_chosen`](Self::n_chosen) as a share of all splits; 0 where there is none.
    pub share_chosen: f64,
}

/// The evidence for each feature, `(n_features,)`, from labelled pairs and the rounds of one or more
/// fits to them.
pub fn feature_report<'a>(
    data: &Matrix,
    rounds: impl IntoIterator<Item = &'a Round>,
) -> Vec<FeatureEvidence> {
    let mut chosen = vec![0usize; data.columns().len()];
    for split in rounds.into_iter().flat_map(|round| round.weak.splits()) {
        chosen[split.feature] += 1;
    }
    let all = chosen.iter().sum::<usize>().max(1) as f64;
    let of = |(rows, (column, n_chosen)): (Vec<u32>, (&Vec<f64>, usize))| FeatureEvidence {
        auc: auc(column, &rows, data.labels()),
        n_chosen,
        share_chosen: n_chosen as f64 / all,
    };
    data.sorted_rows().into_iter().zip(data.columns().iter().zip(chosen)).map(of).collect()
}

/// (sum over negatives of the positives below + half of the positives level) / (Np Nn), from rows in
/// ascending order of the column (Mann and Whitney 1947). NaN where a class has no pair.
fn auc(column: &[f64], rows: &[u32], labels: &[Label]) -> f64 {
    let (mut positive, mut negative, mut doubled) = (0u64, 0u64, 0u64);
    let is_level = |a: &u32, b: &u32| column[*a as usize].total_cmp(&column[*b as usize]).is_eq();
    for level in rows.chunk_by(is_level) {
        let is_positive = |row: &&u32| labels[**row as usize] == Label::Positive;
        let p = level.iter().filter(is_positive).count() as u64;
        let n = level.len() as u64 - p;
        doubled += n * (2 * positive + p);
        positive += p;
        negative += n;
    }
    doubled as f64 / (2.0 * positive as f64 * negative as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    /// Positives at 1, 3 and 4, negatives at 2 and 4: of six pairs of pairs, 1 < 2, 1 < 4 and 3 < 4
    /// hold, 4 = 4 counts half: 3.5 / 6. The second feature is the first upside down.
    #[test]
    fn an_area_by_hand_and_the_splits_counted() {
        let x = vec![1.0, 2.0, 3.0, 4.0, 4.0];
        let upside_down = x.iter().map(|x| -x).collect();
        let labels = vec![Positive, Negative, Positive, Positive, Negative];
        let data = Matrix::new(vec![x, upside_down, vec![0.0; 5]], labels);
        let weak = |feature| model::WeakLearner::Line { feature, slope: 1.0, intercept: 0.0 };
        let rounds = [0, 2, 0, 0].map(|f| Round { weak: weak(f), weighted_error: 0.5 });
        let report = feature_report(&data, &rounds);
        assert_eq!(report[0], FeatureEvidence { auc: 3.5 / 6.0, n_chosen: 3, share_chosen: 0.75 });
        assert!((report[1].auc - 2.5 / 6.0).abs() < 1e-15);
        assert_eq!(report[1].n_chosen, 0);
        assert_eq!(report[2], FeatureEvidence { auc: 0.5, n_chosen: 1, share_chosen: 0.25 });
    }
}
