//! The model that a command finds loop closures with.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::digest_file;
use featurize::FeatureSet;
use model::{Detector, Model};
use serde_json::{Value, json};

use crate::config::Config;
use crate::models::file_of;

/// A model for loop detection: a classifier with a detector.
#[derive(Clone)]
pub(crate) struct UsedModel {
    /// The `model.json`.
    pub(crate) path: PathBuf,
    /// The name of the file as an input, where that does not follow from the path.
    pub(crate) name: Option<String>,
    pub(crate) model: Model,
    pub(crate) detector: Detector,
    /// BLAKE3 digest of the file.
    digest: String,
}

impl UsedModel {
    /// Loads a model: a file, or a folder with one model. A model without a detector is an error that says how to get
    /// one.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let path = &file_of(path).with_context(|| format!("--model {}", path.display()))?;
        let digest = digest_file(path).with_context(|| format!("--model {}", path.display()))?;
        let model = model::load(path)?;
        let detector = model.detector.clone().ok_or_else(|| {
            anyhow!(
                "{} has no `detector`, which loop detection needs; train a model with a pipeline that has a section [detect] and names the ground truth of its logs, such as `evaluate.truth = {{ topic = \"/ground_truth\" }}`",
                path.display()
            )
        })?;
        Ok(Self { path: path.to_owned(), name: None, model, detector, digest })
    }

    /// The features of the model replace those of the pipeline.
    pub(crate) fn set_features(&self, config: &mut Config) -> Result<()> {
        config.featurize = featurize_options(&self.model).with_context(|| {
            format!("{}; `detect.classifier = false` does without", self.path.display())
        })?;
        Ok(())
    }

    /// Name, version and digest of the model.
    pub(crate) fn summary(&self) -> Value {
        let Model { name, version, .. } = &self.model;
        json!({ "name": name, "version": version, "digest": self.digest })
    }
}

/// The features that a model needs.
pub fn featurize_options(model: &Model) -> Result<featurize::Options> {
    let spec = &model.features;
    let is_known = |set: &FeatureSet| {
        set.name() == spec.set && set.version() == spec.version && set.feature_names() == spec.names
    };
    let set = FeatureSet::ALL.into_iter().find(is_known).ok_or_else(|| {
        let known = FeatureSet::ALL.map(|set| format!("`{}` v{}", set.name(), set.version()));
        anyhow!(
            "the model `{}` needs the features `{}` v{}, expected {}; train it again",
            model.name,
            spec.set,
            spec.version,
            known.join(" or ")
        )
    })?;
    Ok(featurize::Options { set, gate_m: spec.gate_m })
}
