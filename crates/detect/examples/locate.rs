//! Locates a drive in the map of another drive, and compares the positions with the ground truth.
//!
//! ```text
//! cargo run --release -p detect --example locate -- RUN MAP_LOG LOG [--starts N [--seed K] [--elsewhere]] [--odometry] [--model FILE]
//! ```
//!
//! `RUN` is a run folder with the scans, the map and the ground truth of both logs. Without `--starts`, the
//! whole drive is located. With it, the search begins at N random scans, and ends with the first position or
//! after 20 m of driving. A position is wrong if it is more than 1 m or 8 deg from the truth: the pose of
//! the lidar relative to the nearest pose of the map is compared with the same relative pose by ground truth.
//! So errors of the map farther away do not count.
//!
//! With `--elsewhere`, the map is only that of the western half of the drive, and the searches begin in the eastern half, at
//! least 30 m from the map: each position that they find is wrong.

#![allow(clippy::print_stdout, reason = "an example prints its results")]

use std::error::Error;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use dataset::tables::scans::{read_scan_headers, read_scans};
use dataset::tables::{TableError, read_poses, read_registered};
use dataset::{LocatedState, Pose2, RangeLimits, Scan, SplitMix64, Trajectory};
use detect::{Locator, LocatorMap, MapDrive, Position};
use model::Detector;
use register::{Drive, RegisterOptions, is_decided};

/// A search ends after this much driving \[m\].
const MOST_M: f64 = 20.0;
/// A scan is near the map if the map has a scan within this distance \[m\].
const NEAR_M: f64 = 3.0;
/// With `--elsewhere`, a search begins at least so far from the map \[m\].
const FAR_M: f64 = 30.0;
const WRONG_M: f64 = 1.0;
const WRONG_DEG: f64 = 8.0;
/// Range limits of a Velodyne HDL-32E \[m\].
const LIMITS: RangeLimits = RangeLimits { min_m: 0.9, max_m: 70.0 };

/// A log of the run.
struct Log {
    folder: PathBuf,
    name: String,
    truth: Trajectory,
}

impl Log {
    fn open(folder: &Path, name: &str) -> Result<Self, TableError> {
        let truth = read_poses(&folder.join(format!("truth/{name}.parquet")))?.0;
        Ok(Self { folder: folder.to_owned(), name: name.to_owned(), truth })
    }

    fn table(&self, kind: &str) -> PathBuf {
        self.folder.join(format!("{kind}/{}.parquet", self.name))
    }

    fn scans(&self, numbers: &[u32]) -> Result<Vec<Scan>, TableError> {
        let mut scans = Vec::new();
        read_scans(&self.table("scans"), numbers, |batch| {
            scans.extend(batch);
            Ok::<_, TableError>(())
        })?;
        Ok(scans)
    }
}

/// The map, and how to tell whether a position in it is right.
struct Known {
    map: LocatorMap,
    poses: Vec<Pose2>,
    truth: Vec<Pose2>,
}

fn known(log: &Log, only_west: bool) -> Result<Known, Box<dyn Error>> {
    let (rows, _) = read_registered(&log.table("registered"))?;
    let (optimized, _) = read_poses(&log.table("trajectory"))?;
    let numbers: Vec<u32> = rows.iter().map(|row| row.id.scan).collect();
    let scans = log.scans(&numbers)?;
    let at = |trajectory: &Trajectory| -> Result<Vec<Pose2>, dataset::NoPose> {
        rows.iter().map(|row| trajectory.pose_at(row.stamp_ns, 1_000_000_000)).collect()
    };
    let (poses, truth) = (at(&optimized)?, at(&log.truth)?);
    let parts = match only_west {
        true => western(&truth),
        false => std::iter::once(0..rows.len()).collect(),
    };
    let drive_of = |part: &Range<usize>| {
        let rows = &rows[part.clone()];
        Drive::of_scans(
            scans[part.clone()].iter().collect(),
            rows.iter().map(|row| row.odometry).collect(),
            rows.iter().map(|row| row.pose).collect(),
            rows.iter().map(|row| row.is_keyframe).collect(),
            rows.iter().map(|row| is_decided(row.near_share, row.weakness)).collect(),
            RegisterOptions::default().limits(LIMITS),
        )
    };
    let drives: Vec<Drive> = parts.iter().map(drive_of).collect();
    let of_map =
        |(drive, part): (_, &Range<usize>)| MapDrive { drive, poses: &poses[part.clone()], map: 0 };
    let of_map: Vec<MapDrive<'_>> = drives.iter().zip(&parts).map(of_map).collect();
    let map = LocatorMap::new(&of_map, 2.5, 5.0);
    let in_map =
        |poses: &[Pose2]| parts.iter().flat_map(|part| poses[part.clone()].to_vec()).collect();
    Ok(Known { map, poses: in_map(&poses), truth: in_map(&truth) })
}

/// The parts of a drive in the western half of its poses.
fn western(truth: &[Pose2]) -> Vec<Range<usize>> {
    let middle_m = quantile(&mut truth.iter().map(|pose| pose.x_m).collect::<Vec<_>>(), 0.5);
    let is_west = |k: usize| truth[k].x_m < middle_m;
    let starts = (0..truth.len()).filter(|&k| is_west(k) && (k == 0 || !is_west(k - 1)));
    starts
        .map(|start| start..(start..truth.len()).find(|&k| !is_west(k)).unwrap_or(truth.len()))
        .collect()
}

impl Known {
    /// Error of a position \[m, rad\].
    fn error(&self, position: &Position, truth: &Pose2) -> (f64, f64) {
        let distance_m = |k: &usize| self.poses[*k].distance_m(&position.pose);
        let nearest = (0..self.poses.len()).min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
        let k = nearest.unwrap_or_default();
        let expected = self.truth[k] * (self.poses[k].inverse() * position.pose);
        (expected.distance_m(truth), expected.heading_difference_rad(truth))
    }

    fn is_wrong(&self, position: &Position, truth: &Pose2) -> bool {
        let (off_m, off_rad) = self.error(position, truth);
        WRONG_M < off_m || WRONG_DEG.to_radians() < off_rad
    }
}

/// The value at a share of the sorted values.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1) as f64;
    values.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
}

/// Resident memory of the process \[MB\], on Linux.
fn memory_mb(key: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with(key))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

/// The scans of a drive with what is known about them.
struct Queries {
    log: Log,
    truth: Vec<Pose2>,
    /// Driven by ground truth up to each scan \[m\].
    path_m: Vec<f64>,
    /// Poses by odometry, or none.
    odometry: Option<Vec<Pose2>>,
}

impl Queries {
    fn open(log: Log, with_odometry: bool) -> Result<Self, Box<dyn Error>> {
        let (headers, _) = read_scan_headers(&log.table("scans"))?;
        let at = |trajectory: &Trajectory| -> Result<Vec<Pose2>, dataset::NoPose> {
            headers.iter().map(|h| trajectory.pose_at(h.stamp_ns, 1_000_000_000)).collect()
        };
        let truth = at(&log.truth)?;
        let odometry = match with_odometry {
            true => Some(at(&read_poses(&log.table("poses"))?.0)?),
            false => None,
        };
        let mut path_m = vec![0.0; truth.len()];
        for k in 1..truth.len() {
            path_m[k] = path_m[k - 1] + truth[k - 1].distance_m(&truth[k]);
        }
        Ok(Self { log, truth, path_m, odometry })
    }

    fn step(&self, k: usize) -> Option<Pose2> {
        let odometry = self.odometry.as_ref()?;
        let before = odometry.get(k.checked_sub(1)?)?;
        Some(before.inverse() * odometry[k])
    }
}

/// What came of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Outcome {
    Right,
    Wrong,
    None,
}

/// Searches from a scan on. Adds the path until the first position, and the time of each scan.
fn search(
    known: &Known,
    queries: &Queries,
    detector: &Detector,
    scans: Range<usize>,
    [first_m, times_ms]: [&mut Vec<f64>; 2],
) -> Result<Outcome, Box<dyn Error>> {
    let numbers: Vec<u32> = scans.clone().map(|k| k as u32).collect();
    let from = scans.start;
    let mut locator = Locator::new(&known.map, detector, &RegisterOptions::default(), LIMITS);
    for (k, scan) in scans.zip(&queries.log.scans(&numbers)?) {
        let begin = Instant::now();
        locator.add(scan, if k == from { None } else { queries.step(k) });
        times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        let Some(position) = locator.position() else { continue };
        first_m.push(queries.path_m[k] - queries.path_m[from]);
        if !known.is_wrong(&position, &queries.truth[k]) {
            return Ok(Outcome::Right);
        }
        let (off_m, off_rad) = known.error(&position, &queries.truth[k]);
        let off_deg = off_rad.to_degrees();
        println!("wrong by {off_m:.2} m, {off_deg:.1} deg, confidence {:.2}", position.confidence);
        return Ok(Outcome::Wrong);
    }
    Ok(Outcome::None)
}

fn starts(
    known: &Known,
    queries: &Queries,
    detector: &Detector,
    n: usize,
    seed: u64,
    only_elsewhere: bool,
) -> Result<(), Box<dyn Error>> {
    let mut random = SplitMix64::new(seed);
    let last_m = queries.path_m.last().copied().unwrap_or_default() - MOST_M;
    let n_possible = queries.path_m.partition_point(|&m| m < last_m);
    let (mut outcomes, mut first_m, mut times_ms) = (Vec::new(), Vec::new(), Vec::new());
    let is_elsewhere = |from: usize| {
        let to_map_m = known.truth.iter().map(|pose| pose.distance_m(&queries.truth[from]));
        FAR_M < to_map_m.fold(f64::INFINITY, f64::min)
    };
    if only_elsewhere && !(0..n_possible).any(is_elsewhere) {
        return Err(format!("no scan is more than {FAR_M} m from the map").into());
    }
    while outcomes.len() < n {
        let from = (random.unit() * n_possible as f64) as usize;
        if only_elsewhere && !is_elsewhere(from) {
            continue;
        }
        let to = queries.path_m.partition_point(|&m| m <= queries.path_m[from] + MOST_M);
        let outcome = search(known, queries, detector, from..to, [&mut first_m, &mut times_ms])?;
        let is_near =
            |k: &usize| known.truth.iter().any(|t| t.distance_m(&queries.truth[*k]) < NEAR_M);
        let n_near = (from..to).filter(is_near).count();
        outcomes.push((outcome, to - from <= 2 * n_near));
        if outcome != Outcome::Right {
            let pose = queries.truth[from];
            println!("start at scan {from} ({:.0}, {:.0}): {outcome:?}", pose.x_m, pose.y_m);
        }
    }
    for (of, only_near) in [("starts", false), ("starts with half of the scans near the map", true)]
    {
        let counted = outcomes.iter().filter(|(_, is_near)| *is_near || !only_near);
        let found: Vec<Outcome> = counted.map(|(outcome, _)| *outcome).collect();
        let [n_right, n_wrong, n_none] = [Outcome::Right, Outcome::Wrong, Outcome::None]
            .map(|kind| found.iter().filter(|outcome| **outcome == kind).count());
        println!("{} {of}: {n_right} right, {n_wrong} wrong, {n_none} none", found.len());
    }
    println!(
        "first position after: median {:.1} m, p99 {:.1} m",
        quantile(&mut first_m, 0.5),
        quantile(&mut first_m, 0.99)
    );
    print_times(&mut times_ms);
    Ok(())
}

fn whole(known: &Known, queries: &Queries, detector: &Detector) -> Result<(), Box<dyn Error>> {
    let mut locator = Locator::new(&known.map, detector, &RegisterOptions::default(), LIMITS);
    let (mut times_ms, mut errors_m, mut nees) = (Vec::new(), Vec::new(), Vec::new());
    let (mut n_wrong, mut n_lost, mut state) = (0, 0, LocatedState::Searching);
    let all: Vec<usize> = (0..queries.truth.len()).collect();
    for block in all.chunks(256) {
        let numbers: Vec<u32> = block.iter().map(|&k| k as u32).collect();
        for (&k, scan) in block.iter().zip(&queries.log.scans(&numbers)?) {
            let begin = Instant::now();
            let next = locator.add(scan, queries.step(k));
            times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
            if next != state {
                println!("scan {k}, {:.1} m: {next:?}", queries.path_m[k]);
                n_lost += usize::from(next == LocatedState::Lost);
                state = next;
            }
            if let Some(position) = locator.position() {
                let (off_m, _) = known.error(&position, &queries.truth[k]);
                errors_m.push(off_m);
                nees.push(
                    off_m * off_m / (position.covariance[(0, 0)] + position.covariance[(1, 1)]),
                );
                n_wrong += usize::from(known.is_wrong(&position, &queries.truth[k]));
            }
        }
    }
    println!(
        "{} of {} scans located, {n_wrong} wrong, lost {n_lost} times",
        errors_m.len(),
        queries.truth.len()
    );
    println!(
        "error: median {:.3} m, p99 {:.3} m; squared error / variance: median {:.2}",
        quantile(&mut errors_m, 0.5),
        quantile(&mut errors_m, 0.99),
        quantile(&mut nees, 0.5)
    );
    print_times(&mut times_ms);
    Ok(())
}

fn print_times(times_ms: &mut [f64]) {
    println!(
        "time per scan: median {:.1} ms, p99 {:.1} ms, most {:.1} ms",
        quantile(times_ms, 0.5),
        quantile(times_ms, 0.99),
        quantile(times_ms, 1.0)
    );
    if let Some((now, most)) = memory_mb("VmRSS").zip(memory_mb("VmHWM")) {
        println!("memory: {now:.0} MB now, {most:.0} MB at most");
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut seed = 7;
    let (mut n_starts, mut with_odometry, mut elsewhere) = (None, false, false);
    let mut names = Vec::new();
    let mut detector = Detector::starting_values();
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--starts" => n_starts = Some(arguments.next().ok_or("--starts needs N")?.parse()?),
            "--seed" => seed = arguments.next().ok_or("--seed needs a number")?.parse()?,
            "--odometry" => with_odometry = true,
            "--elsewhere" => elsewhere = true,
            "--model" => {
                let model = model::load(Path::new(&arguments.next().ok_or("--model needs FILE")?))?;
                detector = model.detector.ok_or("the model has no detector")?;
            }
            _ => names.push(argument),
        }
    }
    let [run, map_log, log] = names.as_slice() else {
        return Err("expected RUN MAP_LOG LOG".into());
    };
    if elsewhere && n_starts.is_none() {
        return Err("--elsewhere needs --starts N".into());
    }
    let known = known(&Log::open(Path::new(run), map_log)?, elsewhere)?;
    let mb = memory_mb("VmRSS").unwrap_or(f64::NAN);
    println!("map: {} places, {mb:.0} MB", known.map.n_places());
    let queries = Queries::open(Log::open(Path::new(run), log)?, with_odometry)?;
    match n_starts {
        Some(n) => starts(&known, &queries, &detector, n, seed, elsewhere),
        None => whole(&known, &queries, &detector),
    }
}
