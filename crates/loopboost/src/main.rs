//! The program `loopboost`.

use std::process::ExitCode;

fn main() -> ExitCode {
    // `loopboost lineage X | head` ends quietly, as other programs do.
    sigpipe::reset();
    ExitCode::from(loopboost::main_from(std::env::args_os()))
}
