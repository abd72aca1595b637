//! Errors of readers.

use crate::source::{Encoding, MessageType};

/// Why the bytes of a message or packet cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// The reader does not read this message type.
    #[error("cannot read {expected} from {found} messages")]
    WrongType {
        /// The data that the reader reads, for example `a laser scan`.
        expected: &'static str,
        /// The message type.
        found: MessageType,
    },
    /// The message type does not exist in this encoding.
    #[error("cannot read {message} messages in encoding {found}, expected {}", list(expected))]
    WrongEncoding {
        /// Name of the message type.
        message: &'static str,
        /// The encodings of this message type.
        expected: &'static [Encoding],
        /// The requested encoding.
        found: Encoding,
    },
    /// The bytes end before the message ends.
    #[error("{message} message has {found} bytes, expected {expected} or more")]
    TooShort {
        /// Name of the message type.
        message: &'static str,
        /// Number of bytes needed so far.
        expected: usize,
        /// Number of bytes.
        found: usize,
    },
    /// The CDR encapsulation header states an encoding other than plain CDR.
    #[error(
        "CDR encapsulation is {found:#06x}, expected 0x0000 (big endian) or 0x0001 (little endian)"
    )]
    Encapsulation {
        /// The first two bytes of the header.
        found: u16,
    },
    /// The recorder compressed the message with Zstandard.
    #[error("message is compressed with Zstandard, expected plain CDR")]
    Compressed,
    /// The bytes do not decode as the message type.
    #[error("bytes do not decode as {message}: {detail}")]
    Malformed {
        /// Name of the message type.
        message: &'static str,
        /// The cause.
        detail: String,
    },
    /// The sizes and fields of a point cloud contradict each other.
    #[error("invalid point cloud layout: {detail}")]
    CloudLayout {
        /// The contradiction.
        detail: String,
    },
    /// A point cloud lacks a required field.
    #[error("point cloud has no field `{field}`, found {}", found.join(", "))]
    NoField {
        /// The required field.
        field: String,
        /// The fields of the cloud.
        found: Vec<String>,
    },
    /// An angle of a scan is NaN or infinite.
    #[error("{message} has an angle that is not finite")]
    NotFinite {
        /// Name of the message type.
        message: &'static str,
    },
    /// A packet has another length than an HDL-32E data packet.
    #[error("packet has {found} bytes, expected 1206 (HDL-32E data packet)")]
    PacketLength {
        /// Number of bytes.
        found: usize,
    },
    /// A block does not start with the flag of an HDL-32E block.
    #[error("block {block} starts with {found:#06x}, expected 0xeeff (HDL-32E block)")]
    BlockFlag {
        /// Block, 0 to 11.
        block: usize,
        /// The flag.
        found: u16,
    },
    /// An azimuth is out of range.
    #[error("block {block} has azimuth {found}, expected 0 to 35999 hundredths of a degree")]
    Azimuth {
        /// Block, 0 to 11.
        block: usize,
        /// The azimuth \[0.01 deg\].
        found: u16,
    },
}

impl MessageError {
    /// A stable name of the error, without values that differ from message to message. It is used to
    /// count messages with the same error.
    pub fn code(&self) -> &'static str {
        match self {
            Self::WrongType { .. } => "wrong_type",
            Self::WrongEncoding { .. } => "wrong_encoding",
            Self::TooShort { .. } => "too_short",
            Self::Encapsulation { .. } => "not_plain_cdr",
            Self::Compressed => "compressed",
            Self::Malformed { .. } => "malformed",
            Self::CloudLayout { .. } => "contradictory_layout",
            Self::NoField { .. } => "missing_field",
            Self::NotFinite { .. } => "angle_not_finite",
            Self::PacketLength { .. } | Self::BlockFlag { .. } | Self::Azimuth { .. } => {
                "packet_layout"
            }
        }
    }
}

/// The `Result` of this crate.
pub type Result<T> = std::result::Result<T, MessageError>;

fn list(encodings: &[Encoding]) -> String {
    encodings.iter().map(|encoding| encoding.name()).collect::<Vec<_>>().join(" or ")
}
