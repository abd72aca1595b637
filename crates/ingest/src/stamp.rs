//! Which time of a message is used: the stamp in its header, or the time at which it was recorded.

use serde::{Deserialize, Serialize};

/// The time of a message that is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Stamp {
    /// The stamp in the header, which the driver of the sensor sets.
    #[default]
    Header,
    /// The log time, at which the recorder received the message. It is later than the measurement by
    /// the delay of the driver and of the transport. For messages without a valid stamp.
    Log,
}

impl Stamp {
    /// Selects the time of a message \[ns since the epoch\], from the stamp in its header and its log
    /// time.
    pub(crate) fn select(self, header_ns: i64, log_ns: u64) -> i64 {
        match self {
            Self::Header => header_ns,
            Self::Log => i64::try_from(log_ns).unwrap_or(i64::MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_option_selects_the_header_or_the_log() {
        assert_eq!(Stamp::default().select(3, 5), 3);
        assert_eq!(Stamp::Log.select(3, 5), 5);
        assert_eq!(Stamp::Log.select(3, u64::MAX), i64::MAX);
    }
}
