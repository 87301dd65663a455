//! The emulated network of the scan: a Cortex-M7 hub, a Cortex-M7 device and an RP2040 behind it, each switched on and off at will.
//!
//! - **Walk:** `osap` – TCP – [`Bridge`] – hub (QEMU) UART0; hub UART1 – [`Bridge`] – device (QEMU); hub UART2 – [`Bridge`] – RP2040
//!   (co-simulation, or a board at a serial port).
//! - **Invariants:** ids, kinds and wires are the constants here. All processes end with the machine.
//! - **Context:** real time: it shows function, never timing.

use crate::bridge::{Bridge, End, Order};
use crate::cosim::Cosim;
use crate::gdb::Debugger;
use crate::images::{Image, Places};
use crate::pico::{HEATER, HUB, MOTOR, pico};
use crate::qemu::{Identity, Qemu, QemuError};
use crate::report::Failure;
use osap::session::{OpenOptions, Session};
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use tempfile::TempDir;

/// A device of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The hub: Cortex-M7, five UARTs.
    Hub,
    /// The device on its UART 1: Cortex-M7.
    Motor,
    /// The device on its UART 2: RP2040.
    Heater,
}

impl Part {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Hub, Self::Motor, Self::Heater];

    /// Its number as a scan writes it.
    #[must_use]
    pub const fn unique_id(self) -> &'static str {
        match self {
            Self::Hub => "6d7073326875620000000001",
            Self::Motor => "6d7073326d6f740000000002",
            Self::Heater => "323034300000000000000003",
        }
    }

    /// What it calls itself.
    #[must_use]
    pub const fn type_name(self) -> &'static str {
        match self {
            Self::Hub => "hub",
            Self::Motor => "motor",
            Self::Heater => "heater",
        }
    }

    /// The way to it from the host.
    #[must_use]
    pub const fn route(self) -> &'static str {
        match self {
            Self::Hub => "/0",
            Self::Motor => "/0/1",
            Self::Heater => "/0/2",
        }
    }
}

/// The name of the co-simulated chip and of its outside port.
const CHIP: &str = "heater";

impl From<QemuError> for Failure {
    fn from(error: QemuError) -> Self {
        match error {
            QemuError::Start(_) => Self::NotRun(error.to_string()),
            QemuError::Memory { .. } => Self::Failed(error.to_string()),
        }
    }
}

/// The machine, all of it switched off at first.
#[derive(Debug)]
pub struct Machine {
    hub: Qemu,
    motor: Qemu,
    bridge: Bridge,
    address: SocketAddr,
    /// Last, so that the files outlive the processes.
    _folder: TempDir,
}

impl Machine {
    /// Makes it. With `board` a real Pico at that serial port takes the emulated one's place.
    ///
    /// # Errors
    /// [`Failure::NotRun`] where something is missing.
    pub fn new(places: &Places, board: Option<PathBuf>, port: u16) -> Result<Self, Failure> {
        let elf = places.image(Image::Mps2An500)?;
        let folder = tempfile::tempdir()?;
        let device = |name: &str, unique_id: &[u8; 12], kind| {
            let identity = Identity { name: name.to_owned(), unique_id: *unique_id, kind };
            Qemu::new(identity, &elf, folder.path(), false)
        };
        let hub = device("hub", b"mps2hub\0\0\0\0\x01", HUB)?;
        let motor = device("motor", b"mps2mot\0\0\0\0\x02", MOTOR)?;
        crate::qemu::version()?;
        let listener = TcpListener::bind(("127.0.0.1", port))?;
        let address = listener.local_addr()?;
        let (heater, cosim) = match board {
            Some(path) if path.exists() => (End::Tty(path), None),
            Some(path) => {
                return Err(Failure::NotRun(format!(
                    "no board is at {}: plug it in, or leave --board out",
                    path.display()
                )));
            }
            None => (End::Port(CHIP.to_owned()), Some(heater(places)?)),
        };
        let wires = vec![
            [End::Listener(listener), End::Socket(hub.serial(0))],
            [End::Socket(hub.serial(1)), End::Socket(motor.serial(0))],
            [End::Socket(hub.serial(2)), heater],
        ];
        let bridge = Bridge::start(wires, cosim)?;
        Ok(Self { hub, motor, bridge, address, _folder: folder })
    }

    /// The link by which `osap` reaches it.
    #[must_use]
    pub fn link(&self) -> String {
        format!("tcp:{},check=crc16", self.address)
    }

    /// Switches a device on.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn start(&mut self, part: Part) -> Result<(), Failure> {
        match part {
            Part::Hub => self.hub.start()?,
            Part::Motor => self.motor.start()?,
            Part::Heater => self.bridge.order(Order::PowerOn(CHIP.to_owned())),
        }
        Ok(())
    }

    /// Pulls a device's plug.
    pub fn kill(&mut self, part: Part) {
        match part {
            Part::Hub => self.hub.kill(),
            Part::Motor => self.motor.kill(),
            Part::Heater => self.bridge.order(Order::PowerOff(CHIP.to_owned())),
        }
    }
}

/// The hub and the motor alone, the hub's time counted in instructions: what is counted in the hub can be read from its memory.
#[derive(Debug)]
pub struct CountedHub {
    hub: Qemu,
    _motor: Qemu,
    _bridge: Bridge,
    address: SocketAddr,
    /// Last, so that the files outlive the processes.
    _folder: TempDir,
}

impl CountedHub {
    /// Switches both on.
    ///
    /// # Errors
    /// [`Failure::NotRun`] where something is missing.
    pub fn start(places: &Places) -> Result<Self, Failure> {
        let elf = places.image(Image::Mps2An500)?;
        crate::qemu::version()?;
        let folder = tempfile::tempdir()?;
        let device = |name: &str, unique_id: &[u8; 12], kind, icount| {
            let identity = Identity { name: name.to_owned(), unique_id: *unique_id, kind };
            Qemu::new(identity, &elf, folder.path(), icount)
        };
        let mut hub = device("hub", b"mps2hub\0\0\0\0\x01", HUB, true)?;
        let mut motor = device("motor", b"mps2mot\0\0\0\0\x02", MOTOR, false)?;
        let listener = TcpListener::bind(("127.0.0.1", 0))?;
        let address = listener.local_addr()?;
        let wires = vec![
            [End::Listener(listener), End::Socket(hub.serial(0))],
            [End::Socket(hub.serial(1)), End::Socket(motor.serial(0))],
        ];
        let bridge = Bridge::start(wires, None)?;
        hub.start()?;
        motor.start()?;
        Ok(Self { hub, _motor: motor, _bridge: bridge, address, _folder: folder })
    }

    /// A session at the hub's first UART.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn session(&self) -> Result<Session, Failure> {
        let spec = format!("tcp:{},check=crc16", self.address);
        let spec = spec.parse().map_err(|error| Failure::Failed(format!("{spec}: {error}")))?;
        Session::open(&[spec], &OpenOptions::default()).map_err(|error| Failure::Failed(error.to_string()))
    }

    /// Stops the hub, to have its memory read and overwritten.
    ///
    /// # Errors
    /// Where its debug stub does not listen.
    pub fn debug_hub(&self) -> std::io::Result<Debugger> {
        Debugger::attach(&self.hub.debug_stub())
    }

    /// Reads the hub's non-volatile memory, which it goes on writing to.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn hub_memory(&self, offset: u64, len: usize) -> std::io::Result<Vec<u8>> {
        self.hub.read_memory(offset, len)
    }
}

/// The co-simulation with the RP2040, which is off.
fn heater(places: &Places) -> Result<Cosim, Failure> {
    let elf = places.image(Image::Rp2040Pico)?;
    let mut cosim = Cosim::start(&places.server())?;
    cosim.chip(&pico(CHIP, &elf, 3, HEATER))?;
    cosim.port(CHIP, (CHIP, 0), crate::network::BAUD, None)?;
    cosim.power_off(CHIP)?;
    Ok(cosim)
}
