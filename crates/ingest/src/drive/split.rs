//! Finds out which files of a folder belong to one drive.
//!
//! Recorders split a long drive into several files. The `metadata.yaml` of rosbag2 lists the files of
//! a drive. Without it, times and names show which file continues another.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use yaml_rust2::{ScanError, Yaml, YamlLoader};

use crate::mcap::log::Log;

/// Maximum time between the end of a file and the start of the next one \[ns\], in either direction.
const MAX_SPLIT_GAP_NS: u64 = 2_000_000_000;

/// The files of one drive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveFiles {
    /// The files, in order of time. At least one.
    pub paths: Vec<PathBuf>,
    /// Files of the drive that do not exist.
    pub missing: Vec<PathBuf>,
    /// Whether the folder represents the drive: its `metadata.yaml` lists the files, or they are the
    /// only drive in the folder and the drive was split.
    pub is_folder: bool,
}

impl DriveFiles {
    fn new(paths: Vec<PathBuf>) -> Self {
        Self { paths, missing: Vec::new(), is_folder: false }
    }
}

/// The `metadata.yaml` of rosbag2 cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MetadataError {
    /// The file cannot be read.
    #[error("cannot read {path}; create it again with `ros2 bag reindex`, or remove it")]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not YAML.
    #[error("{path} is not valid YAML; create it again with `ros2 bag reindex`, or remove it")]
    Yaml {
        /// The file.
        path: PathBuf,
        /// Where the error is.
        source: ScanError,
    },
    /// The file does not list the files of the drive.
    #[error(
        "{path} lists no files, expected `rosbag2_bagfile_information: relative_file_paths:`; create it again with `ros2 bag reindex`, or remove it"
    )]
    NoFiles {
        /// The file.
        path: PathBuf,
    },
}

/// Groups the log files of a folder into drives, in order of their paths.
///
/// A file that cannot be read, or has no messages, is a drive of its own.
pub fn group_files(
    folder: &Path,
    mut files: Vec<PathBuf>,
) -> Result<Vec<DriveFiles>, MetadataError> {
    let mut drives = Vec::new();
    if let Some(listed) = files_in_metadata(folder)? {
        files.retain(|file| !listed.contains(file));
        let (existing, missing): (Vec<_>, Vec<_>) =
            listed.into_iter().partition(|path| path.is_file());
        if !existing.is_empty() {
            drives.push(DriveFiles { paths: sort_by_time(existing), missing, is_folder: true });
        }
        drives.extend(join_split_files(files));
    } else {
        drives.extend(join_split_files(files));
        if let [only] = drives.as_mut_slice() {
            only.is_folder = only.paths.len() > 1;
        }
    }
    drives.sort_by(|a, b| a.paths.cmp(&b.paths));
    Ok(drives)
}

/// The files that the `metadata.yaml` of a folder lists. `None` without `metadata.yaml`.
fn files_in_metadata(folder: &Path) -> Result<Option<Vec<PathBuf>>, MetadataError> {
    let path = folder.join("metadata.yaml");
    if !path.is_file() {
        return Ok(None);
    }
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(source) => return Err(MetadataError::Read { path, source }),
    };
    let documents = match YamlLoader::load_from_str(&text) {
        Ok(documents) => documents,
        Err(source) => return Err(MetadataError::Yaml { path, source }),
    };
    let information = documents.first().map(|yaml| &yaml["rosbag2_bagfile_information"]);
    match information.and_then(|yaml| yaml["relative_file_paths"].as_vec()) {
        Some(listed) => {
            Ok(Some(listed.iter().filter_map(Yaml::as_str).map(|name| folder.join(name)).collect()))
        }
        None => Err(MetadataError::NoFiles { path }),
    }
}

/// Start and end of a file \[ns\], and its topics.
struct Extent {
    start_ns: u64,
    end_ns: u64,
    topics: BTreeSet<String>,
}

impl Extent {
    /// `None` for a file that cannot be read or has no messages. Ingestion reports it later.
    fn read(path: &Path) -> Option<Self> {
        let contents = Log::open(path).ok()?.contents();
        let (start_ns, end_ns) = contents.time_range_ns?;
        let topics = contents.channels.into_values().map(|channel| channel.topic).collect();
        Some(Self { start_ns, end_ns, topics })
    }

    /// Whether another file continues this one. The files of a drive hardly overlap, because a
    /// recorder writes each message once.
    fn continues_in(&self, next: &Self) -> bool {
        next.start_ns.abs_diff(self.end_ns) <= MAX_SPLIT_GAP_NS
            && self.start_ns < next.start_ns
            && self.end_ns <= next.end_ns
            && !self.topics.is_disjoint(&next.topics)
    }
}

fn sort_by_time(files: Vec<PathBuf>) -> Vec<PathBuf> {
    let mut dated: Vec<_> =
        files.into_iter().map(|file| (Extent::read(&file).map(|e| e.start_ns), file)).collect();
    dated.sort();
    dated.into_iter().map(|(_, file)| file).collect()
}

/// Joins each file with the file that continues it.
///
/// If several files can continue it, the only one with the same name apart from its number is used.
/// If there is no such file, the files are not joined.
fn join_split_files(files: Vec<PathBuf>) -> Vec<DriveFiles> {
    // A single file need not be read.
    if files.len() < 2 {
        return files.into_iter().map(|file| DriveFiles::new(vec![file])).collect();
    }
    let extents: Vec<Option<Extent>> = files.iter().map(|file| Extent::read(file)).collect();
    let continues = |a: usize, b: usize| {
        extents[a].as_ref().zip(extents[b].as_ref()).is_some_and(|(a, b)| a.continues_in(b))
    };
    let is_family = |a: usize, b: usize| family(&files[a]) == family(&files[b]);
    // The only candidate, or else the only candidate of the family.
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
    // The two files must agree: b is next after a, and a is previous to b.
    let successor: BTreeMap<usize, usize> = all
        .clone()
        .filter_map(|a| next(a).filter(|&b| previous(b) == Some(a)).map(|b| (a, b)))
        .collect();
    let continuations: BTreeSet<usize> = successor.values().copied().collect();
    all.filter(|file| !continuations.contains(file))
        .map(|first| {
            let chain = std::iter::successors(Some(first), |file| successor.get(file).copied());
            DriveFiles::new(chain.map(|file| files[file].clone()).collect())
        })
        .collect()
}

/// The name of a file without the number at its end: `drive_0.mcap` and `drive_12.mcap` are a family.
fn family(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    stem.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_that_lists_no_files_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let check = |text: &str| {
            std::fs::write(folder.path().join("metadata.yaml"), text).unwrap();
            group_files(folder.path(), Vec::new())
        };
        assert!(matches!(check("a: [b"), Err(MetadataError::Yaml { .. })));
        assert!(matches!(check("a: b"), Err(MetadataError::NoFiles { .. })));
        let listed = "rosbag2_bagfile_information:\n  relative_file_paths: [a_0.mcap]\n";
        assert_eq!(check(listed).unwrap(), []);
    }

    #[test]
    fn listed_files_are_one_drive_and_the_others_are_not_joined_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let listed = "rosbag2_bagfile_information:\n  relative_file_paths: [b_0.mcap, b_1.mcap]\n";
        std::fs::write(path("metadata.yaml"), listed).unwrap();
        std::fs::write(path("b_0.mcap"), "").unwrap();
        let drives = group_files(folder.path(), vec![path("a.mcap"), path("b_0.mcap")]).unwrap();
        let bag = DriveFiles {
            paths: vec![path("b_0.mcap")],
            missing: vec![path("b_1.mcap")],
            is_folder: true,
        };
        assert_eq!(drives, [DriveFiles::new(vec![path("a.mcap")]), bag]);
    }

    #[test]
    fn the_family_of_a_file_is_its_name_without_the_number() {
        assert_eq!(family(Path::new("x/drive_12.mcap")), "drive_");
        assert_eq!(family(Path::new("drive.mcap")), "drive");
    }
}
