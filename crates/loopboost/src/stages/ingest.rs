use anyhow::Result;
use dataset::Dropped;
use dataset::tables::scans::write_scans;
use dataset::tables::{Provenance, write_poses};
use ingest::{Log, Options};

use crate::run::{Done, LogFile, Run, Task, progress_bar};

/// Logs -> scans/LOG.parquet, poses/LOG.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let mut dropped = Dropped::default();
    for log in run.logs()? {
        let task =
            Task { stage: "ingest", log: Some(log.name.clone()), inputs: vec![log.path.clone()] };
        dropped.merge(run.task(&task, |provenance| ingest_log(run, &log, provenance))?);
    }
    Ok(dropped)
}

fn ingest_log(run: &Run, file: &LogFile, provenance: Provenance) -> Result<Done> {
    let options = run.config.for_log(&file.name)?;
    let log = Log::open(&file.path)?;
    let options = Options { lidar: options.lidar, pose: options.pose };
    let progress = progress_bar(log.bytes().len() as u64, format!("ingest {}", file.name), true);
    let (scans, poses) = (run.scans(&file.name), run.poses(&file.name));

    let ingested = write_scans(&scans, &provenance, &file.name, |writer| {
        let ingested = ingest::ingest(
            &log,
            &options,
            |scans| writer.push(scans).map_err(anyhow::Error::from),
            |position| progress.set_position(position),
        )?;
        writer.set_dropped(ingested.dropped.clone());
        anyhow::Ok(ingested)
    })?;
    progress.finish_and_clear();
    let provenance = Provenance { dropped: ingested.dropped.clone(), ..provenance };
    write_poses(&poses, &provenance, &file.name, &ingested.trajectory)?;
    let mut said = format!(
        "{}: {} scans, {} poses",
        file.name,
        ingested.n_scans,
        ingested.trajectory.poses().len()
    );
    if ingested.n_partial_turns > 0 {
        said.push_str(&format!("; {} turns cut by the log's ends", ingested.n_partial_turns));
    }
    Ok(Done { outputs: vec![scans, poses], dropped: ingested.dropped, said: vec![said] })
}
