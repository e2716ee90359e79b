//! The camera driver: libgphoto2 in a child process, with a deadline on everything.
//!
//! [`HostedCamera`] starts `unlit camera-host` ([`host`]), which alone uses libgphoto2, and asks it over a
//! local socket (`protocol`). libgphoto2 can hang for ever; a host that misses its deadline is killed (and
//! the device on USB is reset), and the next call starts another. An answer "busy" is asked again a few times.

pub mod host;
mod labels;
mod log;
mod process;
mod protocol;

use super::{Camera, CameraError, CameraInfo, LockReport, Shot, ShotFile, ShotTimes, usb};
use crate::pair::{Dial, Offered, Settings};
use process::{AskError, Process};
use protocol::{Reply, Request, Trouble};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long each operation may take before the host is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deadlines {
    /// Starting the host and connecting to the camera.
    pub open: Duration,
    /// A shot, beyond its exposure time.
    pub shot: Duration,
    /// Everything else.
    pub other: Duration,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self { open: Duration::from_secs(40), shot: Duration::from_secs(10), other: Duration::from_secs(10) }
    }
}

/// Assumed as exposure time, for the deadline alone, while the camera has not told it: the longest on a dial.
const UNKNOWN_EXPOSURE: Duration = Duration::from_secs(30);
/// How often a busy camera is asked, and the pause in between.
const BUSY_TRIES: u32 = 6;
const BUSY_PAUSE: Duration = Duration::from_millis(250);

/// A tethered camera behind a host process.
pub struct HostedCamera {
    program: PathBuf,
    port: String,
    deadlines: Deadlines,
    host: Option<Process>,
    info: CameraInfo,
    exposure: Option<Duration>,
}

/// The cameras that libgphoto2 finds by itself (USB; a PTP/IP camera is opened by its port). Serial numbers
/// are not known before a camera is opened.
pub fn list() -> Result<Vec<CameraInfo>, CameraError> {
    list_with(&own_program()?)
}

/// [`list`] with the executable that runs the hosts.
pub fn list_with(program: &Path) -> Result<Vec<CameraInfo>, CameraError> {
    let deadline = Deadlines::default().open;
    let mut process = start(program, None)?;
    match process.ask(&Request::List, deadline) {
        Ok((Reply::Cameras(cameras), _)) => Ok(cameras),
        Ok((Reply::Failed { reason, .. }, _)) => {
            Err(CameraError::Refused { operation: "list cameras".into(), reason })
        }
        Ok((other, _)) => Err(CameraError::Host(format!("it answered {other:?} to a request for a list"))),
        Err(AskError::Deadline) => {
            process.kill();
            Err(CameraError::Deadline { operation: "list cameras".into(), deadline })
        }
        Err(AskError::GoneBefore(error) | AskError::Gone(error)) => Err(gone(&error)),
    }
}

fn own_program() -> Result<PathBuf, CameraError> {
    std::env::current_exe().map_err(|error| CameraError::Host(format!("own executable not found: {error}")))
}

fn start(program: &Path, port: Option<&str>) -> Result<Process, CameraError> {
    Process::start(program, port)
        .map_err(|error| CameraError::Host(format!("{} could not be started: {error}", program.display())))
}

fn gone(error: &std::io::Error) -> CameraError {
    CameraError::Host(format!(
        "it ended in the middle of a request ({error}); it is started again at the next try"
    ))
}

impl HostedCamera {
    /// Opens the camera on `port`, or the first that is found.
    pub fn open(port: Option<&str>) -> Result<Self, CameraError> {
        Self::open_with(&own_program()?, port, Deadlines::default())
    }

    /// [`HostedCamera::open`] with the executable that runs the host, and with other deadlines.
    pub fn open_with(program: &Path, port: Option<&str>, deadlines: Deadlines) -> Result<Self, CameraError> {
        let port = match port {
            Some(port) => port.to_owned(),
            None => match list_with(program)?.into_iter().next() {
                Some(first) => first.port,
                None => return Err(CameraError::NotFound { hint: String::new() }),
            },
        };
        let info = CameraInfo { model: String::new(), port: port.clone(), serial: None };
        let mut camera =
            Self { program: program.to_owned(), port, deadlines, host: None, info, exposure: None };
        camera.connect()?;
        Ok(camera)
    }

    /// Process id of the running host, if one runs.
    pub fn host_id(&self) -> Option<u32> {
        self.host.as_ref().map(Process::id)
    }

    /// Starts a host and opens the camera in it, unless one runs. A host that died is replaced.
    fn connect(&mut self) -> Result<&mut Process, CameraError> {
        if self.host.as_mut().is_some_and(|host| !host.alive()) {
            self.host = None;
        }
        if self.host.is_none() {
            self.host = Some(start(&self.program, Some(&self.port))?);
            match self.ask("open", &Request::Open, self.deadlines.open) {
                Ok((Reply::Opened(info), _)) => self.info = info,
                Ok((other, _)) => return Err(self.give_up(out_of_turn(&other))),
                Err(error) => return Err(self.give_up(error)),
            }
        }
        self.host.as_mut().ok_or_else(|| CameraError::Host("it is not running".into()))
    }

    fn give_up(&mut self, error: CameraError) -> CameraError {
        self.host = None;
        error
    }

    /// Kills the host; on USB the device is reset, or the next host would find it in the middle of a transfer.
    fn kill(&mut self) {
        if let Some(host) = self.host.take() {
            host.kill();
            if self.port.starts_with("usb:")
                && let Err(error) = usb::reset(&self.port)
            {
                tracing::warn!("{error}");
            }
        }
    }

    /// Asks with the camera open. Busy is asked again after a pause.
    fn ask_again(
        &mut self,
        operation: &str,
        request: &Request,
        deadline: Duration,
    ) -> Result<(Reply, Vec<u8>), CameraError> {
        let mut tries = 1;
        loop {
            let answer = match self.connect() {
                Ok(_) => self.ask(operation, request, deadline),
                Err(error) => Err(error),
            };
            match answer {
                Err(CameraError::Busy(_)) if tries < BUSY_TRIES => {
                    tries += 1;
                    std::thread::sleep(BUSY_PAUSE);
                }
                answer => return answer,
            }
        }
    }

    /// Asks the running host; one that was gone before it read the question is replaced once.
    fn ask(
        &mut self,
        operation: &str,
        request: &Request,
        deadline: Duration,
    ) -> Result<(Reply, Vec<u8>), CameraError> {
        let began = Instant::now();
        let opening = *request == Request::Open;
        let host = self.host.as_mut().ok_or_else(|| CameraError::Host("it is not running".into()))?;
        let answer = match host.ask(request, deadline) {
            Err(AskError::GoneBefore(_)) if !opening => {
                self.kill();
                self.connect()?.ask(request, deadline)
            }
            answer => answer,
        };
        let (trouble, reason) = match answer {
            Ok((Reply::Failed { trouble, reason }, _)) => (trouble, reason),
            Ok(answer) => return Ok(answer),
            Err(AskError::Deadline) => {
                self.kill();
                return Err(CameraError::Deadline { operation: operation.into(), deadline });
            }
            Err(AskError::GoneBefore(error) | AskError::Gone(error)) => {
                self.kill();
                return Err(gone(&error));
            }
        };
        Err(match trouble {
            Trouble::Busy => CameraError::Busy(reason),
            Trouble::Claimed => CameraError::Claimed { port: self.port.clone() },
            Trouble::NotFound => CameraError::NotFound { hint: format!(" on {} ({reason})", self.port) },
            // A link that cannot even be opened has nobody at its other end.
            Trouble::Lost if opening => {
                CameraError::NotFound { hint: format!(" on {} ({reason})", self.port) }
            }
            Trouble::Refused => CameraError::Refused { operation: operation.into(), reason },
            Trouble::Silent => {
                self.kill();
                CameraError::Deadline { operation: operation.into(), deadline: began.elapsed() }
            }
            Trouble::Lost => {
                self.kill();
                CameraError::Refused {
                    operation: operation.into(),
                    reason: format!("{reason}; the camera is opened anew at the next try"),
                }
            }
        })
    }
}

fn out_of_turn(reply: &Reply) -> CameraError {
    CameraError::Host(format!("it answered out of turn: {reply:?}"))
}

impl Camera for HostedCamera {
    fn info(&mut self) -> Result<CameraInfo, CameraError> {
        self.connect()?;
        Ok(self.info.clone())
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        let deadline = self.deadlines.other;
        match self.ask_again("tell its settings", &Request::Settings, deadline)? {
            (Reply::Settings(settings), _) => {
                self.exposure = settings.shutter.and_then(|s| Duration::try_from_secs_f64(s.0).ok());
                Ok(settings)
            }
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn preview(&mut self) -> Result<Vec<u8>, CameraError> {
        let deadline = self.deadlines.other;
        match self.ask_again("show a live picture", &Request::Preview, deadline)? {
            (Reply::File(_), bytes) => Ok(bytes),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn offered(&mut self) -> Result<Offered, CameraError> {
        let deadline = self.deadlines.other;
        match self.ask_again("list its settings", &Request::Offered, deadline)? {
            (Reply::Offered(offered), _) => Ok(offered),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn set(&mut self, dial: Dial) -> Result<(), CameraError> {
        let operation = match dial {
            Dial::Shutter(value) => format!("set the shutter to {value}"),
            Dial::Aperture(value) => format!("set the aperture to {value}"),
            Dial::Iso(value) => format!("set the sensitivity to {value}"),
        };
        match self.ask_again(&operation, &Request::Set(dial), self.deadlines.other)? {
            (Reply::Done, _) => {}
            (other, _) => return Err(out_of_turn(&other)),
        }
        if let Dial::Shutter(value) = dial {
            self.exposure = Duration::try_from_secs_f64(value.0).ok();
        }
        Ok(())
    }

    fn lock(&mut self) -> Result<LockReport, CameraError> {
        Ok(LockReport::default())
    }

    fn shoot(&mut self) -> Result<Shot, CameraError> {
        let began = Instant::now();
        let deadline = self.exposure.unwrap_or(UNKNOWN_EXPOSURE) + self.deadlines.shot;
        match self.ask_again("take a picture", &Request::Shoot, deadline)? {
            (Reply::File(name), bytes) => Ok(Shot {
                raw: ShotFile { name, bytes },
                jpeg: None,
                times: ShotTimes { total: began.elapsed(), ..ShotTimes::default() },
            }),
            (other, _) => Err(out_of_turn(&other)),
        }
    }
}
