use anyhow::Result;
use dataset::tables::{Provenance, write_candidates};
use dataset::{CandidateClosure, RegisteredScan, ScanId};
use detect::{Candidate, Places, find_candidates};
use optimize::Proposal;

use crate::config::usage;
use crate::drives::{RegisteredDrive, closure_row, registered_drives};
use crate::findings::Findings;
use crate::run::{Done, Run};
use crate::scorer::Scorer;
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Registered scans -> candidates.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Detect)?;
    if run.model.is_none() {
        check_registered(run)?;
        // Without a model there is no classifier, and the features are not used.
        task.inputs.retain(|input| *input != run.path_of(Artifact::Features));
    }
    run.task(&task, |provenance| detect(run, &provenance))
}

/// Without `--model`, the command is the stage alone.
fn check_registered(run: &Run) -> Result<()> {
    if run.is_dry() {
        return Ok(());
    }
    for log in run.ingested_logs()? {
        let path = run.path_of_log(Artifact::Registered, &log.name);
        if !path.exists() {
            return Err(usage(format!(
                "{} does not exist; to find loop closures in logs, name a model with `--model MODEL.json`; to run the stage `detect` alone, run `{}` first",
                path.display(),
                Stage::Register.command()
            )));
        }
    }
    Ok(())
}

fn detect(run: &Run, provenance: &Provenance) -> Result<Done> {
    let model = run.model.as_ref().filter(|_| run.goal.has(Artifact::Features));
    let scorer = model.map(|used| Scorer::new(run, &used.model)).transpose()?;
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
    let scorer =
        scorer.filter(|scorer| ids.first().is_some_and(|first| scorer.can_score(&first.log)));
    // Places are keyframes, and every keyframe has features.
    let classify = |a: usize, b: usize| {
        scorer.and_then(|scorer| scorer.score(ids[a], ids[b])).unwrap_or_default()
    };
    let classify: Option<detect::Classify<'_>> = scorer.is_some().then_some(&classify);
    let candidates = find_candidates(&drive, &places, run.detector(), options.min_path_m, classify);
    Found { n_places: places.scans.len(), candidates }
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
