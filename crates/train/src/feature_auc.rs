//! What each feature is worth by itself.

use dataset::Label;

use crate::Matrix;

/// How often a positive pair differs less in a feature than a negative one, ties counting half: the
/// area under the ROC curve of the feature alone, 0.5 for one that tells nothing, `(n_features,)`.
/// NaN where a class has no pair.
pub fn feature_auc(data: &Matrix) -> Vec<f64> {
    let columns = data.sorted_rows().into_iter().zip(data.columns());
    columns.map(|(rows, column)| auc(column, &rows, data.labels())).collect()
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
    fn an_area_by_hand() {
        let x = vec![1.0, 2.0, 3.0, 4.0, 4.0];
        let upside_down = x.iter().map(|x| -x).collect();
        let labels = vec![Positive, Negative, Positive, Positive, Negative];
        let data = Matrix::new(vec![x, upside_down, vec![0.0; 5]], labels);
        let found = feature_auc(&data);
        assert_eq!((found[0], found[2]), (3.5 / 6.0, 0.5));
        assert!((found[1] - 2.5 / 6.0).abs() < 1e-15);
    }
}
