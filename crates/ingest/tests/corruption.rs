//! Logs with broken bytes: what comes out is an error, or right; what is lost is counted; and no
//! bytes make the program take memory that they do not fill.
//!
//! 300 corruptions are made in a normal run, `LOOPBOOST_CORRUPTIONS=10000` makes more.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

use common::{
    Entry, cloud_log, coarse_packet_log, ingest_bytes, ingest_file, options, planar_log, reasons,
    small_chunks, write,
};
use dataset::Scan;
use ingest::{IngestError, Ingested, Options};
use mcap::records::op;
use mcap::{Compression, WriteOptions};
use messages::Encoding;

/// Memory that reading a log takes above the log's own size: the table of directions, 0.6 MB, and
/// for each chunk that claims it up to 8 MB, of which a thread reads one at a time.
const MEMORY_BYTES: usize = 32 << 20;

struct Counting;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.fetch_add(layout.size(), Relaxed) + layout.size();
        PEAK.fetch_max(live, Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test at a time: the memory that is counted is the whole program's.
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

/// An intact log and what it gives.
struct Intact {
    name: String,
    bytes: Vec<u8>,
    options: Options,
    scans: Vec<Scan>,
    ingested: Ingested,
    is_of_packets: bool,
    /// Where its chunks keep their checksums; none where there are no chunks.
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
        assert!(3 <= scans.len() && ingested.dropped.is_empty(), "{name}: {ingested:?}");
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        // Opcode, length, two times and the size stand before it.
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

    /// Whether nothing vouches for some message: there are no chunks, bytes of a chunk were copied to
    /// where they are a message outside any, the last chunk seems to go on behind the end of the
    /// file, or a chunk's checksum was made 0, which means none.
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

    /// Checks what an altered log gives.
    fn check(&self, altered: &[u8], what: &str) {
        let what = format!("{}: {what}", self.name);
        let unchecked = self.is_unchecked(altered);
        let (scans, ingested) = match ingest_within_memory(altered, &self.options, &what) {
            Ok(found) => found,
            // A topic whose schema is lost has no type any more.
            Err(
                IngestError::Empty { .. }
                | IngestError::NotMcap { .. }
                | IngestError::NoTopic { .. }
                | IngestError::WrongType { .. }
                | IngestError::NoScans { .. }
                | IngestError::NoPoses { .. },
            ) => return,
            // What a message says is believed where nothing vouches for its bytes.
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
                "{what}: scans that are not the intact log's: {scans:?} instead of {:?}, {:?}",
                self.scans,
                ingested.dropped
            );
            assert!(is_subsequence(poses, intact_poses, |a, b| a == b), "{what}: poses");
        }
        let is_less = scans.len() < self.scans.len() || poses.len() < intact_poses.len();
        // An azimuth that was altered can end a turn early, and the turn then counts as partial.
        let is_told = !ingested.dropped.is_empty()
            || unchecked
                && self.is_of_packets
                && self.ingested.n_partial_revolutions < ingested.n_partial_revolutions;
        assert!(!is_less || is_told, "{what}: {} scans, nothing counted", scans.len());
    }

    /// Whether scans are those of the intact log, some left out. A turn may lack the packets of a
    /// chunk that was lost: its points are then some of the intact turn's.
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
    /// Knuth's MMIX; the upper bits are the good ones.
    fn below(&mut self, n: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n
    }
}

/// Alters bytes in one of the ways that disks, networks and writers that die alter them.
fn corrupt(bytes: &mut Vec<u8>, random: &mut Random) -> String {
    let n = bytes.len();
    let (at, other) = (random.below(n), random.below(n));
    let length = 1 + random.below(256).min(n - 1 - at.max(other));
    match random.below(6) {
        0 => {
            bytes[at] ^= 1 << random.below(8);
            format!("a bit at {at}")
        }
        1 => {
            let n_changed = 1 + random.below(16);
            let places: Vec<usize> = (0..n_changed).map(|_| random.below(n)).collect();
            places.iter().for_each(|&at| bytes[at] = random.below(256) as u8);
            format!("bytes at {places:?}")
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
            format!("{length} bytes at {at} again at {other}")
        }
        _ => {
            bytes.drain(at..at + length);
            format!("{length} bytes at {at} removed")
        }
    }
}

#[test]
fn random_corruptions_give_what_is_right_and_count_what_is_lost() {
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

/// At every cut of logs of packets and of clouds; `logs.rs` cuts planar ones.
#[test]
fn a_log_cut_at_any_byte_is_cut_short_and_says_so() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for log in Intact::all() {
        // Uncompressed packets are long and all alike.
        let step = if 5000 < log.bytes.len() { 7 } else { 1 };
        for cut in (0..log.bytes.len()).step_by(step) {
            log.check(&log.bytes[..cut], &format!("cut at {cut}"));
            if let Ok((scans, ingested)) = ingest_bytes(&log.bytes[..cut], &log.options) {
                assert!(!ingested.dropped.is_empty(), "{}: cut at {cut}", log.name);
                assert!(log.are_of_intact(&scans), "{}: cut at {cut}", log.name);
            }
        }
    }
}

/// Where the first record of a kind starts.
fn find(bytes: &[u8], opcode: u8, from: usize) -> usize {
    let mut at = from;
    while bytes[at] != opcode {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    at
}

fn scans_of(bytes: &[u8], what: &str) -> (usize, Vec<(String, u64)>) {
    let options = options("/scan", Some("/pose"));
    let (scans, ingested) = ingest_within_memory(bytes, &options, what).unwrap();
    let dropped = reasons(&ingested.dropped);
    (scans.len(), dropped.into_iter().map(|(reason, n)| (reason.to_owned(), n)).collect())
}

/// Opcode, length and two times stand before the size that a chunk claims.
#[test]
fn a_chunk_that_claims_a_gibibyte_takes_none() {
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
        assert!(error.contains("1 chunks "), "{error}");
    }
}

/// What shrinks 1000 times grows again: zeros of a camera beside the scans.
#[test]
fn a_chunk_that_shrank_a_thousand_times_is_read() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut entries = planar_log();
    entries.insert(7, ("/camera", "sensor_msgs/msg/Image", "cdr", vec![0; 9 << 20]));
    for compression in [Some(Compression::Zstd), Some(Compression::Lz4)] {
        let one_chunk = WriteOptions::new().compression(compression).chunk_size(None);
        let bytes = write(&entries, one_chunk);
        assert!(bytes.len() < 100_000);
        assert_eq!(scans_of(&bytes, "whole"), (10, vec![]));
        // Its end is missing: what came before is kept.
        let end = find(&bytes, op::CHUNK, 8) + 9 + bytes.len() * 3 / 4;
        let (n_scans, dropped) = scans_of(&bytes[..end.min(bytes.len() - 300)], "cut");
        assert!(n_scans <= 10 && dropped.len() == 1, "{n_scans} {dropped:?}");
    }
}

/// A schema's number stands before the length of its name; here it claims 4 GiB. In the data it
/// makes the schema malformed, in the summary the summary, though its own checksum may be missing.
#[test]
fn a_name_that_claims_four_gibibytes_takes_none() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let spoil = |bytes: &mut Vec<u8>, from| {
        let name = find(bytes, op::SCHEMA, from) + 9 + 2;
        bytes[name..name + 4].fill(0xff);
    };
    let mut in_data =
        write(&planar_log(), WriteOptions::new().use_chunks(false).emit_summary_records(false));
    spoil(&mut in_data, 8);
    // What the channel without a schema holds is told by its messages.
    let malformed = "records that are malformed".to_owned();
    assert_eq!(scans_of(&in_data, "in the data"), (10, vec![(malformed, 1)]));

    let mut in_summary = write(&planar_log(), small_chunks());
    let start = mcap::read::footer(&in_summary).unwrap().summary_start as usize;
    spoil(&mut in_summary, start);
    let crc = in_summary.len() - 12;
    in_summary[crc..crc + 4].fill(0);
    let damaged = "summaries that are damaged (the log was read without its index)".to_owned();
    assert_eq!(scans_of(&in_summary, "in the summary"), (10, vec![(damaged, 1)]));
}

/// The opcode of a record is vouched for by nothing but what else the log says of it.
#[test]
fn a_record_that_changes_its_kind_is_missed() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let chunked = small_chunks().compression(None).calculate_chunk_crcs(false);
    let unchunked = WriteOptions::new().use_chunks(false);
    // An attachment, an opcode that the format does not have, one that anybody may use.
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
            let (n_scans, dropped) = scans_of(&bytes, "a message");
            assert_eq!((n_scans, dropped.is_empty()), (9, false), "{kind:#x} {dropped:?}");
        }
        let mut whole_chunk = write(&planar_log(), small_chunks());
        // The first holds the channels.
        let chunk = find(&whole_chunk, op::CHUNK, find(&whole_chunk, op::MESSAGE_INDEX, 8));
        whole_chunk[chunk] = kind;
        let (n_scans, dropped) = scans_of(&whole_chunk, "a chunk");
        assert!(n_scans < 10 && !dropped.is_empty(), "{kind:#x} {dropped:?}");
    }
}

/// A chunk whose length says that it goes on behind the end of the file is checked all the same,
/// where its data is there.
#[test]
fn a_chunk_whose_length_was_altered_is_not_believed_unchecked() {
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
            assert!(is_part && !ingested.dropped.is_empty(), "{name}: byte {at}");
        }
    }
}

#[test]
fn a_file_and_its_bytes_give_the_same() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let bytes = write(&planar_log(), small_chunks());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    std::fs::write(&path, &bytes).unwrap();
    let options = options("/scan", Some("/pose"));
    assert_eq!(ingest_file(&path, &options).unwrap(), ingest_bytes(&bytes, &options).unwrap());
}
