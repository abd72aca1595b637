//! `locate`: where the scans of logs lie in the map of a finished run.

mod places;
mod speeds;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use clap::Args;
use dataset::tables::{Provenance, digest_file, write_located};
use dataset::{
    LocatedPose, LocatedScan, LocatedState, Losses, Note, NoteKind, Pose2, RangeLimits, Scan,
    ScanId, Subject, Trajectory,
};
use detect::{Locator, Position, ScanSteps};
use ingest::{Ingested, LidarSpeed, Log, Options};
use model::Detector;
use register::RegisterOptions;
use serde::Serialize;
use serde_json::{Value, json};

use crate::config::{Config, usage};
use crate::drives::upper_triangle;
use crate::findings::Findings;
use crate::logs::{LogFile, file_name, find};
use crate::run::progress_bar;
use crate::stages::ingest::open;
use crate::trial::topics;
use crate::used_model::UsedModel;
use places::Places;
use speeds::speeds;

#[derive(Args)]
pub(crate) struct LocateArgs {
    /// The logs: MCAP files, or folders with the files of one split drive
    #[arg(required = true)]
    logs: Vec<PathBuf>,
    /// A run folder with a map: of `detect --model`, or of `run` with a section [detect]
    #[arg(long, value_name = "RUN")]
    map: PathBuf,
    /// Use only the places of this log of the map; can be repeated
    #[arg(long = "map-log", value_name = "NAME")]
    map_logs: Vec<String>,
    /// Read the logs with the `ingest` options of this pipeline, instead of those of the map
    #[arg(long, value_name = "PIPELINE.toml")]
    pipeline: Option<PathBuf>,
    /// The model.json, or a folder with one, whose detector judges how well scans fit; without it, starting values
    #[arg(long, value_name = "MODEL.json")]
    model: Option<PathBuf>,
    /// Use no odometry, even if the logs have it
    #[arg(long)]
    no_odometry: bool,
    /// The table to write
    #[arg(long, value_name = "FILE.parquet", default_value = "located.parquet")]
    out: PathBuf,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// What was found for a log.
#[derive(Serialize)]
struct LocatedLog {
    log: String,
    n_scans: usize,
    n_located: usize,
    n_lost: usize,
    travel_m: f64,
    has_odometry: bool,
    first: Option<First>,
}

/// Where the first position was found.
#[derive(Serialize)]
struct First {
    scan: u32,
    /// Path since the first scan, by scan matching \[m\].
    travel_m: f64,
    /// Time since the first scan \[s\].
    secs: f64,
    map: u32,
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    confidence: f64,
}

/// The scans of a log, with its odometry if it has any.
struct QueryLog {
    scans: Vec<Scan>,
    odometry: Option<Trajectory>,
    losses: Losses,
    notes: Vec<Note>,
}

/// The files of a log, and how they are read.
#[derive(Clone, Copy)]
struct OpenLog<'a> {
    file: &'a LogFile,
    logs: &'a [Log],
    options: &'a Options,
}

/// What came of a log.
struct Located {
    inputs: BTreeMap<String, String>,
    rows: Vec<LocatedScan>,
    summary: LocatedLog,
    findings: Findings,
}

impl LocateArgs {
    pub(crate) fn execute(&self) -> Result<Findings> {
        let config = self.pipeline.as_deref().map(|path| Config::load(path, &[])).transpose()?;
        let model = self.model.as_deref().map(UsedModel::load).transpose()?;
        let detector = match &model {
            Some(used) => used.detector.clone(),
            None => Detector::starting_values(),
        };
        let files = self.files()?;
        let known = Places::read(&self.map, &self.map_logs)?;
        let (mut findings, mut rows, mut found) = (Findings::default(), Vec::new(), Vec::new());
        let (mut inputs, mut failed) = (known.inputs.clone(), Vec::new());
        for file in &files {
            let options = match &config {
                Some(config) => {
                    let of_log = config.for_log(&file.name)?;
                    Options { lidar: of_log.lidar, pose: of_log.pose }
                }
                None => known.options.clone(),
            };
            match self.locate(file, &options, &known, &detector) {
                Ok(located) => {
                    findings.merge(located.findings);
                    inputs.extend(located.inputs);
                    found.push(located.summary);
                    rows.extend(located.rows);
                }
                Err(error) => failed.push((file, error)),
            }
        }
        if found.is_empty() {
            return Err(all_failed(failed));
        }
        findings.notes.extend(failed.iter().map(|(file, error)| {
            let kind = NoteKind::LogNotLocated { reason: format!("{error:#}") };
            in_log(file, kind.into())
        }));
        let provenance = Provenance {
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            seed: None,
            options: json!({
                "map": self.map, "map_logs": self.map_logs, "no_odometry": self.no_odometry,
                "model": model.as_ref().map_or(Value::Null, UsedModel::summary),
            }),
            inputs,
            losses: findings.losses.clone(),
            notes: findings.notes.clone(),
        };
        write_located(&self.out, &provenance, &rows)?;
        self.print(&found)?;
        Ok(findings)
    }

    /// Reads a log and locates its scans.
    fn locate(
        &self,
        file: &LogFile,
        options: &Options,
        known: &Places,
        detector: &Detector,
    ) -> Result<Located> {
        let mut inputs = BTreeMap::new();
        for path in &file.paths {
            inputs.insert(file_name(path), digest_file(path)?);
        }
        let query = self.read(file, options.clone(), &known.register)?;
        check_scans(file, &query.scans, known.coverage_deg)?;
        let rows = locate(file, &query, options, known, detector);
        let summary = summary(file, &rows, query.odometry.is_some());
        let notes = query.notes.into_iter().chain(notes(&summary));
        let findings = Findings {
            losses: query.losses.in_log(&file.name),
            notes: notes.map(|note| in_log(file, note)).collect(),
        };
        Ok(Located { inputs, rows, summary, findings })
    }

    /// The logs, each with a name of its own.
    fn files(&self) -> Result<Vec<LogFile>> {
        let mut files = Vec::new();
        for path in &self.logs {
            if !path.exists() {
                return Err(usage(format!(
                    "{} does not exist, expected an MCAP log or a folder of one",
                    path.display()
                )));
            }
            files.extend(find(Path::new(""), &path.to_string_lossy())?);
        }
        let mut names = BTreeSet::new();
        match files.iter().find(|file| !names.insert(file.name.clone())) {
            Some(twice) => Err(usage(format!(
                "two logs have the name `{}`, and the table could not tell them apart; locate them one by one",
                twice.name
            ))),
            None => Ok(files),
        }
    }

    /// Reads the scans and the odometry of a log. Without odometry, the log is read twice: the second time, the scans
    /// are deskewed by the motion that they showed the first time.
    fn read(
        &self,
        file: &LogFile,
        mut options: Options,
        register: &RegisterOptions,
    ) -> Result<QueryLog> {
        let (logs, lost) = open(file)?;
        if self.no_odometry || !has_odometry(&logs, &options) {
            options.pose = None;
        }
        let log = OpenLog { file, logs: &logs, options: &options };
        let speeds = match options.pose.is_none() && options.lidar.deskew {
            true => {
                let mut matched = ScanSteps::new(register, limits(&options));
                let mut steps = Vec::new();
                self.pass(&log, None, |scans| steps.extend(scans.iter().map(|s| matched.add(s))))?;
                Some(speeds(&steps))
            }
            false => None,
        };
        let mut scans = Vec::new();
        let mut ingested = self.pass(&log, speeds.as_deref(), |batch| scans.extend(batch))?;
        ingested.losses.merge(lost);
        let odometry = options.pose.is_some().then_some(ingested.trajectory);
        Ok(QueryLog { scans, odometry, losses: ingested.losses, notes: ingested.notes })
    }

    /// Reads a log once. `speeds` are those of the lidar during the scans, if they are known.
    fn pass(
        &self,
        log: &OpenLog<'_>,
        speeds: Option<&[Option<LidarSpeed>]>,
        mut take: impl FnMut(Vec<Scan>) + Send,
    ) -> Result<Ingested> {
        let OpenLog { file, logs, options } = *log;
        let n_bytes = logs.iter().map(Log::n_bytes).sum();
        let progress = progress_bar(n_bytes, format!("read {}", file.name), true);
        let logs: Vec<&Log> = logs.iter().collect();
        let take = |batch| {
            take(batch);
            anyhow::Ok(())
        };
        let moved = |position| progress.set_position(position);
        let ingested = match speeds {
            None => ingest::ingest(&logs, options, take, moved),
            Some(speeds) => ingest::ingest_with_speeds(&logs, options, speeds, take, moved),
        };
        progress.finish_and_clear();
        ingested.with_context(|| {
            format!(
                "log `{}` cannot be read with the options of {}; name a pipeline for it with --pipeline",
                file.name,
                self.pipeline.as_ref().unwrap_or(&self.map).display()
            )
        })
    }

    fn print(&self, found: &[LocatedLog]) -> Result<()> {
        if self.json {
            let all = json!({ "map": self.map, "table": self.out, "logs": found });
            out!("{}", serde_json::to_string_pretty(&all)?);
            return Ok(());
        }
        for LocatedLog { log, n_scans, n_located, n_lost, first, .. } in found {
            match first {
                Some(first) => out!(
                    "{log}: {n_located} of {n_scans} scans located, first after {:.1} m and {:.1} s, at ({:.2}, {:.2}) m in map {}; lost {n_lost} times",
                    first.travel_m,
                    first.secs,
                    first.x_m,
                    first.y_m,
                    first.map
                ),
                None => out!("{log}: none of {n_scans} scans located"),
            }
        }
        out!("{}", self.out.display());
        Ok(())
    }
}

/// A note about a log.
fn in_log(file: &LogFile, note: Note) -> Note {
    let log = Some(file.name.to_string());
    Note { subject: Subject { log, ..note.subject }, ..note }
}

/// The error of a single log, or those of all.
fn all_failed(mut failed: Vec<(&LogFile, anyhow::Error)>) -> anyhow::Error {
    if let [_] = failed.as_slice()
        && let Some((_, error)) = failed.pop()
    {
        return error;
    }
    let lines: Vec<String> =
        failed.iter().map(|(file, error)| format!("{}: {error:#}", file.name)).collect();
    anyhow!("no log could be read\n{}", lines.join("\n"))
}

/// Whether logs have all topics of the poses. Poses of files and of other runs are not those of these logs.
fn has_odometry(logs: &[Log], options: &Options) -> bool {
    let Some(pose) = &options.pose else { return false };
    let known: BTreeSet<String> = logs
        .iter()
        .flat_map(|log| log.contents().channels.into_values().map(|channel| channel.topic))
        .collect();
    pose.file.is_none() && pose.run.is_none() && topics(options).iter().all(|t| known.contains(t))
}

/// A scanner sees about the same part of a circle in each scan \[deg\].
const SAME_COVERAGE_DEG: f32 = 20.0;

/// Scans of another kind of scanner cannot be compared with the map.
fn check_scans(file: &LogFile, scans: &[Scan], coverage_deg: f32) -> Result<()> {
    let Some(first) = scans.first() else {
        return Err(anyhow!("log `{}` has no scans", file.name));
    };
    match (first.coverage_deg - coverage_deg).abs() <= SAME_COVERAGE_DEG {
        true => Ok(()),
        false => Err(anyhow!(
            "the scans of log `{}` cover {:.0} deg, those of the map {coverage_deg:.0} deg; a log can only be located in a map that was made with the same kind of scanner",
            file.name,
            first.coverage_deg
        )),
    }
}

/// The steps of the odometry are not used over longer gaps than this \[ns\].
const MAX_GAP_NS: i64 = 1_000_000_000;

fn limits(options: &Options) -> RangeLimits {
    RangeLimits { min_m: options.lidar.range_min_m, max_m: options.lidar.range_max_m }
}

fn locate(
    file: &LogFile,
    query: &QueryLog,
    options: &Options,
    known: &Places,
    detector: &Detector,
) -> Vec<LocatedScan> {
    let mut locator = Locator::new(&known.map, detector, &known.register, limits(options));
    let at = |scan: &Scan| query.odometry.as_ref()?.stamped_pose_at(scan.stamp_ns, MAX_GAP_NS).ok();
    let mut before = None;
    let progress = progress_bar(query.scans.len() as u64, format!("locate {}", file.name), false);
    let rows = (0..).zip(&query.scans).map(|(number, scan)| {
        let now = at(scan);
        let step: Option<Pose2> = before
            .zip(now)
            .filter(|(a, b): &(dataset::StampedPose, dataset::StampedPose)| a.segment == b.segment)
            .map(|(a, b)| a.pose.inverse() * b.pose);
        before = now;
        let state = locator.add(scan, step);
        progress.inc(1);
        LocatedScan {
            id: ScanId { log: file.name.clone(), scan: number },
            stamp_ns: scan.stamp_ns,
            travel_m: locator.path_m(),
            state,
            position: locator.position().map(|position| row_of(&position)),
        }
    });
    let rows = rows.collect();
    progress.finish_and_clear();
    rows
}

fn row_of(position: &Position) -> LocatedPose {
    let Position { map, pose, covariance, confidence } = *position;
    LocatedPose { map, pose, covariance: upper_triangle(&covariance), confidence }
}

fn summary(file: &LogFile, rows: &[LocatedScan], has_odometry: bool) -> LocatedLog {
    let start_ns = rows.first().map_or(0, |row| row.stamp_ns);
    let first = rows.iter().find_map(|row| {
        let LocatedPose { map, pose, confidence, .. } = row.position?;
        Some(First {
            scan: row.id.scan,
            travel_m: row.travel_m,
            secs: (row.stamp_ns - start_ns) as f64 * 1e-9,
            map,
            x_m: pose.x_m,
            y_m: pose.y_m,
            heading_rad: pose.heading_rad,
            confidence,
        })
    });
    let is_lost = |pair: &[LocatedScan]| {
        pair[0].state == LocatedState::Located && pair[1].state == LocatedState::Lost
    };
    LocatedLog {
        log: file.name.to_string(),
        n_scans: rows.len(),
        n_located: rows.iter().filter(|row| row.position.is_some()).count(),
        n_lost: rows.windows(2).filter(|pair| is_lost(pair)).count(),
        travel_m: rows.last().map_or(0.0, |row| row.travel_m),
        has_odometry,
        first,
    }
}

/// What needs attention.
fn notes(found: &LocatedLog) -> Option<Note> {
    let LocatedLog { n_scans, n_located, n_lost, travel_m, first, .. } = found;
    match first {
        None => {
            let n_scans = *n_scans as u64;
            Some(NoteKind::NotLocated { n_scans, travel_m: *travel_m }.into())
        }
        Some(first) if 0 < *n_lost => {
            let n_scans = (n_scans - n_located) as u64 - u64::from(first.scan);
            Some(NoteKind::PositionLost { n: *n_lost as u64, n_scans }.into())
        }
        Some(_) => None,
    }
}
