//! What can be wrong with a message.

use crate::hdl32e;
use crate::source::{Encoding, MessageType};

/// What can be wrong with the bytes of one message or packet.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// A reader was given messages of a type that does not hold what it reads.
    #[error("{found} holds no {expected}")]
    WrongType {
        /// What was to be read, as `laser scan`.
        expected: &'static str,
        /// The type of the messages.
        found: MessageType,
    },
    /// The message type does not come in this encoding.
    #[error("{message} is not read from {found}, expected {}", list(expected))]
    WrongEncoding {
        /// The message's type name.
        message: &'static str,
        /// The encodings that it comes in.
        expected: &'static [Encoding],
        /// The encoding asked for.
        found: Encoding,
    },
    /// The bytes end before the message does.
    #[error("{message} ends at byte {found} where at least {expected} are needed")]
    TooShort {
        /// The message's type name.
        message: &'static str,
        /// Bytes needed so far.
        expected: usize,
        /// Bytes there are.
        found: usize,
    },
    /// The four bytes before a CDR body name an encoding that is not plain CDR.
    #[error(
        "CDR encapsulation {found:#06x} is not supported, expected 0x0000 (big endian) or 0x0001 (little endian)"
    )]
    Encapsulation {
        /// The two bytes found.
        found: u16,
    },
    /// The body does not decode as the message its schema names.
    #[error("bytes do not decode as {message}: {detail}")]
    Malformed {
        /// The message's type name.
        message: &'static str,
        /// What the decoder said.
        detail: String,
    },
    /// A point cloud whose sizes and fields contradict each other.
    #[error("point cloud layout: {detail}")]
    CloudLayout {
        /// The contradiction.
        detail: String,
    },
    /// A point cloud without a field that is needed.
    #[error("point cloud has no field `{field}`; there are {}", found.join(", "))]
    NoField {
        /// The field.
        field: String,
        /// The fields there are.
        found: Vec<String>,
    },
    /// An angle of a scan is NaN or infinite.
    #[error("{message} has an angle that is not finite")]
    NotFinite {
        /// The message's type name.
        message: &'static str,
    },
    /// A data packet of another length.
    #[error("packet has {found} bytes, an HDL-32E data packet has {}", hdl32e::PACKET_BYTES)]
    PacketLength {
        /// Bytes found.
        found: usize,
    },
    /// A block that does not start with the flag of the upper (and only) laser bank.
    #[error("block {block} starts with {found:#06x}, an HDL-32E block with 0xeeff")]
    BlockFlag {
        /// Block, 0 to 11.
        block: usize,
        /// The flag found.
        found: u16,
    },
    /// An azimuth that is no angle.
    #[error("block {block} has azimuth {found}, expected 0 to 35999 hundredths of a degree")]
    Azimuth {
        /// Block, 0 to 11.
        block: usize,
        /// The azimuth found \[0.01 deg\].
        found: u16,
    },
}

impl MessageError {
    /// What is wrong, in a few words that are the same for all messages wrong in this way.
    pub fn kind(&self) -> String {
        match self {
            Self::WrongType { .. } | Self::WrongEncoding { .. } => self.to_string(),
            Self::TooShort { .. } => "too short".to_owned(),
            Self::Encapsulation { found } => {
                format!("encapsulation {found:#06x}, expected plain CDR, 0x0000 or 0x0001")
            }
            Self::Malformed { .. } => "malformed".to_owned(),
            Self::CloudLayout { .. } => "a point cloud of contradictory layout".to_owned(),
            Self::NoField { field, found } => {
                format!("no field `{field}`; there are {}", found.join(", "))
            }
            Self::NotFinite { .. } => "an angle that is not finite".to_owned(),
            Self::PacketLength { .. } | Self::BlockFlag { .. } | Self::Azimuth { .. } => {
                "not the layout of an HDL-32E data packet".to_owned()
            }
        }
    }
}

/// `Result` of this crate.
pub type Result<T> = std::result::Result<T, MessageError>;

fn list(encodings: &[Encoding]) -> String {
    encodings.iter().map(|encoding| encoding.name()).collect::<Vec<_>>().join(" or ")
}
