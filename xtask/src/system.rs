//! Packages of the operating system: installed where this is Debian and we are root, else asked of the person.

use crate::run::Program;

/// A machine that has just started may be installing its own updates: wait for those, s.
const LOCK_WAIT: [&str; 2] = ["-o", "DPkg::Lock::Timeout=300"];

/// Installs Debian packages, where this is Debian and we are root; else says what to do.
pub(crate) fn install(packages: &[&str]) -> Result<(), String> {
    let list = packages.join(" ");
    let by_hand = format!("install `{list}` with your system's package manager and run this again");
    if Program::new("apt-get").args(["--version"]).ask().is_none() {
        return Err(format!("`{list}` is missing and there is no apt-get to install it; {by_hand}"));
    }
    if Program::new("id").args(["-u"]).ask().as_deref() != Some("0") {
        return Err(format!("`{list}` is missing and only root may install it; run `sudo apt-get install {list}`"));
    }
    let apt = |arguments: &[&str]| {
        let program = Program::new("apt-get").args(LOCK_WAIT).args(arguments).env("DEBIAN_FRONTEND", "noninteractive");
        program.run().map_err(|error| format!("{error}; {by_hand}"))
    };
    let install = ["install", "--yes", "--quiet", "--no-install-recommends"];
    apt(&["update", "--quiet"])?;
    let plain = apt(&[&install[..], packages].concat());
    let Some(release) = release() else { return plain };
    // A machine that has a part of the emulator from the backports keeps the release's own emulator out, until that part
    // may go back to the release's version too.
    let qemu_tools = format!("qemu-utils/{release}");
    let is_emulator = packages.iter().any(|package| package.starts_with("qemu-system"));
    match plain {
        Err(_) if is_emulator => apt(&[&install[..], &["--allow-downgrades"], packages, &[&qemu_tools]].concat()),
        other => other,
    }
}

/// The name of this release of Debian: `bookworm`.
fn release() -> Option<String> {
    release_in(&std::fs::read_to_string("/etc/os-release").ok()?)
}

fn release_in(os_release: &str) -> Option<String> {
    let name = os_release.lines().find_map(|line| line.strip_prefix("VERSION_CODENAME="))?;
    Some(name.trim_matches('"').to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_releases_name_is_read_with_and_without_quotes() {
        assert_eq!(release_in("ID=debian\nVERSION_CODENAME=bookworm\n").as_deref(), Some("bookworm"));
        assert_eq!(release_in("VERSION_CODENAME=\"noble\"\n").as_deref(), Some("noble"));
        assert_eq!(release_in("ID=debian\n"), None);
    }
}
