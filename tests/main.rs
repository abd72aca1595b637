//! Whole-program tests: one test binary of `crates/loopboost`.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may panic and prints its results"
)]

mod bags;
mod batch;
mod carried;
mod compare;
mod deskew;
mod detection;
mod encodings;
mod errors;
mod evidence;
mod faults_import;
mod faults_labels;
mod faults_poses;
mod faults_program;
mod faults_scans;
mod faults_wheels;
mod fleet;
mod import;
mod inspect_folder;
mod locate;
mod made;
mod made_clouds;
mod made_packets;
mod made_planar;
mod map_labels;
mod poses;
mod real_logs;
mod references;
mod require;
mod require_checks;
mod resume;
mod run;
mod sensors_page;
mod simulation;
mod sites;
mod sources;
mod structure;
mod support;
mod view;
mod wire;
