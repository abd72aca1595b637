use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{Provenance, read_poses, write_keyframes};
use dataset::{Keyframe, Loss, LossKind, Losses, Note, Subject, Trajectory};
use subsample::{Candidate, SubsampleError};

use crate::findings::Findings;
use crate::logs::LogFile;
use crate::pose_choice::is_ground_truth;
use crate::run::{Done, Run};
use crate::site_frames::{Start, unshared_frames};
use crate::stage::{Artifact, Stage, sites};
use crate::summary::Summary;

/// Scans and poses -> keyframes.parquet
///
/// A log without keyframes is left out and counted as a loss, for example one of a robot that stands
/// still. It is an error if the run is strict or no log is left.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let logs = run.ingested_logs()?;
    run.task(&run.task_of(Stage::Subsample)?, |provenance| subsample(run, &logs, provenance))
}

fn subsample(run: &Run, logs: &[LogFile], provenance: Provenance) -> Result<Done> {
    let names: Vec<&str> = logs.iter().map(|log| &*log.name).collect();
    let sites = sites(&run.config, &names)?;
    let mut done = Done::default();
    let mut keyframes = Vec::new();
    let mut failed: Vec<(SubsampleError, &str, &LogFile)> = Vec::new();
    let mut starts: BTreeMap<String, Vec<Start>> = BTreeMap::new();
    for log in logs {
        let (trajectory, _) = read_poses(&run.poses(&log.name))?;
        let site: Arc<str> = sites[&*log.name].as_str().into();
        match keyframes_of(run, log, &site, &trajectory)? {
            Ok((mut of_log, losses)) => {
                if run.is_in_pose_run(&log.name)? {
                    of_log.iter_mut().for_each(|keyframe| keyframe.map = Some(keyframe.frame));
                }
                starts.entry(site.to_string()).or_default().extend(shared_start(
                    run,
                    &log.name,
                    &trajectory,
                )?);
                done.summaries.push(Summary::Subsampled {
                    log: log.name.to_string(),
                    n_keyframes: of_log.len() as u64,
                    length_m: of_log.last().map_or(0.0, |k| k.travel_m),
                });
                keyframes.extend(of_log);
                done.losses.merge(losses.in_log(&log.name));
            }
            Err(error) => match error.code().filter(|_| !run.strict) {
                Some(code) => failed.push((error, code, log)),
                None => return Err(error.into()),
            },
        }
    }
    if logs.is_empty() {
        return Err(anyhow!(
            "none of the logs could be ingested, so there are no keyframes to select; correct the problem of at least one log, and run `ingest` again"
        ));
    }
    if failed.len() == logs.len() {
        return Err(match <[_; 1]>::try_from(failed) {
            Ok([(error, ..)]) => error.into(),
            Err(failed) => anyhow!(
                "none of the {} logs has keyframes:\n  {}",
                logs.len(),
                failed.iter().map(|(e, ..)| e.to_string()).collect::<Vec<_>>().join("\n  ")
            ),
        });
    }
    for (error, code, log) in &failed {
        eprintln!("log `{}` left out of the run: {error}", log.name);
        let kind = LossKind::LogLeftOut { error: (*code).to_owned() };
        done.losses.add(Loss::new(kind, Subject::log(&*log.name)), 1);
    }
    done.notes = unshared_frames(&starts).into_iter().map(Note::from).collect();
    let path = run.path_of(Artifact::Keyframes);
    let (losses, notes) = (done.losses.clone(), done.notes.clone());
    write_keyframes(&path, &Provenance { losses, notes, ..provenance }, &keyframes)?;
    done.outputs.push(path);
    Ok(done)
}

/// Where the trajectory of a log starts. `None` if its map frame is known: the pipeline states it, or the
/// poses are ground truth or those of a map. Only labels need it, loop detection does not.
fn shared_start(run: &Run, log: &str, trajectory: &Trajectory) -> Result<Option<Start>> {
    let is_known = run.config.for_log(log)?.pose.is_some_and(|pose| {
        if pose.run.is_some() {
            return true;
        }
        let is_truth = pose.topic.as_deref().is_some_and(is_ground_truth);
        is_truth || pose.start.is_some() || pose.origin.is_some()
    });
    let is_known = is_known || !run.goal.trains();
    Ok(Start::of(log, trajectory).filter(|_| !is_known))
}

/// The keyframes of a log, or why it has none.
fn keyframes_of(
    run: &Run,
    log: &LogFile,
    site: &Arc<str>,
    trajectory: &Trajectory,
) -> Result<Result<(Vec<Keyframe>, Losses), SubsampleError>> {
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
    Ok(subsample::subsample(options, &log.name, site, &candidates, trajectory))
}
