use dataset::Label;

use crate::TrainError;

/// Feature differences of labelled pairs, column by column.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    columns: Vec<Vec<f64>>,
    labels: Vec<Label>,
}

impl Matrix {
    /// Takes columns, `(n_features, n_pairs)`, and labels, `(n_pairs,)`.
    ///
    /// # Panics
    /// If the length of a column differs from the number of labels.
    pub fn new(columns: Vec<Vec<f64>>, labels: Vec<Label>) -> Self {
        assert!(columns.iter().all(|column| column.len() == labels.len()));
        Self { columns, labels }
    }

    /// A matrix of the rows with these indices.
    pub fn select(&self, rows: &[usize]) -> Self {
        Self {
            columns: self
                .columns
                .iter()
                .map(|column| rows.iter().map(|&row| column[row]).collect())
                .collect(),
            labels: rows.iter().map(|&row| self.labels[row]).collect(),
        }
    }

    /// Number of pairs.
    pub fn n_rows(&self) -> usize {
        self.labels.len()
    }

    /// The values of one feature, `(n_pairs,)`.
    pub fn column(&self, feature: usize) -> &[f64] {
        &self.columns[feature]
    }

    /// All columns, `(n_features, n_pairs)`.
    pub fn columns(&self) -> &[Vec<f64>] {
        &self.columns
    }

    /// The labels, `(n_pairs,)`.
    pub fn labels(&self) -> &[Label] {
        &self.labels
    }

    /// Number of pairs with a label.
    pub fn count(&self, label: Label) -> usize {
        self.labels.iter().filter(|&&l| l == label).count()
    }

    pub(crate) fn check(&self) -> Result<(), TrainError> {
        let (n_positive, n_negative) = (self.count(Label::Positive), self.count(Label::Negative));
        if n_positive == 0 || n_negative == 0 {
            return Err(TrainError::OneClass { n_positive, n_negative });
        }
        for (feature, column) in self.columns.iter().enumerate() {
            if let Some(row) = column.iter().position(|value| !value.is_finite()) {
                return Err(TrainError::NotFinite { feature, row, value: column[row] });
            }
        }
        Ok(())
    }

    /// The rows in ascending order of each feature, `(n_features, n_pairs)`; equal values in order of
    /// the rows.
    pub fn sorted_rows(&self) -> Vec<Vec<u32>> {
        self.columns
            .iter()
            .map(|column| {
                // Sort values together with their rows: a comparison then needs no look-up.
                let mut rows: Vec<(f64, u32)> = column.iter().copied().zip(0..).collect();
                rows.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                rows.into_iter().map(|(_, row)| row).collect()
            })
            .collect()
    }
}

/// The midpoint of two neighbouring values of a feature; `None` if no number lies between them.
pub(crate) fn midpoint(lower: f64, upper: f64) -> Option<f64> {
    let middle = lower + (upper - lower) / 2.0;
    (lower < middle && middle < upper).then_some(middle)
}
