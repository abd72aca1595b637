//! Reading and writing `model.json`. Loading checks every value.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use semver::Version;
use serde::{Deserialize, Serialize};

use crate::detector_check::check_detector;
use crate::{
    Classifier, DETECTOR_VERSION, Detector, FORMAT_VERSION, FeatureSpec, Learner, MAX_DEPTH,
    Measured, Model, Node, OperatingPoint, ScanSpec, Training, Tree, WeakLearner, card,
};

/// Largest accepted file. A model with 50 rounds has about 10 kB.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// Why a model cannot be saved, loaded or used.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A file operation failed.
    #[error("cannot {action} {path}")]
    Io {
        /// `read` or `write`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        source: std::io::Error,
    },
    /// The version exists already.
    #[error("{path} already exists; a model version is never overwritten")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file is not JSON, or not JSON of a model.
    #[error("{path} is not a model")]
    NotAModel {
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        source: serde_json::Error,
    },
    /// The file is too large to be a model.
    #[error("{path} is not a model: it has {n_bytes} bytes, expected {MAX_FILE_BYTES} or less")]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Size of the file.
        n_bytes: u64,
    },
    /// The file is JSON without a format version.
    #[error("{path} is not a model: it has no `format_version`")]
    NoVersion {
        /// The file.
        path: PathBuf,
    },
    /// The file has another format version.
    #[error(
        "{path} has format version {found}, expected {FORMAT_VERSION}; train the model again with `loopboost train PIPELINE.toml --out DIR`"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The version found.
        found: String,
    },
    /// A value is not valid.
    #[error("{path}: {what}")]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The name of the value, the value, and what was expected.
        what: String,
    },
    /// The content was changed after the model was saved.
    #[error(
        "{path} was altered: its content has the digest {expected}, but the file states {found}; train the model again or restore the original file"
    )]
    Digest {
        /// The file.
        path: PathBuf,
        /// The digest in the file.
        found: String,
        /// The digest of the content.
        expected: String,
    },
    /// The scan is not of the kind that the model was trained on.
    #[error(
        "the scan covers {found} ({found_deg} deg), but the model was trained on scans that cover {trained_on} ({trained_deg} deg); use a model trained on scans of the same kind"
    )]
    ScanSpec {
        /// Smallest angle covered by a training scan \[deg\].
        trained_deg: f32,
        /// The kind of the training scans.
        trained_on: &'static str,
        /// Angle covered by the scan \[deg\].
        found_deg: f32,
        /// The kind of the scan.
        found: &'static str,
    },
}

/// The layout of `model.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "Model"))]
#[serde(deny_unknown_fields)]
pub(crate) struct ModelFile {
    format_version: u32,
    name: String,
    version: Version,
    /// BLAKE3 digest of this file with an empty `digest`, in hex.
    digest: String,
    program_version: String,
    seed: u64,
    learner: Learner,
    features: FeatureSpec,
    scans: ScanSpec,
    label_options: serde_json::Value,
    training: Training,
    measured: Vec<Measured>,
    operating_points: Vec<OperatingPoint>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    detector: Option<Detector>,
    rounds: Vec<Round>,
}

/// A weak learner, with its feature by name.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum Round {
    Vote { feature: String, threshold: f64, polarity: f64, alpha: f64 },
    Line { feature: String, slope: f64, intercept: f64 },
    Step { feature: String, threshold: f64, below: f64, above: f64 },
    Tree { nodes: Vec<Option<TreeNode>>, leaves: Vec<f64> },
}

/// A node of a tree: left if F < threshold, else right. Nodes are listed level by level, and the
/// children of node k are nodes 2 k + 1 and 2 k + 2. Leaves are listed from left to right. Null is a
/// node that sends every pair to the left.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
struct TreeNode {
    feature: String,
    threshold: f64,
}

/// A model version on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// The version.
    pub version: Version,
    /// Whether the version was written now. If not, the same model existed already.
    pub is_new: bool,
    /// The paths of `model.json` and `card.md`.
    pub files: Vec<PathBuf>,
}

/// The JSON Schema of `model.json`.
#[cfg(feature = "schema")]
pub fn schema() -> schemars::Schema {
    schemars::schema_for!(ModelFile)
}

/// Writes `<models>/<name>/<version>/model.json` and the model card `card.md` in the same folder.
///
/// The first version is 1.0.0. A later version increases the minor version of the newest one. It
/// increases the major version if the features, the kind of scans or the learner differ from the
/// newest version, or if the newest version cannot be loaded. If a version with the same content
/// exists, no new version is written; only a missing or altered card is written again.
///
/// `model.version` is ignored. Only one process may save at a time.
pub fn save(models: &Path, model: &Model) -> Result<Saved, ModelError> {
    let folder = models.join(&model.name);
    let invalid = |what| ModelError::Invalid { path: folder.clone(), what };
    let n_features = model.features.names.len();
    let mut splits = model.classifier.rounds.iter().flat_map(WeakLearner::splits);
    if let Some(split) = splits.find(|split| n_features <= split.feature) {
        let what = format!(
            "rounds: a round uses feature {}, expected less than {n_features}",
            split.feature
        );
        return Err(invalid(what));
    }
    check(&to_file(model)).map_err(invalid)?;
    let versions = versions(&folder)?;
    let files = |version: &Version| {
        let folder = folder.join(version.to_string());
        vec![folder.join("model.json"), folder.join("card.md")]
    };
    for version in versions.iter().rev() {
        let same = Model { version: version.clone(), ..model.clone() };
        let files = files(version);
        if fs::read_to_string(&files[0]).is_ok_and(|text| text == to_json(&same)) {
            // A run that was interrupted between the two files has written only the first one.
            write(&files[1], &card(&same))?;
            return Ok(Saved { version: version.clone(), is_new: false, files });
        }
    }
    let version = match versions.last() {
        None => Version::new(1, 0, 0),
        Some(newest) => match load(&files(newest)[0]) {
            Ok(existing) if existing.is_retrained_as(model) => {
                Version::new(newest.major, newest.minor + 1, 0)
            }
            _ => Version::new(newest.major + 1, 0, 0),
        },
    };
    let model = Model { version: version.clone(), ..model.clone() };
    let files = files(&version);
    if files[0].exists() {
        return Err(ModelError::Exists { path: files[0].clone() });
    }
    write(&files[0], &to_json(&model))?;
    write(&files[1], &card(&model))?;
    Ok(Saved { version, is_new: true, files })
}

/// The versions in the folder of a model, in ascending order.
fn versions(folder: &Path) -> Result<Vec<Version>, ModelError> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => {
            return Err(ModelError::Io { action: "read", path: folder.to_owned(), source });
        }
    };
    let mut versions: Vec<Version> = entries
        .filter_map(|entry| Version::parse(entry.ok()?.file_name().to_str()?).ok())
        .filter(|version| folder.join(version.to_string()).join("model.json").exists())
        .collect();
    versions.sort();
    Ok(versions)
}

/// Writes a temporary file and renames it when it is complete.
fn write(path: &Path, text: &str) -> Result<(), ModelError> {
    let io = |source| ModelError::Io { action: "write", path: path.to_owned(), source };
    let folder = path.parent().unwrap_or(Path::new(""));
    fs::create_dir_all(folder).map_err(io)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let partial = folder.join(format!(".{name}.partial"));
    let mut file = fs::File::create(&partial).map_err(io)?;
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    written.and_then(|()| fs::rename(&partial, path)).map_err(|source| {
        // The first error is the one to report.
        let _ = fs::remove_file(&partial);
        io(source)
    })
}

/// Loads a `model.json` and checks every value.
pub fn load(path: &Path) -> Result<Model, ModelError> {
    let io = |source| ModelError::Io { action: "read", path: path.to_owned(), source };
    let not_a_model = |source| ModelError::NotAModel { path: path.to_owned(), source };
    let n_bytes = fs::metadata(path).map_err(io)?.len();
    if MAX_FILE_BYTES < n_bytes {
        return Err(ModelError::TooLarge { path: path.to_owned(), n_bytes });
    }
    let bytes = fs::read(path).map_err(io)?;
    let peek: serde_json::Value = serde_json::from_slice(&bytes).map_err(not_a_model)?;
    match peek.get("format_version") {
        Some(found) if found == FORMAT_VERSION => {}
        Some(found) => {
            return Err(ModelError::Version { path: path.to_owned(), found: found.to_string() });
        }
        None => return Err(ModelError::NoVersion { path: path.to_owned() }),
    }
    let invalid = |what| ModelError::Invalid { path: path.to_owned(), what };
    // Another version may have other fields, so it is checked before the fields are parsed.
    if let Some(found) = peek.pointer("/detector/version").filter(|v| **v != DETECTOR_VERSION) {
        return Err(invalid(format!(
            "detector.version: {found}, expected {DETECTOR_VERSION}; train the model again with `loopboost train PIPELINE.toml --out DIR`"
        )));
    }
    // Parse the bytes and not `peek`: the error then contains the line, and duplicate fields fail.
    let file: ModelFile = serde_json::from_slice(&bytes).map_err(not_a_model)?;
    check(&file).map_err(invalid)?;
    let expected = digest(&file);
    if file.digest != expected {
        return Err(ModelError::Digest { path: path.to_owned(), found: file.digest, expected });
    }
    Ok(from_file(file))
}

fn to_json(model: &Model) -> String {
    json_of(&to_file(model))
}

fn json_of(file: &ModelFile) -> String {
    let mut json = serde_json::to_string_pretty(file).expect("a model can be serialised");
    json.push('\n');
    json
}

/// The BLAKE3 digest of the JSON of the file with an empty `digest`.
fn digest(file: &ModelFile) -> String {
    let file = ModelFile { digest: String::new(), ..file.clone() };
    blake3::hash(json_of(&file).as_bytes()).to_hex().to_string()
}

fn to_file(model: &Model) -> ModelFile {
    let name = |feature: usize| model.features.names[feature].clone();
    let rounds = model
        .classifier
        .rounds
        .iter()
        .map(|weak| match *weak {
            WeakLearner::Vote { feature, threshold, polarity, alpha } => {
                Round::Vote { feature: name(feature), threshold, polarity, alpha }
            }
            WeakLearner::Line { feature, slope, intercept } => {
                Round::Line { feature: name(feature), slope, intercept }
            }
            WeakLearner::Step { feature, threshold, below, above } => {
                Round::Step { feature: name(feature), threshold, below, above }
            }
            WeakLearner::Tree(ref tree) => {
                let node = |node: &Node| {
                    let Node { feature, threshold } = *node;
                    node.is_split().then(|| TreeNode { feature: name(feature), threshold })
                };
                let nodes = tree.nodes().iter().map(node).collect();
                Round::Tree { nodes, leaves: tree.leaves().to_vec() }
            }
        })
        .collect();
    let mut file = ModelFile {
        format_version: FORMAT_VERSION,
        name: model.name.clone(),
        version: model.version.clone(),
        digest: String::new(),
        program_version: model.program_version.clone(),
        seed: model.seed,
        learner: model.classifier.learner,
        features: model.features.clone(),
        scans: model.scans,
        label_options: model.label_options.clone(),
        training: model.training.clone(),
        measured: model.measured.clone(),
        operating_points: model.operating_points.clone(),
        detector: model.detector.clone(),
        rounds,
    };
    file.digest = digest(&file);
    file
}

/// The model of a file that passed [`check`].
fn from_file(file: ModelFile) -> Model {
    let index: BTreeMap<&str, usize> =
        file.features.names.iter().zip(0..).map(|(name, k)| (name.as_str(), k)).collect();
    let rounds = file
        .rounds
        .iter()
        .map(|round| match *round {
            Round::Vote { ref feature, threshold, polarity, alpha } => {
                WeakLearner::Vote { feature: index[&**feature], threshold, polarity, alpha }
            }
            Round::Line { ref feature, slope, intercept } => {
                WeakLearner::Line { feature: index[&**feature], slope, intercept }
            }
            Round::Step { ref feature, threshold, below, above } => {
                WeakLearner::Step { feature: index[&**feature], threshold, below, above }
            }
            Round::Tree { ref nodes, ref leaves } => {
                let node = |node: &Option<TreeNode>| match node {
                    Some(TreeNode { feature, threshold }) => {
                        Node { feature: index[&**feature], threshold: *threshold }
                    }
                    None => Node::PASS,
                };
                let nodes: Vec<Node> = nodes.iter().map(node).collect();
                WeakLearner::Tree(Tree::new(&nodes, leaves).expect("the file was checked"))
            }
        })
        .collect();
    Model {
        name: file.name,
        version: file.version,
        program_version: file.program_version,
        seed: file.seed,
        features: file.features,
        scans: file.scans,
        label_options: file.label_options,
        training: file.training,
        measured: file.measured,
        operating_points: file.operating_points,
        detector: file.detector,
        classifier: Classifier { learner: file.learner, rounds },
    }
}

impl Round {
    fn features(&self) -> Vec<&str> {
        match self {
            Self::Vote { feature, .. }
            | Self::Line { feature, .. }
            | Self::Step { feature, .. } => vec![feature],
            Self::Tree { nodes, .. } => {
                nodes.iter().flatten().map(|node| node.feature.as_str()).collect()
            }
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Vote { .. } => "vote",
            Self::Line { .. } => "line",
            Self::Step { .. } => "step",
            Self::Tree { .. } => "tree",
        }
    }

    /// The numbers of the round, with their names.
    fn numbers(&self) -> Vec<(String, f64)> {
        let named = |values: &[(&str, f64)]| {
            values.iter().map(|&(name, value)| (name.to_owned(), value)).collect()
        };
        match *self {
            Self::Vote { threshold, polarity, alpha, .. } => {
                named(&[("threshold", threshold), ("polarity", polarity), ("alpha", alpha)])
            }
            Self::Line { slope, intercept, .. } => {
                named(&[("slope", slope), ("intercept", intercept)])
            }
            Self::Step { threshold, below, above, .. } => {
                named(&[("threshold", threshold), ("below", below), ("above", above)])
            }
            Self::Tree { ref nodes, ref leaves } => {
                let of_node = |(k, node): (usize, &Option<TreeNode>)| {
                    Some((format!("nodes[{k}].threshold"), node.as_ref()?.threshold))
                };
                let thresholds = nodes.iter().enumerate().filter_map(of_node);
                let leaves = (0..).zip(leaves).map(|(k, leaf)| (format!("leaves[{k}]"), *leaf));
                thresholds.chain(leaves).collect()
            }
        }
    }
}

/// Checks every value. The error states the name of the value, the value, and what was expected.
fn check(file: &ModelFile) -> Result<(), String> {
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if file.name.is_empty() || file.name.starts_with('.') || !file.name.chars().all(is_allowed) {
        return Err(format!("name: `{}`, expected letters, digits, `-`, `_` and `.`", file.name));
    }
    let names: BTreeSet<&str> = file.features.names.iter().map(String::as_str).collect();
    if names.len() < file.features.names.len() {
        return Err("features.names: duplicate name, expected each name once".to_owned());
    }
    check_number("features.gate_m", file.features.gate_m)?;
    if file.features.gate_m <= 0.0 {
        return Err(format!("features.gate_m: {}, expected more than 0", file.features.gate_m));
    }
    check_scans(&file.scans)?;
    check_evidence(file)?;
    if let Some(detector) = &file.detector {
        check_detector(detector)?;
    }
    if file.rounds.is_empty() {
        return Err("rounds: none, expected at least one".to_owned());
    }
    let kind = match file.learner {
        Learner::Discrete => "vote",
        Learner::GentleLine => "line",
        Learner::GentleStump => "step",
        Learner::LogitTrees => "tree",
    };
    for (k, round) in file.rounds.iter().enumerate() {
        if round.kind() != kind {
            let (found, learner) = (round.kind(), file.learner.name());
            return Err(format!(
                "rounds[{k}].kind: `{found}` in a `{learner}` model, expected `{kind}`"
            ));
        }
        if let Some(feature) = round.features().into_iter().find(|name| !names.contains(name)) {
            return Err(format!("rounds[{k}].feature: `{feature}` is not among features.names"));
        }
        if let Round::Tree { nodes, leaves } = round
            && !(1..=MAX_DEPTH).any(|d| leaves.len() == 1 << d && nodes.len() + 1 == leaves.len())
        {
            let (n_nodes, n_leaves) = (nodes.len(), leaves.len());
            return Err(format!(
                "rounds[{k}]: {n_nodes} nodes and {n_leaves} leaves, expected 2^d - 1 and 2^d, d = 1 to {MAX_DEPTH}"
            ));
        }
        for (name, value) in round.numbers() {
            check_number(&format!("rounds[{k}].{name}"), value)?;
        }
        if let Round::Vote { polarity, .. } = round
            && polarity.abs().to_bits() != 1f64.to_bits()
        {
            return Err(format!("rounds[{k}].polarity: {polarity}, expected 1 or -1"));
        }
    }
    Ok(())
}

fn check_scans(scans: &ScanSpec) -> Result<(), String> {
    let ScanSpec { is_ring, coverage_min_deg, coverage_max_deg, range_min_m, range_max_m } = *scans;
    let (min_deg, max_deg) = (f64::from(coverage_min_deg), f64::from(coverage_max_deg));
    check_number("scans.coverage_min_deg", min_deg)?;
    check_number("scans.coverage_max_deg", max_deg)?;
    check_number("scans.range_min_m", range_min_m)?;
    check_number("scans.range_max_m", range_max_m)?;
    if !(0.0 <= min_deg && min_deg <= max_deg) {
        return Err(format!(
            "scans: coverage from {min_deg} to {max_deg} deg, expected 0 or more and in ascending order"
        ));
    }
    if is_ring != (FULL_RING_DEG <= min_deg) {
        return Err(format!(
            "scans.is_ring: {is_ring} with a coverage of {min_deg} deg, expected true for {FULL_RING_DEG} deg or more"
        ));
    }
    if !(0.0 <= range_min_m && range_min_m < range_max_m) {
        return Err(format!(
            "scans: ranges from {range_min_m} to {range_max_m} m, expected 0 or more and in ascending order"
        ));
    }
    Ok(())
}

/// Checks that warnings have a code and a count, that rates are between 0 and 1, and that thresholds
/// are finite.
fn check_evidence(file: &ModelFile) -> Result<(), String> {
    let is_code = |code: &str| {
        !code.is_empty()
            && code.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
    };
    for (code, &n) in &file.training.warnings {
        if !is_code(code) {
            return Err(format!("training.warnings: `{code}`, expected a snake_case code"));
        }
        if n == 0 {
            return Err(format!("training.warnings.{code}: 0, expected 1 or more"));
        }
    }
    let rate = |name: &str, value: f64| match (0.0..=1.0).contains(&value) {
        true => Ok(()),
        false => Err(format!("{name}: {value}, expected 0 to 1")),
    };
    for (k, measured) in file.measured.iter().enumerate() {
        rate(&format!("measured[{k}].error"), measured.error)?;
        rate(&format!("measured[{k}].precision"), measured.precision.unwrap_or(0.0))?;
        rate(&format!("measured[{k}].recall"), measured.recall)?;
    }
    for (k, point) in file.operating_points.iter().enumerate() {
        check_number(&format!("operating_points[{k}].threshold"), point.threshold)?;
        rate(&format!("operating_points[{k}].precision"), point.precision)?;
        rate(&format!("operating_points[{k}].recall"), point.recall)?;
        rate(&format!("operating_points[{k}].false_alarm"), point.false_alarm)?;
    }
    Ok(())
}

/// A closed ring covers at least this angle \[deg\] (docs/features.md). It equals
/// `dataset::FULL_RING_DEG`; this crate does not depend on `dataset`.
const FULL_RING_DEG: f64 = 355.0;

fn check_number(name: &str, value: f64) -> Result<(), String> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(format!("{name}: {value}, expected a finite number"))
    }
}
