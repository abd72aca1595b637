//! ROS 1 messages of every type.
#![no_main]

use libfuzzer_sys::fuzz_target;
use loopboost_fuzz::readers;
use messages::Encoding;

fuzz_target!(|bytes: &[u8]| readers::read_as_every_type(Encoding::Ros1, bytes));
