//! Recordings in other formats -> MCAP logs that a viewer opens and `ingest` reads.
//!
//! | format | what it is | file |
//! |---|---|---|
//! | [`Format::Pcap`] | a network capture of a Velodyne sensor, libpcap or pcapng | `pcap/` |
//! | [`Format::Nclt`] | raw files of the North Campus Long-Term data set | `nclt/` |
//! | [`Format::Carmen`] | a log of the Carnegie Mellon Robot Navigation Toolkit | `carmen.rs` |
//!
//! Every reader streams its file from top to bottom; [`import`] merges the readers by time, so that
//! memory does not grow with the recording. What cannot be used is counted by reason
//! ([`Imported::dropped`]); a file that is something else altogether is an error that says what
//! was found, where, and what was expected. The same recording gives the same bytes.
//!
//! The axes of all that is written are those of REP 103: x forward, y left, z up; maps have x east,
//! y north where the recording knows it.
//!
//! ```no_run
//! use std::{fs::File, io::BufWriter, path::PathBuf};
//!
//! let inputs = [PathBuf::from("drive.pcap")];
//! let out = BufWriter::new(File::create("drive.mcap").unwrap());
//! let imported = import::import(&inputs, &import::Options::default(), out, |_bytes| {}).unwrap();
//! for topic in &imported.topics {
//!     println!("{}: {} messages", topic.topic, topic.n_messages);
//! }
//! println!("not used: {}", imported.dropped);
//! ```

mod carmen;
mod encode;
mod error;
mod input;
mod nclt;
mod options;
mod pcap;
mod recognise;
mod record;
mod rotation;
mod write;

use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

use dataset::Dropped;

pub use error::ImportError;
pub use options::{Compression, Options, Topics};
pub use recognise::{Format, recognise};
pub use write::ImportedTopic;

use input::Meter;
use record::{Losses, Record, Source};
use write::LogWriter;

/// What was written, and what was not.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The recording's format.
    pub format: Format,
    /// Topics with their types and numbers of messages, by topic.
    pub topics: Vec<ImportedTopic>,
    /// Log time of the first message \[ns since the epoch\].
    pub start_ns: i64,
    /// Log time of the last message \[ns since the epoch\].
    pub end_ns: i64,
    /// Rows, packets and stretches that could not be used, by reason.
    pub dropped: Dropped,
    /// What is worth knowing and no loss, counted in the same way: other traffic of a capture,
    /// lines of a log that hold no sensor data, stamps that step back.
    pub remarks: Dropped,
}

/// The bytes of a recording: what `progress` of [`import`] counts up to, about.
pub fn input_bytes(inputs: &[PathBuf]) -> Result<u64, ImportError> {
    let (_, files) = recognise::files(inputs)?;
    let sizes = files.iter().map(|path| match std::fs::metadata(path) {
        Ok(metadata) => Ok(metadata.len()),
        Err(source) => Err(ImportError::io("read", path, source)),
    });
    sizes.sum()
}

/// Writes a recording as an MCAP log: profile `ros2`, CDR, chunks of about 1 MB, schemas carried.
///
/// `inputs` are files of one format (several parts of a capture, several files of an NCLT session)
/// or an NCLT folder. Messages are in the order of their log time, which is the time in their
/// header. Where that steps back within a file the log time is held at the latest one so far, the
/// header and the publish time keep what was recorded, and [`Imported::remarks`] counts it.
///
/// `progress` is told how many bytes have been read so far.
pub fn import(
    inputs: &[PathBuf],
    options: &Options,
    out: impl Write + Seek,
    progress: impl Fn(u64),
) -> Result<Imported, ImportError> {
    let (format, files) = recognise::files(inputs)?;
    let meter = Meter::default();
    let mut losses = Losses::default();
    let mut sources = open(format, &files, options, &meter, &mut losses)?;

    let mut writer = LogWriter::new(out, format, &files, options)?;
    let mut heads: Vec<Option<Record>> = Vec::with_capacity(sources.len());
    for source in &mut sources {
        heads.push(source.next(&mut losses)?);
    }
    while let Some(earliest) = earliest(&heads) {
        let next = sources[earliest].next(&mut losses)?;
        let record = std::mem::replace(&mut heads[earliest], next);
        writer.write(&record.expect("the earliest head is one"), &mut losses)?;
        progress(meter.bytes());
    }
    progress(meter.bytes());
    writer.finish(&files, losses)
}

/// The head with the earliest stamp; the first of several.
fn earliest(heads: &[Option<Record>]) -> Option<usize> {
    let stamps =
        heads.iter().enumerate().filter_map(|(k, head)| Some((head.as_ref()?.stamp_ns, k)));
    stamps.min().map(|(_, k)| k)
}

fn open(
    format: Format,
    files: &[PathBuf],
    options: &Options,
    meter: &Meter,
    losses: &mut Losses,
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
        Format::Carmen => {
            for path in files {
                sources.push(Box::new(carmen::Log::open(path, meter)?));
            }
        }
    }
    Ok(sources)
}

/// A file's name, for reasons and metadata.
fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
