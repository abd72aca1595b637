use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow};
use dataset::tables::{
    Provenance, read_candidates, write_closures, write_file, write_poses, write_trajectory,
};
use dataset::{
    CandidateClosure, JudgedClosure, MapPose, Note, NoteKind, Pose2, RegisteredScan, Scan,
    StampedPose, Subject, Trajectory,
};
use model::{Detector, Model};
use optimize::{Edge, Proposal, Reason, Solution, align_every_scan, close_loops};
use register::OdometryScan;
use train::detector::{alignment_covariance, closure_covariance};

use crate::drives::{
    PosedScan, RegisteredDrive, by_scan, closure_row, evidence, matrix, posed_scans,
    registered_drives, registration_limits, scans_of, upper_triangle,
};
use crate::findings::Findings;
use crate::logs::LogFile;
use crate::run::{Done, Run, Task};
use crate::scorer::Scorer;
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Candidates -> closures.parquet, trajectory.parquet, trajectory/LOG.parquet, trajectory/LOG.tum,
/// graph.g2o
///
/// Each segment of a log is a map of its own.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Optimize)?;
    let trained = trained_model(run, &mut task)?;
    run.task(&task, |provenance| optimize(run, trained.as_ref(), &provenance))
}

/// The model that `train` has made in this run, with its detector: of several, the one with the smallest
/// error by the first grouping. It becomes an input of the task, with the features that its classifier
/// needs. `None` if the command names a model, and if there was nothing to fit a detector to.
fn trained_model(run: &Run, task: &mut Task) -> Result<Option<Model>> {
    if run.model.is_some() {
        task.inputs.retain(|input| *input != run.path_of(Artifact::Features));
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
            task.inputs.retain(|input| *input != run.path_of(Artifact::Features));
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
    for log in run.ingested_logs()? {
        let first = maps.closures.len();
        let scans = optimize_log(run, &log, detector, &candidates, &mut maps)?;
        let closures = &maps.closures[first..];
        done.notes.extend(notes(&log, closures));
        done.summaries.push(Summary::Optimized {
            log: log.name.to_string(),
            n_accepted: closures.iter().filter(|closure| closure.is_accepted()).count() as u64,
            n_rejected: closures.iter().filter(|closure| !closure.is_accepted()).count() as u64,
            n_poses: scans.poses().len() as u64,
        });
        trajectories.push((log, scans));
    }
    let provenance = Provenance { notes: done.notes.clone(), ..provenance.clone() };
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

/// Optimizes each segment of a log. Returns the pose at every scan.
fn optimize_log(
    run: &Run,
    log: &LogFile,
    detector: &Detector,
    candidates: &[CandidateClosure],
    maps: &mut Maps,
) -> Result<Trajectory> {
    let posed = posed_scans(run, &log.name)?;
    let mut poses = Vec::new();
    for registered in registered_drives(run, &log.name)? {
        let proposals = proposals(&registered, candidates, run.detector(), detector)?;
        let drive = registered.drive();
        let min_path_m = run.config.detection().min_path_m;
        let solution = close_loops(&drive, &proposals, detector, min_path_m);
        let segment = registered.segment();
        let of_segment = posed.iter().find(|scans| scans[0].odometry.segment == segment);
        let of_segment = of_segment.map(Vec::as_slice).unwrap_or_default();
        let aligned = match run.config.optimize.every_scan {
            true => aligned_poses(run, log, &registered, &solution, of_segment)?,
            false => interpolated_poses(&registered.rows, &solution.poses, of_segment),
        };
        let stamped = of_segment.iter().zip(aligned).map(|(scan, pose)| StampedPose {
            pose,
            covariance: None,
            z_m: None,
            ..scan.odometry
        });
        poses.extend(stamped);
        maps.add(&registered.rows, &solution);
    }
    Ok(Trajectory::new(poses).0)
}

/// The candidates of a drive, with the covariance and the confidence that `detector` gives them. They were
/// found with the detector `found_with`.
fn proposals(
    registered: &RegisteredDrive,
    candidates: &[CandidateClosure],
    found_with: &Detector,
    detector: &Detector,
) -> Result<Vec<Proposal>> {
    let Some(first) = registered.rows.first() else { return Ok(Vec::new()) };
    let rows = by_scan(&registered.rows);
    let mut proposals = Vec::new();
    // Those that a detector would not have compared were found for training only.
    for CandidateClosure { closure, .. } in
        candidates.iter().filter(|candidate| candidate.rank < detector.n_candidates)
    {
        let row_of = |id: &dataset::ScanId| match id.log == first.id.log {
            true => rows.get(&id.scan).copied(),
            false => None,
        };
        // A closure of another drive.
        let (Some(query), Some(reference)) = (row_of(&closure.query), row_of(&closure.reference))
        else {
            continue;
        };
        let evidence = evidence(closure);
        proposals.push(Proposal {
            query,
            reference,
            reference_from_query: closure.reference_from_query,
            covariance: closure_covariance(
                &alignment_covariance(&matrix(closure.covariance), found_with),
                detector,
            ),
            evidence,
            confidence: detector.confidence(&evidence),
        });
    }
    Ok(proposals)
}

/// Aligns every scan of a segment with the map.
fn aligned_poses(
    run: &Run,
    log: &LogFile,
    registered: &RegisteredDrive,
    solution: &Solution,
    posed: &[PosedScan],
) -> Result<Vec<Pose2>> {
    let numbers: Vec<u32> = posed.iter().map(|scan| scan.scan).collect();
    let scans: Vec<Scan> = scans_of(&run.scans(&log.name), &numbers)?;
    let rows = by_scan(&registered.rows);
    let input: Vec<OdometryScan<'_>> = posed
        .iter()
        .zip(&scans)
        .map(|(posed, scan)| OdometryScan {
            scan,
            odometry: posed.odometry.pose,
            is_keyframe: rows.get(&posed.scan).is_some_and(|&row| registered.rows[row].is_keyframe),
        })
        .collect();
    let in_input: Vec<usize> = positions(&registered.rows, posed)
        .with_context(|| format!("log `{}`: registered scans and poses do not match", log.name))?;
    let limits = registration_limits(&run.config, &log.name)?;
    Ok(align_every_scan(&registered.drive(), &solution.poses, &in_input, &input, limits))
}

/// The index of each registered scan among all scans of its segment.
fn positions(rows: &[RegisteredScan], posed: &[PosedScan]) -> Result<Vec<usize>> {
    let index: std::collections::HashMap<u32, usize> =
        posed.iter().map(|scan| scan.scan).zip(0..).collect();
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
    /// Adds the solution of a drive as a map of its own.
    fn add(&mut self, rows: &[RegisteredScan], solution: &Solution) {
        self.closures.extend(solution.closures.iter().map(|closure| JudgedClosure {
            closure: closure_row(rows, &closure.proposal),
            rejected: closure.rejected.map(|reason| reason.code().to_owned()),
        }));
        let keyframes = rows.iter().zip(&solution.poses).zip(&solution.covariances);
        self.keyframes.extend(keyframes.filter(|((row, _), _)| row.is_keyframe).map(
            |((row, pose), covariance)| MapPose {
                id: row.id.clone(),
                stamp_ns: row.stamp_ns,
                pose: *pose,
                covariance: Some(upper_triangle(covariance)),
                is_degenerate: row.is_degenerate,
                segment: row.segment,
                travel_m: row.travel_m,
                map: self.n_maps,
            },
        ));
        self.graph.add(rows, solution);
        self.n_maps += 1;
    }
}

/// `graph.g2o`: the pose graphs of all maps.
#[derive(Default)]
struct Graph {
    n_vertices: usize,
    comments: String,
    vertices: String,
    edges: String,
}

impl Graph {
    /// Adds the graph of a drive: its vertices are the scans that have an edge.
    fn add(&mut self, rows: &[RegisteredScan], solution: &Solution) {
        let mut ids = vec![None; rows.len()];
        for &Edge { a, b, .. } in &solution.edges {
            (ids[a], ids[b]) = (Some(0), Some(0));
        }
        if let Some(first) = rows.first() {
            let _ = writeln!(
                self.comments,
                "# vertices from {}: log {}, segment {}",
                self.n_vertices, first.id.log, first.segment
            );
        }
        for (row, id) in ids.iter_mut().enumerate().filter(|(_, id)| id.is_some()) {
            *id = Some(self.n_vertices);
            let Pose2 { x_m, y_m, heading_rad } = solution.poses[row];
            let _ =
                writeln!(self.vertices, "VERTEX_SE2 {} {x_m} {y_m} {heading_rad}", self.n_vertices);
            self.n_vertices += 1;
        }
        for Edge { a, b, a_from_b, information } in &solution.edges {
            let (Some(a), Some(b)) = (ids[*a], ids[*b]) else { continue };
            let Pose2 { x_m, y_m, heading_rad } = a_from_b;
            let upper = upper_triangle(information).map(|entry| entry.to_string()).join(" ");
            let _ = writeln!(self.edges, "EDGE_SE2 {a} {b} {x_m} {y_m} {heading_rad} {upper}");
        }
    }

    /// The text of the file. docs/detection.md describes it. The comments are at the end, because GTSAM
    /// stops reading edges at a comment.
    fn text(&self) -> String {
        format!(
            "{}{}# Poses of the lidar [m, rad]. Vertices are numbered along each drive.\n{}",
            self.vertices, self.edges, self.comments
        )
    }
}

/// Poses as text, one line per pose: `stamp x y z qx qy qz qw`, in s, m and a unit quaternion.
fn tum(trajectory: &Trajectory) -> String {
    const SECOND_NS: u64 = 1_000_000_000;
    let mut text = String::new();
    for StampedPose { stamp_ns, pose, .. } in trajectory.poses() {
        let sign = if *stamp_ns < 0 { "-" } else { "" };
        let ns = stamp_ns.unsigned_abs();
        let (seconds, rest) = (ns / SECOND_NS, ns % SECOND_NS);
        let (sin, cos) = libm::sincos(pose.heading_rad / 2.0);
        let _ = writeln!(
            text,
            "{sign}{seconds}.{rest:09} {:.9} {:.9} 0 0 0 {sin:.12} {cos:.12}",
            pose.x_m, pose.y_m
        );
    }
    text
}

fn write(
    run: &Run,
    provenance: &Provenance,
    maps: &Maps,
    trajectories: &[(LogFile, Trajectory)],
) -> Result<Vec<PathBuf>> {
    let once = [Artifact::Closures, Artifact::Trajectory, Artifact::PoseGraph];
    let [closures, keyframes, graph] = once.map(|artifact| run.path_of(artifact));
    write_closures(&closures, provenance, &maps.closures)?;
    write_trajectory(&keyframes, provenance, &maps.keyframes)?;
    write_file(&graph, maps.graph.text().as_bytes())?;
    let mut outputs = vec![closures, keyframes, graph];
    for (log, trajectory) in trajectories {
        let table = run.path_of_log(Artifact::ScanTrajectory, &log.name);
        write_poses(&table, provenance, &log.name, trajectory)?;
        let text = run.path_of_log(Artifact::TumTrajectory, &log.name);
        write_file(&text, tum(trajectory).as_bytes())?;
        outputs.extend([table, text]);
    }
    Ok(outputs)
}

/// Remarks about groups of closures that were rejected.
fn notes(log: &LogFile, closures: &[JudgedClosure]) -> Option<Note> {
    let is_unsupported =
        |closure: &&JudgedClosure| closure.rejected.as_deref() == Some(Reason::Unsupported.code());
    let n_closures = closures.iter().filter(is_unsupported).count() as u64;
    let kind = NoteKind::UnsupportedClosures { n_closures };
    (0 < n_closures).then(|| Note::new(kind, Subject::log(&*log.name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter turn to the left: half of it is 45 deg, whose sine and cosine are 0.7071.
    #[test]
    fn a_trajectory_as_text_has_nanoseconds_and_quaternions() {
        let heading_rad = std::f64::consts::FRAC_PI_2;
        let pose =
            |stamp_ns| StampedPose::new(stamp_ns, Pose2 { x_m: 1.5, y_m: -2.0, heading_rad });
        let (trajectory, _) = Trajectory::new(vec![pose(1_000_000_007), pose(-1)]);
        let text = tum(&trajectory);
        let lines: Vec<&str> = text.lines().collect();
        let rest = "1.500000000 -2.000000000 0 0 0 0.707106781187 0.707106781187";
        assert_eq!(lines, [format!("-0.000000001 {rest}"), format!("1.000000007 {rest}")]);
    }
}
