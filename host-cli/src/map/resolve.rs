//! Which device somebody means: by name, by the head of its unique id, or by route.
//!
//! - **Walk:** command lines → [`NetworkMap::resolve`] → the device.
//! - **Invariant:** one device or an error that lists what could have been meant; never the first of several.

use super::{Device, NetworkMap, RouteText, RouteTextError};
use osap_protocol::discovery::UniqueId;
use std::fmt::{self, Display, Formatter};

/// A device that could have been meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// Its name.
    pub name: String,
    /// Its id.
    pub unique_id: UniqueId,
    /// The way to it.
    pub route: RouteText,
}

impl Display for Candidate {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({} at {})", self.name, self.unique_id, self.route)
    }
}

/// Why no single device is meant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ResolveError {
    /// No name, id or route of the map.
    #[error("no device is called {text}, and no unique id begins so{}", hint(.near))]
    NotFound {
        /// As given.
        text: String,
        /// Names that differ little.
        near: Vec<String>,
    },
    /// Several.
    #[error("{text} may be {}: name one by its unique id or its route", list(.candidates))]
    Ambiguous {
        /// As given.
        text: String,
        /// All of them.
        candidates: Vec<Candidate>,
    },
    /// It begins with a slash and is no route.
    #[error(transparent)]
    Route(#[from] RouteTextError),
    /// A route that leads to no device of the map.
    #[error("the map has no device at {route}; a new scan shows what is there now")]
    NothingThere {
        /// As given.
        route: RouteText,
    },
}

fn hint(near: &[String]) -> String {
    if near.is_empty() {
        "; `osap scan` lists all".to_owned()
    } else {
        format!("; did you mean {}?", near.join(" or "))
    }
}

fn list(candidates: &[Candidate]) -> String {
    candidates.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or ")
}

impl NetworkMap {
    /// The device meant by `text`: a route where it begins with a slash, else a whole name, else the head of a unique id.
    ///
    /// # Errors
    /// [`ResolveError`].
    pub fn resolve(&self, text: &str) -> Result<&Device, ResolveError> {
        self.resolve_index(text).map(|index| &self.devices[index])
    }

    /// As [`NetworkMap::resolve`], for its place in [`NetworkMap::devices`].
    ///
    /// # Errors
    /// [`ResolveError`].
    pub fn resolve_index(&self, text: &str) -> Result<usize, ResolveError> {
        if text.starts_with('/') {
            let route: RouteText = text.parse()?;
            let known = self.devices.iter().position(|device| device.routes.iter().any(|known| known.route == route));
            return known
                .or_else(|| self.follow(&route).map(|(device, _)| device))
                .ok_or(ResolveError::NothingThere { route });
        }
        let head = text.to_ascii_lowercase();
        let by_name = self.all(|device| !text.is_empty() && device.name == text);
        let by_id = || self.all(|device| !head.is_empty() && device.unique_id.to_string().starts_with(&head));
        match &(if by_name.is_empty() { by_id() } else { by_name })[..] {
            [one] => Ok(*one),
            [] => Err(ResolveError::NotFound { text: text.to_owned(), near: self.near(text) }),
            several => Err(ResolveError::Ambiguous {
                text: text.to_owned(),
                candidates: several.iter().map(|index| self.devices[*index].candidate()).collect(),
            }),
        }
    }

    fn all(&self, is: impl Fn(&Device) -> bool) -> Vec<usize> {
        (0..self.devices.len()).filter(|index| is(&self.devices[*index])).collect()
    }

    /// Up to three names that could have been meant by a slip.
    fn near(&self, text: &str) -> Vec<String> {
        let mut names: Vec<(usize, &str)> = self
            .devices
            .iter()
            .filter(|device| !device.name.is_empty())
            .map(|device| (edits(text, &device.name), device.name.as_str()))
            .filter(|(edits, _)| *edits <= 2)
            .collect();
        names.sort_unstable();
        names.dedup();
        names.into_iter().take(3).map(|(_, name)| name.to_owned()).collect()
    }
}

impl Device {
    fn candidate(&self) -> Candidate {
        Candidate { name: self.name.clone(), unique_id: self.unique_id, route: self.route().clone() }
    }
}

/// Characters to insert, remove or replace between two texts (Levenshtein).
fn edits(one: &str, other: &str) -> usize {
    let other: Vec<char> = other.chars().collect();
    let mut row: Vec<usize> = (0..=other.len()).collect();
    for (n, a) in one.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], n + 1);
        for (m, b) in other.iter().enumerate() {
            let replaced = diagonal + usize::from(a != *b);
            diagonal = row[m + 1];
            row[m + 1] = replaced.min(row[m] + 1).min(diagonal + 1);
        }
    }
    row[other.len()]
}

#[cfg(test)]
mod tests {
    use super::edits;

    #[test]
    fn slips_are_counted() {
        for (one, other, n) in
            [("", "", 0), ("axis-x", "axis-x", 0), ("axsi-x", "axis-x", 2), ("axis", "axis-x", 2), ("", "ab", 2)]
        {
            assert_eq!((edits(one, other), edits(other, one)), (n, n), "{one} {other}");
        }
    }
}
