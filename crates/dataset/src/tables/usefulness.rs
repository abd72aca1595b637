//! The tables about the usefulness of features. `featurize` measures how stable each feature is.
//! `train` measures how well each feature ranks the pairs and how often the models use it.

use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{Float64Type, UInt64Type};
use arrow_array::{ArrayRef, RecordBatch, UInt64Array};

use super::columns::Columns;
use super::types::{batch, floats, strings};
use super::{Provenance, Result, read_table, write_table};
use crate::FeatureUsefulness;

/// Writes `feature_stability.parquet`: the change of each feature if every other return of the
/// scans is removed, `(n_features,)`.
pub fn write_feature_stability(
    path: &Path,
    provenance: &Provenance,
    names: &[String],
    stability: &[f64],
) -> Result<()> {
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("feature", strings(names.iter().map(String::as_str))),
        ("stability", floats(stability.iter().copied())),
    ];
    write_table(path, "feature_stability", provenance, &batch(columns, &[]))
}

/// Reads `feature_stability.parquet`. Its rows must be the features with these names, in order.
pub fn read_feature_stability(path: &Path, names: &[String]) -> Result<(Vec<f64>, Provenance)> {
    let (table, provenance) = read_table(path, "feature_stability")?;
    let columns = Columns::new(path, &table);
    let features = columns.strings("feature")?;
    if !features.iter().flatten().eq(names.iter().map(String::as_str)) {
        let found = features.iter().flatten().collect::<Vec<_>>().join(", ");
        return Err(columns.error("feature", "the features of the run", found));
    }
    let stability = columns.numbers::<Float64Type>("stability")?;
    Ok((stability.values().to_vec(), provenance))
}

/// Writes `feature_usefulness.parquet`.
pub fn write_feature_usefulness(
    path: &Path,
    provenance: &Provenance,
    rows: &[FeatureUsefulness],
) -> Result<()> {
    write_table(path, "feature_usefulness", provenance, &feature_usefulness_batch(rows))
}

/// The columns of `feature_usefulness.parquet`.
pub fn feature_usefulness_batch(rows: &[FeatureUsefulness]) -> RecordBatch {
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("feature", strings(rows.iter().map(|r| &*r.name))),
        ("auc", floats(rows.iter().map(|r| r.auc))),
        ("stability", floats(rows.iter().map(|r| r.stability))),
        ("chosen", Arc::new(UInt64Array::from_iter_values(rows.iter().map(|r| r.chosen)))),
    ];
    batch(columns, &[])
}

/// Reads `feature_usefulness.parquet`.
pub fn read_feature_usefulness(path: &Path) -> Result<(Vec<FeatureUsefulness>, Provenance)> {
    let (table, provenance) = read_table(path, "feature_usefulness")?;
    let columns = Columns::new(path, &table);
    let features = columns.strings("feature")?;
    let aucs = columns.numbers::<Float64Type>("auc")?;
    let stability = columns.numbers::<Float64Type>("stability")?;
    let chosen = columns.numbers::<UInt64Type>("chosen")?;
    let rows = (0..table.num_rows())
        .map(|row| FeatureUsefulness {
            name: features.value(row).to_owned(),
            auc: aucs.value(row),
            stability: stability.value(row),
            chosen: chosen.value(row),
        })
        .collect();
    Ok((rows, provenance))
}
