use std::io::Write;

use anyhow::Result;
use dataset::Dropped;
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{
    TableError, read_keyframes, read_pairs, read_rounds, read_scores, write_atomically,
};
use evaluate::{Evaluation, Fact, Input};

use crate::run::Run;

/// Scores -> evaluation/*.parquet, report.html
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let inputs = ["keyframes.parquet", "pairs.parquet", "scores.parquet", "rounds.parquet"]
        .map(|name| run.path(name));
    let (keyframes, of_keyframes) = read_keyframes(&inputs[0])?;
    let (pairs, _) = read_pairs(&inputs[1], &keyframes)?;
    let (scores, _) = read_scores(&inputs[2], &pairs)?;
    let (rounds, _) = read_rounds(&inputs[3])?;
    let mut dropped = of_keyframes.dropped;
    let mut facts = Vec::new();
    for log in run.logs()? {
        let (_, of_scans) = read_scan_headers(&run.scans(&log.name))?;
        dropped.merge(of_scans.dropped);
        facts.extend(
            of_scans
                .inputs
                .into_iter()
                .map(|(log, digest)| fact(&format!("BLAKE3 of {log}"), digest)),
        );
    }

    let input = Input {
        keyframes: &keyframes,
        pairs: &pairs,
        scores: &scores,
        rounds: &rounds,
        dropped: &dropped,
    };
    let evaluation = evaluate::evaluate(&input);
    let provenance = run.provenance(&run.config.evaluate, &inputs, Dropped::default())?;
    evaluate::write_tables(&run.path("evaluation"), &provenance, &input, &evaluation)?;

    facts.extend(options(run)?);
    let html = evaluate::report(&run.config.name, &input, &evaluation, &facts);
    let path = run.path("report.html");
    write_atomically(&path, |mut file| {
        file.write_all(html.as_bytes()).map_err(|source| TableError::Io {
            action: "write",
            path: path.clone(),
            source,
        })?;
        Ok::<_, TableError>((file, ()))
    })?;
    say_errors(run, &evaluation);
    run.say("evaluate", format!("report: {}", path.display()));
    Ok(Dropped::default())
}

fn say_errors(run: &Run, evaluation: &Evaluation) {
    for curve in &evaluation.precision_recall {
        let error_at = |rounds: usize| {
            let row = evaluation.errors.iter().find(|row| {
                row.learner == curve.learner
                    && row.grouping == curve.grouping
                    && row.rounds == rounds
            });
            row.map_or(f64::NAN, |row| row.confusion.error() * 100.0)
        };
        let (few, all) = (curve.rounds, run.config.train.rounds as usize);
        run.say(
            "evaluate",
            format!(
                "{} by {}: error {:.1} % at T = {few}, {:.1} % at T = {all}",
                curve.learner,
                curve.grouping,
                error_at(few),
                error_at(all)
            ),
        );
    }
}

fn options(run: &Run) -> Result<Vec<Fact>> {
    let config = &run.config;
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
