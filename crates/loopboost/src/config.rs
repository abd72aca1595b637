//! The pipeline file: every parameter of a run, its defaults, and what is wrong with it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use ingest::{LidarOptions, PoseOptions};
use label::Grouping;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};
use train::Learner;

use crate::logs::{self, LogFile};

/// The command line or the pipeline file is not understood; exit code 2.
#[derive(Debug)]
pub(crate) struct UsageError(String);

impl std::fmt::Display for UsageError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

pub(crate) fn usage(message: impl std::fmt::Display) -> anyhow::Error {
    UsageError(message.to_string()).into()
}

/// A pipeline file, all defaults resolved.
#[derive(Debug, Clone, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Pipeline")]
pub(crate) struct Config {
    /// Names the run and its models; the file's stem unless given.
    #[serde(default)]
    pub(crate) name: String,
    /// Every random draw comes from it.
    #[serde(default = "default_seed")]
    pub(crate) seed: u64,
    /// Makes the logs first; without it logs come from `ingest.logs` alone.
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
    pub(crate) train: train::Options,
    #[serde(default)]
    pub(crate) evaluate: EvaluateSection,
    /// Folder of the pipeline file; `ingest.logs` is relative to it.
    #[serde(skip)]
    folder: PathBuf,
}

/// The paper's pair count as a seed, as good as any.
fn default_seed() -> u64 {
    2436
}

/// `[ingest]`
#[derive(Debug, Clone, Default, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct IngestSection {
    /// Files, folders (their `*.mcap`, those that were split from one drive together) or globs,
    /// relative to the pipeline file.
    pub(crate) logs: Vec<String>,
    /// The map frame of all logs; without it each log has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) site: Option<String>,
    pub(crate) lidar: LidarOptions,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) pose: Option<PoseOptions>,
    /// Per log, by file stem: any of `site`, `lidar` and `pose`, or of their keys.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, LogOptions>")]
    pub(crate) log: BTreeMap<String, Table>,
}

/// More rounds than anybody boosts; a slip of the hand would take all memory.
const MAX_ROUNDS: u32 = 100_000;
/// As for the rounds.
const MAX_RESAMPLES: u32 = 100_000;

/// `[evaluate]`
#[derive(Debug, Clone, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct EvaluateSection {
    /// Folds of the cross-validation, at most: a grouping with fewer groups has a fold for each.
    pub(crate) folds: u32,
    /// What may not stand on both sides of a fold; each is evaluated.
    pub(crate) groupings: Vec<Grouping>,
    /// A grouping that leaves too little to train on ends the run; otherwise it is left out, which
    /// the run and its report tell.
    pub(crate) require_groupings: bool,
    /// Width of the squares of ground that the grouping `place` keeps together \[m\].
    pub(crate) place_m: f64,
    /// Bootstrap resamples of the groups, for confidence intervals; 0 gives none.
    pub(crate) resamples: u32,
    /// Score every pair of keyframes of each log too, at the natural prevalence of positives.
    pub(crate) every_pair: bool,
    /// Of these, pairs with less path than this between them are left out \[m\].
    pub(crate) recent_m: f64,
    /// More pairs than this are thinned: every second, third, ... keyframe is a query, against all
    /// keyframes before it. A million pairs take about 25 MB.
    pub(crate) max_pairs: u64,
    /// The error under other label rules.
    pub(crate) grid: GridSection,
}

impl Default for EvaluateSection {
    fn default() -> Self {
        Self {
            folds: 10,
            groupings: vec![Grouping::Pair, Grouping::Place],
            require_groupings: false,
            place_m: 20.0,
            resamples: 1000,
            every_pair: true,
            recent_m: 30.0,
            max_pairs: 20_000_000,
            grid: GridSection::default(),
        }
    }
}

impl EvaluateSection {
    fn check(&self) -> Result<()> {
        if self.folds < 2 {
            return Err(anyhow!("`evaluate.folds` is {}, expected 2 or more", self.folds));
        }
        if self.groupings.iter().collect::<BTreeSet<_>>().len() < self.groupings.len() {
            return Err(anyhow!("`evaluate.groupings` names a grouping twice"));
        }
        if self.groupings.is_empty() {
            return Err(anyhow!("`evaluate.groupings` is empty, expected at least `pair`"));
        }
        let more_than_0 = |value: f64| value.is_finite() && 0.0 < value;
        if !more_than_0(self.place_m) {
            return Err(anyhow!("`evaluate.place_m` is {}, expected more than 0", self.place_m));
        }
        if !(self.recent_m.is_finite() && 0.0 <= self.recent_m) {
            return Err(anyhow!("`evaluate.recent_m` is {}, expected 0 or more", self.recent_m));
        }
        if self.max_pairs == 0 {
            return Err(anyhow!("`evaluate.max_pairs` is 0, expected 1 or more"));
        }
        if MAX_RESAMPLES < self.resamples {
            return Err(anyhow!(
                "`evaluate.resamples` is {}, expected 0 to {MAX_RESAMPLES}",
                self.resamples
            ));
        }
        Ok(())
    }
}

/// `[evaluate.grid]`: the error for every combination of three label options. It is off where a
/// list is empty.
#[derive(Debug, Clone, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct GridSection {
    /// Values of `label.positive_radius_m` \[m\].
    pub(crate) positive_radius_m: Vec<f64>,
    /// Values of `label.negative_min_m` \[m\].
    pub(crate) negative_min_m: Vec<f64>,
    /// Values of `label.min_travel_gap_m` \[m\]: 0 takes neighbours along the path too, more
    /// takes true revisits only.
    pub(crate) min_travel_gap_m: Vec<f64>,
    /// Which learners.
    pub(crate) learners: Vec<Learner>,
    /// What may not stand on both sides of a fold.
    pub(crate) grouping: Grouping,
}

impl Default for GridSection {
    fn default() -> Self {
        Self {
            positive_radius_m: Vec::new(),
            negative_min_m: Vec::new(),
            min_travel_gap_m: vec![0.0],
            learners: vec![Learner::GentleStump],
            grouping: Grouping::Place,
        }
    }
}

impl GridSection {
    /// The label options of each cell.
    pub(crate) fn cells(&self, label: &label::Options) -> Vec<label::Options> {
        let mut cells = Vec::new();
        for &min_travel_gap_m in &self.min_travel_gap_m {
            for &negative_min_m in &self.negative_min_m {
                for &positive_radius_m in &self.positive_radius_m {
                    cells.push(label::Options {
                        positive_radius_m,
                        negative_min_m,
                        min_travel_gap_m,
                        ..label.clone()
                    });
                }
            }
        }
        cells
    }
}

/// What holds for one log, its overrides applied.
#[derive(Debug, Clone, Default, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct LogOptions {
    /// The map frame; the log's own name unless given.
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
        // Once as it stands, so that an error shows its line ...
        toml::from_str::<Self>(&text).map_err(|e| explain(path, &e))?;
        // ... and once with the overrides.
        let mut table: Table = toml::from_str(&text).map_err(|e| explain(path, &e))?;
        for text in overrides {
            apply_override(&mut table, text)?;
        }
        let mut config: Self = Value::Table(table)
            .try_into()
            .map_err(|e| explain(Path::new(&format!("--set {}", overrides.join(" --set "))), &e))?;
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

    /// The logs that `ingest.logs` names, in its order.
    pub(crate) fn log_files(&self) -> Result<Vec<LogFile>> {
        let mut files = Vec::new();
        for entry in &self.ingest.logs {
            files.extend(logs::find(&self.folder, entry)?);
        }
        Ok(files)
    }

    /// A path that the pipeline file names, which is relative to it.
    pub(crate) fn beside_pipeline(&self, path: &str) -> PathBuf {
        self.folder.join(path)
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
                "`name` is `{}`, expected letters, digits, `-`, `_` and `.`, since it names folders: set `name`",
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
        for (key, rounds) in
            [("rounds", self.train.rounds), ("tree_rounds", self.train.tree_rounds)]
        {
            if !(1..=MAX_ROUNDS).contains(&rounds) {
                return Err(anyhow!("`train.{key}` is {rounds}, expected 1 to {MAX_ROUNDS}"));
            }
        }
        if self.train.learners.is_empty() {
            return Err(anyhow!("`train.learners` is empty, expected at least one learner"));
        }
        if self.train.learners.iter().collect::<BTreeSet<_>>().len() < self.train.learners.len() {
            return Err(anyhow!("`train.learners` names a learner twice"));
        }
        self.evaluate.check()?;
        for cell in self.evaluate.grid.cells(&self.label) {
            cell.check().map_err(|e| anyhow!("[evaluate.grid], as {e}"))?;
        }
        if self.label.pairs_per_class < self.evaluate.folds as usize {
            return Err(anyhow!(
                "`evaluate.folds` is {}, expected no more than `label.pairs_per_class`, which is {}",
                self.evaluate.folds,
                self.label.pairs_per_class
            ));
        }
        for log in self.ingest.log.keys() {
            self.for_log(log)?;
        }
        Ok(())
    }
}

/// A file's name without its last extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Lays `a.b.c=value` over a table; the value is TOML, or else a string. A key with dots in it is
/// quoted as in TOML: `ingest.log."a.b".site=x`.
fn apply_override(table: &mut Table, text: &str) -> Result<()> {
    let (key, value) = text.split_once('=').ok_or_else(|| {
        usage(format!("--set {text}: expected KEY=VALUE, such as label.positive_radius_m=2"))
    })?;
    let parsed = toml::from_str::<Table>(&format!("{key} = {value}"))
        .or_else(|_| {
            toml::from_str::<Table>(&format!("{key} = {}", Value::String(value.to_owned())))
        })
        .map_err(|e| usage(format!("--set {text}: {}", e.message())))?;
    merge(table, &parsed);
    Ok(())
}

/// Poses come from one place: what names another one takes the place of that.
fn give_up_other_sources(pose: &mut Table, over: &Table) {
    const SOURCES: [&str; 3] = ["topic", "frames", "wheels"];
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

/// Lays one table over another, section by section.
fn merge(base: &mut Table, over: &Table) {
    for (key, value) in over {
        match (base.get_mut(key), value) {
            (Some(Value::Table(base)), Value::Table(over)) => {
                if key == "pose" {
                    give_up_other_sources(base, over);
                }
                merge(base, over);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

/// A TOML error with its place and, for an unknown key or name, the nearest known one.
fn explain(place: &Path, error: &toml::de::Error) -> anyhow::Error {
    let mut text = format!("{}: {}", place.display(), error.to_string().trim_end());
    let message = error.message();
    if let Some(known) =
        message.split("expected one of ").nth(1).or(message.split("expected ").nth(1))
        && message.starts_with("unknown ")
    {
        let unknown = message.split('`').nth(1).unwrap_or_default();
        let nearest = known.split('`').skip(1).step_by(2).max_by(|a, b| {
            strsim::jaro_winkler(unknown, a).total_cmp(&strsim::jaro_winkler(unknown, b))
        });
        if let Some(nearest) = nearest {
            text.push_str(&format!("\nhint: did you mean `{nearest}`?"));
        }
    }
    usage(text)
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
    fn an_empty_file_has_all_defaults_and_they_can_be_read_again() {
        let config = load("", &[]).unwrap();
        assert_eq!((config.name.as_str(), config.seed), ("drive", 2436));
        assert_eq!(config.label.pairs_per_class, 1218);
        let printed = config.to_toml().unwrap();
        assert!(printed.contains("spacing_m = 0.5"), "{printed}");
        assert_eq!(load(&printed, &[]).unwrap().to_toml().unwrap(), printed);
    }

    #[test]
    fn overrides_beat_the_file() {
        let file = "[label]\npositive_radius_m = 1.0\n";
        let config = load(
            file,
            &["label.positive_radius_m=2", "name=other", "train.learners=[\"discrete\"]"],
        )
        .unwrap();
        assert!((config.label.positive_radius_m - 2.0).abs() < 1e-12);
        assert_eq!(config.name, "other");
        assert_eq!(config.train.learners, [Learner::Discrete]);
    }

    #[test]
    fn an_unknown_key_fails_and_names_the_nearest() {
        let message = error("[subsample]\nspacing = 0.5\n", &[]);
        assert!(message.contains("spacing = 0.5"), "shows the line: {message}");
        assert!(message.contains("did you mean `spacing_m`?"), "{message}");
        assert!(error("sed = 3\n", &[]).contains("did you mean `seed`?"));
        assert!(
            error("", &["label.positive_radius=2"]).contains("did you mean `positive_radius_m`?")
        );
        assert!(
            error("[train]\nlearners = [\"gentle\"]\n", &[])
                .contains("did you mean `gentle_line`?")
        );
        let message = error("[ingest.log.a.lidar]\nrange_max = 9.0\n", &[]);
        assert!(message.contains("did you mean `range_max_m`?"), "{message}");
    }

    #[test]
    fn values_out_of_range_are_named() {
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
    fn a_log_can_have_options_of_its_own() {
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
