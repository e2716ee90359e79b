//! The camera host: the child process that alone speaks to libgphoto2.
//!
//! libgphoto2 can hang for ever inside a call, and the gphoto2 crate runs every camera of a process through
//! one thread. So each camera has a process of its own, which its driver may kill. The host takes requests on
//! the socket that it was given as standard input and answers there; whatever the library prints goes to
//! standard error. It ends when the socket does, even from inside a call that hangs.

use super::protocol::{self, Reply, Request, Trouble};
use super::{labels, log};
use crate::pair::{Dial, Offered, Settings};
use crate::rig::CameraInfo;
use gphoto2::camera::CameraEvent;
use gphoto2::error::ErrorKind;
use gphoto2::list::CameraDescriptor;
use gphoto2::widget::{GroupWidget, RadioWidget, ToggleWidget, Widget};
use gphoto2::{Camera, Context};
use std::collections::HashSet;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// How long the host may take to say goodbye to the camera when its driver is gone.
const GOODBYE: Duration = Duration::from_secs(3);
/// How long a camera may take, after it has given its file, until it says that it is ready.
const READY_AT_MOST: Duration = Duration::from_secs(5);
/// A camera silent for so long after its file is taken for ready; should it not be, it says "busy" next time.
const SILENCE: Duration = Duration::from_millis(200);
/// Where libgphoto2 shows frames that lie in the camera's memory, not on a card.
const MEMORY: &str = "/";

/// Why the host could not run.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// Started by hand.
    #[error("camera-host is started by unlit itself, with a socket as its standard input: {0}")]
    NoSocket(io::Error),
    /// The socket broke.
    #[error("camera-host lost its driver: {0}")]
    Link(#[from] io::Error),
}

/// Serves the camera on `port` (without one, the host can only list cameras) until the driver closes the socket.
pub fn run(port: Option<&str>) -> Result<(), HostError> {
    let socket = io::stdin().as_fd().try_clone_to_owned().map_err(HostError::NoSocket)?;
    let mut link = UnixStream::from(socket);
    link.peer_addr().map_err(HostError::NoSocket)?;
    let mut requests_in = link.try_clone()?;
    let (pass, requests) = mpsc::channel();
    std::thread::Builder::new().name("camera-host-requests".into()).spawn(move || {
        while let Ok((request, _)) = protocol::receive::<Request>(&mut requests_in) {
            if pass.send(request).is_err() {
                return;
            }
        }
        drop(pass);
        std::thread::sleep(GOODBYE);
        std::process::exit(0);
    })?;
    let mut host = Host { port: port.map(str::to_owned), context: None, open: None };
    log::listen();
    for request in requests {
        log::take();
        let (reply, payload) = host.answer(&request).unwrap_or_else(|failure| {
            let reason = match log::take() {
                log if log.is_empty() => failure.reason,
                log => format!("{} ({log})", failure.reason),
            };
            (Reply::Failed { trouble: failure.trouble, reason }, Vec::new())
        });
        protocol::send(&mut link, &reply, &payload)?;
    }
    Ok(())
}

/// A failed request.
struct Failure {
    trouble: Trouble,
    reason: String,
}

impl Failure {
    fn refused(reason: impl Into<String>) -> Self {
        Self { trouble: Trouble::Refused, reason: reason.into() }
    }

    /// Once the shutter has been released, "busy" must not lead to another release.
    fn after_release(self) -> Self {
        match self.trouble {
            Trouble::Busy => Self { trouble: Trouble::Lost, ..self },
            _ => self,
        }
    }
}

impl From<gphoto2::Error> for Failure {
    fn from(error: gphoto2::Error) -> Self {
        let trouble = match error.kind() {
            ErrorKind::CameraBusy => Trouble::Busy,
            ErrorKind::IoUsbClaim | ErrorKind::IoLock => Trouble::Claimed,
            ErrorKind::IoUsbFind | ErrorKind::ModelNotFound | ErrorKind::UnknownPort => Trouble::NotFound,
            ErrorKind::Timeout => Trouble::Silent,
            ErrorKind::BadParameters | ErrorKind::NotSupported | ErrorKind::CameraError => Trouble::Refused,
            _ => Trouble::Lost,
        };
        Self { trouble, reason: error.to_string() }
    }
}

type Answer<T> = Result<T, Failure>;

struct Host {
    port: Option<String>,
    context: Option<Context>,
    open: Option<Open>,
}

impl Host {
    /// The one context of this process, made at first use, after the logger.
    fn context(&mut self) -> Answer<Context> {
        if let Some(context) = &self.context {
            return Ok(context.clone());
        }
        let context = Context::new()?;
        self.context = Some(context.clone());
        Ok(context)
    }

    fn open(&mut self) -> Answer<&mut Open> {
        self.open.as_mut().ok_or_else(|| Failure::refused("the host was asked before it was told to open"))
    }

    fn answer(&mut self, request: &Request) -> Answer<(Reply, Vec<u8>)> {
        let plain = |reply| Ok((reply, Vec::new()));
        match request {
            Request::List => {
                let cameras = self.context()?.list_cameras().wait()?;
                let info = |c: CameraDescriptor| CameraInfo { model: c.model, port: c.port, serial: None };
                plain(Reply::Cameras(cameras.map(info).collect()))
            }
            Request::Open => {
                let context = self.context()?;
                let port = self.port.clone().ok_or_else(|| Failure::refused("the host has no port"))?;
                let open = Open::connect(&context, &port)?;
                let info = open.info()?;
                self.open = Some(open);
                plain(Reply::Opened(info))
            }
            Request::Settings => plain(Reply::Settings(self.open()?.settings()?)),
            Request::Offered => plain(Reply::Offered(self.open()?.offered()?)),
            Request::Set(dial) => {
                self.open()?.set(*dial)?;
                plain(Reply::Done)
            }
            Request::Preview => Ok((Reply::File("preview.jpg".into()), self.open()?.preview()?)),
            Request::Shoot => {
                let (name, bytes) = self.open()?.shoot()?;
                Ok((Reply::File(name), bytes))
            }
        }
    }
}

/// An open camera.
struct Open {
    context: Context,
    camera: Camera,
    port: String,
    /// Names of the settings that this camera has. libgphoto2 2.5.30 answers "fine" and gives an
    /// uninitialised widget when asked for one that it has not, so no other name may ever be asked for.
    names: HashSet<String>,
    live: bool,
}

impl Open {
    fn connect(context: &Context, port: &str) -> Answer<Self> {
        let descriptor = if port.starts_with("ptpip:") {
            CameraDescriptor { model: "PTP/IP Camera".into(), port: port.into() }
        } else {
            context.list_cameras().wait()?.find(|c| c.port == port).ok_or_else(|| Failure {
                trouble: Trouble::NotFound,
                reason: format!("nothing that libgphoto2 knows is on {port}"),
            })?
        };
        let camera = context.get_camera(&descriptor).wait()?;
        let mut names = HashSet::new();
        // Connecting is lazy; this is the first thing that needs the camera.
        collect_names(&camera.config().wait()?, &mut names)?;
        let open = Self { context: context.clone(), camera, port: port.into(), names, live: false };
        open.send_frames_to_memory()?;
        Ok(open)
    }

    /// Canon bodies hand frames over from memory, which saves the card and its time.
    fn send_frames_to_memory(&self) -> Answer<()> {
        if let Some(target) = self.radio("capturetarget")? {
            let memory = "Internal RAM";
            if target.choice() != memory && target.choices_iter().any(|c| c == memory) {
                target.set_choice(memory)?;
                self.camera.set_config(&target).wait()?;
            }
        }
        Ok(())
    }

    /// The choices of a setting, if the camera has it as a list.
    fn radio(&self, name: &str) -> Answer<Option<RadioWidget>> {
        if !self.names.contains(name) {
            return Ok(None);
        }
        Ok(match self.camera.config_key::<Widget>(name).wait()? {
            Widget::Radio(radio) => Some(radio),
            _ => None,
        })
    }

    /// The text of the first of these settings that the camera has and fills.
    fn text(&self, names: &[&str]) -> Answer<Option<String>> {
        for name in names.iter().filter(|name| self.names.contains(**name)) {
            let text = match self.camera.config_key::<Widget>(name).wait()? {
                Widget::Text(text) => text.value(),
                Widget::Radio(radio) => radio.choice(),
                _ => continue,
            };
            if !text.trim().is_empty() {
                return Ok(Some(text.trim().to_owned()));
            }
        }
        Ok(None)
    }

    fn info(&self) -> Answer<CameraInfo> {
        let model = self.text(&["cameramodel"])?;
        Ok(CameraInfo {
            model: model.unwrap_or_else(|| self.camera.abilities().model().into_owned()),
            port: self.port.clone(),
            serial: self.text(SERIAL)?,
        })
    }

    fn settings(&self) -> Answer<Settings> {
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

    /// The labels of the first of these dials that the camera has.
    fn dial(&self, names: &[&str]) -> Answer<Option<RadioWidget>> {
        for name in names {
            if let Some(radio) = self.radio(name)? {
                return Ok(Some(radio));
            }
        }
        Ok(None)
    }

    fn offered(&self) -> Answer<Offered> {
        let list = |names| -> Answer<Vec<String>> {
            Ok(self.dial(names)?.map(|dial| dial.choices_iter().collect()).unwrap_or_default())
        };
        Ok(Offered {
            shutters: list(SHUTTER)?.iter().filter_map(|label| labels::shutter(label)).collect(),
            apertures: list(APERTURE)?.iter().filter_map(|label| labels::aperture(label)).collect(),
            isos: list(ISO)?.iter().filter_map(|label| labels::iso(label)).collect(),
        })
    }

    fn set(&self, dial: Dial) -> Answer<()> {
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
        // Labels are rounded (1/6 s reads 0.1667 or 0.1666), neighbours are a third of a stop apart.
        let same = |label: &&String| read(label).is_some_and(|value| (value / wanted).log2().abs() < 0.02);
        let label = labels.iter().find(same).ok_or_else(|| {
            Failure::refused(format!("it offers no {name} {wanted:.5}, only {}", labels.join(", ")))
        })?;
        if radio.choice() != *label {
            radio.set_choice(label)?;
            self.camera.set_config(&radio).wait()?;
        }
        Ok(())
    }

    fn preview(&mut self) -> Answer<Vec<u8>> {
        self.live = true;
        let file = self.camera.capture_preview().wait()?;
        Ok(file.get_data(&self.context).wait()?.into_vec())
    }

    /// Ends live view, whose electronic first curtain keeps some bodies from firing a flash.
    fn end_live(&mut self) -> Answer<()> {
        if self.live && self.names.contains("viewfinder") {
            let toggle = self.camera.config_key::<ToggleWidget>("viewfinder").wait()?;
            toggle.set_toggled(false);
            self.camera.set_config(&toggle).wait()?;
        }
        self.live = false;
        Ok(())
    }

    fn shoot(&mut self) -> Answer<(String, Vec<u8>)> {
        self.end_live()?;
        let path = self.camera.capture_image().wait()?;
        let shot = self.fetch(&path.folder(), &path.name()).map_err(Failure::after_release)?;
        self.wait_until_ready(shot)
    }

    /// Waits until the camera is done with the shot whose file is `shot`, and gives the shot's raw file.
    fn wait_until_ready(&self, mut shot: (String, Vec<u8>)) -> Answer<(String, Vec<u8>)> {
        let until = Instant::now() + READY_AT_MOST;
        while Instant::now() < until {
            match self.camera.wait_event(SILENCE).wait() {
                Ok(CameraEvent::CaptureComplete | CameraEvent::Timeout) => break,
                // The second file of RAW+JPEG: it must leave the camera's memory, and the raw is the one wanted.
                Ok(CameraEvent::NewFile(path)) => {
                    let other = self.fetch(&path.folder(), &path.name()).map_err(Failure::after_release)?;
                    if is_jpeg(&shot.1) && !is_jpeg(&other.1) {
                        shot = other;
                    }
                }
                Ok(_) => {}
                // The frame is whole and will not come again; whatever is wrong meets the next request.
                Err(error) => {
                    tracing::warn!("camera gave its file, then no word that it is ready: {error}");
                    break;
                }
            }
        }
        Ok(shot)
    }

    /// Downloads a file. A frame in the camera's memory is forgotten there, or the memory would fill up; one
    /// on a card stays, as the photographer's own copy.
    fn fetch(&self, folder: &str, name: &str) -> Answer<(String, Vec<u8>)> {
        let files = self.camera.fs();
        let bytes = files.download(folder, name).wait()?.get_data(&self.context).wait()?.into_vec();
        if bytes.is_empty() {
            return Err(Failure::refused(format!("{name} came empty")));
        }
        if folder == MEMORY {
            files.delete_file(folder, name).wait()?;
        }
        Ok((name.to_owned(), bytes))
    }
}

/// Names by which libgphoto2 knows a dial, most exact first.
const SHUTTER: &[&str] = &["shutterspeed", "shutterspeed2"];
const APERTURE: &[&str] = &["aperture", "f-number"];
const ISO: &[&str] = &["iso"];
/// On a Canon, `eosserialnumber` is the number on the body, which EXIF has too.
const SERIAL: &[&str] = &["eosserialnumber", "serialnumber"];

fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8])
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
