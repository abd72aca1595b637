//! Tests with corrupt logs. A corrupt log gives an error or correct data, losses are counted, and no
//! log makes the program allocate much more memory than the log has bytes.
//!
//! A normal run makes 300 corruptions. `LOOPBOOST_CORRUPTIONS=10000` makes more.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

use common::{
    Entry, cloud_log, coarse_packet_log, codes, ingest_bytes, ingest_file, options, planar_log,
    small_chunks, write,
};
use dataset::{Scan, StampedPose};
use ingest::{IngestError, Ingested, Options};
use mcap::records::op;
use mcap::{Compression, WriteOptions};
use messages::Encoding;

/// Memory that reading a log needs in addition to the size of the log \[bytes\]: 0.6 MB for the table of
/// directions, and up to 8 MB for each chunk. A thread reads one chunk at a time.
const MEMORY_BYTES: usize = 32 << 20;

struct Counting;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is passed unchanged to the allocator of the system.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.fetch_add(layout.size(), Relaxed) + layout.size();
        PEAK.fetch_max(live, Relaxed);
        // SAFETY: the caller guarantees the same conditions.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller guarantees the same conditions.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs one test at a time, because the memory of the whole program is counted.
static ALONE: Mutex<()> = Mutex::new(());

type Output = Result<(Vec<Scan>, Ingested), IngestError>;

fn ingest_within_memory(bytes: &[u8], options: &Options, what: &str) -> Output {
    let before = LIVE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let output = ingest_bytes(bytes, options);
    let taken = PEAK.load(Relaxed) - before;
    assert!(taken <= MEMORY_BYTES + bytes.len(), "{what}: {taken} bytes of memory");
    output
}

/// An intact log, its scans and poses.
struct Intact {
    name: String,
    bytes: Vec<u8>,
    options: Options,
    scans: Vec<Scan>,
    ingested: Ingested,
    is_of_packets: bool,
    /// Ranges of the CRCs of the chunks. Empty without chunks.
    crcs: Vec<Range<usize>>,
}

fn layouts() -> [(&'static str, WriteOptions); 4] {
    [
        ("zstd", small_chunks()),
        ("lz4", small_chunks().compression(Some(Compression::Lz4))),
        ("none", small_chunks().compression(None)),
        ("unchunked", WriteOptions::new().use_chunks(false)),
    ]
}

impl Intact {
    fn new(name: &str, entries: &[Entry], layout: (&str, WriteOptions)) -> Self {
        let bytes = write(entries, layout.1);
        let pose = entries.iter().any(|entry| entry.0 == "/pose").then_some("/pose");
        let options = options(entries[0].0, pose);
        let (scans, ingested) = ingest_bytes(&bytes, &options).unwrap();
        assert!(3 <= scans.len() && ingested.losses.is_empty(), "{name}: {ingested:?}");
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        // Opcode, length, two times and the size come before the CRC.
        let crc = |start: usize| start + 33..start + 37;
        let starts = summary.chunk_indexes.iter().map(|index| index.chunk_start_offset as usize);
        Self {
            name: format!("{name}, {}", layout.0),
            crcs: starts.map(crc).collect(),
            is_of_packets: entries[0].0 == "/packets",
            bytes,
            options,
            scans,
            ingested,
        }
    }

    fn all() -> Vec<Self> {
        let contents = [
            ("planar", planar_log()),
            ("cdr packets", coarse_packet_log(Encoding::Cdr)),
            ("ros1 packets", coarse_packet_log(Encoding::Ros1)),
            ("cdr clouds", cloud_log(Encoding::Cdr)),
            ("ros1 clouds", cloud_log(Encoding::Ros1)),
            ("protobuf clouds", cloud_log(Encoding::Protobuf)),
            ("json clouds", cloud_log(Encoding::Json)),
        ];
        let of = |(name, entries): &(&str, Vec<Entry>)| {
            layouts().map(|layout| Self::new(name, entries, layout))
        };
        contents.iter().flat_map(of).collect()
    }

    /// Whether some message is not covered by a CRC: there are no chunks, bytes of a chunk were copied
    /// outside of it and form a message there, the last chunk seems to continue after the end of the
    /// file, or the CRC of a chunk was set to 0, which means that there is none.
    fn is_unchecked(&self, altered: &[u8]) -> bool {
        let mut at = 8;
        while let Some(&[opcode, ref length @ ..]) =
            altered.get(at..).and_then(|rest| rest.first_chunk::<9>())
        {
            if opcode == op::MESSAGE {
                return true;
            }
            at = at.saturating_add(9).saturating_add(u64::from_le_bytes(*length) as usize);
            if opcode == op::CHUNK && altered.len() < at {
                return true;
            }
        }
        self.crcs.is_empty()
            || self.crcs.iter().any(|crc| altered.get(crc.clone()) == Some(&[0; 4]))
    }

    /// Checks the result of an altered log.
    fn check(&self, altered: &[u8], what: &str) {
        let what = format!("{}: {what}", self.name);
        let unchecked = self.is_unchecked(altered);
        let (scans, ingested) = match ingest_within_memory(altered, &self.options, &what) {
            Ok(found) => found,
            // A topic without its schema has no type.
            Err(
                IngestError::Empty { .. }
                | IngestError::NotMcap { .. }
                | IngestError::NoTopic { .. }
                | IngestError::WrongType { .. }
                | IngestError::NoScans { .. }
                | IngestError::NoPoses { .. },
            ) => return,
            // The content of a message without a CRC cannot be checked.
            Err(
                IngestError::NoBeam { .. }
                | IngestError::OtherSensor { .. }
                | IngestError::DeadLaser { .. },
            ) if unchecked => return,
            Err(other) => panic!("{what}: {other}"),
        };
        let poses = ingested.trajectory.poses();
        let intact_poses = self.ingested.trajectory.poses();
        if !unchecked {
            assert!(
                self.are_of_intact(&scans),
                "{what}: scans differ from the intact log: {scans:?} instead of {:?}, {:?}",
                self.scans,
                ingested.losses
            );
            // If chunks are missing or change places, segments can start elsewhere.
            let is_same = |a: &StampedPose, b: &StampedPose| {
                (a.stamp_ns, a.pose, a.z_m) == (b.stamp_ns, b.pose, b.z_m)
            };
            assert!(is_subsequence(poses, intact_poses, is_same), "{what}: poses");
        }
        let is_less = scans.len() < self.scans.len() || poses.len() < intact_poses.len();
        // An altered azimuth can end a revolution early. It then counts as partial.
        let is_counted = !ingested.losses.is_empty()
            || unchecked
                && self.is_of_packets
                && self.ingested.n_partial_revolutions < ingested.n_partial_revolutions;
        assert!(!is_less || is_counted, "{what}: {} scans, nothing counted", scans.len());
    }

    /// Whether the scans are some of the scans of the intact log. If packets were lost with a chunk, a
    /// scan has only some of the points of the intact scan.
    fn are_of_intact(&self, scans: &[Scan]) -> bool {
        let is_part = |scan: &Scan, whole: &Scan| match self.is_of_packets {
            false => scan == whole,
            true => is_subsequence(&points(scan), &points(whole), |a, b| a == b),
        };
        is_subsequence(scans, &self.scans, is_part)
    }
}

fn points(scan: &Scan) -> Vec<(f32, f32)> {
    scan.x_m.iter().copied().zip(scan.y_m.iter().copied()).collect()
}

fn is_subsequence<T>(some: &[T], all: &[T], same: impl Fn(&T, &T) -> bool) -> bool {
    let mut rest = all.iter();
    some.iter().all(|one| rest.any(|other| same(one, other)))
}

struct Random(u64);

impl Random {
    /// Linear congruential generator (Knuth, MMIX). The upper bits are the best.
    fn below(&mut self, n: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n
    }
}

/// Alters bytes as disks, networks and crashed recorders do.
fn corrupt(bytes: &mut Vec<u8>, random: &mut Random) -> String {
    let n = bytes.len();
    let (at, other) = (random.below(n), random.below(n));
    let length = 1 + random.below(256).min(n - 1 - at.max(other));
    match random.below(6) {
        0 => {
            bytes[at] ^= 1 << random.below(8);
            format!("bit flipped at {at}")
        }
        1 => {
            let n_changed = 1 + random.below(16);
            let places: Vec<usize> = (0..n_changed).map(|_| random.below(n)).collect();
            places.iter().for_each(|&at| bytes[at] = random.below(256) as u8);
            format!("bytes changed at {places:?}")
        }
        2 => {
            bytes[at..at + length].fill(0);
            format!("{length} zeros at {at}")
        }
        3 => {
            let length = length.min(at.abs_diff(other));
            let (low, high) = bytes.split_at_mut(at.max(other));
            low[at.min(other)..][..length].swap_with_slice(&mut high[..length]);
            format!("{length} bytes at {at} and {other} swapped")
        }
        4 => {
            let copy = bytes[at..at + length].to_owned();
            bytes.splice(other..other, copy);
            format!("{length} bytes at {at} copied to {other}")
        }
        _ => {
            bytes.drain(at..at + length);
            format!("{length} bytes at {at} removed")
        }
    }
}

#[test]
fn random_corruptions_give_correct_data_and_counted_losses() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let n: usize = std::env::var("LOOPBOOST_CORRUPTIONS")
        .map_or(300, |n| n.parse().expect("LOOPBOOST_CORRUPTIONS is a number"));
    let logs = Intact::all();
    let mut random = Random(2436);
    for k in 0..n {
        let log = &logs[k % logs.len()];
        let mut altered = log.bytes.clone();
        let what = corrupt(&mut altered, &mut random);
        log.check(&altered, &what);
    }
}

/// Truncates logs of packets and clouds at every byte. `logs.rs` truncates planar ones.
#[test]
fn a_log_truncated_at_any_byte_gives_its_start_and_a_counted_loss() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for log in Intact::all() {
        // Logs of uncompressed packets are long, so not every byte is tested.
        let step = if 5000 < log.bytes.len() { 7 } else { 1 };
        for cut in (0..log.bytes.len()).step_by(step) {
            log.check(&log.bytes[..cut], &format!("cut at {cut}"));
            if let Ok((scans, ingested)) = ingest_bytes(&log.bytes[..cut], &log.options) {
                assert!(!ingested.losses.is_empty(), "{}: cut at {cut}", log.name);
                assert!(log.are_of_intact(&scans), "{}: cut at {cut}", log.name);
            }
        }
    }
}

/// The start of the first record of a kind.
fn find(bytes: &[u8], opcode: u8, from: usize) -> usize {
    let mut at = from;
    while bytes[at] != opcode {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    at
}

fn scans_of(bytes: &[u8], what: &str) -> (usize, Vec<(&'static str, u64)>) {
    let options = options("/scan", Some("/pose"));
    let (scans, ingested) = ingest_within_memory(bytes, &options, what).unwrap();
    (scans.len(), codes(&ingested.losses))
}

/// Opcode, length and two times come before the size in a chunk header.
#[test]
fn a_chunk_that_claims_a_gibibyte_does_not_allocate_it() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for compression in [Some(Compression::Zstd), Some(Compression::Lz4), None] {
        let whole = write(&planar_log(), WriteOptions::new().compression(compression));
        let size = find(&whole, op::CHUNK, 8) + 9 + 16;
        let mut bytes = whole.clone();
        bytes[size..size + 8].copy_from_slice(&(1u64 << 30).to_le_bytes());
        let options = options("/scan", None);
        for bytes in [&bytes[..], &bytes[..bytes.len() - 8], &bytes[..size + 400]] {
            let what = format!("{compression:?}, {} bytes", bytes.len());
            let _scans_or_none = ingest_within_memory(bytes, &options, &what);
        }
        let error = ingest_within_memory(&bytes, &options, "whole").unwrap_err().to_string();
        assert!(error.contains("1 chunk "), "{error}");
    }
}

/// The log contains scans and a camera image of zeros.
#[test]
fn a_chunk_compressed_by_a_factor_of_a_thousand_is_read() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut entries = planar_log();
    entries.insert(7, ("/camera", "sensor_msgs/msg/Image", "cdr", vec![0; 9 << 20]));
    for compression in [Some(Compression::Zstd), Some(Compression::Lz4)] {
        let one_chunk = WriteOptions::new().compression(compression).chunk_size(None);
        let bytes = write(&entries, one_chunk);
        assert!(bytes.len() < 100_000);
        assert_eq!(scans_of(&bytes, "whole"), (10, vec![]));
        // If the end is missing, the scans before it are kept.
        let end = find(&bytes, op::CHUNK, 8) + 9 + bytes.len() * 3 / 4;
        let (n_scans, losses) = scans_of(&bytes[..end.min(bytes.len() - 300)], "cut");
        assert!(n_scans <= 10 && losses.len() == 1, "{n_scans} {losses:?}");
    }
}

/// The id of a schema comes before the length of its name, which claims 4 GiB here. In the data, the
/// schema becomes a malformed record. In the summary, the summary becomes damaged, even without a CRC.
#[test]
fn a_name_that_claims_four_gibibytes_does_not_allocate_them() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let corrupt_name = |bytes: &mut Vec<u8>, from| {
        let name = find(bytes, op::SCHEMA, from) + 9 + 2;
        bytes[name..name + 4].fill(0xff);
    };
    let mut in_data =
        write(&planar_log(), WriteOptions::new().use_chunks(false).emit_summary_records(false));
    corrupt_name(&mut in_data, 8);
    // The type of the channel without a schema is found from its messages.
    assert_eq!(scans_of(&in_data, "in the data"), (10, vec![("malformed_records", 1)]));

    let mut in_summary = write(&planar_log(), small_chunks());
    let start = mcap::read::footer(&in_summary).unwrap().summary_start as usize;
    corrupt_name(&mut in_summary, start);
    let crc = in_summary.len() - 12;
    in_summary[crc..crc + 4].fill(0);
    assert_eq!(scans_of(&in_summary, "in the summary"), (10, vec![("damaged_summary", 1)]));
}

/// No CRC covers the opcode of a record. The loss shows only in the statistics and the index.
#[test]
fn a_record_with_an_altered_opcode_is_a_counted_loss() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let chunked = small_chunks().compression(None).calculate_chunk_crcs(false);
    let unchunked = WriteOptions::new().use_chunks(false);
    // An attachment, an undefined opcode, and a private opcode.
    for kind in [op::ATTACHMENT, 0x42, 0x99] {
        let mut of_chunk = write(&planar_log(), chunked.clone());
        let chunk = find(&of_chunk, op::CHUNK, 8);
        // An empty compression.
        let message = find(&of_chunk, op::MESSAGE, chunk + 9 + 40);
        of_chunk[message] = kind;
        let mut loose = write(&planar_log(), unchunked.clone());
        let message = find(&loose, op::MESSAGE, 8);
        loose[message] = kind;
        for bytes in [of_chunk, loose] {
            let (n_scans, losses) = scans_of(&bytes, "a message");
            assert_eq!((n_scans, losses.is_empty()), (9, false), "{kind:#x} {losses:?}");
        }
        let mut whole_chunk = write(&planar_log(), small_chunks());
        // The first chunk contains the channels.
        let chunk = find(&whole_chunk, op::CHUNK, find(&whole_chunk, op::MESSAGE_INDEX, 8));
        whole_chunk[chunk] = kind;
        let (n_scans, losses) = scans_of(&whole_chunk, "a chunk");
        assert!(n_scans < 10 && !losses.is_empty(), "{kind:#x} {losses:?}");
    }
}

/// A chunk whose length points beyond the end of the file is still checked against its CRC if its data
/// is complete.
#[test]
fn a_chunk_with_an_altered_length_is_still_checked() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for (name, layout) in layouts().into_iter().take(3) {
        let whole = write(&planar_log(), layout);
        let intact = ingest_bytes(&whole, &options("/scan", Some("/pose"))).unwrap().0;
        let mut bytes = whole.clone();
        let chunk = find(&bytes, op::CHUNK, find(&bytes, op::MESSAGE_INDEX, 8));
        bytes[chunk + 7] = 1;
        let data = chunk + 9 + 40 + name.len().min(4);
        for at in data..data + 200 {
            let mut altered = bytes.clone();
            altered[at] ^= 4;
            let Ok((scans, ingested)) = ingest_bytes(&altered, &options("/scan", Some("/pose")))
            else {
                continue;
            };
            let is_part = is_subsequence(&scans, &intact, |a, b| a == b);
            assert!(is_part && !ingested.losses.is_empty(), "{name}: byte {at}");
        }
    }
}

#[test]
fn a_file_and_its_bytes_give_the_same_result() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let bytes = write(&planar_log(), small_chunks());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    std::fs::write(&path, &bytes).unwrap();
    let options = options("/scan", Some("/pose"));
    assert_eq!(ingest_file(&path, &options).unwrap(), ingest_bytes(&bytes, &options).unwrap());
}
