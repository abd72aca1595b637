//! Files read once from top to bottom, with what has been read counted.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use crate::ImportError;

/// The longest line that is read: a scan of 1081 readings takes about 8 kB.
const MAX_LINE_BYTES: u64 = 1 << 20;
const BUFFER_BYTES: usize = 1 << 18;

/// Bytes read so far, of all files together.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter(Rc<Cell<u64>>);

impl Meter {
    pub fn bytes(&self) -> u64 {
        self.0.get()
    }
}

/// A file that counts what is read of it.
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
        self.meter.0.set(self.meter.0.get() + n as u64);
        Ok(n)
    }
}

impl Seek for Metered {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// A file's bytes, buffered.
pub(crate) fn bytes(path: &Path, meter: &Meter) -> Result<BufReader<Metered>, ImportError> {
    Ok(BufReader::with_capacity(BUFFER_BYTES, Metered::open(path, meter)?))
}

/// Fills `buffer` as far as the file goes; how many bytes there were.
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

/// One line.
pub(crate) struct Line {
    /// Counted from 1.
    pub number: u64,
    /// Without the line's end; bytes that are no UTF-8 replaced.
    pub text: String,
    /// Whether the line's end is there: without one the file may have been cut within the line.
    pub whole: bool,
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
        let whole = self.line.ends_with(b"\n");
        if !whole && MAX_LINE_BYTES <= n as u64 {
            return Err(ImportError::foreign(
                &self.path,
                format!("line {}", self.number),
                "more than 1 MB without a line's end",
                "lines of text",
            ));
        }
        let text = String::from_utf8_lossy(&self.line).trim_end_matches(['\n', '\r']).to_owned();
        Ok(Some(Line { number: self.number, text, whole }))
    }
}

/// The start of a text, fit for an error message.
pub(crate) fn excerpt(text: &str) -> String {
    const CHARS: usize = 40;
    let start: String = text.chars().take(CHARS).flat_map(char::escape_debug).collect();
    if CHARS < text.chars().count() { format!("`{start}...`") } else { format!("`{start}`") }
}
