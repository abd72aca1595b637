//! Measures the time from packets to the scans of one ring, compared with `velodyne-decoder` (PyPI,
//! C++), on one thread each.
//!
//! `cargo bench -p ingest --bench packets`
//!
//! The benchmark repeats the packets of `logs/hdl32e-street.ros2.mcap` in the folder `LOOPBOOST_DATA`,
//! with advancing clocks, and writes them to an uncompressed log. `ingest` reads that log from the page
//! cache and makes scans. The peer decodes the same packets from memory into points
//! (`tests/peers/packets.py`, run with the Python in `LOOPBOOST_PYTHON`). The measurements alternate.
//! Every run must give the same scans.

#![allow(clippy::print_stdout, reason = "a benchmark prints its results")]

#[path = "../../../tests/require.rs"]
mod require;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use ingest::{IngestError, Log, Options};
use messages::hdl32e::{HOUR_US, PACKET_BYTES};
use messages::{Encoding, Source, read_velodyne, ros};

const ROUNDS: usize = 400;
const PACKETS_PER_MESSAGE: usize = 181;
const RUNS: usize = 5;

fn main() {
    const STREET: &str = "logs/hdl32e-street.ros2.mcap";
    let Some(data) = require::shared_data(&[STREET]) else { return };
    let Some(python) = require::python_with(&["mcap", "numpy", "velodyne_decoder"]) else { return };
    let street = data.join(STREET);
    let packets = repeated(&packets_of(&street));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let log = folder.path().join("repeated.mcap");
    write(&log, &packets);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/packets.py");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");

    let (mut ours, mut peers, mut returns) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..RUNS {
        let start = Instant::now();
        returns.push(one.install(|| n_returns(&log)));
        ours.push(start.elapsed().as_secs_f64());
        let output = Command::new(&python)
            .args([script.as_os_str(), street.as_os_str()])
            .args([packets.len().to_string(), "1".to_owned()])
            .output()
            .expect("Python starts");
        let seconds = String::from_utf8_lossy(&output.stdout).trim().parse::<f64>();
        peers.push(seconds.expect("the peer prints seconds"));
    }
    assert!(returns.iter().all(|n| *n == returns[0] && 0 < *n));
    let rate = |seconds: &mut Vec<f64>| {
        seconds.sort_by(f64::total_cmp);
        packets.len() as f64 / seconds[seconds.len() / 2] * 1e-6
    };
    let (ours, peer) = (rate(&mut ours), rate(&mut peers));
    println!("{} packets, one thread, median of {RUNS}:", packets.len());
    println!("  log -> scans of one ring    {ours:>8.2} M packets/s, {} returns", returns[0]);
    println!("  velodyne-decoder, all rings {peer:>8.2} M packets/s");
    println!("  ratio                       {:>8.1}", ours / peer);
}

type StampedPacket = (i64, [u8; PACKET_BYTES]);

fn packets_of(log: &Path) -> Vec<StampedPacket> {
    let bytes = std::fs::read(log).expect("readable");
    let source = Source::new("velodyne_msgs/msg/VelodyneScan", "cdr").expect("a known type");
    let mut packets = Vec::new();
    for message in mcap::MessageStream::new(&bytes).expect("a log") {
        let message = message.expect("a message");
        let scan = read_velodyne(source, &message.data).expect("a scan of packets");
        let found = scan.packets().map(|(ns, bytes)| (ns, bytes.try_into().expect("1206 bytes")));
        packets.extend(found);
    }
    packets
}

/// Repeats the packets [`ROUNDS`] times, advancing stamps and device clock by the length of the
/// capture.
fn repeated(capture: &[StampedPacket]) -> Vec<StampedPacket> {
    let device_us = |packet: &StampedPacket| {
        u32::from_le_bytes(packet.1[1200..1204].try_into().expect("four bytes"))
    };
    let n = capture.len() as u32;
    let round_us = (device_us(&capture[capture.len() - 1]) - device_us(&capture[0])) * n / (n - 1);
    (0..ROUNDS as u32)
        .flat_map(|round| {
            capture.iter().map(move |packet| {
                let (stamp_ns, mut bytes) = *packet;
                let offset_us = round * round_us;
                let time = (device_us(packet) + offset_us) % HOUR_US;
                bytes[1200..1204].copy_from_slice(&time.to_le_bytes());
                (stamp_ns + i64::from(offset_us) * 1000, bytes)
            })
        })
        .collect()
}

fn write(path: &Path, packets: &[StampedPacket]) {
    let file = std::io::BufWriter::new(std::fs::File::create(path).expect("a file"));
    let mut writer = mcap::WriteOptions::new().compression(None).create(file).expect("a log");
    let channel = Arc::new(mcap::Channel {
        id: 1,
        topic: "/velodyne_packets".to_owned(),
        schema: Some(Arc::new(mcap::Schema {
            id: 1,
            name: "velodyne_msgs/msg/VelodyneScan".to_owned(),
            encoding: "ros2msg".to_owned(),
            data: Cow::Borrowed(b""),
        })),
        message_encoding: "cdr".to_owned(),
        metadata: BTreeMap::new(),
    });
    for packets in packets.chunks(PACKETS_PER_MESSAGE) {
        let stamp_ns = packets[packets.len() - 1].0;
        let data = ros::write_velodyne_scan(Encoding::Cdr, "velodyne", stamp_ns, packets);
        let message = mcap::Message {
            channel: channel.clone(),
            sequence: 0,
            log_time: stamp_ns as u64,
            publish_time: stamp_ns as u64,
            data: Cow::Owned(data),
        };
        writer.write(&message).expect("room");
    }
    writer.finish().expect("room");
}

fn n_returns(log: &Path) -> usize {
    let log = Log::open(log).expect("a log");
    let mut n = 0;
    let count = |scans: Vec<dataset::Scan>| {
        n += scans.iter().map(dataset::Scan::len).sum::<usize>();
        Ok::<_, IngestError>(())
    };
    ingest::ingest(&[&log], &Options::default(), count, |_| ()).expect("an intact log");
    n
}
