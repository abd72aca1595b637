//! The whole pipeline, as the README draws it.

use anyhow::Result;
use dataset::Dropped;

use crate::run::Run;
use crate::stage::Stage;
use crate::stages::{evaluate, featurize, ingest, label, simulate, subsample, train};

/// log.mcap -> report.html
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let mut dropped = Dropped::default();
    if run.config.simulate.is_some() {
        dropped.merge(simulate::run(run)?); //  a campus, a robot -> logs
    }
    dropped.merge(ingest::run(run)?); //        logs              -> scans, poses
    dropped.merge(subsample::run(run)?); //     scans, poses      -> keyframes
    dropped.merge(label::run(run)?); //         keyframes         -> labelled pairs
    dropped.merge(featurize::run(run)?); //     keyframes         -> features
    dropped.merge(train::run(run)?); //         pairs, features   -> models, scores
    dropped.merge(evaluate::run(run)?); //      scores            -> tables, report
    Ok(dropped)
}

/// One stage, by its own command.
pub(crate) fn stage(stage: Stage) -> fn(&Run) -> Result<Dropped> {
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
