use std::sync::Arc;

use anyhow::Result;
use dataset::Dropped;
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{read_poses, write_keyframes};
use subsample::Candidate;

use crate::run::Run;

/// Scans and poses -> keyframes.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let mut keyframes = Vec::new();
    let mut dropped = Dropped::default();
    let mut inputs = Vec::new();
    for log in run.logs()? {
        let site: Arc<str> =
            run.config.for_log(&log.name)?.site.map_or(log.name.clone(), Arc::from);
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
        let (of_log, dropped_of_log) = subsample::subsample(
            &run.config.subsample,
            &log.name,
            &site,
            &candidates,
            &trajectory,
        )?;
        run.say(
            "subsample",
            format!(
                "{}: {} keyframes along {:.0} m",
                log.name,
                of_log.len(),
                of_log.last().map_or(0.0, |k| k.travel_m)
            ),
        );
        keyframes.extend(of_log);
        dropped.merge(dropped_of_log);
        inputs.extend([run.scans(&log.name), run.poses(&log.name)]);
    }
    let provenance = run.provenance(&run.config.subsample, &inputs, dropped.clone())?;
    write_keyframes(&run.path("keyframes.parquet"), &provenance, &keyframes)?;
    Ok(dropped)
}
