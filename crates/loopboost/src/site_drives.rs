//! The drives of a site, which may share places.

use std::collections::HashMap;

use anyhow::Result;
use dataset::{Pose2, RegisteredScan, ScanClosure, ScanId};
use ingest::Origin;

use crate::config::usage;
use crate::drives::{RegisteredDrive, registered_drives};
use crate::known_map::KnownMap;
use crate::logs::LogFile;
use crate::run::Run;
use crate::stage::sites;

/// The segments of the logs of a site, after the drives of the map that they are added to.
pub(crate) struct SiteDrives {
    /// Name of the site.
    pub(crate) site: String,
    /// The logs of the run.
    pub(crate) logs: Vec<LogFile>,
    /// First those of the known map, then those of the logs in their order.
    pub(crate) drives: Vec<RegisteredDrive>,
    /// Poses of the registered scans of each drive of the known map.
    pub(crate) known_poses: Vec<Vec<Pose2>>,
    /// The number of the map of each drive of the known map.
    pub(crate) known_maps: Vec<u32>,
    /// The closures of the known map.
    pub(crate) known_closures: Vec<ScanClosure>,
    /// The number and the origin of the known map that is in a frame of absolute references.
    pub(crate) known_frame: Option<(u32, Option<Origin>)>,
}

/// The sites of the run, each with its logs, in the order of their first logs.
pub(crate) fn logs_of_sites(run: &Run) -> Result<Vec<(String, Vec<LogFile>)>> {
    let logs = run.ingested_logs()?;
    let names: Vec<&str> = logs.iter().map(|log| &*log.name).collect();
    let site_of = sites(&run.config, &names)?;
    let mut of_sites: Vec<(String, Vec<LogFile>)> = Vec::new();
    for log in logs {
        let site = &site_of[&*log.name];
        match of_sites.iter_mut().find(|(name, _)| name == site) {
            Some((_, logs)) => logs.push(log),
            None => of_sites.push((site.clone(), vec![log])),
        }
    }
    Ok(of_sites)
}

impl SiteDrives {
    /// Reads the registered scans of each site, one site after the other.
    pub(crate) fn of_run(run: &Run) -> Result<impl Iterator<Item = Result<Self>> + '_> {
        let sites = logs_of_sites(run)?;
        let mut known = KnownMap::read(run)?;
        if known.is_some() && 1 < sites.len() {
            let names: Vec<&str> = sites.iter().map(|(site, _)| &**site).collect();
            return Err(usage(format!(
                "the logs are of the sites `{}`, expected one site, because `detect.maps` adds them to one map; set `ingest.site`, or add the logs of each site by a run of their own",
                names.join("`, `")
            )));
        }
        Ok(sites.into_iter().map(move |(site, logs)| Self::read(run, site, logs, known.take())))
    }

    fn read(run: &Run, site: String, logs: Vec<LogFile>, known: Option<KnownMap>) -> Result<Self> {
        let (mut drives, known_poses, known_maps, known_closures, known_frame) = match known {
            Some(KnownMap { drives, poses, maps, closures, frame }) => {
                (drives, poses, maps, closures, frame)
            }
            None => Default::default(),
        };
        for log in &logs {
            drives.extend(registered_drives(run, &log.name)?);
        }
        Ok(Self { site, logs, drives, known_poses, known_maps, known_closures, known_frame })
    }

    /// Number of drives of the known map.
    pub(crate) fn n_known(&self) -> usize {
        self.known_poses.len()
    }

    /// The drives of the known map by its numbers.
    pub(crate) fn known_groups(&self) -> Vec<Vec<usize>> {
        let mut groups: Vec<(u32, Vec<usize>)> = Vec::new();
        for (drive, &map) in self.known_maps.iter().enumerate() {
            match groups.iter_mut().find(|(of_group, _)| *of_group == map) {
                Some((_, drives)) => drives.push(drive),
                None => groups.push((map, vec![drive])),
            }
        }
        groups.into_iter().map(|(_, drives)| drives).collect()
    }

    /// The drive of each registered scan.
    pub(crate) fn drive_of(&self) -> HashMap<&ScanId, usize> {
        let drives = self.drives.iter().enumerate();
        drives.flat_map(|(k, drive)| drive.rows.iter().map(move |row| (&row.id, k))).collect()
    }

    /// The rows of all drives, in the order of [`register::Drive::joined`].
    pub(crate) fn rows(&self) -> Vec<RegisteredScan> {
        self.drives.iter().flat_map(|drive| drive.rows.iter().cloned()).collect()
    }
}
