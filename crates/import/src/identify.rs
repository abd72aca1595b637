//! Names recordings that are not MCAP files, and the command that reads or converts them.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::format::Format;
use crate::sniff::{entries, head, sniff, sniff_head};

/// A recording in a known format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recording {
    /// The format, as the end of the sentence "the file is ...".
    pub format: String,
    /// What to do with it: a sentence with a command.
    pub remedy: String,
}

/// Names the format of a file or folder, if it is known and not MCAP. A folder without a known layout
/// is named by its first file with a known format.
pub fn identify(path: &Path) -> Option<Recording> {
    if path.is_dir() {
        match sniff(path) {
            Ok(Format::Nclt) => return Some(importable("NCLT data", path)),
            Ok(Format::Bag2) => return Some(importable("a ROS 2 bag", path)),
            _ => {}
        }
        let files = entries(path).ok()?.into_iter().filter(|path| path.is_file());
        return files.take(MAX_FILES).find_map(|file| {
            let recording = identify(&file)?;
            let format = format!("a folder with {} ({})", name(&file), recording.format);
            Some(Recording { format, ..recording })
        });
    }
    let head = head(path).ok()?;
    if let Ok(format) = sniff_head(path, &head) {
        let format = match format {
            Format::Pcap if head.starts_with(&[0x0A, 0x0D, 0x0D, 0x0A]) => {
                "a network capture (pcapng)"
            }
            Format::Pcap => "a network capture (pcap)",
            Format::Nclt => "a file of the NCLT data set",
            Format::Carmen => "a CARMEN log",
            Format::Bag => "a ROS 1 bag",
            Format::Bag2 => "an SQLite database, as in ROS 2 bags (.db3)",
        };
        return Some(importable(format, path));
    }
    of_magic(path, &head)
}

/// Files of a folder that are looked at.
const MAX_FILES: usize = 100;

/// Formats that other programs read: first bytes, name, and a remedy with `{in}` and `{out}`.
const MAGICS: [(&[u8], &str, &str); 10] = [
    (b"\x28\xB5\x2F\xFD", "compressed with Zstandard", "decompress it: `zstd -d {in} -o {out}`"),
    (b"\x04\x22\x4D\x18", "compressed with LZ4", "decompress it: `lz4 -d {in} {out}`"),
    (b"\x1F\x8B", "compressed with gzip", "decompress it: `gzip -dc {in} > {out}`"),
    (b"BZh", "compressed with bzip2", "decompress it: `bzip2 -dc {in} > {out}`"),
    (b"\xFD7zXZ\0", "compressed with xz", "decompress it: `xz -dc {in} > {out}`"),
    (b"PK\x03\x04", "a zip archive", "unpack it: `unzip {in}`"),
    (b"7z\xBC\xAF\x27\x1C", "a 7-Zip archive", "unpack it: `7z x {in}`"),
    (
        b"PAR1",
        "a Parquet table, as loopboost writes them",
        "name the MCAP log that it was made from (`loopboost lineage {in}`)",
    ),
    (b"\x89HDF", "an HDF5 file", "convert it to MCAP with the tools of its data set"),
    (b"\x89PNG", "a PNG image", "name the MCAP log"),
];
const RAWLOG: (&str, &str) = (
    "an MRPT rawlog",
    "loopboost does not read rawlogs: `rawlog-edit --info -i {in}` describes it; to convert it, play \
     it with the ROS node `rawlog_play` of the package `mrpt_rawlog`, and record the topics with \
     `ros2 bag record --storage mcap`",
);
/// Position of the magic bytes of a tar archive (POSIX.1-1988, "ustar").
const TAR_MAGIC_AT: usize = 257;

fn of_magic(path: &Path, head: &[u8]) -> Option<Recording> {
    let tar = ("a tar archive", "unpack it: `tar -xf {in}`");
    let (format, remedy) = if is_rawlog(path, head) {
        RAWLOG
    } else if head.get(TAR_MAGIC_AT..).is_some_and(|rest| rest.starts_with(b"ustar")) {
        tar
    } else {
        let found = MAGICS.iter().find(|(magic, ..)| head.starts_with(magic));
        found.map(|&(_, format, remedy)| (format, remedy))?
    };
    let out = decompressed(path).unwrap_or_else(|| output(path));
    let remedy = remedy.replace("{in}", &path.display().to_string());
    let remedy = remedy.replace("{out}", &out.display().to_string());
    Some(Recording { format: format.to_owned(), remedy })
}

/// The path of a compressed file without the ending of the compression.
fn decompressed(path: &Path) -> Option<PathBuf> {
    const ENDINGS: [&str; 7] = ["zstd", "zst", "lz4", "gz", "bz2", "xz", "gzip"];
    let ending = path.extension().and_then(OsStr::to_str)?.to_ascii_lowercase();
    ENDINGS.contains(&ending.as_str()).then(|| path.with_extension(""))
}

/// A rawlog is a stream of serialized objects, usually compressed with gzip. An object starts with the
/// length of its class name plus 128, and the name (MRPT, `CArchive::WriteObject`).
fn is_rawlog(path: &Path, head: &[u8]) -> bool {
    let is_named = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("rawlog"));
    let starts_with_class = head.split_first().is_some_and(|(length, rest)| {
        let name = length.checked_sub(0x80).and_then(|n| rest.get(..usize::from(n)));
        let classes: [&[u8]; 4] = [b"CSensoryFrame", b"CObservation", b"CAction", b"mrpt::"];
        name.is_some_and(|name| classes.iter().any(|class| name.starts_with(class)))
    });
    starts_with_class || (is_named && head.starts_with(b"\x1F\x8B"))
}

fn importable(format: &str, path: &Path) -> Recording {
    let (from, to) = (path.display(), output(path));
    let remedy = format!("import it: `loopboost import {from} --out {}`", to.display());
    Recording { format: format.to_owned(), remedy }
}

/// The MCAP file for a recording: another file, even if the recording has the ending of an MCAP file.
fn output(path: &Path) -> PathBuf {
    let mcap = path.with_extension("mcap");
    if mcap == path { path.with_extension("converted.mcap") } else { mcap }
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
