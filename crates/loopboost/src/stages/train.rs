use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, anyhow};
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{
    FeatureTable, digest_file, read_features, read_keyframes, read_pairs, write_rounds,
    write_scores,
};
use dataset::{BoostingRound, Dropped, FULL_RING_DEG, Keyframe, Label, Pair, Scores};
use evaluate::{Confusion, operating_points};
use model::{FeatureSpec, Learner, Measured, Model, OperatingPoint, ScanSpec, Training};
use rayon::prelude::*;
use train::{CrossValidated, Matrix, Round};

use crate::run::Run;

/// Pairs and features -> models/, scores.parquet, rounds.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let inputs =
        ["keyframes.parquet", "pairs.parquet", "features.parquet"].map(|name| run.path(name));
    let (keyframes, _) = read_keyframes(&inputs[0])?;
    let (pairs, _) = read_pairs(&inputs[1], &keyframes)?;
    let (features, _) = read_features(&inputs[2])?;
    check_features(run, &keyframes, &features)?;
    let data = matrix(&pairs, &features);
    let groupings = run
        .config
        .evaluate
        .groupings
        .iter()
        .map(|&grouping| {
            let n_folds = run.config.evaluate.folds;
            let folds = label::folds(grouping, n_folds, run.config.seed, &keyframes, &pairs)?;
            Ok((grouping.name(), folds))
        })
        .collect::<Result<Vec<_>>>()?;

    let fitted = run
        .config
        .train
        .learners
        .par_iter()
        .map(|&learner| fit(run, learner, &data, &groupings))
        .collect::<Result<Vec<_>>>()?;
    let names = &features.names;
    let scores: Vec<Scores> = fitted.iter().flat_map(|f| f.scores.iter().cloned()).collect();
    let rounds: Vec<BoostingRound> = fitted.iter().flat_map(|f| f.boosting_rounds(names)).collect();
    let options = serde_json::json!({"train": run.config.train, "evaluate": run.config.evaluate});
    let provenance = run.provenance(&options, &inputs, Dropped::default())?;
    write_scores(&run.path("scores.parquet"), &provenance, &keyframes, &pairs, &scores)?;
    write_rounds(&run.path("rounds.parquet"), &provenance, &rounds)?;

    let context = Context {
        scans: scan_spec(run, &keyframes)?,
        training: training(run, &pairs, &inputs)?,
        label_options: serde_json::to_value(&run.config.label)?,
        features: FeatureSpec {
            set: run.config.featurize.set.name().to_owned(),
            version: run.config.featurize.set.version(),
            gate_m: run.config.featurize.gate_m,
            names: names.clone(),
        },
    };
    for fitted in &fitted {
        save(run, fitted, &data, &context)?;
    }
    Ok(Dropped::default())
}

/// One learner, fitted on all pairs and on the folds of each grouping.
struct Fitted {
    learner: Learner,
    rounds: Vec<Round>,
    cross_validated: Vec<(&'static str, CrossValidated)>,
    scores: Vec<Scores>,
}

fn fit(
    run: &Run,
    learner: Learner,
    data: &Matrix,
    groupings: &[(&'static str, Vec<u32>)],
) -> Result<Fitted> {
    let n_rounds = run.config.train.rounds;
    let rounds = train::fit(learner, n_rounds, data)?;
    let mut cross_validated = Vec::new();
    let mut scores = Vec::new();
    for (grouping, folds) in groupings {
        let result =
            train::cross_validate(learner, n_rounds, data, folds, run.config.evaluate.folds)?;
        scores.push(Scores {
            learner: learner.name().to_owned(),
            grouping: (*grouping).to_owned(),
            n_rounds: n_rounds as usize,
            folds: folds.clone(),
            confidences: result.confidences.clone(),
        });
        cross_validated.push((*grouping, result));
    }
    Ok(Fitted { learner, rounds, cross_validated, scores })
}

impl Fitted {
    fn boosting_rounds(&self, names: &[String]) -> Vec<BoostingRound> {
        let rows = |left_out: Option<(String, u32)>, rounds: &[Round]| -> Vec<BoostingRound> {
            (1..)
                .zip(rounds)
                .map(|(round, fitted)| BoostingRound {
                    learner: self.learner.name().to_owned(),
                    left_out: left_out.clone(),
                    round,
                    feature: names[fitted.weak.feature()].clone(),
                    threshold: fitted.weak.threshold(),
                    weighted_error: fitted.weighted_error,
                })
                .collect()
        };
        let of_folds = self.cross_validated.iter().flat_map(|(grouping, result)| {
            (0..)
                .zip(&result.rounds)
                .flat_map(|(fold, rounds)| rows(Some(((*grouping).to_owned(), fold)), rounds))
        });
        rows(None, &self.rounds).into_iter().chain(of_folds).collect()
    }
}

/// What all models of a run share.
struct Context {
    scans: ScanSpec,
    training: Training,
    label_options: serde_json::Value,
    features: FeatureSpec,
}

fn save(run: &Run, fitted: &Fitted, data: &Matrix, context: &Context) -> Result<()> {
    let mut measured = Vec::new();
    let mut points = Vec::new();
    for scores in &fitted.scores {
        let confidences: Vec<f64> = scores.after(scores.n_rounds).collect();
        let counts = Confusion::count(data.labels(), confidences.iter().copied(), 0.0);
        measured.push(Measured {
            grouping: scores.grouping.clone(),
            folds: run.config.evaluate.folds,
            rounds: scores.n_rounds as u32,
            error: counts.error(),
            precision: counts.precision(),
            recall: counts.recall(),
        });
        for point in operating_points(data.labels(), &confidences) {
            let counts = point.point.confusion;
            points.push(OperatingPoint {
                name: point.name.to_owned(),
                grouping: scores.grouping.clone(),
                threshold: point.point.threshold,
                precision: counts.precision().unwrap_or(0.0),
                recall: counts.recall(),
                false_alarm: counts.false_alarm(),
            });
        }
    }
    let mut model = Model {
        name: format!("{}-{}", run.config.name, fitted.learner.name()),
        version: semver::Version::new(1, 0, 0),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: run.config.seed,
        features: context.features.clone(),
        scans: context.scans,
        label_options: context.label_options.clone(),
        training: context.training.clone(),
        measured,
        operating_points: points,
        classifier: train::classifier(fitted.learner, &fitted.rounds),
    };
    let models = run.path("models");
    let (version, is_new) = model::next_version(&models, &model)?;
    model.version = version;
    if is_new {
        model::save(&models, &model)?;
    }
    let error = model.measured.first().map_or(f64::NAN, |m| m.error);
    run.say(
        "train",
        format!(
            "{} {}{}: error {:.1} % at T = {}",
            model.name,
            model.version,
            if is_new { "" } else { " (unchanged)" },
            error * 100.0,
            run.config.train.rounds
        ),
    );
    Ok(())
}

/// The absolute feature differences of each pair.
fn matrix(pairs: &[Pair], features: &FeatureTable) -> Matrix {
    let n_features = features.names.len();
    let mut columns = vec![Vec::with_capacity(pairs.len()); n_features];
    let mut difference = vec![0.0; n_features];
    for pair in pairs {
        featurize::difference(
            features.row(pair.query),
            features.row(pair.reference),
            &mut difference,
        );
        for (column, &value) in columns.iter_mut().zip(&difference) {
            column.push(value);
        }
    }
    Matrix::new(columns, pairs.iter().map(|pair| pair.label).collect())
}

/// Rows of the features must be the keyframes, and its columns the set that is asked for.
fn check_features(run: &Run, keyframes: &[Keyframe], features: &FeatureTable) -> Result<()> {
    let again = "make the features again with `loopboost featurize PIPELINE.toml --out DIR`";
    if !features.ids.iter().eq(keyframes.iter().map(|k| &k.id)) {
        return Err(anyhow!("features.parquet is not of these keyframes; {again}"));
    }
    let expected = run.config.featurize.set.feature_names();
    if features.names != expected {
        return Err(anyhow!(
            "features.parquet has the columns {}, expected those of `{}`; {again}",
            features.names.join(", "),
            run.config.featurize.set.name()
        ));
    }
    Ok(())
}

fn scan_spec(run: &Run, keyframes: &[Keyframe]) -> Result<ScanSpec> {
    let coverage = keyframes.iter().map(|k| k.coverage_deg);
    let (min, max) = coverage.fold((f32::INFINITY, 0f32), |(a, b), c| (a.min(c), b.max(c)));
    let limits = run
        .logs()?
        .iter()
        .map(|log| Ok(run.config.for_log(&log.name)?.lidar))
        .collect::<Result<Vec<_>>>()?;
    // Of logs with limits of their own, the widest.
    Ok(ScanSpec {
        is_ring: FULL_RING_DEG <= min,
        coverage_min_deg: min,
        coverage_max_deg: max,
        range_min_m: limits.iter().map(|l| l.range_min_m).fold(f64::INFINITY, f64::min),
        range_max_m: limits.iter().map(|l| l.range_max_m).fold(0.0, f64::max),
    })
}

/// Counts, and the digests of the training tables and, by the scans made of them, of the logs.
fn training(run: &Run, pairs: &[Pair], tables: &[PathBuf]) -> Result<Training> {
    let mut digests = BTreeMap::new();
    for table in tables {
        let name = table.file_name().unwrap_or_default().to_string_lossy().into_owned();
        digests.insert(name, digest_file(table)?);
    }
    for log in run.logs()? {
        let (_, provenance) = read_scan_headers(&run.scans(&log.name))?;
        digests.extend(provenance.inputs);
    }
    let count = |label| pairs.iter().filter(|pair| pair.label == label).count();
    Ok(Training { n_positive: count(Label::Positive), n_negative: count(Label::Negative), digests })
}
