//! `inspect` of a folder with several drives.

use std::fs;

use crate::support::{Workplace, loopboost};

const SIMULATED: &str =
    "seed = 7\n[simulate]\nlogs = [\"monday\", \"tuesday\"]\nlength_m = 30.0\npeople = 0\n";

/// Two drives with the same topics, one of another robot, and a damaged file.
#[test]
fn a_folder_gets_one_pipeline_for_the_drives_that_fit() {
    let workplace = Workplace::new(SIMULATED);
    workplace.command("simulate", "out", &[]).expect(0);
    let folder = workplace.path("out/logs");
    let folder = folder.to_str().unwrap();
    let both = workplace.path("both.toml");
    let args = ["inspect", folder, "--write", both.to_str().unwrap()];
    let found = loopboost(&args).expect(0);
    for line in [": 2 drives,", "monday: ", "tuesday: ", "; fits"] {
        assert!(found.stdout.contains(line), "{line}: {}", found.stdout);
    }
    let pipeline = fs::read_to_string(&both).unwrap();
    assert!(pipeline.contains("logs = [\"out/logs\"]"), "{pipeline}");
    let run = workplace.path("run");
    for stage in ["ingest", "subsample"] {
        let args = [stage, both.to_str().unwrap(), "--out", run.to_str().unwrap()];
        loopboost(&args).expect(0);
    }
    assert!(workplace.path("run/keyframes/tuesday.parquet").exists());

    // A planar scanner, and odometry without a map frame.
    let carmen: String = (0..40)
        .map(|k| {
            let x_m = 0.2 * f64::from(k);
            format!(
                "FLASER 4 1.5 1.6 1.5 1.4 {x_m} 0 0 {x_m} 0 0 {}.5 robot {}.5\n",
                100 + k,
                100 + k
            )
        })
        .collect();
    fs::write(workplace.path("other.log"), carmen).unwrap();
    let [from, to] = ["other.log", "out/logs/other.mcap"].map(|name| workplace.path(name));
    loopboost(&["import", from.to_str().unwrap(), "--out", to.to_str().unwrap()]).expect(0);
    fs::write(workplace.path("out/logs/broken.mcap"), "#ROSBAG V2.0").unwrap();
    let found = loopboost(&["inspect", folder]).expect(3);
    for line in [
        ": 4 drives,",
        "broken: not read; does not fit: ",
        "other: ",
        "suggested pipeline for 2 of 4 drives",
        "monday.mcap\",\n",
        "tuesday.mcap\",\n",
    ] {
        assert!(found.stdout.contains(line), "{line}: {}", found.stdout);
    }
    assert!(!found.stdout.contains("other.mcap\""), "{}", found.stdout);
    assert!(found.stderr.contains("warning[drive_differs]"), "{}", found.stderr);
    let json = loopboost(&["inspect", folder, "--json"]).expect(3).stdout;
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let fits: Vec<bool> = json["drives"]
        .as_array()
        .unwrap()
        .iter()
        .map(|drive| drive["does_not_fit"].is_null())
        .collect();
    assert_eq!(fits, [false, true, false, true]);
    // The two drives are too short for enough pairs.
    let refused = json["too_few_pairs"].as_str().unwrap();
    assert!(refused.starts_with("`label` fails for these drives alone: "), "{refused}");

    let plot = ["inspect", folder, "--plot", "path.svg"];
    loopboost(&plot).expect(1).says(&["contains 4 drives, but --plot draws the path of one"]);
}
