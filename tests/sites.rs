//! Maps of several drives of a site, and drives that are added to the map of a finished run.

use std::fs;

use dataset::tables::{read_closures, read_trajectory};
use dataset::{JudgedClosure, MapPose};

use crate::detection::ODOMETRY;
use crate::support::{Workplace, loopboost};

fn pipeline(ingest: &str, more: &str) -> String {
    format!(
        "name = \"site\"\nseed = 7\n[ingest]\nsite = \"north\"\n{ingest}{ODOMETRY}[train]\nlearners = []\n{more}"
    )
}

const SIMULATE: &str = r#"
[simulate]
logs = ["day-1", "day-2"]
buildings = 1
length_m = 200.0
people = 2
[detect]
[evaluate]
truth = { topic = "/ground_truth" }
"#;

fn trajectory(workplace: &Workplace, out: &str) -> Vec<MapPose> {
    read_trajectory(&workplace.path(&format!("{out}/trajectory.parquet"))).unwrap().0
}

/// The accepted closures between the two days.
fn between(workplace: &Workplace, out: &str) -> Vec<JudgedClosure> {
    let path = workplace.path(&format!("{out}/closures.parquet"));
    let (mut closures, _) = read_closures(&path).unwrap();
    closures.retain(|c| c.is_accepted() && c.closure.query.log != c.closure.reference.log);
    closures
}

/// Two days in one run share a map without a false closure. The second day added to the map of the first
/// one gets the same poses within 5 cm.
#[test]
fn two_days_share_a_map_and_a_day_can_be_added_to_a_finished_map() {
    let workplace = Workplace::new(&pipeline("", SIMULATE));
    let made = workplace.command("run", "both", &[]).expect(3);
    assert!(made.stdout.contains("site north: 2 drives in 1 map"), "{}", made.stdout);
    let together = trajectory(&workplace, "both");
    assert!(together.iter().all(|keyframe| keyframe.map == 0));
    let closures = between(&workplace, "both");
    assert!(100 < closures.len(), "{}", closures.len());
    assert!(closures.iter().all(|c| &*c.closure.query.log == "day-2"));
    let text = fs::read_to_string(workplace.path("both/evaluation/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let site = &summary["sites"][0];
    let count = |key: &str| site["truth"][key].as_u64().unwrap();
    assert_eq!(count("n_false"), 0, "{site}");
    assert_eq!(count("n_judged") as usize, closures.len(), "{site}");
    assert!(9 * count("n_revisits") <= 10 * count("n_closed"), "{site}");
    assert_eq!(site["maps"][0]["logs"].to_string(), r#"["day-1","day-2"]"#);
    assert!(site["maps"][0]["ate_rmse_m"].as_f64().unwrap() < 0.1, "{site}");
    let report = fs::read_to_string(workplace.path("both/report.html")).unwrap();
    assert!(report.contains("Maps of several drives"));

    let of_day = |day: u32| format!("logs = [\"both/logs/day-{day}.mcap\"]\n");
    let write = |name: &str, text: &str| fs::write(workplace.path(name), text).unwrap();
    let run = |pipeline: &str, out: &str| {
        let args = [workplace.path(pipeline), workplace.path(out)];
        let [file, folder] = args.map(|path| path.to_str().unwrap().to_owned());
        loopboost(&["run", &file, "--out", &folder])
    };
    write("first.toml", &pipeline(&of_day(1), "[detect]\n"));
    run("first.toml", "first").expect(3).says(&["warning[detector_not_trained]"]);
    write("second.toml", &pipeline(&of_day(2), "[detect]\nmaps = [\"first\"]\n"));
    let made = run("second.toml", "second").expect(3);
    assert!(made.stdout.contains("site north: 2 drives in 1 map"), "{}", made.stdout);

    let added = trajectory(&workplace, "second");
    assert!(added.iter().all(|keyframe| &*keyframe.id.log == "day-2" && keyframe.map == 0));
    // The frame of both maps is the odometry of the first day.
    let of_second_day = together.iter().filter(|keyframe| &*keyframe.id.log == "day-2");
    for (a, b) in added.iter().zip(of_second_day) {
        assert_eq!(a.id, b.id);
        assert!(a.pose.distance_m(&b.pose) < 0.05, "{} m", a.pose.distance_m(&b.pose));
    }
    assert!(100 < between(&workplace, "second").len());
    // A third log is added to both, here the first one again: it has the name of a known log.
    write("third.toml", &pipeline(&of_day(1), "[detect]\nmaps = [\"first\", \"second\"]\n"));
    run("third.toml", "third").expect(2).says(&["log `day-1` is part of the map", "rename it"]);
    // The map has changed since the second day was added.
    write("other.toml", &pipeline(&of_day(1), "[detect]\nmin_path_m = 25.0\n"));
    run("other.toml", "first").expect(3);
    run("third.toml", "third").expect(1).says(&["is not the file that its map was made with"]);
    write("itself.toml", &pipeline(&of_day(1), "[detect]\nmaps = [\"first\"]\n"));
    run("itself.toml", "first").expect(2).says(&["a run cannot use its own map"]);
    write("missing.toml", &pipeline(&of_day(2), "[detect]\nmaps = [\"nowhere\"]\n"));
    run("missing.toml", "x").expect(1).says(&["`detect.maps` is `nowhere`"]);
}
