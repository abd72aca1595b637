use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::tables::scans::{read_scan_headers, read_scans, write_scans};
use dataset::tables::{Provenance, TableError, write_poses};
use dataset::{Loss, LossKind, Losses, Note, NoteKind, Subject, Trajectory};
use ingest::{IngestError, Log, Options, PoseFileError, PoseOptions};

use crate::config::{LogOptions, usage};
use crate::findings::Findings;
use crate::logs::{LogFile, file_name};
use crate::map_run::MapRun;
use crate::run::{Done, Run, Task, missing_log, progress_bar};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;
use crate::transient::is_transient;

/// Logs -> scans/LOG.parquet, poses/LOG.parquet
///
/// A log that cannot be ingested is left out and counted as a loss. It is an error if the run is
/// strict or no log is left.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut findings = Findings::default();
    let mut failed = Vec::new();
    run.find_copies()?;
    let logs = run.logs_without_copies()?;
    let sharers = sharers(run, &logs)?;
    check_frames(run, &logs, &sharers)?;
    let map = MapRun::open(run)?;
    for log in &logs {
        match of_log(run, log, map.as_ref(), sharers.get(&*log.name).map(|other| &**other))? {
            Ok(of_log) => findings.merge(of_log),
            Err(error) => failed.push((error, log)),
        }
    }
    if failed.len() == logs.len() {
        return Err(match <[_; 1]>::try_from(failed) {
            Ok([(error, _)]) => error,
            Err(failed) => anyhow!(
                "none of the {} logs could be ingested:\n  {}",
                logs.len(),
                failed.iter().map(|(e, _)| format!("{e:#}")).collect::<Vec<_>>().join("\n  ")
            ),
        });
    }
    for (error, log) in failed {
        eprintln!("log `{}` left out of the run: {error:#}", log.name);
    }
    if !run.is_dry() {
        findings.losses.merge(run.losses_of_failed_logs()?);
    }
    Ok(findings)
}

/// The scans and poses of a log, or the reason why it is left out of the run. `sharer` is another log with the same
/// site (see [`sharers`]).
pub(crate) fn of_log(
    run: &Run,
    log: &LogFile,
    map: Option<&MapRun<'_>>,
    sharer: Option<&str>,
) -> Result<Result<Findings, anyhow::Error>> {
    if let Some(missing) = first_missing(log)? {
        let error = missing_log(missing);
        if run.strict {
            return Err(error);
        }
        if !run.is_dry() {
            run.set_failed(&log.name, Some(LOG_MISSING))?;
            return Ok(Err(error));
        }
    }
    let mut inputs = log.paths.clone();
    inputs.extend(pose_file(run, log)?);
    let map = map.filter(|_| run.is_in_pose_run(&log.name).unwrap_or(false));
    if let Some(map) = map {
        map.check_log(run, log)?;
        inputs.extend(map.inputs_of_log(&log.name));
    }
    let task = Task { stage: Stage::Ingest, log: Some(log.name.clone()), only: None, inputs };
    let ingested = match (missing_pose_file(run, log)?, map) {
        (Some(error), _) if !run.is_dry() => Err(error.into()),
        (_, Some(map)) => run.task(&task, |provenance| take_log(run, map, log, provenance)),
        _ => run.task(&task, |provenance| ingest_log(run, log, sharer, provenance)),
    };
    let ingested = ingested.and_then(|mut findings| {
        findings.merge(ingest_truth(run, log)?);
        Ok(findings)
    });
    match ingested {
        Ok(of_log) => {
            run.set_failed(&log.name, None)?;
            Ok(Ok(of_log))
        }
        // Other errors, such as a full disk, would hit the next log too. Those of the storage say nothing about the log.
        Err(error) => {
            match error.downcast_ref::<IngestError>().filter(|e| !run.strict && !is_transient(*e)) {
                Some(of_log) => {
                    run.set_failed(&log.name, Some(of_log.code()))?;
                    Ok(Err(error))
                }
                None => Err(error),
            }
        }
    }
}

/// The first file of a log that does not exist. An error of the storage does not count as such.
fn first_missing(log: &LogFile) -> Result<Option<&PathBuf>> {
    for path in &log.paths {
        if !path.try_exists().with_context(|| format!("cannot read {}", path.display()))? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// The code of a log whose file does not exist.
const LOG_MISSING: &str = "log_missing";

/// The file with the poses of a log, from `ingest.pose.file`.
fn pose_file(run: &Run, log: &LogFile) -> Result<Option<PathBuf>> {
    run.config.pose_file(&log.name)
}

/// The error for a log whose file with poses cannot be read.
fn missing_pose_file(run: &Run, log: &LogFile) -> Result<Option<IngestError>> {
    let Some(path) = pose_file(run, log)? else { return Ok(None) };
    let read = std::fs::File::open(&path).map(drop);
    Ok(read.err().map(|error| IngestError::PoseFile { path, source: PoseFileError::Read(error) }))
}

/// Refuses logs of one site whose poses are not in the map frame of the site: revisits between them
/// would be wrong.
pub(crate) fn check_frames(run: &Run, logs: &[LogFile], sharers: &Sharers) -> Result<()> {
    for log in logs {
        let Some(other) = sharers.get(&*log.name) else { continue };
        let own = run.config.for_log(&log.name)?;
        if own.pose.as_ref().is_some_and(PoseOptions::is_own_frame) {
            let why = "are fused from wheels and start in their own frame";
            return Err(own_frame(&log.name, why, &own, other, "start"));
        }
    }
    Ok(())
}

fn own_frame(log: &str, why: &str, own: &LogOptions, other: &str, key: &str) -> anyhow::Error {
    usage(format!(
        "poses of log `{log}` {why}, but log `{other}` has the same site `{}`; set [ingest.log.{log}.pose.{key}] for each of these logs, or remove `site`",
        own.site.as_deref().unwrap_or_default(),
    ))
}

/// For each log that shares its site with other logs, the first of these.
pub(crate) type Sharers = BTreeMap<String, Arc<str>>;

/// The logs that share a site, if labels depend on it that all of them have poses in one frame. Loop detection
/// finds the relation of the frames itself.
pub(crate) fn sharers(run: &Run, logs: &[LogFile]) -> Result<Sharers> {
    let mut sharers = Sharers::new();
    if !run.goal.trains() {
        return Ok(sharers);
    }
    let mut of_sites: BTreeMap<String, Vec<&Arc<str>>> = BTreeMap::new();
    for log in logs {
        if let Some(site) = run.config.for_log(&log.name)?.site {
            of_sites.entry(site).or_default().push(&log.name);
        }
    }
    for logs in of_sites.into_values().filter(|logs| 1 < logs.len()) {
        let others = std::iter::once(logs[1]).chain(std::iter::repeat(logs[0]));
        sharers
            .extend(logs.iter().zip(others).map(|(log, other)| (log.to_string(), other.clone())));
    }
    Ok(sharers)
}

fn ingest_log(
    run: &Run,
    file: &LogFile,
    sharer: Option<&str>,
    provenance: Provenance,
) -> Result<Done> {
    let own = run.config.for_log(&file.name)?;
    let mut options = Options { lidar: own.lidar.clone(), pose: own.pose.clone() };
    if let (Some(pose), Some(path)) = (&mut options.pose, pose_file(run, file)?) {
        pose.file = Some(path.to_string_lossy().into_owned());
    }
    let (logs, lost) = open(file)?;
    let n_bytes = logs.iter().map(Log::n_bytes).sum();
    let progress = progress_bar(n_bytes, format!("ingest {}", file.name), true);
    let (scans, poses) = (run.scans(&file.name), run.poses(&file.name));

    let ingested = write_scans(&scans, &provenance, &file.name, |writer| {
        let mut ingested = ingest::ingest(
            &logs.iter().collect::<Vec<_>>(),
            &options,
            |scans| writer.push(scans).map_err(anyhow::Error::from),
            |position| progress.set_position(position),
        )?;
        if let (true, Some(other)) = (ingested.is_own_frame, sharer) {
            let why = "are counted from its first satellite fix";
            return Err(own_frame(&file.name, why, &own, other, "origin"));
        }
        for path in &file.paths {
            run.check_unchanged(path)?;
        }
        ingested.losses.merge(lost);
        ingested.losses = std::mem::take(&mut ingested.losses).in_log(&file.name);
        let split = (1 < logs.len()).then(|| NoteKind::SplitDrive {
            files: logs.iter().map(|log| file_name(log.path())).collect(),
        });
        ingested.notes.extend(split.map(Note::from));
        if options.pose.is_none() {
            ingested.notes.push(NoteKind::NoPoseSource.into());
        }
        for note in &mut ingested.notes {
            note.subject.log = Some(file.name.to_string());
        }
        writer.set_findings(ingested.losses.clone(), ingested.notes.clone());
        anyhow::Ok(ingested)
    })?;
    progress.finish_and_clear();
    let (losses, notes) = (ingested.losses, ingested.notes);
    let provenance = Provenance { losses: losses.clone(), notes: notes.clone(), ..provenance };
    write_poses(&poses, &provenance, &file.name, &ingested.trajectory)?;
    let summary = Summary::Ingested {
        log: file.name.to_string(),
        n_scans: ingested.n_scans as u64,
        n_poses: ingested.trajectory.poses().len() as u64,
    };
    Ok(Done { outputs: vec![scans, poses], losses, notes, summaries: vec![summary] })
}

/// Takes the scans and the poses of a log from the map of a finished run. The scans are the same, so that they
/// are corrected for the motion of the robot with the odometry, and each has a pose.
fn take_log(run: &Run, map: &MapRun<'_>, log: &LogFile, provenance: Provenance) -> Result<Done> {
    let from = map.scans(&log.name);
    let (headers, Provenance { losses, notes, .. }) = read_scan_headers(&from)?;
    let trajectory = map.trajectory(&log.name)?;
    let (scans, poses) = (run.scans(&log.name), run.poses(&log.name));
    let provenance = Provenance { losses: losses.clone(), notes: notes.clone(), ..provenance };
    write_scans(&scans, &provenance, &log.name, |writer| {
        let all: Vec<u32> = (0..headers.len() as u32).collect();
        read_scans(&from, &all, |batch| writer.push(batch))?;
        writer.set_findings(losses.clone(), notes.clone());
        Ok::<(), TableError>(())
    })?;
    write_poses(&poses, &provenance, &log.name, &trajectory)?;
    let summary = Summary::Ingested {
        log: log.name.to_string(),
        n_scans: headers.len() as u64,
        n_poses: trajectory.poses().len() as u64,
    };
    Ok(Done { outputs: vec![scans, poses], losses, notes, summaries: vec![summary] })
}

/// The ground truth of a log -> truth/LOG.parquet, if the pipeline names it
///
/// It is a task of its own, so that scans and poses do not depend on it. A log whose ground truth cannot
/// be read has an empty table and a warning.
fn ingest_truth(run: &Run, log: &LogFile) -> Result<Findings> {
    if !run.goal.has(Artifact::Truth) {
        return Ok(Findings::default());
    }
    let (mut inputs, only) = (log.paths.clone(), Some(Artifact::Truth));
    inputs.extend(run.config.truth_file(&log.name).filter(|path| path.exists()));
    let task = Task { stage: Stage::Ingest, log: Some(log.name.clone()), only, inputs };
    run.task(&task, |provenance| {
        let own = run.config.for_log(&log.name)?;
        let mut pose = run.config.evaluate.truth.clone();
        if let (Some(pose), Some(path)) = (&mut pose, run.config.truth_file(&log.name)) {
            pose.file = Some(path.to_string_lossy().into_owned());
        }
        let (logs, _) = open(log)?;
        let options = Options { lidar: own.lidar, pose };
        let of_log = Subject::log(&*log.name);
        let logs: Vec<_> = logs.iter().collect();
        let read = ingest::read_poses(&logs, &options, || Ok::<_, IngestError>(()));
        let (trajectory, losses, mut notes) = match read {
            Ok(ingested) => {
                (ingested.trajectory, ingested.losses.in_log(&log.name), ingested.notes)
            }
            Err(error) if is_transient(&error) => return Err(error.into()),
            Err(error) => {
                let error =
                    without_folders(format!("{:#}", anyhow::Error::from(error)), &task.inputs);
                let note = NoteKind::LogWithoutTruth { error }.into();
                (Trajectory::default(), Losses::default(), vec![note])
            }
        };
        for note in &mut notes {
            note.subject.log.clone_from(&of_log.log);
        }
        let path = run.path_of_log(Artifact::Truth, &log.name);
        let provenance = Provenance { losses: losses.clone(), notes: notes.clone(), ..provenance };
        write_poses(&path, &provenance, &log.name, &trajectory)?;
        Ok(Done { outputs: vec![path], losses, notes, summaries: Vec::new() })
    })
}

/// A message in which files have no folder: tables must not depend on where the files are.
fn without_folders(message: String, files: &[PathBuf]) -> String {
    files.iter().fold(message, |message, path| {
        message.replace(&path.display().to_string(), &file_name(path))
    })
}

/// Names the format of a file that is not MCAP, and the command that reads it.
fn name_format(error: IngestError) -> IngestError {
    match error {
        IngestError::NotMcap { path, found, remedy } => match ::import::identify(&path) {
            Some(known) => IngestError::NotMcap {
                path,
                found: format!("is {} (it {found})", known.format),
                remedy: known.remedy,
            },
            None => IngestError::NotMcap { path, found, remedy },
        },
        error => error,
    }
}

/// Opens the files of a drive. If at least one can be read, the others are counted as losses.
pub(crate) fn open(file: &LogFile) -> Result<(Vec<Log>, Losses), IngestError> {
    let mut losses = Losses::default();
    let subject = |path| Subject::file(file_name(path));
    for path in &file.missing {
        losses.add(Loss::new(LossKind::MissingDriveFile, subject(path)), 1);
    }
    let mut logs = Vec::new();
    let mut first_error = None;
    for path in &file.paths {
        match Log::open(path) {
            Ok(log) => logs.push(log),
            Err(error) if is_transient(&error) => return Err(error),
            Err(error) => {
                let error = name_format(error);
                losses.add(Loss::new(LossKind::UnreadableDriveFile, subject(path)), 1);
                first_error.get_or_insert(error);
            }
        }
    }
    match first_error {
        Some(error) if logs.is_empty() => Err(error),
        _ => Ok((logs, losses)),
    }
}
