//! The whole pipeline, as the README draws it.

use anyhow::Result;
use dataset::Dropped;

use crate::run::Run;
use crate::stages::{evaluate, featurize, ingest, label, simulate, subsample, train};

/// log.mcap -> report.html
pub(crate) fn run(run: &Run) -> Result<Dropped> {
    let mut dropped = Dropped::default();
    if run.config.simulate.is_some() {
        simulate::run(run)?; // a campus, a robot      -> logs
    }
    dropped.merge(ingest::run(run)?); //    logs                   -> scans, poses
    dropped.merge(subsample::run(run)?); // scans, poses           -> keyframes
    label::run(run)?; //                    keyframes              -> labelled pairs
    featurize::run(run)?; //                keyframes              -> features
    train::run(run)?; //                    pairs, features        -> models, scores
    evaluate::run(run)?; //                 scores                 -> tables, report
    Ok(dropped)
}
