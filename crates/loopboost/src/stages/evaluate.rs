use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use dataset::tables::scans::{read_scan_headers, read_scans};
use dataset::tables::{
    Provenance, TableError, read_feature_usefulness, read_grid, read_pairs, read_retrieval,
    read_rounds, read_scores, write_file,
};
use dataset::{Keyframe, Note, Scan};
use evaluate::detection::{self, Drive, DriveMeasures, PoseSource, SiteDrives, SiteMeasures};
use evaluate::{ClosureReport, ClosureSketches, Evaluation, Fact, Input, Sketches};

use crate::config::Config;
use crate::findings::Findings;
use crate::found_drives::FoundDrive;
use crate::label_basis::label_basis;
use crate::label_truth::compare_with_truth;
use crate::labelled::{features_of, labelled_keyframes};
use crate::partitions;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};
use crate::summary::{RoundsError, Summary};

/// Scores, closures -> evaluation/, report.html
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Evaluate)?;
    if !run.goal.detects() && run.pose_run().is_none() {
        // Only trajectories and the labels of a map are compared with poses at every scan.
        let folder = run.path("poses");
        task.inputs.retain(|input| !input.starts_with(&folder));
    }
    run.task(&task, |provenance| {
        let (found, sites) = match run.goal.detects() {
            true => FoundDrive::load_all(run)?,
            false => Default::default(),
        };
        let closures: Vec<_> = found.iter().map(FoundDrive::closures).collect();
        let drives: Vec<_> =
            found.iter().zip(&closures).map(|(found, closures)| found.drive(closures)).collect();
        match run.goal.trains() {
            true => evaluate(run, &provenance, &drives, &sites),
            false => evaluate_closures(run, &provenance, &drives, &sites),
        }
    })
}

/// Measures and reports the loop closures of new logs.
fn evaluate_closures(
    run: &Run,
    provenance: &Provenance,
    drives: &[Drive<'_>],
    sites: &[SiteDrives],
) -> Result<Done> {
    let keyframes = partitions::keyframes(run)?;
    let measures: Vec<_> = drives.iter().map(detection::measure).collect();
    let sites: Vec<_> = sites.iter().map(|site| detection::measure_site(site, drives)).collect();
    let mut sketches = ClosureSketches::new(drives);
    each_scan(run, &keyframes, |k, scan| sketches.add(drives, &keyframes[k].id, scan))?;
    let figures = evaluate::closure_figures(drives, &measures, &sketches);
    let Findings { losses, notes } = run.findings_before(Stage::Evaluate)?;

    let folder = run.path("evaluation");
    let mut outputs = detection::write_detection(&folder, provenance, drives, &measures)?;
    outputs.extend(evaluate::write_figures(&folder.join("figures"), &figures)?);
    let name = &run.config.name;
    let json = evaluate::closure_json(name, &measures, &sites, &losses, &notes);
    outputs.push(write_json(run, &json)?);
    let closures = ClosureReport {
        keyframes: &keyframes,
        drives,
        measures: &measures,
        sites: &sites,
        sketches: &sketches,
        figures: &figures,
        losses: &losses,
        notes: &notes,
    };
    let (digests, options) = (digests_of_logs(run)?, options(&run.config)?);
    let html = evaluate::closure_report(name, &closures, (&digests, &options), provenance);
    outputs.push(write_report(run, &html)?);
    let mut summaries = closed(&measures, &sites);
    summaries.push(Summary::Written { file: Artifact::Report.pattern().to_owned() });
    Ok(Done { outputs, summaries, ..Done::default() })
}

/// As [`run`], and then prints the numbers.
pub(crate) fn run_and_print(run: &Run) -> Result<Findings> {
    let findings = self::run(run)?;
    let path = run.path_of(Artifact::Summary);
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    out!("{}", text.trim_end());
    Ok(findings)
}

fn evaluate(
    run: &Run,
    provenance: &Provenance,
    drives: &[Drive<'_>],
    sites: &[SiteDrives],
) -> Result<Done> {
    let (keyframes, _) = labelled_keyframes(run)?;
    let (pairs, _) = read_pairs(&run.path_of(Artifact::Pairs), &keyframes)?;
    let features = features_of(partitions::features(run)?, &keyframes);
    let (scores, of_scores) = read_scores(&run.path_of(Artifact::Scores), &pairs)?;
    let not_evaluated: Vec<Note> = of_scores.notes;
    let (rounds, _) = read_rounds(&run.path_of(Artifact::Rounds))?;
    let (retrieval, _) = read_retrieval(&run.path_of(Artifact::Retrieval))?;
    let (grid, _) = read_grid(&run.path_of(Artifact::Grid))?;
    let usefulness = run.path_of(Artifact::FeatureUsefulness);
    let (feature_usefulness, _) = read_feature_usefulness(&usefulness)?;
    let Findings { losses, mut notes } = run.findings_before(Stage::Evaluate)?;
    notes.retain(|note| !not_evaluated.contains(note));
    let label_basis = label_basis(run, &keyframes, &notes)?;
    let compared = compare_with_truth(run, &keyframes, &pairs)?;
    notes.extend(compared.clone());
    let (digests, options) = (digests_of_logs(run)?, options(&run.config)?);

    let input = Input {
        keyframes: &keyframes,
        pairs: &pairs,
        label_basis: &label_basis,
        place_m: run.config.label.place_m,
        max_height_difference_m: run.config.label.max_height_difference_m,
        place_margin_m: run.config.evaluate.place_margin_m,
        features: &features,
        feature_usefulness: &feature_usefulness,
        scores: &scores,
        not_evaluated: &not_evaluated,
        rounds: &rounds,
        retrieval: &retrieval,
        grid: &grid,
        resamples: run.config.evaluate.resamples,
        seed: run.config.seed,
        losses: &losses,
        notes: &notes,
        detection: drives,
        sites,
    };
    let evaluation = evaluate::evaluate(&input);
    let mut sketches = Sketches::new(&input, &evaluation);
    each_scan(run, &keyframes, |k, scan| sketches.add(&input, k, scan))?;

    let outputs = write(run, provenance, &input, &evaluation, &sketches, (&digests, &options))?;
    let mut summaries = closed(&evaluation.detection, &evaluation.sites);
    summaries.extend(self::summaries(&input, &evaluation));
    if !evaluation.is_validated_on_unseen_ground() {
        summaries.push(Summary::NotValidatedOnUnseenGround);
    }
    summaries.push(Summary::Written { file: Artifact::Report.pattern().to_owned() });
    Ok(Done { outputs, summaries, notes: compared.into_iter().collect(), ..Done::default() })
}

/// The digests of the logs, which the tables of their scans have stored.
fn digests_of_logs(run: &Run) -> Result<Vec<Fact>> {
    let mut facts = Vec::new();
    for log in run.ingested_logs()? {
        let (_, of_scans) = read_scan_headers(&run.scans(&log.name))?;
        let digests = of_scans.inputs.into_iter();
        facts.extend(digests.map(|(log, digest)| fact(&format!("BLAKE3 of {log}"), digest)));
    }
    Ok(facts)
}

/// Reads the scans of all keyframes, log by log.
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

/// Writes tables, figures, numbers and report; returns their paths.
fn write(
    run: &Run,
    provenance: &Provenance,
    input: &Input<'_>,
    evaluation: &Evaluation,
    sketches: &Sketches,
    facts: (&[Fact], &[Fact]),
) -> Result<Vec<PathBuf>> {
    let name = &run.config.name;
    let folder = run.path("evaluation");
    let mut outputs = evaluate::write_tables(&folder, provenance, input, evaluation)?;
    let figures = evaluate::figures(input, evaluation, sketches);
    outputs.extend(evaluate::write_figures(&folder.join("figures"), &figures)?);

    outputs.push(write_json(run, &evaluate::json(name, input, evaluation))?);

    let drawn = (sketches, &figures[..]);
    let html = evaluate::report(name, input, evaluation, drawn, facts, provenance);
    outputs.push(write_report(run, &html)?);
    Ok(outputs)
}

/// Writes the numbers of the report.
fn write_json(run: &Run, json: &serde_json::Value) -> Result<PathBuf> {
    let path = run.path_of(Artifact::Summary);
    write_file(&path, format!("{}\n", serde_json::to_string_pretty(json)?).as_bytes())?;
    Ok(path)
}

fn write_report(run: &Run, html: &str) -> Result<PathBuf> {
    let path = run.path_of(Artifact::Report);
    write_file(&path, html.as_bytes())?;
    Ok(path)
}

/// The error of each learner and grouping: after few rounds and after the last one, or the only
/// error if both are the same or the learner has no rounds.
fn summaries(input: &Input<'_>, evaluation: &Evaluation) -> Vec<Summary> {
    let of_curve = |curve: &evaluate::PrCurve| {
        let rows: Vec<_> = evaluation
            .errors
            .iter()
            .filter(|row| row.learner == curve.learner && row.grouping == curve.grouping)
            .collect();
        let is_boosted = input.is_boosted(&curve.learner);
        let error_at = |rounds: usize| RoundsError {
            rounds: is_boosted.then_some(rounds as u64),
            error: rows
                .iter()
                .find(|row| row.rounds == rounds)
                .map_or(f64::NAN, |row| row.confusion.error()),
        };
        let last = rows.iter().map(|row| row.rounds).max().unwrap_or(curve.rounds);
        let errors = match is_boosted && curve.rounds != last {
            true => vec![error_at(curve.rounds), error_at(last)],
            false => vec![error_at(last)],
        };
        Summary::Evaluated {
            learner: curve.learner.clone(),
            grouping: curve.grouping.clone(),
            errors,
        }
    };
    evaluation.precision_recall.iter().map(of_curve).collect()
}

/// Revisits, false closures and the errors of trajectories and maps, for drives with ground truth.
fn closed(measures: &[DriveMeasures], sites: &[SiteMeasures]) -> Vec<Summary> {
    let of_drive = |of: &DriveMeasures| {
        let truth = of.truth.as_ref()?;
        let mut errors = truth.trajectories.iter();
        let optimized = errors.find(|errors| errors.source == PoseSource::Optimized);
        Some(Summary::Closed {
            log: of.log.clone(),
            segment: of.segment,
            n_revisits: truth.revisits.all.n as u64,
            n_closed: truth.revisits.all.n_closed as u64,
            n_false: truth.closures.n_false_by_pose as u64,
            n_judged: truth.closures.n_judged as u64,
            ate_rmse_m: optimized.and_then(|errors| errors.ate_rmse_m),
        })
    };
    let of_site = |of: &SiteMeasures| {
        let truth = of.truth?;
        Some(Summary::ClosedBetween {
            site: of.site.clone(),
            n_revisits: truth.n_revisits as u64,
            n_closed: truth.n_closed as u64,
            n_false: truth.n_false as u64,
            n_judged: truth.n_judged as u64,
            ate_rmse_m: of.maps.iter().filter_map(|map| map.ate_rmse_m).fold(0.0, f64::max),
        })
    };
    measures.iter().filter_map(of_drive).chain(sites.iter().filter_map(of_site)).collect()
}

/// All options of the run, for the last section of the report.
fn options(config: &Config) -> Result<Vec<Fact>> {
    Ok(vec![
        fact("program", format!("loopboost {}", env!("CARGO_PKG_VERSION"))),
        fact("seed", config.seed.to_string()),
        fact("ingest.lidar", serde_json::to_string(&config.ingest.lidar)?),
        fact("ingest.pose", serde_json::to_string(&config.ingest.pose)?),
        fact("subsample", serde_json::to_string(&config.subsample)?),
        fact("label", serde_json::to_string(&config.label)?),
        fact("featurize", serde_json::to_string(&config.featurize)?),
        fact("register", serde_json::to_string(&config.register)?),
        fact("detect", serde_json::to_string(&config.detection())?),
        fact("train", serde_json::to_string(&config.train)?),
        fact("optimize", serde_json::to_string(&config.optimize)?),
        fact("evaluate", serde_json::to_string(&config.evaluate)?),
    ])
}

fn fact(name: &str, value: String) -> Fact {
    Fact { name: name.to_owned(), value }
}
