//! The pipeline file: every parameter of a run, its defaults, and the checks of its values.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use ingest::{LidarOptions, PoseOptions};
use label::Grouping;
use schemars::{JsonSchema, schema_for};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::detection::{self, DetectSection, OptimizeSection};
use crate::logs::{self, LogFile, stem};
use crate::usage::{explain, explain_overrides};

pub(crate) use crate::usage::{UsageError, usage};

/// A pipeline file with all defaults filled in.
#[derive(Debug, Clone, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Pipeline")]
pub(crate) struct Config {
    /// Name of the run, and the first part of the names of its models. The default is the name of the
    /// file without its extension.
    #[serde(default)]
    pub(crate) name: String,
    /// Seed of every random draw.
    #[serde(default = "default_seed")]
    pub(crate) seed: u64,
    /// Simulates logs first. Without this section, all logs come from `ingest.logs`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) simulate: Option<simulate::Options>,
    #[serde(default)]
    pub(crate) ingest: IngestSection,
    #[serde(default)]
    pub(crate) subsample: subsample::Options,
    #[serde(default)]
    pub(crate) label: label::Options,
    #[serde(default)]
    pub(crate) featurize: featurize::Options,
    #[serde(default)]
    pub(crate) register: register::RegisterOptions,
    /// Finds loop closures, too. Without this section, only `loopboost detect` does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) detect: Option<DetectSection>,
    #[serde(default)]
    pub(crate) train: train::Options,
    #[serde(default)]
    pub(crate) optimize: OptimizeSection,
    #[serde(default)]
    pub(crate) evaluate: EvaluateSection,
    /// Folder of the pipeline file. Paths in `ingest.logs` are relative to it.
    #[serde(skip)]
    folder: PathBuf,
}

/// Any number would do; this is the number of pairs in the paper.
pub(crate) fn default_seed() -> u64 {
    2436
}

/// `[ingest]`
#[derive(Debug, Clone, Default, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct IngestSection {
    /// Files, folders or globs, relative to the pipeline file. A folder stands for its `*.mcap` files;
    /// the files of one split drive are one log.
    pub(crate) logs: Vec<String>,
    /// The map frame of all logs. Without it, each log has its own map frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) site: Option<String>,
    pub(crate) lidar: LidarOptions,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) pose: Option<PoseOptions>,
    /// Options of single logs, by name (the file stem, or `folder/stem` where several logs share it): `site`, `lidar` and `pose`, or any of their keys.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, LogOptions>")]
    pub(crate) log: BTreeMap<String, Table>,
}

/// `[evaluate]`: what `train` needs to measure the learners, and what `evaluate` needs for the report.
#[derive(Debug, Clone, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct EvaluateSection {
    /// Largest number of folds of the cross-validation. A grouping with fewer groups has one fold
    /// for each group.
    pub(crate) folds: u32,
    /// What is kept in one fold and never split between training and test. Each grouping is
    /// evaluated.
    pub(crate) groupings: Vec<Grouping>,
    /// Fail if a grouping leaves too few pairs to train on. Otherwise the grouping is left out, and
    /// the run and its report say so.
    pub(crate) require_groupings: bool,
    /// Width of the squares of ground of the grouping `place` \[m\].
    pub(crate) place_m: f64,
    /// Margin around the test ground of the grouping `place` \[m\]. No classifier is trained on a
    /// scan closer than this to the squares that it is tested on. With `label.positive_radius_m` or
    /// more, no training scan shows the place of a test scan; the default is twice its default.
    pub(crate) place_margin_m: f64,
    /// Bootstrap resamples of the groups for the confidence intervals; 0 gives no intervals.
    pub(crate) resamples: u32,
    /// Score all pairs of keyframes of each log too, at the natural prevalence of positives.
    pub(crate) retrieval: bool,
    /// For `retrieval`: leave out pairs with less path than this between their scans \[m\].
    pub(crate) min_separation_m: f64,
    /// For `retrieval`: largest number of pairs. If there are more, only every second, third, ...
    /// keyframe is a query, against all keyframes before it. A million pairs take about 25 MB.
    pub(crate) max_pairs: u64,
    /// The error under other label rules.
    pub(crate) grid: experiment::GridOptions,
    /// Where the ground truth comes from, with the options of `ingest.pose`. Only `train` and `evaluate`
    /// use it, to fit the detector and to measure closures and trajectories.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) truth: Option<PoseOptions>,
}

impl Default for EvaluateSection {
    fn default() -> Self {
        let experiment::Options {
            folds,
            groupings,
            require_groupings,
            place_m,
            place_margin_m,
            retrieval,
            min_separation_m,
            max_pairs,
            grid,
        } = experiment::Options::default();
        let evaluate::Options { resamples } = evaluate::Options::default();
        Self {
            folds,
            groupings,
            require_groupings,
            place_m,
            place_margin_m,
            resamples,
            retrieval,
            min_separation_m,
            max_pairs,
            grid,
            truth: None,
        }
    }
}

impl EvaluateSection {
    /// The options of each stage that uses this section: `train` and `evaluate`.
    fn split(&self) -> (experiment::Options, evaluate::Options) {
        // Without `..`: a new key must be given to a stage.
        let Self {
            folds,
            groupings,
            require_groupings,
            place_m,
            place_margin_m,
            resamples,
            retrieval,
            min_separation_m,
            max_pairs,
            grid,
            truth: _,
        } = self.clone();
        let experiment = experiment::Options {
            folds,
            groupings,
            require_groupings,
            place_m,
            place_margin_m,
            retrieval,
            min_separation_m,
            max_pairs,
            grid,
        };
        (experiment, evaluate::Options { resamples })
    }

    /// What `train` needs. The models depend on these keys and not on the others.
    pub(crate) fn experiment(&self) -> experiment::Options {
        self.split().0
    }

    fn check(&self, label: &label::Options) -> Result<()> {
        let (experiment, evaluate) = self.split();
        experiment.check(label)?;
        evaluate.check()?;
        if let Some(truth) = &self.truth {
            truth.check().context("`evaluate.truth` has the options of `ingest.pose`")?;
            if truth.run.is_some() {
                return Err(anyhow!(
                    "`evaluate.truth` sets `run`, but the map of a run is an estimate, and not ground truth; use a topic, transforms or a file of another source of poses"
                ));
            }
        }
        Ok(())
    }
}

/// The options of one log, with its overrides applied.
#[derive(Debug, Clone, Default, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct LogOptions {
    /// The map frame. The default is the name of the log.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) site: Option<String>,
    pub(crate) lidar: LidarOptions,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) pose: Option<PoseOptions>,
}

impl Config {
    /// Reads a pipeline file and applies `KEY=VALUE` overrides.
    pub(crate) fn load(path: &Path, overrides: &[String]) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .map_err(|e| usage(format!("cannot read the pipeline file {}: {e}", path.display())))?;
        let mut table: Table = toml::from_str(&text).map_err(|e| explain(path, &e))?;
        refuse_renamed(&table, &path.display())?;
        // Once without the overrides: an error then shows its line in the file ...
        toml::from_str::<Self>(&text).map_err(|e| explain(path, &e))?;
        // ... and once with the overrides.
        for text in overrides {
            apply_override(&mut table, text)?;
        }
        let mut config: Self = Value::Table(table)
            .try_into()
            .map_err(|e| explain_overrides(overrides, &schema_for!(Self), &e))?;
        config.folder = path.parent().map(Path::to_owned).unwrap_or_default();
        if config.name.is_empty() {
            config.name = stem(path);
        }
        config.check().map_err(|e| usage(format!("{}: {e:#}", path.display())))?;
        Ok(config)
    }

    /// The pipeline with every default written out.
    pub(crate) fn to_toml(&self) -> Result<String> {
        toml::to_string(self).context("cannot write the options as TOML")
    }

    /// The logs in `ingest.logs`, in the same order.
    pub(crate) fn log_files(&self) -> Result<Vec<LogFile>> {
        let mut files = Vec::new();
        for entry in &self.ingest.logs {
            files.extend(logs::find(&self.folder, entry)?);
        }
        logs::name_apart(&mut files, self.simulate.as_ref().map_or(&[], |simulate| &simulate.logs));
        Ok(files)
    }

    /// Whether the poses of a log are those of a finished run.
    pub(crate) fn uses_pose_run(&self) -> Result<bool> {
        let runs = |pose: Option<PoseOptions>| pose.is_some_and(|pose| pose.run.is_some());
        for log in self.ingest.log.keys() {
            if runs(self.for_log(log)?.pose) {
                return Ok(true);
            }
        }
        Ok(runs(self.ingest.pose.clone()))
    }

    /// The pipeline of [`Config::to_toml`], as if its file were in this folder.
    pub(crate) fn from_toml(text: &str, folder: PathBuf) -> Result<Self> {
        let config: Self = toml::from_str(text).context("cannot read the options as TOML")?;
        Ok(Self { folder, ..config })
    }

    /// Resolves a path in the pipeline file, which is relative to the file.
    pub(crate) fn beside_pipeline(&self, path: &str) -> PathBuf {
        self.folder.join(path)
    }

    /// The file with the poses of a log, from `ingest.pose.file`.
    pub(crate) fn pose_file(&self, log: &str) -> Result<Option<PathBuf>> {
        let file = self.for_log(log)?.pose.and_then(|pose| pose.file_of(log));
        Ok(file.map(|file| self.beside_pipeline(&file)))
    }

    /// The file with the ground truth of a log, from `evaluate.truth.file`.
    pub(crate) fn truth_file(&self, log: &str) -> Option<PathBuf> {
        let file = self.evaluate.truth.as_ref()?.file_of(log)?;
        Some(self.beside_pipeline(&file))
    }

    /// The options of `detect`, which has defaults for a pipeline without the section.
    pub(crate) fn detection(&self) -> DetectSection {
        self.detect.clone().unwrap_or_default()
    }

    /// The options of one log.
    pub(crate) fn for_log(&self, log: &str) -> Result<LogOptions> {
        let IngestSection { site, lidar, pose, .. } = self.ingest.clone();
        let common = LogOptions { site, lidar, pose };
        let Some(own) = self.ingest.log.get(log) else { return Ok(common) };
        let mut merged = Table::try_from(&common).context("options are TOML")?;
        merge(&mut merged, own);
        let section = format!("[ingest.log.{log}]");
        let options: LogOptions =
            Value::Table(merged).try_into().map_err(|e| explain(Path::new(&section), &e))?;
        options.lidar.check().map_err(|e| usage(format!("{section}: {e}")))?;
        if let Some(pose) = &options.pose {
            pose.check().map_err(|e| usage(format!("{section}: {e}")))?;
        }
        Ok(options)
    }

    fn check(&self) -> Result<()> {
        let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if !self.name.chars().all(legal) || self.name.starts_with('.') {
            return Err(anyhow!(
                "`name` is `{}`, expected letters, digits, `-`, `_` and `.`, because folders are named after it; set `name` in the pipeline file",
                self.name
            ));
        }
        self.ingest.lidar.check()?;
        if let Some(pose) = &self.ingest.pose {
            pose.check()?;
        }
        self.subsample.check()?;
        self.label.check()?;
        self.featurize.check()?;
        if let Some(simulate) = &self.simulate {
            simulate.check().context("[simulate]")?;
        }
        detection::check(&self.register, &self.detection(), &self.optimize)?;
        self.train.check()?;
        if self.train.learners.is_empty() && self.detect.is_none() {
            return Err(anyhow!(
                "`train.learners` is [], expected at least one learner, or a section [detect] for a run that only finds loop closures"
            ));
        }
        self.evaluate.check(&self.label)?;
        for log in self.ingest.log.keys() {
            self.for_log(log)?;
        }
        Ok(())
    }
}

/// Keys that have a new name, old and new.
const RENAMED: [(&str, &str); 2] = [
    ("evaluate.every_pair", "evaluate.retrieval"),
    ("evaluate.recent_m", "evaluate.min_separation_m"),
];

/// Refuses a key that has a new name, and states that name.
fn refuse_renamed(table: &Table, place: &dyn std::fmt::Display) -> Result<()> {
    let contains = |key: &str| {
        let (sections, name) = key.rsplit_once('.').unwrap_or(("", key));
        let mut sections = sections.split_terminator('.');
        let section = sections.try_fold(table, |table, section| table.get(section)?.as_table());
        section.is_some_and(|section| section.contains_key(name))
    };
    match RENAMED.iter().find(|(old, _)| contains(old)) {
        Some((old, new)) => Err(usage(format!("{place}: `{old}` was renamed: use `{new}`"))),
        None => Ok(()),
    }
}

/// Applies `a.b.c=value` to a table. The value is parsed as TOML; if it is not TOML, it is a string. A
/// key that contains dots is quoted as in TOML: `ingest.log."a.b".site=x`.
fn apply_override(table: &mut Table, text: &str) -> Result<()> {
    let (key, value) = text.split_once('=').ok_or_else(|| {
        usage(format!("--set {text}: expected KEY=VALUE, such as label.positive_radius_m=2"))
    })?;
    let parsed = toml::from_str::<Table>(&format!("{key} = {value}"))
        .or_else(|_| {
            toml::from_str::<Table>(&format!("{key} = {}", Value::String(value.to_owned())))
        })
        .map_err(|e| usage(format!("--set {text}: {}", e.message())))?;
    refuse_renamed(&parsed, &format_args!("--set {text}"))?;
    merge(table, &parsed);
    Ok(())
}

/// Poses have one source: a new source replaces the old one.
fn remove_other_sources(pose: &mut Table, over: &Table) {
    const SOURCES: [&str; 5] = ["topic", "frames", "file", "wheels", "run"];
    let Some(source) = SOURCES.into_iter().find(|source| over.contains_key(*source)) else {
        return;
    };
    SOURCES.into_iter().filter(|other| *other != source).for_each(|other| {
        pose.remove(other);
    });
    if source != "wheels" {
        pose.remove("imu");
    }
    if source != "topic" {
        pose.remove("origin");
    }
}

/// Merges one table into another, section by section.
fn merge(base: &mut Table, over: &Table) {
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(base)), Value::Table(over)) => {
                if ["pose", "truth"].contains(&key.as_str()) {
                    remove_other_sources(base, over);
                }
                merge(base, over);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str, overrides: &[&str]) -> Result<Config> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.toml");
        std::fs::write(&path, text).unwrap();
        Config::load(&path, &overrides.iter().map(|&s| s.to_owned()).collect::<Vec<_>>())
    }

    fn error(text: &str, overrides: &[&str]) -> String {
        let error = load(text, overrides).unwrap_err();
        assert!(error.is::<UsageError>());
        format!("{error:#}")
    }

    #[test]
    fn an_empty_file_gives_all_defaults_and_the_printed_defaults_can_be_read() {
        let config = load("", &[]).unwrap();
        assert_eq!((config.name.as_str(), config.seed), ("drive", 2436));
        assert_eq!(config.label.pairs_per_class, 1218);
        let printed = config.to_toml().unwrap();
        assert!(printed.contains("spacing_m = 0.5"), "{printed}");
        assert_eq!(load(&printed, &[]).unwrap().to_toml().unwrap(), printed);
    }

    #[test]
    fn an_override_takes_precedence_over_the_file() {
        let file = "[label]\npositive_radius_m = 1.0\n";
        let config = load(
            file,
            &["label.positive_radius_m=2", "name=other", "train.learners=[\"discrete\"]"],
        )
        .unwrap();
        assert!((config.label.positive_radius_m - 2.0).abs() < 1e-12);
        assert_eq!(config.name, "other");
        assert_eq!(config.train.learners, [train::Learner::Discrete]);
    }

    #[test]
    fn an_unknown_key_is_an_error_that_names_the_most_similar_key() {
        let message = error("[subsample]\nspacing = 0.5\n", &[]);
        assert!(message.contains("spacing = 0.5"), "the message shows the line: {message}");
        assert!(message.contains("did you mean `spacing_m`?"), "{message}");
        assert!(error("sed = 3\n", &[]).contains("did you mean `seed`?"));
        for (key, expected) in [
            ("label.positive_radius", "label.positive_radius_m"),
            ("positive_radius_m", "evaluate.grid.positive_radius_m` or `label.positive_radius_m"),
            ("pose.topic", "ingest.pose.topic"),
            ("ingest.pose.topc", "ingest.pose.topic"),
            ("lidar.ring", "ingest.lidar.ring"),
            ("truth.topic", "evaluate.truth.topic"),
            ("discrete.rounds", ""),
            ("label.x", ""),
            ("train.seed", ""),
            ("evaluate.foo", ""),
            ("upside_down", "ingest.lidar.upside_down` or `simulate.upside_down"),
        ] {
            let message = error("", &[&format!("{key}=2")]);
            let hint = message.split_once("did you mean `").map_or("", |(_, hint)| hint);
            assert_eq!(hint.trim_end_matches("`?"), expected, "{message}");
        }
        // The first key is right, and a part of the second one is unknown.
        let message = error("", &["label.place_m=4", "train.place_m=3"]);
        assert!(!message.contains("did you mean `label"), "{message}");
        assert!(error("", &["label={positive_radius=2}"]).contains("`positive_radius_m`?"));
        assert!(
            error("[train]\nlearners = [\"gentle\"]\n", &[])
                .contains("did you mean `gentle_line`?")
        );
        let message = error("[ingest.log.a.lidar]\nrange_max = 9.0\n", &[]);
        assert!(message.contains("did you mean `range_max_m`?"), "{message}");
    }

    #[test]
    fn a_name_that_is_not_similar_is_not_suggested() {
        assert!(!error("frobnicate = 3\n", &[]).contains("did you mean"));
        assert!(!error("[label]\nx = 3\n", &[]).contains("did you mean"));
    }

    #[test]
    fn a_wrong_type_is_explained_in_plain_words() {
        let radius = error("[label]\npositive_radius_m = \"2\"\n", &[]);
        assert!(radius.contains("found the text \"2\", expected a number"), "{radius}");
        let pairs = error("[label]\npairs_per_class = -3\n", &[]);
        assert!(
            pairs.contains("found the number `-3`, expected a whole number, 0 or more"),
            "{pairs}"
        );
        let pairs = error("", &["label.pairs_per_class=1.5"]);
        assert!(pairs.contains("found the number `1.5`, expected a whole number"), "{pairs}");
        let logs = error("[ingest]\nlogs = \"a.mcap\"\n", &[]);
        assert!(logs.contains("found the text \"a.mcap\", expected a list"), "{logs}");
        for message in [radius, pairs, logs] {
            assert!(!message.contains("invalid type") && !message.contains("f64"), "{message}");
        }
    }

    #[test]
    fn a_renamed_key_gives_an_error_with_the_new_name() {
        let expected = "`evaluate.recent_m` was renamed: use `evaluate.min_separation_m`";
        let of_file = error("[evaluate]\nrecent_m = 20.0\n", &[]);
        assert!(of_file.ends_with(&format!("drive.toml: {expected}")), "{of_file}");
        let of_override = error("", &["evaluate.recent_m=20"]);
        assert_eq!(of_override, format!("--set evaluate.recent_m=20: {expected}"));
        assert!(error("evaluate.every_pair = true", &[]).ends_with("use `evaluate.retrieval`"));
    }

    /// The message must not lead to a key that does not exist.
    #[test]
    fn every_new_name_of_a_renamed_key_is_known() {
        let known = Table::try_from(load("", &[]).unwrap()).unwrap();
        for (old, new) in RENAMED {
            let value = new
                .split('.')
                .try_fold(&Value::Table(known.clone()), |table, key| table.get(key))
                .cloned();
            assert!(value.is_some(), "{old} -> {new}");
        }
    }

    #[test]
    fn a_value_out_of_range_is_an_error_that_names_the_key() {
        assert!(
            error("[label]\nnegative_min_m = 1.0\n", &[]).contains("`label.negative_min_m` is 1")
        );
        assert!(error("[evaluate]\nfolds = 1\n", &[]).contains("`evaluate.folds` is 1"));
        assert!(
            error("", &["ingest.lidar.range_max_m=0.5"])
                .contains("`ingest.lidar.range_max_m` is 0.5")
        );
        assert!(error("name = \"a/b\"\n", &[]).contains("`name` is `a/b`"));
        assert!(error("", &["seed"]).contains("expected KEY=VALUE"));
    }

    #[test]
    fn a_log_can_have_its_own_options() {
        let config = load(
            "[ingest]\nsite = \"mit\"\n[ingest.pose]\ntopic = \"/pose\"\n[ingest.log.b]\nsite = \"aces\"\nlidar.range_max_m = 30.0\n",
            &[],
        )
        .unwrap();
        let (a, b) = (config.for_log("a").unwrap(), config.for_log("b").unwrap());
        assert_eq!((a.site.as_deref(), b.site.as_deref()), (Some("mit"), Some("aces")));
        assert!(
            (b.lidar.range_max_m - 30.0).abs() < 1e-12
                && (a.lidar.range_max_m - 70.0).abs() < 1e-12
        );
        assert_eq!(b.pose.unwrap().topic.as_deref(), Some("/pose"));
    }
}
