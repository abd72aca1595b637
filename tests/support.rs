//! Runs the program in temporary folders, for the whole-program tests.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use dataset::tables::{FeatureTable, read_features, read_keyframes};
use dataset::{Keyframe, Trajectory};

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A finished run of the program.
pub struct Finished {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// Runs the program.
pub fn loopboost(args: &[&str]) -> Finished {
    loopboost_with_threads(args, 2)
}

/// Runs the program with a number of threads.
pub fn loopboost_with_threads(args: &[&str], threads: usize) -> Finished {
    let Output { status, stdout, stderr } =
        Command::new(assert_cmd::cargo::cargo_bin!("loopboost"))
            .args(args)
            .env("RAYON_NUM_THREADS", threads.to_string())
            .output()
            .expect("the program starts");
    Finished {
        code: status.code().expect("the program exits by itself"),
        stdout: String::from_utf8(stdout).expect("text"),
        stderr: String::from_utf8(stderr).expect("text"),
    }
}

/// A temporary folder with a pipeline file, and room for run folders.
pub struct Workplace {
    folder: tempfile::TempDir,
}

impl Workplace {
    pub fn new(pipeline: &str) -> Self {
        let workplace = Self { folder: tempfile::tempdir().expect("a temporary folder") };
        fs::write(workplace.path("drive.toml"), pipeline).expect("a file");
        workplace
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a command of the program with the pipeline and the run folder `out`.
    pub fn command(&self, command: &str, out: &str, more: &[&str]) -> Finished {
        self.command_with_threads(command, out, more, 2)
    }

    pub fn command_with_threads(
        &self,
        command: &str,
        out: &str,
        more: &[&str],
        threads: usize,
    ) -> Finished {
        let (pipeline, out) = (self.path("drive.toml"), self.path(out));
        let mut args = vec![command, pipeline.to_str().unwrap(), "--out", out.to_str().unwrap()];
        args.extend(more);
        loopboost_with_threads(&args, threads)
    }

    /// The files of a run folder by name.
    pub fn files(&self, out: &str) -> BTreeMap<String, Vec<u8>> {
        let mut files = BTreeMap::new();
        let mut folders = vec![self.path(out)];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(self.path(out)).expect("within");
                    let bytes = fs::read(&path).expect("readable");
                    files.insert(name.to_str().expect("text").to_owned(), bytes);
                }
            }
        }
        files
    }
}

impl Finished {
    /// Checks the exit code.
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, code, "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        self
    }

    /// Checks that stderr contains each text.
    pub fn says(self, texts: &[&str]) -> Self {
        for text in texts {
            assert!(self.stderr.contains(text), "`{text}` is not in:\n{}", self.stderr);
        }
        self
    }
}

/// The tables of a folder with one table per log, sorted by name.
fn tables(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut tables: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    tables.sort();
    tables
}

/// The keyframes of a run, log by log, in the order of their names.
pub fn keyframes(run: &Path) -> Vec<Keyframe> {
    let tables = tables(&run.join("keyframes"));
    tables.iter().flat_map(|path| read_keyframes(path).expect("keyframes").0).collect()
}

/// The features of a run, in the same order.
pub fn features(run: &Path) -> FeatureTable {
    let mut all = FeatureTable::default();
    for path in tables(&run.join("features")) {
        let (of_log, _) = read_features(&path).expect("features");
        all.names = of_log.names;
        all.ids.extend(of_log.ids);
        all.values.extend(of_log.values);
    }
    all
}

/// The distance between the last poses, if the first ones are laid over each other, and the length
/// of the true path, both \[m\].
pub fn drift(truth: &Trajectory, fused: &Trajectory) -> (f64, f64) {
    let both: Vec<_> = truth
        .poses()
        .iter()
        .filter_map(|t| Some((t.pose, fused.pose_at(t.stamp_ns, 100_000_000).ok()?)))
        .collect();
    let (first, last) = (both[0], both[both.len() - 1]);
    let map_from_fused = first.0 * first.1.inverse();
    let drift_m = (map_from_fused * last.1).distance_m(&last.0);
    let path_m = both.windows(2).map(|pair| pair[0].0.distance_m(&pair[1].0)).sum();
    (drift_m, path_m)
}
