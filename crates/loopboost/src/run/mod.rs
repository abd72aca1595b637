//! A run: a pipeline file, a run folder, and the tasks that make its artifacts.

mod cache;
mod copies;
mod folder;
mod log_tasks;
mod manifest;
mod plan;
mod progress;

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use dataset::tables::Provenance;
use dataset::{Loss, LossKind, Losses, Note, Subject};
use ingest::FileState;
use model::Detector;

use crate::config::{Config, usage};
use crate::detector_evidence::starting_values;
use crate::findings::Findings;
use crate::goal::Goal;
use crate::logs::LogFile;
use crate::other_run::OtherRun;
use crate::scan_cache::ScanCache;
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;
use crate::used_model::UsedModel;

pub(crate) use cache::missing_log;
pub(crate) use folder::RunFolder;
pub(crate) use log_tasks::LogTasks;
pub(crate) use manifest::{Manifest, Record, changed_values, changes};
pub(crate) use progress::progress_bar;

use manifest::Change;

/// A pipeline file and the folder for its artifacts.
pub(crate) struct Run {
    pub(crate) config: Config,
    folder: RunFolder,
    mode: Mode,
    /// A log that cannot be used ends the run.
    pub(crate) strict: bool,
    /// What the run is for.
    pub(crate) goal: Goal,
    /// The model that loop closures are found with, if the command names one.
    pub(crate) model: Option<UsedModel>,
    /// The detector of a run without a model.
    starting_values: Detector,
    logs: OnceCell<Vec<LogFile>>,
    manifest: RefCell<Manifest>,
    /// Digests of files that this process has read and that have not changed since.
    digests: RefCell<BTreeMap<PathBuf, String>>,
    /// The states of these files before their digests were computed.
    states: RefCell<BTreeMap<PathBuf, Option<FileState>>>,
    /// Tables that were made with this pipeline.
    fresh: RefCell<BTreeSet<PathBuf>>,
    /// The scans that its stages read.
    pub(crate) scan_cache: Arc<ScanCache>,
    /// The stage that is running, or the last one that did.
    stage: Cell<Option<Stage>>,
    /// In a dry run: files that would be made again.
    would_change: RefCell<BTreeSet<PathBuf>>,
}

/// Which tasks run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Mode {
    /// Those whose inputs, options or outputs have changed, and those of the forced stages.
    Resume {
        /// Stages that run in any case.
        force: Vec<Stage>,
    },
    /// None. Prints what would run.
    DryRun {
        /// Stages that would run in any case.
        force: Vec<Stage>,
    },
    /// All: a stage was asked for by its own command.
    Always,
    /// All, without a summary on stdout, which the command prints to itself.
    Quiet,
}

/// A piece of work that is done completely or not at all.
pub(crate) struct Task {
    pub(crate) stage: Stage,
    /// The log, for a stage that works log by log.
    pub(crate) log: Option<Arc<str>>,
    /// The artifact, for a task that makes only one of those of its stage.
    pub(crate) only: Option<Artifact>,
    pub(crate) inputs: Vec<PathBuf>,
}

impl Task {
    /// The name in `run.json`.
    pub(crate) fn name(&self) -> String {
        match (&self.log, self.only) {
            (Some(log), Some(Artifact::Truth)) => format!("{} {log} truth", self.stage),
            (Some(log), _) => format!("{} {log}", self.stage),
            (None, _) => self.stage.to_string(),
        }
    }

    /// Whether it makes an artifact of its stage.
    fn makes(&self, artifact: Artifact) -> bool {
        self.only.is_none_or(|only| only == artifact)
            && (self.log.is_none() || artifact.is_per_log())
    }
}

/// What a task made.
#[derive(Default)]
pub(crate) struct Done {
    pub(crate) outputs: Vec<PathBuf>,
    pub(crate) losses: Losses,
    pub(crate) notes: Vec<Note>,
    /// What to print on stdout.
    pub(crate) summaries: Vec<Summary>,
}

impl Run {
    /// Opens a run folder, and locks it unless the run is dry.
    pub(crate) fn new(
        config: Config,
        folder: PathBuf,
        mode: Mode,
        strict: bool,
        model: Option<UsedModel>,
    ) -> Result<Self> {
        let goal = Goal::of(&config, model.as_ref());
        let other_runs = OtherRun::of(&config, goal, &folder)?;
        let mut folder = match mode {
            Mode::DryRun { .. } => RunFolder::read_only(folder),
            _ => RunFolder::lock(folder)?,
        };
        folder.other_runs = other_runs;
        let mut manifest = Manifest::load(&folder.root)?;
        if !matches!(mode, Mode::DryRun { .. }) {
            manifest.save_journal(&folder.root)?;
        }
        Ok(Self {
            config,
            goal,
            model,
            starting_values: starting_values(goal),
            manifest: RefCell::new(manifest),
            digests: RefCell::default(),
            states: RefCell::default(),
            fresh: RefCell::default(),
            scan_cache: Arc::default(),
            stage: Cell::new(None),
            would_change: RefCell::default(),
            folder,
            mode,
            strict,
            logs: OnceCell::new(),
        })
    }

    /// What loop detection uses: the detector of the model, or the starting values.
    pub(crate) fn detector(&self) -> &Detector {
        self.model.as_ref().map_or(&self.starting_values, |model| &model.detector)
    }

    /// The finished run that poses are taken from.
    pub(crate) fn pose_run(&self) -> Option<&OtherRun> {
        self.folder.other_runs.first().filter(|_| !self.goal.detects())
    }

    /// The finished runs whose map the logs are added to.
    pub(crate) fn known_maps(&self) -> &[OtherRun] {
        match self.goal.detects() {
            true => &self.folder.other_runs,
            false => &[],
        }
    }

    /// Whether the poses of a log are those of a finished run.
    pub(crate) fn is_in_pose_run(&self, log: &str) -> Result<bool> {
        Ok(self.config.for_log(log)?.pose.is_some_and(|pose| pose.run.is_some()))
    }

    /// The models that `train` made in this folder, in the order of the learners of the pipeline.
    pub(crate) fn trained_models(&self) -> Vec<PathBuf> {
        let manifest = self.manifest.borrow();
        let outputs = manifest.tasks.get(Stage::Train.name()).map(|record| &record.outputs);
        let names: Vec<&String> = outputs.into_iter().flat_map(BTreeMap::keys).collect();
        let of_learner = |learner: &train::Learner| {
            let prefix = format!("models/{}-{}/", self.config.name, learner.name());
            let is_model =
                |name: &&&String| name.starts_with(&prefix) && name.ends_with("/model.json");
            names.iter().find(is_model).map(|name| self.path(name))
        };
        self.config.train.learners.iter().filter_map(of_learner).collect()
    }

    /// A path in the run folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path(name)
    }

    /// The path of an artifact that is made once for all logs.
    pub(crate) fn path_of(&self, artifact: Artifact) -> PathBuf {
        debug_assert!(!artifact.is_per_log(), "{artifact:?} is made for each log");
        self.path(artifact.pattern())
    }

    /// The path of an artifact that is made for each log.
    pub(crate) fn path_of_log(&self, artifact: Artifact, log: &str) -> PathBuf {
        debug_assert!(artifact.is_per_log(), "{artifact:?} is made once");
        self.path(&artifact.name(log))
    }

    pub(crate) fn scans(&self, log: &str) -> PathBuf {
        self.path_of_log(Artifact::Scans, log)
    }

    pub(crate) fn poses(&self, log: &str) -> PathBuf {
        self.path_of_log(Artifact::Poses, log)
    }

    /// The paths of an artifact; of one log, if there is one for each log.
    pub(crate) fn paths_of(&self, artifact: Artifact, log: Option<&str>) -> Vec<PathBuf> {
        match (artifact, log) {
            (Artifact::Log, Some(log)) => {
                let n_files = self.config.simulate.as_ref().map_or(1, |options| options.files);
                self.folder.simulated_log(log, n_files)
            }
            (_, log) => vec![self.path(&artifact.name(log.unwrap_or_default()))],
        }
    }

    /// The task of a stage that works log by log. It reads what the stage reads of the log.
    pub(crate) fn task_of_log(&self, stage: Stage, log: &Arc<str>) -> Task {
        let inputs = stage.spec().inputs.iter().filter(|input| self.goal.has(**input));
        let of_log = inputs.filter(|input| input.is_per_log());
        let mut inputs: Vec<PathBuf> =
            of_log.map(|&artifact| self.path_of_log(artifact, log)).collect();
        if Stage::USE_MODEL.contains(&stage) {
            inputs.extend(self.model.iter().map(|model| model.path.clone()));
        }
        Task { stage, log: Some(log.clone()), only: None, inputs }
    }

    /// The task of a stage that works on all logs at once. It reads what the stage reads.
    pub(crate) fn task_of(&self, stage: Stage) -> Result<Task> {
        let mut inputs = Vec::new();
        for &artifact in stage.spec().inputs.iter().filter(|input| self.goal.has(**input)) {
            if artifact.is_per_log() {
                let logs = self.ingested_logs()?;
                inputs.extend(logs.iter().map(|log| self.path_of_log(artifact, &log.name)));
            } else {
                inputs.push(self.path_of(artifact));
            }
        }
        if Stage::USE_MODEL.contains(&stage) {
            inputs.extend(self.model.iter().map(|model| model.path.clone()));
        }
        Ok(Task { stage, log: None, only: None, inputs })
    }

    /// The run's logs: the simulated ones, then those of `ingest.logs`.
    pub(crate) fn logs(&self) -> Result<&[LogFile]> {
        if let Some(logs) = self.logs.get() {
            return Ok(logs);
        }
        let simulated = self.config.simulate.iter().flat_map(|s| &s.logs);
        let mut logs: Vec<LogFile> = simulated
            .map(|name| LogFile::named(name.as_str(), self.paths_of(Artifact::Log, Some(name))))
            .collect();
        logs.extend(self.config.log_files()?);
        if logs.is_empty() {
            return Err(usage(
                "`ingest.logs` is empty: name the logs, or add a [simulate] section",
            ));
        }
        let mut seen: BTreeMap<&str, &LogFile> = BTreeMap::new();
        for log in &logs {
            if let Some(other) = seen.insert(&log.name, log) {
                return Err(usage(format!(
                    "two logs are named `{}`: {} and {}; the name is the file stem (for a split drive, the folder), with the path from the folder in `ingest.logs` if several logs share it, and must be unique in a run: rename one",
                    log.name,
                    other.place(),
                    log.place()
                )));
            }
        }
        if self.config.evaluate.groupings.contains(&label::Grouping::Log) && logs.len() < 2 {
            return Err(usage(
                "`evaluate.groupings` contains `log`, which needs 2 logs or more, but the run has 1: add logs, or remove `log`",
            ));
        }
        let is_log = |name: &&String| seen.contains_key(name.as_str());
        if let Some(stray) = self.config.ingest.log.keys().find(|name| !is_log(name)) {
            return Err(usage(format!(
                "[ingest.log.{stray}]: no log of this run is named `{stray}`"
            )));
        }
        Ok(self.logs.get_or_init(|| logs))
    }

    /// The run's logs without those that could not be ingested and those that are copies.
    pub(crate) fn ingested_logs(&self) -> Result<Vec<LogFile>> {
        let mut logs = self.logs_without_copies()?;
        let manifest = self.manifest.borrow();
        logs.retain(|log| !manifest.failed.contains_key(&*log.name));
        Ok(logs)
    }

    /// Whether the run only prints what would run.
    pub(crate) fn is_dry(&self) -> bool {
        matches!(self.mode, Mode::DryRun { .. })
    }

    /// Records whether a log could be ingested, for the stages that follow. The error is given by
    /// its code.
    pub(crate) fn set_failed(&self, log: &str, error: Option<&str>) -> Result<()> {
        if self.is_dry() || self.manifest.borrow().failed.get(log).map(String::as_str) == error {
            return Ok(());
        }
        let log = log.to_owned();
        self.change(match error {
            Some(error) => Change::Failed { log, error: error.to_owned() },
            None => Change::Ingested { log },
        })
    }

    /// Makes a change to `run.json`. A dry run, and a task that keeps its own record, make it in memory only.
    fn change(&self, change: Change) -> Result<()> {
        let mut manifest = self.manifest.borrow_mut();
        match self.is_dry() || self.folder.target.is_some() {
            true => manifest.apply(change),
            false => manifest.change(&self.folder.root, change)?,
        }
        Ok(())
    }

    /// Writes `run.json`, at the end of a command.
    pub(crate) fn finish(&self) -> Result<()> {
        if self.is_dry() {
            return Ok(());
        }
        self.manifest.borrow_mut().save_journal(&self.folder.root)
    }

    /// The losses and notes of all stages before this one.
    pub(crate) fn findings_before(&self, stage: Stage) -> Result<Findings> {
        let mut findings = Findings::default();
        if Stage::Ingest < stage {
            findings.losses = self.losses_of_failed_logs()?;
        }
        let logs = self.ingested_logs()?;
        let manifest = self.manifest.borrow();
        let is_earlier = |other: &Stage| *other < stage && self.goal.has_stage(*other);
        for earlier in Stage::ALL.into_iter().filter(is_earlier) {
            let of_logs = logs.iter().map(|log| format!("{earlier} {}", log.name));
            let of_truth = logs.iter().map(|log| format!("{earlier} {} truth", log.name));
            let of_truth = of_truth.filter(|_| self.goal.has(Artifact::Truth));
            for name in of_logs.chain(of_truth).chain([earlier.to_string()]) {
                if let Some(Record { losses, notes, .. }) = manifest.tasks.get(&name) {
                    findings.losses.merge(losses.clone());
                    findings.notes.extend(notes.iter().cloned());
                }
            }
        }
        Ok(findings)
    }

    /// The losses and notes of the stages before the current one. Empty if they are not known.
    pub(crate) fn findings_so_far(&self) -> Findings {
        let before = self.stage.get().map(|stage| self.findings_before(stage));
        before.and_then(Result::ok).unwrap_or_default()
    }

    /// The logs of this run that could not be ingested, and those that are copies. `run.json` may
    /// list others, which the pipeline does not name any more.
    pub(crate) fn losses_of_failed_logs(&self) -> Result<Losses> {
        let mut losses = Losses::default();
        for (copy, used) in self.copies()? {
            losses.add(Loss::new(LossKind::DuplicateLog { used }, Subject::log(copy)), 1);
        }
        let failed = &self.manifest.borrow().failed;
        for LogFile { name, .. } in self.logs()? {
            if let Some(error) = failed.get(&**name) {
                let kind = LossKind::LogLeftOut { error: error.clone() };
                losses.add(Loss::new(kind, Subject::log(&**name)), 1);
            }
        }
        Ok(losses)
    }

    /// Does a task, unless it was done with the same inputs and options and its outputs are
    /// unaltered. Returns the losses and notes, of now or of then.
    pub(crate) fn task(
        &self,
        task: &Task,
        work: impl FnOnce(Provenance) -> Result<Done>,
    ) -> Result<Findings> {
        match self.up_to_date(task)? {
            Ok(findings) => Ok(findings),
            Err(provenance) => {
                let done = work(provenance.clone())?;
                self.record(task.name(), task.stage, done, provenance)
            }
        }
    }

    /// The losses and notes of a task that need not be done again. Otherwise what it is made from.
    fn up_to_date(&self, task: &Task) -> Result<Result<Findings, Provenance>> {
        let name = task.name();
        self.stage.set(Some(task.stage));
        let record = self.manifest.borrow().tasks.get(&name).cloned();
        if let Mode::DryRun { force } = &self.mode {
            self.plan(&name, task, record.as_ref(), force.contains(&task.stage))?;
            return Ok(Ok(Findings::default()));
        }
        let provenance = self.provenance(task)?;
        if let (Mode::Resume { force }, Some(record)) = (&self.mode, record)
            && !force.contains(&task.stage)
            && self.changes_since(&record, &provenance).is_empty()
        {
            for summary in &record.summaries {
                self.print(task.stage, format!("{} (unchanged)", self.sentence(summary)));
            }
            return Ok(Ok(Findings { losses: record.losses, notes: record.notes }));
        }
        for input in &task.inputs {
            self.check_fresh(input)?;
        }
        Ok(Err(provenance))
    }

    /// Does tasks of several logs, a few of them at once. `work` gets the numbers of those that are not up to date, with
    /// their provenances, and returns what each made.
    pub(crate) fn tasks(
        &self,
        tasks: &[Task],
        n_at_once: usize,
        work: impl Fn(&[(usize, Provenance)]) -> Result<Vec<Done>>,
    ) -> Result<Findings> {
        let mut findings = Findings::default();
        for (first, some) in (0..).step_by(n_at_once).zip(tasks.chunks(n_at_once)) {
            let mut pending = Vec::new();
            for (k, task) in (first..).zip(some) {
                match self.up_to_date(task)? {
                    Ok(done) => findings.merge(done),
                    Err(provenance) => pending.push((k, provenance)),
                }
            }
            if pending.is_empty() {
                continue;
            }
            for (done, (k, provenance)) in work(&pending)?.into_iter().zip(pending) {
                findings.merge(self.record(tasks[k].name(), tasks[k].stage, done, provenance)?);
            }
        }
        Ok(findings)
    }

    /// Stores in `run.json` what a task was made from and what it made.
    fn record(
        &self,
        name: String,
        stage: Stage,
        done: Done,
        provenance: Provenance,
    ) -> Result<Findings> {
        self.scan_cache.check()?;
        let mut outputs = BTreeMap::new();
        for path in &done.outputs {
            self.digests.borrow_mut().remove(path);
            self.fresh.borrow_mut().remove(path);
            outputs.insert(self.folder.name_of(path), self.digest(path)?);
        }
        for summary in &done.summaries {
            self.print(stage, self.sentence(summary));
        }
        let record = Record {
            program_version: provenance.program_version,
            seed: provenance.seed,
            options: provenance.options,
            inputs: provenance.inputs,
            outputs,
            losses: done.losses.clone(),
            notes: done.notes.clone(),
            summaries: done.summaries,
        };
        self.change(Change::Done { task: name, record })?;
        Ok(Findings { losses: done.losses, notes: done.notes })
    }

    /// What a summary says. The full path of a file can be opened from any folder.
    fn sentence(&self, summary: &Summary) -> String {
        match summary {
            Summary::Written { file } => {
                let path = self.folder.path(file);
                std::path::absolute(&path).unwrap_or(path).display().to_string()
            }
            summary => summary.to_string(),
        }
    }

    /// Prints a result on stdout.
    fn print(&self, stage: Stage, what: impl std::fmt::Display) {
        if self.mode != Mode::Quiet {
            out!("{stage:<10} {what}");
        }
    }
}
