//! Pseudo-terminals, and serial ports that are one underneath.
//!
//! - **Walk:** `pty` on one side, `serial` with its device's name on the other.
//! - **Clauses:** `[LNK-01]`, `[LNK-06]`, `[FRM-02]`.

use crate::support::{Side, exchange, plain};
use osap::link::{self, LinkEvent, LinkOptions};
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::time::Duration;

/// The device a listening pseudo-terminal offers.
fn device(side: &Side) -> &str {
    side.name().strip_prefix("pty:").unwrap()
}

#[test]
fn a_pseudo_terminal_is_a_serial_port() {
    for tail in ["", ",check=none", ",check=crc32"] {
        let terminal = Side::listen(&format!("pty{tail}"), &plain());
        terminal.expect(&LinkEvent::Up);
        for _ in 0..2 {
            let port = Side::open(&format!("serial:{}@3000000{tail}", device(&terminal)), &plain());
            port.expect(&LinkEvent::Up);
            assert_eq!((port.handle.description.bit_rate, port.handle.description.bits_a_byte), (3_000_000, 10));
            exchange(&port, &terminal);
            port.drop_and_see_threads_end();
        }
        terminal.drop_and_see_threads_end();
    }
}

/// Sends the longest packets, which the system does not take at once, until there is no `Sent` any more.
fn fill(side: &Side) {
    loop {
        side.handle.send(vec![1; usize::from(link::MTU_BYTES_MAX)]).unwrap();
        match side.inbox.recv_timeout(Duration::from_secs(1)) {
            Ok((_, LinkEvent::Sent)) => {}
            Ok(other) => panic!("{other:?}"),
            Err(_) => return,
        }
    }
}

/// Nobody reads: the writer waits in the middle of a packet, and still ends with its handle, whichever side it is on.
#[test]
fn a_writer_that_waits_for_a_device_ends() {
    let longest = LinkOptions { mtu_bytes: link::MTU_BYTES_MAX, ..plain() };
    let terminal = Side::listen("pty", &longest);
    terminal.expect(&LinkEvent::Up);
    fill(&terminal);
    terminal.drop_and_see_threads_end();

    let deaf = Side::listen_with_room("pty", &longest, 1); // its `Up` is never taken, so it hands no packet on
    let port = Side::open(&format!("serial:{}", device(&deaf)), &longest);
    port.expect(&LinkEvent::Up);
    fill(&port);
    port.drop_and_see_threads_end();
    deaf.drop_and_see_threads_end();
}

/// A folder of its own, gone with the test.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// `[LNK-06]`: a device that is unplugged and comes back, as another pseudo-terminal under the same name.
#[test]
fn a_device_that_comes_back_is_opened_again() {
    let folder = Folder(std::env::temp_dir().join(format!("osap-links-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let name = folder.0.join("port");
    let plug = || {
        let terminal = Side::listen("pty", &plain());
        terminal.expect(&LinkEvent::Up);
        symlink(device(&terminal), &name).unwrap();
        terminal
    };
    let port = Side::open(&format!("serial:{}", name.display()), &plain());
    assert!(port.expect_down().contains("port"), "the reason names the device");
    for _ in 0..2 {
        let terminal = plug();
        port.expect(&LinkEvent::Up);
        exchange(&port, &terminal);
        std::fs::remove_file(&name).unwrap();
        drop(terminal);
        port.expect_down();
    }
}
