use anyhow::Result;
use dataset::tables::{Provenance, write_pairs};

use crate::findings::Findings;
use crate::labelled::labelled_keyframes;
use crate::map_run::MapRun;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Keyframes, ground truth, pose graph of a finished run -> pairs.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let map = MapRun::open(run)?;
    let mut task = run.task_of(Stage::Label)?;
    if let Some(map) = &map {
        let mut in_map = Vec::new();
        for log in run.ingested_logs()? {
            if run.is_in_pose_run(&log.name)? {
                task.inputs.retain(|input| *input != run.path_of_log(Artifact::Truth, &log.name));
                in_map.push(log);
            }
        }
        task.inputs.extend(map.inputs_of_graph(&in_map));
    }
    run.task(&task, |provenance| label(run, map.as_ref(), &provenance))
}

fn label(run: &Run, map: Option<&MapRun<'_>>, provenance: &Provenance) -> Result<Done> {
    let (keyframes, mut notes) = labelled_keyframes(run)?;
    let (options, seed) = (&run.config.label, run.config.seed);
    let labelled = match map {
        Some(map) => {
            notes.extend(map.notes(&keyframes)?);
            label::label_by_graph(options, seed, &keyframes, &map.graph(&keyframes)?)?
        }
        None => label::label(options, seed, &keyframes)?,
    };
    let label::Labelled { pairs, candidates, notes: of_pairs } = labelled;
    notes.extend(of_pairs);
    let path = run.path_of(Artifact::Pairs);
    let provenance = Provenance { notes: notes.clone(), ..provenance.clone() };
    write_pairs(&path, &provenance, &keyframes, &pairs)?;
    let n_pairs_per_class = options.pairs_per_class as u64;
    let summary = Summary::Labelled { n_pairs_per_class, candidates };
    // Pairs that the label rules leave out are not losses: the options ask for it.
    Ok(Done { outputs: vec![path], notes, summaries: vec![summary], ..Done::default() })
}
