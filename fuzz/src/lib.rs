//! What the fuzz targets and their seeds share.

pub mod logs;
pub mod readers;
pub mod samples;
