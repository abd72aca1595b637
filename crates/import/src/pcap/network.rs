//! A captured frame -> the UDP datagram in it.
//!
//! Link types: tcpdump.org/linktypes.html. What lies below IP is read by `etherparse`.

use std::net::IpAddr;

use etherparse::{EtherType, LinkExtSlice, NetSlice, SlicedPacket, TransportSlice};
use pcap_parser::Linktype;

use super::container::Frame;

/// BSD and OpenBSD number raw IP differently from the rest.
const BSD_RAW_IP: [i32; 2] = [12, 14];
/// Bytes of a Linux cooked header, and where the protocol stands in it (LINKTYPE_LINUX_SLL).
const SLL: (usize, usize) = (16, 14);
/// The same of its second version (LINKTYPE_LINUX_SLL2).
const SLL2: (usize, usize) = (20, 0);
/// Bytes of the address family before a packet of a loopback interface (LINKTYPE_NULL, _LOOP).
const FAMILY_BYTES: usize = 4;

/// A UDP datagram.
pub(super) struct Datagram<'a> {
    pub source: IpAddr,
    /// Where it went.
    pub port: u16,
    pub payload: &'a [u8],
}

/// What a frame is that holds no datagram, in the plural.
pub(super) enum NotUdp {
    /// Other traffic.
    Other(&'static str),
    /// May have been a datagram.
    Undecodable(&'static str),
}

const MALFORMED: NotUdp = NotUdp::Undecodable("frames whose headers do not decode");

/// The datagram of a frame, whole.
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
        _ => return Err(NotUdp::Undecodable("frames of a link type that is not known")),
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
        Some(NetSlice::Arp(_)) => return Err(NotUdp::Other("ARP frames")),
        None if packet.link_exts.iter().any(|ext| matches!(ext, LinkExtSlice::Macsec(_))) => {
            return Err(NotUdp::Undecodable("frames encrypted by MACsec"));
        }
        None => return Err(NotUdp::Other("frames that are neither IP nor ARP")),
    };
    match packet.transport {
        _ if fragmented => Err(NotUdp::Undecodable("fragments of IP packets")),
        Some(TransportSlice::Udp(udp)) => {
            Ok(Datagram { source, port: udp.destination_port(), payload: udp.payload() })
        }
        Some(TransportSlice::Tcp(_)) => Err(NotUdp::Other("TCP segments")),
        Some(TransportSlice::Icmpv4(_) | TransportSlice::Icmpv6(_)) => {
            Err(NotUdp::Other("ICMP messages"))
        }
        _ => Err(NotUdp::Other("IP packets that are neither UDP, TCP nor ICMP")),
    }
}
