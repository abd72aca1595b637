use anyhow::{Result, anyhow};
use dataset::tables::scans::read_scan_headers;
use dataset::tables::{
    FeatureTable, Provenance, read_feature_stability, read_pairs, write_feature_usefulness,
    write_grid, write_retrieval, write_rounds, write_scores,
};
use dataset::{Keyframe, Label, Note, Pair, RangeLimits};
use experiment::{Data, ModelContext, NotEvaluated, Setup};
use model::{FeatureSpec, Model, Training};

use crate::findings::Findings;
use crate::fit_detector::fit_detectors;
use crate::labelled::{features_of, labelled_keyframes};
use crate::partitions;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};
use crate::summary::{GroupingError, Summary};

/// The tables that the models are trained on.
const TRAINING_TABLES: [Artifact; 3] = [Artifact::Keyframes, Artifact::Pairs, Artifact::Features];

/// Pairs, features -> models/, scores, rounds, retrieval, grid and feature_usefulness.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Train)?;
    if !run.goal.detects() {
        // Only the detector needs poses between keyframes.
        for log in run.ingested_logs()? {
            task.inputs.retain(|input| *input != run.poses(&log.name));
        }
    }
    for log in run.ingested_logs()? {
        if run.is_in_pose_run(&log.name)? {
            let truth = run.path_of_log(Artifact::Truth, &log.name);
            task.inputs.retain(|input| *input != truth);
        }
    }
    run.task(&task, |provenance| train(run, &provenance))
}

fn train(run: &Run, provenance: &Provenance) -> Result<Done> {
    let config = &run.config;
    let (keyframes, features) = (partitions::keyframes(run)?, partitions::features(run)?);
    check_features(&config.featurize, &keyframes, &features)?;
    let (keyframes, _) = labelled_keyframes(run)?;
    let features = features_of(features, &keyframes);
    let (pairs, _) = read_pairs(&run.path_of(Artifact::Pairs), &keyframes)?;
    let stability = run.path_of(Artifact::FeatureStability);
    let (stability, _) = read_feature_stability(&stability, &features.names)?;

    let options = config.evaluate.experiment();
    let (train, label) = (&config.train, &config.label);
    let setup = Setup { options: &options, train, label, seed: config.seed };
    let differences = experiment::differences(&pairs, &features);
    let data = Data {
        keyframes: &keyframes,
        features: &features,
        pairs: &pairs,
        differences: &differences,
    };

    let fitted = experiment::fit(train, &differences)?;
    let validation = experiment::cross_validate(&setup, &data)?;
    let retrieval = experiment::retrieval(&setup, &data, &validation)?;
    let grid = experiment::label_grid(&setup, &keyframes, &features)?;
    let rounds = experiment::boosting_rounds(&fitted, &validation, &features.names);
    let usefulness = experiment::feature_usefulness(&data, &stability, &rounds);
    let context = model_context(run, &keyframes, &pairs, provenance)?;
    let mut models = experiment::models(&context, &fitted, &validation, differences.labels());
    let of_detectors = fit_detectors(run, &setup, &data, &validation, &mut models)?;

    let mut notes: Vec<Note> = validation.not_evaluated.iter().map(NotEvaluated::note).collect();
    let of_scores = Provenance { notes: notes.clone(), ..provenance.clone() };
    let scores = validation.scores();
    write_scores(&run.path_of(Artifact::Scores), &of_scores, &keyframes, &pairs, &scores)?;
    write_rounds(&run.path_of(Artifact::Rounds), provenance, &rounds)?;
    write_retrieval(&run.path_of(Artifact::Retrieval), provenance, &retrieval)?;
    write_grid(&run.path_of(Artifact::Grid), provenance, &grid)?;
    write_feature_usefulness(&run.path_of(Artifact::FeatureUsefulness), provenance, &usefulness)?;

    notes.extend(experiment::few_matches(&data, &retrieval));
    notes.extend(of_detectors);
    let outputs = Stage::Train.spec().outputs.iter().map(|&artifact| run.path_of(artifact));
    let mut done = Done { outputs: outputs.collect(), notes, ..Done::default() };
    for model in &models {
        let saved = model::save(&run.path("models"), model)?;
        done.summaries.push(summary(model, &saved.version));
        done.outputs.extend(saved.files);
    }
    Ok(done)
}

/// The rows of the features must be the keyframes, and the columns the features of the set.
fn check_features(
    options: &featurize::Options,
    keyframes: &[Keyframe],
    features: &FeatureTable,
) -> Result<()> {
    let remedy = "make the features again with `loopboost featurize PIPELINE.toml --out DIR`";
    if !features.ids.iter().eq(keyframes.iter().map(|k| &k.id)) {
        return Err(anyhow!(
            "the rows of the tables in features/ do not match those in keyframes/; {remedy}"
        ));
    }
    if features.names != options.set.feature_names() {
        return Err(anyhow!(
            "the tables in features/ have the columns {}, expected those of `{}`; {remedy}",
            features.names.join(", "),
            options.set.name()
        ));
    }
    Ok(())
}

fn model_context(
    run: &Run,
    keyframes: &[Keyframe],
    pairs: &[Pair],
    provenance: &Provenance,
) -> Result<ModelContext> {
    let config = &run.config;
    let set = config.featurize.set;
    let mut limits = Vec::new();
    for log in run.ingested_logs()? {
        let lidar = config.for_log(&log.name)?.lidar;
        limits.push(RangeLimits { min_m: lidar.range_min_m, max_m: lidar.range_max_m });
    }
    Ok(ModelContext {
        name: config.name.clone(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        scans: experiment::scan_spec(keyframes, &limits),
        training: training(run, pairs, provenance)?,
        label_options: serde_json::to_value(&config.label)?,
        features: FeatureSpec {
            set: set.name().to_owned(),
            version: set.version(),
            gate_m: config.featurize.gate_m,
            names: set.feature_names().iter().map(|&name| name.to_owned()).collect(),
        },
    })
}

/// The number of pairs, and the digests of the training tables and of the logs.
fn training(run: &Run, pairs: &[Pair], provenance: &Provenance) -> Result<Training> {
    let mut digests = provenance.inputs.clone();
    digests.retain(|name, _| {
        Artifact::of_name(name).is_some_and(|(artifact, _)| TRAINING_TABLES.contains(&artifact))
    });
    for log in run.ingested_logs()? {
        let (_, of_scans) = read_scan_headers(&run.scans(&log.name))?;
        digests.extend(of_scans.inputs);
    }
    let count = |label| pairs.iter().filter(|pair| pair.label == label).count();
    Ok(Training {
        n_positive: count(Label::Positive),
        n_negative: count(Label::Negative),
        digests,
        warnings: run.findings_before(Stage::Train)?.warnings(),
    })
}

/// The errors of a model.
fn summary(model: &Model, version: &semver::Version) -> Summary {
    let errors = model
        .measured
        .iter()
        .map(|of| GroupingError { grouping: of.grouping.clone(), error: of.error })
        .collect();
    Summary::Trained {
        model: model.name.clone(),
        version: version.to_string(),
        rounds: u64::from(model.measured.first().map_or(0, |measured| measured.rounds)),
        errors,
    }
}
