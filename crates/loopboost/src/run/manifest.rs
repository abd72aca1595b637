//! `run.json`: what each task of a run was made from and what it made. The next run repeats only
//! what has changed.
//!
//! It contains no times and no paths outside the run folder: the same run gives the same bytes.
//!
//! While a command runs, each finished task is a line of `run.journal`, because rewriting `run.json` after each of
//! 100,000 tasks would take longer than the tasks. At its end, the command writes `run.json` and removes the journal.
//! A journal that is still there was left by a command that was killed; its entries count.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::{Provenance, write_file};
use dataset::{Losses, Note};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::stage::Stage;
use crate::summary::Summary;

/// Version of the layout of `run.json`. A file of another version is not read, and every stage runs
/// again.
pub(crate) const FORMAT_VERSION: u32 = 6;

/// The tasks of a run folder, by name ("ingest monday", "label").
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
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

/// A change of a manifest: a line of the journal.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) enum Change {
    /// A task was done.
    Done { task: String, record: Record },
    /// A log could not be ingested.
    Failed { log: String, error: String },
    /// A log that had failed before was ingested.
    Ingested { log: String },
    /// The copies were found.
    Copies(BTreeMap<String, String>),
}

/// A line of the journal.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line<T> {
    format_version: u32,
    change: T,
}

/// A task that was done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Record {
    pub(crate) program_version: String,
    /// Absent for a stage whose results do not depend on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) seed: Option<u64>,
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
    /// counts as empty: every stage runs again. What a command that was killed has done since counts.
    pub(super) fn load(folder: &Path) -> Result<Self> {
        let mut manifest = Self::load_saved(folder).unwrap_or_default();
        manifest.apply_journal(folder)?;
        Ok(manifest)
    }

    /// Reads the manifest of a run folder, and the journal of a command that was killed.
    pub(crate) fn load_existing(folder: &Path) -> Result<Self> {
        let mut manifest = match Self::load_saved(folder) {
            Err(_) if !Self::path(folder).exists() && Self::journal(folder).exists() => {
                Self::default()
            }
            loaded => loaded?,
        };
        manifest.apply_journal(folder)?;
        Ok(manifest)
    }

    fn apply_journal(&mut self, folder: &Path) -> Result<()> {
        let path = Self::journal(folder);
        let journal = match std::fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            journal => journal.with_context(|| format!("cannot read {}", path.display()))?,
        };
        for line in journal.split(|byte| *byte == b'\n') {
            // The last line is incomplete if the command was killed while it wrote it.
            let Ok(line) = serde_json::from_slice::<Line<Change>>(line) else { break };
            if line.format_version == FORMAT_VERSION {
                self.apply(line.change);
            }
        }
        Ok(())
    }

    /// Reads `run.json`.
    fn load_saved(folder: &Path) -> Result<Self> {
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

    fn journal(folder: &Path) -> PathBuf {
        folder.join("run.journal")
    }

    pub(super) fn apply(&mut self, change: Change) {
        match change {
            Change::Done { task, record } => {
                self.tasks.insert(task, record);
            }
            Change::Failed { log, error } => {
                self.tasks.remove(&format!("{} {log}", Stage::Ingest));
                self.failed.insert(log, error);
            }
            Change::Ingested { log } => {
                self.failed.remove(&log);
            }
            Change::Copies(copies) => {
                for copy in copies.keys() {
                    self.tasks.remove(&format!("{} {copy}", Stage::Ingest));
                    self.failed.remove(copy);
                }
                self.copies = copies;
            }
        }
    }

    /// Makes a change, and adds it to the journal.
    pub(super) fn change(&mut self, folder: &Path, change: Change) -> Result<()> {
        let mut line =
            serde_json::to_string(&Line { format_version: FORMAT_VERSION, change: &change })?;
        line.push('\n');
        let path = Self::journal(folder);
        let append = || -> std::io::Result<()> {
            let mut file = File::options().create(true).append(true).open(&path)?;
            file.write_all(line.as_bytes())?;
            file.sync_data()
        };
        append().with_context(|| format!("cannot write {}", path.display()))?;
        self.apply(change);
        Ok(())
    }

    /// Writes `run.json` and removes the journal.
    pub(crate) fn save(&mut self, folder: &Path) -> Result<()> {
        self.format_version = FORMAT_VERSION;
        let mut json = serde_json::to_string_pretty(self)?;
        json.push('\n');
        write_file(&Self::path(folder), json.as_bytes())?;
        match std::fs::remove_file(Self::journal(folder)) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error)
                .with_context(|| format!("cannot remove {}", Self::journal(folder).display())),
            _ => Ok(()),
        }
    }

    /// Writes `run.json` if there is a journal.
    pub(super) fn save_journal(&mut self, folder: &Path) -> Result<()> {
        if Self::journal(folder).exists() { self.save(folder) } else { Ok(()) }
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
            let text = |seed: Option<u64>| seed.map_or("none".to_owned(), |seed| seed.to_string());
            changes.push(format!("seed: {} -> {}", text(self.seed), text(now.seed)));
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
        assert!(message.contains("format version 2, this program reads version 6"), "{message}");
        assert!(load("{").contains("is damaged"));
        assert!(load(r#"{"format_version": 6, "tasks": []}"#).contains("is damaged"));
    }

    /// A command is killed while it writes the second of three lines.
    /// A run folder of an earlier version, and a command of this version that was killed.
    #[test]
    fn the_journal_counts_beside_a_run_json_of_another_version() {
        let folder = tempfile::tempdir().unwrap();
        let mut killed = Manifest::default();
        let failed = Change::Failed { log: "monday".to_owned(), error: "no_scans".to_owned() };
        killed.change(folder.path(), failed).unwrap();
        std::fs::write(Manifest::path(folder.path()), r#"{"format_version": 2}"#).unwrap();
        assert_eq!(Manifest::load(folder.path()).unwrap().failed["monday"], "no_scans");
    }

    #[test]
    fn the_journal_of_a_killed_command_counts_up_to_its_last_complete_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let failed = |log: &str| Change::Failed { log: log.to_owned(), error: "empty".to_owned() };
        let mut manifest = Manifest::default();
        manifest.change(path, failed("a")).unwrap();
        manifest.save(path).unwrap();
        assert!(!Manifest::journal(path).exists());
        manifest.change(path, Change::Ingested { log: "a".to_owned() }).unwrap();
        manifest.change(path, failed("b")).unwrap();
        let loaded = Manifest::load_existing(path).unwrap();
        assert_eq!(loaded.failed.keys().collect::<Vec<_>>(), ["b"]);
        let text = std::fs::read_to_string(Manifest::journal(path)).unwrap();
        std::fs::write(Manifest::journal(path), &text[..text.len() - 5]).unwrap();
        let loaded = Manifest::load_existing(path).unwrap();
        assert!(loaded.failed.is_empty(), "{:?}", loaded.failed);
        // Without `run.json`, there is nothing but the journal.
        std::fs::remove_file(Manifest::path(path)).unwrap();
        assert_eq!(Manifest::load_existing(path).unwrap(), Manifest::default());
    }
}
