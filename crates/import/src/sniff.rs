//! Content sniffing: the format of a file, from its first bytes.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use crate::error::ImportError;
use crate::format::Format;
use crate::input::{excerpt, file_name, read_full};
use crate::{bag, carmen, nclt, pcap};

/// The number of bytes read to find the format of a file. A CARMEN log starts with some kilobytes
/// of comments and parameters.
const HEAD_BYTES: usize = 1 << 16;

const EXPECTED: &str = "a libpcap or pcapng capture, a ROS 1 bag, a ROS 2 bag (.db3 or its folder), an NCLT \
    folder or file (velodyne_hits.bin, odometry_mu_100hz.csv, groundtruth_DATE.csv, ...), or a CARMEN \
    log (FLASER, ROBOTLASER1, ODOM)";

/// Finds the format of a file or folder from its content.
pub fn sniff(path: &Path) -> Result<Format, ImportError> {
    let unknown = |found: String| ImportError::UnknownFormat {
        path: path.to_owned(),
        found,
        expected: EXPECTED.to_owned(),
    };
    let metadata = fs::metadata(path).map_err(|source| ImportError::io("read", path, source))?;
    if metadata.is_dir() {
        if bag::is_bag_folder(path) {
            return Ok(Format::Bag2);
        }
        let files = nclt_files(path)?;
        return match files.is_empty() {
            false => Ok(Format::Nclt),
            true => Err(unknown(folder_contents(path)?)),
        };
    }
    let head = head(path).map_err(|source| ImportError::io("read", path, source))?;
    sniff_head(path, &head).map_err(unknown)
}

/// The first bytes of a file.
pub(crate) fn head(path: &Path) -> io::Result<Vec<u8>> {
    let mut head = vec![0; HEAD_BYTES];
    let n = read_full(&mut File::open(path)?, &mut head)?;
    head.truncate(n);
    Ok(head)
}

/// Finds the format from the first bytes of a file. The error describes an unknown format.
pub(crate) fn sniff_head(path: &Path, head: &[u8]) -> Result<Format, String> {
    if pcap::is_capture(head) {
        return Ok(Format::Pcap);
    }
    if nclt::is_hits(head) {
        return Ok(Format::Nclt);
    }
    if head.starts_with(b"#ROSBAG") {
        return Ok(Format::Bag);
    }
    let is_packed = bag::is_packed(path) && head.starts_with(b"\x28\xB5\x2F\xFD");
    if head.starts_with(b"SQLite format 3\0") || is_packed {
        return Ok(Format::Bag2);
    }
    let not_importable: [(&[u8], &str); 4] = [
        (b"\x89MCAP", "an MCAP file (it needs no import)"),
        (b"\x1F\x8B", "gzip data (unpack it first)"),
        (b"PK\x03\x04", "a zip archive (unpack it first)"),
        (b"\x28\xB5\x2F\xFD", "Zstandard data (unpack it first)"),
    ];
    if let Some((_, found)) = not_importable.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Err((*found).to_owned());
    }
    if head.is_empty() {
        return Err("an empty file".to_owned());
    }
    // In a long file, the last line of the head is truncated.
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

/// The files in a folder whose names belong to the NCLT data set, sorted by name.
fn nclt_files(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let entries = entries(folder)?;
    Ok(entries.into_iter().filter(|path| nclt::is_known(path) && path.is_file()).collect())
}

pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let error = |source| ImportError::io("read folder", folder, source);
    let mut entries = fs::read_dir(folder)
        .map_err(error)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<Vec<_>, _>>()
        .map_err(error)?;
    entries.sort();
    Ok(entries)
}

/// A short description of the contents of a folder.
fn folder_contents(folder: &Path) -> Result<String, ImportError> {
    const MAX_NAMES: usize = 5;
    let entries = entries(folder)?;
    let mut names: Vec<_> = entries.iter().take(MAX_NAMES).map(|path| file_name(path)).collect();
    if MAX_NAMES < entries.len() {
        names.push(format!("and {} more", entries.len() - MAX_NAMES));
    }
    Ok(match names.is_empty() {
        true => "an empty folder".to_owned(),
        false => format!("a folder with {}", names.join(", ")),
    })
}

/// The common format of all inputs, and their files. A folder stands for its NCLT files, or for the files of its bag. A file
/// that is given twice is listed once.
pub(crate) fn files(inputs: &[PathBuf]) -> Result<(Format, Vec<PathBuf>), ImportError> {
    let first = inputs.first().ok_or(ImportError::NoInput)?;
    let format = sniff(first)?;
    let mut files: Vec<PathBuf> = Vec::new();
    let mut known = BTreeSet::new();
    for input in inputs {
        let second_format = sniff(input)?;
        if second_format != format {
            return Err(ImportError::Mixed {
                first: first.clone(),
                first_format: format,
                second: input.clone(),
                second_format,
            });
        }
        let found = match (input.is_dir(), format) {
            (true, Format::Bag2) => bag::bag_files(input)?,
            (true, _) => nclt_files(input)?,
            (false, _) => vec![input.clone()],
        };
        for file in found {
            let path = file.canonicalize().unwrap_or_else(|_| file.clone());
            if known.insert(path) {
                files.push(file);
            }
        }
    }
    Ok((format, files))
}
