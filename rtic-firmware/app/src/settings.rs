//! What a device keeps over power-off: its name, how often it has started, what kind it was made, what its clock knows.
//!
//! - **Walk:** start-up → [`Settings::load`]; a renaming, or a clock that has settled → idle → [`Changes::take`] → [`Settings::keep`] → flash.
//! - **Invariants:** wear is spread over all pages of the range, and a power cut while writing loses the value being written at most: both
//!   are `sequential-storage`'s. Whatever stands in the flash, loading ends in settings that can be used.
//! - **Context:** start-up, and idle, as the lowest of all: a flash write takes milliseconds. **Clauses:** `[DSC-05]`, `[TIM-17]`.
//!
//! ```
//! use firmware_app::settings::{Settings, memory::MemoryFlash};
//!
//! let mut flash = MemoryFlash::<4>::new();
//! let mut settings = Settings::load(&mut flash, 0..MemoryFlash::<4>::BYTES).unwrap();
//! assert_eq!((settings.boots(), settings.name()), (1, ""));
//! settings.set_name("Z Motor").unwrap();
//! let settings = Settings::load(&mut flash, 0..MemoryFlash::<4>::BYTES).unwrap();
//! assert_eq!((settings.boots(), settings.name()), (2, "Z Motor"));
//! ```

use core::ops::Range;
use embedded_storage::nor_flash::NorFlash;
use embedded_storage_async::nor_flash as nor_async;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{KeptTime, Name};
use osap_runtime::Node;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

pub mod memory;

/// Names of the values in the store; each stays what it is for good.
const KEY_NAME: u8 = 1;
const KEY_BOOTS: u8 = 2;
const KEY_KIND: u8 = 3;
const KEY_TIME: u8 = 4;

/// Room for the longest item, its key and its header, in whole words of the flashes there are (32 bytes on an STM32H7).
const ITEM_BYTES: usize = 192;
const _: () = assert!(KeptTime::LEN_MAX + 2 * 32 <= ITEM_BYTES, "key, header and rounding beside the longest value");

/// Why settings could not be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingsError {
    /// The range is not made of at least two pages of this flash.
    Range,
    /// The flash refused, or what stands in it cannot be mended.
    Flash,
}

impl core::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Range => "the settings' range is not two pages or more; see the board's memory map",
            Self::Flash => "the flash refuses; settings last until power-off",
        })
    }
}

impl core::error::Error for SettingsError {}

/// A store of one device's settings.
pub struct Settings<F: NorFlash> {
    map: MapStorage<u8, Ready<F>, NoCache>,
    name: Name,
    boots: u32,
    kind: Option<u8>,
    time: Option<KeptTime>,
}

/// What a node has that is not kept yet.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// Its new name, `[DSC-05]`.
    pub name: Option<Name>,
    /// Of its clock, `[TIM-17]`.
    pub time: Option<KeptTime>,
}

impl Changes {
    /// Takes them from `node`: short, so that it may be locked for it.
    pub fn take<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>(
        node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
        now: LocalTicks,
    ) -> Self {
        let name = node.take_new_name().and_then(|name| name.try_into().ok());
        Self { name, time: node.take_time_to_keep(now) }
    }
}

/// Pages are looked through each time: settings are read at start-up only.
type NoCache = Cache<Uncached, Uncached, Uncached, u8>;

impl<F: NorFlash> Settings<F> {
    /// The settings in `range` of `flash`, after this start was counted. A range that holds none, or none that can be read, is erased
    /// and begun anew.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn load(flash: F, range: Range<u32>) -> Result<Self, SettingsError> {
        let config = MapConfig::try_new(range).map_err(|_| SettingsError::Range)?;
        let mut settings = Self {
            map: MapStorage::new(Ready(flash), config, Cache::new_uncached()),
            name: Name::new(),
            boots: 0,
            kind: None,
            time: None,
        };
        if settings.read().is_err() {
            embassy_futures::block_on(settings.map.erase_all()).map_err(|_| SettingsError::Flash)?;
        }
        let boots = settings.boots.wrapping_add(1);
        settings.boots = boots;
        settings.store(KEY_BOOTS, &boots)?;
        Ok(settings)
    }

    /// The device's name; empty where it was given none.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Which start this is, from 1 on.
    #[must_use]
    pub const fn boots(&self) -> u32 {
        self.boots
    }

    /// Index of the kind the device was made, where that was ever set.
    #[must_use]
    pub const fn kind(&self) -> Option<u8> {
        self.kind
    }

    /// Keeps a name, cut to what a name may be.
    ///
    /// # Errors
    /// [`SettingsError::Flash`].
    pub fn set_name(&mut self, name: &str) -> Result<(), SettingsError> {
        self.name.clear();
        for character in name.chars() {
            if self.name.push(character).is_err() {
                break;
            }
        }
        let mut buffer = [0; ITEM_BYTES];
        embassy_futures::block_on(self.map.store_item(&mut buffer, &KEY_NAME, &self.name.as_bytes()))
            .map_err(|_| SettingsError::Flash)
    }

    /// What the clock kept.
    #[must_use]
    pub const fn time(&self) -> Option<&KeptTime> {
        self.time.as_ref()
    }

    /// Keeps what has changed.
    ///
    /// # Errors
    /// [`SettingsError::Flash`]; what could be kept is.
    pub fn keep(&mut self, changes: &Changes) -> Result<(), SettingsError> {
        let name = changes.name.as_ref().map_or(Ok(()), |name| self.set_name(name));
        let time = changes.time.as_ref().map_or(Ok(()), |time| self.set_time(time));
        name.and(time)
    }

    /// Keeps what the clock wants kept, `[TIM-17]`.
    ///
    /// # Errors
    /// [`SettingsError::Flash`].
    pub fn set_time(&mut self, time: &KeptTime) -> Result<(), SettingsError> {
        let mut bytes = [0; KeptTime::LEN_MAX];
        let len = time.encode(&mut bytes).ok_or(SettingsError::Flash)?;
        self.time = Some(time.clone());
        let mut buffer = [0; ITEM_BYTES];
        embassy_futures::block_on(self.map.store_item(&mut buffer, &KEY_TIME, &&bytes[..len]))
            .map_err(|_| SettingsError::Flash)
    }

    /// Keeps what kind of device this is.
    ///
    /// # Errors
    /// [`SettingsError::Flash`].
    pub fn set_kind(&mut self, kind: u8) -> Result<(), SettingsError> {
        self.kind = Some(kind);
        self.store(KEY_KIND, &kind)
    }

    fn store<'v, V: sequential_storage::map::Value<'v>>(&mut self, key: u8, value: &V) -> Result<(), SettingsError> {
        let mut buffer = [0; ITEM_BYTES];
        embassy_futures::block_on(self.map.store_item(&mut buffer, &key, value)).map_err(|_| SettingsError::Flash)
    }

    fn read(&mut self) -> Result<(), SettingsError> {
        let mut buffer = [0; ITEM_BYTES];
        let map = &mut self.map;
        let boots = embassy_futures::block_on(map.fetch_item::<u32>(&mut buffer, &KEY_BOOTS));
        self.boots = boots.map_err(|_| SettingsError::Flash)?.unwrap_or(0);
        let kind = embassy_futures::block_on(map.fetch_item::<u8>(&mut buffer, &KEY_KIND));
        self.kind = kind.map_err(|_| SettingsError::Flash)?;
        let time = embassy_futures::block_on(map.fetch_item::<&[u8]>(&mut buffer, &KEY_TIME));
        self.time = time.map_err(|_| SettingsError::Flash)?.and_then(KeptTime::decode);
        let name = embassy_futures::block_on(map.fetch_item::<&[u8]>(&mut buffer, &KEY_NAME));
        let name = name.map_err(|_| SettingsError::Flash)?.unwrap_or_default();
        self.name = core::str::from_utf8(name).ok().and_then(|name| Name::try_from(name).ok()).unwrap_or_default();
        Ok(())
    }
}

/// A flash whose calls return when they are done, for a store that would await them.
#[derive(Debug)]
struct Ready<F>(F);

impl<F: NorFlash> nor_async::ErrorType for Ready<F> {
    type Error = F::Error;
}

impl<F: NorFlash> nor_async::ReadNorFlash for Ready<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> nor_async::NorFlash for Ready<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.0.erase(from, to)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.0.write(offset, bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::memory::MemoryFlash;
    use super::*;

    type Flash = MemoryFlash<4>;

    fn load(flash: &mut Flash) -> Settings<&mut Flash> {
        Settings::load(flash, 0..Flash::BYTES).unwrap()
    }

    /// `[DSC-05]`: more renamings than the range holds at once, so that pages are erased and used again; the last name stands.
    #[test]
    fn values_outlive_many_writes_and_each_load_counts() {
        let mut flash = Flash::new();
        load(&mut flash).set_kind(3).unwrap();
        // an item of a name takes more than 16 bytes, so 2000 of them go round 16 KiB at least once
        for n in 0..2000u32 {
            let mut name = Name::new();
            core::fmt::Write::write_fmt(&mut name, format_args!("motor number {n}")).unwrap();
            load(&mut flash).set_name(&name).unwrap();
        }
        let settings = load(&mut flash);
        assert_eq!((settings.name(), settings.kind(), settings.boots()), ("motor number 1999", Some(3), 2002));
    }

    /// `[TIM-17]`: what a node's clock was set to comes back after a reset, and is taken once.
    #[test]
    fn a_clocks_settings_outlast_a_reset() {
        use crate::{Device, kind};
        use osap_protocol::discovery::{BuildKind, TimeSettings, UniqueId};
        let device = || {
            let device = Device::<8, 64, 1, 5, 64>::new(&kind::MOTOR, UniqueId([1; 12]), 1, BuildKind::Firmware, "a");
            device.unwrap().into_parts().0
        };
        let (mut flash, mut node) = (Flash::new(), device());
        assert_eq!(Changes::take(&mut node, LocalTicks::ZERO), Changes::default());
        let tuned = TimeSettings { interval_us: 20_000, priority: 7, ..node.clock().settings() };
        node.clock_mut().set(tuned).unwrap();
        let changes = Changes::take(&mut node, LocalTicks::ZERO);
        assert_eq!(Changes::take(&mut node, LocalTicks::ZERO), Changes::default());
        load(&mut flash).keep(&changes).unwrap();

        let (settings, mut again) = (load(&mut flash), device());
        again.restore_time(settings.time().unwrap());
        assert_eq!(again.clock().settings(), tuned);
        assert_eq!(Changes::take(&mut again, LocalTicks::ZERO), Changes::default(), "nothing new to keep");
    }

    #[test]
    fn a_range_with_anything_in_it_ends_in_settings_that_work() {
        let mut flash = Flash::new();
        flash.write(0, &[0x5a; 4096]).unwrap();
        flash.write(8192, &[0; 64]).unwrap();
        load(&mut flash).set_name("a").unwrap();
        assert_eq!(load(&mut flash).name(), "a");
    }

    #[test]
    fn a_range_that_is_no_range_is_refused() {
        assert_eq!(Settings::load(&mut Flash::new(), 0..100).err(), Some(SettingsError::Range));
    }
}
