//! A run: a configuration, a folder, its tasks, and what is said on the way.

use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::Dropped;
use dataset::tables::{Provenance, TableError, digest_file, is_partial, read_provenance};
use indicatif::{ProgressBar, ProgressStyle};

use crate::config::{Config, usage};
use crate::logs::LogFile;
use crate::manifest::{Manifest, Record, changes};
use crate::options::{maker_of, options_of};

/// A configuration and the folder its artifacts lie in.
///
/// ```text
/// <folder>/
///   run.json                     what was made from what (see `manifest`)
///   logs/<log>.mcap              simulated logs
///   scans/<log>.parquet          poses/<log>.parquet
///   keyframes.parquet            pairs.parquet            features.parquet
///   scores.parquet               rounds.parquet           retrieval.parquet  grid.parquet
///   models/<name>/<version>/     model.json, card.md
///   evaluation/*.parquet         evaluation/summary.json  evaluation/figures/*.svg
///   report.html
/// ```
pub(crate) struct Run {
    pub(crate) config: Config,
    folder: PathBuf,
    mode: Mode,
    /// A log that cannot be ingested ends the run.
    pub(crate) strict: bool,
    logs: OnceCell<Vec<LogFile>>,
    manifest: RefCell<Manifest>,
    /// Digests of files this process has seen and not changed since.
    digests: RefCell<BTreeMap<PathBuf, String>>,
    /// Tables found to fit the pipeline.
    fresh: RefCell<BTreeSet<PathBuf>>,
    /// In a dry run: files that would be made again.
    would_change: RefCell<BTreeSet<PathBuf>>,
    /// Held as long as the run lives; the system lets go of it when the process ends, however.
    _lock: Option<File>,
}

/// Which tasks are done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Mode {
    /// Those whose inputs, options or outputs have changed, and those of the stages named.
    Resume {
        /// Stages done in any case.
        force: Vec<String>,
    },
    /// None; what would be done is told.
    DryRun {
        /// Stages that would be done in any case.
        force: Vec<String>,
    },
    /// All that are come upon: a stage was asked for by its own command.
    Always,
    /// As `Always`, and nothing is said: stdout belongs to what the command prints.
    Quiet,
}

/// A piece of work that is done whole or not at all.
pub(crate) struct Task {
    pub(crate) stage: &'static str,
    /// The log it is done for; none for the stages that see all logs.
    pub(crate) log: Option<Arc<str>>,
    pub(crate) inputs: Vec<PathBuf>,
}

/// What a task gives.
#[derive(Default)]
pub(crate) struct Done {
    pub(crate) outputs: Vec<PathBuf>,
    pub(crate) dropped: Dropped,
    pub(crate) said: Vec<String>,
}

impl Run {
    /// Takes hold of a run folder; fails where another process has it.
    pub(crate) fn new(config: Config, folder: PathBuf, mode: Mode, strict: bool) -> Result<Self> {
        let lock = match mode {
            Mode::DryRun { .. } => None,
            _ => Some(lock(&folder)?),
        };
        if lock.is_some() {
            remove_partial_files(&folder)?;
        }
        Ok(Self {
            config,
            manifest: RefCell::new(Manifest::load(&folder)),
            digests: RefCell::default(),
            fresh: RefCell::default(),
            would_change: RefCell::default(),
            folder,
            mode,
            strict,
            logs: OnceCell::new(),
            _lock: lock,
        })
    }

    /// A path in the run folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub(crate) fn scans(&self, log: &str) -> PathBuf {
        self.path(&format!("scans/{log}.parquet"))
    }

    pub(crate) fn poses(&self, log: &str) -> PathBuf {
        self.path(&format!("poses/{log}.parquet"))
    }

    /// The files of a simulated log, in order of time.
    pub(crate) fn simulated_log(&self, name: &str) -> Vec<PathBuf> {
        match self.config.simulate.as_ref().map_or(1, |options| options.files) {
            1 => vec![self.path(&format!("logs/{name}.mcap"))],
            n => (0..n).map(|k| self.path(&format!("logs/{name}/{name}_{k}.mcap"))).collect(),
        }
    }

    /// The run's logs: the simulated ones, then those of `ingest.logs`.
    pub(crate) fn logs(&self) -> Result<&[LogFile]> {
        if let Some(logs) = self.logs.get() {
            return Ok(logs);
        }
        let simulated = self.config.simulate.iter().flat_map(|s| &s.logs);
        let mut logs: Vec<LogFile> = simulated
            .map(|name| LogFile {
                name: name.as_str().into(),
                paths: self.simulated_log(name),
                missing: Vec::new(),
            })
            .collect();
        logs.extend(self.config.log_files()?);
        if logs.is_empty() {
            return Err(usage(
                "`ingest.logs` is empty: name the logs, or add a [simulate] section",
            ));
        }
        let mut seen = BTreeSet::new();
        for log in &logs {
            if !seen.insert(&log.name) {
                return Err(anyhow!(
                    "two logs are named `{}`, the second is {}; a log is named by its file stem (or by its folder, where a drive was split), which must be unique in a run: rename one",
                    log.name,
                    log.paths[0].display()
                ));
            }
        }
        if self.config.evaluate.groupings.contains(&label::Grouping::Log) && logs.len() < 2 {
            return Err(usage(
                "`evaluate.groupings` has `log`, which holds a log out, but there is 1 log: add logs, or leave `log` out",
            ));
        }
        let is_log = |name: &&String| seen.iter().any(|log| ***log == ***name);
        if let Some(stray) = self.config.ingest.log.keys().find(|name| !is_log(name)) {
            return Err(usage(format!(
                "[ingest.log.{stray}]: no log of this run is named `{stray}`"
            )));
        }
        Ok(self.logs.get_or_init(|| logs))
    }

    /// The run's logs without those that could not be ingested.
    pub(crate) fn ingested_logs(&self) -> Result<Vec<LogFile>> {
        let manifest = self.manifest.borrow();
        let failed = |log: &&LogFile| manifest.failed.contains_key(&*log.name);
        Ok(self.logs()?.iter().filter(|log| !failed(log)).cloned().collect())
    }

    /// Whether nothing is to be done.
    pub(crate) fn is_dry(&self) -> bool {
        matches!(self.mode, Mode::DryRun { .. })
    }

    /// Notes whether a log could be ingested, for the stages behind.
    pub(crate) fn set_failed(&self, log: &str, reason: Option<String>) -> Result<()> {
        let mut manifest = self.manifest.borrow_mut();
        if self.is_dry() || manifest.failed.get(log) == reason.as_ref() {
            return Ok(());
        }
        match reason {
            Some(reason) => {
                manifest.tasks.remove(&format!("ingest {log}"));
                manifest.failed.insert(log.to_owned(), reason);
            }
            None => {
                manifest.failed.remove(log);
            }
        }
        manifest.save(&self.folder)
    }

    /// Does a task, unless it has been done with the same inputs and options and what it made is
    /// still there, unaltered. Returns what of the data could not be used, then or now.
    pub(crate) fn task(
        &self,
        task: &Task,
        work: impl FnOnce(Provenance) -> Result<Done>,
    ) -> Result<Dropped> {
        let name = match &task.log {
            Some(log) => format!("{} {log}", task.stage),
            None => task.stage.to_owned(),
        };
        let record = self.manifest.borrow().tasks.get(&name).cloned();
        if let Mode::DryRun { force } = &self.mode {
            return self.tell(&name, task, record.as_ref(), force.iter().any(|s| s == task.stage));
        }
        let provenance = self.provenance(task)?;
        if let (Mode::Resume { force }, Some(record)) = (&self.mode, record)
            && !force.iter().any(|stage| stage == task.stage)
            && record.changes(&provenance).is_empty()
            && self.outputs_changed(&record).is_empty()
        {
            for line in &record.said {
                self.say(task.stage, format!("{line} (unchanged)"));
            }
            return Ok(record.dropped);
        }
        for input in &task.inputs {
            self.check_fresh(input)?;
        }
        let done = work(provenance.clone())?;
        let mut outputs = BTreeMap::new();
        for path in &done.outputs {
            self.digests.borrow_mut().remove(path);
            self.fresh.borrow_mut().remove(path);
            outputs.insert(self.name_of(path), self.digest(path)?);
        }
        for line in &done.said {
            self.say(task.stage, line);
        }
        let record = Record {
            program_version: provenance.program_version,
            seed: provenance.seed,
            options: provenance.options,
            inputs: provenance.inputs,
            outputs,
            dropped: done.dropped.clone(),
            said: done.said,
        };
        let mut manifest = self.manifest.borrow_mut();
        manifest.tasks.insert(name, record);
        manifest.save(&self.folder)?;
        Ok(done.dropped)
    }

    /// Tells whether a task would be done, and why.
    fn tell(
        &self,
        name: &str,
        task: &Task,
        record: Option<&Record>,
        forced: bool,
    ) -> Result<Dropped> {
        let would_change = self.would_change.borrow().clone();
        let made_again: Vec<String> = task
            .inputs
            .iter()
            .filter(|input| would_change.contains(*input))
            .map(|input| format!("{} may change", self.name_of(input)))
            .collect();
        let (verdict, runs) = match record {
            _ if forced => ("would run: forced".to_owned(), true),
            None => ("would run: not done yet".to_owned(), true),
            Some(_) if !made_again.is_empty() => {
                (format!("would run if its inputs change: {}", made_again.join(", ")), true)
            }
            Some(record) => {
                let mut changes = record.changes(&self.provenance(task)?);
                changes.extend(self.outputs_changed(record));
                match changes.is_empty() {
                    true => ("up to date".to_owned(), false),
                    false => (format!("would run: {}", changes.join(", ")), true),
                }
            }
        };
        if runs {
            let outputs = match (task.stage, &task.log) {
                ("simulate", Some(log)) => self.simulated_log(log),
                ("ingest", Some(log)) => vec![self.scans(log), self.poses(log)],
                ("subsample", _) => vec![self.path("keyframes.parquet")],
                ("label", _) => vec![self.path("pairs.parquet")],
                ("featurize", _) => vec![self.path("features.parquet")],
                ("train", _) => ["scores", "rounds", "retrieval", "grid"]
                    .map(|name| self.path(&format!("{name}.parquet")))
                    .into(),
                _ => Vec::new(),
            };
            self.would_change.borrow_mut().extend(outputs);
        }
        out!("{name:<24} {verdict}");
        Ok(Dropped::default())
    }

    /// Outputs of a task that are missing or not as it left them.
    fn outputs_changed(&self, record: &Record) -> Vec<String> {
        record
            .outputs
            .iter()
            .filter_map(|(name, digest)| match self.digest(&self.path(name)) {
                Ok(found) if found == *digest => None,
                Ok(_) => Some(format!("{name} was altered")),
                Err(_) => Some(format!("{name} is missing")),
            })
            .collect()
    }

    fn provenance(&self, task: &Task) -> Result<Provenance> {
        let inputs = task
            .inputs
            .iter()
            .map(|path| Ok((self.name_of(path), self.digest(path)?)))
            .collect::<Result<BTreeMap<_, _>>>()?;
        Ok(Provenance {
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            seed: self.config.seed,
            options: self.options_of(task.stage, task.log.as_deref())?,
            inputs,
            dropped: Dropped::default(),
        })
    }

    fn options_of(&self, stage: &str, log: Option<&str>) -> Result<serde_json::Value> {
        let logs = self.ingested_logs()?;
        let names: Vec<&str> = logs.iter().map(|log| &*log.name).collect();
        options_of(&self.config, stage, log, &names)
    }

    /// Refuses a table of the run folder that was made with other options than the run's, or from
    /// other files than lie beside it now; and so for what it was made from. A stage asked for by
    /// its own command would otherwise put options into a model that its data were not made with.
    fn check_fresh(&self, path: &Path) -> Result<()> {
        let name = self.name_of(path);
        let Some((stage, log)) = maker_of(&name) else { return Ok(()) };
        if stage == "simulate" || !self.fresh.borrow_mut().insert(path.to_owned()) {
            return Ok(());
        }
        let (_, made) = read_provenance(path)?;
        let mut stale = changes(&made.options, &self.options_of(stage, log)?);
        if made.seed != self.config.seed {
            stale.push(format!("seed {} is now {}", made.seed, self.config.seed));
        }
        for (input, digest) in &made.inputs {
            let path = self.path(input);
            if !path.exists() {
                continue;
            }
            if self.digest(&path)? != *digest {
                stale.push(format!("{input} has changed"));
            }
        }
        if !stale.is_empty() {
            return Err(anyhow!(
                "{} does not fit this pipeline: {}; make it again with `loopboost {stage} PIPELINE.toml --out DIR`, or let `loopboost run` make all that is needed",
                path.display(),
                stale.join(", ")
            ));
        }
        made.inputs
            .keys()
            .map(|input| self.path(input))
            .filter(|path| path.exists())
            .try_for_each(|path| self.check_fresh(&path))
    }

    /// BLAKE3 digest of a file, read once in a run.
    pub(crate) fn digest(&self, path: &Path) -> Result<String> {
        if let Some(known) = self.digests.borrow().get(path) {
            return Ok(known.clone());
        }
        let digest = digest_file(path).map_err(|error| self.explain_missing(path, error))?;
        self.digests.borrow_mut().insert(path.to_owned(), digest.clone());
        Ok(digest)
    }

    /// A missing input is made by another stage.
    fn explain_missing(&self, path: &Path, error: TableError) -> anyhow::Error {
        let is_missing = matches!(&error, TableError::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound);
        let name = self.name_of(path);
        let Some((stage, _)) = maker_of(&name) else {
            return match is_missing {
                true => anyhow!(
                    "{} does not exist (paths in `ingest.logs` are relative to the pipeline file)",
                    path.display()
                ),
                false => error.into(),
            };
        };
        match is_missing && path.starts_with(&self.folder) {
            true => TableError::Missing {
                path: path.to_owned(),
                command: format!("loopboost {stage} PIPELINE.toml --out DIR"),
            }
            .into(),
            false => error.into(),
        }
    }

    /// A file's name in the run folder; of one that lies elsewhere, its file name.
    fn name_of(&self, path: &Path) -> String {
        let name = path.strip_prefix(&self.folder).ok().or(path.file_name().map(Path::new));
        name.unwrap_or(path).to_string_lossy().into_owned()
    }

    /// A result, on stdout.
    pub(crate) fn say(&self, stage: &str, what: impl std::fmt::Display) {
        if self.mode != Mode::Quiet {
            out!("{stage:<10} {what}");
        }
    }
}

/// Takes the lock of a run folder, making the folder if need be.
fn lock(folder: &Path) -> Result<File> {
    std::fs::create_dir_all(folder)
        .map_err(|e| anyhow!("cannot create folder {}: {e}", folder.display()))?;
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
            "another run is at work on {}; wait for it, or choose another --out",
            folder.display()
        )),
        Err(std::fs::TryLockError::Error(e)) => Err(anyhow!("cannot lock {}: {e}", path.display())),
    }
}

/// Removes what a killed run has left half written, in the folders that a run writes to and in no
/// others.
fn remove_partial_files(folder: &Path) -> Result<()> {
    for pattern in [
        ".*",
        "logs/.*",
        "scans/.*",
        "poses/.*",
        "evaluation/.*",
        "evaluation/figures/.*",
        "models/*/*/.*",
    ] {
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

/// A bar on stderr, shown on a terminal only.
pub(crate) fn progress_bar(total: u64, message: String, bytes: bool) -> ProgressBar {
    let template = match bytes {
        true => "{msg:<28} {wide_bar} {bytes}/{total_bytes} {eta}",
        false => "{msg:<28} {wide_bar} {pos}/{len} {eta}",
    };
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(total).with_style(style).with_message(message)
}
