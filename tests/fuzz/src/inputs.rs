//! Where inputs come from: random bytes, well-formed packets, and both spoiled.
//!
//! - **Invariant:** the n-th input depends on the seed and n alone.

use osap_protocol::framing::{Check, encode, encoded_len_max};
use osap_protocol::header::{Terminal, emit};
use osap_protocol::{BusDrop, GatewayIndex, PortIndex, RouteBuf, Step};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Longest input, bytes: more than any receiver under test holds.
const INPUT_BYTES_MAX: usize = 700;

/// A seeded source of inputs.
pub(crate) struct Source {
    random: Pcg64,
    bytes: Vec<u8>,
}

impl Source {
    pub(crate) fn new(seed: u64) -> Self {
        Self { random: Pcg64::seed_from_u64(seed), bytes: Vec::with_capacity(2 * INPUT_BYTES_MAX) }
    }

    /// The next input.
    pub(crate) fn next_input(&mut self) -> &[u8] {
        self.bytes.clear();
        match self.random.random_range(0..10u8) {
            0 => self.noise(),
            1..6 => self.packet(),
            6 | 7 => self.frame(),
            _ => {
                self.frame();
                let mut first = std::mem::take(&mut self.bytes);
                self.frame();
                first.append(&mut self.bytes);
                self.bytes = first;
            }
        }
        if self.random.random_bool(0.5) {
            self.spoil();
        }
        self.bytes.truncate(INPUT_BYTES_MAX);
        &self.bytes
    }

    fn noise(&mut self) {
        let len = self.random.random_range(0..INPUT_BYTES_MAX);
        let few_values = self.random.random_bool(0.5);
        for _ in 0..len {
            let byte: u8 = self.random.random();
            // many zeros and opcode bytes make more structure than evenly spread ones
            self.bytes.push(if few_values {
                [0, 5, 0x40, 0x80, 0xc0, 0xff, 1, 2][usize::from(byte & 7)]
            } else {
                byte
            });
        }
    }

    /// A packet such as a well-behaved sender makes, over links and buses, to ports that exist and ports that do not.
    fn packet(&mut self) {
        let mut route = RouteBuf::new();
        let first_is_bus = self.random.random_bool(0.2);
        for hop in 0..self.random.random_range(1..6u8) {
            let gateway = GatewayIndex::from_low_bits(self.random.random_range(0..4));
            let on_bus = if hop == 0 { first_is_bus } else { self.random.random_bool(0.2) };
            let step =
                if on_bus { Step::Bus { gateway, drop: BusDrop(self.random.random()) } } else { Step::Link(gateway) };
            if route.push(step).is_err() {
                break;
            }
        }
        if self.random.random_bool(0.4) {
            route = RouteBuf::new();
            let gateway = GatewayIndex::from_low_bits(0);
            let _fits = route.push(Step::Link(gateway));
        }
        let terminal = if self.random.random_bool(0.1) {
            Terminal::System { key: self.random.random_range(0..8) }
        } else {
            Terminal::Port {
                source: PortIndex::from_low_bits(self.random.random()),
                destination: PortIndex::from_low_bits(self.random.random_range(0..4)),
                transport: self.random.random_range(0..4),
            }
        };
        let mut packet = [0; INPUT_BYTES_MAX];
        let mtu = if self.random.random_bool(0.8) { 256 } else { self.random.random() };
        let ttl = if self.random.random_bool(0.8) { 50_000 } else { self.random.random() };
        let Ok(at) = emit(&mut packet, ttl, mtu, route.as_route(), terminal) else { return };
        let len = self.payload(&mut packet[at..]);
        self.bytes.extend_from_slice(&packet[..at + len]);
    }

    /// A payload: often a query, an announcement or a segment, sometimes noise.
    fn payload(&mut self, room: &mut [u8]) -> usize {
        let len = self.random.random_range(0..80usize);
        for byte in &mut room[..len] {
            *byte = self.random.random();
        }
        if len >= 6 {
            let shape: &[u8] = match self.random.random_range(0..5u8) {
                0 => &[7, 0, 1, 1],       // request 7: runtime information
                1 => &[9, 0, 3, 1],       // request 9: name
                2 => &[0, 3, 0, 0, 2, 0], // segment 0 of 2 of message 3
                3 => &[1, 9, 9, 9, 9, 9], // an announcement begins with its version
                _ => &[],
            };
            room[..shape.len()].copy_from_slice(shape);
            let key = &mut room[2];
            if *key < 12 {
                *key = self.random.random_range(0..13);
            }
        }
        len
    }

    /// A packet in a frame with either check.
    fn frame(&mut self) {
        self.packet();
        let packet = std::mem::take(&mut self.bytes);
        let check = [Check::None, Check::Crc16, Check::Crc16, Check::Crc32][self.random.random_range(0..4usize)];
        self.bytes.resize(encoded_len_max(packet.len(), check), 0);
        let len = encode(&packet, check, &mut self.bytes).unwrap_or(0);
        self.bytes.truncate(len);
    }

    /// Flips, sets, cuts, repeats or inserts.
    fn spoil(&mut self) {
        for _ in 0..self.random.random_range(1..4u8) {
            if self.bytes.is_empty() {
                return;
            }
            let at = self.random.random_range(0..self.bytes.len());
            match self.random.random_range(0..6u8) {
                0 | 1 => self.bytes[at] ^= 1 << self.random.random_range(0..8u8),
                2 => self.bytes[at] = self.random.random(),
                3 => self.bytes.truncate(at),
                4 => self.bytes.insert(at, self.random.random()),
                _ => {
                    let tail = self.bytes[at..].to_vec();
                    self.bytes.extend(tail);
                }
            }
        }
    }
}
