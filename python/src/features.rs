//! Features of scans.

use ::featurize::{FeatureSet, Featurizer, Options};
use dataset::Scan;
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::{Class, error};

/// The feature set of this name.
fn feature_set(py: Python<'_>, name: &str) -> PyResult<FeatureSet> {
    FeatureSet::ALL.into_iter().find(|set| set.name() == name).ok_or_else(|| {
        let known = FeatureSet::ALL.map(|set| format!("`{}`", set.name()));
        let known = known.join(" or ");
        error(py, Class::Argument, format!("no feature set `{name}`, expected {known}"))
    })
}

/// The names of the features of a set, in order.
#[pyfunction]
pub(crate) fn feature_names(py: Python<'_>, set: &str) -> PyResult<Vec<&'static str>> {
    Ok(feature_set(py, set)?.feature_names().to_vec())
}

/// The features of a scan, `(n_features,)`. `x_m` and `y_m` have the same length.
#[pyfunction]
pub(crate) fn featurize<'py>(
    py: Python<'py>,
    x_m: PyReadonlyArray1<'py, f32>,
    y_m: PyReadonlyArray1<'py, f32>,
    coverage_deg: f32,
    set: &str,
    gate_m: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let options = Options { set: feature_set(py, set)?, gate_m };
    options.check().map_err(|wrong| error(py, Class::Argument, wrong))?;
    features_of(py, &x_m, &y_m, coverage_deg, &options)
}

/// The features of a scan with options that were checked.
pub(crate) fn features_of<'py>(
    py: Python<'py>,
    x_m: &PyReadonlyArray1<'py, f32>,
    y_m: &PyReadonlyArray1<'py, f32>,
    coverage_deg: f32,
    options: &Options,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let [x_m, y_m] = [x_m.as_slice()?.to_vec(), y_m.as_slice()?.to_vec()];
    let features = py.detach(|| {
        let scan = Scan { x_m, y_m, coverage_deg, ..Scan::default() };
        let mut features = vec![0.0; options.set.feature_names().len()];
        Featurizer::new(options).features(&scan, &mut features).map(|()| features)
    });
    let features = features.map_err(|unusable| {
        error(py, Class::Input, format!("no features can be computed from this scan: {unusable}"))
    })?;
    Ok(PyArray1::from_vec(py, features))
}
