//! The model that a command finds loop closures with.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::digest_file;
use featurize::FeatureSet;
use model::{Detector, Model};
use serde_json::{Value, json};

use crate::config::Config;

/// A model for loop detection: a classifier with a detector.
pub(crate) struct UsedModel {
    /// The `model.json`.
    pub(crate) path: PathBuf,
    pub(crate) model: Model,
    pub(crate) detector: Detector,
    /// BLAKE3 digest of the file.
    digest: String,
}

impl UsedModel {
    /// Loads a model. A model without a detector is an error that says how to get one.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let digest = digest_file(path).with_context(|| format!("--model {}", path.display()))?;
        let model = model::load(path)?;
        let detector = model.detector.clone().ok_or_else(|| {
            anyhow!(
                "{} has no `detector`, which loop detection needs; train a model with a pipeline that has a section [detect] and names the ground truth of its logs, such as `evaluate.truth = {{ topic = \"/ground_truth\" }}`",
                path.display()
            )
        })?;
        Ok(Self { path: path.to_owned(), model, detector, digest })
    }

    /// The features of the model replace those of the pipeline.
    pub(crate) fn set_features(&self, config: &mut Config) -> Result<()> {
        let spec = &self.model.features;
        let set = FeatureSet::ALL
            .into_iter()
            .find(|set| set.name() == spec.set)
            .filter(|set| set.version() == spec.version && set.feature_names() == spec.names);
        config.featurize.set = set.ok_or_else(|| {
            let known = FeatureSet::ALL.map(|set| format!("`{}` v{}", set.name(), set.version()));
            anyhow!(
                "{} needs the features `{}` v{}, expected {}; train the model again, or set `detect.classifier = false`",
                self.path.display(),
                spec.set,
                spec.version,
                known.join(" or ")
            )
        })?;
        config.featurize.gate_m = spec.gate_m;
        Ok(())
    }

    /// Name, version and digest of the model.
    pub(crate) fn summary(&self) -> Value {
        let Model { name, version, .. } = &self.model;
        json!({ "name": name, "version": version, "digest": self.digest })
    }
}
