use std::io;
use std::path::{Path, PathBuf};

use crate::Format;

/// Why a recording could not be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file cannot be read.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// No input was given.
    #[error("nothing to import: name a capture, an NCLT folder or file, or a CARMEN log")]
    NoInput,
    /// A file or folder in no format that is known.
    #[error("{} is in no format that can be imported: found {found}, expected {expected}", path.display())]
    Unrecognised {
        /// The file or folder.
        path: PathBuf,
        /// What it starts with or holds.
        found: String,
        /// What would do.
        expected: String,
    },
    /// Inputs of two formats.
    #[error("{} is {first_format}, {} is {second_format}: import them one by one", first.display(), second.display())]
    Mixed {
        /// The first input.
        first: PathBuf,
        /// Its format.
        first_format: Format,
        /// An input of another format.
        second: PathBuf,
        /// Its format.
        second_format: Format,
    },
    /// A file is not what its name or its start promises.
    #[error("{}, {place}: found {found}, expected {expected}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// The line or the byte.
        place: String,
        /// What stands there.
        found: String,
        /// What should.
        expected: String,
    },
    /// A capture of several sensors, of which none was chosen.
    #[error(
        "{} holds the data of several sensors, {addresses}: choose one by its address with `--source-ip`",
        path.display()
    )]
    SeveralSensors {
        /// The capture.
        path: PathBuf,
        /// Their addresses and numbers of packets.
        addresses: String,
    },
    /// Nothing in the recording could be used.
    #[error("{inputs} holds nothing to import: {found}; expected {expected}")]
    Empty {
        /// The names of the files.
        inputs: String,
        /// What they hold.
        found: String,
        /// What would do.
        expected: &'static str,
    },
    /// The log cannot be written.
    #[error("cannot write the log")]
    Write(#[from] mcap::McapError),
}

impl ImportError {
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        Self::Io { action, path: path.to_owned(), source }
    }

    pub(crate) fn foreign(
        path: &Path,
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Foreign {
            path: path.to_owned(),
            place: place.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }
}
