//! The finished run whose map a pipeline uses: for the poses of its logs (`ingest.pose.run`), or to add its
//! logs to the map (`detect.maps`).

use std::path::{Path, PathBuf};

use anyhow::Result;
use ingest::PoseOptions;

use crate::config::{Config, usage};
use crate::goal::Goal;

/// A run folder with a map, as the pipeline names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct OtherRun {
    /// The folder, relative to the pipeline file.
    pub(crate) name: String,
    /// The folder.
    pub(crate) folder: PathBuf,
}

impl OtherRun {
    /// The runs that the pipeline names: one with `ingest.pose.run`, which is the same for all logs that have
    /// it, or those of `detect.maps`.
    ///
    /// `out` is the folder of the run that uses it.
    pub(crate) fn of(config: &Config, goal: Goal, out: &Path) -> Result<Vec<Self>> {
        let of = |key: String, pose: Option<&PoseOptions>| Some((key, pose?.run.clone()?));
        let mut runs: Vec<(String, String)> =
            of("ingest.pose".to_owned(), config.ingest.pose.as_ref()).into_iter().collect();
        for log in config.ingest.log.keys() {
            let pose = config.for_log(log)?.pose;
            runs.extend(of(format!("ingest.log.{log}.pose"), pose.as_ref()));
        }
        let Some((key, name)) = runs.first() else {
            return match goal.detects() {
                true => Self::with_maps(config, out),
                false => Ok(Vec::new()),
            };
        };
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
        Ok(vec![Self::beside(config, &format!("{key}.run"), name, out)?])
    }

    /// The runs of `detect.maps`.
    fn with_maps(config: &Config, out: &Path) -> Result<Vec<Self>> {
        let names = config.detection().maps;
        let folder_name = |name: &String| Path::new(name).file_name().map(ToOwned::to_owned);
        for (k, name) in names.iter().enumerate() {
            if names[..k].iter().any(|other| folder_name(other) == folder_name(name)) {
                return Err(usage(format!(
                    "`detect.maps` has two run folders with the name of `{name}`, expected different names, because tables state what they were made from by these names; rename one"
                )));
            }
        }
        names.iter().map(|name| Self::beside(config, "detect.maps", name, out)).collect()
    }

    /// The run folder with a name relative to the pipeline file.
    fn beside(config: &Config, key: &str, name: &str, out: &Path) -> Result<Self> {
        let folder = config.beside_pipeline(name);
        let is_same = |path: &Path| Some(path.canonicalize().ok()? == out.canonicalize().ok()?);
        if is_same(&folder) == Some(true) {
            return Err(usage(format!(
                "`{key}` is `{name}`, the folder of --out: a run cannot use its own map; choose another --out"
            )));
        }
        Ok(Self { name: name.to_owned(), folder })
    }

    /// The name of a file of this run among the inputs of another run; `None` for other files.
    pub(crate) fn name_of(&self, path: &Path) -> Option<String> {
        let within = path.strip_prefix(&self.folder).ok()?;
        let folder = Path::new(&self.name).file_name()?;
        Some(Path::new("..").join(folder).join(within).to_string_lossy().into_owned())
    }
}
