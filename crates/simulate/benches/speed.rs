//! Measures how many times faster than real time a drive with one HDL-32E at 10 Hz is simulated.
//!
//! Run it with `cargo bench -p simulate --bench speed`. It uses as many threads as there are cores, or
//! `RAYON_NUM_THREADS`.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

use std::fs::File;
use std::io::BufWriter;
use std::time::Instant;

use simulate::{Campus, Lasers, Options, write_drive};

fn main() {
    // Two durations show whether time and memory grow in proportion to the length of the drive.
    for duration_s in [60.0, 600.0] {
        for (buildings, lasers) in [(1, Lasers::All), (7, Lasers::All), (7, Lasers::Three)] {
            let logs = vec!["drive".to_owned()];
            let speed_m_s = 1.6;
            let length_m = speed_m_s * duration_s;
            let options =
                Options { logs, buildings, lasers, length_m, speed_m_s, ..Options::default() };
            let built = Instant::now();
            let campus = Campus::new(&options, 2436).expect("options are in range");
            let build_s = built.elapsed().as_secs_f64();
            let path = std::env::temp_dir().join(format!("speed-{}.mcap", std::process::id()));
            let out = BufWriter::new(File::create(&path).expect("a temporary file"));
            let started = Instant::now();
            let summary = write_drive(&campus, 0, 0, out).expect("written");
            let took_s = started.elapsed().as_secs_f64();
            let megabytes = std::fs::metadata(&path).expect("a file").len() as f64 * 1e-6;
            std::fs::remove_file(&path).expect("removed");
            println!(
                "{buildings} building(s), {lasers:?} lasers, {duration_s:.0} s of driving: built in {build_s:.2} s, written in {took_s:.2} s ({:.1} x real time), {megabytes:.0} MB, {} packets, peak memory {}",
                duration_s / took_s,
                summary.packets,
                peak_memory()
            );
        }
    }
}

/// Peak memory of this process, if the system reports it (Linux).
fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.map_or("unknown".to_owned(), |value| value.trim().to_owned())
}
