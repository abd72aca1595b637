//! `run.json`: what each task of a run was made from and what it made. The next run repeats only
//! what has changed.
//!
//! It contains no times and no paths outside the run folder: the same run gives the same bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};
use dataset::tables::{Provenance, write_file};
use dataset::{Losses, Note};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::summary::Summary;

/// Version of the layout of `run.json`. A file of another version is not read, and every stage runs
/// again.
const FORMAT_VERSION: u32 = 6;

/// The tasks of a run folder, by name ("ingest monday", "label").
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Manifest {
    format_version: u32,
    /// Logs that could not be ingested, with the code of the error.
    pub(crate) failed: BTreeMap<String, String>,
    /// Logs with the same bytes as another log, with the name of that log.
    pub(crate) copies: BTreeMap<String, String>,
    pub(crate) tasks: BTreeMap<String, Record>,
}

/// The part of `run.json` that every version has.
#[derive(Deserialize)]
struct Versioned {
    format_version: u32,
}

/// A task that was done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Record {
    pub(crate) program_version: String,
    pub(crate) seed: u64,
    pub(crate) options: Value,
    /// Names and digests of what it read.
    pub(crate) inputs: BTreeMap<String, String>,
    /// Names and digests of what it wrote.
    pub(crate) outputs: BTreeMap<String, String>,
    pub(crate) losses: Losses,
    pub(crate) notes: Vec<Note>,
    /// What it printed on stdout.
    pub(crate) summaries: Vec<Summary>,
}

impl Manifest {
    fn path(folder: &Path) -> PathBuf {
        folder.join("run.json")
    }

    /// Reads the manifest of a run folder. A missing or damaged one, and one of another version,
    /// counts as empty: every stage runs again.
    pub(super) fn load(folder: &Path) -> Self {
        Self::load_existing(folder).unwrap_or_default()
    }

    /// Reads the manifest of a run folder.
    pub(crate) fn load_existing(folder: &Path) -> Result<Self> {
        let path = Self::path(folder);
        let text = std::fs::read(&path).map_err(|e| {
            anyhow!("{} is not a run folder: cannot read run.json: {e}", folder.display())
        })?;
        let damaged =
            |e| anyhow!("{} is damaged: {e}; `loopboost run` writes a new one", path.display());
        // The version first: the layout of another version may not be readable.
        let Versioned { format_version } = serde_json::from_slice(&text).map_err(damaged)?;
        if format_version != FORMAT_VERSION {
            return Err(anyhow!(
                "{} has format version {format_version}, this program reads version {FORMAT_VERSION}; `loopboost run` writes a new one",
                path.display()
            ));
        }
        serde_json::from_slice(&text).map_err(damaged)
    }

    pub(super) fn save(&mut self, folder: &Path) -> Result<()> {
        self.format_version = FORMAT_VERSION;
        let mut json = serde_json::to_string_pretty(self)?;
        json.push('\n');
        write_file(&Self::path(folder), json.as_bytes())?;
        Ok(())
    }
}

impl Record {
    /// What differs between the task as it was done and as it is asked for now: program, seed,
    /// options and inputs. Empty if nothing differs.
    pub(crate) fn changes(&self, now: &Provenance) -> Vec<String> {
        let mut changes = Vec::new();
        if self.program_version != now.program_version {
            changes.push(format!("program: {} -> {}", self.program_version, now.program_version));
        }
        if self.seed != now.seed {
            changes.push(format!("seed: {} -> {}", self.seed, now.seed));
        }
        changes.extend(self::changes(&self.options, &now.options));
        for (name, digest) in &now.inputs {
            match self.inputs.get(name) {
                None => changes.push(format!("{name} is new")),
                Some(before) if before != digest => changes.push(format!("{name} has changed")),
                Some(_) => {}
            }
        }
        for name in self.inputs.keys().filter(|name| !now.inputs.contains_key(*name)) {
            changes.push(format!("{name} is no longer an input"));
        }
        changes
    }
}

/// What differs between two JSON values, one entry per key.
pub(crate) fn changes(before: &Value, now: &Value) -> Vec<String> {
    let line = |(key, before, now): &(String, Value, Value)| format!("{key}: {before} -> {now}");
    changed_values(before, now).iter().map(line).collect()
}

/// The keys whose values differ between two JSON values, with both values. A value that is missing is null.
pub(crate) fn changed_values(before: &Value, now: &Value) -> Vec<(String, Value, Value)> {
    let mut changes = Vec::new();
    option_changes("", before, now, &mut changes);
    changes
}

fn option_changes(
    key: &str,
    before: &Value,
    now: &Value,
    changes: &mut Vec<(String, Value, Value)>,
) {
    match (before, now) {
        (Value::Object(before), Value::Object(now)) => {
            let keys: std::collections::BTreeSet<&String> =
                before.keys().chain(now.keys()).collect();
            for name in keys {
                let inner = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
                let value = |object: &serde_json::Map<String, Value>| {
                    object.get(name).cloned().unwrap_or(Value::Null)
                };
                option_changes(&inner, &value(before), &value(now), changes);
            }
        }
        (Value::Array(before), Value::Array(now)) => {
            for k in 0..before.len().max(now.len()) {
                let value = |array: &[Value]| array.get(k).cloned().unwrap_or(Value::Null);
                option_changes(&format!("{key}[{k}]"), &value(before), &value(now), changes);
            }
        }
        (before, now) if before != now => {
            changes.push((key.to_owned(), before.clone(), now.clone()));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_for_another_version_states_both_versions() {
        let folder = tempfile::tempdir().unwrap();
        let load = |text: &str| {
            std::fs::write(Manifest::path(folder.path()), text).unwrap();
            Manifest::load_existing(folder.path()).unwrap_err().to_string()
        };
        let message = load(r#"{"format_version": 2, "tasks": {"label": {"dropped": {}}}}"#);
        assert!(message.contains("format version 2, this program reads version 5"), "{message}");
        assert!(load("{").contains("is damaged"));
        assert!(load(r#"{"format_version": 5, "tasks": []}"#).contains("is damaged"));
    }
}
