//! Measures training and scoring against scikit-learn's AdaBoostClassifier, on one thread each.
//!
//! `cargo bench -p train --bench learners`
//!
//! Trains 50 rounds of Discrete AdaBoost on 100,000 pairs x 16 features and scores a million pairs
//! with them. The peer does the same on similar data (`tests/peers/learners.py`, run by the Python in
//! `LOOPBOOST_PYTHON`). The two programs take turns. A second part shows how the cost of training
//! grows with the number of pairs.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

#[path = "../../../tests/require.rs"]
mod require;

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use dataset::{Label, SplitMix64};
use train::Matrix;

const FEATURES: usize = 16;
const ROUNDS: u32 = 50;
const RUNS: usize = 3;

fn main() {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    one.install(|| {
        compare("train", 100_000, |data| fit(model::Learner::Discrete, data));
        let rounds =
            train::fit(model::Learner::Discrete, ROUNDS, &random_pairs(2000)).expect("rounds");
        let classifier = train::classifier(model::Learner::Discrete, &rounds);
        compare("score", 1_000_000, |data| {
            let start = Instant::now();
            let confidences = classifier.score_columns(data.columns());
            let seconds = start.elapsed().as_secs_f64();
            let wrong = confidences.iter().zip(data.labels());
            let wrong = wrong.filter(|(c, l)| Label::from_confidence(**c, 0.0) != **l).count();
            // The two classes overlap. A random guess is wrong half of the time.
            assert!(wrong * 4 < data.n_rows(), "{wrong}");
            seconds
        });
        for learner in [model::Learner::Discrete, model::Learner::LogitTrees] {
            for n in [10_000, 100_000, 1_000_000] {
                let seconds = fit(learner, &random_pairs(n));
                let per_pair = seconds / n as f64 / f64::from(ROUNDS) * 1e9;
                let name = learner.name();
                println!(
                    "{name:<12} {n:>9} pairs {seconds:>8.2} s, {per_pair:.0} ns per pair and round"
                );
            }
        }
    });
}

fn fit(learner: model::Learner, data: &Matrix) -> f64 {
    let start = Instant::now();
    let rounds = train::fit(learner, ROUNDS, data).expect("both classes");
    assert_eq!(rounds.len(), ROUNDS as usize);
    start.elapsed().as_secs_f64()
}

/// Prints the median time of this crate and of the peer.
fn compare(what: &str, n_pairs: usize, run: impl Fn(&Matrix) -> f64) {
    let data = random_pairs(n_pairs);
    let python = require::python_with(&["numpy", "sklearn"]);
    let (mut ours, mut peers) = (Vec::new(), Vec::new());
    for _ in 0..RUNS {
        ours.push(run(&data));
        peers.extend(python.as_deref().map(|python| peer(python, what, n_pairs)));
    }
    let median = |seconds: &mut Vec<f64>| {
        seconds.sort_by(f64::total_cmp);
        seconds.get(seconds.len() / 2).copied()
    };
    let ours = median(&mut ours).expect("runs");
    println!("{what} {n_pairs} pairs x {FEATURES}, T = {ROUNDS}, one thread, median of {RUNS}:");
    println!("  loopboost    {ours:>9.4} s, {:.1} M pairs/s", n_pairs as f64 / ours * 1e-6);
    if let Some(peer) = median(&mut peers) {
        println!("  scikit-learn {peer:>9.4} s, ratio {:.1}", peer / ours);
    }
}

fn peer(python: &str, what: &str, n_pairs: usize) -> f64 {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let output = Command::new(python)
        .arg(root.join("tests/peers/learners.py"))
        .args([&format!("--time-{what}"), &n_pairs.to_string(), &FEATURES.to_string()])
        .env("OMP_NUM_THREADS", "1")
        .output()
        .expect("Python starts");
    String::from_utf8_lossy(&output.stdout).trim().parse().expect("the peer prints seconds")
}

/// Differences that overlap: those of negative pairs are twice as wide as those of positive pairs.
fn random_pairs(n_pairs: usize) -> Matrix {
    let mut random = SplitMix64::new(7);
    let mut uniform = || random.unit() - 0.5;
    // The sum of four uniform numbers is close enough to a normal one.
    let mut normal = || (0..4).map(|_| uniform()).sum::<f64>().abs();
    let labels: Vec<Label> =
        (0..n_pairs).map(|k| if k % 2 == 0 { Label::Positive } else { Label::Negative }).collect();
    let scale = |label: &Label| if *label == Label::Positive { 1.0 } else { 2.0 };
    let columns = (0..FEATURES)
        .map(|_| labels.iter().map(|label| normal() * scale(label)).collect())
        .collect();
    Matrix::new(columns, labels)
}
