//! Scan matching and submaps in worlds with a known answer.

mod joint;
mod matching;
mod odometry;
mod stretches;
mod submaps;
mod world;
