//! The map of a finished run, as `locate` uses it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::{digest_file, read_registered};
use dataset::{Pose2, RangeLimits};
use detect::{LocatorMap, MapDrive};
use ingest::{LidarOptions, Options};
use register::{Drive, RegisterOptions};
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::detection::DetectSection;
use crate::drives::{drives_of, scans_of};
use crate::map_run::MapRun;
use crate::other_run::OtherRun;
use crate::stage::{Artifact, Stage};

/// The places of a map, and how its logs were read.
pub(super) struct KnownMap {
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

impl KnownMap {
    /// Reads the map of a run folder. With `only`, only the places of these logs.
    pub(super) fn read(folder: &Path, only: &[String]) -> Result<Self> {
        let run = OtherRun { name: folder.display().to_string(), folder: folder.to_owned() };
        let run = MapRun::of(&run, "--map")?;
        let logs: Vec<Arc<str>> = run.logs().into_iter().collect();
        if let Some(unknown) = only.iter().find(|name| !logs.iter().any(|log| **log == ***name)) {
            return Err(anyhow!(
                "--map-log {unknown}: the map of {} has no such log, expected one of `{}`",
                folder.display(),
                logs.join("`, `")
            ));
        }
        let is_used = |log: &&Arc<str>| only.is_empty() || only.iter().any(|name| **name == ***log);
        let logs: Vec<&Arc<str>> = logs.iter().filter(is_used).collect();
        let detect = run.options(Stage::Detect.name());
        let register: RegisterOptions =
            recorded(folder, Stage::Detect.name(), &detect["register"])?;
        let places: DetectSection = recorded(folder, Stage::Detect.name(), &detect["detect"])?;
        let options = Self::options(folder, &run, &logs)?;
        let lidar =
            RangeLimits { min_m: options.lidar.range_min_m, max_m: options.lidar.range_max_m };
        let limits = register.limits(lidar);
        let (mut inputs, mut drives) = (BTreeMap::new(), Vec::new());
        for log in logs {
            let tables = [Artifact::Registered, Artifact::Scans, Artifact::ScanTrajectory];
            for artifact in tables {
                let name = format!("map/{}", artifact.name(log));
                inputs.insert(name, digest_file(&run.path(artifact, log))?);
            }
            let trajectory = run.trajectory(log)?;
            let (rows, _) = read_registered(&run.path(Artifact::Registered, log))?;
            let numbers: Vec<u32> = rows.iter().map(|row| row.id.scan).collect();
            let scans = scans_of(&run.scans(log), &numbers)?;
            for drive in drives_of(&rows, scans, limits) {
                let at =
                    |row: &dataset::RegisteredScan| trajectory.stamped_pose_at(row.stamp_ns, 0);
                // A segment without keyframes is in no map.
                let poses: Option<Vec<_>> = drive.rows.iter().map(|row| at(row).ok()).collect();
                let Some(poses) = poses.filter(|poses| !poses.is_empty()) else { continue };
                let map = poses[0].frame;
                drives.push((drive, map, poses.iter().map(|p| p.pose).collect::<Vec<Pose2>>()));
            }
        }
        let joined: Vec<Drive<'_>> = drives.iter().map(|(drive, ..)| drive.drive()).collect();
        let of_map = joined.iter().zip(&drives);
        let parts: Vec<MapDrive<'_>> =
            of_map.map(|(drive, (_, map, poses))| MapDrive { drive, poses, map: *map }).collect();
        let map = LocatorMap::new(&parts, places.place_step_m, places.place_half_m);
        let first = joined.iter().flat_map(|drive| &drive.scans).next();
        let coverage_deg = first.map(|scan| scan.coverage_deg).ok_or_else(|| {
            anyhow!(
                "the map of {} has no scan with a pose; repeat the command that made the run",
                folder.display()
            )
        })?;
        Ok(Self { map, options, register, coverage_deg, inputs })
    }

    /// The options that the logs were read with.
    fn options(folder: &Path, run: &MapRun<'_>, logs: &[&Arc<str>]) -> Result<Options> {
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
