//! HDL-32E packets made in the test: every encoding, message size, schema and order of arrival gives
//! the scans that the sensor's manual defines.

use dataset::Scan;

use crate::made::{Ingested, Logs, Message, SCHEMAS, Schema, log};
use crate::wire::{Encoding, ROS, RosMessage};

// HDL-32E User's Manual 63-9113 Rev. K.
const PACKET_BYTES: usize = 1206;
const BLOCKS: usize = 12;
const BLOCK_BYTES: usize = 100;
const BLOCK_NS: i64 = 46_080;
const PACKET_NS: i64 = BLOCKS as i64 * BLOCK_NS;
const LASER_NS: i64 = 1_152;
/// The horizontal laser, in firing order.
const LASER: usize = 15;

const PACKETS: usize = 440;
/// Azimuth between two blocks, and of the first block \[0.01 deg\].
const STEP: usize = 17;
const START: usize = 20_000;

/// The stamp of a packet, which is its end \[ns\], and its bytes.
type Packet = (i64, Vec<u8>);

/// Azimuth of a block \[0.01 deg\].
fn azimuth(block: usize) -> usize {
    (START + STEP * block) % 36_000
}

/// Distance at an azimuth \[2 mm\]: 3 to 9 m, nothing for 5 deg, and readings at and just beyond the
/// default limits of 0.9 m and 70 m.
fn distance(azimuth: usize) -> u16 {
    match azimuth {
        9_000..9_500 => 0,
        15_000..15_100 => 35_001,
        15_100..15_200 => 35_000,
        18_000..18_100 => 450,
        18_100..18_200 => 449,
        _ => 1_500 + azimuth as u16 / 12,
    }
}

fn packets() -> Vec<Packet> {
    let packet = |k: usize| {
        let mut bytes = Vec::with_capacity(PACKET_BYTES);
        for block in BLOCKS * k..BLOCKS * (k + 1) {
            bytes.extend([0xff, 0xee]);
            bytes.extend((azimuth(block) as u16).to_le_bytes());
            let mut returns = [0; BLOCK_BYTES - 4];
            returns[3 * LASER..][..2].copy_from_slice(&distance(azimuth(block)).to_le_bytes());
            bytes.extend(returns);
        }
        let end_ns = (k as i64 + 1) * PACKET_NS;
        bytes.extend((end_ns as u32 / 1000).to_le_bytes());
        bytes.extend([0x37, 0x21]); // strongest return, HDL-32E
        (end_ns, bytes)
    };
    (0..PACKETS).map(packet).collect()
}

/// The scans that the manual defines: the azimuth of a block belongs to its first firing, laser 15
/// fires 15 of 40 periods later. Scans are cut where its azimuth passes 0.
fn expected() -> Vec<Vec<(i64, f64, f64)>> {
    let share = LASER as f64 / 40.0;
    let at_laser = |block: usize| (azimuth(block) as f64 + share * STEP as f64) % 36_000.0 / 100.0;
    let n_blocks = PACKETS * BLOCKS;
    let cuts: Vec<usize> =
        (1..n_blocks).filter(|&block| at_laser(block) < at_laser(block - 1)).collect();
    let revolution = |pair: &[usize]| {
        (pair[0]..pair[1])
            .map(|block| {
                let ns = block as i64 * BLOCK_NS + LASER as i64 * LASER_NS;
                (ns, at_laser(block), f64::from(distance(azimuth(block))) * 0.002)
            })
            .collect()
    };
    cuts.windows(2).map(revolution).collect()
}

/// Compares scans with the manual's: stamps exactly, azimuths within 0.001 deg and ranges within
/// the resolution of f32.
fn check_scans(scans: &[Scan]) {
    let expected = expected();
    assert_eq!((scans.len(), expected.len()), (2, 2));
    for (scan, firings) in scans.iter().zip(&expected) {
        assert_eq!(scan.stamp_ns, firings[0].0);
        assert!(scan.is_ring() && scan.hole_deg == 0.0);
        let is_return = |range_m: f64| (0.9..=70.0).contains(&range_m);
        let returns: Vec<_> = firings.iter().filter(|(.., range_m)| is_return(*range_m)).collect();
        assert_eq!(scan.len(), returns.len());
        for ([x, y], (_, azimuth_deg, range_m)) in scan.points().zip(returns) {
            // Azimuths are clockwise, y is to the left.
            let off_deg = ((-y).atan2(x).to_degrees() - azimuth_deg + 540.0) % 360.0 - 180.0;
            assert!(off_deg.abs() < 1e-3, "{off_deg} deg");
            assert!((x.hypot(y) - range_m).abs() < 1e-6 * range_m, "{} m, {range_m} m", x.hypot(y));
        }
    }
}

/// A message of packets: a `VelodyneScan`, or a `VelodynePacket` where `is_bare`.
fn message(encoding: Encoding, packets: &[Packet], is_bare: bool) -> Message {
    let stamp_ns = packets[packets.len() - 1].0;
    let start = match is_bare {
        true => RosMessage::new(encoding),
        false => RosMessage::with_header(encoding, stamp_ns).u32(packets.len() as u32),
    };
    let written = packets.iter().fold(start, |m, (ns, bytes)| m.time(*ns).raw(bytes));
    let type_name =
        if is_bare { "velodyne_msgs/VelodynePacket" } else { "velodyne_msgs/VelodyneScan" };
    let data = written.finish();
    Message { topic: "/velodyne_packets", type_name, encoding, stamp_ns, data }
}

/// Adds a log for each encoding, with so many packets in a message; 0: one, without a header.
fn add_logs(logs: &mut Logs, name: &str, packets: &[Packet], n: usize, schema: Schema) {
    for encoding in ROS {
        let groups = packets.chunks(n.max(1));
        let messages: Vec<Message> = groups.map(|group| message(encoding, group, n == 0)).collect();
        logs.add(&format!("{name}-{n}-{encoding:?}-{schema:?}"), log(&messages, schema));
    }
}

/// Every log has the scans of the manual.
fn check(ingested: &Ingested) {
    for (log, scans) in &ingested.scans {
        println!("{log}");
        check_scans(scans);
    }
}

#[test]
fn every_encoding_and_message_size_gives_the_same_scans() {
    let mut logs = Logs::default();
    for n in [0, 1, 77, PACKETS] {
        add_logs(&mut logs, "packets", &packets(), n, Schema::Empty);
    }
    check(&logs.ingest(&[], 0));
}

#[test]
fn packets_with_an_incomplete_or_missing_schema_give_the_same_scans() {
    let mut logs = Logs::default();
    for (n, schema) in [0, 77].into_iter().flat_map(|n| SCHEMAS.map(|schema| (n, schema))) {
        add_logs(&mut logs, "packets", &packets(), n, schema);
    }
    // A channel without a schema is a warning.
    check(&logs.ingest(&[], 3));
}

/// A pseudo-random delay of up to 100 ms \[ns\] (Knuth's linear congruential generator).
fn delay_ns(state: &mut u64) -> i64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    ((*state >> 33) % 100_000_000) as i64
}

fn late(packets: &[Packet]) -> Vec<Packet> {
    let mut state = 2436;
    let mut arriving: Vec<(i64, Packet)> =
        packets.iter().map(|packet| (packet.0 + delay_ns(&mut state), packet.clone())).collect();
    arriving.sort_by_key(|(arrival_ns, _)| *arrival_ns);
    let late: Vec<Packet> = arriving.into_iter().map(|(_, packet)| packet).collect();
    assert!(!late.is_sorted_by_key(|(stamp_ns, _)| *stamp_ns));
    late
}

#[test]
fn packets_up_to_100_ms_late_give_the_same_scans() {
    let mut logs = Logs::default();
    for n in [0, 40] {
        add_logs(&mut logs, "late", &late(&packets()), n, Schema::Empty);
    }
    check(&logs.ingest(&[], 0));
}

/// Every seventh packet again, two packets later.
fn with_duplicates(packets: &[Packet]) -> Vec<Packet> {
    let again = |k: usize| if k % 7 == 2 { vec![packets[k - 2].clone()] } else { Vec::new() };
    packets
        .iter()
        .enumerate()
        .flat_map(|(k, packet)| [vec![packet.clone()], again(k)].concat())
        .collect()
}

/// After every 50th packet the start of a position packet: 206 zeros, then an NMEA sentence.
fn with_position_packets(packets: &[Packet]) -> Vec<Packet> {
    const SENTENCE: &[u8] =
        b"$GPRMC,143408,A,3713.4490,N,12159.2900,W,000.0,000.0,280911,014.8,E,A*00\r\n";
    let mut position = vec![0; PACKET_BYTES];
    position[206..][..SENTENCE.len()].copy_from_slice(SENTENCE);
    packets
        .chunks(50)
        .flat_map(|fifty| {
            let after =
                if fifty.len() == 50 { vec![(fifty[49].0, position.clone())] } else { vec![] };
            [fifty.to_vec(), after].concat()
        })
        .collect()
}

/// 440 packets contain 63 duplicates and 8 position packets.
#[test]
fn duplicate_packets_and_position_packets_are_dropped_and_counted() {
    let (twice, mixed) = (with_duplicates(&packets()), with_position_packets(&packets()));
    assert_eq!((twice.len(), mixed.len()), (440 + 63, 440 + 8));
    let (mut duplicates, mut positions) = (Logs::default(), Logs::default());
    for n in [0, 40] {
        add_logs(&mut duplicates, "duplicates", &twice, n, Schema::Empty);
        add_logs(&mut positions, "positions", &mixed, n, Schema::Empty);
    }
    // Six logs each: three encodings, with and without headers.
    for (logs, n) in [(duplicates, 6 * 63), (positions, 6 * 8)] {
        let ingested = logs.ingest(&[], 3);
        check(&ingested);
        let count = format!("{n} ");
        assert!(ingested.finished.stderr.contains(&count), "{}", ingested.finished.stderr);
    }
}
