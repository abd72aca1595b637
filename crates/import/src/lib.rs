//! Converts recordings in other formats to MCAP logs, which viewers open and `ingest` reads.
//!
//! | format | content | file |
//! |---|---|---|
//! | [`Format::Pcap`] | a network capture of a Velodyne sensor, libpcap or pcapng | `pcap/` |
//! | [`Format::Nclt`] | raw files of the North Campus Long-Term data set | `nclt/` |
//! | [`Format::Carmen`] | a log of the Carnegie Mellon Robot Navigation Toolkit | `carmen/` |
//! | [`Format::Bag`] | a ROS 1 bag | `bag/ros1.rs` |
//! | [`Format::Bag2`] | a ROS 2 bag with SQLite storage | `bag/ros2.rs` |
//!
//! Each reader streams its file from start to end. [`import`] merges the readers by time, and the
//! memory that it needs does not grow with the length of the recording. Data that cannot be used is
//! counted by kind and file ([`Imported::losses`]). A file with unexpected content is an error. The
//! error states the place, what was found and what was expected. The same recording always gives
//! the same bytes.
//!
//! The messages of bags are copied unchanged. In logs of other recordings, all axes follow REP 103: x forward, y left, z up. In maps, x points east and y north if the
//! recording contains these directions.
//!
//! ```
//! use std::io::Cursor;
//!
//! let folder = tempfile::tempdir()?;
//! let log = folder.path().join("drive.log");
//! // A scan of three readings, two poses, and the time.
//! std::fs::write(&log, "FLASER 3 1.5 1.6 1.5 0 0 0 0 0 0 976052857.25 robot 0.1\n")?;
//!
//! let mut mcap = Cursor::new(Vec::new());
//! let imported = import::import(&[log], &import::Options::default(), &mut mcap, |_n_bytes| {})?;
//!
//! assert_eq!(imported.format, import::Format::Carmen);
//! let topics: Vec<&str> = imported.topics.iter().map(|topic| topic.topic.as_str()).collect();
//! assert_eq!(topics, ["/odom", "/scan"]);
//! assert!(imported.losses.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod axes;
mod bag;
mod carmen;
mod encode;
mod error;
mod format;
mod identify;
mod input;
mod nclt;
mod options;
mod pcap;
mod record;
mod sniff;
mod write;

use std::io::{Seek, Write};
use std::path::PathBuf;

use dataset::{Losses, Note};

pub use error::ImportError;
pub use format::Format;
pub use identify::{Recording, identify};
pub use options::{Compression, Options, Topics};
pub use sniff::sniff;
pub use write::{Imported, ImportedTopic};

use input::Meter;
use record::{Record, Source};
use write::LogWriter;

/// The total size of a recording \[bytes\], and approximately the last value that [`import`] passes
/// to `progress`.
pub fn input_bytes(inputs: &[PathBuf]) -> Result<u64, ImportError> {
    let (_, files) = sniff::files(inputs)?;
    let sizes = files.iter().map(|path| match std::fs::metadata(path) {
        Ok(metadata) => Ok(metadata.len()),
        Err(source) => Err(ImportError::io("read", path, source)),
    });
    sizes.sum()
}

/// Writes a recording as an MCAP log: profile `ros2`, CDR messages, chunks of about 1 MB, with all
/// schemas. The messages of bags stay as they are, with the profile `ros1` for bags of ROS 1.
///
/// `inputs` are files of one format (several parts of a capture or of a bag, or several files of an NCLT
/// session), or the folder of an NCLT session or of a ROS 2 bag. Messages are sorted by log time. The log time is the time in the
/// header, for bags the time of the recording. If that time steps back within a file, the log time stays at the latest time so far. The
/// header and the publish time keep the recorded time, and [`Imported::losses`] counts the message.
///
/// `progress` is called with the number of bytes read so far.
pub fn import(
    inputs: &[PathBuf],
    options: &Options,
    out: impl Write + Seek,
    progress: impl Fn(u64),
) -> Result<Imported, ImportError> {
    let (format, files) = sniff::files(inputs)?;
    let meter = Meter::default();
    if matches!(format, Format::Bag | Format::Bag2) {
        return bag::import(format, &files, options, out, &meter, progress);
    }
    if !options.select.is_empty() {
        return Err(ImportError::TopicsOfOtherFormat { format });
    }
    let mut losses = Losses::default();
    let mut notes = Vec::new();
    let mut sources = open(format, &files, options, &meter, &mut losses, &mut notes)?;

    let mut writer = LogWriter::new(out, format, &files, options)?;
    let mut heads: Vec<Option<Record>> = Vec::with_capacity(sources.len());
    for source in &mut sources {
        heads.push(source.next(&mut losses)?);
    }
    while let Some(earliest) = earliest(heads.iter().map(|head| Some(head.as_ref()?.stamp_ns))) {
        let next = sources[earliest].next(&mut losses)?;
        let record = std::mem::replace(&mut heads[earliest], next);
        writer.write(&record.expect("the earliest head is a record"), &mut losses)?;
        progress(meter.bytes());
    }
    progress(meter.bytes());
    writer.finish(&files, losses, notes)
}

/// The index of the earliest stamp. Of equal stamps, the first.
fn earliest(stamps: impl Iterator<Item = Option<i64>>) -> Option<usize> {
    stamps.enumerate().filter_map(|(k, stamp)| Some((stamp?, k))).min().map(|(_, k)| k)
}

/// Opens a reader for each file.
fn open(
    format: Format,
    files: &[PathBuf],
    options: &Options,
    meter: &Meter,
    losses: &mut Losses,
    notes: &mut Vec<Note>,
) -> Result<Vec<Box<dyn Source>>, ImportError> {
    let mut sources: Vec<Box<dyn Source>> = Vec::new();
    match format {
        Format::Pcap => {
            let sensor = pcap::Sensor::new(options);
            for path in files {
                sources.push(Box::new(pcap::Capture::open(path, options, &sensor, meter)?));
            }
        }
        Format::Nclt => sources = nclt::open(files, meter, losses)?,
        // They are copied as they are.
        Format::Bag | Format::Bag2 => {}
        Format::Carmen => {
            let mut after_ns = 0;
            for path in files {
                let log = carmen::Log::open(path, options, meter, after_ns, notes)?;
                after_ns = log.end_by_line_ns().unwrap_or(after_ns);
                sources.push(Box::new(log));
            }
        }
    }
    Ok(sources)
}
