//! The properties of the body: their values, the values that they may take, and how both go over the wire.

use super::datasets::{self, u32s};
use super::dials;
use super::options::{BodyOptions, Drive, Files, Focus, Mode};
use super::request::Words;
use crate::pair::Exposure;
use crate::units::Iso;
use std::collections::BTreeMap;
use std::time::Duration;

/// Property codes (Canon's, as in libgphoto2's ptp.h).
pub(super) mod prop {
    pub(crate) const APERTURE: u32 = 0xd101;
    pub(crate) const SHUTTER: u32 = 0xd102;
    pub(crate) const ISO: u32 = 0xd103;
    pub(crate) const MODE: u32 = 0xd105;
    pub(crate) const DRIVE: u32 = 0xd106;
    pub(crate) const METERING: u32 = 0xd107;
    pub(crate) const FOCUS: u32 = 0xd108;
    pub(crate) const WHITE_BALANCE: u32 = 0xd109;
    pub(crate) const COLOR_TEMPERATURE: u32 = 0xd10a;
    pub(crate) const COLOR_SPACE: u32 = 0xd10f;
    pub(crate) const PICTURE_STYLE: u32 = 0xd110;
    pub(crate) const BATTERY: u32 = 0xd111;
    pub(crate) const POWER_OFF: u32 = 0xd114;
    pub(crate) const OWNER: u32 = 0xd115;
    pub(crate) const SHOTS_LEFT: u32 = 0xd11b;
    pub(crate) const TARGET: u32 = 0xd11c;
    pub(crate) const STORAGE: u32 = 0xd11e;
    pub(crate) const FORMAT: u32 = 0xd120;
    pub(crate) const FORMAT_CF: u32 = 0xd121;
    pub(crate) const FORMAT_SD: u32 = 0xd122;
    pub(crate) const MODE_DIAL: u32 = 0xd138;
    pub(crate) const NOISE_REDUCTION: u32 = 0xd178;
    pub(crate) const SHUTTER_COUNT: u32 = 0xd1ac;
    pub(crate) const SERIAL: u32 = 0xd1af;
    pub(crate) const EVF_OUTPUT: u32 = 0xd1b0;
    pub(crate) const EVF_MODE: u32 = 0xd1b1;
    pub(crate) const LIGHTING_OPTIMIZER: u32 = 0xd1c1;
    pub(crate) const LENS: u32 = 0xd1d8;
    pub(crate) const BRACKETING: u32 = 0xd1d9;
}

/// Frames go to the card, where a body without a computer puts them.
pub(super) const TARGET_CARD: u32 = 1;
/// Frames wait in memory for the computer.
pub(super) const TARGET_COMPUTER: u32 = 4;
/// Sensitivity that the body chooses for each frame.
const ISO_AUTO: u32 = 0;
/// What it then chooses.
const ISO_CHOSEN: Iso = Iso(400.0);
/// Drive mode with ten seconds before the shutter.
const TIMER: u32 = 0x10;
/// Drive mode with two seconds before the shutter.
const SHORT_TIMER: u32 = 0x11;
/// Frames that the body's memory takes.
const SHOTS_LEFT: u32 = 99;

/// A property's value.
#[derive(Clone)]
enum Value {
    /// A number and the values it may take; an empty list: only the body writes it.
    Number(u32, Vec<u32>),
    /// Text that only the body writes.
    Text(String),
    /// ImageFormat, in an encoding of its own.
    Format(Files),
}

/// Why a property was not set.
#[derive(Debug, PartialEq)]
pub(super) enum SetError {
    /// There is no such property, or only the body writes it.
    Unknown,
    /// The value is not on its list.
    Value,
}

/// ImageFormat of a large raw file: length of the entry, type RAW, size L, compression RAW.
const RAW: [u32; 4] = [0x10, 6, 0, 4];
/// ImageFormat of a large fine JPEG: length of the entry, type JPEG, size L, compression fine.
const JPEG: [u32; 4] = [0x10, 1, 0, 3];
/// What ImageFormat may be.
const FORMATS: [Files; 3] = [Files::Raw, Files::RawAndJpeg, Files::Jpeg];

/// `count, entries`.
fn format_bytes(files: Files) -> Vec<u8> {
    match files {
        Files::Raw => u32s(&[&[1], &RAW[..]].concat()),
        Files::RawAndJpeg => u32s(&[&[2], &RAW[..], &JPEG[..]].concat()),
        Files::Jpeg => u32s(&[&[1], &JPEG[..]].concat()),
    }
}

/// Canon's code of a mode.
fn mode_code(mode: Mode) -> u32 {
    match mode {
        Mode::Program => 0,
        Mode::Shutter => 1,
        Mode::Aperture => 2,
        Mode::Manual => 3,
    }
}

/// The properties of one body.
pub(super) struct Properties(BTreeMap<u32, Value>);

impl Properties {
    /// 1/125 s, f/11, ISO 100, and the rest as `options` say.
    pub(super) fn new(options: &BodyOptions) -> Self {
        let shown = |code| Value::Number(code, Vec::new());
        let text = |text: &str| Value::Text(text.to_owned());
        let drive = match options.drive {
            Drive::Single => 0,
            Drive::Continuous => 4,
            Drive::Timer => TIMER,
        };
        let mut properties = Self(BTreeMap::from([
            (prop::ISO, Value::Number(0x48, [ISO_AUTO].into_iter().chain(codes(dials::ISO)).collect())),
            (prop::DRIVE, Value::Number(drive, vec![0, 4, TIMER, SHORT_TIMER])),
            (prop::METERING, Value::Number(3, vec![1, 3, 4, 5])),
            (prop::WHITE_BALANCE, Value::Number(options.white_balance, vec![0, 1, 8, 2, 3, 4, 5, 6, 9])),
            (prop::COLOR_TEMPERATURE, Value::Number(5200, (25..=100).map(|k| k * 100).collect())),
            (prop::COLOR_SPACE, Value::Number(1, vec![1, 2])),
            (prop::PICTURE_STYLE, Value::Number(0x81, vec![0x81, 0x82, 0x83, 0x84, 0x85, 0x86])),
            (prop::BATTERY, shown(2)),
            (prop::POWER_OFF, Value::Number(options.auto_power_off, vec![0, 60, 120, 240, 480, 900, 1800])),
            (prop::OWNER, text("")),
            (prop::SHOTS_LEFT, shown(SHOTS_LEFT)),
            (prop::TARGET, Value::Number(TARGET_CARD, vec![TARGET_CARD, TARGET_COMPUTER])),
            (prop::STORAGE, shown(datasets::STORAGE)),
            (prop::FORMAT, Value::Format(options.files)),
            (prop::FORMAT_CF, Value::Format(options.files)),
            (prop::FORMAT_SD, Value::Format(options.files)),
            (prop::NOISE_REDUCTION, Value::Number(options.noise_reduction, vec![0, 1, 2, 3])),
            (prop::SHUTTER_COUNT, shown(0)),
            (prop::SERIAL, text(&options.serial)),
            (prop::EVF_OUTPUT, Value::Number(0, vec![0, 1, 2, 3])),
            (prop::EVF_MODE, Value::Number(1, vec![0, 1])),
            (prop::LIGHTING_OPTIMIZER, Value::Number(options.lighting_optimizer, vec![0, 1, 2, 3])),
            (prop::LENS, text("EF100mm f/2.8L Macro IS USM")),
            (prop::BRACKETING, Value::Number(options.bracketing, vec![0, 3, 5, 8, 0x0b, 0x0d, 0x10])),
        ]));
        properties.turn_mode_dial(options.mode);
        properties.switch_focus(options.focus);
        properties
    }

    /// Codes of all properties.
    pub(super) fn codes(&self) -> Vec<u32> {
        self.0.keys().copied().collect()
    }

    /// The mode dial, and with it who chooses shutter and aperture. Gives the properties that it touches.
    pub(super) fn turn_mode_dial(&mut self, mode: Mode) -> [u32; 4] {
        let mut dial = |property, default, positions, free: bool| {
            let now = self.number(property).unwrap_or(default);
            self.0.insert(
                property,
                Value::Number(now, if free { codes(positions).collect() } else { Vec::new() }),
            );
        };
        dial(prop::SHUTTER, 0x70, dials::SHUTTER, matches!(mode, Mode::Manual | Mode::Shutter));
        dial(prop::APERTURE, 0x40, dials::APERTURE, matches!(mode, Mode::Manual | Mode::Aperture));
        let code = mode_code(mode);
        self.0.insert(prop::MODE, Value::Number(code, Vec::new()));
        self.0.insert(prop::MODE_DIAL, Value::Number(code, Vec::new()));
        [prop::SHUTTER, prop::APERTURE, prop::MODE, prop::MODE_DIAL]
    }

    /// The switch on the lens.
    pub(super) fn switch_focus(&mut self, focus: Focus) {
        let value = match focus {
            Focus::Manual => Value::Number(3, Vec::new()),
            Focus::OneShot => Value::Number(0, vec![0, 1, 2]),
        };
        self.0.insert(prop::FOCUS, value);
    }

    /// A number.
    pub(super) fn number(&self, property: u32) -> Option<u32> {
        match self.0.get(&property) {
            Some(Value::Number(value, _)) => Some(*value),
            _ => None,
        }
    }

    /// Writes a number as the body itself does.
    pub(super) fn write(&mut self, property: u32, value: u32) {
        if let Some(Value::Number(now, _)) = self.0.get_mut(&property) {
            *now = value;
        }
    }

    /// Sets a property to `value` as it came from the client. Gives the properties that changed with it.
    pub(super) fn set(&mut self, property: u32, value: &[u8]) -> Result<Vec<u32>, SetError> {
        match self.0.get_mut(&property) {
            Some(Value::Number(now, list)) if !list.is_empty() => {
                let mut wide = [0; 4];
                let part = wide.get_mut(..value.len()).ok_or(SetError::Value)?;
                part.copy_from_slice(value);
                let value = u32::from_le_bytes(wide);
                if !list.contains(&value) {
                    return Err(SetError::Value);
                }
                *now = value;
                Ok(vec![property])
            }
            Some(Value::Format(_)) => {
                let files = FORMATS.into_iter().find(|f| format_bytes(*f) == value).ok_or(SetError::Value)?;
                let all = [prop::FORMAT, prop::FORMAT_CF, prop::FORMAT_SD];
                all.into_iter().for_each(|p| drop(self.0.insert(p, Value::Format(files))));
                Ok(all.to_vec())
            }
            _ => Err(SetError::Unknown),
        }
    }

    /// Which files a frame becomes.
    pub(super) fn files(&self) -> Files {
        match self.0.get(&prop::FORMAT) {
            Some(Value::Format(files)) => *files,
            _ => Files::Raw,
        }
    }

    /// What the three dials show, and the body's own choice where the sensitivity is automatic.
    pub(super) fn exposure(&self) -> Option<Exposure> {
        Some(Exposure {
            shutter: dials::shutter(self.number(prop::SHUTTER)?)?,
            aperture: dials::aperture(self.number(prop::APERTURE)?)?,
            iso: match self.number(prop::ISO)? {
                ISO_AUTO => ISO_CHOSEN,
                code => dials::iso(code)?,
            },
        })
    }

    /// How long after the release the shutter opens.
    pub(super) fn delay(&self) -> Duration {
        match self.number(prop::DRIVE) {
            Some(TIMER) => Duration::from_secs(10),
            Some(SHORT_TIMER) => Duration::from_secs(2),
            _ => Duration::ZERO,
        }
    }

    /// The record of a property's value, and that of its list. A property that the body overlays with what it shows
    /// for the moment has that in `instead`.
    pub(super) fn records(&self, property: u32, instead: Option<u32>) -> Vec<u8> {
        match self.0.get(&property) {
            Some(Value::Number(value, list)) => {
                let mut records = datasets::value_changed(property, &u32s(&[instead.unwrap_or(*value)]));
                if !list.is_empty() {
                    records.extend(datasets::available(property, list.len(), &u32s(list)));
                }
                records
            }
            Some(Value::Format(files)) => {
                let choices: Vec<u8> = FORMATS.into_iter().flat_map(format_bytes).collect();
                let mut records = datasets::value_changed(property, &format_bytes(*files));
                records.extend(datasets::available(property, FORMATS.len(), &choices));
                records
            }
            Some(Value::Text(text)) => {
                let mut bytes = text.as_bytes().to_vec();
                bytes.resize((bytes.len() + 1).next_multiple_of(4), 0);
                datasets::value_changed(property, &bytes)
            }
            // A property that it does not know is passed over, as the real body does.
            None => Vec::new(),
        }
    }
}

fn codes(positions: &[dials::Position]) -> impl Iterator<Item = u32> {
    positions.iter().map(|(code, _)| *code)
}

/// Splits `u32 size, u32 property, value` from the client.
pub(super) fn parse_set(sent: &[u8]) -> Option<(u32, &[u8])> {
    let mut words = Words::new(sent);
    let (_size, property) = (words.u32().ok()?, words.u32().ok()?);
    Some((property, words.rest())).filter(|(_, value)| !value.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{FNumber, Seconds};

    #[test]
    fn a_new_body_stands_at_a_125th_f_11_iso_100() {
        let exposure = Properties::new(&BodyOptions::default()).exposure().unwrap();
        assert_eq!(
            exposure,
            Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) }
        );
    }

    #[test]
    fn only_what_is_on_a_dial_can_be_set() {
        let mut properties = Properties::new(&BodyOptions::default());
        let mut set = |property, value: u32| properties.set(property, &value.to_le_bytes());
        assert_eq!(set(prop::SHUTTER, 0x71), Err(SetError::Value));
        assert_eq!(set(prop::SERIAL, 1), Err(SetError::Unknown));
        assert_eq!(set(prop::MODE, 2), Err(SetError::Unknown));
        assert_eq!(set(0xd1ff, 1), Err(SetError::Unknown));
        assert_eq!(set(prop::SHUTTER, 0x68), Ok(vec![prop::SHUTTER]));
        assert_eq!(properties.set(prop::ISO, &[0; 9]), Err(SetError::Value));
        assert_eq!(properties.exposure().unwrap().shutter, Seconds(1.0 / 60.0));
    }

    #[test]
    fn an_automatic_sensitivity_is_the_bodys_choice_and_a_timer_delays() {
        let mut properties = Properties::new(&BodyOptions::default());
        assert_eq!(properties.delay(), Duration::ZERO);
        properties.set(prop::ISO, &ISO_AUTO.to_le_bytes()).unwrap();
        properties.set(prop::DRIVE, &SHORT_TIMER.to_le_bytes()).unwrap();
        assert_eq!(properties.exposure().unwrap().iso, ISO_CHOSEN);
        assert_eq!(properties.delay(), Duration::from_secs(2));
    }

    #[test]
    fn in_aperture_priority_the_shutter_is_the_bodys() {
        let mut properties = Properties::new(&BodyOptions { mode: Mode::Aperture, ..BodyOptions::default() });
        assert_eq!(properties.set(prop::SHUTTER, &[0x68, 0, 0, 0]), Err(SetError::Unknown));
        assert!(properties.set(prop::APERTURE, &[0x38, 0, 0, 0]).is_ok());
        properties.turn_mode_dial(Mode::Manual);
        assert!(properties.set(prop::SHUTTER, &[0x68, 0, 0, 0]).is_ok());
    }

    #[test]
    fn the_three_formats_are_told_apart_on_the_wire() {
        let mut properties = Properties::new(&BodyOptions::default());
        for files in FORMATS {
            properties.set(prop::FORMAT_CF, &format_bytes(files)).unwrap();
            assert_eq!(properties.files(), files);
        }
        assert_eq!(properties.set(prop::FORMAT, &u32s(&[1, 0x10, 6, 2, 4])), Err(SetError::Value));
    }
}
