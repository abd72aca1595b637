//! Faults of labels: copies of a log, two floors, one place with most of the pairs, and numbers that
//! claim more than the data shows.

use std::fs;

use crate::support::Workplace;

const SIMULATED: &str = r#"
seed = 7
[simulate]
logs = ["monday"]
length_m = 40.0
people = 0
"#;

const COPIES: &str = r#"
[ingest]
logs = ["logs"]
site = "building"
pose.topic = "/ground_truth"
"#;

/// A folder `logs` with the log `monday`.
fn monday() -> Workplace {
    let workplace = Workplace::new(SIMULATED);
    workplace.command("simulate", ".", &[]).expect(0);
    fs::write(workplace.path("drive.toml"), COPIES).unwrap();
    workplace
}

#[test]
fn a_copy_of_a_log_is_reported_and_the_log_is_used_once() {
    let workplace = monday();
    let monday = workplace.path("logs/monday.mcap");
    // Sorted by name, the copies come before and after the log.
    fs::copy(&monday, workplace.path("logs/backup.mcap")).unwrap();
    std::os::unix::fs::symlink(&monday, workplace.path("logs/tuesday.mcap")).unwrap();
    let finished = workplace.command("ingest", "out", &[]).expect(3);
    let finished = finished.says(&[
        "warning[duplicate_log]: 2 logs with the same bytes as log `backup` (equal BLAKE3 digests): only `backup` is used in 2 logs (`monday`, `tuesday`)",
    ]);
    assert_eq!(finished.stdout.lines().count(), 1, "{}", finished.stdout);
    let names: Vec<String> = workplace.files("out").into_keys().collect();
    let scans: Vec<_> = names.iter().filter(|name| name.starts_with("scans/")).collect();
    assert_eq!(scans, ["scans/backup.parquet"]);

    // Stages that run alone, and later runs, leave the copies out too.
    let finished = workplace.command("subsample", "out", &[]).expect(0);
    assert!(finished.stdout.contains("backup: ") && !finished.stdout.contains("monday: "));
    workplace.command("ingest", "out", &[]).expect(3).says(&["duplicate_log"]);

    // If the first of them is removed, another one is used.
    fs::remove_file(workplace.path("logs/backup.mcap")).unwrap();
    let finished = workplace.command("ingest", "out", &[]).expect(3);
    finished.says(&["log `monday` (equal BLAKE3 digests)", "log `tuesday`"]);
    fs::remove_file(workplace.path("logs/tuesday.mcap")).unwrap();
    workplace.command("ingest", "out", &[]).expect(0);
}

/// Two logs of equal size that differ in one byte are two logs.
#[test]
fn logs_of_equal_size_are_not_copies_if_a_byte_differs() {
    let workplace = monday();
    let mut bytes = fs::read(workplace.path("logs/monday.mcap")).unwrap();
    // A character of the library name in the header, which no reader uses.
    let place = bytes.windows(9).position(|name| name == b"loopboost").unwrap();
    bytes[place] = b'L';
    fs::write(workplace.path("logs/tuesday.mcap"), bytes).unwrap();
    let finished = workplace.command("ingest", "out", &[]);
    assert!(!finished.stderr.contains("duplicate_log"), "{}", finished.stderr);
    assert_eq!(finished.stdout.lines().count(), 2, "{}", finished.stdout);
}
