//! Removes what no record needs.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use serde_json::Value;

use super::store::Store;

/// Removes the objects that no plan and no record of a plan mentions, records by key that no plan has, and what tasks
/// that were killed have left. Files younger than `min_age_hours` are kept.
pub(super) fn gc(store: &Store, min_age_hours: u64) -> Result<()> {
    let folder = store.run_folder();
    // What is old is decided first: a task that starts now makes new files only.
    let youngest = SystemTime::now() - Duration::from_secs(min_age_hours * 3600);
    let mut used = BTreeSet::new();
    for path in files(&folder.join("plan"))?.into_iter().chain(files(&folder.join("done"))?) {
        if is_partial(&path) {
            continue;
        }
        let text = fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        // A record that is damaged protects nothing, and `merge` reports it.
        if let Ok(value) = serde_json::from_slice::<Value>(&text) {
            collect(&value, &mut used);
        }
    }
    let (mut n_removed, mut n_bytes) = (0, 0);
    for part in ["objects", "keys", "done", "plan"] {
        for path in files(&folder.join(part))? {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let is_kept = ["done", "plan"].contains(&part) || used.contains(&stem);
            if is_kept && !is_partial(&path) {
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

/// All texts in a JSON value that can be the name of an object or of a task: 64 hexadecimal digits.
fn collect(value: &Value, names: &mut BTreeSet<String>) {
    match value {
        Value::String(text) if text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit()) => {
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
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    Ok(files)
}
