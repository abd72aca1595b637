//! Imports network captures.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use common::{Log, import};
use dataset::Severity;
use import::{Compression, ImportError, Options};
use messages::hdl32e::{BLOCKS, PACKET_BYTES, PacketBuilder};
use messages::{read_nav_sat_fix, read_velodyne};
use proptest::prelude::*;

const T0_NS: i64 = 1_700_000_000_000_000_000;
/// A packet takes 552.96 us, rounded to complete microseconds.
const STEP_NS: i64 = 553_000;

/// The layout of a libpcap file.
#[derive(Clone, Copy)]
struct Layout {
    big_endian: bool,
    nanoseconds: bool,
}

const LITTLE_MICRO: Layout = Layout { big_endian: false, nanoseconds: false };

fn u32_of(value: u32, big_endian: bool) -> [u8; 4] {
    if big_endian { value.to_be_bytes() } else { value.to_le_bytes() }
}

fn u16_of(value: u16, big_endian: bool) -> [u8; 2] {
    if big_endian { value.to_be_bytes() } else { value.to_le_bytes() }
}

fn pcap(layout: Layout, link: u32, frames: &[(i64, Vec<u8>)]) -> Vec<u8> {
    let Layout { big_endian, nanoseconds } = layout;
    let mut out = Vec::new();
    let magic = if nanoseconds { 0xA1B2_3C4D } else { 0xA1B2_C3D4 };
    out.extend(u32_of(magic, big_endian));
    out.extend(u16_of(2, big_endian));
    out.extend(u16_of(4, big_endian));
    for word in [0, 0, 65_535, link] {
        out.extend(u32_of(word, big_endian));
    }
    for (stamp_ns, frame) in frames {
        let fraction = stamp_ns % 1_000_000_000 / if nanoseconds { 1 } else { 1000 };
        let length = frame.len() as u32;
        for word in [(stamp_ns / 1_000_000_000) as u32, fraction as u32, length, length] {
            out.extend(u32_of(word, big_endian));
        }
        out.extend(frame);
    }
    out
}

/// A pcapng block.
fn block(kind: u32, body: &[u8], big_endian: bool) -> Vec<u8> {
    let padded = body.len().next_multiple_of(4);
    let length = u32_of(padded as u32 + 12, big_endian);
    let mut out = [u32_of(kind, big_endian), length].concat();
    out.extend(body);
    out.resize(8 + padded, 0);
    out.extend(length);
    out
}

fn section(big_endian: bool) -> Vec<u8> {
    let mut body = u32_of(0x1A2B_3C4D, big_endian).to_vec();
    body.extend(u16_of(1, big_endian));
    body.extend(u16_of(0, big_endian));
    body.extend([0xFF; 8]);
    block(0x0A0D_0D0A, &body, big_endian)
}

/// An interface with a time unit of `10^-digits` s, or of 1 us if `digits` is `None`.
fn interface(link: u16, digits: Option<u8>, big_endian: bool) -> Vec<u8> {
    interface_from(link, digits, None, big_endian)
}

/// An interface with the options `if_tsresol` and `if_tsoffset`.
fn interface_from(
    link: u16,
    if_tsresol: Option<u8>,
    if_tsoffset: Option<i64>,
    big_endian: bool,
) -> Vec<u8> {
    let mut body = u16_of(link, big_endian).to_vec();
    body.extend([0; 2]);
    body.extend(u32_of(0, big_endian));
    if let Some(if_tsresol) = if_tsresol {
        body.extend(u16_of(9, big_endian));
        body.extend(u16_of(1, big_endian));
        body.extend([if_tsresol, 0, 0, 0]);
    }
    if let Some(offset_s) = if_tsoffset {
        body.extend(u16_of(14, big_endian));
        body.extend(u16_of(8, big_endian));
        body.extend(if big_endian { offset_s.to_be_bytes() } else { offset_s.to_le_bytes() });
    }
    if if_tsresol.is_some() || if_tsoffset.is_some() {
        body.extend([0; 4]);
    }
    block(1, &body, big_endian)
}

fn enhanced(interface: u32, ticks: u64, frame: &[u8], big_endian: bool) -> Vec<u8> {
    let length = frame.len() as u32;
    let words = [interface, (ticks >> 32) as u32, ticks as u32, length, length];
    let mut body: Vec<u8> = words.iter().flat_map(|&word| u32_of(word, big_endian)).collect();
    body.extend(frame);
    block(6, &body, big_endian)
}

fn ipv4_udp(source: [u8; 4], port: u16, payload: &[u8]) -> Vec<u8> {
    let udp_length = 8 + payload.len() as u16;
    let mut out = vec![0x45, 0];
    out.extend((20 + udp_length).to_be_bytes());
    out.extend([0, 0, 0x40, 0, 64, 17, 0, 0]);
    out.extend(source);
    out.extend([255; 4]);
    out.extend(port.to_be_bytes());
    out.extend(port.to_be_bytes());
    out.extend(udp_length.to_be_bytes());
    out.extend([0, 0]);
    out.extend(payload);
    out
}

fn ipv6_udp(port: u16, payload: &[u8]) -> Vec<u8> {
    let udp_length = 8 + payload.len() as u16;
    let mut out = vec![0x60, 0, 0, 0];
    out.extend(udp_length.to_be_bytes());
    out.extend([17, 64]);
    out.extend([0xFD; 16]);
    out.extend([0xFE; 16]);
    out.extend(port.to_be_bytes());
    out.extend(port.to_be_bytes());
    out.extend(udp_length.to_be_bytes());
    out.extend([0, 0]);
    out.extend(payload);
    out
}

fn ethernet(ether_type: &[u8], packet: &[u8]) -> Vec<u8> {
    [&[0xFF; 6], &[2, 0, 0, 0, 0, 1][..], ether_type, packet].concat()
}

const SENSOR: [u8; 4] = [192, 168, 1, 201];

/// A data packet at an azimuth \[0.01 deg\].
fn data(azimuth: u16) -> [u8; PACKET_BYTES] {
    let azimuths = std::array::from_fn(|block| (azimuth + 20 * block as u16) % 36_000);
    let mut packet = PacketBuilder::new(azimuths, 0);
    for block in 0..BLOCKS {
        packet.set_return(block, 15, 1000 + azimuth / 36, 7);
    }
    packet.finish()
}

fn data_frame(azimuth: u16) -> Vec<u8> {
    ethernet(&[8, 0], &ipv4_udp(SENSOR, 2368, &data(azimuth)))
}

const AZIMUTHS: [u16; 7] = [0, 12_000, 24_000, 35_900, 11_900, 23_900, 100];

fn frames() -> Vec<(i64, Vec<u8>)> {
    let frame = |(k, azimuth): (usize, &u16)| (T0_NS + k as i64 * STEP_NS, data_frame(*azimuth));
    AZIMUTHS.iter().enumerate().map(frame).collect()
}

fn run(capture: &[u8]) -> Log {
    import(&[("drive.pcap", capture)], &Options::default()).unwrap()
}

/// The packets of each message of a log, with their stamps.
fn packets(log: &Log) -> Vec<Vec<(i64, Vec<u8>)>> {
    log.of("/velodyne_packets")
        .map(|message| {
            let scan = read_velodyne(message.source, &message.bytes).unwrap();
            let packets: Vec<_> =
                scan.packets().map(|(stamp_ns, data)| (stamp_ns, data.to_vec())).collect();
            assert_eq!(scan.stamp_ns, packets.last().unwrap().0);
            assert_eq!(message.log_ns as i64, scan.stamp_ns);
            packets
        })
        .collect()
}

fn expected() -> Vec<Vec<(i64, Vec<u8>)>> {
    let packet = |k: usize| (T0_NS + k as i64 * STEP_NS, data(AZIMUTHS[k]).to_vec());
    vec![(0..4).map(packet).collect(), (4..6).map(packet).collect(), vec![packet(6)]]
}

#[test]
fn every_byte_order_and_resolution_gives_the_same_revolutions() {
    for big_endian in [false, true] {
        for nanoseconds in [false, true] {
            let log = run(&pcap(Layout { big_endian, nanoseconds }, 1, &frames()));
            assert_eq!(packets(&log), expected());
            assert!(log.imported.losses.is_empty());
        }
    }
}

#[test]
fn nanoseconds_are_kept() {
    let layout = Layout { big_endian: false, nanoseconds: true };
    let log = run(&pcap(layout, 1, &[(T0_NS + 123_456_789, data_frame(0))]));
    assert_eq!(packets(&log)[0][0].0, T0_NS + 123_456_789);
}

#[test]
fn pcapng_interfaces_have_their_own_resolutions() {
    for big_endian in [false, true] {
        let mut capture = section(big_endian);
        capture.extend(interface(1, None, big_endian));
        capture.extend(interface(101, Some(9), big_endian));
        // A block of a kind that is skipped.
        capture.extend(block(5, &[0; 12], big_endian));
        for (k, &azimuth) in AZIMUTHS.iter().enumerate() {
            let stamp_ns = (T0_NS + k as i64 * STEP_NS) as u64;
            capture.extend(match k % 2 {
                0 => enhanced(0, stamp_ns / 1000, &data_frame(azimuth), big_endian),
                _ => {
                    let packet = ipv4_udp(SENSOR, 2368, &data(azimuth));
                    enhanced(1, stamp_ns, &packet, big_endian)
                }
            });
        }
        // A packet of an unknown interface, and a packet without a time.
        capture.extend(enhanced(2, 0, &data_frame(0), big_endian));
        let mut simple = u32_of(8, big_endian).to_vec();
        simple.extend([0; 8]);
        capture.extend(block(3, &simple, big_endian));
        let log = run(&capture);
        assert_eq!(packets(&log), expected());
        assert_eq!(
            log.losses(Severity::Warning),
            [("packets_of_unknown_interface", 1), ("packets_without_time", 1)]
        );
    }
}

/// 1700000000.5 s in units of 2^-20 s (the case of ProfiShark taps), 2^-30 s, 2^-32 s (Endace cards),
/// 2^-1 s, 1 s and 10^-10 s.
#[test]
fn pcapng_resolutions_are_powers_of_two_or_ten() {
    const HALF_SECONDS: u64 = 2 * 1_700_000_000 + 1;
    let units = [
        (0x94, HALF_SECONDS << 19),
        (0x9E, HALF_SECONDS << 29),
        (0xA0, HALF_SECONDS << 31),
        (0x81, HALF_SECONDS),
        (10, HALF_SECONDS * 5_000_000_000),
    ];
    for big_endian in [false, true] {
        for (if_tsresol, ticks) in units {
            let mut capture = section(big_endian);
            capture.extend(interface(1, Some(if_tsresol), big_endian));
            capture.extend(enhanced(0, ticks, &data_frame(0), big_endian));
            let log = run(&capture);
            assert_eq!(packets(&log)[0][0].0, T0_NS + 500_000_000, "{if_tsresol:#x}");
        }
        let mut capture = section(big_endian);
        capture.extend(interface_from(1, Some(0x81), Some(1_600_000_000), big_endian));
        capture.extend(enhanced(0, 2 * 100_000_000 + 1, &data_frame(0), big_endian));
        assert_eq!(packets(&run(&capture))[0][0].0, T0_NS + 500_000_000, "with an offset");
    }
}

#[test]
fn datagrams_are_found_in_every_link_type() {
    let packet = ipv4_udp(SENSOR, 2368, &data(0));
    let cooked = |length: usize, at: usize| {
        let mut header = vec![0; length];
        header[at] = 8;
        [header, packet.clone()].concat()
    };
    let vlan = [0x81, 0, 0, 5, 8, 0];
    let double_vlan = [0x88, 0xA8, 0, 7, 0x81, 0, 0, 5, 8, 0];
    let frames = [
        (1, ethernet(&vlan, &packet)),
        (1, ethernet(&double_vlan, &packet)),
        (1, ethernet(&[0x86, 0xDD], &ipv6_udp(2368, &data(0)))),
        (101, packet.clone()),
        (101, ipv6_udp(2368, &data(0))),
        (12, packet.clone()),
        (228, packet.clone()),
        (0, [&[2, 0, 0, 0], &packet[..]].concat()),
        (108, [&[0, 0, 0, 2], &packet[..]].concat()),
        (113, cooked(16, 14)),
        (276, cooked(20, 0)),
    ];
    for (link, frame) in frames {
        let log = run(&pcap(LITTLE_MICRO, link, &[(T0_NS, frame)]));
        assert_eq!(packets(&log), [[(T0_NS, data(0).to_vec())]], "link type {link}");
    }
}

/// A position packet with the NMEA sentence of the unit test in `position.rs`.
fn position() -> Vec<u8> {
    let mut payload = vec![0; 512];
    let sentence = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n";
    payload[206..206 + sentence.len()].copy_from_slice(sentence);
    payload
}

#[test]
fn positions_become_fixes_and_other_traffic_is_counted() {
    let udp = |port, payload: &[u8]| ethernet(&[8, 0], &ipv4_udp(SENSOR, port, payload));
    let mut fragment = ipv4_udp(SENSOR, 2368, &data(0));
    fragment[6] = 0x20;
    let mut unknown = data(0);
    unknown[0] = 0;
    let mut frames = frames();
    let at = |k: i64| T0_NS + k * STEP_NS;
    frames.insert(1, (at(0) + 1000, udp(8308, &position())));
    frames.insert(2, (at(0) + 2000, udp(8308, &[0; 512])));
    frames.insert(3, (at(0) + 3000, udp(53, &[1, 2, 3])));
    frames.insert(4, (at(0) + 4000, ethernet(&[8, 0], &fragment)));
    frames.insert(5, (at(0) + 5000, udp(2368, &unknown)));
    frames.insert(6, (at(0) + 6000, udp(2368, &data(0)[..1205])));
    frames.insert(7, (at(0) + 7000, ethernet(&[0x12, 0x34], &[0; 40])));
    frames.insert(8, (at(0) + 8000, data_frame(0)[..100].to_vec()));
    let log = run(&pcap(LITTLE_MICRO, 1, &frames));
    assert_eq!(packets(&log), expected());
    let fixes: Vec<_> = log.of("/fix").collect();
    assert_eq!(fixes.len(), 1);
    let fix = read_nav_sat_fix(fixes[0].source, &fixes[0].bytes).unwrap();
    assert_eq!(fix.stamp_ns, at(0) + 1000);
    assert!((fix.latitude_deg - 48.1173).abs() < 1e-9, "{fix:?}");
    assert_eq!(
        log.losses(Severity::Warning),
        [("datagrams_not_data", 2), ("undecodable_frames", 1), ("undecodable_frames", 1)]
    );
    assert_eq!(
        log.losses(Severity::Info),
        [("datagrams_to_other_ports", 1), ("positions_without_fix", 1), ("frames_not_udp", 1)]
    );
    let losses = log.imported.losses.to_string();
    let sentence = "1 frame of another protocol than UDP (neither IP nor ARP) (file `drive.pcap`)";
    assert!(losses.contains(sentence), "{losses}");
    assert!(losses.contains("1 undecodable frame (IP fragment) (file `drive.pcap`)"), "{losses}");
}

#[test]
fn one_of_several_sensors_must_be_selected() {
    let other = [10, 0, 0, 7];
    let mut frames = frames();
    frames.insert(2, (T0_NS, ethernet(&[8, 0], &ipv4_udp(other, 2368, &data(5)))));
    let capture = pcap(LITTLE_MICRO, 1, &frames);
    let error = import(&[("a.pcap", &capture)], &Options::default()).unwrap_err();
    let ImportError::SeveralSensors { addresses, .. } = error else { panic!("{error}") };
    assert_eq!(addresses, "10.0.0.7, 192.168.1.201");

    let options = Options { source_ip: Some(SENSOR.into()), ..Options::default() };
    let log = import(&[("a.pcap", &capture)], &options).unwrap();
    assert_eq!(packets(&log), expected());
    assert_eq!(log.losses(Severity::Info), [("packets_of_other_sensors", 1)]);
}

#[test]
fn parts_of_a_capture_are_merged_by_time() {
    let frames = frames();
    let (first, second) = frames.split_at(4);
    let first = pcap(LITTLE_MICRO, 1, first);
    let second = pcap(Layout { big_endian: true, nanoseconds: true }, 1, second);
    let files: [(&str, &[u8]); 2] = [("2.pcap", &second), ("1.pcap", &first)];
    assert_eq!(packets(&import(&files, &Options::default()).unwrap()), expected());
}

/// The ports are listed, the most frequent first. Data packets to another port are a warning if the data
/// port has none, even if there are positions.
#[test]
fn ports_that_are_not_used_are_listed() {
    let udp = |port, payload: &[u8]| ethernet(&[8, 0], &ipv4_udp(SENSOR, port, payload));
    let at = |k: i64| T0_NS + k * STEP_NS;
    let mut frames = vec![(at(0), udp(8308, &position()))];
    frames.extend((1..4).map(|k| (at(k), udp(53, &[1, 2, 3]))));
    frames.extend((4..6).map(|k| (at(k), udp(2370, &data(0)))));
    frames.push((at(6), udp(9999, &[0; 1206])));
    let log = run(&pcap(LITTLE_MICRO, 1, &frames));
    assert_eq!(log.of("/fix").count(), 1);
    assert_eq!(log.losses(Severity::Warning), [("data_packets_to_other_port", 2)]);
    assert_eq!(log.losses(Severity::Info), [("datagrams_to_other_ports", 4)]);
    let losses = log.imported.losses.to_string();
    assert!(losses.contains("4 UDP datagrams to other ports (53: 3, 9999: 1)"), "{losses}");
    assert!(losses.contains("set `--udp-port 2370`"), "{losses}");

    frames.push((at(7), data_frame(0)));
    let log = run(&pcap(LITTLE_MICRO, 1, &frames));
    assert_eq!(log.losses(Severity::Warning), []);
    assert_eq!(log.losses(Severity::Info), [("datagrams_to_other_ports", 6)]);
}

#[test]
fn a_capture_without_sensor_data_is_an_error_that_lists_its_content() {
    let frame = ethernet(&[8, 0], &ipv4_udp(SENSOR, 2369, &data(0)));
    let capture = pcap(LITTLE_MICRO, 1, &[(T0_NS, frame)]);
    let error = import(&[("a.pcap", &capture)], &Options::default()).unwrap_err().to_string();
    assert!(error.contains("1 Velodyne data packet to port 2369"), "{error}");
    assert!(error.contains("2368") && error.contains("--udp-port"), "{error}");
    let options = Options { udp_port: 2369, ..Options::default() };
    assert_eq!(import(&[("a.pcap", &capture)], &options).unwrap().messages.len(), 1);
}

#[test]
fn a_stamp_that_steps_back_stays_in_the_message_and_the_log_stays_sorted() {
    let mut frames = frames();
    frames[6].0 = T0_NS;
    let log = run(&pcap(LITTLE_MICRO, 1, &frames));
    let last = &log.messages[2];
    assert_eq!(last.publish_ns as i64, T0_NS);
    assert_eq!(last.log_ns as i64, T0_NS + 5 * STEP_NS);
    assert_eq!(log.losses(Severity::Info), [("message_times_step_back", 1)]);
}

#[test]
fn the_same_capture_gives_the_same_bytes() {
    let capture = pcap(LITTLE_MICRO, 1, &frames());
    assert_eq!(run(&capture).bytes, run(&capture).bytes);
}

/// The packets of all messages.
fn flat(log: &Log) -> Vec<(i64, Vec<u8>)> {
    packets(log).concat()
}

#[test]
fn a_truncated_capture_keeps_its_complete_packets() {
    let options = Options { compression: Compression::None, ..Options::default() };
    let frames = &frames()[2..5];
    let mut pcapng = section(false);
    pcapng.extend(interface(1, Some(9), false));
    for (stamp_ns, frame) in frames {
        pcapng.extend(enhanced(0, *stamp_ns as u64, frame, false));
    }
    let complete = &expected().concat()[2..5];
    for capture in [pcap(LITTLE_MICRO, 1, frames), pcapng] {
        let mut lengths = Vec::new();
        for cut in 0..capture.len() {
            match import(&[("a.pcap", &capture[..cut])], &options) {
                Ok(log) => {
                    let found = flat(&log);
                    assert_eq!(found, complete[..found.len()]);
                    assert!(found.len() < complete.len());
                    lengths.push(found.len());
                    let losses = log.losses(Severity::Warning);
                    let is_between_packets = losses.is_empty();
                    assert!(is_between_packets || losses == [("truncated_capture", 1)]);
                }
                Err(error) => assert!(lengths.is_empty(), "{cut}: {error}"),
            }
        }
        lengths.dedup();
        assert_eq!(lengths, [1, 2]);
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_after_a_header_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        for head in [
            pcap(LITTLE_MICRO, 1, &frames()[..1]),
            pcap(Layout { big_endian: true, nanoseconds: true }, 113, &[]),
            [section(true), interface(1, None, true)].concat(),
        ] {
            let _ = import(&[("a.pcap", &[head, bytes.clone()].concat())], &Options::default());
        }
    }

    #[test]
    fn a_changed_byte_does_not_panic(at in 0usize..10_000, value: u8) {
        let mut pcapng = section(false);
        pcapng.extend(interface(1, Some(6), false));
        for (stamp_ns, frame) in frames() {
            pcapng.extend(enhanced(0, stamp_ns as u64 / 1000, &frame, false));
        }
        for mut capture in [pcap(LITTLE_MICRO, 1, &frames()), pcapng] {
            let at = at % capture.len();
            capture[at] = value;
            let _ = import(&[("a.pcap", &capture)], &Options::default());
        }
    }
}
