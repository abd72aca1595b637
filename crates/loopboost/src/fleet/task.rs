//! One task: from the bytes of a log to its record.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};

use super::entry::Entry;
use super::plan::Plan;
use super::store::{Record, Store};
use super::trouble::InputTrouble;
use crate::logs::LogFile;
use crate::run::{LogTasks, Run};
use crate::stage::Stage;
use crate::stages::{featurize, ingest, register, subsample};
use crate::used_model::UsedModel;

/// Does tasks of a plan.
pub(super) struct Worker<'a> {
    pub(super) store: &'a Store,
    pub(super) plan: &'a Plan,
    /// The name of the plan.
    pub(super) id: &'a str,
    /// The folder that the paths of inputs are relative to.
    pub(super) root: PathBuf,
    pub(super) model: Option<UsedModel>,
    /// Where the temporary folder is created.
    pub(super) scratch: PathBuf,
}

impl Worker<'_> {
    /// Does a task, unless its record exists.
    pub(super) fn run(&self, entry: &Entry) -> Result<()> {
        if let Some(bytes) = self.store.record(self.id, entry)?
            && self.is_complete(entry, &bytes)?
        {
            eprintln!("task {}, log `{}`: done before", entry.index, entry.key);
            return Ok(());
        }
        if let Some(bytes) = self.store.known(entry)?
            && self.is_complete(entry, &bytes)?
        {
            eprintln!("task {}, log `{}`: done before, for another plan", entry.index, entry.key);
            for (_, digest) in Record::parse(&bytes, entry).iter().flat_map(Record::outputs) {
                self.store.keep(digest);
            }
            return self.store.commit(self.id, entry, &bytes);
        }
        let record = self.compute(entry)?;
        self.store.commit(self.id, entry, &record.bytes()?)
    }

    /// Whether a record is valid and its tables are there.
    fn is_complete(&self, entry: &Entry, bytes: &[u8]) -> Result<bool> {
        let Ok(record) = Record::parse(bytes, entry) else { return Ok(false) };
        for (_, digest) in record.outputs() {
            if !self.store.has(digest)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Makes the tables of a log in a temporary folder, and stores them.
    fn compute(&self, entry: &Entry) -> Result<Record> {
        self.check_inputs(entry)?;
        let cannot = || format!("cannot create a folder in {}", self.scratch.display());
        let scratch = tempfile::Builder::new().prefix("loopboost-").tempdir_in(&self.scratch);
        let scratch = scratch.with_context(cannot)?;
        let log = entry.log(&self.root);
        let config = self.plan.config(&self.root)?;
        let own = self.store.run_folder();
        let run = Run::of_log(config, scratch.path(), own, self.model.clone(), log.clone());
        let stages = stages(&run, &log, entry.sharer.as_deref());
        // An input that was replaced explains other errors, and a result without error is not that of the plan.
        self.check_inputs(entry)?;
        stages?;
        let LogTasks { failed, tasks } = run.into_tasks(&log.name);
        let record = Record::new(entry, failed, tasks);
        for (name, digest) in record.outputs() {
            let stored = self.store.put(&scratch.path().join(name))?;
            if stored != *digest {
                let path = scratch.path().join(name);
                let text = format!("{} was altered after it was written", path.display());
                return Err(InputTrouble(text).into());
            }
        }
        Ok(record)
    }

    fn check_inputs(&self, entry: &Entry) -> Result<()> {
        match entry.changed_input(&self.root)? {
            Some(change) => Err(InputTrouble(change).into()),
            None => Ok(()),
        }
    }
}

/// The stages that work log by log, as `loopboost run` does them.
fn stages(run: &Run, log: &LogFile, sharer: Option<&str>) -> Result<()> {
    let mut findings = match ingest::of_log(run, log, None, sharer)? {
        Ok(findings) => findings,
        Err(reason) => {
            eprintln!("log `{}` left out of the run: {reason:#}", log.name);
            return Ok(());
        }
    };
    findings.merge(subsample::of_log(run, log)?);
    if run.goal.has_stage(Stage::Featurize) {
        let name: &Arc<str> = &log.name;
        findings.merge(featurize::of_log(run, name)?);
    }
    if run.goal.has_stage(Stage::Register) {
        findings.merge(register::of_logs(run, std::slice::from_ref(log))?);
    }
    for line in findings.lines() {
        eprintln!("{line}");
    }
    Ok(())
}
