//! What a run is for, and so which stages and artifacts are part of it.

use crate::config::Config;
use crate::stage::{Artifact, Stage};
use crate::used_model::UsedModel;

/// What a run is for. The classifier is trained, or loop closures are found, or both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Goal {
    /// The run trains and evaluates classifiers.
    trains: bool,
    /// The run finds loop closures.
    detects: bool,
    /// The run needs the features of keyframes.
    has_features: bool,
    /// The pipeline names the ground truth.
    has_truth: bool,
    /// Logs are simulated.
    simulates: bool,
}

impl Goal {
    /// What a run is for, with the model that the command names.
    pub(crate) fn of(config: &Config, model: Option<&UsedModel>) -> Self {
        match model {
            None => Self::train(config),
            Some(_) => Self::detect(config, config.detection().classifier),
        }
    }

    /// A run that trains, unless the pipeline lists no learners. It also finds loop closures if the pipeline has
    /// the section `[detect]`.
    pub(crate) fn train(config: &Config) -> Self {
        Self {
            trains: !config.train.learners.is_empty(),
            detects: config.detect.is_some(),
            has_features: !config.train.learners.is_empty(),
            has_truth: config.evaluate.truth.is_some(),
            simulates: config.simulate.is_some(),
        }
    }

    /// A run that finds loop closures with a model, with or without its classifier.
    pub(crate) fn detect(config: &Config, uses_classifier: bool) -> Self {
        Self { trains: false, detects: true, has_features: uses_classifier, ..Self::train(config) }
    }

    /// Whether the run trains classifiers.
    pub(crate) fn trains(self) -> bool {
        self.trains
    }

    /// Whether the run finds loop closures.
    pub(crate) fn detects(self) -> bool {
        self.detects
    }

    /// Whether a stage is part of the run.
    pub(crate) fn has_stage(self, stage: Stage) -> bool {
        match stage {
            Stage::Simulate => self.simulates,
            Stage::Ingest | Stage::Subsample | Stage::Evaluate => true,
            Stage::Label | Stage::Train => self.trains,
            Stage::Featurize => self.has_features,
            Stage::Register | Stage::Detect | Stage::Optimize => self.detects,
        }
    }

    /// Whether the run makes an artifact. Stages read those of their inputs that the run makes.
    pub(crate) fn has(self, artifact: Artifact) -> bool {
        match artifact {
            Artifact::Truth => self.has_truth,
            _ => artifact.maker().is_some_and(|stage| self.has_stage(stage)),
        }
    }
}
