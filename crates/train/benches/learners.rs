//! Training and scoring, beside scikit-learn's AdaBoostClassifier, on one thread each.
//!
//! `cargo bench -p train --bench learners`
//!
//! Trains 50 rounds of Discrete AdaBoost on 100,000 pairs x 16 features and scores a million pairs
//! with them; the peer, run by the Python in `LOOPBOOST_PYTHON`, does the same to like data
//! (`tests/peers/learners.py`). Both are run in turn. Then shows how the cost of training grows
//! with the pairs.

#[path = "../../../tests/require.rs"]
mod require;

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use dataset::Label;
use train::Matrix;

const FEATURES: usize = 16;
const ROUNDS: u32 = 50;
const RUNS: usize = 3;

fn main() {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    one.install(|| {
        beside("train", 100_000, |data| fit(model::Learner::Discrete, data));
        let rounds = train::fit(model::Learner::Discrete, ROUNDS, &drawn(2000)).expect("rounds");
        let classifier = train::classifier(model::Learner::Discrete, &rounds);
        beside("score", 1_000_000, |data| {
            let start = Instant::now();
            let confidences = classifier.score_columns(data.columns());
            let seconds = start.elapsed().as_secs_f64();
            let wrong = confidences.iter().zip(data.labels());
            let wrong = wrong.filter(|(c, l)| Label::from_confidence(**c, 0.0) != **l).count();
            // The two classes overlap; whoever guesses is wrong half of the time.
            assert!(wrong * 4 < data.n_rows(), "{wrong}");
            seconds
        });
        for learner in [model::Learner::Discrete, model::Learner::LogitTrees] {
            for n in [10_000, 100_000, 1_000_000] {
                let seconds = fit(learner, &drawn(n));
                let per_pair = seconds / n as f64 / f64::from(ROUNDS) * 1e9;
                let name = learner.name();
                println!(
                    "{name:<12} {n:>9} pairs {seconds:>8.2} s, {per_pair:.0} ns a pair and round"
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

/// The median of our seconds and of the peer's.
fn beside(what: &str, n_pairs: usize, run: impl Fn(&Matrix) -> f64) {
    let data = drawn(n_pairs);
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

/// Differences that tell a little: negatives twice as wide as positives.
fn drawn(n_pairs: usize) -> Matrix {
    let mut state = 7u64;
    // SplitMix64; the sum of four uniform numbers is near enough to a normal one.
    let mut uniform = || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut normal = || (0..4).map(|_| uniform()).sum::<f64>().abs();
    let labels: Vec<Label> =
        (0..n_pairs).map(|k| if k % 2 == 0 { Label::Positive } else { Label::Negative }).collect();
    let scale = |label: &Label| if *label == Label::Positive { 1.0 } else { 2.0 };
    let columns = (0..FEATURES)
        .map(|_| labels.iter().map(|label| normal() * scale(label)).collect())
        .collect();
    Matrix::new(columns, labels)
}
