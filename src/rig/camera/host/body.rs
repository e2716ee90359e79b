//! One open camera, through libgphoto2: its settings, its dials, its live picture.

use super::failure::{Answer, Failure};
use crate::pair::{Dial, Offered, Settings};
use crate::rig::camera::labels;
use crate::rig::camera::lock::{self, Config, Reading};
use crate::rig::camera::protocol::{Target, Trouble};
use crate::rig::{CameraInfo, LockReport};
use gphoto2::list::CameraDescriptor;
use gphoto2::widget::{GroupWidget, RadioWidget, ToggleWidget, Widget};
use gphoto2::{Camera, Context};
use std::collections::HashSet;
use std::time::Duration;

/// Names by which libgphoto2 knows a dial, most exact first.
const SHUTTER: &[&str] = &["shutterspeed", "shutterspeed2"];
const APERTURE: &[&str] = &["aperture", "f-number"];
const ISO: &[&str] = &["iso"];
/// On a Canon, `eosserialnumber` is the number on the body, which EXIF has too.
const SERIAL: &[&str] = &["eosserialnumber", "serialnumber"];
/// Stops within which two labels are the same position of a dial: labels are rounded (1/6 s reads 0.1667 or
/// 0.1666), neighbours are a third of a stop apart.
const SAME: f64 = 0.02;
/// What kind of files a release makes.
const FORMAT: &[&str] = &["imageformat", "imagequality"];

/// An open camera.
pub(super) struct Body {
    pub(super) context: Context,
    pub(super) camera: Camera,
    port: String,
    /// Model by which libgphoto2 lists it; not always the name that the body gives itself.
    pub(super) listed_as: String,
    /// Names of the settings that this camera has. libgphoto2 2.5.30 answers "fine" and gives an
    /// uninitialised widget when asked for one that it has not, so no other name may ever be asked for.
    names: HashSet<String>,
    live: bool,
    /// Files of releases that were given up, which may still come.
    pub(super) files_owed: usize,
}

impl Body {
    /// Connects, and changes nothing.
    pub(super) fn connect(context: &Context, port: &str) -> Answer<Self> {
        let descriptor = if port.starts_with("ptpip:") {
            CameraDescriptor { model: "PTP/IP Camera".into(), port: port.into() }
        } else {
            context.list_cameras().wait()?.find(|c| c.port == port).ok_or_else(|| {
                Failure::new(Trouble::NotFound, format!("nothing that libgphoto2 knows is on {port}"))
            })?
        };
        let camera = context.get_camera(&descriptor).wait()?;
        let mut names = HashSet::new();
        // Connecting is lazy; this is the first thing that needs the camera.
        collect_names(&camera.config().wait()?, &mut names)?;
        let (context, port, listed_as) = (context.clone(), port.into(), descriptor.model);
        Ok(Self { context, camera, port, listed_as, names, live: false, files_owed: 0 })
    }

    /// Canon, Nikon and Sony bodies keep frames in memory or on a card, as they are told; others have no choice.
    pub(super) fn send_frames_to(&self, wanted: Target) -> Answer<()> {
        if let Some(target) = self.radio("capturetarget")? {
            let wanted = match wanted {
                Target::Memory => "Internal RAM",
                Target::Card => "Memory card",
            };
            if target.choice() != wanted && target.choices_iter().any(|c| c == wanted) {
                target.set_choice(wanted)?;
                self.camera.set_config(&target).wait()?;
            }
        }
        Ok(())
    }

    fn widget(&self, name: &str) -> Answer<Option<Widget>> {
        if !self.names.contains(name) {
            return Ok(None);
        }
        Ok(Some(self.camera.config_key::<Widget>(name).wait()?))
    }

    /// The choices of a setting, if the camera has it as a list.
    fn radio(&self, name: &str) -> Answer<Option<RadioWidget>> {
        Ok(match self.widget(name)? {
            Some(Widget::Radio(radio)) => Some(radio),
            _ => None,
        })
    }

    /// The text of the first of these settings that the camera has and fills.
    pub(super) fn text(&self, names: &[&str]) -> Answer<Option<String>> {
        for name in names {
            let text = match self.widget(name)? {
                Some(Widget::Text(text)) => text.value(),
                Some(Widget::Radio(radio)) => radio.choice(),
                _ => continue,
            };
            if !text.trim().is_empty() {
                return Ok(Some(text.trim().to_owned()));
            }
        }
        Ok(None)
    }

    pub(super) fn info(&self) -> Answer<CameraInfo> {
        let model = self.text(&["cameramodel"])?;
        Ok(CameraInfo {
            model: model.unwrap_or_else(|| self.camera.abilities().model().into_owned()),
            port: self.port.clone(),
            serial: self.text(SERIAL)?,
        })
    }

    pub(super) fn settings(&self) -> Answer<Settings> {
        Ok(Settings {
            make: self.text(&["manufacturer"])?,
            model: self.text(&["cameramodel"])?,
            serial: self.text(SERIAL)?,
            lens: self.text(&["lensname"])?,
            shutter: self.text(SHUTTER)?.and_then(|label| labels::shutter(&label)),
            aperture: self.text(APERTURE)?.and_then(|label| labels::aperture(&label)),
            iso: self.text(ISO)?.and_then(|label| labels::iso(&label)),
            exposure_program: self.text(&["autoexposuremode", "expprogram"])?,
            white_balance: self.text(&["whitebalance"])?,
            ..Settings::default()
        })
    }

    /// The exposure time on the dial; absent for bulb, automatic, and a body that does not tell.
    pub(super) fn exposure(&self) -> Answer<Option<Duration>> {
        let seconds = self.text(SHUTTER)?.and_then(|label| labels::shutter(&label));
        Ok(seconds.and_then(|s| Duration::try_from_secs_f64(s.0).ok()))
    }

    /// How many files a release makes, going by the label of the format ("RAW + Large Fine JPEG", "NEF+Basic").
    pub(super) fn files_a_release(&self) -> Answer<usize> {
        let label = self.text(FORMAT)?.unwrap_or_default();
        Ok(1 + label.matches('+').count().min(1))
    }

    /// The labels of the first of these dials that the camera has.
    fn dial(&self, names: &[&str]) -> Answer<Option<RadioWidget>> {
        for name in names {
            if let Some(radio) = self.radio(name)? {
                return Ok(Some(radio));
            }
        }
        Ok(None)
    }

    pub(super) fn offered(&self) -> Answer<Offered> {
        let list = |names| -> Answer<Vec<String>> {
            Ok(self.dial(names)?.map(|dial| dial.choices_iter().collect()).unwrap_or_default())
        };
        Ok(Offered {
            shutters: list(SHUTTER)?.iter().filter_map(|label| labels::shutter(label)).collect(),
            apertures: list(APERTURE)?.iter().filter_map(|label| labels::aperture(label)).collect(),
            isos: list(ISO)?.iter().filter_map(|label| labels::iso(label)).collect(),
        })
    }

    pub(super) fn set(&self, dial: Dial) -> Answer<()> {
        type Read = fn(&str) -> Option<f64>;
        let (names, read, wanted): (_, Read, f64) = match dial {
            Dial::Shutter(value) => (SHUTTER, |label| labels::shutter(label).map(|v| v.0), value.0),
            Dial::Aperture(value) => (APERTURE, |label| labels::aperture(label).map(|v| v.0), value.0),
            Dial::Iso(value) => (ISO, |label| labels::iso(label).map(|v| v.0), value.0),
        };
        let name = names.first().copied().unwrap_or_default();
        let radio = self
            .dial(names)?
            .ok_or_else(|| Failure::refused(format!("it has no {name} that a computer may set")))?;
        let labels: Vec<String> = radio.choices_iter().collect();
        let same = |label: &&String| read(label).is_some_and(|value| (value / wanted).log2().abs() < SAME);
        let label = labels.iter().find(same).ok_or_else(|| {
            Failure::refused(format!("it offers no {name} {wanted:.5}, only {}", labels.join(", ")))
        })?;
        if radio.choice() != *label {
            radio.set_choice(label)?;
            self.camera.set_config(&radio).wait()?;
            let now = self.text(names)?.unwrap_or_default();
            if read(&now).is_none_or(|value| (value / wanted).log2().abs() >= SAME) {
                return Err(Failure::refused(format!(
                    "its {name} stays on {now} when told to go to {label}"
                )));
            }
        }
        Ok(())
    }

    /// Goes through the maker's table.
    pub(super) fn lock(&mut self) -> Answer<LockReport> {
        let info = self.info()?;
        let maker = self.text(&["manufacturer"])?.unwrap_or_else(|| info.model.clone());
        lock::go_through(self, &maker, &info.model)
    }

    pub(super) fn preview(&mut self) -> Answer<Vec<u8>> {
        self.live = true;
        let file = self.camera.capture_preview().wait()?;
        Ok(file.get_data(&self.context).wait()?.into_vec())
    }

    /// Ends live view, whose electronic first curtain keeps some bodies from firing a flash.
    pub(super) fn end_live(&mut self) -> Answer<()> {
        if self.live && self.names.contains("viewfinder") {
            let toggle = self.camera.config_key::<ToggleWidget>("viewfinder").wait()?;
            toggle.set_toggled(false);
            self.camera.set_config(&toggle).wait()?;
        }
        self.live = false;
        Ok(())
    }
}

impl Config for Body {
    type Error = Failure;

    fn read(&mut self, name: &str) -> Answer<Option<Reading>> {
        Ok(self.widget(name)?.and_then(|widget| {
            let readonly = widget.readonly();
            let (value, choices) = match &widget {
                Widget::Radio(radio) => (radio.choice(), radio.choices_iter().collect()),
                Widget::Text(text) => (text.value(), Vec::new()),
                Widget::Range(range) => (range.value().to_string(), Vec::new()),
                Widget::Toggle(toggle) => {
                    (u8::from(toggle.toggled()?).to_string(), vec!["0".into(), "1".into()])
                }
                _ => return None,
            };
            Some(Reading { value: value.trim().to_owned(), choices, readonly })
        }))
    }

    fn write(&mut self, name: &str, value: &str) -> Answer<()> {
        let Some(widget) = self.widget(name)? else {
            return Err(Failure::refused(format!("it has no {name}")));
        };
        match &widget {
            Widget::Radio(radio) => radio.set_choice(value)?,
            Widget::Text(text) => text.set_value(value)?,
            Widget::Toggle(toggle) => toggle.set_toggled(value != "0"),
            _ => return Err(Failure::refused(format!("its {name} is no list to choose from"))),
        }
        Ok(self.camera.set_config(&widget).wait()?)
    }
}

fn collect_names(group: &GroupWidget, names: &mut HashSet<String>) -> Answer<()> {
    for child in group.children_iter() {
        match child {
            Widget::Group(inner) => collect_names(&inner, names)?,
            other => {
                names.insert(other.name());
            }
        }
    }
    Ok(())
}
