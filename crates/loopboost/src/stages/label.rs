use anyhow::Result;
use dataset::Dropped;
use dataset::tables::{Provenance, read_keyframes, write_pairs};

use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};

/// Keyframes -> pairs.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    run.task(&run.task_of(Stage::Label)?, |provenance| label(run, &provenance))
}

fn label(run: &Run, provenance: &Provenance) -> Result<Done> {
    let (keyframes, _) = read_keyframes(&run.path_of(Artifact::Keyframes))?;
    let (pairs, candidates) = label::label(&run.config.label, run.config.seed, &keyframes)?;
    let path = run.path_of(Artifact::Pairs);
    write_pairs(&path, provenance, &keyframes, &pairs)?;
    let n = run.config.label.pairs_per_class;
    let said = format!(
        "{n} of {} positive and {n} of {} negative pairs; left out: {} ambiguous, {} too close along the path, {} without a common frame",
        candidates.positive,
        candidates.negative,
        candidates.ambiguous,
        candidates.short_travel_gap,
        candidates.without_common_frame
    );
    // What the labels leave out is no loss: it is what the options ask for.
    Ok(Done { outputs: vec![path], said: vec![said], ..Done::default() })
}
