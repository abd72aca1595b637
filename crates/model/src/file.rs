//! `model.json`: written once, read with every value checked.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use semver::Version;
use serde::{Deserialize, Serialize};

use crate::{
    Classifier, FORMAT_VERSION, FeatureSpec, Learner, Measured, Model, OperatingPoint, ScanSpec,
    Training, WeakLearner,
};

/// A file larger than this is no model of ours; 50 rounds take about 10 kB.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// What can be wrong with a model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The system refused.
    #[error("cannot {action} {path}: {source}")]
    Io {
        /// "read", "write", ...
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// A version is never overwritten.
    #[error("{path} exists; a model version is never overwritten")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file is no `model.json`.
    #[error("{path} is not a model: {detail}")]
    NotAModel {
        /// The file.
        path: PathBuf,
        /// The decoder's word.
        detail: String,
    },
    /// Another format version.
    #[error(
        "{path} has format version {found}, this program reads version {FORMAT_VERSION}; train the model again with `loopboost train PIPELINE.toml --out DIR`"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The version found.
        found: String,
    },
    /// A value that cannot be.
    #[error("{path}: {what}")]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Which value, what it is, and what it must be.
        what: String,
    },
    /// Scans that the model was not made for.
    #[error(
        "the model was trained on {trained_on} ({trained_deg} deg), the scan is one of {found} ({found_deg} deg); use a model of such scans"
    )]
    ScanSpec {
        /// Angle swept by the training scans \[deg\].
        trained_deg: f32,
        /// What these are.
        trained_on: &'static str,
        /// Angle swept by the scan \[deg\].
        found_deg: f32,
        /// What it is.
        found: &'static str,
    },
}

/// The layout of `model.json`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelFile {
    format_version: u32,
    name: String,
    version: Version,
    program_version: String,
    seed: u64,
    learner: Learner,
    features: FeatureSpec,
    scans: ScanSpec,
    label_options: serde_json::Value,
    training: Training,
    measured: Vec<Measured>,
    operating_points: Vec<OperatingPoint>,
    rounds: Vec<Round>,
}

/// A weak learner, its feature by name.
#[derive(Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum Round {
    Vote { feature: String, threshold: f64, polarity: f64, alpha: f64 },
    Line { feature: String, slope: f64, intercept: f64 },
    Step { feature: String, threshold: f64, below: f64, above: f64 },
}

/// Writes `<models>/<name>/<version>/model.json`, which must not exist; returns its path.
pub fn save(models: &Path, model: &Model) -> Result<PathBuf, ModelError> {
    let folder = models.join(&model.name).join(model.version.to_string());
    let path = folder.join("model.json");
    let io = |source| ModelError::Io { action: "write", path: path.clone(), source };
    if path.exists() {
        return Err(ModelError::Exists { path });
    }
    fs::create_dir_all(&folder).map_err(io)?;
    let partial = folder.join(".model.json.partial");
    let mut file = fs::File::create(&partial).map_err(io)?;
    file.write_all(to_json(model).as_bytes()).map_err(io)?;
    file.sync_all().map_err(io)?;
    fs::rename(&partial, &path).map_err(io)?;
    Ok(path)
}

/// Reads a `model.json` and checks every value of it.
pub fn load(path: &Path) -> Result<Model, ModelError> {
    let io = |source| ModelError::Io { action: "read", path: path.to_owned(), source };
    let not_a_model = |detail: String| ModelError::NotAModel { path: path.to_owned(), detail };
    let size = fs::metadata(path).map_err(io)?.len();
    if MAX_FILE_BYTES < size {
        return Err(not_a_model(format!("{size} bytes, a model has at most {MAX_FILE_BYTES}")));
    }
    let bytes = fs::read(path).map_err(io)?;
    let value: serde_json::Value =
        serde_json::from_slice(&bytes).map_err(|e| not_a_model(e.to_string()))?;
    match value.get("format_version") {
        Some(found) if found == FORMAT_VERSION => {}
        Some(found) => {
            return Err(ModelError::Version { path: path.to_owned(), found: found.to_string() });
        }
        None => return Err(not_a_model("it has no `format_version`".to_owned())),
    }
    let file: ModelFile = serde_json::from_value(value).map_err(|e| not_a_model(e.to_string()))?;
    from_file(file).map_err(|what| ModelError::Invalid { path: path.to_owned(), what })
}

/// The version for a model to be saved, given those under the same name: 1.0.0 for the first;
/// the existing one where nothing but the version differs; else one minor version more, or one
/// major where the features or the scans are others. The flag tells whether it is to be saved.
pub fn next_version(models: &Path, model: &Model) -> Result<(Version, bool), ModelError> {
    let folder = models.join(&model.name);
    let entries = match fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Ok((Version::new(1, 0, 0), true));
        }
        Err(source) => return Err(ModelError::Io { action: "read", path: folder, source }),
    };
    let newest = entries
        .filter_map(|entry| Version::parse(entry.ok()?.file_name().to_str()?).ok())
        .filter(|version| folder.join(version.to_string()).join("model.json").exists())
        .max();
    let Some(newest) = newest else { return Ok((Version::new(1, 0, 0), true)) };
    // A version that cannot be read is left where it is, and what follows it is another.
    let Ok(existing) = load(&folder.join(newest.to_string()).join("model.json")) else {
        return Ok((Version::new(newest.major + 1, 0, 0), true));
    };
    if to_json(&Model { version: newest.clone(), ..model.clone() }) == to_json(&existing) {
        return Ok((newest, false));
    }
    let compatible = existing.features == model.features
        && existing.scans.is_ring == model.scans.is_ring
        && existing.classifier.learner == model.classifier.learner;
    Ok(match compatible {
        true => (Version::new(newest.major, newest.minor + 1, 0), true),
        false => (Version::new(newest.major + 1, 0, 0), true),
    })
}

fn to_json(model: &Model) -> String {
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
        })
        .collect();
    let file = ModelFile {
        format_version: FORMAT_VERSION,
        name: model.name.clone(),
        version: model.version.clone(),
        program_version: model.program_version.clone(),
        seed: model.seed,
        learner: model.classifier.learner,
        features: model.features.clone(),
        scans: model.scans,
        label_options: model.label_options.clone(),
        training: model.training.clone(),
        measured: model.measured.clone(),
        operating_points: model.operating_points.clone(),
        rounds,
    };
    let mut json = serde_json::to_string_pretty(&file).expect("a model serialises into memory");
    json.push('\n');
    json
}

fn from_file(file: ModelFile) -> Result<Model, String> {
    check_number("features.gate_m", file.features.gate_m)?;
    check_number("scans.range_min_m", file.scans.range_min_m)?;
    check_number("scans.range_max_m", file.scans.range_max_m)?;
    for (k, name) in file.features.names.iter().enumerate() {
        if file.features.names[..k].contains(name) {
            return Err(format!("features.names: `{name}` stands there twice"));
        }
    }
    if file.rounds.is_empty() {
        return Err("rounds: none, expected at least one".to_owned());
    }
    let index = |round: usize, name: &str| {
        let index = file.features.names.iter().position(|known| known == name);
        index
            .ok_or_else(|| format!("rounds[{round}].feature: `{name}` is not among features.names"))
    };
    let rounds = file
        .rounds
        .iter()
        .enumerate()
        .map(|(k, round)| {
            let number = |name: &str, value| check_number(&format!("rounds[{k}].{name}"), value);
            let wrong_kind = |found| {
                Err(format!("rounds[{k}].kind: `{found}` in a `{}` model", file.learner.name()))
            };
            match (file.learner, round) {
                (Learner::Discrete, Round::Vote { feature, threshold, polarity, alpha }) => {
                    number("threshold", *threshold)?;
                    number("alpha", *alpha)?;
                    if polarity.abs().to_bits() != 1f64.to_bits() {
                        return Err(format!("rounds[{k}].polarity: {polarity}, expected 1 or -1"));
                    }
                    Ok(WeakLearner::Vote {
                        feature: index(k, feature)?,
                        threshold: *threshold,
                        polarity: *polarity,
                        alpha: *alpha,
                    })
                }
                (Learner::GentleLine, Round::Line { feature, slope, intercept }) => {
                    number("slope", *slope)?;
                    number("intercept", *intercept)?;
                    Ok(WeakLearner::Line {
                        feature: index(k, feature)?,
                        slope: *slope,
                        intercept: *intercept,
                    })
                }
                (Learner::GentleStump, Round::Step { feature, threshold, below, above }) => {
                    number("threshold", *threshold)?;
                    number("below", *below)?;
                    number("above", *above)?;
                    Ok(WeakLearner::Step {
                        feature: index(k, feature)?,
                        threshold: *threshold,
                        below: *below,
                        above: *above,
                    })
                }
                (_, Round::Vote { .. }) => wrong_kind("vote"),
                (_, Round::Line { .. }) => wrong_kind("line"),
                (_, Round::Step { .. }) => wrong_kind("step"),
            }
        })
        .collect::<Result<_, _>>()?;
    for point in &file.operating_points {
        check_number(&format!("operating_points: threshold of `{}`", point.name), point.threshold)?;
    }
    Ok(Model {
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
        classifier: Classifier { learner: file.learner, rounds },
    })
}

fn check_number(name: &str, value: f64) -> Result<(), String> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(format!("{name}: {value}, expected a finite number"))
    }
}
