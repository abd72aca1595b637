//! Candidates in worlds with a known answer.

mod drives;
mod locate;
mod pairs;
mod similarity;
#[expect(dead_code, reason = "the tests of `register` use more of it")]
#[path = "../../../register/tests/register/world.rs"]
mod walls;
mod world;
