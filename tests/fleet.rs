//! Work on many machines: `plan`, `task`, `merge` and `gc` give the bytes of `run`, whatever happens to tasks.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime};

use crate::support::{Finished, Workplace, loopboost};

const SIMULATED: &str = r#"
seed = 7
[simulate]
logs = ["one", "two", "three"]
length_m = 60.0
people = 0
"#;

/// All stages that work log by log, and then all others.
const PIPELINE: &str = r#"
name = "fleet"
seed = 7
[ingest]
logs = ["data/logs"]
site = "building"
pose.topic = "/ground_truth"
[label]
pairs_per_class = 40
[detect]
[train]
learners = ["discrete"]
rounds = 5
[evaluate]
groupings = ["pair"]
retrieval = false
resamples = 0
truth = { topic = "/ground_truth" }
"#;

/// Two logs with the same file name, a third one, a copy of it, and a file that is not a log.
fn workplace() -> Workplace {
    static LOGS: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    let logs = LOGS.get_or_init(|| {
        let workplace = Workplace::new(SIMULATED);
        workplace.command("simulate", "out", &[]).expect(0);
        let read = |log| fs::read(workplace.path(&format!("out/logs/{log}.mcap"))).unwrap();
        ["one", "two", "three"].map(read).to_vec()
    });
    let workplace = Workplace::new(PIPELINE);
    for (name, bytes) in [
        ("north/monday", &logs[0][..]),
        ("south/monday", &logs[1]),
        ("west/tuesday", &logs[2]),
        ("west/wednesday", &logs[2]),
        ("broken", b"#ROSBAG V2.0"),
    ] {
        let path = workplace.path(&format!("data/logs/{name}.mcap"));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    workplace
}

/// The tasks of the logs, in the order of the plan.
const LOGS: [&str; 4] = ["broken", "north/monday", "south/monday", "tuesday"];

/// A run folder with a plan.
struct Fleet<'a> {
    workplace: &'a Workplace,
    out: &'a str,
    plan: String,
}

impl<'a> Fleet<'a> {
    fn new(workplace: &'a Workplace, out: &'a str) -> Self {
        let plan = workplace.command("plan", out, &[]).expect(0);
        Self { workplace, out, plan: plan.stdout.trim().to_owned() }
    }

    fn folder(&self) -> PathBuf {
        self.workplace.path(self.out)
    }

    fn args(&self, command: &str, more: &[&str]) -> Vec<String> {
        let folder = self.folder();
        let args = [command, folder.to_str().unwrap(), "--plan", &self.plan];
        args.iter().chain(more).map(|&arg| arg.to_owned()).collect()
    }

    fn command(&self, command: &str, more: &[&str]) -> Finished {
        let args = self.args(command, more);
        loopboost(&args.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn task(&self, index: usize) -> Finished {
        self.command("task", &["--index", &index.to_string()])
    }

    fn merge(&self) -> Finished {
        self.command("merge", &[])
    }

    /// Starts a command, to be killed.
    fn start(&self, command: &str, more: &[&str]) -> Child {
        Command::new(assert_cmd::cargo::cargo_bin!("loopboost"))
            .args(self.args(command, more))
            .env("RAYON_NUM_THREADS", "2")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    }

    fn record(&self, index: usize) -> PathBuf {
        self.folder().join(format!("done/{}/{index}.json", self.plan))
    }

    /// Files in the folders that tasks write to.
    fn n_files(&self) -> usize {
        let mut n_files = 0;
        let mut folders: Vec<PathBuf> =
            ["objects", "done", "keys"].map(|name| self.folder().join(name)).into();
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
                match entry.file_type() {
                    Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                    _ => n_files += 1,
                }
            }
        }
        n_files
    }

    /// An object that the record of a task needs.
    fn object(&self, index: usize, table: &str) -> PathBuf {
        let record: serde_json::Value =
            serde_json::from_slice(&fs::read(self.record(index)).unwrap()).unwrap();
        let tasks = record["tasks"].as_object().unwrap();
        let digest = tasks.values().find_map(|task| task["outputs"][table].as_str());
        self.folder().join("objects").join(digest.unwrap_or_else(|| panic!("no {table}")))
    }
}

/// The files of a run folder, without those of plans and tasks.
fn results(workplace: &Workplace, out: &str) -> BTreeMap<String, Vec<u8>> {
    let mut files = workplace.files(out);
    let of_tasks = ["plan/", "objects/", "done/", "keys/"];
    files.retain(|name, _| !of_tasks.iter().any(|folder| name.starts_with(folder)));
    files
}

/// The files that `run` makes.
fn expected() -> &'static BTreeMap<String, Vec<u8>> {
    static EXPECTED: OnceLock<BTreeMap<String, Vec<u8>>> = OnceLock::new();
    EXPECTED.get_or_init(|| {
        let workplace = workplace();
        workplace.command("run", "whole", &[]).expect(3);
        results(&workplace, "whole")
    })
}

/// Checks the tables of logs after `merge`.
fn assert_merged(fleet: &Fleet<'_>, what: &str) {
    let merged = results(fleet.workplace, fleet.out);
    let mut of_logs = BTreeSet::new();
    for folder in ["scans", "poses", "truth", "keyframes", "features", "registered", "odometry"] {
        for log in &LOGS[1..] {
            of_logs.insert(format!("{folder}/{log}.parquet"));
        }
    }
    let names: BTreeSet<String> =
        merged.keys().filter(|name| name.ends_with(".parquet")).cloned().collect();
    assert_eq!(names, of_logs, "{what}");
    for name in &of_logs {
        assert!(merged[name] == expected()[name], "{what}: {name} has other bytes");
    }
}

/// The same, and all files after a `run` of the rest.
fn assert_same(fleet: &Fleet<'_>, what: &str) {
    assert_merged(fleet, what);
    let rest = fleet.workplace.command("run", fleet.out, &[]).expect(3);
    for line in rest.stdout.lines() {
        let stage = line.split_whitespace().next().unwrap_or_default();
        let is_of_log = ["ingest", "subsample", "featurize", "register"].contains(&stage);
        assert!(!is_of_log || line.ends_with("(unchanged)"), "{what}: {line}");
    }
    let found = results(fleet.workplace, fleet.out);
    assert!(found.keys().eq(expected().keys()), "{what}: {:?}", found.keys());
    for (name, bytes) in expected() {
        assert!(found[name] == *bytes, "{what}: {name} has other bytes");
    }
}

/// Copies a folder with the times of its files.
fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (path, target) = {
            let entry = entry.unwrap();
            (entry.path(), to.join(entry.file_name()))
        };
        if path.is_dir() {
            copy_folder(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
            let changed = fs::metadata(&path).unwrap().modified().unwrap();
            fs::File::options().write(true).open(&target).unwrap().set_modified(changed).unwrap();
        }
    }
}

#[test]
fn tasks_at_two_mount_points_give_the_bytes_of_run() {
    let workplace = workplace();
    let fleet = Fleet::new(&workplace, "fleet");
    let text =
        fs::read_to_string(fleet.folder().join(format!("plan/{}.json", fleet.plan))).unwrap();
    assert!(!text.contains(workplace.path("").to_str().unwrap().trim_end_matches('/')), "{text}");
    assert_eq!(Fleet::new(&workplace, "fleet").plan, fleet.plan, "the same plan");

    // Half of the tasks where the logs are, the others where they and the run folder are mounted elsewhere.
    fleet.task(0).expect(0).says(&["log `broken` left out"]);
    fleet.task(1).expect(0);
    let elsewhere = Workplace::new("");
    copy_folder(&workplace.path("data"), &elsewhere.path("deep/mount/data"));
    copy_folder(&workplace.path("fleet"), &elsewhere.path("other"));
    let root = elsewhere.path("deep/mount");
    let other = Fleet { workplace: &elsewhere, out: "other", plan: fleet.plan.clone() };
    for index in ["2", "3"] {
        let args = ["--index", index, "--root", root.to_str().unwrap()];
        other.command("task", &args).expect(0);
    }
    // Without --root, the logs are not found from there.
    let found = other.command("task", &["--index", "0"]);
    found.expect(0).says(&["done before"]);
    fs::remove_file(other.record(1)).unwrap();
    fs::remove_dir_all(elsewhere.path("other/keys")).unwrap();
    other.task(1).expect(75);
    copy_folder(&elsewhere.path("other"), &fleet.folder());
    assert!(fleet.record(1).exists());

    fleet.merge().expect(0);
    let once = workplace.files("fleet");
    fleet.merge().expect(0);
    assert!(workplace.files("fleet") == once, "a second merge changes nothing");
    assert_same(&fleet, "mount points");
}

/// A task is killed as soon as 1, 2, 3, ... files have appeared in the store, which is after each step of publishing,
/// and repeated. `merge` is killed at pseudo-random times.
#[test]
fn killed_tasks_and_merges_are_repeated_to_the_same_bytes() {
    let workplace = workplace();
    let fleet = Fleet::new(&workplace, "fleet");
    fleet.command("task", &["--index", "0", "--of", "1"]).expect(0);
    let record = fs::read(fleet.record(1)).unwrap();
    // Seven tables and the record. An attempt that ends before it is killed is repeated.
    for n in 1..=8 {
        let is_killed = (0..50).any(|_| {
            for folder in ["objects", "done", "keys"] {
                fs::remove_dir_all(fleet.folder().join(folder)).unwrap();
            }
            let mut child = fleet.start("task", &["--index", "1"]);
            while fleet.n_files() < n && child.try_wait().unwrap().is_none() {}
            child.kill().unwrap();
            let is_killed = !child.wait().unwrap().success();
            for object in fs::read_dir(fleet.folder().join("objects")).unwrap().flatten() {
                let name = object.file_name().into_string().unwrap();
                let digest = blake3::hash(&fs::read(object.path()).unwrap()).to_hex();
                assert!(name.ends_with(".partial") || *name == *digest, "{name} is not complete");
            }
            fleet.task(1).expect(0);
            assert!(fs::read(fleet.record(1)).unwrap() == record, "killed at file {n}");
            is_killed
        });
        assert!(is_killed, "no attempt was killed at file {n}");
    }
    fleet.command("task", &["--index", "0", "--of", "1"]).expect(0);
    for k in 0..6 {
        let mut child = fleet.start("merge", &[]);
        std::thread::sleep(Duration::from_millis(1 + k * 7));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    fleet.merge().expect(0);
    assert_merged(&fleet, "killed");
}

#[test]
fn attempts_at_the_same_time_make_one_record() {
    let workplace = workplace();
    let fleet = Fleet::new(&workplace, "fleet");
    for index in 0..LOGS.len() {
        let start = |_| fleet.start("task", &["--index", &index.to_string()]);
        let attempts: Vec<Child> = (0..3).map(start).collect();
        for mut attempt in attempts {
            assert_eq!(attempt.wait().unwrap().code(), Some(0), "task {index}");
        }
    }
    let done = fs::read_dir(fleet.folder().join(format!("done/{}", fleet.plan))).unwrap();
    assert_eq!(done.count(), LOGS.len());
    fleet.merge().expect(0);
    assert_merged(&fleet, "at the same time");
}

#[test]
fn records_that_are_missing_foreign_altered_or_double_are_found() {
    let workplace = workplace();
    let fleet = Fleet::new(&workplace, "fleet");
    let n = LOGS.len();
    fleet.merge().expect(1).says(&[&format!("{n} of {n} tasks have no record"), "I = 0-3"]);
    fleet.command("task", &["--index", "0", "--of", "2"]).expect(0);
    fleet.merge().expect(1).says(&["2 of 4 tasks have no record", "I = 1,3"]);
    fleet.command("task", &["--index", "1", "--of", "2"]).expect(0);
    fleet.merge().expect(0);

    // The record of another task.
    let good = fs::read(fleet.record(1)).unwrap();
    fs::copy(fleet.record(2), fleet.record(1)).unwrap();
    let found = fleet.merge().expect(1);
    found.says(&["1.json is the record of another task: log `south/monday`", "task 1 again"]);
    // The task has its own result by key, publishes it, and finds the other one in its place.
    fleet.task(1).expect(70).says(&["1.json exists with other bytes", "was kept as"]);
    let kept: Vec<PathBuf> = fs::read_dir(fleet.record(1).parent().unwrap())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_str().unwrap().contains("/1."))
        .collect();
    assert_eq!(kept.len(), 2, "{kept:?}");
    assert!(kept.iter().any(|path| fs::read(path).unwrap() == good));
    fs::remove_file(fleet.record(1)).unwrap();
    fleet.merge().expect(1);
    fleet.task(1).expect(0);
    // The same bytes twice are no conflict.
    fleet.merge().expect(0);

    // An altered record, and one with a table that is not its own.
    for (from, to, says) in [
        ("\"seed\"", "\"sead\"", "was edited"),
        ("\"failed\": null", "\"failed\":  null", "was edited"),
        ("scans/north", "../north", "has a table that is not one of the log"),
        ("\"tasks\"", "\"task s\"", "is damaged"),
    ] {
        let text = String::from_utf8(good.clone()).unwrap();
        let altered = text.replace(from, to);
        if altered == text {
            assert_eq!(from, "\"seed\"", "{from} is not in the record");
            continue;
        }
        fs::write(fleet.record(1), altered).unwrap();
        fleet.merge().expect(1).says(&[says, "do task 1 again"]);
    }
    fs::write(fleet.record(1), &good).unwrap();

    // A file that is no record, and an altered and a missing object, which the task makes again.
    let stray = fleet.record(17);
    fs::write(&stray, &good).unwrap();
    fleet.merge().expect(1).says(&["17.json is not a record of the plan"]);
    fs::remove_file(stray).unwrap();
    let object = fleet.object(1, "scans/north/monday.parquet");
    let mut bytes = fs::read(&object).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::remove_file(&object).unwrap();
    for altered in [Some(&bytes), None] {
        match altered {
            Some(bytes) => fs::write(&object, bytes).unwrap(),
            None => fs::remove_file(&object).unwrap(),
        }
        let found = fleet.merge().expect(1);
        found.says(&["scans/north/monday.parquet, is missing or was altered", "task 1 again"]);
        fleet.task(1).expect(0);
        fleet.merge().expect(0);
    }
    assert_merged(&fleet, "repaired");
}

#[test]
fn an_input_that_was_replaced_is_refused_and_a_new_plan_repeats_only_its_task() {
    let workplace = workplace();
    let fleet = Fleet::new(&workplace, "fleet");
    fleet.command("task", &["--index", "0", "--of", "3"]).expect(0);
    let log = workplace.path("data/logs/south/monday.mcap");
    let bytes = fs::read(&log).unwrap();
    // The same size and another time; another size; missing.
    let before = fs::metadata(&log).unwrap().modified().unwrap();
    let set = |at: SystemTime| {
        fs::File::options().write(true).open(&log).unwrap().set_modified(at).unwrap();
    };
    set(before + Duration::from_secs(1));
    fleet.task(2).expect(75).says(&["monday.mcap differs from the plan", "loopboost plan"]);
    fs::write(&log, &bytes[..bytes.len() - 1]).unwrap();
    set(before);
    fleet.task(2).expect(75).says(&["differs from the plan"]);
    fs::remove_file(&log).unwrap();
    fleet.task(2).expect(75).says(&["differs from the plan: found missing"]);
    assert!(!fleet.record(2).exists());
    fleet.task(1).expect(0);

    // Back, but at another time: another version.
    fs::write(&log, &bytes).unwrap();
    set(before + Duration::from_secs(2));
    let again = Fleet::new(&workplace, "fleet");
    assert_ne!(again.plan, fleet.plan);
    for index in [0, 1, 3] {
        again.task(index).expect(0).says(&["done before, for another plan"]);
    }
    let computed = again.task(2).expect(0);
    assert!(computed.stdout.contains("ingest"), "{}", computed.stdout);
    again.merge().expect(0);
    assert_merged(&again, "replaced");

    // Nothing of the first plan is needed without it.
    let gc = |more: &[&str]| {
        let folder = fleet.folder();
        let args = [&["gc", folder.to_str().unwrap()][..], more].concat();
        loopboost(&args).expect(0).stdout
    };
    fs::write(fleet.folder().join("objects").join("0".repeat(64)), b"unused").unwrap();
    fs::write(fleet.folder().join("objects").join("notes"), b"of somebody").unwrap();
    assert!(gc(&[]).starts_with("0 files"), "files of the last day stay");
    assert!(gc(&["--min-age-hours", "0"]).starts_with("1 files removed, 6 bytes"));
    again.merge().expect(0);
}

#[test]
fn wrong_plans_and_indices_exit_with_2() {
    let workplace = workplace();
    let fleet = Fleet::new(&workplace, "fleet");
    fleet.task(4).expect(2).says(&["the plan has 4 tasks, numbered from 0"]);
    fleet.command("task", &[]).expect(2).says(&["--index", "SLURM_ARRAY_TASK_ID"]);
    let folder = fleet.folder();
    let folder = folder.to_str().unwrap();
    loopboost(&["task", folder, "--plan", "0", "--index", "0"])
        .expect(2)
        .says(&["does not exist", "loopboost plan"]);
    // A folder of another program.
    let foreign = workplace.path("foreign/objects/ab/cdef");
    fs::create_dir_all(foreign.parent().unwrap()).unwrap();
    fs::write(&foreign, "").unwrap();
    let of_others = workplace.path("foreign");
    let gc = ["gc", of_others.to_str().unwrap(), "--min-age-hours", "0"];
    loopboost(&gc).expect(2).says(&["is not a run folder"]);
    assert!(foreign.exists());
    // The index of a batch system.
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("loopboost"));
    let args = fleet.args("task", &[]);
    let status = command.args(args).env("SLURM_ARRAY_TASK_ID", "3").output().unwrap().status;
    assert_eq!(status.code(), Some(0));
    assert!(fleet.record(3).exists());
    // More workers than tasks.
    fleet.command("task", &["--index", "7", "--of", "9"]).expect(0);
    let path = fleet.folder().join(format!("plan/{}.json", fleet.plan));
    let altered = fs::read_to_string(&path).unwrap().replace("north", "nord");
    fs::write(&path, altered).unwrap();
    fleet.task(1).expect(2).says(&["was altered: its BLAKE3 digest is"]);
    fleet.merge().expect(2);
}

/// `detect --model` after a merge: the features and the scan matching are those of the model.
#[test]
fn a_plan_with_a_model_gives_the_bytes_of_detect() {
    let workplace = workplace();
    workplace.command("run", "train", &[]).expect(3);
    let model = workplace.path("train/models/fleet-discrete/1.0.0/model.json");
    let model = ["--model", model.to_str().unwrap()];
    workplace.command("detect", "whole", &model).expect(3);
    let plan = workplace.command("plan", "fleet", &model).expect(0).stdout;
    let fleet = Fleet { workplace: &workplace, out: "fleet", plan: plan.trim().to_owned() };
    fleet.command("task", &["--index", "0", "--of", "1"]).expect(0);
    fleet.merge().expect(0);
    let detected = workplace.command("detect", "fleet", &model).expect(3).stdout;
    let mut registered = detected.lines().filter(|line| line.starts_with("register")).peekable();
    assert!(registered.peek().is_some(), "{detected}");
    for line in registered {
        assert!(line.ends_with("(unchanged)"), "{line}");
    }
    let (whole, found) = (results(&workplace, "whole"), results(&workplace, "fleet"));
    assert!(found.keys().eq(whole.keys()), "{:?}", found.keys());
    for (name, bytes) in &whole {
        assert!(found[name] == *bytes, "{name} has other bytes");
    }
}
