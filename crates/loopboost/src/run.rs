//! A run: a configuration, a folder, and what is said on the way.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::Dropped;
use dataset::tables::{Provenance, digest_file};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::config::{Config, stem};

/// A configuration and the folder its artifacts lie in.
///
/// ```text
/// <folder>/
///   logs/<log>.mcap              simulated logs
///   scans/<log>.parquet          poses/<log>.parquet
///   keyframes.parquet            pairs.parquet            features.parquet
///   scores.parquet               rounds.parquet
///   models/<name>/<version>/model.json
///   evaluation/*.parquet         report.html
/// ```
pub(crate) struct Run {
    pub(crate) config: Config,
    folder: PathBuf,
}

/// A log of the run.
pub(crate) struct LogFile {
    /// File stem, unique in the run.
    pub(crate) name: Arc<str>,
    pub(crate) path: PathBuf,
}

impl Run {
    pub(crate) fn new(config: Config, folder: PathBuf) -> Self {
        Self { config, folder }
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

    pub(crate) fn simulated_log(&self, name: &str) -> PathBuf {
        self.path(&format!("logs/{name}.mcap"))
    }

    /// The run's logs: the simulated ones, then those of `ingest.logs`.
    pub(crate) fn logs(&self) -> Result<Vec<LogFile>> {
        let simulated = self.config.simulate.iter().flat_map(|s| &s.logs);
        let mut paths: Vec<PathBuf> = simulated.map(|name| self.simulated_log(name)).collect();
        paths.extend(self.config.log_files()?);
        if paths.is_empty() {
            return Err(anyhow!(
                "`ingest.logs` is empty: name the logs, or add a [simulate] section"
            ));
        }
        let logs: Vec<LogFile> =
            paths.into_iter().map(|path| LogFile { name: stem(&path).into(), path }).collect();
        let mut seen = BTreeSet::new();
        for log in &logs {
            if !seen.insert(&log.name) {
                return Err(anyhow!(
                    "two logs are named `{}`, the second is {}; a log is named by its file stem, which must be unique in a run: rename one",
                    log.name,
                    log.path.display()
                ));
            }
        }
        if let Some(stray) =
            self.config.ingest.log.keys().find(|log| !seen.contains(&Arc::from(log.as_str())))
        {
            return Err(anyhow!("[ingest.log.{stray}]: no log of this run is named `{stray}`"));
        }
        Ok(logs)
    }

    /// The provenance of an artifact made from files of the run folder.
    pub(crate) fn provenance(
        &self,
        options: &impl Serialize,
        inputs: &[PathBuf],
        dropped: Dropped,
    ) -> Result<Provenance> {
        let inputs = inputs
            .iter()
            .map(|path| Ok((self.name_of(path), digest_file(path)?)))
            .collect::<Result<BTreeMap<_, _>>>()?;
        Ok(Provenance {
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            seed: self.config.seed,
            options: serde_json::to_value(options).context("options are JSON")?,
            inputs,
            dropped,
        })
    }

    /// A file's name in the run folder; of one that lies elsewhere, its file name.
    fn name_of(&self, path: &Path) -> String {
        let name = path.strip_prefix(&self.folder).ok().or(path.file_name().map(Path::new));
        name.unwrap_or(path).to_string_lossy().into_owned()
    }

    /// A result, on stdout.
    pub(crate) fn say(&self, stage: &str, what: impl std::fmt::Display) {
        println!("{stage:<10} {what}");
    }
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
