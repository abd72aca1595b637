//! Pose graphs with known solutions, simulated drives with right and wrong closures, and sites
//! of several drives.

mod drives;
mod graphs;
mod sites;
#[path = "../../../register/tests/register/world.rs"]
mod world;
