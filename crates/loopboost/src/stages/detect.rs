use std::collections::HashMap;

use anyhow::{Result, anyhow};
use dataset::tables::{FeatureTable, Provenance, read_features, read_keyframes, write_candidates};
use dataset::{CandidateClosure, Keyframe, Note, NoteKind, RegisteredScan, ScanId, Subject};
use detect::{Candidate, Places, find_candidates};
use optimize::Proposal;

use crate::drives::{RegisteredDrive, closure_row, registered_drives};
use crate::findings::Findings;
use crate::run::{Done, Run};
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Registered scans -> candidates.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Detect)?;
    if run.model.is_none() {
        // Without a model there is no classifier, and the features are not used.
        task.inputs.retain(|input| *input != run.path_of(Artifact::Features));
    }
    run.task(&task, |provenance| detect(run, &provenance))
}

fn detect(run: &Run, provenance: &Provenance) -> Result<Done> {
    let scorer = Scorer::of(run)?;
    let mut done = Done::default();
    let mut rows = Vec::new();
    for log in run.ingested_logs()? {
        let (mut n_places, mut n_candidates) = (0, 0);
        for drive in registered_drives(run, &log.name)? {
            let found = candidates_of(run, &drive, scorer.as_ref());
            n_places += found.n_places;
            n_candidates += found.candidates.len();
            rows.extend(found.candidates.iter().map(|found| row(&drive.rows, found)));
        }
        done.summaries.push(Summary::Detected {
            log: log.name.to_string(),
            n_places: n_places as u64,
            n_candidates: n_candidates as u64,
        });
    }
    done.notes = scorer.iter().flat_map(|scorer| scorer.notes.clone()).collect();
    let path = run.path_of(Artifact::Candidates);
    let provenance = Provenance { notes: done.notes.clone(), ..provenance.clone() };
    write_candidates(&path, &provenance, &rows)?;
    done.outputs.push(path);
    Ok(done)
}

struct Found {
    n_places: usize,
    candidates: Vec<Candidate>,
}

fn candidates_of(run: &Run, registered: &RegisteredDrive, scorer: Option<&Scorer<'_>>) -> Found {
    let options = run.config.detection();
    let drive = registered.drive();
    let places = Places::new(&drive, &drive.poses, options.place_step_m, options.place_half_m);
    let ids: Vec<&ScanId> = registered.rows.iter().map(|row| &row.id).collect();
    let scorer = scorer.filter(|scorer| scorer.can_score(ids.first().copied()));
    let classify = |a: usize, b: usize| scorer.map_or(0.0, |scorer| scorer.score(ids[a], ids[b]));
    let classify: Option<detect::Classify<'_>> = scorer.is_some().then_some(&classify);
    let candidates = find_candidates(&drive, &places, run.detector(), options.min_path_m, classify);
    Found { n_places: places.scans.len(), candidates }
}

/// Scores pairs of keyframes with the classifier of the model.
struct Scorer<'a> {
    model: &'a model::Model,
    features: FeatureTable,
    /// The row of each keyframe in the features.
    rows: HashMap<ScanId, usize>,
    /// Logs whose scans are of another kind than those that the model was trained on.
    other_kind: Vec<String>,
    notes: Vec<Note>,
}

impl<'a> Scorer<'a> {
    /// `None` without a model, and if the classifier is not wanted.
    fn of(run: &'a Run) -> Result<Option<Self>> {
        let Some(used) = run.model.as_ref().filter(|_| run.goal.has(Artifact::Features)) else {
            return Ok(None);
        };
        let (features, _) = read_features(&run.path_of(Artifact::Features))?;
        if features.names != used.model.features.names {
            return Err(anyhow!(
                "features.parquet has the columns {}, but {} needs {}; run `loopboost detect` with --model again",
                features.names.join(", "),
                used.path.display(),
                used.model.features.names.join(", ")
            ));
        }
        let rows = features.ids.iter().cloned().zip(0..).collect();
        let (keyframes, _) = read_keyframes(&run.path_of(Artifact::Keyframes))?;
        let (mut other_kind, mut notes) = (Vec::new(), Vec::new());
        for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
            let spec = &used.model.scans;
            let is_other = |k: &&Keyframe| {
                spec.check(k.coverage_deg, dataset::FULL_RING_DEG <= k.coverage_deg).is_err()
            };
            let Some(other) = of_log.iter().find(is_other) else { continue };
            let kind = NoteKind::ClassifierNotUsed {
                model: used.model.name.clone(),
                trained_deg: f64::from(spec.coverage_min_deg),
                found_deg: f64::from(other.coverage_deg),
            };
            notes.push(Note::new(kind, Subject::log(&*other.id.log)));
            other_kind.push(other.id.log.to_string());
        }
        Ok(Some(Self { model: &used.model, features, rows, other_kind, notes }))
    }

    /// Whether the scans of a drive are of the kind that the model was trained on.
    fn can_score(&self, first: Option<&ScanId>) -> bool {
        first.is_some_and(|id| !self.other_kind.iter().any(|log| **log == *id.log))
    }

    /// Confidence of the classifier for two keyframes.
    fn score(&self, a: &ScanId, b: &ScanId) -> f64 {
        let row = |id| self.features.row(self.rows[id]);
        let difference: Vec<f64> = row(a).iter().zip(row(b)).map(|(a, b)| (a - b).abs()).collect();
        self.model.classifier.confidence(&difference)
    }
}

fn row(rows: &[RegisteredScan], found: &Candidate) -> CandidateClosure {
    let proposal = Proposal {
        query: found.query,
        reference: found.reference,
        reference_from_query: found.reference_from_query,
        covariance: found.covariance,
        evidence: found.evidence,
        confidence: found.confidence,
    };
    CandidateClosure { closure: closure_row(rows, &proposal), rank: found.rank }
}
