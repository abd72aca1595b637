//! The finished run that a pipeline takes the poses of its logs from: `ingest.pose.run`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use ingest::PoseOptions;

use crate::config::{Config, usage};
use crate::goal::Goal;

/// A run folder with a map, as the pipeline names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PoseRun {
    /// The folder, relative to the pipeline file.
    pub(crate) name: String,
    /// The folder.
    pub(crate) folder: PathBuf,
}

impl PoseRun {
    /// The run that `ingest.pose.run` names. All logs that have the key must name the same one.
    ///
    /// `out` is the folder of the run that uses its poses.
    pub(crate) fn of(config: &Config, goal: Goal, out: &Path) -> Result<Option<Self>> {
        let of = |key: String, pose: Option<&PoseOptions>| Some((key, pose?.run.clone()?));
        let mut runs: Vec<(String, String)> =
            of("ingest.pose".to_owned(), config.ingest.pose.as_ref()).into_iter().collect();
        for log in config.ingest.log.keys() {
            let pose = config.for_log(log)?.pose;
            runs.extend(of(format!("ingest.log.{log}.pose"), pose.as_ref()));
        }
        let Some((key, name)) = runs.first() else { return Ok(None) };
        if let Some((other, found)) = runs.iter().find(|(_, run)| run != name) {
            return Err(usage(format!(
                "`{key}.run` is `{name}` and `{other}.run` is `{found}`, expected the same run for all logs, because the maps of two runs have no known relation; find the loop closures of all logs in one run"
            )));
        }
        if goal.detects() {
            return Err(usage(format!(
                "`{key}.run` is set, but loop detection needs the odometry of the logs, not poses that already contain loop closures; set `topic`, `frames`, `file` or `wheels` instead, or remove the section [detect]"
            )));
        }
        let folder = config.beside_pipeline(name);
        let is_same = |path: &Path| Some(path.canonicalize().ok()? == out.canonicalize().ok()?);
        if is_same(&folder) == Some(true) {
            return Err(usage(format!(
                "`{key}.run` is `{name}`, the folder of --out: a run cannot take its poses from itself; choose another --out"
            )));
        }
        Ok(Some(Self { name: name.clone(), folder }))
    }

    /// The name of a file of this run among the inputs of another run; `None` for other files.
    pub(crate) fn name_of(&self, path: &Path) -> Option<String> {
        let within = path.strip_prefix(&self.folder).ok()?;
        let folder = Path::new(&self.name).file_name()?;
        Some(Path::new("..").join(folder).join(within).to_string_lossy().into_owned())
    }
}
