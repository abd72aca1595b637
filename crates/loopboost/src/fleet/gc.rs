//! Removes what no record needs.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use serde_json::Value;

use super::store::Store;
use crate::config::usage;

/// Removes the objects that no plan and no record of a plan mentions, records by key that no plan has, and what tasks
/// that were killed have left. Files younger than `min_age_hours` are kept.
pub(super) fn gc(store: &Store, min_age_hours: u64) -> Result<()> {
    let folder = store.run_folder();
    if !folder.join("plan").is_dir() && !folder.join("run.json").is_file() {
        return Err(usage(format!(
            "{} is not a run folder: it has neither plan/ nor run.json",
            folder.display()
        )));
    }
    // What is old is decided first: a task that starts now makes new files only.
    let youngest = SystemTime::now()
        .checked_sub(Duration::from_secs(min_age_hours.saturating_mul(3600)))
        .unwrap_or(SystemTime::UNIX_EPOCH);
    let used = used(folder)?;
    let (mut n_removed, mut n_bytes) = (0, 0);
    for part in ["objects", "keys", "done", "plan"] {
        for path in files(&folder.join(part))? {
            if !is_garbage(part, &path, &used) {
                continue;
            }
            let cannot = || format!("cannot remove {}", path.display());
            let of = fs::metadata(&path).with_context(cannot)?;
            if of.modified().with_context(cannot)? <= youngest {
                fs::remove_file(&path).with_context(cannot)?;
                n_removed += 1;
                n_bytes += of.len();
            }
        }
    }
    out!("{n_removed} files removed, {n_bytes} bytes");
    Ok(())
}

/// Whether a file is one that loopboost made, and that nothing needs. Files with other names stay.
fn is_garbage(part: &str, path: &Path, used: &BTreeSet<String>) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = match part {
        "objects" => Some(&*name),
        "keys" => name.strip_suffix(".json"),
        _ => None,
    };
    is_partial(path) || name.is_some_and(|name| is_digest(name) && !used.contains(name))
}

/// The names of all objects and tasks that plans and records mention.
fn used(folder: &Path) -> Result<BTreeSet<String>> {
    let mut used = BTreeSet::new();
    for path in files(&folder.join("plan"))?.into_iter().chain(files(&folder.join("done"))?) {
        if !is_partial(&path) {
            add(&path, &mut used)?;
        }
    }
    // A plan mentions a task, whose record in `keys` mentions its objects.
    for task in used.clone() {
        add(&folder.join("keys").join(format!("{task}.json")), &mut used)?;
    }
    Ok(used)
}

/// Adds what a file mentions, if it exists. A damaged one protects nothing, and `merge` reports it.
fn add(path: &Path, used: &mut BTreeSet<String>) -> Result<()> {
    let text = match fs::read(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        text => text.with_context(|| format!("cannot read {}", path.display()))?,
    };
    if let Ok(value) = serde_json::from_slice::<Value>(&text) {
        collect(&value, used);
    }
    Ok(())
}

fn is_digest(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// All texts in a JSON value that can be the name of an object or of a task: 64 hexadecimal digits.
fn collect(value: &Value, names: &mut BTreeSet<String>) {
    match value {
        Value::String(text) if is_digest(text) => {
            names.insert(text.clone());
        }
        Value::Array(values) => values.iter().for_each(|value| collect(value, names)),
        Value::Object(values) => values.values().for_each(|value| collect(value, names)),
        _ => {}
    }
}

fn is_partial(path: &Path) -> bool {
    dataset::tables::is_partial(path)
}

/// The files below a folder, sorted. None if there is no such folder.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        let entries = match fs::read_dir(&folder) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            entries => entries.with_context(|| format!("cannot list {}", folder.display()))?,
        };
        for entry in entries {
            let path = entry.with_context(|| format!("cannot list {}", folder.display()))?.path();
            // Links are not followed.
            let kind = fs::symlink_metadata(&path)
                .with_context(|| format!("cannot read {}", path.display()))?
                .file_type();
            if kind.is_dir() {
                folders.push(path);
            } else if kind.is_file() {
                files.push(path);
            }
        }
    }
    files.sort();
    Ok(files)
}
