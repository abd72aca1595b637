//! Candidates in worlds with a known answer.

mod drives;
mod pairs;
mod similarity;
mod world;
