//! Labels from the map of a finished run: `ingest.pose.run`.

use std::collections::BTreeMap;
use std::fs;
use std::sync::OnceLock;

use dataset::tables::{read_graph, read_pairs, read_poses, read_trajectory};
use dataset::{Keyframe, Label, Pair};

use crate::detection::new_drive;
use crate::support::{self, Workplace, loopboost};

const RADIUS_M: f64 = 1.5;
const NEGATIVE_M: f64 = 30.0;

/// The drive that makes the map, with the starting values of the detector.
fn map_pipeline() -> String {
    format!("{}[detect]\n[train]\nlearners = []\n", new_drive())
}

/// Learns from the map in the folder `map`. The log is the one that the first run simulated.
fn learner(more: &str) -> String {
    format!(
        r#"name = "learner"
seed = 7
[ingest]
logs = ["map/logs/friday.mcap"]
pose.run = "map"
[label]
positive_radius_m = {RADIUS_M:?}
negative_min_m = {NEGATIVE_M:?}
min_travel_gap_m = 10.0
pairs_per_class = 150
[train]
learners = ["discrete"]
rounds = 10
[evaluate]
groupings = ["pair"]
{more}"#
    )
}

const TRUTH: &str = "truth = { topic = \"/ground_truth\" }\n";

/// The map, which is made once.
fn map() -> &'static BTreeMap<String, Vec<u8>> {
    static MAP: OnceLock<BTreeMap<String, Vec<u8>>> = OnceLock::new();
    MAP.get_or_init(|| {
        let workplace = Workplace::new(&map_pipeline());
        let made = workplace.command("run", "map", &[]).expect(3);
        assert!(made.stderr.contains("warning[detector_not_trained]"), "{}", made.stderr);
        workplace.files("map")
    })
}

/// A folder with the map, and the pipeline of the learner.
fn with_map() -> Workplace {
    let workplace = Workplace::new(&learner(""));
    for (name, bytes) in map() {
        let path = workplace.path("map").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    workplace
}

/// Without a learner, nothing is labelled.
#[test]
fn a_run_without_learners_only_finds_closures() {
    let has = |name: &str| map().contains_key(name);
    assert!(has("closures.parquet") && has("trajectory.parquet") && has("report.html"));
    assert!(!has("pairs.parquet") && !has("features/friday.parquet") && !has("scores.parquet"));
}

fn pairs_of(workplace: &Workplace, out: &str) -> (Vec<Keyframe>, Vec<Pair>) {
    let keyframes = support::keyframes(&workplace.path(out));
    let (pairs, _) =
        read_pairs(&workplace.path(&format!("{out}/pairs.parquet")), &keyframes).unwrap();
    (keyframes, pairs)
}

/// The values of a note of a task, from `run.json`.
fn note(workplace: &Workplace, out: &str, task: &str, code: &str) -> serde_json::Value {
    let text = fs::read_to_string(workplace.path(&format!("{out}/run.json"))).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let notes = json["tasks"][task]["notes"].as_array().unwrap();
    let is_code = |note: &&serde_json::Value| note.to_string().contains(code);
    notes.iter().find(is_code).unwrap_or_else(|| panic!("no {code} in {notes:?}")).clone()
}

/// The number in a note with this key.
fn number(note: &serde_json::Value, key: &str) -> u64 {
    let text = note.to_string();
    let (_, rest) = text.split_once(&format!("\"{key}\":")).unwrap_or_else(|| panic!("{text}"));
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap()
}

#[test]
fn a_model_learns_from_the_map_of_a_run_and_not_from_the_ground_truth() {
    let workplace = with_map();
    workplace
        .command("run", "blind", &[])
        .expect(0)
        .says(&["info[labels_from_map]", "rest on map 0 of the run map, with"]);
    let (keyframes, pairs) = pairs_of(&workplace, "blind");

    // The poses are those of the map, and each is in the map.
    let (optimized, _) = read_poses(&workplace.path("map/trajectory/friday.parquet")).unwrap();
    for keyframe in &keyframes {
        assert_eq!(optimized.pose_at(keyframe.stamp_ns, 0), Ok(keyframe.pose));
        assert_eq!(keyframe.map, Some(0));
    }
    // Every label is decided.
    assert_eq!(pairs.len(), 300);
    for pair in &pairs {
        let std_m = pair.distance_std_m.unwrap();
        assert!(2f64.sqrt() * label::ALIGNMENT_STD_M <= std_m && std_m < 20.0, "{pair:?}");
        match pair.label {
            Label::Positive => assert!(pair.distance_m + 2.0 * std_m <= RADIUS_M, "{pair:?}"),
            Label::Negative => assert!(NEGATIVE_M <= pair.distance_m - 2.0 * std_m, "{pair:?}"),
        }
    }
    let undecided = note(&workplace, "blind", "label", "undecided_pairs");
    assert!(0 < number(&undecided, "n_positive"), "{undecided}");
    let n_closures = number(&note(&workplace, "blind", "label", "labels_from_map"), "n_closures");
    let (closures, _) =
        dataset::tables::read_closures(&workplace.path("map/closures.parquet")).unwrap();
    let accepted = closures.iter().filter(|closure| closure.is_accepted()).count() as u64;
    assert!(0 < n_closures && n_closures == accepted);
    let report = fs::read_to_string(workplace.path("blind/report.html")).unwrap();
    assert!(report.contains("Basis: the labels of log `friday` rest on map 0 of the run map"));

    // The ground truth is compared with the labels, and changes none of them.
    fs::write(workplace.path("drive.toml"), learner(TRUTH)).unwrap();
    workplace.command("run", "compared", &[]).expect(0).says(&["info[labels_compared]"]);
    let compared = note(&workplace, "compared", "evaluate", "labels_compared");
    assert_eq!(number(&compared, "n_pairs"), 300, "{compared}");
    assert_eq!(number(&compared, "n_wrong"), 0, "{compared}");
    let [blind, seeing] = ["blind", "compared"].map(|out| workplace.files(out));
    let is_learned = |name: &&String| {
        ["pairs.", "keyframes/", "scores.", "models/"].iter().any(|start| name.starts_with(start))
    };
    assert!(blind.keys().filter(is_learned).count() >= 5, "{:?}", blind.keys());
    for name in blind.keys().filter(is_learned) {
        assert!(blind[name] == seeing[name], "{name} depends on the ground truth");
    }

    // A second run has nothing to do.
    fs::write(workplace.path("drive.toml"), learner("")).unwrap();
    let again = workplace.command("run", "blind", &[]).expect(0).stdout;
    assert!(again.lines().all(|line| line.ends_with("(unchanged)")), "{again}");
}

/// The number of the map is that of the run, which refuses a table that it did not write.
#[test]
fn keyframes_have_the_number_of_their_map_in_the_run() {
    let workplace = with_map();
    let path = workplace.path("map/trajectory.parquet");
    let (mut rows, provenance) = read_trajectory(&path).unwrap();
    // As if three other maps came before.
    rows.iter_mut().for_each(|row| row.map += 3);
    dataset::tables::write_trajectory(&path, &provenance, &rows).unwrap();
    workplace.command("ingest", "out", &[]).expect(1).says(&[
        "is not finished",
        "trajectory.parquet is not the file that its map was made with",
        "repeat the command that made the run",
    ]);
    repair(&workplace, "trajectory.parquet");
    workplace.command("run", "out", &[]).expect(0).says(&["rest on map 3 of the run map"]);
    let (keyframes, _) = pairs_of(&workplace, "out");
    assert!(keyframes.iter().all(|keyframe| keyframe.map == Some(3)));
}

/// Stores the digest of a changed table in `run.json` of the map.
fn repair(workplace: &Workplace, table: &str) {
    let path = workplace.path("map/run.json");
    let mut json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let digest = dataset::tables::digest_file(&workplace.path(&format!("map/{table}"))).unwrap();
    json["tasks"]["optimize"]["outputs"][table] = digest.into();
    fs::write(path, json.to_string()).unwrap();
}

#[test]
fn the_graph_has_the_edges_of_the_g2o_file() {
    let workplace = with_map();
    let (edges, _) = read_graph(&workplace.path("map/graph.parquet")).unwrap();
    let text = fs::read_to_string(workplace.path("map/graph.g2o")).unwrap();
    let lines: Vec<Vec<f64>> = text
        .lines()
        .filter_map(|line| line.strip_prefix("EDGE_SE2 "))
        .map(|line| line.split(' ').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert_eq!(edges.len(), lines.len());
    for (edge, cells) in edges.iter().zip(&lines) {
        let pose = edge.reference_from_query;
        assert_eq!([pose.x_m, pose.y_m, pose.heading_rad], cells[2..5]);
        // The covariance is the inverse of the information: their product is the identity.
        let full = |[xx, xy, xh, yy, yh, hh]: [f64; 6]| {
            nalgebra::Matrix3::new(xx, xy, xh, xy, yy, yh, xh, yh, hh)
        };
        let product = full(edge.covariance) * full(cells[5..11].try_into().unwrap());
        assert!((product - nalgebra::Matrix3::identity()).amax() < 1e-6, "{edge:?}");
    }
}

/// Runs a pipeline with options, and checks the exit code and what it says.
fn refused(workplace: &Workplace) -> impl Fn(&str, &str, &[&str], i32, &[&str]) {
    move |pipeline: &str, out: &str, more: &[&str], code: i32, texts: &[&str]| {
        fs::write(workplace.path("drive.toml"), pipeline).unwrap();
        workplace.command("run", out, more).expect(code).says(texts);
    }
}

#[test]
fn a_run_that_does_not_fit_is_refused() {
    let workplace = with_map();
    let refused = refused(&workplace);
    let plain = learner("");

    // No run, or a run that is not finished.
    refused(
        &plain,
        "out",
        &["--set", "ingest.pose.run=nothing"],
        1,
        &["`ingest.pose.run` is `nothing`", "nothing is not a run folder"],
    );
    fs::write(workplace.path("drive.toml"), map_pipeline()).unwrap();
    workplace.command("simulate", "half", &[]).expect(0);
    workplace.command("ingest", "half", &[]).expect(0);
    refused(
        &plain,
        "out",
        &["--set", "ingest.pose.run=half"],
        1,
        &["has no map: `optimize` has not finished in it", "[detect]"],
    );

    // Another log, a log with the same name, and other scans of the log.
    fs::copy(workplace.path("map/logs/friday.mcap"), workplace.path("sunday.mcap")).unwrap();
    let logs = |log: &str| format!("ingest.logs=[{log:?}]");
    refused(
        &plain,
        "out",
        &["--set", &logs("sunday.mcap")],
        1,
        &["has no log `sunday`, expected one of `friday`", "[ingest.log.sunday.pose]"],
    );
    fs::create_dir(workplace.path("other")).unwrap();
    let mut bytes = fs::read(workplace.path("sunday.mcap")).unwrap();
    bytes.push(0);
    fs::write(workplace.path("other/friday.mcap"), bytes).unwrap();
    refused(
        &plain,
        "out",
        &["--set", &logs("other/friday.mcap")],
        1,
        &["friday.mcap is not the log `friday` of the run", "its BLAKE3 digest is"],
    );
    refused(
        &plain,
        "out",
        &["--set", "ingest.lidar.range_max_m=20"],
        1,
        &["`ingest.lidar` differs (range_max_m: 70.0 -> 20.0)"],
    );
}

#[test]
fn a_pipeline_with_contradicting_sources_of_poses_is_refused() {
    let workplace = with_map();
    let refused = refused(&workplace);
    let plain = learner("");

    // A run that would use its own poses, or poses that already contain closures.
    refused(&plain, "map", &[], 2, &["the folder of --out: a run cannot use its own map"]);
    refused(
        &format!("{plain}[detect]\n"),
        "out",
        &[],
        2,
        &["`ingest.pose.run` is set, but loop detection needs the odometry of the logs"],
    );
    refused(
        &plain,
        "out",
        &["--set", "ingest.log.friday.pose.run=half"],
        2,
        &[
            "`ingest.pose.run` is `map` and `ingest.log.friday.pose.run` is `half`",
            "expected the same run for all logs",
        ],
    );
    let two = plain.replace("pose.run = \"map\"", "pose = { run = \"map\", topic = \"/odom\" }");
    refused(&two, "out", &[], 2, &["`ingest.pose` sets `topic` and `run`, expected one of"]);
    refused(
        &plain,
        "out",
        &["--set", "evaluate.truth={run=\"map\"}"],
        2,
        &["`evaluate.truth` sets `run`"],
    );
    refused(&plain, "out", &["--set", "train.learners=[]"], 2, &["`train.learners` is []"]);

    // Nothing of this changed the map.
    refused(&plain, "out", &[], 0, &[]);
    let map = workplace.path("map");
    let verified = loopboost(&["lineage", workplace.path("out/pairs.parquet").to_str().unwrap()]);
    assert_eq!(verified.code, 0, "{}", verified.stderr);
    assert!(verified.stdout.contains("friday.mcap"), "{}", verified.stdout);
    let verified = loopboost(&["verify", map.to_str().unwrap()]).expect(0);
    assert!(!verified.stdout.contains("changed"), "{}", verified.stdout);
}
