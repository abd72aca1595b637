//! Time to compute the features of scans with 2000 returns, compared with plain numpy. Both use one
//! thread.
//!
//! `cargo bench -p featurize --bench features`
//!
//! `tests/peers/features.py` computes the same features of similar scans. It runs with the Python in
//! `LOOPBOOST_PYTHON`. The two programs run one after the other. (The script can also check the values in a run
//! folder.)

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

#[path = "../../../tests/require.rs"]
mod require;

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use dataset::Scan;
use featurize::{FeatureSet, Featurizer, Options};

const SCANS: usize = 300;
const RETURNS: usize = 2000;
const RUNS: usize = 3;

fn main() {
    let scans: Vec<Scan> = (0..SCANS).map(room).collect();
    let python = require::python_with(&["numpy"]);
    for set in [FeatureSet::Paper16, FeatureSet::Campus] {
        let (mut ours, mut peers) = (Vec::new(), Vec::new());
        for _ in 0..RUNS {
            ours.push(seconds_per_scan(set, &scans));
            peers.extend(python.as_deref().map(|python| time_numpy(python, set)));
        }
        let median = |seconds: &mut Vec<f64>| {
            seconds.sort_by(f64::total_cmp);
            seconds.get(seconds.len() / 2).copied()
        };
        let ours = median(&mut ours).expect("runs");
        println!("{} of {RETURNS} returns, one thread, median of {RUNS}:", set.name());
        println!("  loopboost {:>9.1} us per scan", ours * 1e6);
        if let Some(numpy) = median(&mut peers) {
            println!("  numpy     {:>9.1} us per scan, ratio {:.1}", numpy * 1e6, numpy / ours);
        }
    }
}

fn seconds_per_scan(set: FeatureSet, scans: &[Scan]) -> f64 {
    let mut featurizer = Featurizer::new(&Options { set, ..Options::default() });
    let mut features = vec![0.0; set.feature_names().len()];
    let start = Instant::now();
    for scan in scans {
        featurizer.features(scan, &mut features).expect("usable");
        assert!(features.iter().all(|f| f.is_finite()));
    }
    start.elapsed().as_secs_f64() / scans.len() as f64
}

fn time_numpy(python: &str, set: FeatureSet) -> f64 {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let output = Command::new(python)
        .arg(root.join("tests/peers/features.py"))
        .args(["--time", set.name(), &SCANS.to_string(), &RETURNS.to_string()])
        .env("OMP_NUM_THREADS", "1")
        .output()
        .expect("Python starts");
    String::from_utf8_lossy(&output.stdout).trim().parse().expect("the peer prints seconds")
}

/// A rectangular room, rotated and shifted, with ripples of 2 cm on the walls.
fn room(k: usize) -> Scan {
    let rotation_rad = k as f64 * 0.7;
    let walls: [f64; 4] = std::array::from_fn(|wall| 1.0 + ((k * 7 + wall * 5) % 19) as f64);
    let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
    for i in 0..RETURNS {
        let azimuth = i as f64 / RETURNS as f64 * std::f64::consts::TAU;
        let to_wall = |(wall, distance): (usize, &f64)| {
            let cos = (azimuth - rotation_rad - wall as f64 * std::f64::consts::FRAC_PI_2).cos();
            if 1e-3 < cos { distance / cos } else { 60.0 }
        };
        let r = walls.iter().enumerate().map(to_wall).fold(60.0, f64::min);
        let r = r + 0.02 * ((i * i) as f64 * 0.37).sin();
        scan.x_m.push((r * azimuth.cos()) as f32);
        scan.y_m.push((r * azimuth.sin()) as f32);
    }
    scan
}
