use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use dataset::tables::scans::read_scans;
use dataset::tables::{
    FeatureTable, Provenance, TableError, read_keyframes, write_feature_stability, write_features,
};
use dataset::{Keyframe, Scan, ScanId, Unusable};
use featurize::Featurizer;
use rayon::prelude::*;

use crate::findings::Findings;
use crate::partitions::{self, remove_other_logs};
use crate::run::{Done, Run, Task};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Number of scans that the stability of the features is measured on; enough for a median.
const STABILITY_SCANS: usize = 1000;

/// Keyframes -> features/LOG.parquet, feature_stability.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut findings = Findings::default();
    for log in run.ingested_logs()? {
        findings.merge(of_log(run, &log.name)?);
    }
    remove_other_logs(run, Artifact::Features)?;
    // An even sample of the scans of all logs.
    let only = Some(Artifact::FeatureStability);
    let task = Task { only, ..run.task_of(Stage::Featurize)? };
    findings.merge(run.task(&task, |provenance| stability(run, &provenance))?);
    Ok(findings)
}

/// The features of the keyframes of a log.
pub(crate) fn of_log(run: &Run, log: &Arc<str>) -> Result<Findings> {
    let only = Some(Artifact::Features);
    let task = Task { only, ..run.task_of_log(Stage::Featurize, log) };
    run.task(&task, |provenance| featurize(run, log, &provenance))
}

fn featurize(run: &Run, log: &str, provenance: &Provenance) -> Result<Done> {
    let options = &run.config.featurize;
    let (keyframes, _) = read_keyframes(&run.path_of_log(Artifact::Keyframes, log))?;
    check_one_kind_of_scan(&keyframes)?;
    let names = options.set.feature_names();
    let mut values = vec![0.0; keyframes.len() * names.len()];
    let path = run.scans(log);
    // Keyframes are sorted by time, but scans are read in the order of the log.
    let mut rows: Vec<(u32, usize)> = keyframes.iter().map(|k| k.id.scan).zip(0..).collect();
    rows.sort_unstable();
    let scans: Vec<u32> = rows.iter().map(|&(scan, _)| scan).collect();
    let mut rows = rows.iter();
    read_scans(&path, &scans, |batch| {
        let features = features_of(options, &batch)
            .with_context(|| format!("{}: a keyframe has no features", path.display()))?;
        for (features, &(_, row)) in features.iter().zip(&mut rows) {
            values[row * names.len()..][..names.len()].copy_from_slice(features);
        }
        anyhow::Ok(())
    })?;
    let table = FeatureTable {
        names: names.iter().map(|&name| name.to_owned()).collect(),
        ids: keyframes.iter().map(|k| k.id.clone()).collect(),
        values,
    };
    let output = run.path_of_log(Artifact::Features, log);
    write_features(&output, provenance, &table)?;
    let summary = Summary::Featurized {
        log: log.to_owned(),
        set: options.set.name().to_owned(),
        n_features: names.len() as u64,
        n_keyframes: keyframes.len() as u64,
    };
    Ok(Done { outputs: vec![output], summaries: vec![summary], ..Done::default() })
}

/// How stable the features are, from an even sample of the scans of all keyframes.
fn stability(run: &Run, provenance: &Provenance) -> Result<Done> {
    let options = &run.config.featurize;
    let keyframes = partitions::keyframes(run)?;
    check_one_kind_of_scan(&keyframes)?;
    let every = keyframes.len().div_ceil(STABILITY_SCANS).max(1);
    let sampled: Vec<&ScanId> = keyframes.iter().step_by(every).map(|k| &k.id).collect();
    let mut sample = Vec::new();
    for of_log in sampled.chunk_by(|a, b| a.log == b.log) {
        let mut scans: Vec<u32> = of_log.iter().map(|id| id.scan).collect();
        scans.sort_unstable();
        read_scans(&run.scans(&of_log[0].log), &scans, |batch| {
            sample.extend(batch);
            Ok::<(), TableError>(())
        })?;
    }
    let stability = featurize::stability(options, &sample);
    let names: Vec<String> =
        options.set.feature_names().iter().map(|&name| name.to_owned()).collect();
    let output = run.path_of(Artifact::FeatureStability);
    write_feature_stability(&output, provenance, &names, &stability)?;
    Ok(Done { outputs: vec![output], ..Done::default() })
}

/// The features of each scan.
fn features_of(options: &featurize::Options, scans: &[Scan]) -> Result<Vec<Vec<f64>>, Unusable> {
    let n_features = options.set.feature_names().len();
    let compute = |featurizer: &mut Featurizer, scan: &Scan| {
        let mut features = vec![0.0; n_features];
        featurizer.features(scan, &mut features).map(|()| features)
    };
    let features: Vec<_> =
        scans.par_iter().map_init(|| Featurizer::new(options), compute).collect();
    // If several scans fail, report the first one in the log, not the first one in time.
    features.into_iter().collect()
}

/// The features of a full circle cannot be compared with those of a part of it.
pub(crate) fn check_one_kind_of_scan(keyframes: &[Keyframe]) -> Result<()> {
    let is_ring = |k: &&Keyframe| dataset::FULL_RING_DEG <= k.coverage_deg;
    let ring = keyframes.iter().find(is_ring);
    let open = keyframes.iter().find(|k| !is_ring(k));
    match (ring, open) {
        (Some(ring), Some(open)) => Err(anyhow!(
            "the logs have two kinds of scans, whose features cannot be compared: the scans of log `{}` cover {} deg, those of log `{}` cover {} deg; write one pipeline for each kind",
            ring.id.log,
            ring.coverage_deg,
            open.id.log,
            open.coverage_deg
        )),
        _ => Ok(()),
    }
}
