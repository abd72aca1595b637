//! Models.

use std::path::{Path, PathBuf};

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::features::features_of;
use crate::{Class, error};

/// Each thread scores at least so many pairs.
const MIN_CHUNK: usize = 16384;

/// A model.json.
#[pyclass(frozen, module = "loopboost._loopboost")]
pub(crate) struct Model {
    path: PathBuf,
    model: model::Model,
}

#[pymethods]
impl Model {
    /// Reads a file, or the only model in a folder, and checks every value and the digest.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let load = || {
            let path = loopboost::model_file(&path)?;
            let model = model::load(&path)?;
            anyhow::Ok(Self { path, model })
        };
        py.detach(load).map_err(|failed| error(py, Class::Input, format!("{failed:#}")))
    }

    /// The file.
    #[getter]
    fn path(&self) -> &Path {
        &self.path
    }

    #[getter]
    fn name(&self) -> &str {
        &self.model.name
    }

    #[getter]
    fn version(&self) -> String {
        self.model.version.to_string()
    }

    #[getter]
    fn learner(&self) -> &'static str {
        self.model.classifier.learner.name()
    }

    #[getter]
    fn has_detector(&self) -> bool {
        self.model.detector.is_some()
    }

    /// The sections `features`, `scans`, `training`, `measured` or `operating_points` of the file, as JSON.
    fn section(&self, py: Python<'_>, name: &str) -> PyResult<String> {
        let model = &self.model;
        let text = match name {
            "features" => serde_json::to_string(&model.features),
            "scans" => serde_json::to_string(&model.scans),
            "training" => serde_json::to_string(&model.training),
            "measured" => serde_json::to_string(&model.measured),
            "operating_points" => serde_json::to_string(&model.operating_points),
            _ => return Err(error(py, Class::Argument, format!("no section `{name}`"))),
        };
        text.map_err(|failed| error(py, Class::Input, failed))
    }

    /// The card of the model as text.
    fn card(&self) -> String {
        model::card(&self.model)
    }

    /// The features that the model needs of a scan, `(n_features,)`. `x_m` and `y_m` have the same length.
    fn featurize<'py>(
        &self,
        py: Python<'py>,
        x_m: PyReadonlyArray1<'py, f32>,
        y_m: PyReadonlyArray1<'py, f32>,
        coverage_deg: f32,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let is_ring = dataset::FULL_RING_DEG <= coverage_deg;
        let checked = self.model.scans.check(coverage_deg, is_ring);
        checked.map_err(|other| error(py, Class::Input, other))?;
        let options = loopboost::featurize_options(&self.model)
            .map_err(|unknown| error(py, Class::Input, unknown))?;
        features_of(py, &x_m, &y_m, coverage_deg, &options)
    }

    /// Confidences of pairs of rows of `features`, `(n_pairs,)`. `a` and `b` have the same length, and no row number is
    /// out of range.
    fn score_pairs<'py>(
        &self,
        py: Python<'py>,
        features: PyReadonlyArray2<'py, f64>,
        a: PyReadonlyArray1<'py, u64>,
        b: PyReadonlyArray1<'py, u64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let n_features = self.model.features.names.len();
        let (features, a, b) = (features.as_slice()?, a.as_slice()?, b.as_slice()?);
        let classifier = &self.model.classifier;
        let score = |(a, b): (&[u64], &[u64])| {
            let pairs = a.iter().zip(b).map(|(&a, &b)| (a as usize, b as usize));
            classifier.score_pairs(features, n_features, pairs)
        };
        // Threads of this call only: those of a pool are missing in a process that Python's multiprocessing forked.
        let n_threads = std::thread::available_parallelism().map_or(1, usize::from);
        let chunk = a.len().div_ceil(n_threads).max(MIN_CHUNK);
        let confidences: Vec<f64> = py.detach(|| {
            let mut confidences = vec![0.0; a.len()];
            let chunks = a.chunks(chunk).zip(b.chunks(chunk)).zip(confidences.chunks_mut(chunk));
            std::thread::scope(|scope| {
                for (pairs, confidences) in chunks {
                    scope.spawn(move || confidences.copy_from_slice(&score(pairs)));
                }
            });
            confidences
        });
        Ok(PyArray1::from_vec(py, confidences))
    }
}
