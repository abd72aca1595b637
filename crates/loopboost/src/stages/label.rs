use anyhow::Result;
use dataset::tables::{Provenance, write_pairs};

use crate::findings::Findings;
use crate::labelled::labelled_keyframes;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Keyframes, ground truth -> pairs.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    run.task(&run.task_of(Stage::Label)?, |provenance| label(run, &provenance))
}

fn label(run: &Run, provenance: &Provenance) -> Result<Done> {
    let (keyframes, mut notes) = labelled_keyframes(run)?;
    let labelled = label::label(&run.config.label, run.config.seed, &keyframes)?;
    let label::Labelled { pairs, candidates, notes: of_pairs } = labelled;
    notes.extend(of_pairs);
    let path = run.path_of(Artifact::Pairs);
    let provenance = Provenance { notes: notes.clone(), ..provenance.clone() };
    write_pairs(&path, &provenance, &keyframes, &pairs)?;
    let n_pairs_per_class = run.config.label.pairs_per_class as u64;
    let summary = Summary::Labelled { n_pairs_per_class, candidates };
    // Pairs that the label rules leave out are not losses: the options ask for it.
    Ok(Done { outputs: vec![path], notes, summaries: vec![summary], ..Done::default() })
}
