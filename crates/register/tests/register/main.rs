//! Scan matching and submaps in worlds with a known answer.

mod matching;
mod odometry;
mod submaps;
mod world;
