//! Many tiny logs: what planning, doing and merging a task costs, for two numbers of tasks.
//!
//! `cargo bench -p loopboost --bench fleet -- 500 10000`
//!
//! The tasks are done by one process for every 1000 of them. The time per task must not grow with their number. The
//! memory is the largest that a process had in use.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

use std::fs;
use std::io::{Read, Seek};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Tasks of one process.
const TASKS_OF_PROCESS: usize = 1000;

fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|arg| arg.parse().ok()).collect();
    let numbers = if numbers.is_empty() { vec![100, 1000] } else { numbers };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let simulate = "seed = 1\n[simulate]\nlength_m = 2.0\npeople = 0\nlogs = [\"tiny\"]\n";
    fs::write(at("simulate.toml"), simulate).expect("a file");
    run(&["simulate", path(&at("simulate.toml")), "--out", path(&at("made"))]);
    let base = fs::read(at("made/logs/tiny.mcap")).expect("a log");
    println!("a log has {} bytes", small_log(&base, 0).len());
    println!("{:>8} {:>12} {:>12} {:>10} {:>12}", "tasks", "plan/task", "task", "merge", "memory");
    for n in numbers {
        let data = at(&format!("data-{n}"));
        for k in 0..n {
            let file = data.join(format!("{:03}/log-{k:05}.mcap", k / 100));
            fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
            fs::write(file, small_log(&base, k)).expect("a file");
        }
        let pipeline = format!(
            "name = \"tiny\"\n[ingest]\nlogs = [\"data-{n}\"]\npose.topic = \"/ground_truth\"\n[subsample]\nspacing_m = 0.1\n"
        );
        fs::write(at("fleet.toml"), pipeline).expect("a file");
        let out = at(&format!("out-{n}"));
        let planned = run(&["plan", path(&at("fleet.toml")), "--out", path(&out)]);
        let plan = planned.stdout.trim();
        let n_processes = n.div_ceil(TASKS_OF_PROCESS);
        let mut seconds = Duration::ZERO;
        let mut memory = planned.memory_mb;
        for k in 0..n_processes {
            let (index, of) = (k.to_string(), n_processes.to_string());
            let done = run(&["task", path(&out), "--plan", plan, "--index", &index, "--of", &of]);
            seconds += done.time;
            memory = memory.max(done.memory_mb);
        }
        let merged = run(&["merge", path(&out), "--plan", plan]);
        println!(
            "{n:>8} {:>9.3} ms {:>9.3} ms {:>8.3} s {:>9.0} MB",
            planned.time.as_secs_f64() * 1e3 / n as f64,
            seconds.as_secs_f64() * 1e3 / n as f64,
            merged.time.as_secs_f64(),
            memory.max(merged.memory_mb)
        );
    }
}

fn path(path: &Path) -> &str {
    path.to_str().expect("text")
}

/// The first messages of a log, and a message that makes its bytes differ from those of the others.
fn small_log(base: &[u8], k: usize) -> Vec<u8> {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).expect("a writer");
    let metadata = mcap::records::Metadata {
        name: "number".to_owned(),
        metadata: [("k".to_owned(), k.to_string())].into(),
    };
    writer.write_metadata(&metadata).expect("metadata");
    let messages = mcap::MessageStream::new(base).expect("a log");
    let mut first_ns = None;
    for message in messages {
        let message = message.expect("a message");
        let since_ns = message.log_time - *first_ns.get_or_insert(message.log_time);
        if since_ns < 1_500_000_000 {
            writer.write(&message).expect("a message");
        }
    }
    writer.finish().expect("the end");
    writer.into_inner().into_inner()
}

/// A finished process.
struct Finished {
    stdout: String,
    time: Duration,
    memory_mb: f64,
}

fn run(args: &[&str]) -> Finished {
    let mut printed = tempfile::tempfile().expect("a file");
    let start = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_loopboost"))
        .args(args)
        .stdout(Stdio::from(printed.try_clone().expect("a file")))
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    let status_file = format!("/proc/{}/status", child.id());
    let mut memory_mb = 0.0f64;
    let status = loop {
        let text = fs::read_to_string(&status_file).unwrap_or_default();
        let largest = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kb = largest.and_then(|kb| kb.trim().trim_end_matches(" kB").parse::<f64>().ok());
        memory_mb = memory_mb.max(kb.unwrap_or_default() / 1024.0);
        match child.try_wait().expect("a status") {
            Some(status) => break status,
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let time = start.elapsed();
    assert!(status.success(), "{args:?}: {status}");
    let mut stdout = String::new();
    printed.rewind().expect("a file");
    printed.read_to_string(&mut stdout).expect("text");
    Finished { stdout, time, memory_mb }
}
