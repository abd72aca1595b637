use std::collections::BTreeMap;

use parquet::file::metadata::KeyValue;
use serde_json::Value;

use crate::Dropped;

/// Version of the table formats; a table of another version is not read.
pub const FORMAT_VERSION: u32 = 3;

/// Where a table comes from; it travels in the table's key-value metadata.
///
/// | key | value |
/// |---|---|
/// | `loopboost.kind` | `scans`, `poses`, `keyframes`, ... |
/// | `loopboost.format_version` | [`FORMAT_VERSION`] |
/// | `loopboost.program_version` | the program's version |
/// | `loopboost.seed` | the run's seed |
/// | `loopboost.options` | the stage's options, resolved, as JSON |
/// | `loopboost.inputs` | JSON object: input file to BLAKE3 digest, hex |
/// | `loopboost.dropped` | JSON object: reason to count of what the stage had to leave out |
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// Version of the program that wrote the table.
    pub program_version: String,
    /// The run's seed.
    pub seed: u64,
    /// The stage's options, all defaults resolved.
    pub options: Value,
    /// Inputs, by their name in the run folder (logs: by file name), with their BLAKE3 digests.
    pub inputs: BTreeMap<String, String>,
    /// What the stage left out.
    pub dropped: Dropped,
}

impl Provenance {
    pub(super) fn to_metadata(&self, kind: &str) -> Vec<KeyValue> {
        self.entries(kind).into_iter().map(|(key, value)| KeyValue::new(key, value)).collect()
    }

    /// Keys and values as an artifact of a kind carries them.
    pub fn entries(&self, kind: &str) -> Vec<(String, String)> {
        let entry = |key: &str, value: String| (format!("loopboost.{key}"), value);
        vec![
            entry("kind", kind.to_owned()),
            entry("format_version", FORMAT_VERSION.to_string()),
            entry("program_version", self.program_version.clone()),
            entry("seed", self.seed.to_string()),
            entry("options", self.options.to_string()),
            entry("inputs", serde_json::json!(self.inputs).to_string()),
            entry("dropped", serde_json::json!(self.dropped).to_string()),
        ]
    }

    /// Kind and provenance from the keys and values of an artifact; none where one is missing.
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
            dropped: serde_json::from_str(&get("dropped")?).ok()?,
        })
    }
}
