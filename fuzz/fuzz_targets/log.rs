//! Complete logs.
#![no_main]

use libfuzzer_sys::fuzz_target;
use loopboost_fuzz::logs;

fuzz_target!(|input: &[u8]| {
    if let Some((bytes, options)) = logs::from_input(input) {
        logs::read(bytes, &options);
    }
});
