//! A map as a tree of text, for terminals.
//!
//! ```text
//! host  osap-host  686f…0007
//! └─0─ hub  fabric-hub  01a2…b3c4
//!    ├─1─ axis-x  servo  02a2…b3c4
//!    │  └═2═ axis-y (/0/2)
//!    ├─2─ axis-y  servo  03a2…b3c4
//!    └─3─ silent, expected 04a2…b3c4
//! ```
//!
//! Single lines are first routes; a double line closes a loop or is a further way to a device shown elsewhere.
//!
//! - **Invariant:** each device stands once; the order is that of gateways and drops.

use super::{LeadsTo, NetworkMap, RouteText, short_id, step_text};
use osap_protocol::Step;
use std::collections::BTreeMap;
use std::fmt::Write;

/// What hangs below a device.
enum Branch {
    Device(usize),
    Also { device: usize },
    Silent { expected: String },
}

impl NetworkMap {
    /// The map as lines of text.
    #[must_use]
    pub fn tree(&self) -> String {
        let mut below: Vec<Vec<(String, Branch)>> = self.devices.iter().map(|_| Vec::new()).collect();
        let first: BTreeMap<&RouteText, usize> =
            self.devices.iter().enumerate().map(|(index, device)| (device.route(), index)).collect();
        for (parent, device) in self.devices.iter().enumerate() {
            for (step, child) in self.exits(parent) {
                let label = step_text(step).trim_start_matches('/').to_owned();
                let on_first_route = device.route().to_buf().with(step).ok().map(RouteText::from);
                let branch = match child {
                    Exit::Silent(place) => {
                        let expected = self.silent[place].neighbour.map_or_else(String::new, short_id);
                        Branch::Silent { expected }
                    }
                    Exit::Device(child)
                        if on_first_route.as_ref().and_then(|route| first.get(route)) == Some(&child) =>
                    {
                        Branch::Device(child)
                    }
                    Exit::Device(child) if self.is_way_back(parent, child, step) => continue,
                    Exit::Device(device) => Branch::Also { device },
                };
                below[parent].push((label, branch));
            }
        }
        let mut text = String::new();
        self.line(&mut text, 0);
        self.branches(&mut text, &below, 0, "");
        text
    }

    fn branches(&self, text: &mut String, below: &[Vec<(String, Branch)>], parent: usize, indent: &str) {
        let last = below[parent].len().saturating_sub(1);
        for (number, (label, branch)) in below[parent].iter().enumerate() {
            let (corner, further) = if number == last { ('└', "   ") } else { ('├', "│  ") };
            // writing into a string cannot fail
            match branch {
                Branch::Device(device) => {
                    let _ = write!(text, "{indent}{corner}─{label}─ ");
                    self.line(text, *device);
                    self.branches(text, below, *device, &format!("{indent}{further}"));
                }
                Branch::Also { device } => {
                    let device = &self.devices[*device];
                    let _ = writeln!(text, "{indent}{corner}═{label}═ {} ({})", device.label(), device.route());
                }
                Branch::Silent { expected } if expected.is_empty() => {
                    let _ = writeln!(text, "{indent}{corner}─{label}─ silent");
                }
                Branch::Silent { expected } => {
                    let _ = writeln!(text, "{indent}{corner}─{label}─ silent, expected {expected}");
                }
            }
        }
    }

    fn line(&self, text: &mut String, device: usize) {
        let device = &self.devices[device];
        let _ = writeln!(text, "{}  {}  {}", device.label(), device.type_name, short_id(device.unique_id));
    }

    /// Steps that lead out of a device, in order, and where to.
    fn exits(&self, device: usize) -> Vec<(Step, Exit)> {
        let mut exits = Vec::new();
        for gateway in &self.devices[device].gateways {
            let Some(index) = osap_protocol::GatewayIndex::new(gateway.index) else { continue };
            match gateway.leads_to {
                Some(LeadsTo::Device { device, .. }) => exits.push((Step::Link(index), Exit::Device(device))),
                Some(LeadsTo::Silent { silent }) => exits.push((Step::Link(index), Exit::Silent(silent))),
                Some(LeadsTo::Bus { bus }) => {
                    for member in self.buses[bus].members.iter().filter(|member| member.device != device) {
                        let drop = osap_protocol::BusDrop(member.drop);
                        exits.push((Step::Bus { gateway: index, drop }, Exit::Device(member.device)));
                    }
                }
                None => {}
            }
        }
        exits.extend(self.exits_unread(device));
        exits.sort_by_key(|(step, _)| step.gateway());
        exits
    }

    /// The same by gateways that the device did not tell of: links and buses know where they end.
    fn exits_unread(&self, device: usize) -> Vec<(Step, Exit)> {
        let unread = |end: usize, gateway: Option<u8>| {
            let index = gateway.filter(|_| end == device).and_then(osap_protocol::GatewayIndex::new)?;
            let is_told = self.devices[device].gateways.iter().any(|gateway| gateway.index == index.get());
            (!is_told).then_some(index)
        };
        let mut exits = Vec::new();
        for link in &self.links {
            for (here, there) in [(link.near, link.far), (link.far, link.near)] {
                let index = unread(here.device, here.gateway);
                exits.extend(index.map(|index| (Step::Link(index), Exit::Device(there.device))));
            }
        }
        for bus in &self.buses {
            let Some(gateway) = bus.members.iter().find_map(|it| unread(it.device, it.gateway)) else { continue };
            for member in bus.members.iter().filter(|member| member.device != device) {
                let drop = osap_protocol::BusDrop(member.drop);
                exits.push((Step::Bus { gateway, drop }, Exit::Device(member.device)));
            }
        }
        exits
    }

    /// Whether a step from `device` only goes back over what its first route, or that of another on its bus, came by; or was
    /// already shown from the other side.
    fn is_way_back(&self, device: usize, to: usize, step: Step) -> bool {
        match step {
            // a bus is shown from where it was found first
            Step::Bus { .. } => true,
            Step::Link(gateway) => self.links.iter().any(|link| {
                link.far.device == device && link.far.gateway == Some(gateway.get()) && link.near.device == to
            }),
        }
    }
}

enum Exit {
    Device(usize),
    Silent(usize),
}
