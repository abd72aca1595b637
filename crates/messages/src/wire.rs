//! A reader of the two ROS encodings that does not copy, for large messages, and a writer.
//!
//! A CDR message (OMG formal/02-06-51, section 15.3) starts with an encapsulation header of four
//! bytes (DDSI-RTPS, "Serialized payload representation"), which states the byte order. A value of n
//! bytes is aligned to a multiple of n from the end of the header. A string ends with a zero, which is
//! included in its count. A ROS 1 message is packed, little endian, and its strings have no
//! terminator. In both encodings a u32 count precedes a string or a sequence.

use crate::source::{Encoding, MessageType};
use crate::{MessageError, Result};

/// Length of a CDR encapsulation header \[bytes\].
const ENCAPSULATION: usize = 4;
/// Largest padding that some DDS vendors append to a CDR message \[bytes\].
pub(crate) const MAX_CDR_PADDING: usize = 8;

/// Whether a CDR message is big endian, from its encapsulation header.
pub(crate) fn cdr_is_big_endian(message: &'static str, bytes: &[u8]) -> Result<bool> {
    match bytes {
        [0, 0, _, _, ..] => Ok(true),
        [0, 1, _, _, ..] => Ok(false),
        // The magic number of a Zstandard frame (RFC 8878, section 3.1.1). rosbag2 writes such messages
        // with the compression mode `message`. No CDR message starts like this.
        [0x28, 0xB5, 0x2F, 0xFD, ..] => Err(MessageError::Compressed),
        [a, b, _, _, ..] => {
            Err(MessageError::Encapsulation { found: u16::from_be_bytes([*a, *b]) })
        }
        _ => Err(MessageError::TooShort { message, expected: ENCAPSULATION, found: bytes.len() }),
    }
}

/// The value of a message, and the number of bytes that follow it.
pub(crate) struct Decoded<T> {
    pub(crate) value: T,
    pub(crate) n_left: usize,
}

impl<T> Decoded<T> {
    pub(crate) fn map<U>(self, f: impl FnOnce(T) -> U) -> Decoded<U> {
        Decoded { value: f(self.value), n_left: self.n_left }
    }
}

/// Reads a message from front to back. Every read checks that there are enough bytes.
pub(crate) struct Cursor<'a> {
    message: &'static str,
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
    big_endian: bool,
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(
        message_type: MessageType,
        encoding: Encoding,
        bytes: &'a [u8],
    ) -> Result<Self> {
        let message = message_type.name();
        let (at, big_endian) = match encoding {
            Encoding::Cdr => (ENCAPSULATION, cdr_is_big_endian(message, bytes)?),
            Encoding::Ros1 => (0, false),
            Encoding::Protobuf | Encoding::Json => {
                let expected = message_type.encodings();
                return Err(MessageError::WrongEncoding { message, expected, found: encoding });
            }
        };
        Ok(Self { message, bytes, at, encoding, big_endian })
    }

    pub(crate) fn is_big_endian(&self) -> bool {
        self.big_endian
    }

    /// Number of bytes not yet read.
    fn n_left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The value with the number of bytes that are left.
    pub(crate) fn decoded<T>(&self, value: T) -> Decoded<T> {
        Decoded { value, n_left: self.n_left() }
    }

    pub(crate) fn take(&mut self, n: usize) -> Result<&'a [u8]> {
        let end = self.at.saturating_add(n);
        let taken = self.bytes.get(self.at..end).ok_or(MessageError::TooShort {
            message: self.message,
            expected: end,
            found: self.bytes.len(),
        })?;
        self.at = end;
        Ok(taken)
    }

    pub(crate) fn u8(&mut self) -> Result<u8> {
        Ok(self.take(1)?[0])
    }

    pub(crate) fn u32(&mut self) -> Result<u32> {
        if self.encoding == Encoding::Cdr {
            let body = self.at - ENCAPSULATION;
            self.take(body.next_multiple_of(4) - body)?;
        }
        let raw = self.take(4)?;
        Ok(u32_of([raw[0], raw[1], raw[2], raw[3]], self.big_endian))
    }

    /// A size or an index.
    pub(crate) fn size(&mut self) -> Result<usize> {
        Ok(self.u32()? as usize)
    }

    /// Reads the count of a sequence. Checks that there are enough bytes left for this number of
    /// elements of at least `n_bytes` each.
    pub(crate) fn count(&mut self, n_bytes: usize) -> Result<usize> {
        let count = self.size()?;
        let needed = count.saturating_mul(n_bytes);
        if self.n_left() < needed {
            return Err(MessageError::TooShort {
                message: self.message,
                expected: self.at.saturating_add(needed),
                found: self.bytes.len(),
            });
        }
        Ok(count)
    }

    /// A `uint8[]`.
    pub(crate) fn byte_sequence(&mut self) -> Result<&'a [u8]> {
        let n = self.size()?;
        self.take(n)
    }

    pub(crate) fn string(&mut self) -> Result<&'a str> {
        let bytes = self.byte_sequence()?;
        let text = match (self.encoding, bytes) {
            (Encoding::Cdr, [text @ .., 0]) => text,
            _ => bytes,
        };
        std::str::from_utf8(text)
            .map_err(|e| MessageError::Malformed { message: self.message, detail: e.to_string() })
    }

    pub(crate) fn time_ns(&mut self) -> Result<i64> {
        Ok(time_ns(self.u32()?, self.u32()?))
    }

    /// Reads a `std_msgs/Header` and returns its stamp.
    pub(crate) fn header_stamp_ns(&mut self) -> Result<i64> {
        if self.encoding == Encoding::Ros1 {
            self.u32()?; // seq
        }
        let stamp_ns = self.time_ns()?;
        self.byte_sequence()?; // frame_id
        Ok(stamp_ns)
    }

    /// Reads a `std_msgs/Header` and returns its frame.
    pub(crate) fn header_frame_id(&mut self) -> Result<&'a str> {
        if self.encoding == Encoding::Ros1 {
            self.u32()?; // seq
        }
        self.time_ns()?;
        self.string()
    }
}

/// A 32-bit integer from its bytes.
#[inline]
pub(crate) fn u32_of(raw: [u8; 4], big_endian: bool) -> u32 {
    if big_endian { u32::from_be_bytes(raw) } else { u32::from_le_bytes(raw) }
}

/// A stamp \[ns\]. Seconds are signed in ROS 2 and unsigned in ROS 1. Both are equal until 2038, and
/// are read as signed here.
pub(crate) fn time_ns(sec: u32, nanosec: u32) -> i64 {
    i64::from(sec as i32) * 1_000_000_000 + i64::from(nanosec)
}

/// The seconds (rounded down) and the nanoseconds of a stamp.
pub(crate) fn sec_and_nanosec(stamp_ns: i64) -> (i64, u32) {
    (stamp_ns.div_euclid(1_000_000_000), stamp_ns.rem_euclid(1_000_000_000) as u32)
}

/// Writes a message from front to back, little endian.
pub(crate) struct Writer {
    bytes: Vec<u8>,
    encoding: Encoding,
}

impl Writer {
    /// # Panics
    /// Panics if the encoding is not CDR or ROS 1.
    pub(crate) fn new(encoding: Encoding, capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(capacity);
        match encoding {
            Encoding::Cdr => bytes.extend_from_slice(&[0, 1, 0, 0]),
            Encoding::Ros1 => {}
            Encoding::Protobuf | Encoding::Json => not_of_ros(encoding),
        }
        Self { bytes, encoding }
    }

    pub(crate) fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub(crate) fn u32(&mut self, value: u32) {
        if self.encoding == Encoding::Cdr {
            // The length of the encapsulation header is a multiple of four too.
            self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        }
        self.raw(&value.to_le_bytes());
    }

    pub(crate) fn size(&mut self, value: usize) {
        self.u32(u32::try_from(value).expect("counts in ROS messages have 32 bits"));
    }

    pub(crate) fn byte_sequence(&mut self, bytes: &[u8]) {
        self.size(bytes.len());
        self.raw(bytes);
    }

    pub(crate) fn string(&mut self, text: &str) {
        let terminator: &[u8] = if self.encoding == Encoding::Cdr { &[0] } else { &[] };
        self.size(text.len() + terminator.len());
        self.raw(text.as_bytes());
        self.raw(terminator);
    }

    pub(crate) fn time(&mut self, stamp_ns: i64) {
        let (sec, nanosec) = sec_and_nanosec(stamp_ns);
        self.u32(sec as u32);
        self.u32(nanosec);
    }

    pub(crate) fn header(&mut self, stamp_ns: i64, frame_id: &str) {
        if self.encoding == Encoding::Ros1 {
            self.u32(0); // seq
        }
        self.time(stamp_ns);
        self.string(frame_id);
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// Panics because ROS messages do not exist in this encoding.
pub(crate) fn not_of_ros(encoding: Encoding) -> ! {
    panic!("cannot write a ROS message in encoding {encoding}, expected cdr or ros1")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes, written by hand: encapsulation header, one byte, padding to 4, a 32-bit integer in the
    /// byte order of the header, and "ab" with and without its zero.
    #[test]
    fn integers_are_aligned_in_cdr_only() {
        let read = |encoding, bytes: &[u8]| {
            let mut cursor = Cursor::new(MessageType::PointCloud2, encoding, bytes).unwrap();
            let read = (cursor.u8().unwrap(), cursor.u32().unwrap(), cursor.string().unwrap());
            assert_eq!(cursor.n_left(), 0);
            (read.0, read.1, read.2.to_owned())
        };
        let expected = (7, 0x0102, "ab".to_owned());
        let little = [0, 1, 0, 0, 7, 0, 0, 0, 2, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        let big = [0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 1, 2, 0, 0, 0, 3, b'a', b'b', 0];
        let packed = [7, 2, 1, 0, 0, 2, 0, 0, 0, b'a', b'b'];
        assert_eq!(read(Encoding::Cdr, &little), expected);
        assert_eq!(read(Encoding::Cdr, &big), expected);
        assert_eq!(read(Encoding::Ros1, &packed), expected);
        for (encoding, bytes) in [(Encoding::Cdr, &little[..]), (Encoding::Ros1, &packed[..])] {
            let mut writer = Writer::new(encoding, 0);
            writer.u8(7);
            writer.u32(0x0102);
            writer.string("ab");
            assert_eq!(writer.finish(), bytes);
        }
    }

    #[test]
    fn a_count_is_checked_against_the_number_of_bytes_left() {
        let bytes = [3, 0, 0, 0, 1, 2, 3, 4, 5, 6];
        let count = |n_bytes| {
            Cursor::new(MessageType::PointCloud2, Encoding::Ros1, &bytes).unwrap().count(n_bytes)
        };
        assert_eq!(count(2), Ok(3));
        let too_short = MessageError::TooShort { message: "PointCloud2", expected: 13, found: 10 };
        assert_eq!(count(3), Err(too_short));
        assert!(count(usize::MAX).is_err());
    }

    #[test]
    fn a_stamp_before_the_epoch_keeps_its_value() {
        for stamp_ns in [-1, 0, 1, -1_000_000_000, 1_330_000_000_049_999_872] {
            let (sec, nanosec) = sec_and_nanosec(stamp_ns);
            assert_eq!(time_ns(sec as u32, nanosec), stamp_ns);
        }
    }

    #[test]
    fn json_is_not_an_encoding_of_ros_messages() {
        let error = Cursor::new(MessageType::PointCloud2, Encoding::Json, &[]).err().unwrap();
        assert_eq!(
            error.to_string(),
            "cannot read PointCloud2 messages in encoding json, expected cdr or ros1"
        );
    }
}
