//! Whole-program tests: one binary, wired from `crates/loopboost`.

mod batch;
mod deskew;
mod encodings;
mod errors;
mod evidence;
mod import;
mod poses;
mod real_logs;
mod require;
mod require_checks;
mod resume;
mod run;
mod simulation;
mod structure;
mod support;
