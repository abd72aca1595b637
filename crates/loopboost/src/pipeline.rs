//! The whole pipeline, as the README draws it.

use anyhow::Result;

use crate::findings::Findings;
use crate::run::Run;
use crate::stage::Stage;
use crate::stages::{evaluate, featurize, ingest, label, simulate, subsample, train};

/// log.mcap -> report.html
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut findings = Findings::default();
    if run.config.simulate.is_some() {
        findings.merge(simulate::run(run)?); //  a campus, a robot -> logs
    }
    findings.merge(ingest::run(run)?); //        logs              -> scans, poses
    findings.merge(subsample::run(run)?); //     scans, poses      -> keyframes
    findings.merge(label::run(run)?); //         keyframes         -> labelled pairs
    findings.merge(featurize::run(run)?); //     keyframes         -> features
    findings.merge(train::run(run)?); //         pairs, features   -> models, scores
    findings.merge(evaluate::run(run)?); //      scores            -> tables, report
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
        Stage::Train => train::run,
        Stage::Evaluate => evaluate::run,
    }
}
