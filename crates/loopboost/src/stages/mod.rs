//! One command, one file: each reads its inputs from the run folder, calls its crate, and writes
//! its artifacts.

pub(crate) mod detect;
pub(crate) mod evaluate;
pub(crate) mod featurize;
pub(crate) mod ingest;
pub(crate) mod label;
pub(crate) mod optimize;
pub(crate) mod register;
pub(crate) mod simulate;
pub(crate) mod subsample;
pub(crate) mod train;
