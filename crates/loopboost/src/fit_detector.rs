//! Fits the detector of each model of a run.

use std::collections::HashMap;

use anyhow::{Result, anyhow};
use dataset::tables::{read_candidates, read_poses, read_registered};
use dataset::{CandidateClosure, Note, NoteKind, ScanClosure, ScanId};
use experiment::{CrossValidation, Data, Setup, held_out_confidences};
use model::{DetectorPart, Model};
use train::Learner;
use train::detector::{FittedDetector, LogEvidence, NotFitted, fit};

use crate::detector_evidence::{LogTables, log_evidence};
use crate::run::Run;
use crate::stage::Artifact;

/// Gives each model a detector, if the run finds loop closures and has ground truth. The notes say which
/// parts could not be fitted.
///
/// The classifier counts with its confidence in pairs that it was not trained on: with that in its
/// training pairs, the verifier would trust it too much.
pub(crate) fn fit_detectors(
    run: &Run,
    setup: &Setup<'_>,
    data: &Data<'_>,
    validation: &CrossValidation,
    models: &mut [Model],
) -> Result<Vec<Note>> {
    if !run.goal.detects() || !run.goal.has(Artifact::Truth) {
        return Ok(Vec::new());
    }
    let logs = evidence_of_logs(run, data)?;
    let mut notes: Vec<Note> = Vec::new();
    for model in models {
        let learner = learner_of(&setup.train.learners, model)?;
        let evidence = with_confidences(&logs, |pairs| {
            Ok(held_out_confidences(setup, data, validation, learner, pairs)?)
        })?;
        let FittedDetector { detector, not_fitted } = fit(&evidence);
        let needed = not_fitted.into_iter().filter(|missing| is_needed(missing, &evidence));
        for note in needed.map(note) {
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
        model.detector = Some(detector);
    }
    Ok(notes)
}

/// The evidence of a log, and the two keyframes of each of its candidates. `None` if the true pose of
/// one of them is not known: the classifier has no fold for it.
struct Log {
    evidence: LogEvidence,
    pairs: Vec<Option<[usize; 2]>>,
}

fn evidence_of_logs(run: &Run, data: &Data<'_>) -> Result<Vec<Log>> {
    let (candidates, _) = read_candidates(&run.path_of(Artifact::Candidates))?;
    let keyframes: HashMap<&ScanId, usize> =
        data.keyframes.iter().map(|keyframe| &keyframe.id).zip(0..).collect();
    let mut logs = Vec::new();
    for log in run.ingested_logs()? {
        // Logs of one site may have ground truth in different frames.
        let is_of_log = |c: &ScanClosure| c.query.log == log.name && c.reference.log == log.name;
        let of_log: Vec<CandidateClosure> =
            candidates.iter().filter(|c| is_of_log(&c.closure)).cloned().collect();
        let pair = |found: &CandidateClosure| {
            let ids = [&found.closure.query, &found.closure.reference];
            let [query, reference] = ids.map(|id| keyframes.get(id).copied());
            query.zip(reference).map(|(query, reference)| [query, reference])
        };
        let pairs = of_log.iter().map(pair).collect();
        let (registered, _) = read_registered(&run.path_of_log(Artifact::Registered, &log.name))?;
        let (odometry, _) = read_poses(&run.poses(&log.name))?;
        let (truth, _) = read_poses(&run.path_of_log(Artifact::Truth, &log.name))?;
        let evidence = log_evidence(&LogTables {
            log: &log.name,
            registered: &registered,
            odometry: &odometry,
            truth: &truth,
            candidates: &of_log,
        });
        logs.push(Log { evidence, pairs });
    }
    Ok(logs)
}

/// The evidence with the confidence of a classifier in each candidate.
fn with_confidences(
    logs: &[Log],
    confidences: impl Fn(&[[usize; 2]]) -> Result<Vec<Option<f64>>>,
) -> Result<Vec<LogEvidence>> {
    let pairs = || logs.iter().flat_map(|log| log.pairs.iter().copied());
    let known: Vec<[usize; 2]> = pairs().flatten().collect();
    let mut confidences = confidences(&known)?.into_iter();
    let mut evidence: Vec<LogEvidence> = logs.iter().map(|log| log.evidence.clone()).collect();
    let candidates = evidence.iter_mut().flat_map(|log| &mut log.candidates);
    for (found, pair) in candidates.zip(pairs()) {
        found.evidence.classifier = pair.and_then(|_| confidences.next().flatten());
    }
    Ok(evidence)
}

/// The learner of a model.
fn learner_of(learners: &[Learner], model: &Model) -> Result<Learner> {
    let of_model = |learner: &&Learner| learner.boosting() == Some(model.classifier.learner);
    learners
        .iter()
        .find(of_model)
        .copied()
        .ok_or_else(|| anyhow!("`train.learners` has no `{}`", model.classifier.learner.name()))
}

/// The error of odometry is not needed where all odometry has covariances.
fn is_needed(missing: &NotFitted, logs: &[LogEvidence]) -> bool {
    missing.part != DetectorPart::Odometry || logs.iter().any(|log| !log.odometry_has_covariance)
}

fn note(missing: NotFitted) -> Note {
    let NotFitted { part, found, expected } = missing;
    NoteKind::DetectorPartNotFitted { part: part.name().to_owned(), found, expected }.into()
}
