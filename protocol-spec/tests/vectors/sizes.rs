//! The thesis's Table 2.6, with packets that the code builds.

use crate::headers::{Said, route};
use crate::{Clauses, Hex, each, vector_file, vectors};
use osap_protocol::PortIndex;
use osap_protocol::framing::{Check, encode, encoded_len_max};
use osap_protocol::header::{Terminal, emit};
use osap_protocol::ttl::wire_time;
use serde::Deserialize;

pub(crate) const SIZES: &str = "sizes.toml";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SizeFile {
    packet: Vec<Size>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Size {
    name: String,
    clause: Clauses,
    bytes: Hex,
    steps: Vec<Said>,
    header_bytes: usize,
    data_bytes: usize,
    pipes_bytes: usize,
    total_bytes: usize,
    overhead_permille: usize,
    wire_bits: usize,
    wire_us_at_1000_kbps: u64,
    framed_bytes: usize,
    framed_us_at_3_mbaud: u64,
    ttl_us: u64,
}

vectors!(Size);

fn nearest(numerator: usize, denominator: usize) -> usize {
    (2 * numerator + denominator) / (2 * denominator)
}

#[test]
fn table_2_6() {
    let file: SizeFile = vector_file(SIZES);
    assert_eq!(file.packet.len(), 8, "{SIZES}: the table has eight rows");
    each(SIZES, &file.packet, |at, v| {
        let mut packet = vec![0x55; v.total_bytes];
        let port = |index| PortIndex::new(index).expect("a small index");
        let terminal = Terminal::Port { source: port(3), destination: port(0), transport: 0 };
        let header =
            emit(&mut packet, 1000, 256, route(&v.steps).as_route(), terminal).expect("the header fits its packet");
        assert_eq!(&packet[..header], v.bytes.0, "{at}: header");
        assert_eq!(header, v.header_bytes, "{at}: header bytes");
        assert_eq!(packet.len() - header, v.data_bytes + v.pipes_bytes, "{at}: bytes behind the header");
        let overhead = nearest(1000 * (header + v.pipes_bytes), packet.len());
        assert_eq!(overhead, v.overhead_permille, "{at}: overhead");

        let bare = wire_time(packet.len(), 8, 1_000_000);
        assert_eq!(packet.len() * 8, v.wire_bits, "{at}: wire bits");
        assert_eq!(bare.as_us_ceil(), v.wire_us_at_1000_kbps, "{at}: wire time");

        let mut frame = vec![0; encoded_len_max(packet.len(), Check::Crc16)];
        let framed = encode(&packet, Check::Crc16, &mut frame).expect("the stated bound suffices");
        assert_eq!(framed, v.framed_bytes, "{at}: framed bytes");
        let wire = wire_time(framed, 10, 3_000_000);
        assert_eq!((wire.steps() + 128) >> 8, v.framed_us_at_3_mbaud, "{at}: framed wire time, to the nearest µs");
        assert_eq!(wire.as_us_ceil(), v.ttl_us, "{at}: what it takes off a TTL");
    });
}
