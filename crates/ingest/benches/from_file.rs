//! Measures the time from a log on disk to its scans, and to their table. For comparison, it measures
//! the minimum work of any reader: reading the same messages with the `mcap` crate and summing their
//! bytes, with the same number of threads.
//!
//! `cargo bench -p ingest --bench from_file [-- LOG.mcap [LIDAR_TOPIC POSE_TOPIC]]`
//!
//! The default log is `logs/hdl32e-killian.mcap` in the folder `LOOPBOOST_DATA`. The measurements
//! alternate, so a machine that slows down affects all of them. The ratio is that of the medians. Every
//! run must give the same scans and the same sum.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

#[path = "../../../tests/require.rs"]
mod require;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dataset::tables::scans::write_scans;
use dataset::tables::{Provenance, TableError};
use ingest::{IngestError, LidarOptions, Log, Options, PoseOptions};
use rayon::prelude::*;

const RUNS: usize = 7;

fn main() {
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    let Some(log) = args.next().map(PathBuf::from).or_else(killian) else { return };
    let lidar = args.next().unwrap_or_else(|| "/velodyne_packets".to_owned());
    let pose = args.next().unwrap_or_else(|| "/ground_truth".to_owned());
    println!("{}", log.display());
    let folder = tempfile::tempdir().expect("a temporary folder");
    let table = folder.path().join("scans.parquet");
    for threads in [1, std::thread::available_parallelism().map_or(2, usize::from)] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let (mut ours, mut decoded, mut peer) = (Vec::new(), Vec::new(), Vec::new());
        let (mut scans, mut sums) = (Vec::new(), Vec::new());
        for _ in 0..RUNS {
            let (time, sum) = timed(|| pool.install(|| sum_of_messages(&log, [&lidar, &pose])));
            peer.push(time);
            sums.push(sum);
            let (time, n) = timed(|| pool.install(|| to_scans_table(&log, &table, &lidar, &pose)));
            ours.push(time);
            scans.push(n);
            let (time, n) = timed(|| pool.install(|| to_scans(&log, &lidar, &pose)));
            decoded.push(time);
            scans.push(n);
        }
        assert!(scans.iter().all(|n| *n == scans[0]) && sums.iter().all(|s| *s == sums[0]));
        let (ours, decoded, peer) = (median(ours), median(decoded), median(peer));
        let ratio = |ours: Duration| ours.as_secs_f64() / peer.as_secs_f64();
        println!("{threads} threads, median of {RUNS}:");
        println!("  mcap crate, sum of the bytes {peer:>10.3?}   sum {}", sums[0]);
        println!("  file -> scans                {decoded:>10.3?}   ratio {:.2}", ratio(decoded));
        println!("  file -> scans table          {ours:>10.3?}   ratio {:.2}", ratio(ours));
        println!("  scans                        {:>10}", scans[0]);
    }
    if let Some(peak) = peak_memory_kb() {
        println!("peak memory of this process: {} MB", peak / 1024);
    }
}

fn killian() -> Option<PathBuf> {
    const KILLIAN: &str = "logs/hdl32e-killian.mcap";
    Some(require::shared_data(&[KILLIAN])?.join(KILLIAN))
}

fn options(lidar: &str, pose: &str) -> Options {
    Options {
        lidar: LidarOptions { topic: lidar.to_owned(), ..LidarOptions::default() },
        pose: Some(PoseOptions::of_topic(pose)),
    }
}

fn to_scans(log: &Path, lidar: &str, pose: &str) -> usize {
    let log = Log::open(log).expect("a log");
    let take = |_| Ok::<_, IngestError>(());
    ingest::ingest(&[&log], &options(lidar, pose), take, |_| ()).expect("an intact log").n_scans
}

fn to_scans_table(log: &Path, table: &Path, lidar: &str, pose: &str) -> usize {
    let options = options(lidar, pose);
    let log = Log::open(log).expect("a log");
    write_scans(table, &Provenance::default(), "log", |writer| {
        let ingested = ingest::ingest(
            &[&log],
            &options,
            |scans| Ok::<_, Failed>(writer.push(scans)?),
            |_| (),
        )?;
        assert!(!ingested.trajectory.poses().is_empty());
        Ok::<_, Failed>(ingested.n_scans)
    })
    .expect("an intact log")
}

/// Reads the file, then its chunks in parallel.
fn sum_of_messages(log: &Path, topics: [&str; 2]) -> u64 {
    let bytes = std::fs::read(log).expect("a log");
    let summary = mcap::Summary::read(&bytes).expect("readable").expect("a summary");
    summary
        .chunk_indexes
        .par_iter()
        .map(|index| {
            let messages = summary.stream_chunk(&bytes, index).expect("a chunk");
            messages
                .map(|message| message.expect("a message"))
                .filter(|message| topics.contains(&message.channel.topic.as_str()))
                .map(|message| message.data.iter().map(|&byte| u64::from(byte)).sum::<u64>())
                .sum::<u64>()
        })
        .sum()
}

fn timed<T>(work: impl FnOnce() -> T) -> (Duration, T) {
    let start = Instant::now();
    let value = work();
    (start.elapsed(), value)
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}

/// Peak of the resident set (Linux).
fn peak_memory_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[derive(Debug)]
#[allow(dead_code, reason = "shown by `expect`")]
enum Failed {
    Table(TableError),
    Ingest(IngestError),
}

impl From<TableError> for Failed {
    fn from(error: TableError) -> Self {
        Self::Table(error)
    }
}

impl From<IngestError> for Failed {
    fn from(error: IngestError) -> Self {
        Self::Ingest(error)
    }
}
