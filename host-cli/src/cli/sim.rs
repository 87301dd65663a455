//! `osap sim MACHINE --listen …`: offers a simulated machine in real time, as hardware would be offered.
//!
//! - **Walk:** a machine with a `bridge` in the workstation's place → one listening link for each of its links to the workstation → `offer` lets
//!   real time pass in the world and carries packets between the two.
//! - **Invariant:** what is offered is the machine that `--link sim:` scans in virtual time, with the same seed.

mod bridge;
mod machine;
mod offer;

use super::links::{link_next, load_key, quoted};
use super::wait::{Until, parse_seconds};
use super::{CliError, Exit, Output};
use crate::link::{LinkError, LinkOptions, LinkSpec, Target};
use crate::network::{SimSpec, SimSpecError};
use clap::Args;
use machine::Machine;
use offer::Offer;
use osap_protocol::framing::Check;
use osap_sim::faults::FaultConfig;
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Offers a simulated machine in real time, on TCP ports or pseudo-terminals
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap sim printer --listen tcp:127.0.0.1:4100\n  osap sim printer --listen pty --for 60\n  \
                        osap sim ring:6 --listen tcp:127.0.0.1:0 --fault loss=0.01,seed=7"
)]
pub struct SimArgs {
    /// Machine: printer, line:N, ring:N, bus:N, random:N or random:N:EXTRA
    #[arg(value_name = "MACHINE", value_parser = parse_machine)]
    machine: SimSpec,
    /// Where: tcp:HOST:PORT or udp:HOST:PORT, one port after the other for each link to the workstation (port 0: any
    /// free ones), or pty
    #[arg(long, value_name = "SPEC")]
    listen: LinkSpec,
    /// Seed of all that is drawn at random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Faults on every listening link: loss=0.01,delay=200us,seed=7; also dup, reorder, jitter, ber, bandwidth
    #[arg(long, value_name = "FAULTS")]
    fault: Option<FaultConfig>,
    /// Key file; needed to listen beyond this computer
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// File to write every packet of the machine's own links to, for Wireshark (pcapng)
    #[arg(long, value_name = "FILE")]
    capture: Option<PathBuf>,
    /// Ends after so many seconds; else at Ctrl-C
    #[arg(long = "for", value_name = "SECONDS", value_parser = parse_seconds)]
    run_for: Option<Duration>,
}

#[derive(Serialize)]
struct Document<'a> {
    machine: String,
    seed: u64,
    endpoints: &'a [Endpoint],
    /// Scans what is offered.
    command: &'a str,
}

/// One listening link.
#[derive(Serialize)]
struct Endpoint {
    leads_to: String,
    link: String,
}

fn parse_machine(text: &str) -> Result<SimSpec, SimSpecError> {
    if text.starts_with("sim:") { text.parse() } else { format!("sim:{text}").parse() }
}

pub(super) fn run(args: &SimArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let key = args.key.as_deref().map(|file| load_key(file, output)).transpose()?;
    let options = LinkOptions { key, faults: args.fault, ..LinkOptions::default() };
    let seed = args.machine.seed.unwrap_or(args.seed);
    let mut machine = Machine::build(args.machine.kind, seed, boot_epoch());
    if let Some(file) = &args.capture {
        machine.capture(file)?;
    }
    let specs = specs(&args.listen, machine.links.len())?;
    let names: Vec<String> = machine.links.iter().map(|link| link.leads_to.clone()).collect();
    let until = Until::new(args.run_for);
    let mut offer = Offer::open(machine, &specs, &options).map_err(|error| listen_failed(args, &error))?;
    let with_link = |(leads_to, link)| Endpoint { leads_to, link };
    let endpoints: Vec<Endpoint> =
        names.into_iter().zip(dialled(&args.listen, &offer.names())).map(with_link).collect();
    announce(args, seed, &endpoints, output)?;
    offer.run(&until, output);
    offer.sum_up(output);
    Ok(Exit::Ok)
}

/// Another number with each start of this program, as hardware counts its boots: milliseconds, since scripts start it again within
/// a second. Of a clock before 1970 nothing is known, and 1 will do.
fn boot_epoch() -> u32 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).map_or(1, |since| since.as_millis());
    #[expect(clippy::cast_possible_truncation, reason = "any 32 bits do that differ from start to start")]
    let epoch = since as u32;
    epoch
}

/// Tells where the machine can be found. Flushed at once: whoever started us waits for it.
fn announce(args: &SimArgs, seed: u64, endpoints: &[Endpoint], output: &mut Output<'_>) -> Result<(), CliError> {
    let links = endpoints.iter().map(|endpoint| format!(" --link {}", quoted(&endpoint.link)));
    let key = args.key.iter().map(|file| format!(" --key {}", quoted(&file.display().to_string())));
    let command = format!("osap scan{}", links.chain(key).collect::<String>());
    if output.json() {
        let machine = SimSpec { seed: None, ..args.machine.clone() }.to_string();
        return output.document("sim", &Document { machine, seed, endpoints, command: &command });
    }
    let width = endpoints.iter().map(|endpoint| endpoint.leads_to.chars().count()).max().unwrap_or(0);
    for Endpoint { leads_to, link } in endpoints {
        output.line(format!("{leads_to:<width$}  {link}"))?;
    }
    output.line(command)?;
    output.flush()?;
    output.say("Ctrl-C ends it.");
    Ok(())
}

/// What each of `count` links listens on.
fn specs(listen: &LinkSpec, count: usize) -> Result<Vec<LinkSpec>, CliError> {
    let nth = |number: usize| {
        let mut spec = listen.clone();
        if let Target::Tcp { port, .. } | Target::Udp { port, .. } = &mut spec.target
            && *port != 0
        {
            *port = u16::try_from(usize::from(*port) + number).ok()?;
        }
        Some(spec)
    };
    (0..count).map(nth).collect::<Option<_>>().ok_or_else(|| {
        let what = format!("the machine has {count} links, and ports end at 65535");
        CliError::new(Exit::Usage, what, listen.to_string(), "choose a lower port, or 0 to let the system choose")
    })
}

/// What the other side opens to reach what we listen on.
fn dialled(listen: &LinkSpec, names: &[String]) -> Vec<String> {
    let check = match listen.check {
        None => "",
        Some(Check::None) => ",check=none",
        Some(Check::Crc16) => ",check=crc16",
        Some(Check::Crc32) => ",check=crc32",
    };
    let one = |name: &String| match name.strip_prefix("pty:") {
        Some(device) => format!("serial:{device}{check}"),
        // Whoever listens on all addresses is found on this computer's own.
        None => format!("{}{check}", name.replace(":0.0.0.0:", ":127.0.0.1:").replace(":[::]:", ":[::1]:")),
    };
    names.iter().map(one).collect()
}

fn listen_failed(args: &SimArgs, error: &LinkError) -> CliError {
    let (exit, next) = match error {
        LinkError::OpenOnly { .. } => (Exit::Usage, "listen on `pty` to offer a serial port".to_owned()),
        other => link_next(other),
    };
    CliError::new(exit, error.to_string(), format!("--listen {}", args.listen), next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_follow_on_and_end_where_ports_do() {
        let shown = |listen: &str, count| {
            let specs = specs(&listen.parse().unwrap(), count)?;
            Ok::<_, CliError>(specs.iter().map(ToString::to_string).collect::<Vec<_>>())
        };
        assert_eq!(shown("tcp:127.0.0.1:4100", 2).unwrap(), ["tcp:127.0.0.1:4100", "tcp:127.0.0.1:4101"]);
        assert_eq!(shown("tcp:[::1]:0", 2).unwrap(), ["tcp:[::1]:0", "tcp:[::1]:0"]);
        assert_eq!(shown("pty,check=crc32", 1).unwrap(), ["pty,check=crc32"]);
        assert_eq!(shown("tcp:127.0.0.1:65535", 2).unwrap_err().exit(), Exit::Usage);
    }

    #[test]
    fn what_is_printed_can_be_opened() {
        let listen: LinkSpec = "pty,check=crc32".parse().unwrap();
        let dialled = dialled(&listen, &["pty:/dev/pts/3".to_owned()]);
        assert_eq!(dialled, ["serial:/dev/pts/3,check=crc32"]);
        assert!(dialled[0].parse::<LinkSpec>().is_ok());
        let listen: LinkSpec = "tcp:0.0.0.0:4100".parse().unwrap();
        assert_eq!(super::dialled(&listen, &[listen.to_string()]), ["tcp:127.0.0.1:4100"]);
    }
}
