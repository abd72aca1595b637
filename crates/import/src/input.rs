//! Buffered reading of files from start to end, with a count of the bytes read.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use crate::error::ImportError;

/// The longest line accepted \[bytes\]. A scan of 1081 readings takes about 8 kB.
const MAX_LINE_BYTES: u64 = 1 << 20;
const BUFFER_BYTES: usize = 1 << 18;

/// The number of bytes read so far from all files.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter(Rc<Cell<u64>>);

impl Meter {
    pub fn bytes(&self) -> u64 {
        self.0.get()
    }

    pub fn add(&self, n_bytes: u64) {
        self.0.set(self.0.get() + n_bytes);
    }
}

/// A file that counts the bytes read from it.
pub(crate) struct Metered {
    file: File,
    meter: Meter,
}

impl Metered {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        let file = File::open(path).map_err(|source| ImportError::io("read", path, source))?;
        Ok(Self { file, meter: meter.clone() })
    }
}

impl Read for Metered {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(buffer)?;
        self.meter.add(n as u64);
        Ok(n)
    }
}

impl Seek for Metered {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Opens a file for buffered reading.
pub(crate) fn bytes(path: &Path, meter: &Meter) -> Result<BufReader<Metered>, ImportError> {
    Ok(BufReader::with_capacity(BUFFER_BYTES, Metered::open(path, meter)?))
}

/// Reads until `buffer` is full or the input ends. Returns the number of bytes read.
pub(crate) fn read_full(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}

/// The lines of a text file.
pub(crate) struct Lines {
    path: PathBuf,
    reader: BufReader<Metered>,
    number: u64,
    line: Vec<u8>,
}

/// One line of a text file.
pub(crate) struct Line {
    /// Counted from 1.
    pub number: u64,
    /// The text without the line break. Bytes that are not UTF-8 are replaced.
    pub text: String,
    /// Whether the line ends with a line break. A line without one may be truncated.
    pub is_complete: bool,
}

impl Lines {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        let reader = bytes(path, meter)?;
        Ok(Self { path: path.to_owned(), reader, number: 0, line: Vec::new() })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn next(&mut self) -> Result<Option<Line>, ImportError> {
        self.line.clear();
        let n = (&mut self.reader)
            .take(MAX_LINE_BYTES)
            .read_until(b'\n', &mut self.line)
            .map_err(|source| ImportError::io("read", &self.path, source))?;
        if n == 0 {
            return Ok(None);
        }
        self.number += 1;
        let is_complete = self.line.ends_with(b"\n");
        if !is_complete && MAX_LINE_BYTES <= n as u64 {
            return Err(ImportError::unexpected(
                &self.path,
                format!("line {}", self.number),
                "more than 1 MB without a line break",
                "lines of text",
            ));
        }
        let text = String::from_utf8_lossy(&self.line).trim_end_matches(['\n', '\r']).to_owned();
        Ok(Some(Line { number: self.number, text, is_complete }))
    }
}

/// The first characters of a text, escaped and quoted for an error message.
pub(crate) fn excerpt(text: &str) -> String {
    const MAX_CHARS: usize = 40;
    let start: String = text.chars().take(MAX_CHARS).flat_map(char::escape_debug).collect();
    if MAX_CHARS < text.chars().count() { format!("`{start}...`") } else { format!("`{start}`") }
}

/// The name of a file without its folder, for messages and metadata.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
