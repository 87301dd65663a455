//! Carries bytes between emulators, boards and the command line, with the co-simulation kept at the pace of the wall clock.
//!
//! - **Walk:** an [`End`] → this thread → the other end. Ends that go away are connected again when they come back.
//! - **Invariants:** an end that nobody listens at loses what is sent to it, as a wire without a device does; an emulator is never left
//!   undrained, which would stop it. Virtual time never runs ahead of the wall clock; where it cannot keep up it falls behind.
//! - **Context:** one thread, ended and joined when the bridge is dropped.

use crate::cosim::{Cosim, Event, Ns};
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpListener;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest stretch of virtual time that is run at once; more that is behind is given up.
const SLICE: Duration = Duration::from_millis(10);
/// From one round to the next.
const PAUSE: Duration = Duration::from_micros(200);
/// From one try to connect to the next.
const RETRY: Duration = Duration::from_millis(10);
/// Bytes that may wait for an end that is slow to take them.
const PENDING_MAX: usize = 1 << 16;

/// One end of a wire.
#[derive(Debug)]
pub enum End {
    /// A UART of a QEMU process: its unix socket.
    Socket(PathBuf),
    /// An outside port of the co-simulation.
    Port(String),
    /// A real board at a serial port of this computer, at 3 Mbaud.
    Tty(PathBuf),
    /// Whoever calls: one at a time, the last one counts.
    Listener(TcpListener),
}

/// Something to be done to the co-simulation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Order {
    /// Switches a chip off.
    PowerOff(String),
    /// Switches it on again.
    PowerOn(String),
}

/// The thread.
#[derive(Debug)]
pub struct Bridge {
    orders: Sender<Order>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Bridge {
    /// Starts to carry bytes over `wires`.
    ///
    /// # Errors
    /// Where no thread can be started or a listener cannot be asked without waiting.
    pub fn start(wires: Vec<[End; 2]>, cosim: Option<Cosim>) -> io::Result<Self> {
        let (orders, inbox) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let wires = wires.into_iter().map(|[a, b]| Ok([Plug::new(a)?, Plug::new(b)?])).collect::<io::Result<_>>()?;
        let carrier = Carrier { wires, cosim, orders: inbox, stop: Arc::clone(&stop), last: Instant::now() };
        let thread = std::thread::Builder::new().name("hil-bridge".into()).spawn(move || carrier.run())?;
        Ok(Self { orders, stop, thread: Some(thread) })
    }

    /// Has something done to the co-simulation.
    pub fn order(&self, order: Order) {
        // a thread that has ended has said why
        let _sent = self.orders.send(order);
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ended = thread.join();
        }
    }
}

/// Bytes in both directions.
trait Stream: Read + Write + Send {}
impl<T: Read + Write + Send> Stream for T {}

/// An end, whether anybody is there, and what waits to be taken.
struct Plug {
    end: End,
    stream: Option<Box<dyn Stream>>,
    tried: Option<Instant>,
    pending: Vec<u8>,
}

impl Plug {
    fn new(end: End) -> io::Result<Self> {
        if let End::Listener(listener) = &end {
            listener.set_nonblocking(true)?;
        }
        Ok(Self { end, stream: None, tried: None, pending: Vec::new() })
    }

    fn connect(&mut self) {
        let is_listener = matches!(self.end, End::Listener(_));
        let is_early = self.tried.is_some_and(|at| at.elapsed() < RETRY);
        if !is_listener && (self.stream.is_some() || is_early) {
            return;
        }
        self.tried = Some(Instant::now());
        if let Some(stream) = self.end.open() {
            self.pending.clear();
            self.stream = Some(stream);
        }
    }

    /// What has come; an end that is gone is let go.
    fn read(&mut self) -> Vec<u8> {
        let mut room = [0; 4096];
        let Some(stream) = &mut self.stream else { return Vec::new() };
        match stream.read(&mut room) {
            Ok(0) => self.stream = None,
            Ok(len) => return room[..len].to_vec(),
            Err(error) if is_passing(&error) => {}
            Err(_) => self.stream = None,
        }
        Vec::new()
    }

    fn write(&mut self, bytes: &[u8]) {
        let Some(stream) = &mut self.stream else { return };
        if self.pending.len() + bytes.len() <= PENDING_MAX {
            self.pending.extend_from_slice(bytes);
        }
        match stream.write(&self.pending) {
            Ok(len) => drop(self.pending.drain(..len)),
            Err(error) if is_passing(&error) => {}
            Err(_) => self.stream = None,
        }
    }

    fn is_port(&self, name: &str) -> bool {
        matches!(&self.end, End::Port(port) if port == name)
    }
}

impl End {
    /// Connects, if somebody is there.
    fn open(&self) -> Option<Box<dyn Stream>> {
        match self {
            Self::Socket(path) => {
                let stream = UnixStream::connect(path).ok()?;
                stream.set_nonblocking(true).ok()?;
                Some(Box::new(stream))
            }
            Self::Listener(listener) => {
                let (stream, _) = listener.accept().ok()?;
                stream.set_nonblocking(true).ok()?;
                stream.set_nodelay(true).ok()?;
                Some(Box::new(stream))
            }
            Self::Tty(path) => {
                let port = serialport::new(path.to_string_lossy(), crate::network::BAUD).timeout(PAUSE);
                Some(Box::new(Tty(port.open().ok()?)))
            }
            Self::Port(_) => None,
        }
    }
}

/// A serial port, which says that it waited too long where others would say that they would wait.
struct Tty(Box<dyn serialport::SerialPort>);

impl Read for Tty {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        if self.0.bytes_to_read()? == 0 {
            return Err(ErrorKind::WouldBlock.into());
        }
        self.0.read(room)
    }
}

impl Write for Tty {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::TimedOut)
}

/// Carries what has come at `from` over; for a port of the co-simulation it is given back.
fn carry(from: &mut Plug, to: &mut Plug) -> Option<(String, Vec<u8>)> {
    from.connect();
    let bytes = from.read();
    if let End::Port(port) = &to.end {
        return (!bytes.is_empty()).then(|| (port.clone(), bytes));
    }
    to.write(&bytes);
    None
}

struct Carrier {
    wires: Vec<[Plug; 2]>,
    cosim: Option<Cosim>,
    orders: Receiver<Order>,
    stop: Arc<AtomicBool>,
    last: Instant,
}

impl Carrier {
    fn run(mut self) {
        while !self.stop.load(Ordering::Acquire) {
            if let Err(error) = self.round() {
                eprintln!("hil: {error}");
                return;
            }
            std::thread::sleep(PAUSE);
        }
    }

    fn round(&mut self) -> Result<(), crate::cosim::CosimError> {
        let mut to_ports = Vec::new();
        for wire in &mut self.wires {
            let [a, b] = wire;
            to_ports.extend(carry(a, b));
            to_ports.extend(carry(b, a));
        }
        let Some(cosim) = &mut self.cosim else { return Ok(()) };
        for order in self.orders.try_iter() {
            match order {
                Order::PowerOff(chip) => cosim.power_off(&chip)?,
                Order::PowerOn(chip) => cosim.power_on(&chip)?,
            }
        }
        for (port, bytes) in to_ports {
            cosim.send(&port, &bytes, 0)?;
        }
        let passed = self.last.elapsed();
        self.last = Instant::now();
        let slice_ns = Ns::try_from(passed.min(SLICE).as_nanos()).unwrap_or(0);
        for event in cosim.run(cosim.now_ns() + slice_ns, false)? {
            let Event::Frame { port, bytes, .. } = event else { continue };
            for wire in &mut self.wires {
                let [a, b] = wire;
                if a.is_port(&port) {
                    b.write(&bytes);
                } else if b.is_port(&port) {
                    a.write(&bytes);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpStream;
    use std::os::unix::net::UnixListener;

    fn exchange(caller: &mut TcpStream, emulator: &mut UnixStream, text: &[u8]) {
        let mut room = vec![0; text.len()];
        caller.write_all(text).unwrap();
        emulator.read_exact(&mut room).unwrap();
        emulator.write_all(&room).unwrap();
        caller.read_exact(&mut room).unwrap();
        assert_eq!(room, text);
    }

    /// Both ends go away and come back; what is at the other end stays connected.
    #[test]
    fn bytes_go_both_ways_and_ends_that_come_back_are_connected_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("uart.sock");
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = listener.local_addr().unwrap();
        let uart = UnixListener::bind(&path).unwrap();
        let _bridge = Bridge::start(vec![[End::Listener(listener), End::Socket(path.clone())]], None).unwrap();
        let (mut emulator, _) = uart.accept().unwrap();
        let mut caller = TcpStream::connect(address).unwrap();
        exchange(&mut caller, &mut emulator, b"first");
        drop(emulator);
        let (mut emulator, _) = uart.accept().unwrap();
        exchange(&mut caller, &mut emulator, b"another emulator");
        drop(caller);
        let mut caller = TcpStream::connect(address).unwrap();
        exchange(&mut caller, &mut emulator, b"another caller");
    }
}
