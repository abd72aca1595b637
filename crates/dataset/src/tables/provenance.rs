use std::collections::BTreeMap;

use parquet::file::metadata::KeyValue;
use serde_json::Value;

use crate::{Losses, Note};

/// Version of the table formats. A table of another version is not read.
pub const FORMAT_VERSION: u32 = 4;

/// Where a table comes from. It is stored in the key-value metadata of the table.
///
/// | key | value |
/// |---|---|
/// | `loopboost.kind` | `scans`, `poses`, `keyframes`, ... |
/// | `loopboost.format_version` | [`FORMAT_VERSION`] |
/// | `loopboost.program_version` | the program's version |
/// | `loopboost.seed` | the run's seed |
/// | `loopboost.options` | the stage's options, resolved, as JSON |
/// | `loopboost.inputs` | JSON object: input file to BLAKE3 digest, hex |
/// | `loopboost.losses` | JSON list of what the stage left out: code, arguments, subject, count `n` |
/// | `loopboost.notes` | JSON list of remarks: code, arguments, subject |
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// Version of the program that wrote the table.
    pub program_version: String,
    /// The run's seed.
    pub seed: u64,
    /// The options of the stage, with all defaults.
    pub options: Value,
    /// BLAKE3 digests of the inputs, by name in the run folder (logs: by file name).
    pub inputs: BTreeMap<String, String>,
    /// What the stage left out.
    pub losses: Losses,
    /// What the stage remarked.
    pub notes: Vec<Note>,
}

impl Provenance {
    pub(super) fn to_metadata(&self, kind: &str) -> Vec<KeyValue> {
        self.entries(kind).into_iter().map(|(key, value)| KeyValue::new(key, value)).collect()
    }

    /// Keys and values, as an artifact of a kind stores them.
    pub fn entries(&self, kind: &str) -> Vec<(String, String)> {
        let entry = |key: &str, value: String| (format!("loopboost.{key}"), value);
        vec![
            entry("kind", kind.to_owned()),
            entry("format_version", FORMAT_VERSION.to_string()),
            entry("program_version", self.program_version.clone()),
            entry("seed", self.seed.to_string()),
            entry("options", self.options.to_string()),
            entry("inputs", serde_json::json!(self.inputs).to_string()),
            entry("losses", serde_json::json!(self.losses).to_string()),
            entry("notes", serde_json::json!(self.notes).to_string()),
        ]
    }

    /// Kind and provenance from the keys and values of an artifact; none if one is missing.
    pub fn from_entries(get: impl Fn(&str) -> Option<String>) -> Option<(String, Self)> {
        let of = |key: &str| get(&format!("loopboost.{key}"));
        Some((of("kind")?, Self::from_metadata(of)?))
    }

    /// Reads everything but kind and format version, which the caller has checked.
    pub(super) fn from_metadata(get: impl Fn(&str) -> Option<String>) -> Option<Self> {
        Some(Self {
            program_version: get("program_version")?,
            seed: get("seed")?.parse().ok()?,
            options: serde_json::from_str(&get("options")?).ok()?,
            inputs: serde_json::from_str(&get("inputs")?).ok()?,
            losses: serde_json::from_str(&get("losses")?).ok()?,
            notes: serde_json::from_str(&get("notes")?).ok()?,
        })
    }
}
