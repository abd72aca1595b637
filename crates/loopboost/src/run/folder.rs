//! The run folder: its lock, and files that an interrupted run left half written.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use dataset::tables::is_partial;

use crate::other_run::OtherRun;
use crate::stage::Artifact;

/// A folder that this process has locked, or only looks at.
///
/// ```text
/// <folder>/
///   run.json                     what was made from what (see `manifest`)
///   run.journal                  the same, while a command runs
///   logs/<log>.mcap              simulated logs
///   scans/<log>.parquet          poses/<log>.parquet      keyframes/<log>.parquet
///   features/<log>.parquet       feature_stability.parquet
///   pairs.parquet
///   scores.parquet               rounds.parquet           retrieval.parquet  grid.parquet
///   feature_usefulness.parquet
///   registered/<log>.parquet     odometry/<log>.parquet   candidates.parquet
///   closures.parquet             trajectory.parquet       graph.parquet      graph.g2o
///   trajectory/<log>.parquet     trajectory/<log>.tum     truth/<log>.parquet
///   models/<name>/<version>/     model.json, card.md
///   evaluation/*.parquet         evaluation/summary.json  evaluation/figures/*.svg
///   report.html
/// ```
pub(crate) struct RunFolder {
    pub(super) root: PathBuf,
    /// The run folder that the results are for, if `root` is a temporary folder.
    pub(super) target: Option<PathBuf>,
    /// The runs whose maps are used.
    pub(super) other_runs: Vec<OtherRun>,
    /// Held for the lifetime of this value; the system releases it when the process ends.
    _lock: Option<File>,
}

impl RunFolder {
    /// Locks a run folder for writing and removes half-written files. Creates the folder if it is
    /// missing; fails if another process has locked it.
    pub(crate) fn lock(root: PathBuf) -> Result<Self> {
        let lock = lock(&root)?;
        remove_partial_files(&root)?;
        Ok(Self { root, target: None, other_runs: Vec::new(), _lock: Some(lock) })
    }

    /// A run folder that nothing is written to.
    pub(super) fn read_only(root: PathBuf) -> Self {
        Self { root, target: None, other_runs: Vec::new(), _lock: None }
    }

    /// A temporary folder, for results that go to a run folder later.
    pub(super) fn scratch(root: PathBuf, target: PathBuf) -> Self {
        Self { target: Some(target), ..Self::read_only(root) }
    }

    /// A path in the run folder.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// The files of a simulated log, in order of time.
    pub(super) fn simulated_log(&self, log: &str, n_files: u32) -> Vec<PathBuf> {
        match n_files {
            1 => vec![self.path(&Artifact::Log.name(log))],
            n => (0..n).map(|k| self.path(&format!("logs/{log}/{log}_{k}.mcap"))).collect(),
        }
    }

    /// The name of a file in the run folder, or in a run whose map is used; the file name alone
    /// where it is elsewhere.
    pub(super) fn name_of(&self, path: &Path) -> String {
        let of_table = |path: &&Path| path.extension().is_some_and(|end| end == "parquet");
        let of_other_run = self.other_runs.iter().filter(|_| of_table(&path));
        if let Some(name) = of_other_run.filter_map(|run| run.name_of(path)).next() {
            return name;
        }
        let mut folders = [Some(&self.root), self.target.as_ref()].into_iter().flatten();
        let within = folders.find_map(|folder| path.strip_prefix(folder).ok());
        let name = within.or(path.file_name().map(Path::new));
        name.unwrap_or(path).to_string_lossy().into_owned()
    }
}

fn lock(folder: &Path) -> Result<File> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot create folder {}", folder.display()))?;
    let path = folder.join(".lock");
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .with_context(|| format!("cannot open {}", path.display()))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(std::fs::TryLockError::WouldBlock) => Err(anyhow!(
            "another run is using {}; wait until it has finished, or choose another --out",
            folder.display()
        )),
        Err(std::fs::TryLockError::Error(e)) => {
            Err(e).with_context(|| format!("cannot lock {}", path.display()))
        }
    }
}

/// Removes files that an interrupted run left half written, only in folders that a run writes to.
fn remove_partial_files(folder: &Path) -> Result<()> {
    let of_logs = Artifact::ALL.into_iter().filter_map(Artifact::folder);
    let of_logs: BTreeSet<String> = of_logs.map(|folder| format!("{folder}/**/.*")).collect();
    let others = [".*", "evaluation/.*", "evaluation/figures/.*", "models/*/*/.*"];
    for pattern in others.into_iter().chain(of_logs.iter().map(String::as_str)) {
        let pattern = format!("{}/{pattern}", glob::Pattern::escape(&folder.to_string_lossy()));
        for path in glob::glob(&pattern).into_iter().flatten().flatten() {
            if is_partial(&path) && path.is_file() {
                std::fs::remove_file(&path)
                    .with_context(|| format!("cannot remove {}", path.display()))?;
            }
        }
    }
    Ok(())
}
