//! What was found in the drives of a run, as `evaluate` takes it.

use std::collections::HashMap;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::{
    Provenance, read_candidates, read_closures, read_poses, read_registered, read_trajectory,
};
use dataset::{
    CandidateClosure, JudgedClosure, MapPose, NoteKind, Pose2, RegisteredScan, ScanClosure, ScanId,
    Trajectory,
};
use evaluate::detection::{
    ClosureBetween, Drive, DriveKeyframe, Evidence, FoundCandidate, FoundClosure, KeyframePoses,
    ScanPoses, SiteDrives,
};

use crate::drives::{PosedScan, posed_scans_of};
use crate::logs::LogFile;
use crate::run::Run;
use crate::site_drives::logs_of_sites;
use crate::stage::{Artifact, Stage};

/// What the stages `register`, `detect` and `optimize` found in a segment of a log.
pub(crate) struct FoundDrive {
    log: Arc<str>,
    segment: u32,
    /// Number of its map.
    map: u32,
    keyframes: Vec<KeyframePoses>,
    /// The index of each keyframe.
    ids: HashMap<ScanId, usize>,
    scans: Vec<ScanPoses>,
    candidates: Vec<FoundCandidate>,
    /// Each closure with the indices of its keyframes, the query first.
    closures: Vec<(JudgedClosure, [usize; 2])>,
    truth: Option<Arc<Trajectory>>,
}

/// The tables that all logs of a run share.
struct Shared {
    candidates: Vec<CandidateClosure>,
    closures: Vec<JudgedClosure>,
    keyframes: Vec<MapPose>,
}

impl FoundDrive {
    /// The drives of all logs, and the sites with several drives.
    pub(crate) fn load_all(run: &Run) -> Result<(Vec<Self>, Vec<SiteDrives>)> {
        let (mut keyframes, Provenance { notes, .. }) =
            read_trajectory(&run.path_of(Artifact::Trajectory))?;
        // Poses are compared with the ground truth after an alignment at the first one. Covariances in the frame of
        // absolute references are not those of poses relative to the first one.
        for note in &notes {
            if let NoteKind::MapGeoreferenced { map, .. } = note.kind {
                let of_map = keyframes.iter_mut().filter(|keyframe| keyframe.map == map);
                of_map.for_each(|keyframe| keyframe.covariance = None);
            }
        }
        let shared = Shared {
            candidates: read_candidates(&run.path_of(Artifact::Candidates))?.0,
            closures: read_closures(&run.path_of(Artifact::Closures))?.0,
            keyframes,
        };
        let mut drives = Vec::new();
        for log in run.ingested_logs()? {
            drives.extend(Self::of_log(run, &log, &shared)?);
        }
        let sites = sites_of(run, &drives, &shared.closures)?;
        Ok((drives, sites))
    }

    fn of_log(run: &Run, log: &LogFile, shared: &Shared) -> Result<Vec<Self>> {
        let path = |artifact| run.path_of_log(artifact, &log.name);
        let (registered, _) = read_registered(&path(Artifact::Registered))?;
        let (optimized, _) = read_poses(&path(Artifact::ScanTrajectory))?;
        let truth = match run.goal.has(Artifact::Truth) {
            true => Some(read_poses(&path(Artifact::Truth))?.0),
            false => None,
        };
        let truth = truth.filter(|truth| !truth.poses().is_empty()).map(Arc::new);
        let posed = posed_scans_of(run, &log.name, &registered)?;
        let segments = registered.chunk_by(|a, b| a.segment == b.segment);
        segments
            .map(|rows| {
                let segment = rows[0].segment;
                let posed = posed.iter().find(|scans| scans[0].odometry.segment == segment);
                let (keyframes, ids) = keyframes(rows, &shared.keyframes);
                let map_of = |k: &&MapPose| ids.contains_key(&k.id);
                let map = shared.keyframes.iter().find(map_of).map_or(0, |k| k.map);
                let index = |closure: &ScanClosure| -> Option<[usize; 2]> {
                    Some([*ids.get(&closure.query)?, *ids.get(&closure.reference)?])
                };
                let candidates = shared.candidates.iter().filter_map(|candidate| {
                    Some(found_candidate(&candidate.closure, index(&candidate.closure)?))
                });
                let closures = shared
                    .closures
                    .iter()
                    .filter_map(|judged| Some((judged.clone(), index(&judged.closure)?)));
                Ok(Self {
                    log: log.name.clone(),
                    segment,
                    map,
                    scans: scans(posed.map(Vec::as_slice).unwrap_or_default(), rows, &optimized)?,
                    candidates: candidates.collect(),
                    closures: closures.collect(),
                    truth: truth.clone(),
                    keyframes,
                    ids,
                })
            })
            .collect()
    }

    /// The closures of the drive.
    pub(crate) fn closures(&self) -> Vec<FoundClosure<'_>> {
        self.closures.iter().map(found_closure).collect()
    }

    /// The drive with its closures, from [`Self::closures`].
    pub(crate) fn drive<'a>(&'a self, closures: &'a [FoundClosure<'a>]) -> Drive<'a> {
        Drive {
            log: &self.log,
            segment: self.segment,
            map: (!self.keyframes.is_empty()).then_some(self.map),
            keyframes: &self.keyframes,
            scans: &self.scans,
            candidates: &self.candidates,
            closures,
            truth: self.truth.as_deref(),
            // The poses of a run are those of the lidar.
            base_from_lidar: Pose2::default(),
        }
    }
}

/// The sites with several drives, and the closures between these.
fn sites_of(
    run: &Run,
    drives: &[FoundDrive],
    closures: &[JudgedClosure],
) -> Result<Vec<SiteDrives>> {
    let keyframe_of: HashMap<&ScanId, DriveKeyframe> = (drives.iter().enumerate())
        .flat_map(|(drive, found)| {
            found.ids.iter().map(move |(id, &keyframe)| (id, DriveKeyframe { drive, keyframe }))
        })
        .collect();
    let mut sites = Vec::new();
    for (site, logs) in logs_of_sites(run)? {
        let is_of_site =
            |(_, found): &(usize, &FoundDrive)| logs.iter().any(|log| log.name == found.log);
        let of_site = drives.iter().enumerate().filter(is_of_site);
        let of_site: Vec<(usize, u32)> = of_site.map(|(k, found)| (k, found.map)).collect();
        if of_site.len() < 2 {
            continue;
        }
        let between = |judged: &JudgedClosure| {
            let closure = &judged.closure;
            let query = *keyframe_of.get(&closure.query)?;
            let reference = *keyframe_of.get(&closure.reference)?;
            let is_of_site = of_site.iter().any(|&(drive, _)| drive == query.drive);
            (is_of_site && query.drive != reference.drive).then_some(ClosureBetween {
                query,
                reference,
                reference_from_query: closure.reference_from_query,
                is_accepted: judged.is_accepted(),
            })
        };
        let closures = closures.iter().filter_map(between).collect();
        sites.push(SiteDrives { site, drives: of_site, closures });
    }
    Ok(sites)
}

/// The keyframes of a drive, and the index of each.
fn keyframes(
    rows: &[RegisteredScan],
    optimized: &[MapPose],
) -> (Vec<KeyframePoses>, HashMap<ScanId, usize>) {
    let optimized: HashMap<&ScanId, &MapPose> = optimized.iter().map(|k| (&k.id, k)).collect();
    let found: Vec<(&RegisteredScan, &MapPose)> =
        rows.iter().filter_map(|row| Some((row, *optimized.get(&row.id)?))).collect();
    let ids = found.iter().map(|(row, _)| row.id.clone()).zip(0..).collect();
    let keyframe = |(row, optimized): &(&RegisteredScan, &MapPose)| KeyframePoses {
        scan: row.id.scan,
        stamp_ns: row.stamp_ns,
        path_m: row.travel_m,
        odometry: row.odometry,
        scan_matched: row.pose,
        optimized: optimized.pose,
        covariance: optimized.covariance,
    };
    (found.iter().map(keyframe).collect(), ids)
}

/// The poses of all scans of a drive.
fn scans(
    posed: &[PosedScan],
    rows: &[RegisteredScan],
    optimized: &Trajectory,
) -> Result<Vec<ScanPoses>> {
    let registered: HashMap<u32, Pose2> = rows.iter().map(|row| (row.id.scan, row.pose)).collect();
    posed
        .iter()
        .map(|scan| {
            let stamp_ns = scan.odometry.stamp_ns;
            let pose = optimized.pose_at(stamp_ns, 0).map_err(|_| {
                anyhow!(
                    "the trajectory has no pose at the stamp {stamp_ns} ns of scan {}; run `{}` again",
                    scan.scan,
                    Stage::Optimize.command()
                )
            })?;
            Ok(ScanPoses {
                stamp_ns,
                odometry: scan.odometry.pose,
                scan_matched: registered.get(&scan.scan).copied(),
                optimized: pose,
            })
        })
        .collect()
}

fn found_closure((judged, keyframes): &(JudgedClosure, [usize; 2])) -> FoundClosure<'_> {
    let closure = &judged.closure;
    let found = found_candidate(closure, *keyframes);
    FoundClosure {
        query: found.query,
        reference: found.reference,
        reference_from_query: found.reference_from_query,
        covariance: closure.covariance,
        confidence: closure.confidence,
        rejected: judged.rejected.as_deref(),
        evidence: Evidence {
            overlap: closure.overlap,
            known_overlap: closure.known_overlap,
            conflict: closure.conflict,
            margin: closure.margin,
            classifier: closure.classifier,
            is_degenerate: closure.is_degenerate,
        },
    }
}

fn found_candidate(closure: &ScanClosure, [query, reference]: [usize; 2]) -> FoundCandidate {
    FoundCandidate {
        query,
        reference,
        reference_from_query: closure.reference_from_query,
        confidence: closure.confidence,
    }
}
