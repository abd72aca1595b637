//! Code shared by the fuzz targets and the seeds.

pub mod logs;
pub mod readers;
pub mod samples;
