//! The whole pipeline, as the README draws it.

use anyhow::Result;

use crate::findings::Findings;
use crate::run::Run;
use crate::stage::Stage;
use crate::stages::{
    detect, evaluate, featurize, ingest, label, optimize, register, simulate, subsample, train,
};

/// log.mcap -> report.html
///
/// Without a model, a run trains classifiers, and finds loop closures if the pipeline has the section
/// `[detect]`. With a model, it finds loop closures only.
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut findings = Findings::default();
    let has = |stage| run.goal.has_stage(stage);
    if has(Stage::Simulate) {
        findings.merge(simulate::run(run)?); //  a campus, a robot -> logs
    }
    findings.merge(ingest::run(run)?); //        logs              -> scans, poses
    findings.merge(subsample::run(run)?); //     scans, poses      -> keyframes
    if has(Stage::Label) {
        findings.merge(label::run(run)?); //     keyframes         -> labelled pairs
    }
    if has(Stage::Featurize) {
        findings.merge(featurize::run(run)?); // keyframes         -> features
    }
    if has(Stage::Register) {
        findings.merge(register::run(run)?); //  scans, poses      -> poses by scan matching
        findings.merge(detect::run(run)?); //    registered scans  -> candidates
    }
    if has(Stage::Train) {
        findings.merge(train::run(run)?); //     pairs, features   -> models, scores
    }
    if has(Stage::Optimize) {
        findings.merge(optimize::run(run)?); //  candidates        -> closures, trajectory
    }
    findings.merge(evaluate::run(run)?); //      scores, closures  -> tables, report
    Ok(findings)
}

/// One stage, by its own command.
pub(crate) fn stage(stage: Stage) -> fn(&Run) -> Result<Findings> {
    match stage {
        Stage::Simulate => simulate::run,
        Stage::Ingest => ingest::run,
        Stage::Subsample => subsample::run,
        Stage::Label => label::run,
        Stage::Featurize => featurize::run,
        Stage::Register => register::run,
        Stage::Detect => detect::run,
        Stage::Train => train::run,
        Stage::Optimize => optimize::run,
        Stage::Evaluate => evaluate::run,
    }
}
