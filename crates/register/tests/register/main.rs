//! Scan matching and submaps in worlds with a known answer.

mod matching;
mod submaps;
mod world;
