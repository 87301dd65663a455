//! A little of GDB's remote protocol: reads and overwrites the memory of a device that QEMU runs.
//!
//! - **Walk:** [`Debugger::attach`], which stops the device → [`Debugger::read_word`], [`Debugger::write`] → [`Debugger::detach`], which lets
//!   it run on.
//! - **Invariants:** every packet has a sum and is acknowledged. Nothing else is attached at the same time.
//! - **Context:** real time; a device that answers nothing within ten seconds is an error.

use std::fmt::Write as _;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// A device that stands still.
#[derive(Debug)]
pub struct Debugger(UnixStream);

impl Debugger {
    /// Stops the device whose stub listens at `socket`.
    ///
    /// # Errors
    /// Where nobody listens.
    pub fn attach(socket: &Path) -> io::Result<Self> {
        let stream = UnixStream::connect(socket)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        Ok(Self(stream))
    }

    /// The word at `address`, little-endian.
    ///
    /// # Errors
    /// Where the answer does not come or is an error.
    pub fn read_word(&mut self, address: u32) -> io::Result<u32> {
        let answer = self.ask(&format!("m{address:x},4"))?;
        u32::from_str_radix(&answer, 16).map(u32::swap_bytes).map_err(|_| refused(&answer))
    }

    /// Overwrites what is at `address`, code too.
    ///
    /// # Errors
    /// Where the answer does not come or is an error.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> io::Result<()> {
        let mut command = format!("M{address:x},{:x}:", bytes.len());
        for byte in bytes {
            // writing to a string never fails
            let _fits = write!(command, "{byte:02x}");
        }
        self.confirmed(&command)
    }

    /// Lets the device run on.
    ///
    /// # Errors
    /// Where the answer does not come or is an error.
    pub fn detach(mut self) -> io::Result<()> {
        self.confirmed("D")
    }

    fn confirmed(&mut self, command: &str) -> io::Result<()> {
        let answer = self.ask(command)?;
        if answer == "OK" { Ok(()) } else { Err(refused(&answer)) }
    }

    fn ask(&mut self, command: &str) -> io::Result<String> {
        self.0.write_all(framed(command).as_bytes())?;
        loop {
            let answer = self.answer()?;
            // the device tells once that it has stopped
            if !answer.starts_with('T') {
                return Ok(answer);
            }
        }
    }

    fn answer(&mut self) -> io::Result<String> {
        // acknowledgements stand before it
        while self.byte()? != b'$' {}
        let mut answer = String::new();
        loop {
            match self.byte()? {
                b'#' => break,
                byte => answer.push(char::from(byte)),
            }
        }
        // the sum: a socket spoils nothing
        let _sum = [self.byte()?, self.byte()?];
        self.0.write_all(b"+")?;
        Ok(answer)
    }

    fn byte(&mut self) -> io::Result<u8> {
        let mut byte = [0];
        self.0.read_exact(&mut byte)?;
        Ok(byte[0])
    }
}

/// A packet: its sum is that of its bytes, modulo 256.
fn framed(command: &str) -> String {
    let sum = command.bytes().fold(0u8, u8::wrapping_add);
    format!("${command}#{sum:02x}")
}

fn refused(answer: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, format!("QEMU's debug stub answered {answer:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of GDB's manual has the sum of `OK`: 0x9a.
    #[test]
    fn a_packet_has_its_sum() {
        assert_eq!(framed("OK"), "$OK#9a");
        assert_eq!(framed(""), "$#00");
    }

    #[test]
    fn words_are_little_endian_and_refusals_are_errors() {
        let (ours, mut stub) = UnixStream::pair().unwrap();
        let mut debugger = Debugger(ours);
        stub.write_all(b"$T02thread:01;#07+$01020304#8a+$E01#a6").unwrap();
        assert_eq!(debugger.read_word(0x58).unwrap(), 0x0403_0201);
        assert!(debugger.write(0x10, &[0, 0xde]).unwrap_err().to_string().contains("E01"));
        let wanted = b"$m58,4#3a++$M10,2:00de#6f+";
        let mut sent = [0; 26];
        stub.read_exact(&mut sent).unwrap();
        assert_eq!(&sent, wanted);
    }
}
