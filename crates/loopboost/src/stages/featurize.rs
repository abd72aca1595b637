use anyhow::{Context, Result, anyhow};
use dataset::tables::scans::read_scans;
use dataset::tables::{FeatureTable, Provenance, read_keyframes, write_features};
use dataset::{Dropped, Keyframe};
use featurize::Featurizer;
use rayon::prelude::*;

use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};

/// Keyframes -> features.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    run.task(&run.task_of(Stage::Featurize)?, |provenance| featurize(run, &provenance))
}

fn featurize(run: &Run, provenance: &Provenance) -> Result<Done> {
    let options = &run.config.featurize;
    let (keyframes, _) = read_keyframes(&run.path_of(Artifact::Keyframes))?;
    check_one_kind_of_scan(&keyframes)?;
    let names = options.set.feature_names();
    let mut values = vec![0.0; keyframes.len() * names.len()];
    let mut first = 0;
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        let path = run.scans(&of_log[0].id.log);
        // Keyframes are in order of time, rows of the table in order of the log.
        let mut rows: Vec<(u32, usize)> = of_log.iter().map(|k| k.id.scan).zip(first..).collect();
        first += of_log.len();
        rows.sort_unstable();
        let scans: Vec<u32> = rows.iter().map(|&(scan, _)| scan).collect();
        let mut rows = rows.iter();
        read_scans(&path, &scans, |batch| {
            let features = batch
                .par_iter()
                .map_init(
                    || Featurizer::new(options),
                    |featurizer, scan| {
                        let mut features = vec![0.0; names.len()];
                        featurizer.features(scan, &mut features).map(|()| features)
                    },
                )
                .collect::<Vec<_>>()
                .into_iter()
                .collect::<Result<Vec<_>, _>>()
                .with_context(|| format!("{}: a keyframe has no features", path.display()))?;
            for (features, &(_, row)) in features.iter().zip(&mut rows) {
                values[row * names.len()..][..names.len()].copy_from_slice(features);
            }
            anyhow::Ok(())
        })?;
    }
    let table = FeatureTable {
        names: names.iter().map(|&name| name.to_owned()).collect(),
        ids: keyframes.iter().map(|k| k.id.clone()).collect(),
        values,
    };
    let path = run.path_of(Artifact::Features);
    write_features(&path, provenance, &table)?;
    let said = format!(
        "{} features ({}) of {} keyframes",
        names.len(),
        options.set.name(),
        keyframes.len()
    );
    Ok(Done { outputs: vec![path], said: vec![said], ..Done::default() })
}

/// Features of a ring and of a part of the circle do not compare.
fn check_one_kind_of_scan(keyframes: &[Keyframe]) -> Result<()> {
    let is_ring = |k: &&Keyframe| dataset::FULL_RING_DEG <= k.coverage_deg;
    let ring = keyframes.iter().find(is_ring);
    let open = keyframes.iter().find(|k| !is_ring(k));
    match (ring, open) {
        (Some(ring), Some(open)) => Err(anyhow!(
            "scans of two kinds in one run: log `{}` has full rings ({} deg), log `{}` scans of {} deg; their features do not compare: make a pipeline for each",
            ring.id.log,
            ring.coverage_deg,
            open.id.log,
            open.coverage_deg
        )),
        _ => Ok(()),
    }
}
