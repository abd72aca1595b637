//! `velodyne_msgs/VelodyneScan` and `velodyne_msgs/VelodynePacket`. The packets are borrowed.

use crate::hdl32e::PACKET_BYTES;
use crate::wire::{Cursor, Decoded, MAX_CDR_PADDING, Writer, time_ns, u32_of};
use crate::{Encoding, MessageError, MessageType, Result};

/// Length of a `VelodynePacket`: its stamp and its data \[bytes\].
const STAMPED_PACKET_BYTES: usize = 8 + PACKET_BYTES;

/// The packets of one message, borrowed from its bytes.
#[derive(Debug, Clone, Copy)]
pub struct VelodyneScan<'a> {
    /// Stamp of the header, or of the packet in a `VelodynePacket` \[ns since the epoch\].
    pub stamp_ns: i64,
    packets: &'a [u8],
    n_packets: usize,
    stride: usize,
    big_endian: bool,
}

impl<'a> VelodyneScan<'a> {
    /// Reads the header of a `VelodyneScan` and checks that the packets fill the message. Otherwise an
    /// altered count or an altered length of the frame name would hide packets.
    pub(crate) fn read(encoding: Encoding, bytes: &'a [u8]) -> Result<Decoded<Self>> {
        let mut cursor = Cursor::new(MessageType::VelodyneScan, encoding, bytes)?;
        let stamp_ns = cursor.header_stamp_ns()?;
        let n_packets = cursor.size()?;
        // In CDR the stamp of the next packet is aligned: it starts 2 bytes after the data.
        let stride = match encoding {
            Encoding::Cdr => STAMPED_PACKET_BYTES.next_multiple_of(4),
            _ => STAMPED_PACKET_BYTES,
        };
        let length = match n_packets {
            0 => 0,
            n => (n - 1).saturating_mul(stride).saturating_add(STAMPED_PACKET_BYTES),
        };
        let packets = cursor.take(length)?;
        let big_endian = cursor.is_big_endian();
        let decoded = cursor.decoded(Self { stamp_ns, packets, n_packets, stride, big_endian });
        if MAX_CDR_PADDING < decoded.n_left {
            return Err(MessageError::Malformed {
                message: MessageType::VelodyneScan.name(),
                detail: format!("{} bytes follow its {n_packets} packets", decoded.n_left),
            });
        }
        Ok(decoded)
    }

    /// Reads a `VelodynePacket`.
    pub(crate) fn read_packet(encoding: Encoding, bytes: &'a [u8]) -> Result<Decoded<Self>> {
        let mut cursor = Cursor::new(MessageType::VelodynePacket, encoding, bytes)?;
        let packets = cursor.take(STAMPED_PACKET_BYTES)?;
        let stride = STAMPED_PACKET_BYTES;
        let big_endian = cursor.is_big_endian();
        let scan = Self { stamp_ns: 0, packets, n_packets: 1, stride, big_endian };
        let stamp_ns = scan.packets().next().map_or(0, |(stamp_ns, _)| stamp_ns);
        Ok(cursor.decoded(Self { stamp_ns, ..scan }))
    }

    /// Number of packets.
    pub fn len(&self) -> usize {
        self.n_packets
    }

    /// Whether there are no packets.
    pub fn is_empty(&self) -> bool {
        self.n_packets == 0
    }

    /// The stamp \[ns since the epoch\] and the 1206 bytes of each packet, in order.
    pub fn packets(&self) -> impl ExactSizeIterator<Item = (i64, &'a [u8])> + use<'a> {
        let Self { packets, stride, big_endian, .. } = *self;
        (0..self.n_packets).map(move |k| {
            let packet = &packets[k * stride..][..STAMPED_PACKET_BYTES];
            let u32_at = |at: usize| {
                u32_of([packet[at], packet[at + 1], packet[at + 2], packet[at + 3]], big_endian)
            };
            (time_ns(u32_at(0), u32_at(4)), &packet[8..])
        })
    }
}

/// Writes a `velodyne_msgs/VelodyneScan`. Each packet has its own stamp \[ns since the epoch\].
pub fn write_velodyne_scan(
    encoding: Encoding,
    frame_id: &str,
    stamp_ns: i64,
    packets: &[(i64, [u8; PACKET_BYTES])],
) -> Vec<u8> {
    let capacity = 64 + frame_id.len() + packets.len() * (STAMPED_PACKET_BYTES + 2);
    let mut writer = Writer::new(encoding, capacity);
    writer.header(stamp_ns, frame_id);
    writer.size(packets.len());
    for (packet_stamp_ns, packet) in packets {
        writer.time(*packet_stamp_ns);
        writer.raw(packet);
    }
    writer.finish()
}

/// Writes a `velodyne_msgs/VelodynePacket`.
pub fn write_velodyne_packet(
    encoding: Encoding,
    stamp_ns: i64,
    packet: &[u8; PACKET_BYTES],
) -> Vec<u8> {
    let mut writer = Writer::new(encoding, 4 + STAMPED_PACKET_BYTES);
    writer.time(stamp_ns);
    writer.raw(packet);
    writer.finish()
}
