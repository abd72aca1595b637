use std::collections::BTreeMap;

use parquet::file::metadata::KeyValue;
use serde_json::Value;

use crate::{Losses, Note};

/// Version of the table formats. Tables of other versions cannot be read.
pub const FORMAT_VERSION: u32 = 7;

/// The origin of a table. It is stored in the key-value metadata of the table.
///
/// | key | value |
/// |---|---|
/// | `loopboost.kind` | `scans`, `poses`, `keyframes`, ... |
/// | `loopboost.format_version` | [`FORMAT_VERSION`] |
/// | `loopboost.program_version` | version of the program |
/// | `loopboost.seed` | seed of the run; tables that do not depend on it have no such key |
/// | `loopboost.options` | options of the stage, including defaults, as JSON |
/// | `loopboost.inputs` | JSON object: BLAKE3 digest (hex) of each input file |
/// | `loopboost.losses` | JSON list of losses: code, arguments, subject, count `n` |
/// | `loopboost.notes` | JSON list of notes: code, arguments, subject |
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// Version of the program that wrote the table.
    pub program_version: String,
    /// Seed of the run. `None` for a stage whose results do not depend on it.
    pub seed: Option<u64>,
    /// Options of the stage, including defaults.
    pub options: Value,
    /// BLAKE3 digests of the inputs. The key is the path in the run folder; for logs, the file
    /// name.
    pub inputs: BTreeMap<String, String>,
    /// The data that the stage left out.
    pub losses: Losses,
    /// The notes of the stage.
    pub notes: Vec<Note>,
}

impl Provenance {
    pub(super) fn to_metadata(&self, kind: &str) -> Vec<KeyValue> {
        self.entries(kind).into_iter().map(|(key, value)| KeyValue::new(key, value)).collect()
    }

    /// The keys and values that a file of the given kind stores.
    pub fn entries(&self, kind: &str) -> Vec<(String, String)> {
        let entry = |key: &str, value: String| (format!("loopboost.{key}"), value);
        let seed = self.seed.map(|seed| entry("seed", seed.to_string()));
        let mut entries = vec![
            entry("kind", kind.to_owned()),
            entry("format_version", FORMAT_VERSION.to_string()),
            entry("program_version", self.program_version.clone()),
        ];
        entries.extend(seed);
        entries.extend([
            entry("options", self.options.to_string()),
            entry("inputs", serde_json::json!(self.inputs).to_string()),
            entry("losses", serde_json::json!(self.losses).to_string()),
            entry("notes", serde_json::json!(self.notes).to_string()),
        ]);
        entries
    }

    /// The kind and the provenance, from the keys and values of a file. Returns `None` if a key is
    /// missing or a value cannot be parsed.
    pub fn from_entries(get: impl Fn(&str) -> Option<String>) -> Option<(String, Self)> {
        let of = |key: &str| get(&format!("loopboost.{key}"));
        Some((of("kind")?, Self::from_metadata(of)?))
    }

    /// Reads the provenance. The caller has already checked the kind and the format version.
    pub(super) fn from_metadata(get: impl Fn(&str) -> Option<String>) -> Option<Self> {
        Some(Self {
            program_version: get("program_version")?,
            seed: get("seed").map(|seed| seed.parse()).transpose().ok()?,
            options: serde_json::from_str(&get("options")?).ok()?,
            inputs: serde_json::from_str(&get("inputs")?).ok()?,
            losses: serde_json::from_str(&get("losses")?).ok()?,
            notes: serde_json::from_str(&get("notes")?).ok()?,
        })
    }
}
