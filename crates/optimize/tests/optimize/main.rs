//! Pose graphs with known solutions, simulated drives with right and wrong closures, and sites
//! of several drives, and maps with absolute references.

mod drives;
mod graphs;
mod references;
mod sites;
#[path = "../../../register/tests/register/world.rs"]
mod world;
