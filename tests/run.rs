//! The whole pipeline on simulated logs.

use std::collections::BTreeSet;

use dataset::tables::{read_pairs, read_poses};
use dataset::{Label, ScanId};

use crate::support::{self, Workplace, loopboost, root};

const PIPELINE: &str = r#"
name = "drive"
seed = 7

[simulate]
logs = ["there", "back"]
length_m = 160.0
people = 3

[ingest]
site = "building"
pose.topic = "/ground_truth"

[label]
pairs_per_class = 150

[train]
rounds = 20

[evaluate]
groupings = ["pair", "scan"]
"#;

const STAGES: [&str; 7] =
    ["simulate", "ingest", "subsample", "label", "featurize", "train", "evaluate"];

#[test]
fn the_bytes_depend_on_the_seed_and_not_on_the_threads_or_the_commands() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command_with_threads("run", "one", &[], 1).expect(0);
    let expected = workplace.files("one");
    for name in [
        "logs/there.mcap",
        "scans/there.parquet",
        "poses/back.parquet",
        "keyframes/there.parquet",
        "keyframes/back.parquet",
        "pairs.parquet",
        "features/there.parquet",
        "feature_stability.parquet",
        "scores.parquet",
        "rounds.parquet",
        "retrieval.parquet",
        "grid.parquet",
        "feature_usefulness.parquet",
        "models/drive-discrete/1.0.0/model.json",
        "models/drive-gentle_line/1.0.0/model.json",
        "models/drive-gentle_stump/1.0.0/model.json",
        "evaluation/summary.parquet",
        "evaluation/summary.json",
        "evaluation/errors.parquet",
        "evaluation/precision_recall.parquet",
        "evaluation/selection.parquet",
        "evaluation/mistakes.parquet",
        "evaluation/figures/error-curve-scan.svg",
        "evaluation/figures/ground-1.svg",
        "evaluation/figures/match-1.svg",
        "report.html",
    ] {
        assert!(expected.contains_key(name), "{name} is missing");
    }
    let same = |out: &str| {
        let found = workplace.files(out);
        assert_eq!(expected.keys().collect::<Vec<_>>(), found.keys().collect::<Vec<_>>());
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "{name} of `{out}` has other bytes");
        }
    };
    workplace.command_with_threads("run", "two", &[], 2).expect(0);
    same("two");
    workplace.command_with_threads("run", "eight", &[], 8).expect(0);
    same("eight");
    for stage in STAGES {
        workplace.command(stage, "by-stage", &[]).expect(0);
    }
    same("by-stage");
    // A second run in the same folder changes nothing and adds no model version.
    let again = workplace.command("run", "two", &[]).expect(0);
    assert!(again.stdout.lines().all(|line| line.ends_with("(unchanged)")), "{}", again.stdout);
    same("two");

    workplace.command("run", "other", &["--set", "seed=8"]).expect(0);
    let other = workplace.files("other");
    for name in [
        "logs/there.mcap",
        "pairs.parquet",
        "models/drive-discrete/1.0.0/model.json",
        "report.html",
    ] {
        assert!(other[name] != expected[name], "{name} does not depend on the seed");
    }
}

#[test]
fn pairs_obey_the_label_rules() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &["--set", "label.min_travel_gap_m=5"]).expect(0);
    let out = |name: &str| workplace.path("out").join(name);
    let keyframes = support::keyframes(&out(""));
    let (pairs, provenance) = read_pairs(&out("pairs.parquet"), &keyframes).unwrap();
    assert_eq!(provenance.options["min_travel_gap_m"], 5.0);
    let inputs: Vec<_> = provenance.inputs.keys().collect();
    assert_eq!(inputs, ["keyframes/back.parquet", "keyframes/there.parquet"]);
    let count = |label| pairs.iter().filter(|pair| pair.label == label).count();
    assert_eq!((count(Label::Positive), count(Label::Negative)), (150, 150));
    let unique: BTreeSet<_> = pairs.iter().map(|pair| (pair.query, pair.reference)).collect();
    assert_eq!(unique.len(), 300);

    // Positions from the poses, not from the keyframes.
    let trajectories = ["there", "back"]
        .map(|log| (log, read_poses(&out(&format!("poses/{log}.parquet"))).unwrap().0));
    let position = |k: usize| {
        let keyframe = &keyframes[k];
        let (_, trajectory) =
            trajectories.iter().find(|(log, _)| *log == &*keyframe.id.log).unwrap();
        trajectory.pose_at(keyframe.stamp_ns, i64::MAX).unwrap()
    };
    for pair in &pairs {
        // The query is of the later log, or later in its log.
        let [query, reference] = [pair.query, pair.reference].map(|k| &keyframes[k].id);
        let order = |id: &ScanId| (&*id.log != "there", keyframes.iter().position(|k| k.id == *id));
        assert!(order(reference) < order(query));
        let distance_m = position(pair.query).distance_m(&position(pair.reference));
        assert!((distance_m - pair.distance_m).abs() < 1e-9);
        match pair.label {
            Label::Positive => {
                assert!(distance_m <= 1.5);
                let (a, b) = (&keyframes[pair.query], &keyframes[pair.reference]);
                assert!(a.id.log != b.id.log || 5.0 <= (a.travel_m - b.travel_m).abs());
            }
            Label::Negative => assert!(50.0 < distance_m),
        }
    }
    for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
        for step in of_log.windows(2) {
            let moved_m = step[0].pose.distance_m(&step[1].pose);
            assert!((0.5..0.75).contains(&moved_m), "{moved_m}");
            assert!((step[1].travel_m - step[0].travel_m - moved_m).abs() < 1e-9);
        }
    }
    let features = support::features(&out(""));
    assert_eq!((features.names.len(), features.ids.len()), (16, keyframes.len()));
    assert!(features.values.iter().all(|value| value.is_finite()));
}

#[test]
fn results_go_to_stdout_and_the_report_opens_offline() {
    let workplace = Workplace::new(PIPELINE);
    let finished = workplace.command("run", "out", &[]).expect(0);
    // Progress is printed to terminals only, so only notes are left, and none is a warning.
    for line in finished.stderr.lines() {
        assert!(line.starts_with("info["), "{line}");
    }
    for stage in STAGES {
        assert!(finished.stdout.lines().any(|line| line.starts_with(stage)), "{stage}");
    }
    let report = String::from_utf8(workplace.files("out")["report.html"].clone()).unwrap();
    for part in [
        "id=\"error-curve-pair\"",
        "id=\"precision-recall-scan\"",
        "id=\"retrieval\"",
        "id=\"first-rounds\"",
        "id=\"false-alarm-1\"",
        "id=\"ground-1\"",
        "Selected features",
        "Map of site building",
    ] {
        assert!(report.contains(part), "{part}");
    }
    // The report opens offline and has no script.
    for part in ["http://", "https://", "<script", "src=", "@import", "url("] {
        assert!(!report.contains(part), "{part}");
    }
}

#[test]
fn the_printed_configuration_gives_the_same_logs_as_the_file() {
    let workplace = Workplace::new(PIPELINE);
    let pipeline = workplace.path("drive.toml");
    let printed = loopboost(&["run", pipeline.to_str().unwrap(), "--print-config"]).expect(0);
    for default in ["spacing_m = 0.5", "positive_radius_m = 1.5", "gate_m = 2.5", "folds = 10"] {
        assert!(printed.stdout.contains(default), "{default}:\n{}", printed.stdout);
    }
    workplace.command("simulate", "a", &[]).expect(0);
    std::fs::write(&pipeline, &printed.stdout).unwrap();
    workplace.command("simulate", "b", &[]).expect(0);
    assert_eq!(workplace.files("a"), workplace.files("b"));
}

#[test]
fn every_pipeline_of_the_repository_is_valid() {
    let mut n = 0;
    for entry in std::fs::read_dir(root().join("pipelines")).unwrap() {
        let path = entry.unwrap().path();
        loopboost(&["run", path.to_str().unwrap(), "--print-config"]).expect(0);
        n += 1;
    }
    assert!(n >= 3);
}

#[test]
fn inspect_lists_topics_and_suggests_a_working_pipeline() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("simulate", "out", &[]).expect(0);
    let log = workplace.path("out/logs/there.mcap");
    let log = log.to_str().unwrap();
    let printed = loopboost(&["inspect", log]).expect(0).stdout;
    for text in
        ["/velodyne_packets", "Velodyne HDL-32E", "10.00 revolutions per second", "0 missing"]
    {
        assert!(printed.contains(text), "`{text}` is not in:\n{printed}");
    }
    let (_, fitting) = printed.split_once("suggested pipeline").unwrap();
    let (_, fitting) = fitting.split_once(":\n").unwrap();
    // The printed pipeline and the written one both work and give the same scans.
    std::fs::write(workplace.path("drive.toml"), fitting).unwrap();
    workplace.command("ingest", "printed", &[]).expect(0);
    let written = workplace.path("written.toml");
    let args = ["inspect", log, "--write", written.to_str().unwrap()];
    loopboost(&args).expect(0);
    loopboost(&args).expect(1).says(&["written.toml already exists"]);
    let text = std::fs::read_to_string(&written).unwrap();
    assert!(text.contains("logs = [\"out/logs/there.mcap\"]"), "{text}");
    std::fs::copy(&written, workplace.path("drive.toml")).unwrap();
    workplace.command("ingest", "written", &[]).expect(0);
    workplace.command("subsample", "written", &[]).expect(0);
    assert!(
        workplace.files("printed")["scans/there.parquet"]
            == workplace.files("written")["scans/there.parquet"]
    );
}

#[test]
fn inspect_can_print_json() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("simulate", "out", &[]).expect(0);
    let log = workplace.path("out/logs/there.mcap");
    let printed = loopboost(&["inspect", log.to_str().unwrap(), "--json"]).expect(0).stdout;
    let printed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let topics = printed["survey"]["topics"].as_array().unwrap();
    let topic = |name: &str| topics.iter().find(|topic| topic["topic"] == name).unwrap();
    let packets = &topic("/velodyne_packets")["content"]["packets"];
    assert_eq!(packets["n_missing"], 0);
    assert!((packets["spin_hz"].as_f64().unwrap() - 10.0).abs() < 0.01);
    let poses = &topic("/ground_truth")["content"]["poses"];
    assert!(poses["path_m"].as_f64().unwrap() > 10.0);
    assert_eq!(printed["missing"], serde_json::json!([]));
    assert!(printed["pipeline"].as_str().unwrap().contains("[ingest.lidar]"));
}

/// The pipeline files of the fixtures make the committed logs, also on this machine.
#[test]
fn the_fixtures_are_reproducible() {
    let workplace = Workplace::new("");
    let (pipeline, out) = (root().join("fixtures/corridor.toml"), workplace.path("out"));
    let args = ["simulate", pipeline.to_str().unwrap(), "--out", out.to_str().unwrap()];
    loopboost(&args).expect(0);
    let committed = std::fs::read(root().join("fixtures/corridor.mcap")).unwrap();
    assert!(workplace.files("out")["logs/corridor.mcap"] == committed);
}
