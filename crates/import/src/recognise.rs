//! Formats told by content.

use std::fmt;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::error::ImportError;
use crate::input::{excerpt, read_full};
use crate::{carmen, nclt};

/// A format that can be imported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A network capture of a Velodyne sensor; libpcap and pcapng are told apart by content.
    Pcap,
    /// Raw files of the North Campus Long-Term data set: a folder of them, or one.
    Nclt,
    /// A log of CARMEN, the Carnegie Mellon Robot Navigation Toolkit.
    Carmen,
}

impl Format {
    /// A word for metadata and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pcap => "pcap",
            Self::Nclt => "nclt",
            Self::Carmen => "carmen",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pcap => "a network capture",
            Self::Nclt => "NCLT data",
            Self::Carmen => "a CARMEN log",
        })
    }
}

/// Bytes looked at to tell a file's format: the comments and parameters that open a CARMEN log are
/// some kilobytes.
const HEAD_BYTES: usize = 1 << 16;

/// First four bytes of a libpcap file, as the writing machine had them (pcap-savefile(5)):
/// microseconds, nanoseconds, and Kuznetzov's modified format.
const PCAP_MAGICS: [u32; 3] = [0xA1B2_C3D4, 0xA1B2_3C4D, 0xA1B2_CD34];
/// First four bytes of a pcapng file: the type of its section header (draft-ietf-opsawg-pcapng,
/// section 4.1), the same in both byte orders.
pub(crate) const PCAPNG_MAGIC: u32 = 0x0A0D_0D0A;

const EXPECTED: &str = "a libpcap or pcapng capture, an NCLT folder or file (velodyne_hits.bin, \
    odometry_mu_100hz.csv, groundtruth_DATE.csv, ...), or a CARMEN log (FLASER, ROBOTLASER1, ODOM)";

/// Tells the format of a file or folder by what it holds.
pub fn recognise(path: &Path) -> Result<Format, ImportError> {
    let unrecognised = |found: String| ImportError::Unrecognised {
        path: path.to_owned(),
        found,
        expected: EXPECTED.to_owned(),
    };
    let metadata = fs::metadata(path).map_err(|source| ImportError::io("read", path, source))?;
    if metadata.is_dir() {
        let files = nclt_files(path)?;
        return match files.is_empty() {
            false => Ok(Format::Nclt),
            true => Err(unrecognised(folder_contents(path)?)),
        };
    }
    let mut head = vec![0; HEAD_BYTES];
    let n = File::open(path)
        .and_then(|mut file| read_full(&mut file, &mut head))
        .map_err(|source| ImportError::io("read", path, source))?;
    head.truncate(n);
    of_head(path, &head).map_err(unrecognised)
}

fn of_head(path: &Path, head: &[u8]) -> Result<Format, String> {
    if let Some(magic) = head.first_chunk::<4>() {
        let (little, big) = (u32::from_le_bytes(*magic), u32::from_be_bytes(*magic));
        if PCAP_MAGICS.contains(&little) || PCAP_MAGICS.contains(&big) || little == PCAPNG_MAGIC {
            return Ok(Format::Pcap);
        }
    }
    if nclt::is_hits(head) {
        return Ok(Format::Nclt);
    }
    let known: [(&[u8], &str); 6] = [
        (b"\x89MCAP", "an MCAP log already"),
        (b"#ROSBAG", "a ROS 1 bag: convert it with `mcap convert`"),
        (b"SQLite format 3", "an SQLite file, perhaps a ROS 2 bag: convert it with `mcap convert`"),
        (b"\x1F\x8B", "gzip data: unpack it first"),
        (b"PK\x03\x04", "a zip archive: unpack it first"),
        (b"\x28\xB5\x2F\xFD", "Zstandard data: unpack it first"),
    ];
    if let Some((_, found)) = known.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Err((*found).to_owned());
    }
    if head.is_empty() {
        return Err("an empty file".to_owned());
    }
    // The head of a long file ends within a line.
    let text = String::from_utf8_lossy(head);
    if nclt::is_table(path) {
        return Ok(Format::Nclt);
    }
    if text.lines().any(carmen::is_message) {
        return Ok(Format::Carmen);
    }
    Err(match std::str::from_utf8(&head[..head.len().min(8)]) {
        Ok(_) => format!("text that starts with {}", excerpt(text.lines().next().unwrap_or(""))),
        Err(_) => format!("a file that starts with the bytes {:02x?}", &head[..head.len().min(8)]),
    })
}

/// The files of an NCLT folder that are known, by name.
fn nclt_files(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let entries = entries(folder)?;
    Ok(entries.into_iter().filter(|path| nclt::is_known(path) && path.is_file()).collect())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let error = |source| ImportError::io("read folder", folder, source);
    let mut entries = fs::read_dir(folder)
        .map_err(error)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(error)?;
    entries.sort();
    Ok(entries)
}

/// What a folder holds, in a few words.
fn folder_contents(folder: &Path) -> Result<String, ImportError> {
    const SHOWN: usize = 5;
    let entries = entries(folder)?;
    let mut names: Vec<_> = entries.iter().take(SHOWN).map(|path| crate::file_name(path)).collect();
    if SHOWN < entries.len() {
        names.push(format!("and {} more", entries.len() - SHOWN));
    }
    Ok(match names.is_empty() {
        true => "an empty folder".to_owned(),
        false => format!("a folder of {}", names.join(", ")),
    })
}

/// The one format of all inputs, and their files; folders are opened, doubles left out.
pub(crate) fn files(inputs: &[PathBuf]) -> Result<(Format, Vec<PathBuf>), ImportError> {
    let first = inputs.first().ok_or(ImportError::NoInput)?;
    let format = recognise(first)?;
    let mut files: Vec<PathBuf> = Vec::new();
    for input in inputs {
        let second_format = recognise(input)?;
        if second_format != format {
            return Err(ImportError::Mixed {
                first: first.clone(),
                first_format: format,
                second: input.clone(),
                second_format,
            });
        }
        let found = if input.is_dir() { nclt_files(input)? } else { vec![input.clone()] };
        for file in found {
            if !files.contains(&file) {
                files.push(file);
            }
        }
    }
    Ok((format, files))
}
