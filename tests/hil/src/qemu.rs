//! QEMU processes that run the mps2 images: a Cortex-M7 with five UARTs, each a socket, and memory that outlives the process.
//!
//! - **Walk:** [`Qemu::new`] writes the factory record → [`Qemu::start`] → sockets of [`Qemu::serial`] → [`Qemu::kill`] → start again.
//! - **Invariants:** a process ends with its owner. The non-volatile memory is a file that is made once and kept over kills.
//! - **Context:** real time. QEMU knows neither baud rates nor cycles: what runs here shows function, never timing.

use std::fs::{self, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// The machine that is emulated.
const MACHINE: &str = "mps2-an500";
/// UARTs it has.
pub const UARTS: usize = 5;
/// Bytes of the file that stands for its non-volatile memory: the board's pseudo-static RAM.
const NVM_BYTES: u64 = 16 << 20;
/// Where the factory record stands in it, as `boards/mps2-an500/src/kept.rs` says.
const FACTORY_OFFSET: u64 = 0x5000;
/// Begins a factory record.
const FACTORY_MARK: u32 = 0x0511_fac7;

/// Why an emulated device does not run.
#[derive(Debug, thiserror::Error)]
pub enum QemuError {
    /// The program did not start.
    #[error("cannot start qemu-system-arm: {0}. `cargo xtask hil` installs it")]
    Start(io::Error),
    /// Its files cannot be made.
    #[error("cannot write the memory of the device {name} to {}: {source}", path.display())]
    Memory {
        /// Which device.
        name: String,
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Who an emulated device is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Names its files.
    pub name: String,
    /// Its number.
    pub unique_id: [u8; 12],
    /// Index into `firmware_app::kind::KINDS`.
    pub kind: u8,
}

/// One emulated device.
#[derive(Debug)]
pub struct Qemu {
    identity: Identity,
    elf: PathBuf,
    folder: PathBuf,
    icount: bool,
    child: Option<Child>,
}

impl Qemu {
    /// A device that is switched off. Its sockets and memory stand in `folder`. With `icount` its time is that of its instructions, 4 ns each,
    /// while it does something, and the computer's while it sleeps.
    ///
    /// # Errors
    /// [`QemuError::Memory`].
    pub fn new(identity: Identity, elf: &Path, folder: &Path, icount: bool) -> Result<Self, QemuError> {
        let device = Self { identity, elf: elf.to_owned(), folder: folder.to_owned(), icount, child: None };
        device.make_memory().map_err(|source| QemuError::Memory {
            name: device.identity.name.clone(),
            path: device.memory(),
            source,
        })?;
        Ok(device)
    }

    fn make_memory(&self) -> io::Result<()> {
        let mut file = OpenOptions::new().create(true).truncate(true).write(true).open(self.memory())?;
        file.set_len(NVM_BYTES)?;
        file.seek(SeekFrom::Start(FACTORY_OFFSET))?;
        file.write_all(&factory_record(&self.identity))
    }

    /// The file of its non-volatile memory.
    #[must_use]
    pub fn memory(&self) -> PathBuf {
        self.folder.join(format!("{}.nvm", self.identity.name))
    }

    /// Reads its non-volatile memory.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn read_memory(&self, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        let mut file = fs::File::open(self.memory())?;
        file.seek(SeekFrom::Start(offset))?;
        let mut bytes = vec![0; len];
        file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// The unix socket of one of its UARTs; it listens while the device runs.
    #[must_use]
    pub fn serial(&self, number: usize) -> PathBuf {
        self.folder.join(format!("{}{number}.sock", self.identity.name))
    }

    /// The unix socket of its debug stub; it listens while the device runs.
    #[must_use]
    pub fn debug_stub(&self) -> PathBuf {
        self.folder.join(format!("{}-gdb.sock", self.identity.name))
    }

    /// Who it is.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Switches it on. One that runs is left alone.
    ///
    /// # Errors
    /// [`QemuError::Start`].
    pub fn start(&mut self) -> Result<(), QemuError> {
        if self.child.is_none() {
            self.child = Some(self.command().spawn().map_err(QemuError::Start)?);
        }
        Ok(())
    }

    /// Ends the process at once, as pulling the plug does.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            // it may have ended of itself
            let _killed = child.kill();
            let _reaped = child.wait();
        }
    }

    fn command(&self) -> Command {
        let mut command = Command::new("qemu-system-arm");
        let memory = self.memory();
        let backend = format!("memory-backend-file,id=nvm,size=16M,mem-path={},share=on", memory.display());
        command.args(["-display", "none", "-monitor", "none", "-object", &backend]);
        command.args(["-machine", &format!("{MACHINE},memory-backend=nvm"), "-kernel"]).arg(&self.elf);
        if self.icount {
            command.args(["-icount", "shift=2"]);
        }
        command.args(["-gdb", &format!("unix:{},server=on,wait=off", self.debug_stub().display())]);
        for number in 0..UARTS {
            let serial = self.serial(number);
            command.args(["-serial", &format!("unix:{},server=on,wait=off", serial.display())]);
        }
        command.stdin(Stdio::null()).stdout(Stdio::null());
        command
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        self.kill();
    }
}

/// What tells an mps2 image who it is.
#[must_use]
pub fn factory_record(identity: &Identity) -> [u8; 20] {
    let mut record = [0; 20];
    record[..4].copy_from_slice(&FACTORY_MARK.to_le_bytes());
    record[4..16].copy_from_slice(&identity.unique_id);
    record[16] = identity.kind;
    record
}

/// Whether QEMU can be started at all; its version.
///
/// # Errors
/// [`QemuError::Start`].
pub fn version() -> Result<String, QemuError> {
    let output = Command::new("qemu-system-arm").arg("--version").output().map_err(QemuError::Start)?;
    Ok(String::from_utf8_lossy(&output.stdout).lines().next().unwrap_or_default().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The layout of `boards/mps2-an500/src/kept.rs`: mark, twelve bytes of number, kind, all little-endian.
    #[test]
    fn a_factory_record_is_laid_out_as_the_board_reads_it() {
        let identity = Identity { name: "a".into(), unique_id: *b"abcdefghijkl", kind: 1 };
        let record = factory_record(&identity);
        assert_eq!(record[..8], [0xc7, 0xfa, 0x11, 0x05, b'a', b'b', b'c', b'd']);
        assert_eq!(record[12..], [b'i', b'j', b'k', b'l', 1, 0, 0, 0]);
    }

    #[test]
    fn the_record_stands_in_the_memory_where_the_board_looks_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let identity = Identity { name: "a".into(), unique_id: *b"abcdefghijkl", kind: 1 };
        let device = Qemu::new(identity.clone(), Path::new("none"), folder.path(), false).unwrap();
        assert_eq!(device.read_memory(FACTORY_OFFSET, 20).unwrap(), factory_record(&identity));
        assert_eq!(fs::metadata(device.memory()).unwrap().len(), NVM_BYTES);
    }
}
