use std::path::Path;

use anyhow::{Result, anyhow};
use dataset::tables::scans::write_scans;
use dataset::tables::{Provenance, write_poses};
use dataset::{Dropped, Loss, LossKind, Losses, Subject};
use ingest::{IngestError, Log, Options, PoseOptions};

use crate::config::{LogOptions, usage};
use crate::logs::{LogFile, file_name};
use crate::run::{Done, Run, Task, missing_log, progress_bar};
use crate::stage::Stage;

/// Logs -> scans/LOG.parquet, poses/LOG.parquet
///
/// A log that cannot be ingested is named and left out, and the others are done, unless the run is
/// strict or no log is left.
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let mut dropped = Dropped::default();
    let mut failed = Vec::new();
    let logs = run.logs()?;
    check_frames(run, logs)?;
    for log in logs {
        if let Some(missing) = log.paths.iter().find(|path| !path.exists()) {
            let error = missing_log(missing);
            if run.strict {
                return Err(error);
            }
            if !run.is_dry() {
                run.set_failed(&log.name, Some(error.to_string()))?;
                failed.push((error, log));
                continue;
            }
        }
        let task =
            Task { stage: Stage::Ingest, log: Some(log.name.clone()), inputs: log.paths.clone() };
        match run.task(&task, |provenance| ingest_log(run, log, provenance)) {
            Ok(of_log) => {
                run.set_failed(&log.name, None)?;
                dropped.merge(of_log);
            }
            // Whatever else goes wrong, such as a full disk, goes wrong for the next log too.
            Err(error) if error.is::<IngestError>() && !run.strict => {
                run.set_failed(&log.name, Some(format!("{error:#}")))?;
                failed.push((error, log));
            }
            Err(error) => return Err(error),
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
        dropped.add(format!("log left out of the run, `{}`: {error:#}", log.name), 1);
    }
    Ok(dropped)
}

/// Refuses logs of one site whose poses are not in the site's map frame: revisits between them would
/// be made up.
fn check_frames(run: &Run, logs: &[LogFile]) -> Result<()> {
    for log in logs {
        let own = run.config.for_log(&log.name)?;
        if own.pose.as_ref().is_some_and(PoseOptions::is_own_frame)
            && let Some(other) = sharer(run, &log.name, &own)?
        {
            let why = "are fused from wheels and start in a frame of their own";
            return Err(own_frame(&log.name, why, &own, other, "start"));
        }
    }
    Ok(())
}

fn own_frame(log: &str, why: &str, own: &LogOptions, other: &str, key: &str) -> anyhow::Error {
    usage(format!(
        "poses of log `{log}` {why}, but its site `{}` is that of `{other}` too; give each such log its [ingest.log.{log}.pose.{key}], or take `site` away",
        own.site.as_deref().unwrap_or_default(),
    ))
}

/// Another log of the site of this one.
fn sharer<'a>(run: &'a Run, name: &str, own: &LogOptions) -> Result<Option<&'a str>> {
    for other in run.logs()? {
        if *other.name != *name
            && own.site.is_some()
            && run.config.for_log(&other.name)?.site == own.site
        {
            return Ok(Some(&other.name));
        }
    }
    Ok(None)
}

fn ingest_log(run: &Run, file: &LogFile, provenance: Provenance) -> Result<Done> {
    let own = run.config.for_log(&file.name)?;
    let sharer = sharer(run, &file.name, &own)?;
    let options = Options { lidar: own.lidar.clone(), pose: own.pose.clone() };
    let (logs, lost) = open(file)?;
    let n_bytes: usize = logs.iter().map(|log| log.bytes().len()).sum();
    let progress = progress_bar(n_bytes as u64, format!("ingest {}", file.name), true);
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
        ingested.losses.merge(lost);
        writer.set_dropped(ingested.losses.clone().into());
        anyhow::Ok(ingested)
    })?;
    progress.finish_and_clear();
    let dropped = Dropped::from(ingested.losses);
    let provenance = Provenance { dropped: dropped.clone(), ..provenance };
    write_poses(&poses, &provenance, &file.name, &ingested.trajectory)?;
    let n_poses = ingested.trajectory.poses().len();
    let mut said = format!("{}: {} scans, {n_poses} poses", file.name, ingested.n_scans);
    if let n_files @ 2.. = logs.len() {
        let names: Vec<String> = logs.iter().map(|log| file_name(log.path())).collect();
        said.push_str(&format!("; from {n_files} files of one drive: {}", names.join(", ")));
    }
    for note in &ingested.notes {
        said.push_str(&format!("; {note}"));
    }
    Ok(Done { outputs: vec![scans, poses], dropped, said: vec![said] })
}

/// Opens the files of a drive. If at least one can be read, the others are counted as losses.
pub(crate) fn open(file: &LogFile) -> Result<(Vec<Log>, Losses), IngestError> {
    let mut losses = Losses::default();
    let subject = |path: &Path| Subject::file(path.display().to_string());
    for path in &file.missing {
        losses.add(Loss::new(LossKind::MissingDriveFile, subject(path)), 1);
    }
    let mut logs = Vec::new();
    let mut first_error = None;
    for path in &file.paths {
        match Log::open(path) {
            Ok(log) => logs.push(log),
            Err(error) => {
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
