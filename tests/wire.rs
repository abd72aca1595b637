//! Messages as bytes, written from the specifications and not by the program's own crates: ROS 1
//! (packed, little endian), CDR in both byte orders (OMG formal/02-06-51, section 15.3) and protocol
//! buffers. Foxglove's JSON is written with `serde_json`.

/// How messages are encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    Ros1,
    Cdr,
    CdrBigEndian,
    Protobuf,
    Json,
}

pub const ROS: [Encoding; 3] = [Encoding::Ros1, Encoding::Cdr, Encoding::CdrBigEndian];
pub const FOXGLOVE: [Encoding; 2] = [Encoding::Protobuf, Encoding::Json];

impl Encoding {
    /// The message encoding of an MCAP channel.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ros1 => "ros1",
            Self::Cdr | Self::CdrBigEndian => "cdr",
            Self::Protobuf => "protobuf",
            Self::Json => "json",
        }
    }

    /// The schema name in an MCAP log of a type such as `sensor_msgs/LaserScan`.
    pub fn schema_name(self, type_name: &str) -> String {
        match self {
            Self::Cdr | Self::CdrBigEndian => type_name.replace('/', "/msg/"),
            _ => type_name.to_owned(),
        }
    }

    /// The schema encoding of an MCAP log.
    pub fn schema_encoding(self) -> &'static str {
        match self {
            Self::Ros1 => "ros1msg",
            Self::Cdr | Self::CdrBigEndian => "ros2msg",
            Self::Protobuf => "protobuf",
            Self::Json => "jsonschema",
        }
    }
}

/// A ROS message under construction.
pub struct RosMessage {
    encoding: Encoding,
    bytes: Vec<u8>,
}

/// Bytes of the encapsulation header of CDR; alignment counts from its end.
const ENCAPSULATION: usize = 4;

impl RosMessage {
    pub fn new(encoding: Encoding) -> Self {
        let bytes = match encoding {
            Encoding::Ros1 => Vec::new(),
            Encoding::Cdr => vec![0, 1, 0, 0],
            Encoding::CdrBigEndian => vec![0, 0, 0, 0],
            Encoding::Protobuf | Encoding::Json => panic!("{encoding:?} is not an encoding of ROS"),
        };
        Self { encoding, bytes }
    }

    /// A message that starts with a `std_msgs/Header`.
    pub fn with_header(encoding: Encoding, stamp_ns: i64) -> Self {
        let message = Self::new(encoding);
        let message = if encoding == Encoding::Ros1 { message.u32(0) } else { message };
        message.time(stamp_ns).string("a frame")
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    fn number<const N: usize>(mut self, little_endian: [u8; N]) -> Self {
        if self.encoding != Encoding::Ros1 {
            let n_after_header = self.bytes.len() - ENCAPSULATION;
            self.bytes.resize(ENCAPSULATION + n_after_header.next_multiple_of(N), 0);
        }
        if self.encoding == Encoding::CdrBigEndian {
            self.bytes.extend(little_endian.iter().rev());
        } else {
            self.bytes.extend(little_endian);
        }
        self
    }

    pub fn u8(self, value: u8) -> Self {
        self.number([value])
    }

    pub fn u32(self, value: u32) -> Self {
        self.number(value.to_le_bytes())
    }

    pub fn f32(self, value: f32) -> Self {
        self.number(value.to_le_bytes())
    }

    pub fn f64(self, value: f64) -> Self {
        self.number(value.to_le_bytes())
    }

    pub fn f64s(self, values: &[f64]) -> Self {
        values.iter().fold(self, |message, &value| message.f64(value))
    }

    /// A sequence of numbers, after their count.
    pub fn f32_sequence(self, values: &[f32]) -> Self {
        values.iter().fold(self.u32(values.len() as u32), |message, &value| message.f32(value))
    }

    /// Bytes without a count: an array of fixed size.
    pub fn raw(mut self, bytes: &[u8]) -> Self {
        self.bytes.extend(bytes);
        self
    }

    /// A sequence of bytes, after their count.
    pub fn byte_sequence(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    /// Text. CDR counts and writes a closing zero.
    pub fn string(self, text: &str) -> Self {
        if self.encoding == Encoding::Ros1 {
            self.byte_sequence(text.as_bytes())
        } else {
            self.u32(text.len() as u32 + 1).raw(text.as_bytes()).raw(&[0])
        }
    }

    pub fn time(self, stamp_ns: i64) -> Self {
        self.u32((stamp_ns / 1_000_000_000) as u32).u32((stamp_ns % 1_000_000_000) as u32)
    }
}

/// A protocol buffer under construction (proto3: numbers that are zero are left out). Fields have
/// numbers below 16.
#[derive(Default)]
pub struct Protobuf {
    bytes: Vec<u8>,
}

impl Protobuf {
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    fn plain_varint(mut self, mut value: u64) -> Self {
        while 0x7f < value {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
        self
    }

    fn tag(self, field: u8, wire_type: u8) -> Self {
        self.plain_varint(u64::from(field << 3 | wire_type))
    }

    pub fn varint(self, field: u8, value: u64) -> Self {
        if value == 0 { self } else { self.tag(field, 0).plain_varint(value) }
    }

    pub fn double(self, field: u8, value: f64) -> Self {
        if value.to_bits() == 0 { self } else { self.tag(field, 1).raw(&value.to_le_bytes()) }
    }

    pub fn fixed32(self, field: u8, value: u32) -> Self {
        if value == 0 { self } else { self.tag(field, 5).raw(&value.to_le_bytes()) }
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.bytes.extend(bytes);
        self
    }

    /// Text, bytes, packed numbers or an embedded message.
    pub fn bytes(self, field: u8, bytes: &[u8]) -> Self {
        self.tag(field, 2).plain_varint(bytes.len() as u64).raw(bytes)
    }

    pub fn message(self, field: u8, message: &Self) -> Self {
        self.bytes(field, &message.bytes)
    }

    /// A Foxglove message: `timestamp` and `frame_id`.
    pub fn foxglove(stamp_ns: i64) -> Self {
        let (seconds, nanos) = (stamp_ns as u64 / 1_000_000_000, stamp_ns as u64 % 1_000_000_000);
        let timestamp = Self::default().varint(1, seconds).varint(2, nanos);
        Self::default().message(1, &timestamp).bytes(2, b"a frame")
    }

    /// `foxglove.Pose`
    pub fn pose(position: [f64; 3], orientation: [f64; 4]) -> Self {
        let numbers = |values: &[f64]| {
            let fields = values.iter().zip(1..);
            fields.fold(Self::default(), |message, (&value, field)| message.double(field, value))
        };
        Self::default().message(1, &numbers(&position)).message(2, &numbers(&orientation))
    }
}

/// A Foxglove message in JSON: `timestamp`, `frame_id` and more.
pub fn foxglove_json(stamp_ns: i64, more: serde_json::Value) -> Vec<u8> {
    let mut message = more;
    let (sec, nsec) = (stamp_ns / 1_000_000_000, stamp_ns % 1_000_000_000);
    message["timestamp"] = serde_json::json!({ "sec": sec, "nsec": nsec });
    message["frame_id"] = "a frame".into();
    message.to_string().into_bytes()
}

/// A pose in Foxglove's JSON.
pub fn json_pose(position: [f64; 3], orientation: [f64; 4]) -> serde_json::Value {
    let ([x, y, z], [qx, qy, qz, qw]) = (position, orientation);
    serde_json::json!({
        "position": { "x": x, "y": y, "z": z },
        "orientation": { "x": qx, "y": qy, "z": qz, "w": qw },
    })
}

/// Bytes in Foxglove's JSON (RFC 4648, section 4).
pub fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let bits = (0..3).fold(0, |bits, k| bits << 8 | u32::from(*group.get(k).unwrap_or(&0)));
        for k in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * k)) as usize & 63];
            text.push(if k <= group.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[test]
fn the_bytes_are_those_of_the_specifications() {
    let message = |encoding| RosMessage::new(encoding).string("ab").f64(1.0).u8(7).u32(8).finish();
    // 1.0 is 3ff0 0000 0000 0000.
    let one = [0, 0, 0, 0, 0, 0, 0xf0, 0x3f];
    let ros1 = [&[2, 0, 0, 0, b'a', b'b'][..], &one, &[7, 8, 0, 0, 0]].concat();
    assert_eq!(message(Encoding::Ros1), ros1);
    let start = [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0];
    let cdr = [&start[..], &one, &[7, 0, 0, 0, 8, 0, 0, 0]].concat();
    assert_eq!(message(Encoding::Cdr), cdr);
    let start = [0, 0, 0, 0, 0, 0, 0, 3, b'a', b'b', 0, 0];
    let one = [0x3f, 0xf0, 0, 0, 0, 0, 0, 0];
    let big_endian = [&start[..], &one, &[7, 0, 0, 0, 0, 0, 0, 8]].concat();
    assert_eq!(message(Encoding::CdrBigEndian), big_endian);
    // The examples of the protocol buffers documentation, "Encoding": 150 and "testing".
    assert_eq!(Protobuf::default().varint(1, 150).finish(), [0x08, 0x96, 0x01]);
    let text = Protobuf::default().bytes(2, b"testing").finish();
    assert_eq!(text, [&[0x12, 0x07][..], b"testing"].concat());
    // RFC 4648, section 10.
    assert_eq!(
        ["f", "fo", "foo", "foob"].map(|t| base64(t.as_bytes())).concat(),
        "Zg==Zm8=Zm9vZm9vYg=="
    );
}
