//! Runs that are repeated, changed, killed, or that run out of disk space.

use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::require::python_with;
use crate::support::{Finished, Workplace, loopboost};

const PIPELINE: &str = r#"
name = "drive"
seed = 7

[simulate]
logs = ["there", "back"]
length_m = 110.0
people = 2

[ingest]
site = "building"
pose.topic = "/ground_truth"

[label]
pairs_per_class = 60

[train]
rounds = 10

[evaluate]
groupings = ["pair", "scan"]
"#;

/// The tasks that a run executed, from the first words of its lines. Lines of other tasks end in
/// `(unchanged)`.
fn done(finished: &Finished) -> Vec<String> {
    let mut done: Vec<String> = finished
        .stdout
        .lines()
        .filter(|line| !line.ends_with("(unchanged)"))
        .map(|line| {
            let mut words = line.split_whitespace();
            let stage = words.next().unwrap_or_default();
            match stage {
                "simulate" | "ingest" | "subsample" | "featurize" => {
                    format!("{stage} {}", words.next().unwrap_or_default().trim_end_matches(':'))
                }
                _ => stage.to_owned(),
            }
        })
        .collect();
    done.dedup();
    done
}

#[test]
fn only_tasks_with_changes_run_again() {
    let workplace = Workplace::new(PIPELINE);
    let run = |more: &[&str]| workplace.command("run", "out", more).expect(0);
    assert_eq!(done(&run(&[])).len(), 11);
    let first = workplace.files("out");
    assert_eq!(done(&run(&[])), [""; 0], "nothing has changed");

    // A label option changes no stage before `label`.
    let after = done(&run(&["--set", "label.positive_radius_m=2"]));
    assert_eq!(after, ["label", "train", "evaluate"]);
    // With the old option, the run finds the old models and adds no version.
    let models = |files: &std::collections::BTreeMap<String, Vec<u8>>| {
        files.keys().filter(|name| name.ends_with("model.json")).count()
    };
    assert_eq!(models(&workplace.files("out")), 6);
    run(&[]);
    let mut back = workplace.files("out");
    assert_eq!(models(&back), 6, "version 1.0.0 is used again");
    back.retain(|name, _| !name.contains("/1.1.0/"));
    assert!(back == first);

    // Files that were changed or removed by hand are made again. Later tasks do not run if the new
    // files equal the old ones.
    fs::remove_file(workplace.path("out/features/there.parquet")).unwrap();
    fs::write(workplace.path("out/poses/back.parquet"), b"spoiled").unwrap();
    assert_eq!(done(&run(&[])), ["ingest back", "featurize there"]);
    assert_eq!(done(&run(&["--force", "label"])), ["label"]);
}

#[test]
fn a_log_added_is_the_only_one_ingested() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("simulate", "out", &[]).expect(0);
    let (_, rest) = PIPELINE.split_once("[ingest]").unwrap();
    fs::write(workplace.path("drive.toml"), format!("[ingest]\nlogs = [\"logs\"]{rest}")).unwrap();
    fs::create_dir(workplace.path("logs")).unwrap();
    let add = |name: &str| {
        let from = workplace.path("out/logs").join(name);
        fs::copy(from, workplace.path("logs").join(name)).unwrap();
    };
    add("there.mcap");
    workplace.command("run", "out", &["--set", "label.pairs_per_class=20"]).expect(0);
    add("back.mcap");
    let after = workplace.command("run", "out", &["--set", "label.pairs_per_class=20"]).expect(0);
    assert_eq!(
        done(&after),
        ["ingest back", "subsample back", "label", "featurize back", "train", "evaluate"]
    );
}

#[test]
fn a_dry_run_shows_what_would_run_and_why_without_running_it() {
    let workplace = Workplace::new(PIPELINE);
    let dry = |more: &[&str]| {
        let mut args = vec!["--dry-run"];
        args.extend(more);
        workplace.command("run", "out", &args).expect(0).stdout
    };
    assert!(dry(&[]).contains("would run: not done yet"));
    assert!(!workplace.path("out").exists());
    workplace.command("run", "out", &[]).expect(0);
    let before = workplace.files("out");
    assert!(dry(&[]).lines().all(|line| line.ends_with("up to date")), "{}", dry(&[]));
    let printed = dry(&["--set", "label.positive_radius_m=2", "--force", "featurize"]);
    for line in [
        "label                    would run: positive_radius_m: 1.5 -> 2.0",
        "featurize                would run: forced",
        "train                    would run if its inputs change: pairs.parquet may change, features/there.parquet may change, features/back.parquet may change, feature_stability.parquet may change",
        "subsample there          up to date",
        "subsample                up to date",
    ] {
        assert!(printed.contains(line), "`{line}` is not in:\n{printed}");
    }
    assert!(workplace.files("out") == before);
}

/// Only `evaluate` uses the number of resamples.
#[test]
fn a_new_number_of_resamples_retrains_nothing() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    let resamples = ["--set", "evaluate.resamples=500"];
    let dry_run = [&["--dry-run"][..], &resamples].concat();
    let planned = workplace.command("run", "out", &dry_run).expect(0).stdout;
    let would_run: Vec<&str> =
        planned.lines().filter(|line| !line.ends_with("up to date")).collect();
    let expected = "evaluate                 would run: evaluate.resamples: 1000 -> 500";
    assert_eq!(would_run, [expected], "{planned}");
    assert_eq!(done(&workplace.command("run", "out", &resamples).expect(0)), ["evaluate"]);
}

#[test]
fn a_run_without_changes_repeats_the_losses() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    // The same logs as files, one of them truncated.
    let log = fs::read(workplace.path("out/logs/there.mcap")).unwrap();
    fs::write(workplace.path("there.mcap"), &log[..log.len() * 9 / 10]).unwrap();
    fs::copy(workplace.path("out/logs/back.mcap"), workplace.path("back.mcap")).unwrap();
    let (_, rest) = PIPELINE.split_once("[ingest]").unwrap();
    let files = format!("[ingest]\nlogs = [\"there.mcap\", \"back.mcap\"]{rest}");
    fs::write(workplace.path("drive.toml"), files).unwrap();
    for _ in 0..2 {
        workplace.command("run", "cut", &[]).expect(3).says(&["1 file cut off at the end"]);
    }
}

/// A run is killed at pseudo-random times and resumed. It ends with the same bytes.
/// `LOOPBOOST_KILLS` sets the number of kills, and makes the test use the quickstart.
#[test]
fn a_killed_run_resumes_to_the_same_bytes() {
    let quickstart = fs::read_to_string(crate::support::root().join("pipelines/quickstart.toml"));
    let workplace = match std::env::var("LOOPBOOST_KILLS") {
        Ok(_) => Workplace::new(&quickstart.unwrap()),
        Err(_) => Workplace::new(PIPELINE),
    };
    let start = std::time::Instant::now();
    workplace.command("run", "whole", &[]).expect(0);
    let whole_ms = start.elapsed().as_millis() as u64;
    let expected = workplace.files("whole");
    let n: u64 = std::env::var("LOOPBOOST_KILLS").map_or(8, |n| n.parse().expect("a number"));
    let (mut n_killed, mut k) = (0, 0);
    // A run that ended before the kill does not count.
    while n_killed < n {
        k += 1;
        assert!(k < 10 * n + 10, "{n_killed} kills in {k} runs");
        let out = workplace.path("killed");
        let mut child = Command::new(assert_cmd::cargo::cargo_bin!("loopboost"))
            .args(["run", workplace.path("drive.toml").to_str().unwrap(), "--out"])
            .arg(&out)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // A pseudo-random time within the run.
        std::thread::sleep(Duration::from_millis((k * 7919 + 37) % (whole_ms * 3 / 4).max(2)));
        n_killed += u64::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        let resumed = workplace.command("run", "killed", &[]).expect(0);
        let found = workplace.files("killed");
        assert!(
            found.keys().eq(expected.keys()),
            "kill {k}: {:?}\n{}",
            found.keys(),
            resumed.stdout
        );
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "kill {k}: {name} has other bytes");
        }
        fs::remove_dir_all(&out).unwrap();
    }
    println!("{n_killed} of {k} runs were killed before their end; all resumed to the same bytes");
}

#[test]
fn a_second_run_in_the_same_folder_is_an_error() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    let lock = fs::File::open(workplace.path("out/.lock")).unwrap();
    lock.lock().unwrap();
    workplace
        .command("run", "out", &[])
        .expect(1)
        .says(&["another run is using", "choose another --out"]);
    drop(lock);
    workplace.command("run", "out", &[]).expect(0);
}

/// A limit on the size of files simulates a full disk. The run leaves no incomplete file, and the next
/// run resumes.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_an_error_and_leaves_no_incomplete_file() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "whole", &[]).expect(0);
    workplace.command("simulate", "out", &[]).expect(0);
    let program = assert_cmd::cargo::cargo_bin!("loopboost");
    // The shell counts blocks of 512 or 1024 bytes; both limits are smaller than a table of scans.
    let script = format!(
        "trap '' XFSZ; ulimit -f 400; exec {} run {} --out {}",
        program.display(),
        workplace.path("drive.toml").display(),
        workplace.path("out").display()
    );
    let output = Command::new("sh").args(["-c", &script]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("cannot write") && stderr.contains("scans"), "{stderr}");
    let left = workplace.files("out");
    assert!(
        !left.keys().any(|name| name.contains("partial") || name.starts_with("scans")),
        "{:?}",
        left.keys()
    );
    workplace.command("run", "out", &[]).expect(0);
    assert!(workplace.files("out") == workplace.files("whole"));
}

#[test]
fn lineage_and_verify_show_the_sources_and_the_changes_of_files() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    let out = workplace.path("out");
    let model = out.join("models/drive-discrete/1.0.0/model.json");
    let verify = || loopboost(&["verify", out.to_str().unwrap()]);
    assert!(verify().expect(0).stdout.contains(" 0 problems"));
    for artifact in [&model, &out.join("report.html"), &out.join("evaluation/errors.parquet")] {
        let printed = loopboost(&["lineage", artifact.to_str().unwrap()]).expect(0).stdout;
        for name in ["keyframes/back.parquet", "scans/there.parquet", "logs/back.mcap", "seed 7"] {
            assert!(printed.contains(name), "{name} is not in:\n{printed}");
        }
        assert!(!printed.contains("options "), "{printed}");
    }
    let pairs = out.join("pairs.parquet");
    let printed = loopboost(&["lineage", pairs.to_str().unwrap(), "--verbose"]).expect(0).stdout;
    assert!(printed.contains("  options {") && printed.contains("positive_radius_m"), "{printed}");
    // Replace a table by one from another run.
    workplace.command("run", "other", &["--set", "label.positive_radius_m=1.2"]).expect(0);
    fs::copy(workplace.path("other/pairs.parquet"), out.join("pairs.parquet")).unwrap();
    fs::remove_file(out.join("report.html")).unwrap();
    let printed = verify().expect(1);
    for line in [
        "pairs.parquet changed after `label` wrote it",
        "report.html is missing (written by `evaluate`)",
        "pairs.parquet changed after `train` read it to write feature_usefulness.parquet, grid.parquet, models/",
    ] {
        assert!(printed.stdout.contains(line), "`{line}` is not in:\n{}", printed.stdout);
    }
    let printed = loopboost(&["lineage", model.to_str().unwrap()]).expect(0).stdout;
    assert!(
        printed.lines().any(|l| l.contains("pairs.parquet") && l.contains("changed since")),
        "{printed}"
    );
    loopboost(&["verify", workplace.path("").to_str().unwrap()])
        .expect(1)
        .says(&["is not a run folder"]);
    loopboost(&["lineage", workplace.path("drive.toml").to_str().unwrap()])
        .expect(1)
        .says(&["has no provenance"]);
}

#[test]
fn models_are_listed_shown_compared_verified_and_exported() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    workplace.command("run", "out", &["--set", "label.positive_radius_m=2"]).expect(0);
    let path = |name: &str| workplace.path("out").join(name).to_str().unwrap().to_owned();
    let (a, b) = (
        path("models/drive-discrete/1.0.0/model.json"),
        path("models/drive-discrete/1.1.0/model.json"),
    );
    let list = loopboost(&["model", "list", &path("")]).expect(0).stdout;
    assert_eq!(list.lines().count(), 6, "{list}");
    let card = loopboost(&["model", "show", &a]).expect(0).stdout;
    assert_eq!(card, fs::read_to_string(path("models/drive-discrete/1.0.0/card.md")).unwrap());
    // A folder with one model is that model.
    let shown =
        loopboost(&["model", "show", &path("models/drive-discrete/1.0.0")]).expect(0).stdout;
    assert_eq!(shown, card);
    let several = ["has 2 models; name one of them", "1.0.0/model.json", "1.1.0/model.json"];
    loopboost(&["model", "show", &path("models/drive-discrete")]).expect(1).says(&several);
    let pipeline = workplace.path("drive.toml").to_str().unwrap().to_owned();
    for (folder, said) in [("models/drive-discrete", &several[..]), ("scans", &["no model.json"])] {
        let arguments = ["detect", &pipeline, "--model", &path(folder), "--out", &path("detected")];
        loopboost(&arguments).expect(1).says(said);
    }
    let diff = loopboost(&["model", "diff", &a, &b]).expect(0).stdout;
    assert!(diff.contains("label_options.positive_radius_m: 1.5 -> 2.0"), "{diff}");
    assert!(loopboost(&["model", "diff", &a, &a]).expect(0).stdout.contains("no difference"));
    loopboost(&["model", "verify", &path("models")]).expect(0);
    for learner in ["discrete", "gentle_line", "gentle_stump"] {
        let model = path(&format!("models/drive-{learner}/1.0.0/model.json"));
        let onnx = path(&format!("{learner}.onnx"));
        loopboost(&["model", "export", &model, "--onnx", &onnx]).expect(0);
        let Some(python) = python_with(&["numpy", "onnx", "onnxruntime"]) else { continue };
        let output = Command::new(python)
            .arg(crate::support::root().join("tests/peers/export.py"))
            .args([&onnx, &model])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        print!("{}", String::from_utf8_lossy(&output.stdout));
    }
    let altered = fs::read_to_string(&a).unwrap().replace("\"seed\": 7", "\"seed\": 8");
    fs::write(&a, altered).unwrap();
    loopboost(&["model", "verify", &a]).expect(1);
    loopboost(&["model", "show", &a]).expect(1).says(&["was altered", "digest"]);
}
