use std::io;
use std::path::{Path, PathBuf};

use crate::format::Format;

/// Why a recording could not be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file or folder cannot be read.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// The operation that failed.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        #[source]
        source: io::Error,
    },
    /// No input was given.
    #[error(
        "no input; expected a network capture, a ROS bag, an NCLT folder or file, or a CARMEN log"
    )]
    NoInput,
    /// The format of a file or folder is not known.
    #[error("cannot import {}: found {found}, expected {expected}", path.display())]
    UnknownFormat {
        /// The file or folder.
        path: PathBuf,
        /// The content that was found.
        found: String,
        /// The formats that can be imported.
        expected: String,
    },
    /// The inputs have different formats.
    #[error(
        "{} is {first_format}, but {} is {second_format}; import them separately",
        first.display(),
        second.display()
    )]
    Mixed {
        /// The first input.
        first: PathBuf,
        /// The format of the first input.
        first_format: Format,
        /// An input of another format.
        second: PathBuf,
        /// The format of that input.
        second_format: Format,
    },
    /// The content of a file does not match its name or its first bytes.
    #[error("{}, {place}: found {found}, expected {expected}", path.display())]
    UnexpectedContent {
        /// The file.
        path: PathBuf,
        /// The line or the byte.
        place: String,
        /// The content that was found.
        found: String,
        /// The content that was expected.
        expected: String,
    },
    /// A capture contains data of several sensors, and none of them was selected.
    #[error(
        "{} contains data of several sensors ({addresses}); select one with `--source-ip`",
        path.display()
    )]
    SeveralSensors {
        /// The capture.
        path: PathBuf,
        /// The addresses of the sensors.
        addresses: String,
    },
    /// A selected topic is not in the bags.
    #[error("no topic {missing}; the topics are {found}")]
    NoTopic {
        /// The selected topics that do not exist.
        missing: String,
        /// The topics of the bags.
        found: String,
    },
    /// Topics can be selected from bags only.
    #[error("{format} has no topics to select; leave out `--topic`")]
    TopicsOfOtherFormat {
        /// The format of the inputs.
        format: Format,
    },
    /// Nothing in the recording could be used.
    #[error("{inputs}: nothing to import: found {found}, expected {expected}")]
    Empty {
        /// The names of the files.
        inputs: String,
        /// What the files contain.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// The log cannot be written.
    #[error("cannot write the log")]
    Write(
        /// The cause.
        #[from]
        mcap::McapError,
    ),
}

impl ImportError {
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        Self::Io { action, path: path.to_owned(), source }
    }

    pub(crate) fn unexpected(
        path: &Path,
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::UnexpectedContent {
            path: path.to_owned(),
            place: place.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }
}
