use anyhow::Result;
use dataset::Dropped;
use dataset::tables::{read_keyframes, write_pairs};

use crate::run::Run;

/// Keyframes -> pairs.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let keyframes_path = run.path("keyframes.parquet");
    let (keyframes, _) = read_keyframes(&keyframes_path)?;
    let (pairs, candidates) = label::label(&run.config.label, run.config.seed, &keyframes)?;
    let provenance = run.provenance(&run.config.label, &[keyframes_path], Dropped::default())?;
    write_pairs(&run.path("pairs.parquet"), &provenance, &keyframes, &pairs)?;
    let n = run.config.label.pairs_per_class;
    run.say(
        "label",
        format!(
            "{n} of {} positive and {n} of {} negative pairs; left out: {} ambiguous, {} near in path, {} without a common frame",
            candidates.positive,
            candidates.negative,
            candidates.ambiguous,
            candidates.near_in_path,
            candidates.without_common_frame
        ),
    );
    // What the labels leave out is no loss: it is what the options ask for.
    Ok(Dropped::default())
}
