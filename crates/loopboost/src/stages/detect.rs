use std::collections::BTreeSet;

use anyhow::Result;
use dataset::tables::{Provenance, write_candidates};
use dataset::{CandidateClosure, RegisteredScan, ScanClosure};
use detect::{Candidate, Places, find_candidates, find_candidates_between};
use optimize::Proposal;
use register::Drive;

use crate::config::usage;
use crate::drives::closure_row;
use crate::findings::Findings;
use crate::known_map::KnownMap;
use crate::logs::LogFile;
use crate::run::{Done, Run};
use crate::scorer::Scorer;
use crate::site_drives::SiteDrives;
use crate::stage::{Artifact, Stage};
use crate::summary::Summary;

/// Registered scans -> candidates.parquet
pub(crate) fn run(run: &Run) -> Result<Findings> {
    let mut task = run.task_of(Stage::Detect)?;
    task.inputs.extend(KnownMap::inputs(run)?);
    if run.model.is_none() {
        check_registered(run)?;
        // Without a model there is no classifier, and the features are not used.
        task.inputs.retain(|input| !input.starts_with(run.path("features")));
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
    let finder = Finder { run, scorer: scorer.as_ref() };
    let mut done = Done::default();
    let mut rows = Vec::new();
    for site in SiteDrives::of_run(run)? {
        let site = site?;
        let found = finder.candidates(&site);
        run.scan_cache.check()?;
        done.summaries.extend(found.summaries(&site));
        rows.extend(found.rows);
    }
    done.notes = scorer.iter().flat_map(|scorer| scorer.notes.clone()).collect();
    let path = run.path_of(Artifact::Candidates);
    let provenance = Provenance { notes: done.notes.clone(), ..provenance.clone() };
    write_candidates(&path, &provenance, &rows)?;
    done.outputs.push(path);
    Ok(done)
}

/// What finds candidates.
struct Finder<'a> {
    run: &'a Run,
    scorer: Option<&'a Scorer<'a>>,
}

/// The candidates of a site.
struct Found {
    rows: Vec<CandidateClosure>,
    /// Number of places of each drive.
    n_places: Vec<usize>,
}

impl Finder<'_> {
    /// The candidates within each new drive of a site, and then those between its drives.
    fn candidates(&self, site: &SiteDrives) -> Found {
        let options = self.run.config.detection();
        let detector = self.run.detector();
        let mut found = Found { rows: Vec::new(), n_places: Vec::new() };
        let (mut drives, mut parts) = (Vec::new(), Vec::new());
        for (k, registered) in site.drives.iter().enumerate() {
            let drive = registered.drive();
            let known_poses = site.known_poses.get(k);
            let poses = known_poses.unwrap_or(&drive.poses);
            let of_drive = Places::new(&drive, poses, options.place_step_m, options.place_half_m);
            if known_poses.is_none() {
                let min_path_m = options.min_path_m;
                let candidates = self.with_classifier(&registered.rows, |classify| {
                    find_candidates(&drive, &of_drive, detector, min_path_m, classify)
                });
                found.rows.extend(candidates.iter().map(|found| row(&registered.rows, found)));
            }
            found.n_places.push(of_drive.scans.len());
            if 1 < site.drives.len() {
                parts.push(of_drive.into_part());
                drives.push(drive);
            }
        }
        if 1 < drives.len() {
            let drive = Drive::joined(drives);
            let places = Places::joined(&drive, parts);
            let rows = site.rows();
            let candidates = self.with_classifier(&rows, |classify| {
                find_candidates_between(&drive, &places, detector, site.n_known().max(1), classify)
            });
            found.rows.extend(candidates.iter().map(|found| row(&rows, found)));
        }
        found
    }

    /// Finds candidates with the confidence of the classifier for pairs of rows, if it can score the logs
    /// of all rows.
    fn with_classifier(
        &self,
        rows: &[RegisteredScan],
        find: impl Fn(Option<detect::Classify<'_>>) -> Vec<Candidate>,
    ) -> Vec<Candidate> {
        let logs: BTreeSet<&str> = rows.iter().map(|row| &*row.id.log).collect();
        let is_usable = |scorer: &&Scorer<'_>| logs.iter().all(|log| scorer.can_score(log));
        let Some(scorer) = self.scorer.filter(is_usable) else { return find(None) };
        // Places are keyframes, and every keyframe has features.
        let score = |a: usize, b: usize| scorer.score(&rows[a].id, &rows[b].id).unwrap_or_default();
        find(Some(&score))
    }
}

impl Found {
    /// What was found in each log, and between the drives of the site.
    fn summaries(&self, site: &SiteDrives) -> Vec<Summary> {
        let drive_of = site.drive_of();
        let is_within = |c: &&ScanClosure| drive_of.get(&c.query) == drive_of.get(&c.reference);
        let closures = || self.rows.iter().map(|row| &row.closure);
        let of_log = |log: &LogFile| {
            let is_of_log = |c: &&ScanClosure| c.query.log == log.name;
            let drives = site.drives.iter().zip(&self.n_places);
            let of_log = drives
                .filter(|(drive, _)| drive.rows.first().is_some_and(|row| row.id.log == log.name));
            Summary::Detected {
                log: log.name.to_string(),
                n_places: of_log.map(|(_, n)| *n as u64).sum(),
                n_candidates: closures().filter(is_of_log).filter(is_within).count() as u64,
            }
        };
        let mut summaries: Vec<Summary> = site.logs.iter().map(of_log).collect();
        if 1 < site.drives.len() {
            summaries.push(Summary::DetectedBetween {
                site: site.site.clone(),
                n_drives: site.drives.len() as u64,
                n_candidates: closures().filter(|c| !is_within(c)).count() as u64,
            });
        }
        summaries
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
