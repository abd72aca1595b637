//! Normalisation of features, for the baselines. The paper compares its boosted classifiers with
//! these; they run on the same folds and are evaluated but not saved.

use crate::matrix::Matrix;

/// The mean of each feature, and the factor that scales its standard deviation to 1. The factor of a
/// constant feature is 0.
pub(crate) fn scales(training: &Matrix) -> Vec<(f64, f64)> {
    let n = training.n_rows() as f64;
    training
        .columns()
        .iter()
        .map(|column| {
            let mean = column.iter().sum::<f64>() / n;
            let variance = column.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
            // By rounding, a constant c has a deviation of about 1e-16 c.
            let deviation = variance.sqrt();
            (mean, if deviation <= 1e-12 * mean.abs() { 0.0 } else { 1.0 / deviation })
        })
        .collect()
}

/// The scaled rows of a matrix, row-major, `(n, n_features)`.
pub(crate) fn normalised(matrix: &Matrix, scales: &[(f64, f64)]) -> Vec<f64> {
    (0..matrix.n_rows())
        .flat_map(|row| {
            scales
                .iter()
                .zip(matrix.columns())
                .map(move |(&(mean, factor), column)| (column[row] - mean) * factor)
        })
        .collect()
}
