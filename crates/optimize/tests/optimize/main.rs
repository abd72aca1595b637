//! Pose graphs with known solutions, and simulated drives with right and wrong closures.

mod drives;
mod graphs;
#[path = "../../../register/tests/register/world.rs"]
mod world;
