//! Which links a command talks over, and what they are run with: the options that all commands share.
//!
//! - **Walk:** [`LinkArgs`] → specifications (from the command line, else from `OSAP_LINK`, else USB) → an open [`Session`].
//! - **Invariants:** a session that is given back has at least one open link. A hint repeats the options that were given, so that it can
//!   be copied as it stands.
//! - **Clauses:** `[LNK-04]` to `[LNK-07]`.

use super::{CliError, Exit, Output, key};
use crate::core::EventKind;
use crate::error::{NetworkError, OpenError};
use crate::link::{Key, LinkError, LinkOptions, LinkSpec, found};
use crate::network::NetworkSpec;
use crate::session::{OpenOptions, Session};
use clap::Args;
use fixed_math::time::Span;
use osap_sim::faults::FaultConfig;
use std::path::{Path, PathBuf};

/// Environment variable that stands in for `--link`; several are separated by a semicolon.
pub const LINK_VARIABLE: &str = "OSAP_LINK";
/// Time that links get to open and neighbours to announce themselves. It passes whole only where somebody stays silent.
const SETTLE: Span = Span::from_us(1_500_000);

/// Options for links.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Links")]
pub struct LinkArgs {
    #[arg(
        long = "link",
        value_name = "SPEC",
        help = "Link to use, given again for more: serial, serial:/dev/ttyACM0, tcp:127.0.0.1:4100, udp:127.0.0.1:4100, or a \
                machine simulated in virtual time: sim:printer. Default: those in OSAP_LINK, with ; between them, else every \
                USB serial device of a known kind"
    )]
    links: Vec<NetworkSpec>,
    /// Faults on every link, to try them out: loss=0.01,delay=200us,seed=7; also dup, reorder, jitter, ber, bandwidth
    #[arg(long, value_name = "FAULTS")]
    fault: Option<FaultConfig>,
    /// Key file of links beyond this machine, as made by `osap key generate`
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Offers the host's own time as the network's, by this priority: lower goes before higher, devices have 128. Without it the
    /// host only follows
    #[arg(
        long, value_name = "PRIORITY", num_args = 0..=1, require_equals = true, default_missing_value = "0",
        value_parser = clap::value_parser!(u8).range(0..=254)
    )]
    root: Option<u8>,
    /// File to write every packet to, for Wireshark (pcapng)
    #[arg(long, value_name = "FILE")]
    capture: Option<PathBuf>,
}

impl LinkArgs {
    /// Options for one simulated machine in virtual time.
    pub(super) fn simulated(spec: NetworkSpec, capture: Option<PathBuf>) -> Self {
        Self { links: vec![spec], capture, ..Self::default() }
    }

    /// A command line with these links, for a hint.
    #[must_use]
    pub fn command(&self, command: &str) -> String {
        let links = self.links.iter().map(|link| format!(" --link {}", quoted(&link.to_string())));
        let key = self.key.iter().map(|file| format!(" --key {}", quoted(&file.display().to_string())));
        let root = self.root.iter().map(|priority| format!(" --root={priority}"));
        format!("osap {command}{}", links.chain(key).chain(root).collect::<String>())
    }

    /// The links, for the `where` of an error.
    #[must_use]
    pub fn place(&self) -> String {
        let given = self.specs().unwrap_or_default();
        if given.is_empty() {
            return "USB serial devices of this computer".to_owned();
        }
        given.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }

    /// Opens the links and waits until they have neighbours.
    ///
    /// # Errors
    /// Where there is none, none opens, or the options do not go together.
    pub fn open(&self, output: &mut Output<'_>) -> Result<Session, CliError> {
        let specs = self.expanded()?;
        let faults = self.fault;
        let key = self.key.as_deref().map(|file| load_key(file, output)).transpose()?;
        let options = OpenOptions {
            link: LinkOptions { key, faults, ..LinkOptions::default() },
            capture: self.capture.clone(),
            root: self.root,
            ..OpenOptions::default()
        };
        let mut session = Session::open(&specs, &options).map_err(|error| self.open_failed(&error))?;
        session.network().settle(SETTLE).map_err(|error| self.stopped(&error))?;
        self.check_open(&mut session)?;
        Ok(session)
    }

    /// The links as given: on the command line, else in the environment.
    fn specs(&self) -> Result<Vec<NetworkSpec>, CliError> {
        let variable = std::env::var(LINK_VARIABLE).unwrap_or_default();
        if !self.links.is_empty() || variable.is_empty() {
            return Ok(self.links.clone());
        }
        let parse = |text: &str| {
            let next = format!("mend {LINK_VARIABLE}, or name a link with `--link`");
            text.parse::<NetworkSpec>().map_err(|error| {
                CliError::new(Exit::Usage, error.to_string(), format!("the variable {LINK_VARIABLE}"), next)
            })
        };
        variable.split(';').map(parse).collect()
    }

    /// The links to open, with each serial device there is now as one of its own, `[LNK-06]`.
    fn expanded(&self) -> Result<Vec<NetworkSpec>, CliError> {
        let given = self.specs()?;
        if given.is_empty() {
            let Ok(any) = "serial".parse::<LinkSpec>() else { return Err(nothing_plugged()) };
            // What comes back unchanged stands for a device that is not there.
            let plugged: Vec<_> = found(&any).into_iter().filter(|spec| *spec != any).map(NetworkSpec::Link).collect();
            return if plugged.is_empty() { Err(nothing_plugged()) } else { Ok(plugged) };
        }
        let each = |spec| match spec {
            NetworkSpec::Link(link) => found(&link).into_iter().map(NetworkSpec::Link).collect(),
            NetworkSpec::Sim(_) => vec![spec],
        };
        Ok(given.into_iter().flat_map(each).collect())
    }

    /// Fails where all links are closed, with the reason that each gave last.
    fn check_open(&self, session: &mut Session) -> Result<(), CliError> {
        let local = session.network().local().map_err(|error| self.stopped(&error))?;
        if local.links.is_empty() || local.links.iter().any(|link| link.open) {
            return Ok(());
        }
        let mut reasons: Vec<String> =
            local.link_names.iter().map(|name| format!("{name} did not open in time")).collect();
        for event in session.network().events().map_err(|error| self.stopped(&error))? {
            let index = usize::from(event.gateway.get());
            if let (EventKind::Down(reason), Some(known)) = (event.kind, reasons.get_mut(index)) {
                *known = format!("{}: {reason}", local.link_names[index]);
            }
        }
        let next = match &self.key {
            Some(key) => format!("check that the other end runs, and that it has the key in {} too", key.display()),
            None => {
                "check that the device is powered and plugged in, or that its simulator runs; `osap demo` needs neither"
                    .to_owned()
            }
        };
        Err(CliError::new(Exit::NoLink, "no link could be opened", reasons.join("; "), next))
    }

    /// What failed about opening, with a next step.
    fn open_failed(&self, error: &OpenError) -> CliError {
        let usage = "see `osap scan --help` for what a link can be";
        let (exit, next) = match error {
            OpenError::NoLink => return nothing_plugged(),
            OpenError::Link { source, .. } => link_next(source),
            OpenError::Capture { .. } => (Exit::Io, "choose another file for --capture".to_owned()),
            OpenError::Thread(_) => (Exit::Io, "end other programs and try again".to_owned()),
            OpenError::TooManyLinks { .. } | OpenError::SimulationNotAlone { .. } | OpenError::Option { .. } => {
                (Exit::Usage, usage.to_owned())
            }
        };
        CliError::new(exit, error.to_string(), self.place(), next)
    }

    /// The host's own node has ended.
    pub(super) fn stopped(&self, error: &NetworkError) -> CliError {
        CliError::new(Exit::Io, error.to_string(), self.place(), "run the command again")
    }
}

/// What to do where UDP is wanted beyond this computer, or with a key.
const UDP_NEXT: &str = "UDP stays on this computer; use tcp with `--key FILE`";

/// What to do about a link that does not start.
pub(super) fn link_next(error: &LinkError) -> (Exit, String) {
    let (exit, next) = match error {
        LinkError::KeyNeeded { .. } => {
            (Exit::KeyNeeded, "make a key with `osap key generate machine.key` and give both ends `--key machine.key`")
        }
        // One advice for both: to make a key and to leave it out again would lead in a circle.
        LinkError::UdpBeyondLoopback { .. } => (Exit::KeyNeeded, UDP_NEXT),
        LinkError::KeyUnused { .. } => (Exit::Usage, UDP_NEXT),
        LinkError::ListenOnly { .. }
        | LinkError::OpenOnly { .. }
        | LinkError::CheckUnused { .. }
        | LinkError::Mtu { .. } => (Exit::Usage, "see `osap scan --help` for what a link can be"),
        LinkError::Resolve { .. } => (Exit::NoLink, "check the name, or give the address in digits"),
        LinkError::Bind { .. } => (Exit::NoLink, "choose another port; port 0 lets the system choose"),
        LinkError::Pty { .. } | LinkError::Thread { .. } => (Exit::NoLink, "end other programs and try again"),
    };
    (exit, next.to_owned())
}

/// A key from a file; what should be done about the file is talk.
pub(super) fn load_key(file: &Path, output: &mut Output<'_>) -> Result<Key, CliError> {
    let loaded = Key::load(file).map_err(|error| key::failed(file, &error))?;
    if let Some(warning) = loaded.warning {
        output.say(format!("warning: {warning}"));
    }
    Ok(loaded.key)
}

fn nothing_plugged() -> CliError {
    let what = "no link was given, and no USB serial device of a known kind is plugged in";
    let next = "plug one in, or name a link: `osap scan --link serial:/dev/ttyUSB0@3000000`; \
                without hardware, `osap scan --link sim:printer`";
    CliError::new(Exit::NoLink, what, "USB serial devices of this computer", next)
}

/// `word` as a shell takes it for one word.
#[must_use]
pub fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_./:@=,+".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        links: LinkArgs,
    }

    #[test]
    fn a_hint_repeats_what_was_given() {
        let line = ["osap", "--link", "sim:printer", "--link", "serial:/dev/my port", "--key", "it's"];
        let links = Line::try_parse_from(line).unwrap_or_else(|error| panic!("{error}")).links;
        assert_eq!(links.command("scan"), r"osap scan --link sim:printer --link 'serial:/dev/my port' --key 'it'\''s'");
    }

    #[test]
    fn what_is_listened_on_without_a_key_says_how_to_make_one() {
        let (exit, next) = link_next(&LinkError::KeyNeeded { address: ([10, 0, 0, 1], 4100).into() });
        assert_eq!(exit, Exit::KeyNeeded);
        assert!(next.contains("`osap key generate"));
    }

    #[test]
    fn advice_about_udp_does_not_lead_in_a_circle() {
        let beyond = link_next(&LinkError::UdpBeyondLoopback { address: ([10, 0, 0, 1], 4100).into() });
        let unused = link_next(&LinkError::KeyUnused { spec: "udp:10.0.0.1:4100".to_owned() });
        assert_eq!((beyond.1.as_str(), unused.1.as_str()), (UDP_NEXT, UDP_NEXT));
    }
}
