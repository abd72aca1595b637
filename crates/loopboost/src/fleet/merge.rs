//! Makes a run folder from the records of all tasks of a plan.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use dataset::tables::{TableError, digest_file, write_atomically};
use rayon::prelude::*;

use super::entry::Entry;
use super::plan::Plan;
use super::store::{Record, Store};
use crate::findings::Findings;
use crate::partitions;
use crate::run::{LogTasks, RunFolder};
use crate::stage::Artifact;

/// Most problems that are listed.
const MAX_LISTED: usize = 20;

/// Requires one valid record for each task, and makes the tables and `run.json` from them.
pub(super) fn merge(store: &Store, plan: &Plan, id: &str) -> Result<Findings> {
    let folder = RunFolder::lock(store.run_folder().to_owned())?;
    let read = |entry: &Entry| -> Result<Result<Record, Problem>> { of_entry(store, id, entry) };
    let found: Vec<Result<Record, Problem>> =
        plan.entries.par_iter().map(read).collect::<Result<_>>()?;
    let mut problems = Problems::default();
    let mut records = Vec::with_capacity(found.len());
    for (entry, found) in plan.entries.iter().zip(found) {
        match found {
            Ok(record) => records.push((entry, record)),
            Err(Problem::Missing) => problems.missing.push(entry.index),
            Err(Problem::Invalid(text)) => problems.invalid.push(text),
        }
    }
    problems.invalid.extend(strays(store, plan, id)?);
    problems.check(plan.entries.len(), id)?;

    records.par_iter().try_for_each(|(_, record)| install(store, record))?;
    let mut logs = BTreeMap::new();
    for (entry, Record { failed, tasks, .. }) in records {
        logs.insert(entry.key.clone(), LogTasks { failed, tasks });
    }
    let (n, n_failed) = (logs.len(), logs.values().filter(|log| log.failed.is_some()).count());
    // As `run` does, because programs read all files of these folders.
    for artifact in [Artifact::Keyframes, Artifact::Features, Artifact::Odometry] {
        let is_used = |log: &&String| logs[*log].failed.is_none();
        let used: Vec<&str> = logs.keys().filter(is_used).map(String::as_str).collect();
        partitions::remove_others(store.run_folder(), artifact, used.into_iter())?;
    }
    folder.write_manifest(logs, plan.copies.clone())?;
    out!("{n} logs merged, {n_failed} of them left out");
    Ok(Findings::default())
}

/// Why there is no usable record.
enum Problem {
    Missing,
    Invalid(String),
}

#[derive(Default)]
struct Problems {
    missing: Vec<usize>,
    invalid: Vec<String>,
}

impl Problems {
    fn check(&self, n_entries: usize, id: &str) -> Result<()> {
        if self.missing.is_empty() && self.invalid.is_empty() {
            return Ok(());
        }
        let mut text = String::new();
        if !self.missing.is_empty() {
            text += &format!(
                "{} of {n_entries} tasks have no record; do them with `loopboost task --plan {id} --index I`, I = {}",
                self.missing.len(),
                ranges(&self.missing)
            );
        }
        for problem in self.invalid.iter().take(MAX_LISTED) {
            text += if text.is_empty() { "" } else { "\n" };
            text += problem;
        }
        if MAX_LISTED < self.invalid.len() {
            text += &format!("\nand {} more", self.invalid.len() - MAX_LISTED);
        }
        Err(anyhow!("{text}"))
    }
}

/// The record of a task, with tables that are what it says.
fn of_entry(store: &Store, id: &str, entry: &Entry) -> Result<Result<Record, Problem>> {
    let path = store.done(id).join(format!("{}.json", entry.index));
    let Some(bytes) = store.record(id, entry)? else { return Ok(Err(Problem::Missing)) };
    let again = format!("remove it and do task {} again", entry.index);
    let record = match Record::parse(&bytes, entry) {
        Ok(record) => record,
        Err(why) => {
            let text = format!("{} {why}; {again}", path.display());
            return Ok(Err(Problem::Invalid(text)));
        }
    };
    for (name, digest) in record.outputs() {
        if !store.has(digest)? {
            let text = format!(
                "{}, which is {name}, is missing or was altered; do task {} again",
                store.object(digest).display(),
                entry.index
            );
            return Ok(Err(Problem::Invalid(text)));
        }
    }
    Ok(Ok(record))
}

/// Files among the records that are not the record of a task of the plan: of conflicts, and of tasks that do not exist.
fn strays(store: &Store, plan: &Plan, id: &str) -> Result<Vec<String>> {
    let folder = store.done(id);
    let entries = match fs::read_dir(&folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.with_context(|| format!("cannot list {}", folder.display()))?,
    };
    let mut strays = Vec::new();
    for file in entries {
        let file = file.with_context(|| format!("cannot list {}", folder.display()))?;
        let name = file.file_name().to_string_lossy().into_owned();
        let mut parts = name.split('.');
        let index = parts.next().and_then(|part| part.parse::<usize>().ok());
        let entry = index.and_then(|index| plan.entries.get(index));
        let path = file.path();
        match (entry, parts.collect::<Vec<_>>().as_slice()) {
            (Some(_), ["json"]) => {}
            // What a task that was killed, or that is running, has not finished.
            (None, [.., "partial"]) => {}
            (Some(entry), [_, "json"]) => {
                let first = folder.join(format!("{}.json", entry.index));
                if first.exists() && digest_file(&path)? != digest_file(&first)? {
                    strays.push(format!(
                        "{} and {} are records of one task with different bytes; compare them and remove the wrong one",
                        first.display(),
                        path.display()
                    ));
                }
            }
            _ => strays.push(format!("{} is not a record of the plan; remove it", path.display())),
        }
    }
    strays.sort();
    Ok(strays)
}

/// Puts the tables of a log into the run folder.
fn install(store: &Store, record: &Record) -> Result<()> {
    for (name, digest) in record.outputs() {
        let (object, path) = (store.object(digest), store.run_folder().join(name));
        let cannot = || format!("cannot write {}", path.display());
        if is_same_file(&object, &path) {
            continue;
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create folder {}", folder.display()))?;
        let linked = tempfile::Builder::new()
            .prefix(".")
            .suffix(".partial")
            .make_in(folder, |partial| fs::hard_link(&object, partial));
        match linked {
            Ok(partial) => {
                let named = partial.into_temp_path().persist(&path);
                named.map_err(|e| e.error).with_context(cannot)?;
            }
            // The file system has no hard links.
            Err(_) => write_atomically(&path, |mut out| {
                let copy =
                    fs::File::open(&object).and_then(|mut from| std::io::copy(&mut from, &mut out));
                match copy {
                    Ok(_) => Ok((out, ())),
                    Err(source) => {
                        Err(TableError::Io { action: "write", path: path.clone(), source })
                    }
                }
            })?,
        }
    }
    Ok(())
}

/// Whether two paths are one file.
#[cfg(unix)]
fn is_same_file(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let id = |path: &Path| fs::metadata(path).ok().map(|of| (of.dev(), of.ino()));
    id(a).is_some() && id(a) == id(b)
}

/// Whether two paths are one file. It is not known here, so the file is made again.
#[cfg(not(unix))]
fn is_same_file(_: &Path, _: &Path) -> bool {
    false
}

/// Numbers as ranges: `0-2,5`, as `sbatch --array` takes them.
fn ranges(numbers: &[usize]) -> String {
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for &number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => ranges.push((number, number)),
        }
    }
    let text = |&(first, last): &(usize, usize)| match first == last {
        true => first.to_string(),
        false => format!("{first}-{last}"),
    };
    ranges.iter().map(text).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_tasks_are_listed_as_ranges() {
        assert_eq!(ranges(&[0, 1, 2, 5, 7, 8]), "0-2,5,7-8");
        assert_eq!(ranges(&[3]), "3");
    }
}
