mod every_pair;
mod grid;

use anyhow::{Context as _, Result, anyhow};
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{
    FeatureTable, Provenance, read_features, read_keyframes, read_pairs, write_grid,
    write_retrieval, write_rounds, write_scores,
};
use dataset::{BoostingRound, Dropped, FULL_RING_DEG, Keyframe, Label, HeldOut, Pair, Scores};
use evaluate::{Confusion, operating_points};
use ingest::LidarOptions;
use label::{FoldOptions, Folds, Grouping};
use model::{FeatureSpec, Measured, Model, OperatingPoint, ScanSpec, Training};
use rayon::prelude::*;
use train::{FoldFit, Folded, Learner, Matrix, Round};

use crate::config::EvaluateSection;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};

/// All options that the models depend on or carry.
struct Options<'a> {
    name: &'a str,
    train: &'a train::Options,
    evaluate: &'a EvaluateSection,
    label: &'a label::Options,
    featurize: &'a featurize::Options,
    lidars: Vec<LidarOptions>,
}

/// Pairs and features -> models/, scores.parquet, rounds.parquet, retrieval.parquet, grid.parquet
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let config = &run.config;
    let lidars = run.ingested_logs()?.into_iter().map(|log| Ok(config.for_log(&log.name)?.lidar));
    let options = Options {
        name: &config.name,
        train: &config.train,
        evaluate: &config.evaluate,
        label: &config.label,
        featurize: &config.featurize,
        lidars: lidars.collect::<Result<_>>()?,
    };
    run.task(&run.task_of(Stage::Train)?, |provenance| train(run, &options, &provenance))
}

fn train(run: &Run, options: &Options<'_>, provenance: &Provenance) -> Result<Done> {
    let (keyframes, _) = read_keyframes(&run.path_of(Artifact::Keyframes))?;
    let (pairs, _) = read_pairs(&run.path_of(Artifact::Pairs), &keyframes)?;
    let (features, _) = read_features(&run.path_of(Artifact::Features))?;
    check_features(options.featurize, &keyframes, &features)?;
    let data = matrix(&pairs, &features);
    let mut fitted: Vec<Fitted> = options
        .train
        .learners
        .par_iter()
        .map(|&learner| fit(options, learner, &data))
        .collect::<Vec<_>>()
        .into_iter()
        .collect::<Result<_>>()?;
    let mut groupings = Vec::new();
    let mut not_evaluated = Dropped::default();
    let mut said = Vec::new();
    for &grouping in &options.evaluate.groupings {
        let fold_options = fold_options(options.evaluate, grouping, run.config.seed);
        match hold_out(options, &fold_options, &keyframes, &pairs, &data, &mut fitted) {
            Ok(folds) => groupings.push((grouping, folds)),
            Err(error) if options.evaluate.require_groupings => return Err(error),
            Err(error) => {
                said.push(format!("left out: {error:#}"));
                not_evaluated.add(format!("{error:#}"), 1);
            }
        }
    }
    if groupings.is_empty() {
        return Err(anyhow!("no grouping can be evaluated; {}", said.join("; ")));
    }
    let retrieval =
        every_pair::retrieval(options, &keyframes, &features, &data, &groupings, &fitted)?;
    let cells = grid::grid(options, run.config.seed, &keyframes, &features)?;
    let names = &features.names;
    let scores: Vec<Scores> = fitted.iter().flat_map(|f| f.scores.iter().cloned()).collect();
    let rounds: Vec<BoostingRound> = fitted.iter().flat_map(|f| f.boosting_rounds(names)).collect();
    let mut done = Done {
        outputs: Stage::Train.spec().outputs.iter().map(|&made| run.path_of(made)).collect(),
        said,
        ..Done::default()
    };
    let of_scores = Provenance { dropped: not_evaluated, ..provenance.clone() };
    write_scores(&run.path_of(Artifact::Scores), &of_scores, &keyframes, &pairs, &scores)?;
    write_rounds(&run.path_of(Artifact::Rounds), provenance, &rounds)?;
    write_retrieval(&run.path_of(Artifact::Retrieval), provenance, &retrieval)?;
    write_grid(&run.path_of(Artifact::Grid), provenance, &cells)?;

    let context = Context {
        seed: run.config.seed,
        scans: scan_spec(options, &keyframes),
        training: training(run, &pairs, provenance)?,
        label_options: serde_json::to_value(options.label)?,
        features: FeatureSpec {
            set: options.featurize.set.name().to_owned(),
            version: options.featurize.set.version(),
            gate_m: options.featurize.gate_m,
            names: names.clone(),
        },
    };
    for fitted in &fitted {
        // Baselines are evaluated, not saved.
        let Some(boosting) = fitted.learner.boosting() else { continue };
        let model = model_of(options, fitted, boosting, &data, &context);
        let folder = model::save(&run.path("models"), &model)?;
        let errors = model
            .measured
            .iter()
            .map(|measured| format!("{:.1} % by {}", measured.error * 100.0, measured.grouping));
        done.said.push(format!(
            "{} {}: error {} at T = {}",
            model.name,
            folder.version,
            errors.collect::<Vec<_>>().join(", "),
            options.train.rounds_of(fitted.learner)
        ));
        done.outputs.extend(folder.files);
    }
    Ok(done)
}

/// How pairs are assigned to folds.
fn fold_options(evaluate: &EvaluateSection, grouping: Grouping, seed: u64) -> FoldOptions {
    FoldOptions { grouping, n_folds: evaluate.folds, place_m: evaluate.place_m, seed }
}

/// One learner, fitted on all pairs and on the folds of each grouping.
struct Fitted {
    learner: Learner,
    rounds: Vec<Round>,
    /// Classifiers fitted without folds, by grouping.
    fits: Vec<(Grouping, Vec<FoldFit>)>,
    scores: Vec<Scores>,
}

fn fit(options: &Options<'_>, learner: Learner, data: &Matrix) -> Result<Fitted> {
    let rounds = match learner.boosting() {
        Some(boosting) => train::fit(boosting, options.train.rounds_of(learner), data)?,
        None => Vec::new(),
    };
    Ok(Fitted { learner, rounds, fits: Vec::new(), scores: Vec::new() })
}

/// Cross-validates all learners on the folds of one grouping.
fn hold_out(
    options: &Options<'_>,
    fold_options: &FoldOptions,
    keyframes: &[Keyframe],
    pairs: &[Pair],
    data: &Matrix,
    fitted: &mut [Fitted],
) -> Result<Folds> {
    let folds = label::assign_folds(fold_options, keyframes, pairs)?;
    let grouping = fold_options.grouping;
    let n_rounds = |fitted: &Fitted| options.train.rounds_of(fitted.learner);
    let folded = folded(data, &folds);
    let validated = fitted
        .par_iter()
        .map(|fitted| train::cross_validate(fitted.learner, n_rounds(fitted), &folded))
        .collect::<Vec<_>>()
        .into_iter()
        .collect::<Result<Vec<_>, _>>()
        .with_context(|| format!("grouping `{}`", grouping.name()))?;
    for (fitted, validated) in fitted.iter_mut().zip(validated) {
        fitted.scores.push(Scores {
            learner: fitted.learner.name().to_owned(),
            grouping: grouping.name().to_owned(),
            n_rounds: n_rounds(fitted) as usize,
            groups: folds.groups.clone(),
            folds: folds.folds.clone(),
            confidences: validated.confidences,
        });
        fitted.fits.push((grouping, validated.fits));
    }
    Ok(folds)
}

fn folded<'a>(data: &'a Matrix, folds: &'a Folds) -> Folded<'a> {
    Folded { data, folds: &folds.folds, keys: &folds.keys }
}

impl Fitted {
    fn boosting_rounds(&self, names: &[String]) -> Vec<BoostingRound> {
        let rows = |held_out: Option<HeldOut>, rounds: &[Round]| -> Vec<BoostingRound> {
            (1..)
                .zip(rounds)
                .flat_map(|(round, fitted)| fitted.weak.splits().map(move |s| (round, fitted, s)))
                .map(|(round, fitted, split)| BoostingRound {
                    learner: self.learner.name().to_owned(),
                    held_out: held_out.clone(),
                    round,
                    node: split.node,
                    feature: names[split.feature].clone(),
                    threshold: split.threshold,
                    weighted_error: fitted.weighted_error,
                })
                .collect()
        };
        let of_folds = self.fits.iter().flat_map(|(grouping, fits)| {
            fits.iter().flat_map(|fit| {
                let grouping = grouping.name().to_owned();
                rows(Some(HeldOut { grouping, folds: fit.held_out }), &fit.rounds)
            })
        });
        rows(None, &self.rounds).into_iter().chain(of_folds).collect()
    }
}

/// What all models of a run share.
struct Context {
    seed: u64,
    scans: ScanSpec,
    training: Training,
    label_options: serde_json::Value,
    features: FeatureSpec,
}

fn model_of(
    options: &Options<'_>,
    fitted: &Fitted,
    boosting: model::Learner,
    data: &Matrix,
    context: &Context,
) -> Model {
    let mut measured = Vec::new();
    let mut points = Vec::new();
    for scores in &fitted.scores {
        let confidences: Vec<f64> = scores.after(scores.n_rounds).collect();
        let counts = Confusion::count(data.labels(), confidences.iter().copied(), 0.0);
        measured.push(Measured {
            grouping: scores.grouping.clone(),
            folds: scores.folds.iter().flatten().max().map_or(0, |fold| fold + 1),
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
    Model {
        name: format!("{}-{}", options.name, fitted.learner.name()),
        // `save` gives the version.
        version: semver::Version::new(1, 0, 0),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: context.seed,
        features: context.features.clone(),
        scans: context.scans,
        label_options: context.label_options.clone(),
        training: context.training.clone(),
        measured,
        operating_points: points,
        classifier: train::classifier(boosting, &fitted.rounds),
    }
}

/// The absolute feature differences of each pair.
pub(crate) fn matrix(pairs: &[Pair], features: &FeatureTable) -> Matrix {
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
fn check_features(
    options: &featurize::Options,
    keyframes: &[Keyframe],
    features: &FeatureTable,
) -> Result<()> {
    let again = "make the features again with `loopboost featurize PIPELINE.toml --out DIR`";
    if !features.ids.iter().eq(keyframes.iter().map(|k| &k.id)) {
        return Err(anyhow!("features.parquet is not of these keyframes; {again}"));
    }
    if features.names != options.set.feature_names() {
        return Err(anyhow!(
            "features.parquet has the columns {}, expected those of `{}`; {again}",
            features.names.join(", "),
            options.set.name()
        ));
    }
    Ok(())
}

fn scan_spec(options: &Options<'_>, keyframes: &[Keyframe]) -> ScanSpec {
    let coverage = keyframes.iter().map(|k| k.coverage_deg);
    let (min, max) = coverage.fold((f32::INFINITY, 0f32), |(a, b), c| (a.min(c), b.max(c)));
    // Of logs with limits of their own, the widest.
    let lidars = options.lidars.iter();
    ScanSpec {
        is_ring: FULL_RING_DEG <= min,
        coverage_min_deg: min,
        coverage_max_deg: max,
        range_min_m: lidars.clone().map(|l| l.range_min_m).fold(f64::INFINITY, f64::min),
        range_max_m: lidars.map(|l| l.range_max_m).fold(0.0, f64::max),
    }
}

/// Counts, and the digests of the training tables and, by the scans made of them, of the logs.
fn training(run: &Run, pairs: &[Pair], provenance: &Provenance) -> Result<Training> {
    let mut digests = provenance.inputs.clone();
    for log in run.ingested_logs()? {
        let (_, of_scans) = read_scan_headers(&run.scans(&log.name))?;
        digests.extend(of_scans.inputs);
    }
    let count = |label| pairs.iter().filter(|pair| pair.label == label).count();
    Ok(Training { n_positive: count(Label::Positive), n_negative: count(Label::Negative), digests })
}
