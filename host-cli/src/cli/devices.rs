//! Devices: scanning for them, finding the one that is meant, and what can go wrong between us and one.
//!
//! - **Walk:** a command's DEVICE → a scan → [`Scanned::device`] → questions to it → [`Scanned::failed`] where one has no answer.
//! - **Invariant:** never the first of several: a name that two devices have is an error that lists both.

use super::links::{LinkArgs, quoted};
use super::output::{count, printable};
use super::progress::Progress;
use super::{CliError, Exit, Output};
use crate::error::{AskError, Place};
use crate::map::{Device, Gateway, LeadsTo, NetworkMap, ResolveError, RouteText};
use crate::scan::{ScanCost, ScanError, ScanOptions, ScanPhase, ScanProgress};
use crate::session::Session;
use osap_runtime::sequenced::Destination;
use serde::Serialize;

/// A network that was scanned.
pub struct Scanned<'a> {
    /// What carries questions.
    pub session: Session,
    /// What was found.
    pub map: NetworkMap,
    /// What finding it took.
    pub cost: ScanCost,
    links: &'a LinkArgs,
}

/// Which device, in a document.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceId {
    /// What it is called.
    pub name: String,
    /// Which one, from its silicon.
    pub unique_id: String,
    /// The way to it.
    pub route: RouteText,
}

impl From<&Device> for DeviceId {
    fn from(device: &Device) -> Self {
        Self { name: device.name.clone(), unique_id: device.unique_id.to_string(), route: device.route().clone() }
    }
}

impl<'a> Scanned<'a> {
    /// Opens the links and finds what is there.
    ///
    /// # Errors
    /// Where no link opens or the host itself cannot go on. That a device is silent is no error: the map says it.
    pub fn open(links: &'a LinkArgs, output: &mut Output<'_>) -> Result<Self, CliError> {
        let progress = Progress::spinner(output, "opening links");
        let mut session = links.open(output)?;
        let (map, cost) = scan(&mut session, links, &progress)?;
        Ok(Self { session, map, cost, links })
    }

    /// Finds what is there now.
    ///
    /// # Errors
    /// As [`Scanned::open`].
    pub fn again(&mut self) -> Result<(), CliError> {
        (self.map, self.cost) = scan(&mut self.session, self.links, &Progress::none())?;
        Ok(())
    }

    /// The device that `text` means, for `osap COMMAND`.
    ///
    /// # Errors
    /// Where there is none or several.
    pub fn device(&self, text: &str, command: &str) -> Result<&Device, CliError> {
        self.map.resolve(text).map_err(|error| self.not_resolved(&error, command))
    }

    /// The device that `text` means, and the way to it: the one that was named where it is a route, be it through a loop.
    ///
    /// # Errors
    /// As [`Scanned::device`].
    pub fn target(&self, text: &str, command: &str) -> Result<(Device, Destination), CliError> {
        let device = self.device(text, command)?.clone();
        let to = self.session.destination_of(&device);
        let Ok(route) = text.parse::<RouteText>() else { return Ok((device, to)) };
        if route == *device.route() {
            return Ok((device, to));
        }
        let mtu_bytes = packet_bytes_along(&self.map, &route).unwrap_or(to.mtu_bytes);
        Ok((device, Destination { mtu_bytes, ..self.session.destination(&route) }))
    }

    /// The end of a command: `exit`, unless the capture that was asked for is not whole.
    ///
    /// # Errors
    /// Where the capture ended early.
    pub fn finish(&mut self, exit: Exit) -> Result<Exit, CliError> {
        match self.session.network().capture_fault() {
            None => Ok(exit),
            Some(fault) => {
                let next = "make room for the file, or choose another one for --capture, then run the command again";
                Err(CliError::new(Exit::Io, format!("the capture is not whole: {fault}"), self.links.place(), next))
            }
        }
    }

    /// A command line that shows why devices drop packets.
    #[must_use]
    pub fn counters_hint(&self) -> String {
        self.links.command("counters --all --nonzero")
    }

    /// What kept a device from answering.
    #[must_use]
    pub fn failed(&self, error: &AskError) -> CliError {
        let scan = self.links.command("scan");
        let there = |place: &Place| format!("{} over {}", place.route, self.links.place());
        let name = |place: &Place| printable(&place.name.clone().unwrap_or_else(|| "a device".to_owned()));
        let told = printable(&error.to_string());
        let (exit, what, place, next) = match error {
            AskError::Timeout { place, what, tries, waited_us } => (
                Exit::NoAnswer,
                format!("{} did not answer {what}: {tries} tries of {waited_us} µs each", name(place)),
                there(place),
                format!("check that it is powered and plugged in; `{scan}` shows what can be reached"),
            ),
            AskError::Refused { place, what, refusal } => (
                Exit::Refused,
                format!("{} refused {what}: {refusal}", name(place)),
                there(place),
                format!("`{}` shows what it has", self.links.command(&format!("info {}", place.route))),
            ),
            AskError::Network(error) => return self.links.stopped(error),
            AskError::TooSlow { place, .. } | AskError::Send { place, .. } | AskError::Message { place, .. } => {
                (Exit::NoAnswer, told, there(place), format!("`{scan}` shows what can be reached now"))
            }
            AskError::MessageRefused { place, .. } | AskError::MotionRefused { place, .. } => {
                (Exit::Refused, told, there(place), format!("`{}` shows why", self.counters_hint()))
            }
            AskError::Malformed { place, .. } => (
                Exit::NoAnswer,
                told,
                there(place),
                "update its firmware or this program, whichever is older".to_owned(),
            ),
        };
        CliError::new(exit, what, place, next)
    }

    fn not_resolved(&self, error: &ResolveError, command: &str) -> CliError {
        let scan = format!("`{}` lists all there are", self.links.command("scan"));
        let found = {
            let devices = count(self.map.devices.len(), "device", "devices");
            format!("{}, where a scan found {devices}", self.links.place())
        };
        match error {
            ResolveError::NotFound { text, near } => {
                let what = format!("no device is called {text:?}, and no unique id begins so");
                let next = match near.first() {
                    Some(name) => {
                        let meant = self.links.command(&format!("{command} {}", quoted(name)));
                        format!("did you mean `{}`? {scan}", printable(&meant))
                    }
                    None => scan,
                };
                CliError::new(Exit::DeviceNotFound, what, found, next)
            }
            ResolveError::Ambiguous { text, candidates } => {
                let one = |device: &crate::map::Candidate| {
                    format!("{} ({}, id {})", device.route, printable(&device.name), device.unique_id)
                };
                let places = candidates.iter().map(one).collect::<Vec<_>>().join("; ");
                let what = format!("{text:?} may mean any of {} devices", candidates.len());
                let route = candidates.first().map_or_else(RouteText::host, |device| device.route.clone());
                let next = format!("say which by its route: `{}`", self.links.command(&format!("{command} {route}")));
                CliError::new(Exit::DeviceAmbiguous, what, places, next)
            }
            ResolveError::Route(error) => CliError::new(Exit::Usage, error.to_string(), found, scan),
            ResolveError::NothingThere { route } => {
                CliError::new(Exit::DeviceNotFound, format!("no device is at {route}"), found, scan)
            }
        }
    }
}

fn scan(session: &mut Session, links: &LinkArgs, progress: &Progress) -> Result<(NetworkMap, ScanCost), CliError> {
    let mut tell = |now: ScanProgress| {
        let phase = match now.phase {
            ScanPhase::Visiting => "asking who is there",
            ScanPhase::Reading => "reading what they say",
            ScanPhase::Closing => "looking whether all are still there",
        };
        let ScanProgress { depth, done, of, devices, .. } = now;
        progress.tell(format!("{}; {phase}, {depth} steps away: {done} of {of}", count(devices, "device", "devices")));
    };
    match session.scan(&ScanOptions::default(), &mut tell) {
        Ok(report) => Ok((report.map, report.cost)),
        Err(ScanError::Network(error)) => Err(links.stopped(&error)),
        Err(error @ ScanError::HostSilent) => {
            Err(CliError::new(Exit::NoAnswer, error.to_string(), links.place(), "report it with this command line"))
        }
    }
}

/// The smallest packet of both ends of all links along `route`; `None` where the map does not know them.
fn packet_bytes_along(map: &NetworkMap, route: &RouteText) -> Option<u16> {
    let (_, gateways) = map.follow(route)?;
    let far = |gateway: &Gateway| match gateway.leads_to {
        Some(LeadsTo::Device { device, gateway }) => {
            let ends = &map.devices.get(device)?.gateways;
            ends.iter().find(|end| Some(end.index) == gateway).map(|end| end.mtu_bytes)
        }
        _ => None,
    };
    gateways.into_iter().flat_map(|gateway| [Some(gateway.mtu_bytes), far(gateway)]).flatten().min()
}

/// The map as text can show it: names from devices cannot move a terminal's cursor or break a line.
#[must_use]
pub fn shown(map: &NetworkMap) -> NetworkMap {
    let mut shown = map.clone();
    for device in &mut shown.devices {
        device.name = printable(&device.name);
        device.type_name = printable(&device.type_name);
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::discovery::Refusal;

    fn with_scanned(check: impl FnOnce(&Scanned<'_>)) {
        let links = LinkArgs::simulated("sim:line:1".parse().unwrap(), None);
        let (mut out, mut talk) = (Vec::new(), Vec::new());
        let scanned = Scanned::open(&links, &mut Output::new(&mut out, &mut talk, false, false));
        check(&scanned.unwrap_or_else(|error| panic!("{error}")));
    }

    /// What cannot be brought about from a command line, since the options are checked before anything is sent.
    #[test]
    fn what_a_device_refuses_and_what_it_leaves_unanswered_have_their_codes() {
        with_scanned(|scanned| {
            let route: RouteText = "/0".parse().unwrap();
            let place = || Place { name: Some("\u{1b}[2Jhub".to_owned()), route: route.clone() };
            let refused = AskError::Refused { place: place(), what: "set runtime name", refusal: Refusal::Range };
            let silent = AskError::Timeout { place: place(), what: "counters", tries: 4, waited_us: 50_000 };
            for (error, exit, next) in [
                (refused, Exit::Refused, "`osap info /0 --link sim:line:1`"),
                (silent, Exit::NoAnswer, "`osap scan --link sim:line:1`"),
            ] {
                let failed = scanned.failed(&error);
                let text = failed.to_string();
                assert_eq!(failed.exit(), exit);
                assert!(text.contains(next) && text.contains("/0 over sim:line:1"), "{text}");
                assert!(!text.contains("\u{1b}[2J"), "a device's name reached the terminal as it was: {text:?}");
            }
        });
    }

    #[test]
    fn names_in_a_shown_map_cannot_break_its_lines() {
        with_scanned(|scanned| {
            let mut map = scanned.map.clone();
            map.devices[1].name = "a\nb".to_owned();
            assert_eq!(shown(&map).tree().lines().count(), 2);
        });
    }
}
