use dataset::Pair;
use dataset::tables::FeatureTable;
use train::Matrix;

/// The absolute feature differences and the label of each pair.
pub fn differences(pairs: &[Pair], features: &FeatureTable) -> Matrix {
    let n_features = features.names.len();
    let mut columns = vec![Vec::with_capacity(pairs.len()); n_features];
    let mut difference = vec![0.0; n_features];
    for pair in pairs {
        let (query, reference) = (features.row(pair.query), features.row(pair.reference));
        featurize::difference(query, reference, &mut difference);
        for (column, &value) in columns.iter_mut().zip(&difference) {
            column.push(value);
        }
    }
    Matrix::new(columns, pairs.iter().map(|pair| pair.label).collect())
}
