//! A pcapng file of all packets on a network's links.
//!
//! - **Walk:** the node's thread, or a tap in a simulated world → [`LinkCapture`] → the file.
//! - **Invariants:** a capture never disturbs what it shows: where the file cannot be written any more it ends, and says why when asked.
//! - **Context:** any thread; a packet takes a lock and a buffered write.

use crate::error::OpenError;
use fixed_math::time::LocalTicks;
use osap_sim::capture::{Capture, Direction, InterfaceId};
use std::fmt::{self, Debug, Formatter};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A capture that several links write to.
#[derive(Clone)]
pub(super) struct LinkCapture {
    path: PathBuf,
    state: Arc<Mutex<State>>,
}

struct State {
    capture: Option<Capture<BufWriter<File>>>,
    interfaces: Vec<InterfaceId>,
    fault: Option<String>,
}

impl Debug for LinkCapture {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_tuple("LinkCapture").field(&self.path).finish()
    }
}

impl LinkCapture {
    /// Begins a capture; a file that is there is overwritten.
    pub(super) fn create(path: &Path) -> Result<Self, OpenError> {
        let cannot = |reason: String| OpenError::Capture { path: path.display().to_string(), reason };
        let file = File::create(path).map_err(|error| cannot(error.to_string()))?;
        let capture = Capture::new(BufWriter::new(file)).map_err(|error| cannot(reason(&error)))?;
        let state = State { capture: Some(capture), interfaces: Vec::new(), fault: None };
        Ok(Self { path: path.to_owned(), state: Arc::new(Mutex::new(state)) })
    }

    /// Adds the next link.
    pub(super) fn add(&self, name: &str, bit_rate: u32) {
        self.write(|capture, interfaces| {
            interfaces.push(capture.add_interface(name, bit_rate)?);
            Ok(())
        });
    }

    /// Writes a packet of the `link`-th link that was added.
    pub(super) fn packet(&self, link: usize, at: LocalTicks, direction: Direction, packet: &[u8]) {
        self.write(|capture, interfaces| match interfaces.get(link) {
            Some(interface) => capture.packet(*interface, at, direction, packet),
            None => Ok(()),
        });
    }

    /// Why the capture ended early, if it did.
    pub(super) fn fault(&self) -> Option<String> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).fault.clone()
    }

    fn write(
        &self,
        write: impl FnOnce(
            &mut Capture<BufWriter<File>>,
            &mut Vec<InterfaceId>,
        ) -> Result<(), osap_sim::capture::CaptureError>,
    ) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let State { capture: Some(capture), interfaces, .. } = &mut *state else { return };
        if let Err(error) = write(capture, interfaces) {
            state.capture = None;
            state.fault = Some(format!("{}: {}", self.path.display(), reason(&error)));
        }
    }
}

/// What is at the bottom of an error: the writer says of every failure, even of a full disk, that it was about reading bytes.
fn reason(error: &dyn std::error::Error) -> String {
    let mut at = error;
    while let Some(source) = at.source() {
        at = source;
    }
    at.to_string()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    /// What ends a capture is told by the system's own words.
    #[test]
    fn a_full_disk_is_told_as_such() {
        let capture = LinkCapture::create(Path::new("/dev/full")).unwrap();
        capture.add("link", 0);
        // more than a buffered writer keeps
        for _ in 0..100 {
            capture.packet(0, LocalTicks::ZERO, Direction::Sent, &[0; 200]);
        }
        let fault = capture.fault().unwrap();
        assert!(fault.starts_with("/dev/full: No space left on device"), "{fault}");
    }
}
