//! The baselines of the paper, on the same folds as the boosted learners: they are evaluated, not
//! saved.

use crate::matrix::Matrix;

/// Rows of a matrix, each feature scaled to mean 0 and deviation 1 on the training rows.
///
/// Returns training rows and test rows, row-major, `(n, n_features)`. A feature that is constant on
/// the training rows is 0 throughout.
pub(crate) fn normalised(training: &Matrix, test: &Matrix) -> (Vec<f64>, Vec<f64>) {
    let n = training.n_rows() as f64;
    let scales: Vec<(f64, f64)> = training
        .columns()
        .iter()
        .map(|column| {
            let mean = column.iter().sum::<f64>() / n;
            let variance = column.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
            // Rounding leaves a constant c with a deviation of about 1e-16 c.
            let deviation = variance.sqrt();
            (mean, if deviation <= 1e-12 * mean.abs() { 0.0 } else { 1.0 / deviation })
        })
        .collect();
    let rows = |matrix: &Matrix| {
        (0..matrix.n_rows())
            .flat_map(|row| {
                scales
                    .iter()
                    .zip(matrix.columns())
                    .map(move |(&(mean, factor), column)| (column[row] - mean) * factor)
            })
            .collect()
    };
    (rows(training), rows(test))
}
