//! The bytes of a log, read by position.
//!
//! Files are not mapped into memory. If another program truncates a mapped file, the operating system
//! kills the process that reads it. A read by position fails instead, and the log is named.

use std::fs::{File, Metadata};
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// The bytes of a log: a file, or bytes in memory.
#[derive(Debug)]
pub(crate) struct LogBytes {
    source: Source,
    n_bytes: usize,
    /// The first read that failed.
    failed: Mutex<Option<io::Error>>,
}

#[derive(Debug)]
enum Source {
    File { file: File, state: FileState },
    Memory(Vec<u8>),
}

/// What changes if a file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileState {
    n_bytes: u64,
    /// `None` if the file system does not record it.
    modified: Option<SystemTime>,
}

impl FileState {
    /// The state of the file at a path.
    pub fn read(path: &Path) -> io::Result<Self> {
        Ok(Self::of(&std::fs::metadata(path)?))
    }

    fn of(metadata: &Metadata) -> Self {
        Self { n_bytes: metadata.len(), modified: metadata.modified().ok() }
    }

    /// What differs from a later state.
    pub fn change(&self, now: &Self) -> Option<String> {
        let (before, after) = (self.n_bytes, now.n_bytes);
        match before == after {
            false => Some(format!("its size changed from {before} to {after} bytes")),
            true if self != now => Some("another program wrote to it".to_owned()),
            true => None,
        }
    }
}

impl LogBytes {
    /// Opens a file. It has the size that it has now, even if it grows.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let state = FileState::of(&file.metadata()?);
        let n_bytes = usize::try_from(state.n_bytes)
            .map_err(|_| io::Error::other("the file is larger than the address space"))?;
        Ok(Self { source: Source::File { file, state }, n_bytes, failed: Mutex::default() })
    }

    pub(crate) fn in_memory(bytes: Vec<u8>) -> Self {
        let n_bytes = bytes.len();
        Self { source: Source::Memory(bytes), n_bytes, failed: Mutex::default() }
    }

    /// The number of bytes when the log was opened.
    pub(crate) fn len(&self) -> usize {
        self.n_bytes
    }

    /// The bytes of a range. If they cannot be read, they are empty, and [`Self::check_unchanged`]
    /// returns the error. `buffer` holds the bytes of a file.
    pub(crate) fn get<'a>(&'a self, range: Range<usize>, buffer: &'a mut Vec<u8>) -> &'a [u8] {
        let range = range.start..range.end.min(self.n_bytes);
        match &self.source {
            Source::Memory(bytes) => bytes.get(range).unwrap_or_default(),
            Source::File { file, .. } => {
                let n = range.len();
                if buffer.len() < n {
                    buffer.resize(n, 0);
                }
                match read_exact_at(file, &mut buffer[..n], range.start as u64) {
                    Ok(()) => &buffer[..n],
                    Err(error) => {
                        let mut failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
                        failed.get_or_insert(error);
                        &[]
                    }
                }
            }
        }
    }

    /// Checks that all reads succeeded, and that no program wrote to the file since it was opened.
    pub(crate) fn check_unchanged(&self) -> Result<(), Changed> {
        let Source::File { file, state } = &self.source else { return Ok(()) };
        let now = FileState::of(&file.metadata().map_err(Changed::Unreadable)?);
        if let Some(change) = state.change(&now) {
            return Err(Changed::Written(change));
        }
        let mut failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        match failed.take() {
            Some(error) => Err(Changed::Unreadable(error)),
            None => Ok(()),
        }
    }
}

/// Why the bytes that were read cannot be trusted.
#[derive(Debug)]
pub(crate) enum Changed {
    /// Another program wrote to the file.
    Written(String),
    /// A read failed.
    Unreadable(io::Error),
}

/// Fills a buffer from a position in a file.
#[cfg(unix)]
fn read_exact_at(file: &File, buffer: &mut [u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, buffer, at)
}

/// Fills a buffer from a position in a file.
#[cfg(windows)]
fn read_exact_at(file: &File, mut buffer: &mut [u8], mut at: u64) -> io::Result<()> {
    while !buffer.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, buffer, at) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(n) => {
                buffer = &mut buffer[n..];
                at += n as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Reads the structure of a log: small parts, usually one after the other.
pub(crate) struct View<'a> {
    bytes: &'a LogBytes,
    buffer: Vec<u8>,
    /// The part of the file in `buffer`.
    loaded: Range<usize>,
    n_ahead: usize,
}

impl<'a> View<'a> {
    /// The number of bytes that are read after a jump, and the largest number that is read ahead.
    const AHEAD_BYTES: Range<usize> = 4 << 10..256 << 10;

    pub(crate) fn new(bytes: &'a LogBytes) -> Self {
        Self { bytes, buffer: Vec::new(), loaded: 0..0, n_ahead: Self::AHEAD_BYTES.start }
    }

    /// The number of bytes of the log.
    pub(crate) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// The bytes of a range, or `None` if the log is shorter or they cannot be read.
    pub(crate) fn get(&mut self, range: Range<usize>) -> Option<&[u8]> {
        if range.end < range.start || self.bytes.len() < range.end {
            return None;
        }
        if let Source::Memory(bytes) = &self.bytes.source {
            return bytes.get(range);
        }
        if range.start < self.loaded.start || self.loaded.end < range.end {
            // Read more at once if the parts follow each other.
            let follows = (self.loaded.start..=self.loaded.end).contains(&range.start);
            let Range { start: least, end: most } = Self::AHEAD_BYTES;
            self.n_ahead = if follows { (self.n_ahead * 2).min(most) } else { least };
            let end = range.end.max(range.start + self.n_ahead).min(self.bytes.len());
            self.loaded = range.start..end;
            if self.bytes.get(self.loaded.clone(), &mut self.buffer).len() < self.loaded.len() {
                self.loaded = 0..0;
                return None;
            }
        }
        let start = range.start - self.loaded.start;
        self.buffer.get(start..start + range.len())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn numbers() -> Vec<u8> {
        (0..1_000_000u32).map(|k| (k % 251) as u8).collect()
    }

    #[test]
    fn a_file_and_memory_give_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        std::fs::write(&path, numbers()).unwrap();
        let (file, memory) = (LogBytes::open(&path).unwrap(), LogBytes::in_memory(numbers()));
        let (mut a, mut b) = (View::new(&file), View::new(&memory));
        let ranges = [
            0..9,
            9..20,
            20..70_000,
            70_000..70_000,
            999_990..1_000_000,
            5..8,
            0..1_000_000,
            999_999..1_000_001,
            2_000_000..2_000_001,
            1_000_000..1_000_000,
        ];
        for range in ranges {
            let expected = numbers().get(range.clone()).map(<[u8]>::to_vec);
            assert_eq!(a.get(range.clone()).map(<[u8]>::to_vec), expected, "{range:?}");
            assert_eq!(b.get(range.clone()).map(<[u8]>::to_vec), expected, "{range:?}");
        }
        assert!(file.check_unchanged().is_ok() && memory.check_unchanged().is_ok());
    }

    #[test]
    fn a_file_that_is_truncated_or_written_is_no_longer_valid() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        std::fs::write(&path, numbers()).unwrap();
        let mut buffer = Vec::new();

        let bytes = LogBytes::open(&path).unwrap();
        let file = File::options().write(true).open(&path).unwrap();
        file.set_len(1000).unwrap();
        assert_eq!(bytes.get(0..1000, &mut buffer).len(), 1000);
        assert!(bytes.get(900..1001, &mut buffer).is_empty());
        let Err(Changed::Written(change)) = bytes.check_unchanged() else { panic!() };
        assert_eq!(change, "its size changed from 1000000 to 1000 bytes");

        let bytes = LogBytes::open(&path).unwrap();
        let mut file = File::options().write(true).open(&path).unwrap();
        file.write_all(b"other").unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        let Err(Changed::Written(change)) = bytes.check_unchanged() else { panic!() };
        assert_eq!(change, "another program wrote to it");
    }
}
