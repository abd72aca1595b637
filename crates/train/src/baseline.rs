//! The baselines of the paper, on the same folds as the boosted learners: they are evaluated, not
//! saved.

use crate::matrix::Matrix;

/// Mean of each feature, and the factor that makes its deviation 1; the factor of a feature that
/// is constant is 0.
pub(crate) fn scales(training: &Matrix) -> Vec<(f64, f64)> {
    let n = training.n_rows() as f64;
    training
        .columns()
        .iter()
        .map(|column| {
            let mean = column.iter().sum::<f64>() / n;
            let variance = column.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
            // Rounding leaves a constant c with a deviation of about 1e-16 c.
            let deviation = variance.sqrt();
            (mean, if deviation <= 1e-12 * mean.abs() { 0.0 } else { 1.0 / deviation })
        })
        .collect()
}

/// Rows of a matrix, scaled, row-major, `(n, n_features)`.
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
