//! A task of a plan: what it is about, what it reads, and what its result depends on.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::paths;
use crate::logs::LogFile;
use crate::run::Run;
use crate::stage::{Artifact, Stage};

/// Version of the layout of plans and records. Files of another version are not read.
pub(super) const FORMAT_VERSION: u32 = 1;

/// A task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Entry {
    /// Position in the list.
    pub(super) index: usize,
    pub(super) kind: Kind,
    /// The name of the log.
    pub(super) key: String,
    /// BLAKE3 of everything that the result depends on. Tasks with the same value in two plans have the same result.
    pub(super) task: String,
    /// The files of the log, in order of time.
    pub(super) files: Vec<Input>,
    /// Files that belong to the log and do not exist.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) missing: Vec<String>,
    /// Files with poses of the log.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) others: Vec<Input>,
    /// Another log with the same site.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) sharer: Option<String>,
}

/// What a task is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    /// A log: from its bytes to the tables that depend on no other log.
    Log,
}

/// A file that a task reads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Input {
    /// Relative to the root.
    pub(super) path: String,
    /// Size \[bytes\] and time of the last change \[ns since 1970\]. `None` if the file did not exist.
    pub(super) version: Option<(u64, u128)>,
}

impl Input {
    /// A file as it is now.
    fn of(root: &Path, path: &Path) -> Result<Self> {
        Ok(Self { path: paths::relative(root, path)?, version: version(path)? })
    }
}

/// Size and time of the last change of a file; `None` if it does not exist.
pub(super) fn version(path: &Path) -> Result<Option<(u64, u128)>> {
    let read = std::fs::metadata(path).and_then(|of| Ok((of.len(), of.modified()?)));
    match read {
        Ok((n_bytes, changed)) => {
            let since = changed.duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
            Ok(Some((n_bytes, since.as_nanos())))
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
    }
}

impl Entry {
    pub(super) fn of_log(
        run: &Run,
        log: &LogFile,
        index: usize,
        root: &Path,
        sharer: Option<String>,
    ) -> Result<Self> {
        let input = |path: &PathBuf| Input::of(root, &paths::canonical_file(path)?);
        let files = log.paths.iter().map(input).collect::<Result<Vec<_>>>()?;
        let others = pose_files(run, log)?.iter().map(input).collect::<Result<Vec<_>>>()?;
        let missing = log.missing.iter().map(|path| {
            let path = paths::canonical_file(path)?;
            paths::relative(root, &path)
        });
        let missing: Vec<String> = missing.collect::<Result<_>>()?;
        let mut options = BTreeMap::new();
        for stage in Stage::OF_LOGS {
            if run.goal.has_stage(stage) {
                let of_stage = run.options_of(stage, Some(&log.name), None)?;
                options.insert(stage.name(), of_stage);
            }
        }
        if run.goal.has(Artifact::Truth) {
            let only = Some(Artifact::Truth);
            options.insert("truth", run.options_of(Stage::Ingest, Some(&log.name), only)?);
        }
        // Where the files are does not matter, but their names are a part of the tables.
        let identity = |input: &Input| json!([file_name(&input.path), input.version]);
        let depends_on = json!({
            "program": env!("CARGO_PKG_VERSION"),
            "format": FORMAT_VERSION,
            "tables": dataset::tables::FORMAT_VERSION,
            "kind": Kind::Log,
            "log": log.name,
            "options": options,
            "max_pose_gap_secs": run.config.subsample.max_pose_gap_secs,
            "min_path_m": run.config.detection().min_path_m,
            "is_shared": sharer.is_some(),
            "files": files.iter().map(identity).collect::<Vec<_>>(),
            "others": others.iter().map(identity).collect::<Vec<_>>(),
            "missing": missing.iter().map(|path| file_name(path)).collect::<Vec<_>>(),
        });
        let task = blake3::hash(&serde_json::to_vec(&depends_on)?).to_hex().to_string();
        let key = log.name.to_string();
        Ok(Self { index, kind: Kind::Log, key, task, files, missing, others, sharer })
    }

    /// The log, with its files below the root.
    pub(super) fn log(&self, root: &Path) -> LogFile {
        let files = self.files.iter().map(|input| root.join(&input.path)).collect();
        let missing = self.missing.iter().map(|path| root.join(path)).collect();
        let mut log = LogFile::named(self.key.as_str(), files);
        log.missing = missing;
        log
    }

    /// The first input that is not as it was when the plan was made, and what is different.
    pub(super) fn changed_input(&self, root: &Path) -> Result<Option<String>> {
        for input in self.files.iter().chain(&self.others) {
            let path = root.join(&input.path);
            let now = version(&path)?;
            if now != input.version {
                let text = |version: Option<(u64, u128)>| match version {
                    Some((n_bytes, ns)) => format!("{n_bytes} bytes, changed at {ns} ns"),
                    None => "missing".to_owned(),
                };
                return Ok(Some(format!(
                    "{} differs from the plan: found {}, expected {}; if it was replaced, run `loopboost plan` again",
                    path.display(),
                    text(now),
                    text(input.version)
                )));
            }
        }
        Ok(None)
    }
}

/// The files with the poses and with the ground truth of a log.
pub(super) fn pose_files(run: &Run, log: &LogFile) -> Result<Vec<PathBuf>> {
    let poses = run.config.pose_file(&log.name)?;
    Ok(poses.into_iter().chain(run.config.truth_file(&log.name)).collect())
}

fn file_name(path: &str) -> &str {
    path.rsplit_once('/').map_or(path, |(_, name)| name)
}

/// Whether a path with this name could be outside its folder.
pub(super) fn is_unsafe(name: &str) -> bool {
    name.split('/').any(|part| part.is_empty() || part == "." || part == "..")
}
