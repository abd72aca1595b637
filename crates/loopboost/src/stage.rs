//! The stages of a run and the artifacts they make, each written down once.
//!
//! A stage is a verb, a crate, a command and a section of the pipeline file. [`Stage::spec`] says
//! what it reads, what it writes and which options its results depend on; its file in
//! [`crate::stages`] does the work, and [`crate::pipeline`] calls it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use clap::ValueEnum;
use clap::builder::PossibleValue;
use serde_json::{Value, json, to_value};

use crate::config::{Config, LogOptions};

/// A step from the logs to the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Stage {
    Simulate,
    Ingest,
    Subsample,
    Label,
    Featurize,
    Register,
    Detect,
    Train,
    Optimize,
    Evaluate,
}

/// What a stage is.
pub(crate) struct Spec {
    /// Name of the stage, its command, and its section of the pipeline file.
    pub(crate) name: &'static str,
    /// One line of help.
    pub(crate) help: &'static str,
    /// What it reads in the run folder: those of these artifacts that the run makes (see
    /// [`crate::goal::Goal`]).
    pub(crate) inputs: &'static [Artifact],
    /// What it writes to the run folder, besides models, figures and evaluation tables.
    pub(crate) outputs: &'static [Artifact],
    /// The options that its results depend on. They are stored with the results, and the stage
    /// runs again when they change.
    pub(crate) options: fn(&Config, &Scope<'_>) -> Result<Value>,
}

/// What options are asked for.
pub(crate) struct Scope<'a> {
    /// The log, for a stage that works log by log.
    pub(crate) log: Option<&'a str>,
    /// The logs of the run; only the log, for a stage that works log by log.
    pub(crate) logs: &'a [&'a str],
    /// The artifact, for a task that makes only one of those of its stage.
    pub(crate) only: Option<Artifact>,
    /// The model that loop closures are found with; null without one.
    pub(crate) model: Value,
}

impl Stage {
    /// All stages, in the order of a run.
    pub(crate) const ALL: [Self; 10] = [
        Self::Simulate,
        Self::Ingest,
        Self::Subsample,
        Self::Label,
        Self::Featurize,
        Self::Register,
        Self::Detect,
        Self::Train,
        Self::Optimize,
        Self::Evaluate,
    ];

    /// The stages that use the model that loop closures are found with. The others do not depend on it,
    /// except that `featurize` computes the features of the model.
    pub(crate) const USE_MODEL: [Self; 4] =
        [Self::Register, Self::Detect, Self::Optimize, Self::Evaluate];

    /// The stages that work log by log. Their results do not depend on the seed or on other logs, so that they are the
    /// same in every run.
    pub(crate) const OF_LOGS: [Self; 4] =
        [Self::Ingest, Self::Subsample, Self::Featurize, Self::Register];

    /// Whether this stage works log by log.
    pub(crate) fn is_of_logs(self) -> bool {
        Self::OF_LOGS.contains(&self)
    }

    /// What this stage is.
    pub(crate) fn spec(self) -> Spec {
        use Artifact as A;
        match self {
            Self::Simulate => Spec {
                name: "simulate",
                help: "Simulate the drives of the [simulate] section -> logs/LOG.mcap",
                inputs: &[],
                outputs: &[A::Log],
                options: |config, _| Ok(to_value(&config.simulate)?),
            },
            Self::Ingest => Spec {
                name: "ingest",
                help: "Read the logs -> scans/LOG.parquet, poses/LOG.parquet",
                inputs: &[A::Log],
                outputs: &[A::Scans, A::Poses, A::Truth],
                options: ingest_options,
            },
            Self::Subsample => Spec {
                name: "subsample",
                help: "Keep a scan every half metre: scans, poses -> keyframes/LOG.parquet",
                inputs: &[A::Scans, A::Poses],
                outputs: &[A::Keyframes],
                options: |config, scope| {
                    let mut value = to_value(&config.subsample)?;
                    value["sites"] = to_value(sites(config, scope.logs)?)?;
                    Ok(value)
                },
            },
            Self::Label => Spec {
                name: "label",
                help: "Label pairs of keyframes: keyframes -> pairs.parquet",
                inputs: &[A::Keyframes, A::Truth],
                outputs: &[A::Pairs],
                options: |config, _| Ok(to_value(&config.label)?),
            },
            Self::Featurize => Spec {
                name: "featurize",
                help: "Compute features: keyframes, scans -> features/LOG.parquet, ...",
                inputs: &[A::Keyframes, A::Scans],
                outputs: &[A::Features, A::FeatureStability],
                options: |config, _| Ok(to_value(&config.featurize)?),
            },
            Self::Register | Self::Detect | Self::Optimize => self.spec_of_detection(),
            Self::Train | Self::Evaluate => self.spec_of_models(),
        }
    }

    /// The stages of loop detection.
    fn spec_of_detection(self) -> Spec {
        use Artifact as A;
        match self {
            Self::Register => Spec {
                name: "register",
                help: "Match scans: scans, poses -> registered/LOG.parquet, odometry/LOG.parquet",
                inputs: &[A::Keyframes, A::Scans, A::Poses],
                outputs: &[A::Registered, A::Odometry],
                options: register_options,
            },
            Self::Detect => Spec {
                name: "detect",
                help: "Find places that may be the same -> candidates.parquet; with --model, find loop closures in logs",
                inputs: &[A::Registered, A::Scans, A::Keyframes, A::Features],
                outputs: &[A::Candidates],
                options: |config, scope| {
                    let mut value = detection_options(config, scope)?;
                    value["detect"] = to_value(config.detection())?;
                    Ok(value)
                },
            },
            _ => Spec {
                name: "optimize",
                help: "Choose closures: candidates -> closures.parquet, trajectory/LOG.tum, ...",
                inputs: &[
                    A::Registered,
                    A::Candidates,
                    A::Scans,
                    A::Poses,
                    A::Keyframes,
                    A::Features,
                ],
                outputs: &[
                    A::Closures,
                    A::Trajectory,
                    A::ScanTrajectory,
                    A::TumTrajectory,
                    A::PoseGraph,
                    A::GraphEdges,
                ],
                options: |config, scope| {
                    let mut value = detection_options(config, scope)?;
                    value["optimize"] = to_value(&config.optimize)?;
                    value["min_path_m"] = config.detection().min_path_m.into();
                    value["max_pose_gap_secs"] = config.subsample.max_pose_gap_secs.into();
                    Ok(value)
                },
            },
        }
    }

    /// The stages that train and measure.
    fn spec_of_models(self) -> Spec {
        use Artifact as A;
        match self {
            Self::Train => Spec {
                name: "train",
                help: "Train and cross-validate: pairs, features -> models/, scores.parquet, ...",
                inputs: &[
                    A::Keyframes,
                    A::Pairs,
                    A::Features,
                    A::FeatureStability,
                    A::Poses,
                    A::Registered,
                    A::Candidates,
                    A::Truth,
                ],
                outputs: &[A::Scores, A::Rounds, A::Retrieval, A::Grid, A::FeatureUsefulness],
                options: train_options,
            },
            _ => Spec {
                name: "evaluate",
                help: "Measure and report: scores, closures -> evaluation/, report.html",
                inputs: &[
                    A::Keyframes,
                    A::Pairs,
                    A::Features,
                    A::Scores,
                    A::Rounds,
                    A::Retrieval,
                    A::Grid,
                    A::FeatureUsefulness,
                    A::Scans,
                    A::Poses,
                    A::Registered,
                    A::Candidates,
                    A::Closures,
                    A::Trajectory,
                    A::ScanTrajectory,
                    A::Truth,
                ],
                outputs: &[A::Summary, A::Report],
                // The report shows them all.
                options: |config, scope| {
                    let mut value = to_value(config)?;
                    if !scope.model.is_null() {
                        value["model"] = scope.model.clone();
                    }
                    Ok(value)
                },
            },
        }
    }

    pub(crate) fn name(self) -> &'static str {
        self.spec().name
    }

    /// The command that runs this stage alone.
    pub(crate) fn command(self) -> String {
        format!("loopboost {} PIPELINE.toml --out DIR", self.name())
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// `--force STAGE`
impl ValueEnum for Stage {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()).help(self.spec().help))
    }
}

/// The options of the scans and poses of a log, or of its ground truth. The estimates must not depend on
/// whether there is a ground truth, so the options of the scans and poses do not contain it.
fn ingest_options(config: &Config, scope: &Scope<'_>) -> Result<Value> {
    // The site is an option of `subsample`.
    let log = scope.log.unwrap_or_default();
    let mut options = LogOptions { site: None, ..config.for_log(log)? };
    if scope.only == Some(Artifact::Truth) {
        options.pose = config.evaluate.truth.clone();
    }
    Ok(to_value(options)?)
}

fn register_options(config: &Config, scope: &Scope<'_>) -> Result<Value> {
    let mut value = detection_options(config, scope)?;
    value["max_pose_gap_secs"] = config.subsample.max_pose_gap_secs.into();
    Ok(value)
}

/// The options that `register`, `detect` and `optimize` share.
fn detection_options(config: &Config, scope: &Scope<'_>) -> Result<Value> {
    let range = |log: &&str| {
        let lidar = config.for_log(log)?.lidar;
        Ok(((*log).to_owned(), [lidar.range_min_m, lidar.range_max_m]))
    };
    let ranges = scope.logs.iter().map(range).collect::<Result<BTreeMap<_, _>>>()?;
    Ok(json!({ "register": config.register, "range_m": ranges, "model": scope.model }))
}

fn train_options(config: &Config, scope: &Scope<'_>) -> Result<Value> {
    let lidars = scope
        .logs
        .iter()
        .map(|log| Ok((*log, config.for_log(log)?.lidar)))
        .collect::<Result<BTreeMap<_, _>>>()?;
    Ok(json!({
        "name": config.name,
        "train": config.train,
        "evaluate": config.evaluate.experiment(),
        "label": config.label,
        "featurize": config.featurize,
        "lidars": lidars,
        "detect": config.detect,
        "register": config.detect.as_ref().map(|_| &config.register),
    }))
}

/// The site of each log. A log without a site is a site of its own.
pub(crate) fn sites(config: &Config, logs: &[&str]) -> Result<BTreeMap<String, String>> {
    logs.iter()
        .map(|&log| {
            let site = config.for_log(log)?.site;
            Ok((log.to_owned(), site.unwrap_or_else(|| log.to_owned())))
        })
        .collect()
}

/// A file, or a folder of files, in the run folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Artifact {
    /// A simulated log; one that is split into files is a folder of them.
    Log,
    Scans,
    Poses,
    /// The poses of the ground truth, for evaluation only.
    Truth,
    Keyframes,
    Pairs,
    Features,
    FeatureStability,
    Registered,
    Odometry,
    Candidates,
    Scores,
    Rounds,
    Retrieval,
    Grid,
    FeatureUsefulness,
    Closures,
    /// The optimized poses of keyframes.
    Trajectory,
    /// The optimized poses of all scans.
    ScanTrajectory,
    /// The same as text.
    TumTrajectory,
    PoseGraph,
    /// The edges of the pose graph, by scan.
    GraphEdges,
    /// The numbers of the report as JSON.
    Summary,
    Report,
}

impl Artifact {
    pub(crate) const ALL: [Self; 24] = [
        Self::Log,
        Self::Scans,
        Self::Poses,
        Self::Truth,
        Self::Keyframes,
        Self::Pairs,
        Self::Features,
        Self::FeatureStability,
        Self::Registered,
        Self::Odometry,
        Self::Candidates,
        Self::Scores,
        Self::Rounds,
        Self::Retrieval,
        Self::Grid,
        Self::FeatureUsefulness,
        Self::Closures,
        Self::Trajectory,
        Self::ScanTrajectory,
        Self::TumTrajectory,
        Self::PoseGraph,
        Self::GraphEdges,
        Self::Summary,
        Self::Report,
    ];

    /// The name in the run folder; `{log}` stands for the name of a log.
    pub(crate) fn pattern(self) -> &'static str {
        match self {
            Self::Log => "logs/{log}.mcap",
            Self::Scans => "scans/{log}.parquet",
            Self::Poses => "poses/{log}.parquet",
            Self::Truth => "truth/{log}.parquet",
            Self::Keyframes => "keyframes/{log}.parquet",
            Self::Pairs => "pairs.parquet",
            Self::Features => "features/{log}.parquet",
            Self::FeatureStability => "feature_stability.parquet",
            Self::Registered => "registered/{log}.parquet",
            Self::Odometry => "odometry/{log}.parquet",
            Self::Candidates => "candidates.parquet",
            Self::Scores => "scores.parquet",
            Self::Rounds => "rounds.parquet",
            Self::Retrieval => "retrieval.parquet",
            Self::Grid => "grid.parquet",
            Self::FeatureUsefulness => "feature_usefulness.parquet",
            Self::Closures => "closures.parquet",
            Self::Trajectory => "trajectory.parquet",
            Self::ScanTrajectory => "trajectory/{log}.parquet",
            Self::TumTrajectory => "trajectory/{log}.tum",
            Self::PoseGraph => "graph.g2o",
            Self::GraphEdges => "graph.parquet",
            Self::Summary => "evaluation/summary.json",
            Self::Report => "report.html",
        }
    }

    /// The folder of the files of logs, if there is one for each log.
    pub(crate) fn folder(self) -> Option<&'static str> {
        self.pattern().split_once("/{log}").map(|(folder, _)| folder)
    }

    /// Whether there is one for each log.
    pub(crate) fn is_per_log(self) -> bool {
        self.pattern().contains("{log}")
    }

    /// The name in the run folder of the artifact of a log, or of all logs.
    pub(crate) fn name(self, log: &str) -> String {
        self.pattern().replace("{log}", log)
    }

    /// The artifact with a name in the run folder, and its log.
    pub(crate) fn of_name(name: &str) -> Option<(Self, Option<&str>)> {
        Self::ALL.into_iter().find_map(|artifact| match artifact.pattern().split_once("{log}") {
            Some((before, after)) => {
                let log = name.strip_prefix(before)?.strip_suffix(after)?;
                Some((artifact, Some(log)))
            }
            None => (artifact.pattern() == name).then_some((artifact, None)),
        })
    }

    /// The stage that makes it.
    pub(crate) fn maker(self) -> Option<Stage> {
        Stage::ALL.into_iter().find(|stage| stage.spec().outputs.contains(&self))
    }

    /// The stage that makes the file at a path, by the last parts of the path: two, one, or more if the name of a
    /// log contains folders.
    pub(crate) fn maker_of_path(path: &Path) -> Option<Stage> {
        let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
        let few = [2, 1].into_iter().filter(|&n| n <= parts.len());
        few.chain(3..=parts.len()).find_map(|n| {
            let (artifact, _) = Self::of_name(&parts[parts.len() - n..].join("/"))?;
            artifact.maker()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_gives_artifact_log_and_stage() {
        let of = |name| {
            let (artifact, log) = Artifact::of_name(name)?;
            Some((artifact.maker()?.name(), log))
        };
        assert_eq!(of("scans/monday.parquet"), Some(("ingest", Some("monday"))));
        assert_eq!(of("poses/a.b.parquet"), Some(("ingest", Some("a.b"))));
        assert_eq!(of("logs/monday.mcap"), Some(("simulate", Some("monday"))));
        assert_eq!(of("pairs.parquet"), Some(("label", None)));
        assert_eq!(of("evaluation/summary.json"), Some(("evaluate", None)));
        assert_eq!(of("monday.mcap"), None);
        let of_path = |path| Artifact::maker_of_path(Path::new(path)).map(Stage::name);
        assert_eq!(of_path("runs/a/scans/monday.parquet"), Some("ingest"));
        assert_eq!(of_path("runs/a/scans/pairs.parquet"), Some("ingest"));
        assert_eq!(of_path("runs/a/scans/north/monday.parquet"), Some("ingest"));
        assert_eq!(of_path("pairs.parquet"), Some("label"));
        assert_eq!(of_path("runs/a/other.parquet"), None);
    }

    #[test]
    fn every_artifact_has_one_stage_that_makes_it() {
        for artifact in Artifact::ALL {
            let makers: Vec<_> = Stage::ALL
                .into_iter()
                .filter(|stage| stage.spec().outputs.contains(&artifact))
                .collect();
            assert_eq!(makers.len(), 1, "{artifact:?}: {makers:?}");
        }
    }

    /// A stage reads only what an earlier stage makes.
    #[test]
    fn stages_are_in_order_of_their_inputs() {
        for stage in Stage::ALL {
            for input in stage.spec().inputs {
                assert!(input.maker().is_some_and(|maker| maker < stage), "{stage} {input:?}");
            }
        }
    }

    #[test]
    fn every_stage_has_a_section_of_the_pipeline_file() {
        let schema = schemars::schema_for!(Config);
        for stage in Stage::ALL {
            assert!(schema.as_value()["properties"].get(stage.name()).is_some(), "{stage}");
        }
    }
}
