//! `import`: a network capture gives the same scans as the log.

use std::fs;

use dataset::tables::scans::read_scan_headers;
use messages::{Source, read_velodyne};

use crate::support::{Workplace, loopboost};

const SIMULATED: &str = "seed = 7\n[simulate]\nlogs = [\"drive\"]\nlength_m = 12.0\npeople = 0\n";

/// A capture in libpcap format with times in nanoseconds (draft-ietf-opsawg-pcap). Each record is an
/// Ethernet frame with an IPv4 datagram from 192.168.1.201 to port 2368.
fn capture(packets: &[(i64, Vec<u8>)]) -> Vec<u8> {
    let mut out = Vec::new();
    for word in [0xa1b2_3c4d_u32, 0x0004_0002, 0, 0, 65_535, 1] {
        out.extend_from_slice(&word.to_le_bytes());
    }
    for (stamp_ns, payload) in packets {
        let udp_length = 8 + payload.len() as u16;
        let mut frame = vec![0xff; 12];
        frame.extend_from_slice(&[0x08, 0x00]);
        frame.extend_from_slice(&[0x45, 0]);
        frame.extend_from_slice(&(20 + udp_length).to_be_bytes());
        frame.extend_from_slice(&[0, 0, 0, 0, 64, 17, 0, 0, 192, 168, 1, 201, 255, 255, 255, 255]);
        for half in [2368, 2368, udp_length, 0] {
            frame.extend_from_slice(&half.to_be_bytes());
        }
        frame.extend_from_slice(payload);
        let (seconds, ns) = (stamp_ns / 1_000_000_000, stamp_ns % 1_000_000_000);
        for word in [seconds as u32, ns as u32, frame.len() as u32, frame.len() as u32] {
            out.extend_from_slice(&word.to_le_bytes());
        }
        out.extend(frame);
    }
    out
}

#[test]
fn a_capture_gives_the_same_scans_as_the_log_it_was_made_from() {
    let workplace = Workplace::new(SIMULATED);
    workplace.command("simulate", "out", &[]).expect(0);
    let log = fs::read(workplace.path("out/logs/drive.mcap")).unwrap();
    let source = Source::new("velodyne_msgs/msg/VelodyneScan", "cdr").unwrap();
    let mut packets: Vec<(i64, Vec<u8>)> = Vec::new();
    for message in mcap::MessageStream::new(&log).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == "/velodyne_packets" {
            let scan = read_velodyne(source, &message.data).unwrap();
            packets.extend(scan.packets().map(|(stamp_ns, bytes)| (stamp_ns, bytes.to_vec())));
        }
    }
    let pcap = workplace.path("drive.pcap");
    fs::write(&pcap, capture(&packets)).unwrap();

    let imported = workplace.path("imported.mcap");
    let args = ["import", pcap.to_str().unwrap(), "--out", imported.to_str().unwrap(), "--json"];
    let printed = loopboost(&args).expect(0).stdout;
    let printed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(printed["topics"][0]["topic"], "/velodyne_packets");
    loopboost(&args).expect(1).says(&["imported.mcap already exists"]);

    for (out, log) in [("original", "out/logs/drive.mcap"), ("capture", "imported.mcap")] {
        let pipeline = format!("[ingest]\nlogs = [\"{log}\"]\n");
        fs::write(workplace.path("drive.toml"), pipeline).unwrap();
        workplace.command("ingest", out, &[]).expect(0);
    }
    let headers = |table: &str| read_scan_headers(&workplace.path(table)).unwrap().0;
    let original = headers("original/scans/drive.parquet");
    assert!(original.len() > 50);
    assert_eq!(headers("capture/scans/imported.parquet"), original);
}

#[test]
fn what_cannot_be_imported_is_named() {
    let workplace = Workplace::new("");
    let (file, out) = (workplace.path("notes.txt"), workplace.path("x.mcap"));
    fs::write(&file, "no log\n").unwrap();
    let args = ["import", file.to_str().unwrap(), "--out", out.to_str().unwrap()];
    loopboost(&args).expect(1).says(&["notes.txt: found text that starts with `no log`"]);
    assert!(!out.exists());
}
