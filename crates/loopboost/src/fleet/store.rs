//! The files that tasks share: objects named after their content, and records that are never overwritten.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result};
use dataset::tables::digest_file;
use serde::{Deserialize, Serialize};

use super::entry::{Entry, FORMAT_VERSION, is_unsafe};
use super::paths;
use super::trouble::Conflict;
use crate::config::usage;
use crate::run::Record as TaskRecord;
use crate::stage::Artifact;

/// The folders of a run folder that tasks write to.
///
/// ```text
/// <folder>/
///   plan/<plan>.json             a plan; the name is the BLAKE3 digest of the file
///   objects/<digest>             a table; the name is its BLAKE3 digest
///   done/<plan>/<index>.json     what a task made; created once, never overwritten
///   done/<plan>/<index>.<digest>.json   what another attempt of the task made, if it is not the same
///   keys/<task>.json             the same record by what the task depends on, for other plans
/// ```
///
/// No file is written in place. A file appears under its name complete, and after its content is on disk, so a process
/// can be killed at any time, and two of them can do the same task.
pub(super) struct Store {
    folder: PathBuf,
}

/// What a task made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    format_version: u32,
    /// The task, as in the plan.
    task: String,
    /// The name of the log.
    key: String,
    /// Why the log is left out, as a code.
    pub(super) failed: Option<String>,
    /// As in `run.json`.
    pub(super) tasks: BTreeMap<String, TaskRecord>,
}

impl Record {
    pub(super) fn new(
        entry: &Entry,
        failed: Option<String>,
        tasks: BTreeMap<String, TaskRecord>,
    ) -> Self {
        let (task, key) = (entry.task.clone(), entry.key.clone());
        Self { format_version: FORMAT_VERSION, task, key, failed, tasks }
    }

    pub(super) fn bytes(&self) -> Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    /// Reads the record of an entry. The error says why it is not a valid one.
    pub(super) fn parse(bytes: &[u8], entry: &Entry) -> Result<Self, String> {
        let record: Self = serde_json::from_slice(bytes).map_err(|e| format!("is damaged: {e}"))?;
        if record.format_version != FORMAT_VERSION {
            return Err(format!(
                "has format version {}, expected {FORMAT_VERSION}",
                record.format_version
            ));
        }
        if record.task != entry.task || record.key != entry.key {
            return Err(format!(
                "is the record of another task: log `{}`, task {}; expected log `{}`, task {}",
                record.key, record.task, entry.key, entry.task
            ));
        }
        let is_of_log = |name: &&String| {
            let of = Artifact::of_name(name);
            of.is_some_and(|(_, log)| log == Some(&entry.key)) && !is_unsafe(name)
        };
        let mut names = record.tasks.values().flat_map(|task| task.outputs.keys());
        match names.find(|name| !is_of_log(name)) {
            Some(name) => Err(format!("has a table that is not one of the log: {name}")),
            // The bytes must be those that a task writes, so that an edited file is noticed.
            None if record.bytes().ok().as_deref() != Some(bytes) => {
                Err("was edited: a task would write it in another way".to_owned())
            }
            None => Ok(record),
        }
    }

    /// The names of the tables in the run folder, with their digests.
    pub(super) fn outputs(&self) -> impl Iterator<Item = (&String, &String)> {
        self.tasks.values().flat_map(|task| &task.outputs)
    }
}

impl Store {
    /// The store of a run folder, which is created if it is missing.
    pub(super) fn create(run_folder: &Path) -> Result<Self> {
        fs::create_dir_all(run_folder)
            .with_context(|| format!("cannot create folder {}", run_folder.display()))?;
        Self::open(run_folder)
    }

    /// The store of a run folder.
    pub(super) fn open(run_folder: &Path) -> Result<Self> {
        Ok(Self { folder: paths::canonical(run_folder)? })
    }

    pub(super) fn run_folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn plan_path(&self, id: &str) -> PathBuf {
        self.folder.join("plan").join(format!("{id}.json"))
    }

    /// The path of an object.
    pub(super) fn object(&self, digest: &str) -> PathBuf {
        self.folder.join("objects").join(digest)
    }

    /// The folder of the records of a plan.
    pub(super) fn done(&self, plan: &str) -> PathBuf {
        self.folder.join("done").join(plan)
    }

    fn key(&self, entry: &Entry) -> PathBuf {
        self.folder.join("keys").join(format!("{}.json", entry.task))
    }

    /// Whether an object is there, with the content that its name says.
    pub(super) fn has(&self, digest: &str) -> Result<bool> {
        let path = self.object(digest);
        if !path.try_exists().with_context(|| format!("cannot read {}", path.display()))? {
            return Ok(false);
        }
        Ok(digest_file(&path)? == digest)
    }

    /// Stores a file as an object. Returns its digest.
    pub(super) fn put(&self, file: &Path) -> Result<String> {
        let digest = digest_file(file)?;
        let object = self.object(&digest);
        if self.has(&digest)? {
            self.keep(&digest);
            return Ok(digest);
        }
        let bytes = |out: &mut File| -> std::io::Result<()> {
            std::io::copy(&mut File::open(file)?, out).map(drop)
        };
        let partial = self.write_partial(&object, bytes)?;
        // An object with the wrong content is replaced.
        persist(partial, &object)?;
        sync_folder(&object)?;
        Ok(digest)
    }

    /// Marks an object as used again: `gc` keeps new objects, which may have no record yet.
    pub(super) fn keep(&self, digest: &str) {
        // Another user's object cannot be marked. If `gc` removes it, `merge` says so.
        let object = File::options().write(true).open(self.object(digest));
        let _ = object.and_then(|file| file.set_modified(SystemTime::now()));
    }

    /// Writes a plan. One that is there has the same bytes, or it is replaced.
    pub(super) fn write_plan(&self, id: &str, bytes: &[u8]) -> Result<PathBuf> {
        let path = self.plan_path(id);
        let partial = self.write_partial(&path, |out| out.write_all(bytes))?;
        persist(partial, &path)?;
        sync_folder(&path)?;
        Ok(path)
    }

    /// The bytes of the record of an entry in a plan.
    pub(super) fn record(&self, plan: &str, entry: &Entry) -> Result<Option<Vec<u8>>> {
        read(&self.done(plan).join(format!("{}.json", entry.index)))
    }

    /// The bytes of the record of the same task in another plan.
    pub(super) fn known(&self, entry: &Entry) -> Result<Option<Vec<u8>>> {
        read(&self.key(entry))
    }

    /// Publishes the record of an entry. The first one counts: if another attempt has published one with other bytes,
    /// this one is kept beside it, and it is an error.
    pub(super) fn commit(&self, plan: &str, entry: &Entry, bytes: &[u8]) -> Result<()> {
        let path = self.done(plan).join(format!("{}.json", entry.index));
        if let Some(found) = self.create_once(&path, bytes)? {
            if found == bytes {
                return Ok(());
            }
            let digest = blake3::hash(bytes).to_hex();
            let other = path.with_file_name(format!("{}.{digest}.json", entry.index));
            self.create_once(&other, bytes)?;
            return Err(Conflict { path, other }.into());
        }
        // Another plan may have done the same task in the meantime.
        self.create_once(&self.key(entry), bytes)?;
        Ok(())
    }

    /// Creates a file with this content. Returns the content of a file that exists already.
    fn create_once(&self, path: &Path, bytes: &[u8]) -> Result<Option<Vec<u8>>> {
        let cannot = || format!("cannot write {}", path.display());
        let partial = self.write_partial(path, |out| out.write_all(bytes))?;
        match fs::hard_link(&partial, path) {
            Ok(()) => {}
            // A link over NFS can be made and reported as a failure, if the answer was lost.
            Err(error) => match read(path)? {
                Some(found) => {
                    sync_folder(path)?;
                    return Ok(Some(found));
                }
                None if error.kind() == ErrorKind::Unsupported => {
                    return Err(usage(format!(
                        "{}: the file system has no hard links, which records need; choose another run folder",
                        path.display()
                    )));
                }
                None => return Err(error).with_context(cannot),
            },
        }
        sync_folder(path)?;
        Ok(None)
    }

    /// A temporary file in the folder of `path`, whose content is on disk.
    fn write_partial(
        &self,
        path: &Path,
        fill: impl FnOnce(&mut File) -> std::io::Result<()>,
    ) -> Result<tempfile::TempPath> {
        let cannot = || format!("cannot write {}", path.display());
        let folder = path.parent().unwrap_or(&self.folder);
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create folder {}", folder.display()))?;
        let mut partial = tempfile::Builder::new();
        partial.prefix(".").suffix(".partial");
        // Other users may read the file, as with other files.
        #[cfg(unix)]
        partial.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut partial = partial.tempfile_in(folder).with_context(cannot)?;
        fill(partial.as_file_mut()).with_context(cannot)?;
        partial.as_file().sync_all().with_context(cannot)?;
        Ok(partial.into_temp_path())
    }
}

/// Gives a temporary file its name.
fn persist(partial: tempfile::TempPath, path: &Path) -> Result<()> {
    let named = partial.persist(path).map_err(|error| error.error);
    named.with_context(|| format!("cannot write {}", path.display()))
}

/// The content of a file; `None` if it does not exist.
fn read(path: &Path) -> Result<Option<Vec<u8>>> {
    match fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
    }
}

/// Makes sure that the name of a new file is on disk.
fn sync_folder(path: &Path) -> Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .with_context(|| format!("cannot write the folder {}", folder.display()))
}
