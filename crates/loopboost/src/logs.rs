//! Finds the logs of a run: the files, folders and globs in `ingest.logs`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use ingest::{DriveFiles, group_files};

/// A log of the run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct LogFile {
    /// The stem of the file, or the name of the folder for a split drive that is the only one in it.
    /// Unique in the run.
    pub(crate) name: Arc<str>,
    /// One file, or the files of a split drive in order of time.
    pub(crate) paths: Vec<PathBuf>,
    /// Files of the drive that do not exist.
    pub(crate) missing: Vec<PathBuf>,
}

impl LogFile {
    /// A log of one file.
    pub(crate) fn of(path: PathBuf) -> Self {
        Self { name: log_name(&path).into(), paths: vec![path], missing: Vec::new() }
    }

    /// Its location for messages: the file, or the folder of the files.
    pub(crate) fn place(&self) -> String {
        let first = &self.paths[0];
        match self.paths.len() {
            1 => first.display().to_string(),
            n => {
                let folder = first.parent().unwrap_or(Path::new(""));
                format!("{} ({n} files, the first is {})", folder.display(), file_name(first))
            }
        }
    }
}

/// Maximum depth of nested folders. A deeper path is a link to a folder above.
const MAX_DEPTH: usize = 16;

/// The logs of an entry of `ingest.logs`, sorted by name for a folder or glob. A single file need not
/// exist, because only `ingest` reads it.
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
            .with_context(|| format!("`ingest.logs`: `{entry}` is not a path or glob"))?;
        let mut logs = Vec::new();
        for path in matches {
            let path =
                path.with_context(|| format!("`ingest.logs`: cannot search for `{entry}`"))?;
            match path.is_dir() {
                true => logs.extend(in_folder(&path, 0)?),
                false => logs.push(LogFile::of(path)),
            }
        }
        logs
    };
    if found.is_empty() {
        return Err(match ::import::identify(&path) {
            Some(known) => anyhow!(
                "`ingest.logs`: no *.mcap file in `{entry}`: it is {}; {}",
                known.format,
                known.remedy
            ),
            None => anyhow!(
                "`ingest.logs`: no *.mcap file in `{entry}` (searched {}; paths are relative to the pipeline file)",
                path.display()
            ),
        });
    }
    Ok(found)
}

/// The logs of a folder and its subfolders. Names that start with a dot are ignored.
pub(crate) fn in_folder(folder: &Path, depth: usize) -> Result<Vec<LogFile>> {
    let failed = || format!("`ingest.logs`: cannot list the folder {}", folder.display());
    if MAX_DEPTH < depth {
        return Err(anyhow!("more than {MAX_DEPTH} nested folders: {}", folder.display()))
            .with_context(failed);
    }
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect())
        .with_context(failed)?;
    entries.retain(|path| !file_name(path).starts_with('.'));
    entries.sort();
    let (folders, files): (Vec<_>, Vec<_>) = entries.into_iter().partition(|path| path.is_dir());
    // A compressed log is an error that names the command, unless it was decompressed.
    let is_log =
        |path: &PathBuf| is_mcap(path) || compressed_mcap(path).is_some_and(|mcap| !mcap.exists());
    let files: Vec<PathBuf> = files.into_iter().filter(is_log).collect();

    // The path of `.` or `..` does not contain the name of the folder.
    let name: Arc<str> = file_name(&folder.canonicalize().with_context(failed)?).into();
    let named = |DriveFiles { paths, missing, is_folder }| {
        let name = if is_folder { name.clone() } else { log_name(&paths[0]).into() };
        LogFile { name, paths, missing }
    };
    let mut drives: Vec<LogFile> = group_files(folder, files)?.into_iter().map(named).collect();
    // `metadata.yaml` may list the decompressed file. It is already counted as missing.
    let missing: Vec<PathBuf> = drives.iter().flat_map(|drive| drive.missing.clone()).collect();
    drives.retain(|drive| {
        !compressed_mcap(&drive.paths[0]).is_some_and(|mcap| missing.contains(&mcap))
    });
    for subfolder in folders {
        drives.extend(in_folder(&subfolder, depth + 1)?);
    }
    Ok(drives)
}

fn is_mcap(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap"))
}

/// For a file such as `a.mcap.zstd`, which rosbag2 writes with `--compression-mode file`: `a.mcap`.
fn compressed_mcap(path: &Path) -> Option<PathBuf> {
    const ENDINGS: [&str; 6] = ["zstd", "zst", "lz4", "gz", "bz2", "xz"];
    let ending = path.extension()?.to_str()?.to_ascii_lowercase();
    let mcap = path.with_extension("");
    (ENDINGS.contains(&ending.as_str()) && is_mcap(&mcap)).then_some(mcap)
}

/// The name of a log: that of its file, without `.mcap`.
fn log_name(path: &Path) -> String {
    compressed_mcap(path).map_or_else(|| stem(path), |mcap| stem(&mcap))
}

/// The name of a file without its last extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
