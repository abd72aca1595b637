//! How useful each feature is.

use dataset::{BoostingRound, FeatureUsefulness, Label};
use train::Matrix;

use crate::Data;

/// For each feature: how well it ranks the pairs on its own, how stable it is, and how often the
/// models chose it.
///
/// `stability` has one value per feature, `(n_features,)`; `rounds` are those of
/// [`boosting_rounds`](crate::boosting_rounds), of which only the fits on all pairs count.
pub fn feature_usefulness(
    data: &Data<'_>,
    stability: &[f64],
    rounds: &[BoostingRound],
) -> Vec<FeatureUsefulness> {
    let chosen = |name: &String| {
        rounds.iter().filter(|r| r.held_out.is_none() && r.feature == *name).count() as u64
    };
    let aucs = feature_auc(data.differences);
    let rows = data.features.names.iter().zip(aucs.into_iter().zip(stability));
    rows.map(|(name, (auc, &stability))| FeatureUsefulness {
        name: name.clone(),
        auc,
        stability,
        chosen: chosen(name),
    })
    .collect()
}

/// The area under the ROC curve of each feature alone, `(n_features,)`: the probability that a
/// positive pair differs less in the feature than a negative pair, where ties count half. NaN if a
/// class has no pair.
fn feature_auc(data: &Matrix) -> Vec<f64> {
    let columns = data.sorted_rows().into_iter().zip(data.columns());
    columns.map(|(rows, column)| auc(column, &rows, data.labels())).collect()
}

/// The sum over negatives of (positives below + half of the positives with the same value), divided
/// by Np Nn (Mann and Whitney 1947). `rows` are in ascending order of the column. NaN if a class has
/// no pair.
fn auc(column: &[f64], rows: &[u32], labels: &[Label]) -> f64 {
    let (mut positive, mut negative, mut doubled) = (0u64, 0u64, 0u64);
    let is_equal = |a: &u32, b: &u32| column[*a as usize].total_cmp(&column[*b as usize]).is_eq();
    for equal in rows.chunk_by(is_equal) {
        let is_positive = |row: &&u32| labels[**row as usize] == Label::Positive;
        let p = equal.iter().filter(is_positive).count() as u64;
        let n = equal.len() as u64 - p;
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

    /// Positives at 1, 3 and 4, negatives at 2 and 4. Of the six combinations of a positive and a
    /// negative, 1 < 2, 1 < 4 and 3 < 4 count one, 4 = 4 counts half: 3.5 / 6. The second feature is
    /// the negative of the first, the third is constant.
    #[test]
    fn the_area_matches_a_count_by_hand() {
        let x = vec![1.0, 2.0, 3.0, 4.0, 4.0];
        let negated = x.iter().map(|x| -x).collect();
        let labels = vec![Positive, Negative, Positive, Positive, Negative];
        let data = Matrix::new(vec![x, negated, vec![0.0; 5]], labels);
        let found = feature_auc(&data);
        assert_eq!((found[0], found[2]), (3.5 / 6.0, 0.5));
        assert!((found[1] - 2.5 / 6.0).abs() < 1e-15);
    }
}
