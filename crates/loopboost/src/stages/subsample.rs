use std::sync::Arc;

use anyhow::Result;
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{Provenance, read_poses, write_keyframes};
use subsample::Candidate;

use crate::findings::Findings;
use crate::logs::LogFile;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage, sites};
use crate::summary::Summary;

/// Scans and poses -> keyframes.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let logs = run.ingested_logs()?;
    run.task(&run.task_of(Stage::Subsample)?, |provenance| subsample(run, &logs, provenance))
}

fn subsample(run: &Run, logs: &[LogFile], provenance: Provenance) -> Result<Done> {
    let names: Vec<&str> = logs.iter().map(|log| &*log.name).collect();
    let sites = sites(&run.config, &names)?;
    let mut done = Done::default();
    let mut keyframes = Vec::new();
    for log in logs {
        let (headers, _) = read_scan_headers(&run.scans(&log.name))?;
        let (trajectory, _) = read_poses(&run.poses(&log.name))?;
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
        let site: Arc<str> = sites[&*log.name].as_str().into();
        let (of_log, losses) = subsample::subsample(
            &run.config.subsample,
            &log.name,
            &site,
            &candidates,
            &trajectory,
        )?;
        done.summaries.push(Summary::Subsampled {
            log: log.name.to_string(),
            n_keyframes: of_log.len() as u64,
            length_m: of_log.last().map_or(0.0, |k| k.travel_m),
        });
        keyframes.extend(of_log);
        done.losses.merge(losses.in_log(&log.name));
    }
    let path = run.path_of(Artifact::Keyframes);
    write_keyframes(&path, &Provenance { losses: done.losses.clone(), ..provenance }, &keyframes)?;
    done.outputs.push(path);
    Ok(done)
}
