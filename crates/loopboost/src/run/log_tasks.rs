//! The tasks of a single log, done elsewhere and put together.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;

use super::folder::RunFolder;
use super::manifest::{Change, Manifest, Record};
use super::{Mode, Run};
use crate::config::Config;
use crate::detector_evidence::starting_values;
use crate::goal::Goal;
use crate::logs::LogFile;
use crate::stage::Stage;
use crate::used_model::UsedModel;

/// The tasks of a log that were done, and why it is left out of the run, as a code.
pub(crate) struct LogTasks {
    pub(crate) failed: Option<String>,
    pub(crate) tasks: BTreeMap<String, Record>,
}

impl Run {
    /// A run of a single log in a temporary folder, for the run folder `target`.
    pub(crate) fn of_log(
        config: Config,
        scratch: &Path,
        target: &Path,
        model: Option<UsedModel>,
        log: LogFile,
    ) -> Self {
        let goal = Goal::of(&config, model.as_ref());
        Self {
            config,
            goal,
            model,
            starting_values: starting_values(goal),
            manifest: RefCell::default(),
            digests: RefCell::default(),
            states: RefCell::default(),
            fresh: RefCell::default(),
            scan_cache: Arc::default(),
            stage: Cell::new(None),
            would_change: RefCell::default(),
            folder: RunFolder::scratch(scratch.to_owned(), target.to_owned()),
            mode: Mode::Always,
            strict: false,
            logs: OnceCell::from(vec![log]),
        }
    }

    /// What was done.
    pub(crate) fn into_tasks(self, log: &str) -> LogTasks {
        let Manifest { mut failed, tasks, .. } = self.manifest.into_inner();
        LogTasks { failed: failed.remove(log), tasks }
    }
}

impl RunFolder {
    /// Adds the tasks of logs to `run.json`, in place of those that were there, and the copies among the logs.
    pub(crate) fn write_manifest(
        &self,
        logs: BTreeMap<String, LogTasks>,
        copies: BTreeMap<String, String>,
    ) -> Result<()> {
        let mut manifest = Manifest::load(&self.root)?;
        manifest.apply(Change::Copies(copies));
        for (log, LogTasks { failed, tasks }) in logs {
            for stage in Stage::OF_LOGS {
                manifest.tasks.remove(&format!("{stage} {log}"));
            }
            manifest.tasks.remove(&format!("{} {log} truth", Stage::Ingest));
            manifest.tasks.extend(tasks);
            manifest.apply(match failed {
                Some(error) => Change::Failed { log, error },
                None => Change::Ingested { log },
            });
        }
        manifest.save(&self.root)
    }
}
