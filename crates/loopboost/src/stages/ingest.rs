use anyhow::Result;
use dataset::Dropped;
use dataset::tables::scans::write_scans;
use dataset::tables::write_poses;
use ingest::{Log, Options};

use crate::run::{LogFile, Run, progress_bar};

/// Logs -> scans/LOG.parquet, poses/LOG.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let mut dropped = Dropped::default();
    for log in run.logs()? {
        dropped.merge(ingest_log(run, &log)?);
    }
    Ok(dropped)
}

fn ingest_log(run: &Run, file: &LogFile) -> Result<Dropped> {
    let options = run.config.for_log(&file.name)?;
    let log = Log::open(&file.path)?;
    let provenance =
        run.provenance(&options, std::slice::from_ref(&file.path), Dropped::default())?;
    let options = Options { lidar: options.lidar, pose: options.pose };
    let progress = progress_bar(log.bytes().len() as u64, format!("ingest {}", file.name), true);

    let ingested = write_scans(&run.scans(&file.name), &provenance, &file.name, |writer| {
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
    write_poses(&run.poses(&file.name), &provenance, &file.name, &ingested.trajectory)?;
    run.say(
        "ingest",
        format!(
            "{}: {} scans, {} poses",
            file.name,
            ingested.n_scans,
            ingested.trajectory.poses().len()
        ),
    );
    Ok(ingested.dropped)
}
