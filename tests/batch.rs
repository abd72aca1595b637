//! Many logs in one run: an unreadable log is named and the others are ingested. The files of a split
//! drive become one log.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use dataset::tables::scans::read_scan_headers;

use crate::support::Workplace;

const SIMULATED: &str = r#"
seed = 7
[simulate]
logs = ["one", "two"]
length_m = 40.0
people = 0
"#;

const BATCH: &str = r#"
[ingest]
logs = ["logs"]
site = "building"
pose.topic = "/ground_truth"
"#;

/// A folder with the simulated logs `one` and `two` in `out/logs`.
fn simulated() -> Workplace {
    let workplace = Workplace::new(SIMULATED);
    workplace.command("simulate", "out", &[]).expect(0);
    workplace
}

fn use_pipeline(workplace: &Workplace, pipeline: &str) {
    fs::write(workplace.path("drive.toml"), pipeline).unwrap();
}

#[test]
fn an_unreadable_log_is_named_and_the_others_are_ingested() {
    let workplace = simulated();
    fs::create_dir(workplace.path("logs")).unwrap();
    for log in ["one", "two"] {
        let name = format!("logs/{log}.mcap");
        fs::copy(workplace.path(&format!("out/{name}")), workplace.path(&name)).unwrap();
    }
    fs::write(workplace.path("logs/bag.mcap"), "#ROSBAG V2.0").unwrap();
    use_pipeline(&workplace, BATCH);
    workplace
        .command("ingest", "batch", &["--strict"])
        .expect(1)
        .says(&["bag.mcap is not an MCAP file"]);
    let finished = workplace.command("ingest", "batch", &[]).expect(3);
    let finished = finished.says(&[
        "warning[log_left_out]: 1 log left out of the run (not_mcap) (log `bag`)",
        "bag.mcap is not an MCAP file",
    ]);
    assert!(finished.stdout.contains("one: "), "{}", finished.stdout);
    let names: Vec<String> = workplace.files("batch").into_keys().collect();
    for log in ["one", "two"] {
        assert!(names.contains(&format!("scans/{log}.parquet")), "{names:?}");
    }
    // Later stages work without it, in the same run and in the next one.
    workplace.command("subsample", "batch", &[]).expect(0);
    workplace.command("ingest", "batch", &[]).expect(3);
    // A removed log is no longer reported.
    fs::remove_file(workplace.path("logs/bag.mcap")).unwrap();
    workplace.command("ingest", "batch", &[]).expect(0);
    // A repaired log takes part again.
    let repaired = split(&workplace.path("logs/one.mcap"), 1, 1).remove(0);
    fs::write(workplace.path("logs/bag.mcap"), repaired).unwrap();
    workplace.command("ingest", "batch", &[]).expect(0);
    workplace.command("subsample", "batch", &[]).expect(0);
    // If no log can be read, the run fails.
    for log in ["one", "two", "bag"] {
        fs::write(workplace.path(&format!("logs/{log}.mcap")), "").unwrap();
    }
    workplace.command("ingest", "batch", &[]).expect(1).says(&[
        "none of the 3 logs could be ingested",
        "one.mcap is empty",
        "two.mcap is empty",
    ]);
}

/// Splits the messages of a log into `n` files, without the last `n_left_out` messages of each.
fn split(log: &Path, n: usize, n_left_out: usize) -> Vec<Vec<u8>> {
    let bytes = fs::read(log).unwrap();
    let messages: Vec<_> =
        mcap::MessageStream::new(&bytes).unwrap().collect::<Result<_, _>>().unwrap();
    messages
        .chunks(messages.len().div_ceil(n))
        .map(|part| {
            let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
            let kept = &part[..part.len() - n_left_out];
            kept.iter().for_each(|message| writer.write(message).unwrap());
            writer.finish().unwrap();
            writer.into_inner().into_inner()
        })
        .collect()
}

#[test]
fn the_files_of_a_split_drive_become_one_log() {
    let workplace = simulated();
    let whole = workplace.path("out/logs/one.mcap");
    fs::create_dir_all(workplace.path("logs/monday")).unwrap();
    // The files are sorted by time, not by name.
    for (name, part) in ["c", "a", "b"].into_iter().zip(split(&whole, 3, 0)) {
        fs::write(workplace.path(&format!("logs/monday/{name}.mcap")), part).unwrap();
    }
    // Another drive in the same folder.
    fs::create_dir(workplace.path("logs/tuesday")).unwrap();
    fs::copy(workplace.path("out/logs/two.mcap"), workplace.path("logs/tuesday/two.mcap")).unwrap();
    use_pipeline(&workplace, BATCH);
    let finished = workplace.command("ingest", "joined", &[]).expect(0);
    assert!(finished.stdout.contains("monday: "), "{}", finished.stdout);
    finished.says(&["info[split_drive]: read from 3 files of one drive"]);

    use_pipeline(&workplace, &BATCH.replace("[\"logs\"]", "[\"out/logs/one.mcap\"]"));
    workplace.command("ingest", "whole", &[]).expect(0);
    let scans = |out: &str, log: &str| {
        read_scan_headers(&workplace.path(&format!("{out}/scans/{log}.parquet"))).unwrap().0
    };
    assert!(scans("joined", "monday").len() > 100);
    assert_eq!(scans("joined", "monday"), scans("whole", "one"));
    let names: BTreeMap<_, _> = workplace.files("joined");
    assert!(names.contains_key("scans/two.parquet"));
}

/// Two drives in one folder stay two logs if neither starts where the other ends. The `metadata.yaml`
/// of rosbag2 makes its folder one drive.
#[test]
fn separate_drives_in_one_folder_stay_separate_logs() {
    let workplace = simulated();
    use_pipeline(&workplace, &BATCH.replace("\"logs\"", "\"out/logs\""));
    let finished = workplace.command("ingest", "apart", &[]).expect(0);
    assert!(finished.stdout.contains("one: ") && finished.stdout.contains("two: "));
    fs::create_dir(workplace.path("bag")).unwrap();
    let metadata = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - bag_0.mcap\n    - bag_1.mcap\n";
    fs::write(workplace.path("bag/metadata.yaml"), metadata).unwrap();
    for (k, part) in split(&workplace.path("out/logs/one.mcap"), 2, 0).into_iter().enumerate() {
        fs::write(workplace.path(&format!("bag/bag_{k}.mcap")), part).unwrap();
    }
    use_pipeline(&workplace, &BATCH.replace("\"logs\"", "\"bag\""));
    let finished = workplace.command("ingest", "bagged", &[]).expect(0);
    assert!(finished.stdout.contains("bag: "), "{}", finished.stdout);
    finished.says(&["read from 2 files of one drive"]);
    // A missing file and an empty file lose only their own data.
    fs::remove_file(workplace.path("bag/bag_1.mcap")).unwrap();
    let finished = workplace.command("ingest", "bagged", &[]).expect(3);
    finished.says(&["file listed in metadata.yaml but missing"]);
    fs::write(workplace.path("bag/bag_1.mcap"), "").unwrap();
    let finished = workplace.command("ingest", "bagged", &[]).expect(3);
    finished.says(&["file of a split drive that cannot be read", "bag_1.mcap"]);
}

/// Two robots drive at the same time and record the same topics. Their logs are split at the same
/// time. The file names show which files belong together.
#[test]
fn files_of_two_robots_are_not_mixed() {
    let workplace = simulated();
    fs::create_dir(workplace.path("logs")).unwrap();
    // One message less, so that the logs of the second robot are not copies of the first.
    for (robot, n_left_out) in [("A", 0), ("B", 1)] {
        let parts = split(&workplace.path("out/logs/one.mcap"), 2, n_left_out);
        for (k, part) in parts.into_iter().enumerate() {
            fs::write(workplace.path(&format!("logs/{robot}_{k}.mcap")), part).unwrap();
        }
    }
    use_pipeline(&workplace, BATCH);
    let finished = workplace.command("ingest", "robots", &[]).expect(0);
    finished.says(&["A_0.mcap, A_1.mcap", "B_0.mcap, B_1.mcap"]);
    // If the names do not show it, no files are combined.
    for (from, to) in [("A_0", "north"), ("A_1", "east"), ("B_0", "south"), ("B_1", "west")] {
        let path = |name: &str| workplace.path(&format!("logs/{name}.mcap"));
        fs::rename(path(from), path(to)).unwrap();
    }
    let finished = workplace.command("ingest", "apart", &[]).expect(0);
    assert!(!finished.stderr.contains("files of one drive"), "{}", finished.stderr);
}
