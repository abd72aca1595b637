//! Finds the logs of a run: the files, folders and globs in `ingest.logs`.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use ingest::{DriveFiles, group_files};

/// A log of the run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct LogFile {
    /// The stem of the file, or the name of the folder for a split drive that is the only one in it. A log that shares
    /// it with another log of the run has a longer name (see [`name_apart`]). Unique in the run.
    pub(crate) name: Arc<str>,
    /// The names to use if several logs have the same one: the path from the folder in `ingest.logs`, and
    /// the same with the name of that folder.
    longer: [Arc<str>; 2],
    /// One file, or the files of a split drive in order of time.
    pub(crate) paths: Vec<PathBuf>,
    /// Files of the drive that do not exist.
    pub(crate) missing: Vec<PathBuf>,
}

impl LogFile {
    /// A log of one file.
    pub(crate) fn of(path: PathBuf) -> Self {
        Self::named(log_name(&path), vec![path])
    }

    /// A log with this name.
    pub(crate) fn named(name: impl Into<Arc<str>>, paths: Vec<PathBuf>) -> Self {
        let name: Arc<str> = name.into();
        Self { longer: [name.clone(), name.clone()], name, paths, missing: Vec::new() }
    }

    /// Sets the longer names of a log that was found below the folder `base`.
    fn found_below(mut self, base: &Path) -> Self {
        let folder = self.paths[0].parent().unwrap_or(Path::new(""));
        // A split drive has the name of its folder.
        let is_folder = *self.name != *log_name(&self.paths[0]);
        let folder = if is_folder { folder.parent().unwrap_or(Path::new("")) } else { folder };
        let parts = |path: &Path| -> Vec<String> {
            let normal = path.components().filter(|part| matches!(part, Component::Normal(_)));
            normal.map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
        };
        // A drive whose folder is listed itself is not below it.
        let Ok(below) = folder.strip_prefix(base) else { return self };
        let mut within = parts(below);
        within.push(self.name.to_string());
        self.longer[0] = within.join("/").into();
        if let Some(last) = parts(base).last() {
            self.longer[1] = format!("{last}/{}", self.longer[0]).into();
        }
        self
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

/// Gives logs that share a name longer names: the path from the folder in `ingest.logs`, such as `north/monday`, and if
/// that is not enough, with the name of that folder. A name does not depend on where the folder is. It depends on other
/// logs only in that a name that is used twice is not used at all. `taken` are names of other logs of the run.
pub(crate) fn name_apart(logs: &mut [LogFile], taken: &[String]) {
    for level in 0..2 {
        let mut counts: BTreeMap<Arc<str>, usize> = BTreeMap::new();
        let names = logs.iter().map(|log| log.name.clone());
        for name in names.chain(taken.iter().map(|name| name.as_str().into())) {
            *counts.entry(name).or_default() += 1;
        }
        for log in logs.iter_mut().filter(|log| 1 < counts[&log.name]) {
            log.name = log.longer[level].clone();
        }
    }
}

/// Maximum depth of nested folders. A deeper path is a link to a folder above.
const MAX_DEPTH: usize = 16;

/// The logs of an entry of `ingest.logs`, sorted by name for a folder or glob. A single file need not
/// exist, because only `ingest` reads it.
pub(crate) fn find(folder: &Path, entry: &str) -> Result<Vec<LogFile>> {
    let path = folder.join(entry);
    let (found, base) = if path.is_dir() {
        (in_folder(&path, 0)?, path.clone())
    } else if path.exists() || !entry.contains(['*', '?', '[']) {
        // The folder of a file is a part of its longer names if the entry names it.
        let folder = Path::new(entry).parent().and_then(Path::file_name);
        let base = path.ancestors().nth(if folder.is_some() { 2 } else { 1 }).map(Path::to_owned);
        let log = LogFile::of(path).found_below(&base.unwrap_or_default());
        let longer = [log.longer[0].clone(), log.longer[0].clone()];
        return Ok(vec![LogFile { longer, ..log }]);
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
        // The folders before the first one with a placeholder.
        let is_fixed =
            |part: &Component<'_>| !part.as_os_str().to_string_lossy().contains(['*', '?', '[']);
        let fixed: PathBuf = Path::new(entry).components().take_while(is_fixed).collect();
        (logs, folder.join(fixed))
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
    Ok(found.into_iter().map(|log| log.found_below(&base)).collect())
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
        LogFile { missing, ..LogFile::named(name, paths) }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The names of the logs of some entries of `ingest.logs`.
    fn names(files: &[&str], entries: &[&str]) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, file).unwrap();
        }
        let find = |entry: &&str| find(folder.path(), entry).unwrap();
        let mut logs: Vec<LogFile> = entries.iter().flat_map(find).collect();
        name_apart(&mut logs, &["simulated".to_owned()]);
        logs.iter().map(|log| log.name.to_string()).collect()
    }

    #[test]
    fn a_name_is_as_long_as_it_must_be() {
        let files = ["d/a/x.mcap", "d/b/x.mcap", "d/b/y.mcap", "d/simulated.mcap"];
        // A folder, a glob, and files.
        assert_eq!(names(&files, &["d"]), ["d/simulated", "a/x", "b/x", "y"]);
        assert_eq!(names(&files, &["d/*/?.mcap"]), ["a/x", "b/x", "y"]);
        assert_eq!(names(&files, &["d/a/x.mcap", "d/b/y.mcap"]), ["x", "y"]);
        assert_eq!(names(&files, &["d/a/x.mcap", "d/b/x.mcap"]), ["a/x", "b/x"]);
        // The path from the folder is the same, so its name is added.
        assert_eq!(names(&files, &["d/a", "d/b"]), ["a/x", "b/x", "y"]);
        // The same file twice has the same name twice.
        assert_eq!(names(&files, &["d/a/x.mcap", "d/a/x.mcap"]), ["a/x", "a/x"]);
    }

    /// The files of a split drive have no metadata here, so they are joined only if they can be read: the listed ones.
    #[test]
    fn a_split_drive_is_named_after_its_folder() {
        let metadata = |folder: &Path| {
            let text =
                "rosbag2_bagfile_information:\n  relative_file_paths: [p_0.mcap, p_1.mcap]\n";
            std::fs::write(folder.join("metadata.yaml"), text).unwrap();
        };
        let root = tempfile::tempdir().unwrap();
        for name in ["north/monday", "south/monday"] {
            let folder = root.path().join(name);
            std::fs::create_dir_all(&folder).unwrap();
            metadata(&folder);
            std::fs::write(folder.join("p_0.mcap"), b"0").unwrap();
            std::fs::write(folder.join("p_1.mcap"), b"1").unwrap();
        }
        let mut logs = find(root.path(), "north").unwrap();
        assert_eq!((&*logs[0].name, logs[0].paths.len()), ("monday", 2));
        logs.extend(find(root.path(), "south").unwrap());
        name_apart(&mut logs, &[]);
        let names: Vec<&str> = logs.iter().map(|log| &*log.name).collect();
        assert_eq!(names, ["north/monday", "south/monday"]);
    }
}
