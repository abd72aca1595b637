//! Which logs a run has: the files, folders and globs of `ingest.logs`.
//!
//! A recorder splits a long drive into several files. Which files of a folder are one drive is told
//! by a `metadata.yaml` of rosbag2 beside them, or else by their times and names: one file goes on
//! where another ends.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use ingest::Log;
use yaml_rust2::{Yaml, YamlLoader};

use crate::config::stem;

/// A log of the run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct LogFile {
    /// The file's stem; of a drive that was split, the folder's name where the folder holds no
    /// other. Unique in the run.
    pub(crate) name: Arc<str>,
    /// One file, or those a drive was split into, in order of time.
    pub(crate) paths: Vec<PathBuf>,
    /// Files of the drive that are not there.
    pub(crate) missing: Vec<PathBuf>,
}

impl LogFile {
    /// A log of one file.
    pub(crate) fn of(path: PathBuf) -> Self {
        Self { name: stem(&path).into(), paths: vec![path], missing: Vec::new() }
    }

    /// Where it lies, for messages: the file, or the folder of the files.
    pub(crate) fn place(&self) -> String {
        let first = &self.paths[0];
        match self.paths.len() {
            1 => first.display().to_string(),
            n => {
                let folder = first.parent().unwrap_or(Path::new(""));
                format!("{} ({n} files from {} on)", folder.display(), file_name(first))
            }
        }
    }
}

/// Time from the end of one file to the start of the next, either way, up to which they are one
/// drive \[ns\].
const MAX_SPLIT_GAP_NS: u64 = 2_000_000_000;
/// Folders within folders that are looked into; more are a link that leads back.
const MAX_DEPTH: usize = 16;

/// The logs that an entry of `ingest.logs` names, those of a folder or a glob by name. A file that
/// is named itself need not be there: only `ingest` reads it.
pub(crate) fn find(folder: &Path, entry: &str) -> Result<Vec<LogFile>> {
    let path = folder.join(entry);
    let found = if path.is_dir() {
        in_folder(&path, 0)?
    } else if path.exists() || !entry.contains(['*', '?', '[']) {
        return Ok(vec![LogFile::of(path)]);
    } else {
        let is_absolute = Path::new(entry).is_absolute() || folder.as_os_str().is_empty();
        let pattern = match is_absolute {
            true => entry.to_owned(),
            false => format!("{}/{entry}", glob::Pattern::escape(&folder.to_string_lossy())),
        };
        let matches = glob::glob(&pattern)
            .with_context(|| format!("`ingest.logs`: `{entry}` is no path or glob"))?;
        let mut logs = Vec::new();
        for path in matches {
            let path = path.with_context(|| format!("`ingest.logs`: cannot look for `{entry}`"))?;
            match path.is_dir() {
                true => logs.extend(in_folder(&path, 0)?),
                false => logs.push(LogFile::of(path)),
            }
        }
        logs
    };
    if found.is_empty() {
        return Err(anyhow!(
            "`ingest.logs`: there is no *.mcap in `{entry}` (looked in {}; paths are relative to the pipeline file)",
            path.display()
        ));
    }
    Ok(found)
}

/// The logs of a folder and of the folders in it. What starts with a dot is none.
fn in_folder(folder: &Path, depth: usize) -> Result<Vec<LogFile>> {
    let failed = || format!("`ingest.logs`: cannot list the folder {}", folder.display());
    if MAX_DEPTH < depth {
        return Err(anyhow!("folders in folders, {MAX_DEPTH} deep: {}", folder.display()))
            .with_context(failed);
    }
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect())
        .with_context(failed)?;
    entries.retain(|path| !file_name(path).starts_with('.'));
    entries.sort();
    let (folders, files): (Vec<_>, Vec<_>) = entries.into_iter().partition(|path| path.is_dir());
    let is_log = |path: &PathBuf| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap"));
    let mut files: Vec<PathBuf> = files.into_iter().filter(is_log).collect();

    // The name of `.` or `..` is not in the path.
    let name: Arc<str> = file_name(&folder.canonicalize().with_context(failed)?).into();
    let mut drives = Vec::new();
    if let Some(listed) = files_of_bag(folder)? {
        files.retain(|file| !listed.contains(file));
        let (there, missing): (Vec<_>, Vec<_>) =
            listed.into_iter().partition(|path| path.is_file());
        if !there.is_empty() {
            drives.push(LogFile { name: name.clone(), paths: in_time(there), missing });
        }
        drives.extend(join(files));
    } else {
        drives.extend(join(files));
        if let [one] = drives.as_mut_slice()
            && one.paths.len() > 1
        {
            one.name = name;
        }
    }
    // By name, as a folder is listed.
    drives.sort_by(|a, b| a.paths.cmp(&b.paths));
    for below in folders {
        drives.extend(in_folder(&below, depth + 1)?);
    }
    Ok(drives)
}

pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The files that rosbag2's `metadata.yaml` in a folder lists; none without one.
fn files_of_bag(folder: &Path) -> Result<Option<Vec<PathBuf>>> {
    let path = folder.join("metadata.yaml");
    if !path.is_file() {
        return Ok(None);
    }
    let broken = |what: String| {
        anyhow!(
            "{} {what}, expected `rosbag2_bagfile_information: relative_file_paths:`; make it anew with `ros2 bag reindex`, or take it away",
            path.display()
        )
    };
    let text =
        std::fs::read_to_string(&path).map_err(|e| broken(format!("cannot be read: {e}")))?;
    let documents =
        YamlLoader::load_from_str(&text).map_err(|e| broken(format!("is no YAML: {e}")))?;
    let information = documents.first().map(|yaml| &yaml["rosbag2_bagfile_information"]);
    let listed = information.and_then(|yaml| yaml["relative_file_paths"].as_vec());
    let listed = listed.ok_or_else(|| broken("lists no files".to_owned()))?;
    Ok(Some(listed.iter().filter_map(Yaml::as_str).map(|name| folder.join(name)).collect()))
}

/// When a file starts and ends \[ns\], and its topics.
struct Extent {
    start_ns: u64,
    end_ns: u64,
    topics: BTreeSet<String>,
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
            && self.start_ns < next.start_ns
            && self.end_ns <= next.end_ns
            && !self.topics.is_disjoint(&next.topics)
    }
}

fn in_time(files: Vec<PathBuf>) -> Vec<PathBuf> {
    let mut dated: Vec<_> =
        files.into_iter().map(|file| (extent(&file).map(|e| e.start_ns), file)).collect();
    dated.sort();
    dated.into_iter().map(|(_, file)| file).collect()
}

/// Puts files together that belong to one drive: each with the one that goes on where it ends. Of
/// several that do, the one of the same name but for its number; if that does not tell, none.
fn join(files: Vec<PathBuf>) -> Vec<LogFile> {
    // With one file there is nothing to tell apart, and no need to read it.
    if files.len() < 2 {
        return files.into_iter().map(LogFile::of).collect();
    }
    let extents: Vec<Option<Extent>> = files.iter().map(|file| extent(file)).collect();
    let continues = |a: usize, b: usize| {
        extents[a].as_ref().zip(extents[b].as_ref()).is_some_and(|(a, b)| a.continues_in(b))
    };
    let is_family = |a: usize, b: usize| family(&files[a]) == family(&files[b]);
    // Of some candidates the only one, or else the only one of the family.
    let only = |of: usize, candidates: Vec<usize>| -> Option<usize> {
        let family: Vec<usize> = candidates.iter().copied().filter(|&c| is_family(of, c)).collect();
        match (candidates.as_slice(), family.as_slice()) {
            ([one], _) | (_, [one]) => Some(*one),
            _ => None,
        }
    };
    let all = 0..files.len();
    let next = |a: usize| only(a, all.clone().filter(|&b| continues(a, b)).collect());
    let previous = |b: usize| only(b, all.clone().filter(|&a| continues(a, b)).collect());
    // Both ends must be of one mind.
    let successor: BTreeMap<usize, usize> = all
        .clone()
        .filter_map(|a| next(a).filter(|&b| previous(b) == Some(a)).map(|b| (a, b)))
        .collect();
    let followers: BTreeSet<usize> = successor.values().copied().collect();
    all.filter(|file| !followers.contains(file))
        .map(|first| {
            let chain = std::iter::successors(Some(first), |file| successor.get(file).copied());
            let paths = chain.map(|file| files[file].clone()).collect();
            LogFile { paths, ..LogFile::of(files[first].clone()) }
        })
        .collect()
}

/// A file's name without the number at its end: `drive_0.mcap` and `drive_12.mcap` are a family.
fn family(path: &Path) -> String {
    stem(path).trim_end_matches(|c: char| c.is_ascii_digit()).to_owned()
}
