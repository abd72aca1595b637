//! Extracts the UDP datagram from a captured frame.
//!
//! Link types: tcpdump.org/linktypes.html. `etherparse` parses Ethernet, IP and UDP headers.

use std::net::IpAddr;

use dataset::LossKind;
use etherparse::{EtherType, LinkExtSlice, NetSlice, SlicedPacket, TransportSlice};
use pcap_parser::Linktype;

use super::container::Frame;

/// Link types of raw IP on BSD and OpenBSD, which differ from other systems.
const BSD_RAW_IP: [i32; 2] = [12, 14];
/// Size of a Linux cooked header and offset of its protocol field \[bytes\] (LINKTYPE_LINUX_SLL).
const SLL: (usize, usize) = (16, 14);
/// The same for the second version of the header (LINKTYPE_LINUX_SLL2).
const SLL2: (usize, usize) = (20, 0);
/// Size of the address family that precedes a packet of a loopback interface \[bytes\]
/// (LINKTYPE_NULL, LINKTYPE_LOOP).
const FAMILY_BYTES: usize = 4;

/// A UDP datagram.
pub(super) struct Datagram<'a> {
    pub source: IpAddr,
    /// The destination port.
    pub port: u16,
    pub payload: &'a [u8],
}

/// Why a frame has no datagram.
pub(super) enum NotUdp {
    /// The frame has another protocol.
    Other(&'static str),
    /// The frame may contain a datagram, but it cannot be decoded.
    Undecodable(&'static str),
}

impl NotUdp {
    /// The loss for a frame without a datagram.
    pub fn loss_kind(self, is_truncated: bool) -> LossKind {
        match self {
            Self::Other(protocol) => LossKind::FramesNotUdp { protocol: protocol.to_owned() },
            Self::Undecodable(_) if is_truncated => LossKind::TruncatedFrames,
            Self::Undecodable(fault) => LossKind::UndecodableFrames { fault: fault.to_owned() },
        }
    }
}

const MALFORMED: NotUdp = NotUdp::Undecodable("malformed headers");

/// The complete datagram of a frame.
pub(super) fn datagram<'a>(frame: &Frame<'a>) -> Result<Datagram<'a>, NotUdp> {
    let bytes = frame.bytes;
    let packet = match frame.link {
        Linktype::ETHERNET => SlicedPacket::from_ethernet(bytes),
        Linktype::LINUX_SLL => return cooked(bytes, SLL),
        Linktype(276) => return cooked(bytes, SLL2),
        Linktype::RAW | Linktype::IPV4 | Linktype::IPV6 => SlicedPacket::from_ip(bytes),
        Linktype(link) if BSD_RAW_IP.contains(&link) => SlicedPacket::from_ip(bytes),
        Linktype::NULL | Linktype::LOOP => {
            SlicedPacket::from_ip(bytes.get(FAMILY_BYTES..).ok_or(MALFORMED)?)
        }
        _ => return Err(NotUdp::Undecodable("unknown link type")),
    };
    of_packet(packet.map_err(|_| MALFORMED)?)
}

fn cooked(bytes: &[u8], (length, at): (usize, usize)) -> Result<Datagram<'_>, NotUdp> {
    let header = bytes.get(..length).ok_or(MALFORMED)?;
    let ether_type = EtherType(u16::from_be_bytes([header[at], header[at + 1]]));
    let packet = SlicedPacket::from_ether_type(ether_type, &bytes[length..]);
    of_packet(packet.map_err(|_| MALFORMED)?)
}

fn of_packet(packet: SlicedPacket<'_>) -> Result<Datagram<'_>, NotUdp> {
    let (source, fragmented) = match &packet.net {
        Some(NetSlice::Ipv4(ip)) => {
            (IpAddr::from(ip.header().source_addr()), ip.is_payload_fragmented())
        }
        Some(NetSlice::Ipv6(ip)) => {
            (IpAddr::from(ip.header().source_addr()), ip.is_payload_fragmented())
        }
        Some(NetSlice::Arp(_)) => return Err(NotUdp::Other("ARP")),
        None if packet.link_exts.iter().any(|ext| matches!(ext, LinkExtSlice::Macsec(_))) => {
            return Err(NotUdp::Undecodable("encrypted by MACsec"));
        }
        None => return Err(NotUdp::Other("neither IP nor ARP")),
    };
    match packet.transport {
        _ if fragmented => Err(NotUdp::Undecodable("IP fragment")),
        Some(TransportSlice::Udp(udp)) => {
            Ok(Datagram { source, port: udp.destination_port(), payload: udp.payload() })
        }
        Some(TransportSlice::Tcp(_)) => Err(NotUdp::Other("TCP")),
        Some(TransportSlice::Icmpv4(_) | TransportSlice::Icmpv6(_)) => Err(NotUdp::Other("ICMP")),
        _ => Err(NotUdp::Other("another IP protocol")),
    }
}
