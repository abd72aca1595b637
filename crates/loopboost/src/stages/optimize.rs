use std::collections::{BTreeSet, HashMap};
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow};
use dataset::tables::{
    Provenance, read_candidates, write_closures, write_file, write_graph, write_poses,
    write_trajectory,
};
use dataset::{
    CandidateClosure, JudgedClosure, MapPose, Note, NoteKind, Pose2, RegisteredScan, ScanClosure,
    ScanId, StampedPose, Subject, Trajectory, tum,
};
use model::{Detector, Model};
use nalgebra::Matrix3;
use optimize::{
    Closure, JoinOutcome, Known, Proposal, Reason, Site, Solution, align_every_scan, close_loops,
    join_drives,
};
use register::Drive;
use train::detector::{alignment_covariance, closure_covariance};

use crate::drives::{
    PosedScan, RegisteredDrive, by_id, closure_row, evidence, matrix, posed_scans_of,
    registration_limits, upper_triangle,
};
use crate::findings::Findings;
use crate::georeference::{Far, Georeference, Georeferenced};
use crate::known_map::KnownMap;
use crate::logs::LogFile;
use crate::map_files::{Graph, is_same_drive};
use crate::references::{self, SiteReferences};
use crate::run::{Done, Run, Task};
use crate::scorer::Scorer;
use crate::site_drives::SiteDrives;
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Candidates -> closures.parquet, trajectory.parquet, trajectory/LOG.parquet, trajectory/LOG.tum,
/// graph.g2o, graph.parquet
///
/// The drives of a site, which are the segments of its logs, share a map where they share places.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Optimize)?;
    task.inputs.extend(KnownMap::inputs(run)?);
    task.inputs.extend(references::inputs(run)?);
    let trained = trained_model(run, &mut task)?;
    run.task(&task, |provenance| optimize(run, trained.as_ref(), &provenance))
}

/// The model that `train` has made in this run, with its detector: of several, the one with the smallest
/// error by the first grouping. It becomes an input of the task, with the features that its classifier
/// needs. `None` if the command names a model, and if there was nothing to fit a detector to.
fn trained_model(run: &Run, task: &mut Task) -> Result<Option<Model>> {
    if run.model.is_some() {
        task.inputs.retain(|input| !input.starts_with(run.path("features")));
        return Ok(None);
    }
    let mut models = Vec::new();
    for path in run.trained_models() {
        if !run.is_dry() || path.exists() {
            models.push((model::load(&path)?, path));
        }
    }
    let error = |model: &Model| model.measured.first().map_or(1.0, |measured| measured.error);
    let best = models
        .into_iter()
        .filter(|(model, _)| model.detector.is_some())
        .min_by(|(a, _), (b, _)| error(a).total_cmp(&error(b)));
    Ok(match best {
        Some((model, path)) => {
            task.inputs.push(path);
            Some(model)
        }
        None => {
            task.inputs.retain(|input| !input.starts_with(run.path("features")));
            None
        }
    })
}

/// What the logs of a run give together.
#[derive(Default)]
struct Maps {
    closures: Vec<JudgedClosure>,
    keyframes: Vec<MapPose>,
    graph: Graph,
    n_maps: u32,
}

fn optimize(run: &Run, trained: Option<&Model>, provenance: &Provenance) -> Result<Done> {
    let (mut candidates, _) = read_candidates(&run.path_of(Artifact::Candidates))?;
    let mut done = Done::default();
    let detector = trained.and_then(|model| model.detector.as_ref());
    if let Some(model) = trained {
        add_confidences(run, model, &mut candidates)?;
    } else if run.model.is_none() {
        done.notes.push(NoteKind::DetectorNotTrained.into());
    }
    let detector = detector.unwrap_or_else(|| run.detector());
    let mut maps = Maps::default();
    let mut trajectories = Vec::new();
    for site in SiteDrives::of_run(run)? {
        let site = site?;
        let first = maps.closures.len();
        let referenced = SiteReferences::read(run, &site)?;
        let (solved, drives, made) = solve(run, &site, &referenced, detector, &candidates);
        let rows = site.rows();
        let numbers = maps.add(&rows, &site, &solved);
        done.losses.merge(referenced.losses);
        done.notes.extend(referenced.notes);
        done.notes.extend(made.notes_of_map(&site, &numbers));
        let closures = Closures::of(&site, &maps.closures[first..]);
        for log in &site.logs {
            let scans = every_scan(run, log, &site, &drives, &solved)?;
            done.notes.extend(closures.notes(log));
            done.summaries.push(closures.summary(log, scans.poses().len()));
            trajectories.push((log.clone(), scans));
        }
        if 1 < site.drives.len() {
            done.summaries.push(closures.joined(&solved));
            done.notes.extend(join_notes(&site, &solved));
        }
        done.notes.extend(made.notes);
        done.summaries.extend(made.summaries);
    }
    run.scan_cache.check()?;
    let (losses, notes) = (done.losses.clone(), done.notes.clone());
    let provenance = Provenance { losses, notes, ..provenance.clone() };
    done.outputs = write(run, &provenance, &maps, &trajectories)?;
    Ok(done)
}

/// Adds the confidence of the classifier to candidates that were found without it: the detector was
/// fitted to evidence with it.
fn add_confidences(run: &Run, model: &Model, candidates: &mut [CandidateClosure]) -> Result<()> {
    let scorer = Scorer::new(run, model)?;
    for CandidateClosure { closure, .. } in candidates {
        if closure.classifier.is_none() && scorer.can_score(&closure.query.log) {
            closure.classifier = scorer.score(&closure.query, &closure.reference);
        }
    }
    Ok(())
}

/// Closes the loops of each drive of a site by itself, then joins those that share places, and puts the maps
/// into the frame of their references. Candidates whose places are far from each other by the references take no
/// part.
fn solve(
    run: &Run,
    site: &SiteDrives,
    references: &SiteReferences,
    detector: &Detector,
    candidates: &[CandidateClosure],
) -> (Site, Vec<Drive>, Georeferenced) {
    let options = &run.config.optimize.references;
    let georeference = Georeference { site, references, options, detector };
    let drives: Vec<Drive> = site.drives.iter().map(RegisteredDrive::drive).collect();
    let (near, far) = Far::split(candidates, site, &georeference.locate(&drives));
    let finder = Proposals { candidates: &near, found_with: run.detector(), detector };
    let min_path_m = run.config.detection().min_path_m;
    let mut solutions = Vec::new();
    for (k, (registered, drive)) in site.drives.iter().zip(&drives).enumerate() {
        solutions.push(match site.known_poses.get(k) {
            Some(poses) => known_solution(poses),
            None => {
                let proposals = finder.among(&registered.rows);
                close_loops(drive, &proposals, detector, min_path_m)
            }
        });
    }
    let drive = Drive::joined(drives);
    let rows = site.rows();
    let proposals = finder.between(&rows, &drive);
    let known = Known {
        maps: site.known_groups(),
        closures: site.known_closures.iter().filter_map(|c| proposal(&by_id(&rows), c)).collect(),
    };
    let mut solved = join_drives(&drive, &solutions, &known, &proposals, detector);
    let mut made = georeference.place(&drive, &mut solved);
    made.notes.extend(far.note(&site.site, detector.min_confidence));
    let by_id = by_id(&rows);
    let closures = &mut solved.solution.closures;
    closures.extend(far.closures.iter().filter_map(|closure| {
        let rejected = Some(Reason::FarByReferences);
        Some(Closure { proposal: proposal(&by_id, closure)?, rejected })
    }));
    closures.sort_by_key(|closure| (closure.proposal.query, closure.proposal.reference));
    (solved, drive.split(), made)
}

/// A drive of the known map. Its closures are those of the map.
fn known_solution(poses: &[Pose2]) -> Solution {
    Solution {
        closures: Vec::new(),
        poses: poses.to_vec(),
        covariances: vec![Matrix3::zeros(); poses.len()],
        edges: Vec::new(),
        rounds: Vec::new(),
    }
}

/// The poses at every scan of a log.
fn every_scan(
    run: &Run,
    log: &LogFile,
    site: &SiteDrives,
    drives: &[Drive],
    solved: &Site,
) -> Result<Trajectory> {
    let of_log = site.drives.iter().filter(|drive| drive.log() == Some(&log.name));
    let rows: Vec<RegisteredScan> = of_log.flat_map(|drive| drive.rows.iter().cloned()).collect();
    let posed = posed_scans_of(run, &log.name, &rows)?;
    let mut poses = Vec::new();
    let mut optimized = &solved.solution.poses[..];
    for (registered, drive) in site.drives.iter().zip(drives) {
        let (of_drive, rest) = optimized.split_at(registered.rows.len());
        optimized = rest;
        if registered.log() != Some(&log.name) {
            continue;
        }
        let segment = registered.segment();
        let of_segment = posed.iter().find(|scans| scans[0].odometry.segment == segment);
        let of_segment = of_segment.map(Vec::as_slice).unwrap_or_default();
        let aligned = match run.config.optimize.every_scan {
            true => aligned_poses(run, log, (&registered.rows, drive), of_drive, of_segment)?,
            false => interpolated_poses(&registered.rows, of_drive, of_segment),
        };
        let stamped = of_segment.iter().zip(aligned).map(|(scan, pose)| StampedPose {
            pose,
            covariance: None,
            z_m: None,
            ..scan.odometry
        });
        poses.extend(stamped);
    }
    Ok(Trajectory::new(poses).0)
}

/// Candidates as proposals, with the covariance and the confidence that `detector` gives them. They were
/// found with the detector `found_with`.
struct Proposals<'a> {
    candidates: &'a [CandidateClosure],
    found_with: &'a Detector,
    detector: &'a Detector,
}

impl Proposals<'_> {
    /// The candidates between drives. `rows` are those of all of them.
    fn between(&self, rows: &[RegisteredScan], drive: &Drive) -> Vec<Proposal> {
        let mut proposals = self.among(rows);
        proposals.retain(|p| drive.part_of(p.query) != drive.part_of(p.reference));
        proposals
    }

    /// The candidates between two of the rows.
    fn among(&self, rows: &[RegisteredScan]) -> Vec<Proposal> {
        let rows = by_id(rows);
        // Those that a detector would not have compared were found for training only.
        let compared = self.candidates.iter().filter(|c| c.rank < self.detector.n_candidates);
        let proposal = |CandidateClosure { closure, .. }: &CandidateClosure| {
            let found = proposal(&rows, closure)?;
            let alignment = alignment_covariance(&found.covariance, self.found_with);
            let covariance = closure_covariance(&alignment, self.detector);
            let confidence = self.detector.confidence(&found.evidence);
            Some(Proposal { covariance, confidence, ..found })
        };
        compared.filter_map(proposal).collect()
    }
}

/// A closure as a proposal; `None` if one of its scans is not among the rows.
fn proposal(rows: &HashMap<&ScanId, usize>, closure: &ScanClosure) -> Option<Proposal> {
    Some(Proposal {
        query: *rows.get(&closure.query)?,
        reference: *rows.get(&closure.reference)?,
        reference_from_query: closure.reference_from_query,
        covariance: matrix(closure.covariance),
        evidence: evidence(closure),
        confidence: closure.confidence,
    })
}

/// The closures of a site.
struct Closures<'a> {
    site: &'a SiteDrives,
    /// Each with whether it is between two drives.
    closures: Vec<(&'a JudgedClosure, bool)>,
}

impl<'a> Closures<'a> {
    fn of(site: &'a SiteDrives, closures: &'a [JudgedClosure]) -> Self {
        let drive_of = site.drive_of();
        let is_between = |judged: &JudgedClosure| {
            drive_of.get(&judged.closure.query) != drive_of.get(&judged.closure.reference)
        };
        let closures = closures.iter().map(|judged| (judged, is_between(judged))).collect();
        Self { site, closures }
    }

    /// The closures within the drives of a log, and those between its segments.
    fn of_log(&self, log: &LogFile) -> impl Iterator<Item = &'a JudgedClosure> {
        let is_of_log = |judged: &&JudgedClosure| {
            judged.closure.query.log == log.name && judged.closure.reference.log == log.name
        };
        self.closures.iter().map(|(judged, _)| *judged).filter(is_of_log)
    }

    fn summary(&self, log: &LogFile, n_poses: usize) -> Summary {
        let n_accepted = self.of_log(log).filter(|judged| judged.is_accepted()).count();
        Summary::Optimized {
            log: log.name.to_string(),
            n_accepted: n_accepted as u64,
            n_rejected: (self.of_log(log).count() - n_accepted) as u64,
            n_poses: n_poses as u64,
        }
    }

    /// The closures between drives, and the number of maps.
    fn joined(&self, solved: &Site) -> Summary {
        let between = || self.closures.iter().filter(|(_, is_between)| *is_between);
        let n_accepted = between().filter(|(judged, _)| judged.is_accepted()).count();
        Summary::Joined {
            site: self.site.site.clone(),
            n_drives: self.site.drives.len() as u64,
            n_maps: solved.maps.len() as u64,
            n_accepted: n_accepted as u64,
            n_rejected: (between().count() - n_accepted) as u64,
        }
    }

    /// Remarks about groups of closures that were rejected.
    fn notes(&self, log: &LogFile) -> Option<Note> {
        let unsupported = Some(Reason::Unsupported.code());
        let is_unsupported = |judged: &&JudgedClosure| judged.rejected.as_deref() == unsupported;
        let n_closures = self.of_log(log).filter(is_unsupported).count() as u64;
        let kind = NoteKind::UnsupportedClosures { n_closures };
        (0 < n_closures).then(|| Note::new(kind, Subject::log(&*log.name)))
    }
}

/// Remarks about logs of a site that are in different maps.
fn join_notes(site: &SiteDrives, solved: &Site) -> Vec<Note> {
    let of_map = |map: &[usize]| -> BTreeSet<&str> {
        map.iter().filter_map(|&drive| site.drives[drive].log()).map(|log| &**log).collect()
    };
    let maps: BTreeSet<BTreeSet<&str>> = solved.maps.iter().map(|map| of_map(map)).collect();
    let joined = |logs: &BTreeSet<&str>| logs.iter().copied().collect::<Vec<_>>().join(", ");
    let mut notes = Vec::new();
    // Segments of one log that share no place are usual.
    if 1 < maps.len() {
        let maps: Vec<String> = maps.iter().map(joined).collect();
        let site = site.site.clone();
        notes.push(NoteKind::SeparateMaps { site, maps: maps.join(" | ") }.into());
    }
    notes.extend(solved.joins.iter().filter_map(|join| {
        let (logs, others) = (joined(&of_map(&join.drives)), joined(&of_map(&join.to)));
        let site = site.site.clone();
        match join.outcome {
            JoinOutcome::Ambiguous => Some(NoteKind::AmbiguousMaps { site, logs, others }.into()),
            JoinOutcome::BothKnown => {
                Some(NoteKind::EarlierMapsOverlap { site, logs, others }.into())
            }
            JoinOutcome::Joined { .. } | JoinOutcome::Unsupported { .. } => None,
        }
    }));
    notes
}

/// Aligns every scan of a segment with the map.
fn aligned_poses(
    run: &Run,
    log: &LogFile,
    (rows, drive): (&[RegisteredScan], &Drive),
    poses: &[Pose2],
    posed: &[PosedScan],
) -> Result<Vec<Pose2>> {
    let numbers: Vec<u32> = posed.iter().map(|scan| scan.scan).collect();
    let limits = registration_limits(&run.config, &log.name)?;
    let scans = run.scan_cache.open(&run.scans(&log.name), &numbers, limits)?;
    let odometry: Vec<Pose2> = posed.iter().map(|scan| scan.odometry.pose).collect();
    let in_input: Vec<usize> = positions(rows, posed)
        .with_context(|| format!("log `{}`: registered scans and poses do not match", log.name))?;
    Ok(align_every_scan(drive, poses, &in_input, &scans, &odometry))
}

/// The index of each registered scan among all scans of its segment.
fn positions(rows: &[RegisteredScan], posed: &[PosedScan]) -> Result<Vec<usize>> {
    let index: HashMap<u32, usize> = posed.iter().map(|scan| scan.scan).zip(0..).collect();
    rows.iter()
        .map(|row| {
            index.get(&row.id.scan).copied().ok_or_else(|| {
                anyhow!(
                    "scan {} has no pose by odometry; run `{}` again",
                    row.id.scan,
                    Stage::Register.command()
                )
            })
        })
        .collect()
}

/// The pose at every scan: the optimized pose of the last registered scan before it, and the odometry
/// since then. The difference to the next registered scan is spread over the time between the two.
fn interpolated_poses(
    rows: &[RegisteredScan],
    optimized: &[Pose2],
    posed: &[PosedScan],
) -> Vec<Pose2> {
    let of_scan = |scan: &PosedScan| {
        let stamp_ns = scan.odometry.stamp_ns;
        let after = rows.partition_point(|row| row.stamp_ns <= stamp_ns);
        let along =
            |row: usize| optimized[row] * (rows[row].odometry.inverse() * scan.odometry.pose);
        match (after.checked_sub(1), after < rows.len()) {
            (Some(last), true) => {
                let gap_ns = (rows[after].stamp_ns - rows[last].stamp_ns) as f64;
                let share = (stamp_ns - rows[last].stamp_ns) as f64 / gap_ns;
                along(last).towards(&along(after), share)
            }
            (Some(last), false) => along(last),
            (None, _) => along(0),
        }
    };
    posed.iter().map(of_scan).collect()
}

impl Maps {
    /// Adds the drives of a site, whose rows are `rows`. Those of the known map are in its run. Returns the number
    /// of the map of each drive.
    fn add(&mut self, rows: &[RegisteredScan], site: &SiteDrives, solved: &Site) -> Vec<u32> {
        let solution = &solved.solution;
        self.closures.extend(solution.closures.iter().map(|closure| JudgedClosure {
            closure: closure_row(rows, &closure.proposal),
            rejected: closure.rejected.map(|reason| reason.code().to_owned()),
        }));
        let numbers = self.numbers(site, solved);
        let mut first_row = 0;
        for (drive, of_drive) in rows.chunk_by(is_same_drive).enumerate() {
            let poses = solution.poses[first_row..].iter().zip(&solution.covariances[first_row..]);
            first_row += of_drive.len();
            if drive < site.n_known() {
                continue;
            }
            let keyframes = of_drive.iter().zip(poses).filter(|(row, _)| row.is_keyframe);
            self.keyframes.extend(keyframes.map(|(row, (pose, covariance))| MapPose {
                id: row.id.clone(),
                stamp_ns: row.stamp_ns,
                pose: *pose,
                covariance: Some(upper_triangle(covariance)),
                is_degenerate: row.is_degenerate,
                segment: row.segment,
                travel_m: row.travel_m,
                map: numbers[drive],
            }));
        }
        self.graph.add(rows, solution);
        self.n_maps = numbers.iter().map(|number| number + 1).fold(self.n_maps, u32::max);
        numbers
    }

    /// The number of the map of each drive. A map with a drive of the known map keeps its number.
    fn numbers(&self, site: &SiteDrives, solved: &Site) -> Vec<u32> {
        let mut next = site.known_maps.iter().map(|number| number + 1).fold(self.n_maps, u32::max);
        let mut numbers = vec![0; site.drives.len()];
        for map in &solved.maps {
            let known = map.iter().find_map(|&drive| site.known_maps.get(drive));
            let number = known.copied().unwrap_or_else(|| {
                next += 1;
                next - 1
            });
            map.iter().for_each(|&drive| numbers[drive] = number);
        }
        numbers
    }
}

fn write(
    run: &Run,
    provenance: &Provenance,
    maps: &Maps,
    trajectories: &[(LogFile, Trajectory)],
) -> Result<Vec<PathBuf>> {
    let once =
        [Artifact::Closures, Artifact::Trajectory, Artifact::PoseGraph, Artifact::GraphEdges];
    let [closures, keyframes, graph, edges] = once.map(|artifact| run.path_of(artifact));
    write_closures(&closures, provenance, &maps.closures)?;
    write_trajectory(&keyframes, provenance, &maps.keyframes)?;
    write_file(&graph, maps.graph.text().as_bytes())?;
    write_graph(&edges, provenance, &maps.graph.by_scan)?;
    let mut outputs = vec![closures, keyframes, graph, edges];
    for (log, trajectory) in trajectories {
        let table = run.path_of_log(Artifact::ScanTrajectory, &log.name);
        write_poses(&table, provenance, &log.name, trajectory)?;
        let text = run.path_of_log(Artifact::TumTrajectory, &log.name);
        let poses = trajectory.poses().iter().map(|pose| (pose.stamp_ns, pose.pose));
        write_file(&text, tum(poses).as_bytes())?;
        outputs.extend([table, text]);
    }
    Ok(outputs)
}
