//! The map of finished runs: that drives are added to (`detect.maps`), or that `locate` searches.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::tables::{Provenance, read_closures, read_poses, read_registered, read_trajectory};
use dataset::{JudgedClosure, NoteKind, Pose2, RangeLimits, ScanClosure};
use ingest::Origin;
use register::RegisterOptions;
use serde_json::Value;

use crate::config::usage;
use crate::drives::{RegisteredDrive, drives_of};
use crate::map_run::MapRun;
use crate::run::Run;
use crate::scan_cache::ScanCache;
use crate::stage::Artifact;

/// The drives of finished runs.
#[derive(Default)]
pub(crate) struct KnownMap {
    pub(crate) drives: Vec<RegisteredDrive>,
    /// The optimized pose of each registered scan of each drive.
    pub(crate) poses: Vec<Vec<Pose2>>,
    /// The number of the map of each drive.
    pub(crate) maps: Vec<u32>,
    /// The accepted closures within and between them. `locate` does not need them.
    pub(crate) closures: Vec<ScanClosure>,
    /// The number and the origin of the map that is in a frame of absolute references.
    pub(crate) frame: Option<(u32, Option<Origin>)>,
}

impl KnownMap {
    /// What [`KnownMap::add_log`] reads.
    pub(crate) const OF_LOG: [Artifact; 3] =
        [Artifact::Registered, Artifact::Scans, Artifact::ScanTrajectory];

    /// Reads the map that the logs of a run are added to; `None` if the pipeline names none.
    pub(crate) fn read(run: &Run) -> Result<Option<Self>> {
        let runs = MapRun::known(run)?;
        let Some(first) = runs.first() else { return Ok(None) };
        let (_, Provenance { notes, .. }) = read_trajectory(&first.path(Artifact::Trajectory, ""))?;
        let frames: Vec<_> = notes.iter().filter_map(|note| frame(&note.kind)).collect();
        let frame = only_frame(&frames, first.folder())?;
        let mut known = Self { frame, ..Self::default() };
        let mut names = BTreeSet::new();
        for map in &runs {
            for log in map.logs() {
                known.add_log(map, &log, &run.scan_cache)?;
                if !names.insert(log.clone()) {
                    return Err(usage(format!(
                        "`detect.maps`: two runs have a log `{log}`; remove one"
                    )));
                }
            }
            let (closures, _) = read_closures(&map.path(Artifact::Closures, ""))?;
            let accepted = closures.into_iter().filter(JudgedClosure::is_accepted);
            known.closures.extend(accepted.map(|judged| judged.closure));
        }
        if let Some(log) = run.ingested_logs()?.iter().find(|log| names.contains(&log.name)) {
            return Err(usage(format!(
                "log `{}` is part of the map (`detect.maps`); remove it from `ingest.logs`, or rename it",
                log.name
            )));
        }
        // The numbers of maps are those of the first run.
        let of_first: BTreeSet<u32> = first.numbers();
        let stray = known.drives.iter().zip(&known.maps).find(|(_, map)| !of_first.contains(map));
        if let Some((drive, map)) = stray {
            return Err(usage(format!(
                "`detect.maps`: log `{}` is in map {map}, which {} does not have: it shares no place with the logs of that run; remove its run",
                drive.log().map_or("", |log| &**log),
                first.folder().display()
            )));
        }
        Ok(Some(known))
    }

    /// Adds the drives of a log of a run, without closures.
    pub(crate) fn add_log(
        &mut self,
        map: &MapRun<'_>,
        log: &str,
        cache: &Arc<ScanCache>,
    ) -> Result<()> {
        let path = map.path(Artifact::Registered, log);
        let (rows, provenance) = read_registered(&path)?;
        let limits = limits(&path, &provenance, log)?;
        let (optimized, _) = read_poses(&map.path(Artifact::ScanTrajectory, log))?;
        for drive in drives_of(cache, &map.scans(log), &rows, limits)? {
            // A segment without keyframes is in no map.
            let Some(number) = map.number(log, drive.segment()) else { continue };
            let pose = |stamp_ns: i64| {
                optimized.pose_at(stamp_ns, 0).with_context(|| {
                    format!(
                        "{}: no pose at {stamp_ns} ns",
                        map.path(Artifact::ScanTrajectory, log).display()
                    )
                })
            };
            let poses = drive.rows.iter().map(|row| pose(row.stamp_ns)).collect::<Result<_>>()?;
            self.drives.push(drive);
            self.poses.push(poses);
            self.maps.push(number);
        }
        Ok(())
    }

    /// The files that it is read from.
    pub(crate) fn inputs(run: &Run) -> Result<Vec<PathBuf>> {
        let mut inputs = Vec::new();
        for map in MapRun::known(run)? {
            for log in map.logs() {
                inputs.extend(Self::OF_LOG.map(|artifact| map.path(artifact, &log)));
            }
            inputs.extend([Artifact::Trajectory, Artifact::Closures].map(|a| map.path(a, "")));
        }
        Ok(inputs)
    }
}

/// The number and the origin of a map in the frame of its references, from the note that says so.
fn frame(note: &NoteKind) -> Option<(u32, Option<Origin>)> {
    let NoteKind::MapGeoreferenced { map, latitude_deg, longitude_deg, altitude_m, .. } = *note
    else {
        return None;
    };
    let origin = || {
        let (latitude_deg, longitude_deg) = (latitude_deg?, longitude_deg?);
        Some(Origin { latitude_deg, longitude_deg, altitude_m: altitude_m? })
    };
    Some((map, origin()))
}

/// The frame of references that a run has a map in. An error if there are several, which have no known relation.
fn only_frame(
    frames: &[(u32, Option<Origin>)],
    folder: &Path,
) -> Result<Option<(u32, Option<Origin>)>> {
    match frames {
        [first, second, ..] => Err(usage(format!(
            "`detect.maps`: {} has several maps in a frame of references ({} and {}), one per site, and it is not known in which of them the new logs are; make a run with the logs of one site, and add to that",
            folder.display(),
            first.0,
            second.0
        ))),
        _ => Ok(frames.first().copied()),
    }
}

/// The range limits of the registration of a log, from the options of its table.
fn limits(path: &Path, provenance: &Provenance, log: &str) -> Result<RangeLimits> {
    let options = &provenance.options;
    let metre = |k: usize| options["range_m"][log][k].as_f64();
    let lidar = metre(0).zip(metre(1)).map(|(min_m, max_m)| RangeLimits { min_m, max_m });
    let register: Option<RegisterOptions> =
        serde_json::from_value::<RegisterOptions>(options["register"].clone()).ok();
    register.zip(lidar).map(|(register, lidar)| register.limits(lidar)).ok_or_else(|| {
        let found: &Value = options;
        anyhow!(
            "{}: the options of the table are {found}, expected `register` and `range_m` of the log `{log}`; repeat the run",
            path.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_of_several_sites_in_frames_of_references_are_refused() {
        let origin = Some(Origin { latitude_deg: 42.0, longitude_deg: -83.7, altitude_m: 260.0 });
        let found = |frames: &[(u32, Option<Origin>)]| only_frame(frames, Path::new("runs/both"));
        assert_eq!(found(&[]).unwrap(), None);
        assert_eq!(found(&[(2, origin)]).unwrap(), Some((2, origin)));
        let error = found(&[(0, origin), (3, None)]).unwrap_err().to_string();
        assert!(
            error.contains("runs/both has several maps") && error.contains("0 and 3"),
            "{error}"
        );
    }
}
