//! The plan of the work on single logs: what each task reads, and the checks that need all logs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use serde::{Deserialize, Serialize};

use super::entry::{Entry, FORMAT_VERSION, is_unsafe, pose_files};
use super::paths;
use super::store::Store;
use crate::config::{Config, usage};
use crate::logs::LogFile;
use crate::run::{Mode, Run};
use crate::stages::ingest::{check_frames, sharers};
use crate::used_model::UsedModel;

/// The tasks of all logs. It has no times of its own and no absolute paths: the same pipeline and logs give the same
/// plan on every machine.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    format_version: u32,
    program_version: String,
    /// The folder that the paths of inputs are relative to, itself relative to the run folder.
    root: String,
    /// The folder of the pipeline file, relative to `root`.
    folder: String,
    /// Digest of the model that loop closures are found with. It is one of the objects.
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<String>,
    /// The name of the model as an input of stages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    model_name: Option<String>,
    /// The logs with the same bytes as another log, with the name of that log.
    pub(super) copies: BTreeMap<String, String>,
    /// One per log that is used, in the order of the run.
    pub(super) entries: Vec<Entry>,
    /// The pipeline with all defaults, without the list of logs, as TOML.
    pipeline: String,
}

impl Plan {
    /// Plans the work on the logs of a pipeline. `root` replaces the deepest folder with all inputs.
    pub(super) fn new(
        mut config: Config,
        store: &Store,
        model: Option<&Path>,
        root: Option<&Path>,
    ) -> Result<Self> {
        if config.uses_pose_run()? {
            return Err(usage(
                "`ingest.pose.run` is set, but a plan cannot read another run; use `loopboost run`",
            ));
        }
        let folder = paths::canonical(&config.beside_pipeline(""))?;
        let model = model.map(UsedModel::load).transpose()?;
        let model_path = model.as_ref().map(|model| model.path.clone());
        if let Some(model) = model.as_ref().filter(|_| config.detection().classifier) {
            model.set_features(&mut config)?;
        }
        let run_folder = store.run_folder().to_owned();
        let mode = Mode::DryRun { force: Vec::new() };
        let run = Run::new(config, run_folder.clone(), mode, false, model)?;
        run.find_copies()?;
        let logs = run.logs_without_copies()?;
        let sharers = sharers(&run, &logs)?;
        check_frames(&run, &logs, &sharers)?;
        check_pose_files(&run.config, &logs)?;
        if let Some(log) = logs.iter().find(|log| is_unsafe(&log.name)) {
            return Err(usage(format!(
                "the name `{}` of a log has an empty part or dots",
                log.name
            )));
        }
        let is_simulated = |log: &&LogFile| log.paths[0].starts_with(&run_folder);
        let missing = |log: &&LogFile| !log.paths[0].exists();
        if let Some(log) = logs.iter().filter(is_simulated).find(missing) {
            return Err(usage(format!(
                "the log `{}` is not simulated yet; run `loopboost simulate PIPELINE.toml --out DIR` first",
                log.name
            )));
        }

        let root = match root {
            Some(root) => paths::canonical(root)?,
            None => common_root(&run, &logs, &folder)?,
        };
        let mut entries = Vec::with_capacity(logs.len());
        for (index, log) in logs.iter().enumerate() {
            let sharer = sharers.get(&*log.name).map(ToString::to_string);
            entries.push(Entry::of_log(&run, log, index, &root, sharer)?);
        }
        let copies = run.copies()?;
        let mut pipeline = run.config.clone();
        pipeline.ingest.logs.clear();
        Ok(Self {
            format_version: FORMAT_VERSION,
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            root: paths::relative(&run_folder, &root)?,
            folder: paths::relative(&root, &folder)?,
            model: model_path.as_deref().map(|path| store.put(path)).transpose()?,
            model_name: model_path.as_deref().map(|path| run.name_of(path)),
            copies,
            entries,
            pipeline: pipeline.to_toml()?,
        })
    }

    /// The bytes of the file, which its name is computed from.
    pub(super) fn bytes(&self) -> Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    /// Reads a plan and checks that it is the one with this name.
    pub(super) fn load(store: &Store, id: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Versions {
            format_version: u32,
            program_version: String,
        }
        let path = store.plan_path(id);
        let bytes = match std::fs::read(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(usage(format!(
                    "{} does not exist; `loopboost plan` prints the name of the plan that it writes",
                    path.display()
                )));
            }
            read => read.with_context(|| format!("cannot read {}", path.display()))?,
        };
        let found = blake3::hash(&bytes).to_hex();
        if *found != *id {
            return Err(usage(format!(
                "{} was altered: its BLAKE3 digest is {found}, expected its name; run `loopboost plan` again",
                path.display()
            )));
        }
        let damaged = |error| usage(format!("{} is not a plan: {error}", path.display()));
        let versions: Versions = serde_json::from_slice(&bytes).map_err(damaged)?;
        let own = env!("CARGO_PKG_VERSION");
        if versions.format_version != FORMAT_VERSION || versions.program_version != own {
            return Err(usage(format!(
                "{} was made by loopboost {} with format version {}, this is loopboost {own} with format version {FORMAT_VERSION}; use the same version, or run `loopboost plan` again",
                path.display(),
                versions.program_version,
                versions.format_version
            )));
        }
        let plan: Self = serde_json::from_slice(&bytes).map_err(damaged)?;
        match plan.entries.iter().find(|entry| is_unsafe(&entry.key)) {
            Some(entry) => Err(usage(format!(
                "{} is not a plan: the name `{}` of a log has an empty part or dots",
                path.display(),
                entry.key
            ))),
            None => Ok(plan),
        }
    }

    /// The folder that the inputs are relative to, on this machine.
    pub(super) fn root(&self, store: &Store, root: Option<&Path>) -> Result<PathBuf> {
        let root = root.map_or_else(|| store.run_folder().join(&self.root), Path::to_owned);
        paths::canonical(&root)
    }

    /// The pipeline, with paths below the root.
    pub(super) fn config(&self, root: &Path) -> Result<Config> {
        Config::from_toml(&self.pipeline, root.join(&self.folder))
    }

    /// The model that loop closures are found with.
    pub(super) fn model(&self, store: &Store) -> Result<Option<UsedModel>> {
        let Some(digest) = &self.model else { return Ok(None) };
        let mut model = UsedModel::load(&store.object(digest))?;
        model.name.clone_from(&self.model_name);
        Ok(Some(model))
    }
}

/// Refuses absolute paths of files with poses: where the logs are mounted elsewhere, they would not be found, or would be
/// other files.
fn check_pose_files(config: &Config, logs: &[LogFile]) -> Result<()> {
    for LogFile { name, .. } in logs {
        let poses = config.for_log(name)?.pose.and_then(|pose| pose.file_of(name));
        let truth = config.evaluate.truth.as_ref().and_then(|truth| truth.file_of(name));
        let mut files = poses.into_iter().chain(truth);
        if let Some(file) = files.find(|file| Path::new(file).is_absolute()) {
            return Err(usage(format!(
                "the file with poses `{file}` has an absolute path, which other machines may not have; write it relative to the pipeline file"
            )));
        }
    }
    Ok(())
}

/// The deepest folder with the pipeline file and all inputs.
fn common_root(run: &Run, logs: &[LogFile], folder: &Path) -> Result<PathBuf> {
    let mut root = folder.to_owned();
    for log in logs {
        for path in log.paths.iter().chain(&log.missing).chain(&pose_files(run, log)?) {
            let path = paths::canonical_file(path)?;
            while !path.starts_with(&root) {
                if !root.pop() {
                    return Err(anyhow!(
                        "{} has no folder in common with {}",
                        path.display(),
                        folder.display()
                    ));
                }
            }
        }
    }
    Ok(root)
}
