//! What a task was made from, and whether that still holds.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, anyhow};
use dataset::tables::{Provenance, TableError, digest_file, read_provenance};
use ingest::{FileState, IngestError};

use super::manifest::{Record, changes};
use super::{Run, Task};
use crate::stage::{Artifact, Scope, Stage};
use crate::used_model::UsedModel;

impl Run {
    /// What a task would be made from now.
    pub(super) fn provenance(&self, task: &Task) -> Result<Provenance> {
        let inputs = task
            .inputs
            .iter()
            .map(|path| Ok((self.name_of(path), self.digest(path)?)))
            .collect::<Result<BTreeMap<_, _>>>()?;
        Ok(Provenance {
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            seed: (!task.stage.is_of_logs()).then_some(self.config.seed),
            options: self.options_of(task.stage, task.log.as_deref(), task.only)?,
            inputs,
            ..Provenance::default()
        })
    }

    /// The options that the results of a stage depend on.
    /// The name of an input.
    pub(crate) fn name_of(&self, path: &Path) -> String {
        let named = self.model.as_ref().filter(|model| model.path == path);
        let name = named.and_then(|model| model.name.clone());
        name.unwrap_or_else(|| self.folder.name_of(path))
    }

    pub(crate) fn options_of(
        &self,
        stage: Stage,
        log: Option<&str>,
        only: Option<Artifact>,
    ) -> Result<serde_json::Value> {
        let log = log.filter(|_| stage.is_of_logs());
        // A list of all logs for each of them would take quadratic time.
        let all = if log.is_none() { self.ingested_logs()? } else { Vec::new() };
        let logs: Vec<&str> = all.iter().map(|log| &*log.name).chain(log).collect();
        let model = self.model.as_ref().map_or(serde_json::Value::Null, UsedModel::summary);
        (stage.spec().options)(&self.config, &Scope { log, logs: &logs, only, model })
    }

    /// What differs between a task as it was done and as it is asked for now; nothing if its
    /// results can be kept.
    pub(super) fn changes_since(&self, record: &Record, now: &Provenance) -> Vec<String> {
        let mut changes = record.changes(now);
        changes.extend(record.outputs.iter().filter_map(|(name, digest)| {
            match self.digest(&self.path(name)) {
                Ok(found) if found == *digest => None,
                Ok(_) => Some(format!("{name} was altered")),
                Err(_) => Some(format!("{name} is missing")),
            }
        }));
        changes
    }

    /// Refuses a table of the run folder that was altered, that was made with other options, or from other files
    /// than those in the folder now; and the same for everything it was made from. Otherwise a
    /// stage run by its own command would store options in a model that its data were not made
    /// with.
    pub(super) fn check_fresh(&self, path: &Path) -> Result<()> {
        let name = self.folder.name_of(path);
        let Some((artifact, log)) = Artifact::of_name(&name) else { return Ok(()) };
        let Some(stage) = artifact.maker() else { return Ok(()) };
        if stage == Stage::Simulate || !self.fresh.borrow_mut().insert(path.to_owned()) {
            return Ok(());
        }
        let recorded = {
            let tasks = &self.manifest.borrow().tasks;
            tasks.values().find_map(|record| record.outputs.get(&name).cloned())
        };
        if let Some(recorded) = recorded
            && self.digest(path)? != recorded
        {
            return Err(anyhow!(
                "{} was altered after `{stage}` wrote it; run `{}` again, or `loopboost run`",
                path.display(),
                stage.command()
            ));
        }
        let only = (artifact == Artifact::Truth).then_some(artifact);
        let (_, made) = read_provenance(path)?;
        let mut stale = changes(&made.options, &self.options_of(stage, log, only)?);
        if let Some(seed) = made.seed.filter(|seed| *seed != self.config.seed) {
            stale.push(format!("seed: {seed} -> {}", self.config.seed));
        }
        for (input, digest) in &made.inputs {
            let path = self.path(input);
            if path.exists() && self.digest(&path)? != *digest {
                stale.push(format!("{input} has changed"));
            }
        }
        if !stale.is_empty() {
            return Err(anyhow!(
                "{} was not made with this pipeline: {}; run `{}` again, or `loopboost run`, which repeats all outdated stages",
                path.display(),
                stale.join(", "),
                stage.command()
            ));
        }
        made.inputs
            .keys()
            .map(|input| self.path(input))
            .filter(|path| path.exists())
            .try_for_each(|path| self.check_fresh(&path))
    }

    /// Checks that a log is still the file whose digest was computed.
    pub(crate) fn check_unchanged(&self, path: &Path) -> Result<(), IngestError> {
        let before = self.states.borrow().get(path).copied().flatten();
        let change = match (before, FileState::read(path)) {
            (Some(before), Ok(now)) => before.change(&now),
            (Some(_), Err(error)) => Some(format!("it can no longer be read ({error})")),
            (None, _) => None,
        };
        match change {
            Some(change) => Err(IngestError::Changed { path: path.to_owned(), change }),
            None => Ok(()),
        }
    }

    /// BLAKE3 digest of a file. Each file is read once in a run.
    pub(crate) fn digest(&self, path: &Path) -> Result<String> {
        if let Some(known) = self.digests.borrow().get(path) {
            return Ok(known.clone());
        }
        // The state comes first: a file that is written while its digest is computed has changed.
        let state = FileState::read(path).ok();
        let digest = digest_file(path).map_err(|error| explain_missing_log(path, error))?;
        self.states.borrow_mut().insert(path.to_owned(), state);
        self.digests.borrow_mut().insert(path.to_owned(), digest.clone());
        Ok(digest)
    }
}

/// Names the option where a missing file is a log.
fn explain_missing_log(path: &Path, error: TableError) -> anyhow::Error {
    match error {
        TableError::Missing { .. } if Artifact::maker_of_path(path).is_none() => missing_log(path),
        error => error.into(),
    }
}

/// A log that the pipeline names and that does not exist.
pub(crate) fn missing_log(path: &Path) -> anyhow::Error {
    anyhow!(
        "{} does not exist (paths in `ingest.logs` are relative to the pipeline file)",
        path.display()
    )
}
