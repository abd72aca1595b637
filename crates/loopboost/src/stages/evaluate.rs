use std::collections::BTreeMap;

use anyhow::{Context as _, Result};
use dataset::tables::scans::{read_scan_headers, read_scans};
use dataset::tables::{
    Provenance, TableError, read_features, read_grid, read_keyframes, read_pairs, read_retrieval,
    read_rounds, read_scores, write_file,
};
use dataset::{Dropped, FeatureUsefulness, Keyframe, Scan};
use evaluate::{Evaluation, Fact, Input, Sketches};

use crate::config::Config;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};

/// Scores -> evaluation/, report.html
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    run.task(&run.task_of(Stage::Evaluate)?, |provenance| evaluate(run, &provenance))
}

/// As [`run`], and then prints the numbers.
pub(crate) fn run_and_print(run: &Run) -> Result<Dropped> {
    let dropped = self::run(run)?;
    let path = run.path_of(Artifact::Summary);
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    out!("{}", text.trim_end());
    Ok(dropped)
}

fn evaluate(run: &Run, provenance: &Provenance) -> Result<Done> {
    let (keyframes, of_keyframes) = read_keyframes(&run.path_of(Artifact::Keyframes))?;
    let (pairs, _) = read_pairs(&run.path_of(Artifact::Pairs), &keyframes)?;
    let (features, _) = read_features(&run.path_of(Artifact::Features))?;
    let (scores, of_scores) = read_scores(&run.path_of(Artifact::Scores), &pairs)?;
    let not_evaluated: Vec<String> = of_scores.dropped.iter().map(|(why, _)| why.to_owned()).collect();
    let (rounds, _) = read_rounds(&run.path_of(Artifact::Rounds))?;
    let (retrieval, _) = read_retrieval(&run.path_of(Artifact::Retrieval))?;
    let (grid, _) = read_grid(&run.path_of(Artifact::Grid))?;
    let mut dropped = of_keyframes.dropped;
    let mut facts = Vec::new();
    for log in run.ingested_logs()? {
        let (_, of_scans) = read_scan_headers(&run.scans(&log.name))?;
        dropped.merge(of_scans.dropped);
        let digests = of_scans.inputs.into_iter();
        facts.extend(digests.map(|(log, digest)| fact(&format!("BLAKE3 of {log}"), digest)));
    }
    facts.extend(options(&run.config)?);

    let input = Input {
        keyframes: &keyframes,
        pairs: &pairs,
        features: &features,
        feature_usefulness: &[],
        scores: &scores,
        not_evaluated: &not_evaluated,
        rounds: &rounds,
        retrieval: &retrieval,
        grid: &grid,
        resamples: run.config.evaluate.resamples,
        seed: run.config.seed,
        dropped: &dropped,
    };
    let evaluation = evaluate::evaluate(&input);
    let (sketches, thinned) = look_at_scans(run, &input, &evaluation)?;
    let feature_rows = feature_rows(run, &input, &thinned);
    let input = Input { feature_usefulness: &feature_rows, ..input };
    let figures = evaluate::figures(&input, &evaluation, &sketches);
    let mut done = Done { said: summary_lines(&input, &evaluation), ..Done::default() };
    let folder = run.path("evaluation");
    done.outputs = evaluate::write_tables(&folder, provenance, &input, &evaluation)?;
    done.outputs.extend(evaluate::write_figures(&folder.join("figures"), &figures)?);
    let name = &run.config.name;
    let json = evaluate::json(name, &input, &evaluation);
    let mut json = serde_json::to_string_pretty(&json)?;
    json.push('\n');
    write_file(&run.path_of(Artifact::Summary), json.as_bytes())?;
    done.outputs.push(run.path_of(Artifact::Summary));
    let path = run.path_of(Artifact::Report);
    let drawn = (&sketches, &figures[..]);
    let html = evaluate::report(name, &input, &evaluation, drawn, &facts, provenance);
    write_file(&path, html.as_bytes())?;
    done.said.push("report.html".to_owned());
    done.outputs.push(path);
    Ok(done)
}

/// Scans whose features are computed again, thinned: enough for a median.
const THINNED_SCANS: usize = 1000;

/// What each feature is worth by itself, how far it moves when scans are thinned, and how often the
/// rounds of the models chose it.
fn feature_rows(run: &Run, input: &Input<'_>, scans: &[Scan]) -> Vec<FeatureUsefulness> {
    let stability = featurize::stability(&run.config.featurize, scans);
    let auc = train::feature_auc(&super::train::matrix(input.pairs, input.features));
    let chosen = |name: &String| {
        input.rounds.iter().filter(|r| r.held_out.is_none() && r.feature == *name).count() as u64
    };
    let rows = input.features.names.iter().zip(auc.into_iter().zip(stability));
    rows.map(|(name, (auc, stability))| FeatureUsefulness {
        name: name.clone(),
        auc,
        stability,
        chosen: chosen(name),
    })
    .collect()
}

/// Hands the scans of all keyframes to the figures that are drawn of scans, and keeps some, evenly.
fn look_at_scans(
    run: &Run,
    input: &Input<'_>,
    evaluation: &Evaluation,
) -> Result<(Sketches, Vec<Scan>)> {
    let mut sketches = Sketches::new(input, evaluation);
    let every = input.keyframes.len().div_ceil(THINNED_SCANS).max(1);
    let mut kept = Vec::new();
    each_scan(run, input.keyframes, |k, scan| {
        sketches.add(input, k, scan);
        if k.is_multiple_of(every) {
            kept.push(scan.clone());
        }
    })?;
    Ok((sketches, kept))
}

/// Reads the scans of all keyframes.
fn each_scan(run: &Run, all: &[Keyframe], mut take: impl FnMut(usize, &Scan)) -> Result<()> {
    let mut logs: BTreeMap<&str, Vec<(u32, usize)>> = BTreeMap::new();
    for (k, Keyframe { id, .. }) in all.iter().enumerate() {
        logs.entry(&id.log).or_default().push((id.scan, k));
    }
    for (log, mut keyframes) in logs {
        keyframes.sort_unstable();
        let scans: Vec<u32> = keyframes.iter().map(|&(scan, _)| scan).collect();
        let mut of_scans = keyframes.iter().map(|&(_, k)| k);
        read_scans(&run.scans(log), &scans, |batch| {
            for (scan, k) in batch.iter().zip(&mut of_scans) {
                take(k, scan);
            }
            Ok::<(), TableError>(())
        })?;
    }
    Ok(())
}

/// The error of each learner and grouping: after few rounds and after the last one, or the only
/// error if both are the same or the learner has no rounds.
fn summary_lines(input: &Input<'_>, evaluation: &Evaluation) -> Vec<String> {
    let line = |curve: &evaluate::PrCurve| {
        let rows: Vec<_> = evaluation
            .errors
            .iter()
            .filter(|row| row.learner == curve.learner && row.grouping == curve.grouping)
            .collect();
        let error_at = |rounds: usize| {
            let row = rows.iter().find(|row| row.rounds == rounds);
            row.map_or(f64::NAN, |row| row.confusion.error() * 100.0)
        };
        let (few, last) =
            (curve.rounds, rows.iter().map(|row| row.rounds).max().unwrap_or(curve.rounds));
        let errors = if !input.is_boosted(&curve.learner) {
            format!("{:.1} %", error_at(last))
        } else if few == last {
            format!("{:.1} % at T = {last}", error_at(last))
        } else {
            format!("{:.1} % at T = {few}, {:.1} % at T = {last}", error_at(few), error_at(last))
        };
        format!("{} by {}: error {errors}", curve.learner, curve.grouping)
    };
    evaluation.precision_recall.iter().map(line).collect()
}

fn options(config: &Config) -> Result<Vec<Fact>> {
    Ok(vec![
        fact("program", format!("loopboost {}", env!("CARGO_PKG_VERSION"))),
        fact("seed", config.seed.to_string()),
        fact("ingest.lidar", serde_json::to_string(&config.ingest.lidar)?),
        fact("ingest.pose", serde_json::to_string(&config.ingest.pose)?),
        fact("subsample", serde_json::to_string(&config.subsample)?),
        fact("label", serde_json::to_string(&config.label)?),
        fact("featurize", serde_json::to_string(&config.featurize)?),
        fact("train", serde_json::to_string(&config.train)?),
        fact("evaluate", serde_json::to_string(&config.evaluate)?),
    ])
}

fn fact(name: &str, value: String) -> Fact {
    Fact { name: name.to_owned(), value }
}
