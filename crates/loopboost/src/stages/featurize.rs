use anyhow::{Context, Result, anyhow};
use dataset::tables::scans::read_scans;
use dataset::tables::{
    FeatureTable, Provenance, read_keyframes, write_feature_stability, write_features,
};
use dataset::{Keyframe, Scan, Unusable};
use featurize::Featurizer;
use rayon::prelude::*;

use crate::findings::Findings;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Number of scans that the stability of the features is measured on; enough for a median.
const STABILITY_SCANS: usize = 1000;

/// Keyframes -> features.parquet, feature_stability.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    run.task(&run.task_of(Stage::Featurize)?, |provenance| featurize(run, &provenance))
}

fn featurize(run: &Run, provenance: &Provenance) -> Result<Done> {
    let options = &run.config.featurize;
    let (keyframes, _) = read_keyframes(&run.path_of(Artifact::Keyframes))?;
    check_one_kind_of_scan(&keyframes)?;
    let (table, sample) = compute(run, &keyframes)?;
    let stability = featurize::stability(options, &sample);

    let outputs = [Artifact::Features, Artifact::FeatureStability].map(|table| run.path_of(table));
    write_features(&outputs[0], provenance, &table)?;
    write_feature_stability(&outputs[1], provenance, &table.names, &stability)?;
    let summary = Summary::Featurized {
        set: options.set.name().to_owned(),
        n_features: table.names.len() as u64,
        n_keyframes: keyframes.len() as u64,
    };
    Ok(Done { outputs: outputs.into(), summaries: vec![summary], ..Done::default() })
}

/// The features of all keyframes, and an even sample of their scans.
fn compute(run: &Run, keyframes: &[Keyframe]) -> Result<(FeatureTable, Vec<Scan>)> {
    let names = run.config.featurize.set.feature_names();
    let mut values = vec![0.0; keyframes.len() * names.len()];
    let every = keyframes.len().div_ceil(STABILITY_SCANS).max(1);
    let mut sample = Vec::new();
    let mut first = 0;
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        let path = run.scans(&of_log[0].id.log);
        // Keyframes are sorted by time, but scans are read in the order of the log.
        let mut rows: Vec<(u32, usize)> = of_log.iter().map(|k| k.id.scan).zip(first..).collect();
        first += of_log.len();
        rows.sort_unstable();
        let scans: Vec<u32> = rows.iter().map(|&(scan, _)| scan).collect();
        let mut rows = rows.iter();
        read_scans(&path, &scans, |batch| {
            let features = features_of(&run.config.featurize, &batch)
                .with_context(|| format!("{}: a keyframe has no features", path.display()))?;
            for ((scan, features), &(_, row)) in batch.iter().zip(&features).zip(&mut rows) {
                values[row * names.len()..][..names.len()].copy_from_slice(features);
                if row.is_multiple_of(every) {
                    sample.push(scan.clone());
                }
            }
            anyhow::Ok(())
        })?;
    }
    let table = FeatureTable {
        names: names.iter().map(|&name| name.to_owned()).collect(),
        ids: keyframes.iter().map(|k| k.id.clone()).collect(),
        values,
    };
    Ok((table, sample))
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
