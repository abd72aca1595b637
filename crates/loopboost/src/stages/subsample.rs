use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{Provenance, n_rows, read_poses, write_keyframes};
use dataset::{Keyframe, Loss, LossKind, Losses, Note, Subject};
use subsample::{Candidate, SubsampleError};

use crate::findings::Findings;
use crate::logs::LogFile;
use crate::partitions::remove_other_logs;
use crate::pose_choice::is_ground_truth;
use crate::run::{Done, Run, Task};
use crate::site_frames::{Start, unshared_frames};
use crate::stage::{Artifact, Stage, sites};
use crate::summary::Summary;

/// Scans and poses -> keyframes/LOG.parquet
///
/// A log without keyframes is left out and counted as a loss, for example one of a robot that stands
/// still. It is an error if the run is strict or no log is left.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let logs = run.ingested_logs()?;
    let mut findings = Findings::default();
    for log in &logs {
        findings.merge(of_log(run, log)?);
    }
    if !run.is_dry() {
        check_keyframes(run, &logs)?;
        remove_other_logs(run, Artifact::Keyframes)?;
    }
    findings.merge(check_frames(run, &logs)?);
    Ok(findings)
}

/// The keyframes of a log.
pub(crate) fn of_log(run: &Run, log: &LogFile) -> Result<Findings> {
    let task = run.task_of_log(Stage::Subsample, &log.name);
    run.task(&task, |provenance| subsample(run, log, provenance))
}

fn subsample(run: &Run, log: &LogFile, provenance: Provenance) -> Result<Done> {
    let mut done = Done::default();
    let keyframes = match keyframes_of(run, log)? {
        Ok((keyframes, losses)) => {
            done.losses = losses.in_log(&log.name);
            done.summaries.push(Summary::Subsampled {
                log: log.name.to_string(),
                n_keyframes: keyframes.len() as u64,
                length_m: keyframes.last().map_or(0.0, |k| k.travel_m),
            });
            keyframes
        }
        Err(error) => match error.code().filter(|_| !run.strict) {
            Some(code) => {
                eprintln!("log `{}` left out of the run: {error}", log.name);
                let kind = LossKind::LogLeftOut { error: code.to_owned() };
                done.losses.add(Loss::new(kind, Subject::log(&*log.name)), 1);
                Vec::new()
            }
            None => return Err(error.into()),
        },
    };
    let path = run.path_of_log(Artifact::Keyframes, &log.name);
    write_keyframes(&path, &Provenance { losses: done.losses.clone(), ..provenance }, &keyframes)?;
    done.outputs.push(path);
    Ok(done)
}

/// It is an error if no log has keyframes.
fn check_keyframes(run: &Run, logs: &[LogFile]) -> Result<()> {
    if logs.is_empty() {
        return Err(anyhow!(
            "none of the logs could be ingested, so there are no keyframes to select; correct the problem of at least one log, and run `ingest` again"
        ));
    }
    let mut failed = Vec::new();
    for log in logs {
        if 0 < n_rows(&run.path_of_log(Artifact::Keyframes, &log.name))? {
            return Ok(());
        }
        failed.extend(keyframes_of(run, log)?.err());
    }
    Err(match <[_; 1]>::try_from(failed) {
        Ok([error]) => error.into(),
        Err(failed) => anyhow!(
            "none of the {} logs has keyframes:\n  {}",
            logs.len(),
            failed.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  ")
        ),
    })
}

/// Remarks about logs of one site that may not share a map frame. They need the poses of all logs.
fn check_frames(run: &Run, logs: &[LogFile]) -> Result<Findings> {
    let task = Task { only: Some(Artifact::Keyframes), ..run.task_of(Stage::Subsample)? };
    run.task(&task, |_| {
        let names: Vec<&str> = logs.iter().map(|log| &*log.name).collect();
        let mut starts: BTreeMap<String, Vec<Start>> = BTreeMap::new();
        for (log, site) in sites(&run.config, &names)? {
            starts.entry(site).or_default().extend(shared_start(run, &log)?);
        }
        let notes = unshared_frames(&starts).into_iter().map(Note::from).collect();
        Ok(Done { notes, ..Done::default() })
    })
}

/// Where the trajectory of a log starts. `None` if its map frame is known: the pipeline states it, or the
/// poses are ground truth or those of a map. Only labels need it, loop detection does not.
fn shared_start(run: &Run, log: &str) -> Result<Option<Start>> {
    let is_known = run.config.for_log(log)?.pose.is_some_and(|pose| {
        if pose.run.is_some() {
            return true;
        }
        let is_truth = pose.topic.as_deref().is_some_and(is_ground_truth);
        is_truth || pose.start.is_some() || pose.origin.is_some()
    });
    if is_known || !run.goal.trains() {
        return Ok(None);
    }
    let (trajectory, _) = read_poses(&run.poses(log))?;
    Ok(Start::of(log, &trajectory))
}

/// The keyframes of a log, or why it has none.
fn keyframes_of(
    run: &Run,
    log: &LogFile,
) -> Result<Result<(Vec<Keyframe>, Losses), SubsampleError>> {
    let (trajectory, _) = read_poses(&run.poses(&log.name))?;
    let site = sites(&run.config, &[&log.name])?.remove(&*log.name).unwrap_or_default();
    let site: Arc<str> = site.into();
    let (headers, _) = read_scan_headers(&run.scans(&log.name))?;
    let candidates: Vec<Candidate> = headers
        .iter()
        .zip(0..)
        .map(|(header, scan)| Candidate {
            scan,
            stamp_ns: header.stamp_ns,
            coverage_deg: header.coverage_deg,
            usable: header.usable,
        })
        .collect();
    let options = &run.config.subsample;
    let subsampled = subsample::subsample(options, &log.name, &site, &candidates, &trajectory);
    let is_in_map = run.is_in_pose_run(&log.name)?;
    Ok(subsampled.map(|(mut keyframes, losses)| {
        for keyframe in keyframes.iter_mut().filter(|_| is_in_map) {
            keyframe.map = Some(keyframe.frame);
        }
        (keyframes, losses)
    }))
}
