//! Packets, alone and in messages.
#![no_main]

use libfuzzer_sys::fuzz_target;
use loopboost_fuzz::readers;
use messages::hdl32e::is_position_packet;
use messages::{Encoding, MessageType, Source, read_velodyne};

fuzz_target!(|bytes: &[u8]| {
    readers::packet(bytes);
    is_position_packet(bytes);
    for encoding in [Encoding::Cdr, Encoding::Ros1] {
        for message_type in [MessageType::VelodyneScan, MessageType::VelodynePacket] {
            if let Ok(scan) = read_velodyne(Source { message_type, encoding }, bytes) {
                readers::all_packets(&scan);
            }
        }
    }
});
