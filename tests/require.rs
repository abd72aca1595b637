//! What some checks need beyond this repository: Python packages ("peers"), recorded logs ("data")
//! and the `mcap` command ("mcap-cli").
//!
//! A check that lacks one of them is skipped, and prints what is missing on stderr. With
//! `LOOPBOOST_REQUIRE=peers,data` it fails instead, with the same text. Every test and benchmark
//! that can be skipped uses this file; those of other crates include it by its path.

#![allow(dead_code, reason = "each test or benchmark uses a part")]

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

const PEERS: &str = "peers";
const DATA: &str = "data";
const MCAP_CLI: &str = "mcap-cli";

/// The folder with recorded logs: `LOOPBOOST_DATA`, or `../shared/data` next to the repository.
/// None if one of the files is missing from it.
pub fn shared_data(files: &[&str]) -> Option<PathBuf> {
    let folder = std::env::var_os("LOOPBOOST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let missing: Vec<String> = files
        .iter()
        .map(|file| folder.join(file))
        .filter(|path| !path.exists())
        .map(|path| path.display().to_string())
        .collect();
    if missing.is_empty() {
        return Some(folder);
    }
    report_missing(DATA, &format!("no shared data {} (set LOOPBOOST_DATA)", missing.join(", ")));
    None
}

/// The Python of `LOOPBOOST_PYTHON`, or `python3`. None if it cannot import one of the modules.
pub fn python_with(modules: &[&str]) -> Option<String> {
    const FIND_MISSING: &str = "\
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ImportError:
        print(name)
";
    let python = std::env::var("LOOPBOOST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let output = Command::new(&python).args(["-c", FIND_MISSING]).args(modules).output();
    let missing = match output {
        Ok(output) if output.status.success() => {
            let missing = String::from_utf8_lossy(&output.stdout);
            let missing: Vec<&str> = missing.split_whitespace().collect();
            if missing.is_empty() {
                return Some(python);
            }
            format!("{python} has no module {}", missing.join(", "))
        }
        Ok(output) => format!("{python} fails: {}", String::from_utf8_lossy(&output.stderr).trim()),
        Err(error) => format!("cannot run {python}: {error}"),
    };
    report_missing(PEERS, &format!("{missing} (set LOOPBOOST_PYTHON)"));
    None
}

/// A command with `doctor`: `LOOPBOOST_MCAP`, or `mcap`. It is the command line tool of MCAP, or
/// `pymcap-cli` of PyPI, which `.ci/run` installs.
pub fn mcap_command() -> Option<String> {
    let mcap = std::env::var("LOOPBOOST_MCAP").unwrap_or_else(|_| "mcap".to_owned());
    if Command::new(&mcap).args(["doctor", "--help"]).output().is_ok() {
        return Some(mcap);
    }
    report_missing(MCAP_CLI, &format!("cannot run {mcap} (set LOOPBOOST_MCAP)"));
    None
}

/// Fails if `LOOPBOOST_REQUIRE` lists this kind; prints what is skipped otherwise.
fn report_missing(kind: &str, missing: &str) {
    let required = std::env::var("LOOPBOOST_REQUIRE").unwrap_or_default();
    let required: Vec<&str> =
        required.split(',').map(str::trim).filter(|name| !name.is_empty()).collect();
    for name in &required {
        let is_known = [PEERS, DATA, MCAP_CLI].contains(name);
        assert!(is_known, "LOOPBOOST_REQUIRE lists `{name}`, expected peers, data or mcap-cli");
    }
    assert!(!required.contains(&kind), "LOOPBOOST_REQUIRE lists `{kind}`: {missing}");
    // Not `eprintln!`: the test harness hides what a passing test prints with it.
    let thread = std::thread::current();
    let check = thread.name().filter(|name| *name != "main").unwrap_or("benchmark");
    let _ = writeln!(std::io::stderr(), "skipped: {check}: {missing}");
}
