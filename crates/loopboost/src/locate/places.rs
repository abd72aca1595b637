//! The map of a finished run, as `locate` uses it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::digest_file;
use detect::{LocatorMap, MapDrive};
use ingest::{LidarOptions, Options};
use register::{Drive, RegisterOptions};
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::config::usage;
use crate::detection::DetectSection;
use crate::drives::RegisteredDrive;
use crate::known_map::KnownMap;
use crate::map_run::MapRun;
use crate::other_run::OtherRun;
use crate::scan_cache::ScanCache;
use crate::stage::Stage;

/// The places of a map, and how its logs were read.
pub(super) struct Places {
    pub(super) map: LocatorMap,
    /// The options of the logs of the map. Those of one of them, because they have the same lidar.
    pub(super) options: Options,
    pub(super) register: RegisterOptions,
    /// Coverage of the scans \[deg\].
    pub(super) coverage_deg: f32,
    /// The digests of the tables.
    pub(super) inputs: BTreeMap<String, String>,
}

/// An option that the run recorded.
fn recorded<T: DeserializeOwned>(folder: &Path, task: &str, value: &Value) -> Result<T> {
    serde_json::from_value(value.clone()).map_err(|error| {
        anyhow!(
            "{}/run.json: the options of `{task}` cannot be read: {error}; make the run again with this version",
            folder.display()
        )
    })
}

/// The logs of a map that are used: all, or those in `only`.
fn used(folder: &Path, logs: BTreeSet<Arc<str>>, only: &[String]) -> Result<Vec<Arc<str>>> {
    if let Some(unknown) = only.iter().find(|name| !logs.contains(&***name)) {
        let known: Vec<&str> = logs.iter().map(|log| &**log).collect();
        return Err(usage(format!(
            "--map-log {unknown}: the map of {} has no such log, expected one of `{}`",
            folder.display(),
            known.join("`, `")
        )));
    }
    let is_used = |log: &Arc<str>| only.is_empty() || only.iter().any(|name| **name == **log);
    Ok(logs.into_iter().filter(is_used).collect())
}

impl Places {
    /// Reads the map of a run folder. With `only`, only the places of these logs.
    pub(super) fn read(folder: &Path, only: &[String]) -> Result<Self> {
        let run = OtherRun { name: folder.display().to_string(), folder: folder.to_owned() };
        let run = MapRun::of(&run, "--map", |path| Ok(digest_file(path)?))?;
        let logs = used(folder, run.logs(), only)?;
        let detect = run.options(Stage::Detect.name());
        let register: RegisterOptions =
            recorded(folder, Stage::Detect.name(), &detect["register"])?;
        let detection: DetectSection = recorded(folder, Stage::Detect.name(), &detect["detect"])?;
        let options = Self::options(folder, &run, &logs)?;
        let (mut inputs, mut known) = (BTreeMap::new(), KnownMap::default());
        let cache = Arc::new(ScanCache::default());
        for log in &logs {
            known.add_log(&run, log, &cache)?;
            for artifact in KnownMap::OF_LOG {
                let name = format!("map/{}", artifact.name(log));
                inputs.insert(name, digest_file(&run.path(artifact, log))?);
            }
        }
        let drives: Vec<Drive> = known.drives.iter().map(RegisteredDrive::drive).collect();
        let of_map = drives.iter().zip(&known.poses).zip(&known.maps);
        let parts: Vec<MapDrive<'_>> =
            of_map.map(|((drive, poses), &map)| MapDrive { drive, poses, map }).collect();
        let coverage_deg = known.drives.iter().find_map(RegisteredDrive::coverage_deg);
        let coverage_deg = coverage_deg.ok_or_else(|| {
            anyhow!(
                "the map of {} has no scan with a pose; repeat the command that made the run",
                folder.display()
            )
        })?;
        let map = LocatorMap::new(&parts, detection.place_step_m, detection.place_half_m);
        cache.check()?;
        Ok(Self { map, options, register, coverage_deg, inputs })
    }

    /// The options that the logs were read with.
    fn options(folder: &Path, run: &MapRun<'_>, logs: &[Arc<str>]) -> Result<Options> {
        let mut first: Option<(&str, Options)> = None;
        for log in logs {
            let task = format!("{} {log}", Stage::Ingest);
            let recorded_options = run.options(&task);
            let lidar: LidarOptions = recorded(folder, &task, &recorded_options["lidar"])?;
            let pose = recorded(folder, &task, &recorded_options["pose"])?;
            match &first {
                None => first = Some((log, Options { lidar, pose })),
                Some((other, options)) if options.lidar != lidar => {
                    return Err(anyhow!(
                        "the logs `{other}` and `{log}` of the map have different `ingest.lidar` options, and scans of two lidars cannot be compared; use one of the logs with --map-log"
                    ));
                }
                Some(_) => {}
            }
        }
        first.map(|(_, options)| options).ok_or_else(|| {
            anyhow!("the map of {} has no log; repeat the command that made it", folder.display())
        })
    }
}
