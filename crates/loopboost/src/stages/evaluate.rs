use anyhow::Result;
use dataset::Dropped;
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{
    Provenance, read_grid, read_keyframes, read_pairs, read_retrieval, read_rounds, read_scores,
    write_file,
};
use evaluate::{Evaluation, Fact, Input};

use crate::config::Config;
use crate::run::{Done, Run, Task};

const INPUTS: [&str; 6] = [
    "keyframes.parquet",
    "pairs.parquet",
    "scores.parquet",
    "rounds.parquet",
    "retrieval.parquet",
    "grid.parquet",
];

/// Scores -> evaluation/, report.html
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let task =
        Task { stage: "evaluate", log: None, inputs: INPUTS.map(|name| run.path(name)).into() };
    run.task(&task, |provenance| evaluate(run, &provenance))
}

fn evaluate(run: &Run, provenance: &Provenance) -> Result<Done> {
    let [keyframes, pairs, scores, rounds, retrieval, grid] = INPUTS.map(|name| run.path(name));
    let (keyframes, of_keyframes) = read_keyframes(&keyframes)?;
    let (pairs, _) = read_pairs(&pairs, &keyframes)?;
    let (scores, _) = read_scores(&scores, &pairs)?;
    let (rounds, _) = read_rounds(&rounds)?;
    let (retrieval, _) = read_retrieval(&retrieval)?;
    let (grid, _) = read_grid(&grid)?;
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
        scores: &scores,
        rounds: &rounds,
        retrieval: &retrieval,
        grid: &grid,
        resamples: run.config.evaluate.resamples,
        seed: run.config.seed,
        dropped: &dropped,
    };
    let evaluation = evaluate::evaluate(&input);
    let mut done = Done { said: said(run, &evaluation), ..Done::default() };
    done.outputs =
        evaluate::write_tables(&run.path("evaluation"), provenance, &input, &evaluation)?;
    let path = run.path("report.html");
    let html = evaluate::report(&run.config.name, &input, &evaluation, &facts, provenance);
    write_file(&path, html.as_bytes())?;
    done.said.push("report.html".to_owned());
    done.outputs.push(path);
    Ok(done)
}

fn said(run: &Run, evaluation: &Evaluation) -> Vec<String> {
    let of_curve = |curve: &evaluate::PrCurve| {
        let error_at = |rounds: usize| {
            let row = evaluation.errors.iter().find(|row| {
                row.learner == curve.learner
                    && row.grouping == curve.grouping
                    && row.rounds == rounds
            });
            row.map_or(f64::NAN, |row| row.confusion.error() * 100.0)
        };
        let (few, all) = (curve.rounds, run.config.train.rounds as usize);
        format!(
            "{} by {}: error {:.1} % at T = {few}, {:.1} % at T = {all}",
            curve.learner,
            curve.grouping,
            error_at(few),
            error_at(all)
        )
    };
    evaluation.precision_recall.iter().map(of_curve).collect()
}

fn options(config: &Config) -> Result<Vec<Fact>> {
    Ok(vec![
        fact("program", format!("loopboost {}", env!("CARGO_PKG_VERSION"))),
        fact("seed", config.seed.to_string()),
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
