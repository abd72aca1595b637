//! Which logs a run has: the files, folders and globs of `ingest.logs`.
//!
//! A recorder splits a long drive into several files. Those of one folder are told to be one drive
//! by a `metadata.yaml` of rosbag2 beside them, or by their times: one goes on where another ends.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use ingest::Log;

use crate::config::stem;

/// A log of the run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct LogFile {
    /// The file's stem; of a drive that was split, the folder's name. Unique in the run.
    pub(crate) name: Arc<str>,
    /// One file, or those a drive was split into, in order of time.
    pub(crate) paths: Vec<PathBuf>,
}

impl LogFile {
    /// A log of one file.
    pub(crate) fn of(path: PathBuf) -> Self {
        Self { name: stem(&path).into(), paths: vec![path] }
    }
}

/// Time from the end of one file to the start of the next up to which they are one drive \[ns\].
const MAX_SPLIT_GAP_NS: u64 = 2_000_000_000;
/// Folders within folders that are looked into.
const MAX_DEPTH: usize = 4;

/// The logs that an entry of `ingest.logs` names, those of a folder or a glob by name. A file that
/// is named itself need not be there: only `ingest` reads it.
pub(crate) fn find(folder: &Path, entry: &str) -> Result<Vec<LogFile>> {
    let path = folder.join(entry);
    if path.is_dir() {
        return match in_folder(&path, 0)? {
            none if none.is_empty() => Err(anyhow!(
                "`ingest.logs`: there is no *.mcap in the folder {} (paths are relative to the pipeline file)",
                path.display()
            )),
            some => Ok(some),
        };
    }
    if path.exists() || !entry.contains(['*', '?', '[']) {
        return Ok(vec![LogFile::of(path)]);
    }
    let escaped = glob::Pattern::escape(&folder.to_string_lossy());
    let pattern = if escaped.is_empty() { entry.to_owned() } else { format!("{escaped}/{entry}") };
    let found: Vec<PathBuf> = glob::glob(&pattern)
        .with_context(|| format!("`ingest.logs`: `{entry}` is no path or glob"))?
        .collect::<Result<_, _>>()
        .with_context(|| format!("`ingest.logs`: cannot look for `{entry}`"))?;
    if found.is_empty() {
        return Err(anyhow!(
            "`ingest.logs`: nothing matches `{entry}` (looked for {pattern}; paths are relative to the pipeline file)"
        ));
    }
    let mut logs = Vec::new();
    for path in found {
        match path.is_dir() {
            true => logs.extend(in_folder(&path, 0)?),
            false => logs.push(LogFile::of(path)),
        }
    }
    Ok(logs)
}

/// The logs of a folder; where it has none itself, those of its folders.
fn in_folder(folder: &Path, depth: usize) -> Result<Vec<LogFile>> {
    let failed = || format!("`ingest.logs`: cannot list the folder {}", folder.display());
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect())
        .with_context(failed)?;
    entries.sort();
    let is_log = |path: &&PathBuf| path.is_file() && path.extension().is_some_and(|e| e == "mcap");
    let files: Vec<PathBuf> = entries.iter().filter(is_log).cloned().collect();
    if files.is_empty() && depth < MAX_DEPTH {
        let mut logs = Vec::new();
        for below in entries.iter().filter(|path| path.is_dir()) {
            logs.extend(in_folder(below, depth + 1)?);
        }
        return Ok(logs);
    }
    let is_rosbag = folder.join("metadata.yaml").is_file();
    let drives = drives(files, is_rosbag);
    Ok(match <[Vec<PathBuf>; 1]>::try_from(drives) {
        Ok([one]) if one.len() > 1 => {
            // The name of `.` or `..` is not in the path.
            let full = folder.canonicalize().with_context(failed)?;
            let name = full.file_name().unwrap_or_default().to_string_lossy();
            vec![LogFile { name: name.into(), paths: one }]
        }
        Ok(drives) => named_by_first(drives.into()),
        Err(drives) => named_by_first(drives),
    })
}

fn named_by_first(drives: Vec<Vec<PathBuf>>) -> Vec<LogFile> {
    let name = |paths: &[PathBuf]| paths.first().map(|path| stem(path)).unwrap_or_default().into();
    drives.into_iter().map(|paths| LogFile { name: name(&paths), paths }).collect()
}

/// When a file starts and ends \[ns\], and its topics.
struct Extent {
    start_ns: u64,
    end_ns: u64,
    topics: BTreeSet<String>,
}

/// Puts files together that belong to one drive.
fn drives(files: Vec<PathBuf>, all_one: bool) -> Vec<Vec<PathBuf>> {
    // With one file there is nothing to tell apart, and no need to read it.
    if files.len() < 2 {
        return files.into_iter().map(|file| vec![file]).collect();
    }
    let mut dated: Vec<(Option<Extent>, PathBuf)> =
        files.into_iter().map(|file| (extent(&file), file)).collect();
    dated.sort_by(|(a, a_path), (b, b_path)| {
        let start = |extent: &Option<Extent>| extent.as_ref().map(|e| e.start_ns);
        start(a).cmp(&start(b)).then_with(|| a_path.cmp(b_path))
    });
    let goes_on = |(a, _): &(Option<Extent>, PathBuf), (b, _): &(Option<Extent>, PathBuf)| {
        all_one || a.as_ref().zip(b.as_ref()).is_some_and(|(a, b)| a.continues_in(b))
    };
    let mut drives: Vec<Vec<PathBuf>> = dated
        .chunk_by(goes_on)
        .map(|drive| drive.iter().map(|(_, path)| path.clone()).collect())
        .collect();
    // By name again, as a folder is listed.
    drives.sort();
    drives
}

/// None for a file that cannot be read or holds no message; `ingest` says so.
fn extent(path: &Path) -> Option<Extent> {
    let contents = Log::open(path).ok()?.contents();
    let (start_ns, end_ns) = contents.time_range_ns?;
    let topics = contents.channels.into_values().map(|channel| channel.topic).collect();
    Some(Extent { start_ns, end_ns, topics })
}

impl Extent {
    /// A recorder writes no message twice, so that the files of a drive hardly overlap.
    fn continues_in(&self, next: &Self) -> bool {
        next.start_ns.abs_diff(self.end_ns) <= MAX_SPLIT_GAP_NS
            && self.end_ns <= next.end_ns
            && !self.topics.is_disjoint(&next.topics)
    }
}
