//! A check that lacks a peer or data is skipped, or fails if it is required.

use std::process::{Command, Output};

/// A check that needs shared data, one that needs a peer, and what their messages name.
const CHECKS: [(&str, &str); 2] = [
    (
        "real_logs::street_in_ros_1_and_ros_2_gives_the_same_revolutions",
        "no shared data /missing/data/logs/hdl32e-street.ros1.mcap, ",
    ),
    (
        "structure::the_schemas_are_generated_from_the_types",
        "cannot run /missing/python: No such file or directory",
    ),
];

/// Runs one test of this program without peers and without data.
fn run(test: &str, required: &str) -> Output {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test])
        .env("LOOPBOOST_DATA", "/missing/data")
        .env("LOOPBOOST_PYTHON", "/missing/python")
        .env("LOOPBOOST_REQUIRE", required)
        .output()
        .unwrap()
}

#[test]
fn a_missing_peer_or_missing_data_fails_if_required_and_is_named() {
    for (test, missing) in CHECKS {
        let output = run(test, "peers,data");
        let stdout = String::from_utf8(output.stdout).unwrap();
        assert!(!output.status.success() && stdout.contains(missing), "{stdout}");
    }
}

#[test]
fn a_missing_peer_or_missing_data_is_printed_if_not_required() {
    for (test, missing) in CHECKS {
        let output = run(test, "");
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{stderr}");
        assert!(stderr.contains(&format!("skipped: {test}: {missing}")), "{stderr}");
    }
}

#[test]
fn an_unknown_name_in_the_list_of_required_things_fails() {
    let (test, _) = CHECKS[0];
    let output = run(test, "peer");
    let stdout = String::from_utf8(output.stdout).unwrap();
    assert!(stdout.contains("LOOPBOOST_REQUIRE lists `peer`, expected peers, data"), "{stdout}");
}
