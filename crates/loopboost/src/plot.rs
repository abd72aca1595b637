//! `inspect --plot`: draws the path of a log from its suggested pipeline.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::Note;
use dataset::tables::write_file;
use ingest::{Log, Options};
use subsample::Candidate;

use crate::config::Config;
use crate::run::progress_bar;

/// Draws poses, their uncertainty, and the keyframes. Returns the notes about the poses.
pub(crate) fn plot(file: &Path, name: &str, logs: &[Log], pipeline: &str) -> Result<Vec<Note>> {
    if file.extension().is_none_or(|extension| extension != "svg") {
        return Err(anyhow!(
            "--plot is {}, expected a file name that ends in .svg",
            file.display()
        ));
    }
    let config: Config = toml::from_str(pipeline).context("cannot parse the suggested pipeline")?;
    let options = config.for_log(name)?;
    let options = Options { lidar: options.lidar, pose: options.pose };
    let mut candidates = Vec::new();
    let n_bytes: usize = logs.iter().map(|log| log.bytes().len()).sum();
    let progress = progress_bar(n_bytes as u64, format!("plot {name}"), true);
    let ingested = ingest::ingest(
        &logs.iter().collect::<Vec<_>>(),
        &options,
        |scans| {
            candidates.extend(
                scans
                    .iter()
                    .zip(candidates.len() as u32..)
                    .map(|(scan, number)| Candidate {
                        scan: number,
                        stamp_ns: scan.stamp_ns,
                        coverage_deg: scan.coverage_deg,
                        usable: scan.check_usable().is_ok(),
                    })
                    .collect::<Vec<_>>(),
            );
            anyhow::Ok(())
        },
        |position| progress.set_position(position),
    )?;
    progress.finish_and_clear();
    let log: Arc<str> = name.into();
    let trajectory = &ingested.trajectory;
    let (kept, _) = subsample::subsample(&config.subsample, &log, &log, &candidates, trajectory)?;
    write_file(file, evaluate::path_svg(name, trajectory.poses(), &kept).as_bytes())?;
    Ok(ingested.notes)
}
