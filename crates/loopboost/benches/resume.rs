//! A log is added to ten: what the next run costs, beside the least it has to do.
//!
//! `cargo bench -p loopboost --bench resume`
//!
//! The least is the stages that see one log, for that log alone, and the stages that see all logs, each done by force.
//! Both are whole processes on the same logs, in turn.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const RUNS: usize = 5;
const LOG_STAGES: [&str; 3] = ["ingest", "subsample", "featurize"];
const GLOBAL_STAGES: [&str; 3] = ["label", "train", "evaluate"];

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let names: Vec<String> = (0..11).map(|k| format!("\"day-{k:02}\"")).collect();
    let simulate =
        format!("seed = 1\n[simulate]\nlength_m = 200.0\nlogs = [{}]\n", names.join(", "));
    fs::write(at("simulate.toml"), simulate).expect("a file");
    run(&["simulate"], &at("simulate.toml"), &at("all"));
    let pipeline = "[ingest]\nlogs = [\"logs\"]\nsite = \"b\"\npose.topic = \"/ground_truth\"\n";
    fs::write(at("drive.toml"), pipeline).expect("a file");
    let alone = pipeline.replace("[\"logs\"]", "[\"all/logs/day-10.mcap\"]");
    fs::write(at("alone.toml"), alone).expect("a file");

    let (mut resumed, mut least) = (Vec::new(), Vec::new());
    for _ in 0..RUNS {
        let _ = fs::remove_dir_all(at("logs"));
        let _ = fs::remove_dir_all(at("out"));
        fs::create_dir(at("logs")).expect("a folder");
        let add = |k: usize| {
            let name = format!("day-{k:02}.mcap");
            fs::copy(at("all/logs").join(&name), at("logs").join(&name)).expect("a copy");
        };
        (0..10).for_each(add);
        run(&["run"], &at("drive.toml"), &at("out"));
        add(10);
        resumed.push(run(&["run"], &at("drive.toml"), &at("out")));

        let one: Duration =
            LOG_STAGES.iter().map(|stage| run(&[stage], &at("alone.toml"), &at("alone"))).sum();
        let mut forced = vec!["run"];
        forced.extend(GLOBAL_STAGES.iter().flat_map(|stage| ["--force", stage]));
        // Nothing has changed: what this does are the global stages, and the check of the rest,
        // which is taken off.
        let checked = run(&["run"], &at("drive.toml"), &at("out"));
        let global = run(&forced, &at("drive.toml"), &at("out"));
        least.push(one + global.saturating_sub(checked));
    }
    let (resumed, least) = (median(resumed), median(least));
    println!("eleven logs of 200 m, median of {RUNS}:");
    println!("  run after one log was added to ten       {resumed:>10.3?}");
    println!("  that log alone and the global stages     {least:>10.3?}");
    println!(
        "  ratio                                    {:>10.2}",
        resumed.as_secs_f64() / least.as_secs_f64()
    );
}

fn run(command: &[&str], pipeline: &Path, out: &Path) -> Duration {
    let start = Instant::now();
    let status = Command::new(env!("CARGO_BIN_EXE_loopboost"))
        .arg(command[0])
        .arg(pipeline)
        .arg("--out")
        .arg(out)
        .args(&command[1..])
        .stdout(Stdio::null())
        .status()
        .expect("the program starts");
    assert!(status.success());
    start.elapsed()
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}
