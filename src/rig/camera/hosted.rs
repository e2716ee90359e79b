//! [`HostedCamera`]: a camera behind a host process, with deadlines, retries and the ladder back.

use super::process::{AskError, Launch, Process};
use super::protocol::{Reply, Request, Target, Trouble};
use super::recover::{self, Patient};
use super::{gone, list_with, out_of_turn};
use crate::pair::{Dial, Offered, Settings};
use crate::rig::{Camera, CameraError, CameraInfo, LockReport, Shot, ShotFile, ShotTimes, usb};
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
        Self { open: Duration::from_secs(20), shot: Duration::from_secs(10), other: Duration::from_secs(10) }
    }
}

/// Assumed as exposure time, for the deadline alone, when the dial does not tell: the longest on a dial.
const UNKNOWN_EXPOSURE: Duration = Duration::from_secs(30);
/// How often a busy camera is asked, and the pause in between.
const BUSY_TRIES: u32 = 8;
const BUSY_PAUSE: Duration = Duration::from_millis(250);
/// How long a camera may be away from the bus after a reset, or after somebody's hand.
const AWAY_AT_MOST: Duration = Duration::from_secs(5);
/// Pause between two looks at the bus.
const LOOK_PAUSE: Duration = Duration::from_millis(250);
/// Bytes at a file's end that tell two frames apart: sensor noise never repeats.
const TELLING_TAIL: usize = 64 << 10;

/// A tethered camera behind a host process.
pub struct HostedCamera {
    launch: Launch,
    port: String,
    deadlines: Deadlines,
    target: Target,
    host: Option<Process>,
    info: Option<CameraInfo>,
    /// The last host was killed or lost its camera: the next one may need more than opening.
    wounded: bool,
    /// The shutter was released, and no frame came: it may still come.
    frame_owed: bool,
    /// Tells the last frame from others.
    last_frame: Option<blake3::Hash>,
}

impl HostedCamera {
    /// Opens the camera on `port`, or the first that is found. Its frames go to the computer alone.
    pub fn open(port: Option<&str>) -> Result<Self, CameraError> {
        Self::open_with(&Launch::own()?, port, Deadlines::default(), Target::default())
    }

    /// [`HostedCamera::open`] by hosts started in another way, with other deadlines, frames going to `target`.
    pub fn open_with(
        launch: &Launch,
        port: Option<&str>,
        deadlines: Deadlines,
        target: Target,
    ) -> Result<Self, CameraError> {
        let port = match port {
            Some(port) => port.to_owned(),
            None => match list_with(launch)?.into_iter().next() {
                Some(first) => first.port,
                None => return Err(CameraError::NotFound { hint: String::new() }),
            },
        };
        let mut camera = Self {
            launch: launch.clone(),
            port,
            deadlines,
            target,
            host: None,
            info: None,
            wounded: false,
            frame_owed: false,
            last_frame: None,
        };
        camera.restart()?;
        Ok(camera)
    }

    /// Process id of the running host, if one runs.
    pub fn host_id(&self) -> Option<u32> {
        self.host.as_ref().map(Process::id)
    }

    /// Makes sure that a host runs with the camera open in it.
    fn connect(&mut self) -> Result<&mut Process, CameraError> {
        if !self.runs() {
            self.host = None;
            if self.wounded {
                let steps = recover::bring_back(self)?;
                tracing::info!("camera on {} is back: {}", self.port, steps.join(", "));
            } else {
                self.restart()?;
            }
        }
        self.host.as_mut().ok_or_else(|| CameraError::Host("it is not running".into()))
    }

    /// Starts a host on `port` and opens the camera in it; gives who it says it is.
    fn open_on(&mut self, port: &str) -> Result<(Process, CameraInfo), CameraError> {
        let request = Request::Open { target: self.target, frame_owed: self.frame_owed };
        let mut host = self.launch.start(Some(port))?;
        let began = Instant::now();
        match host.ask(&request, self.deadlines.open) {
            Ok((Reply::Opened(info), _)) => Ok((host, info)),
            Ok((Reply::Failed { trouble, reason }, _)) => {
                host.kill();
                let hint = format!(" on {port} ({reason})");
                Err(match trouble {
                    // A link that cannot even be opened has nobody at its other end; on USB somebody is plugged in.
                    Trouble::Lost if !port.starts_with("usb:") => CameraError::NotFound { hint },
                    trouble => self.error("open", trouble, reason, began.elapsed()),
                })
            }
            Ok((other, _)) => Err(out_of_turn(&other)),
            Err(AskError::Deadline) => {
                host.kill();
                Err(CameraError::Deadline { operation: "open".into(), deadline: self.deadlines.open })
            }
            Err(AskError::GoneBefore(error) | AskError::Gone(error)) => Err(gone(&error)),
        }
    }

    /// Whether whoever is on a port now is the camera that was opened first.
    fn is_same(&self, found: &CameraInfo) -> bool {
        self.info.as_ref().is_none_or(|mine| mine.model == found.model && mine.serial == found.serial)
    }

    fn settle(&mut self, host: Process, info: CameraInfo) {
        self.port.clone_from(&info.port);
        self.host = Some(host);
        self.info = Some(info);
        self.wounded = false;
    }

    /// Ends the host at once: it hangs, or its camera is lost.
    fn kill(&mut self) {
        self.wounded = true;
        if let Some(host) = self.host.take() {
            host.kill();
        }
    }

    /// Asks with the camera open, and gives the first frame of the answer. Busy is asked again after a pause.
    fn ask(
        &mut self,
        operation: &str,
        request: &Request,
        deadline: Duration,
    ) -> Result<(Reply, Vec<u8>), CameraError> {
        let mut tries = 1;
        loop {
            let began = Instant::now();
            let mut answer = self.connect()?.ask(request, deadline);
            if matches!(answer, Err(AskError::GoneBefore(_))) {
                // Nothing was done, so that asking another host is safe.
                self.kill();
                answer = self.connect()?.ask(request, deadline);
            }
            match self.sort(operation, answer, began, deadline) {
                Err(CameraError::Busy(_)) if tries < BUSY_TRIES => {
                    tries += 1;
                    std::thread::sleep(BUSY_PAUSE);
                }
                sorted => return sorted,
            }
        }
    }

    /// Sorts what came, or did not come; a host that cannot go on is killed.
    fn sort(
        &mut self,
        operation: &str,
        answer: Result<(Reply, Vec<u8>), AskError>,
        began: Instant,
        deadline: Duration,
    ) -> Result<(Reply, Vec<u8>), CameraError> {
        match answer {
            Ok((Reply::Failed { trouble, reason }, _)) => {
                if matches!(trouble, Trouble::Silent | Trouble::Lost | Trouble::NotFound) {
                    self.kill();
                }
                Err(self.error(operation, trouble, reason, began.elapsed()))
            }
            Ok(answer) => Ok(answer),
            Err(AskError::Deadline) => {
                self.kill();
                Err(CameraError::Deadline { operation: operation.into(), deadline })
            }
            Err(AskError::GoneBefore(error) | AskError::Gone(error)) => {
                self.kill();
                Err(gone(&error))
            }
        }
    }

    fn error(&self, operation: &str, trouble: Trouble, reason: String, took: Duration) -> CameraError {
        let operation = operation.to_owned();
        match trouble {
            Trouble::Busy => CameraError::Busy(reason),
            Trouble::Claimed => CameraError::Claimed { port: self.port.clone() },
            Trouble::NotFound if self.info.is_some() && self.on_usb() => {
                CameraError::Unplugged { port: self.port.clone() }
            }
            Trouble::NotFound => CameraError::NotFound { hint: format!(" on {} ({reason})", self.port) },
            Trouble::Silent => CameraError::Deadline { operation, deadline: took },
            Trouble::Lost => CameraError::Lost { operation, reason },
            Trouble::Refused => CameraError::Refused { operation, reason },
            Trouble::NoFocus => CameraError::NoFocus(reason),
            Trouble::CardFull => CameraError::CardFull(reason),
            Trouble::BatteryLow => CameraError::BatteryLow(reason),
            Trouble::Incomplete { got, announced } => {
                CameraError::Incomplete { name: reason, got, announced }
            }
            Trouble::Untrusted => CameraError::Untrusted(reason),
        }
    }

    /// The files of a release, which the host has just announced.
    fn bring_in(&mut self, deadline: Duration) -> Result<Shot, CameraError> {
        let began = Instant::now();
        let until = began + deadline;
        let (mut raw, mut jpeg) = (None, None);
        loop {
            let host = self.host.as_mut().ok_or_else(|| CameraError::Host("it is not running".into()))?;
            let frame = host.hear(until);
            match self.sort(SHOOT, frame, began, deadline)? {
                (Reply::Frame(name), bytes) if raw.is_none() => raw = Some(ShotFile { name, bytes }),
                (Reply::Frame(name), bytes) => jpeg = Some(ShotFile { name, bytes }),
                (Reply::Shot(times), _) => {
                    let raw = raw.ok_or_else(|| CameraError::Host("it gave a shot without a file".into()))?;
                    return Ok(Shot { raw, jpeg, times });
                }
                (other, _) => return Err(out_of_turn(&other)),
            }
        }
    }

    /// A body that gives the frame before once more has not taken one.
    fn note_frame(&mut self, bytes: &[u8]) -> Result<(), CameraError> {
        let tail = &bytes[bytes.len().saturating_sub(TELLING_TAIL)..];
        let frame = blake3::hash(tail);
        if self.last_frame.replace(frame) == Some(frame) {
            return Err(CameraError::Untrusted("it is the frame of the release before once more".into()));
        }
        Ok(())
    }
}

const SHOOT: &str = "take a picture";

impl Patient for HostedCamera {
    fn runs(&mut self) -> bool {
        self.host.as_mut().is_some_and(Process::alive)
    }

    fn ask(&mut self) -> Result<(), CameraError> {
        self.settings().map(drop)
    }

    fn restart(&mut self) -> Result<(), CameraError> {
        if let Some(host) = self.host.take() {
            host.kill();
        }
        let port = self.port.clone();
        let (host, info) = self.open_on(&port)?;
        if !self.is_same(&info) {
            return Err(CameraError::Unplugged { port });
        }
        self.settle(host, info);
        Ok(())
    }

    fn on_usb(&self) -> bool {
        self.port.starts_with("usb:")
    }

    fn find_again(&mut self) -> Result<String, CameraError> {
        let until = Instant::now() + AWAY_AT_MOST;
        loop {
            for found in list_with(&self.launch)? {
                match self.open_on(&found.port) {
                    Ok((host, info)) if self.is_same(&info) => {
                        self.settle(host, info);
                        return Ok(self.port.clone());
                    }
                    Ok(_) => {}
                    Err(error) => tracing::debug!("{} is not the camera looked for: {error}", found.port),
                }
            }
            if Instant::now() >= until {
                return Err(CameraError::Unplugged { port: self.port.clone() });
            }
            std::thread::sleep(LOOK_PAUSE);
        }
    }

    fn reset(&mut self) -> Result<(), CameraError> {
        usb::reset(&self.port)
            .map_err(|error| CameraError::Lost { operation: "reset".into(), reason: error.to_string() })
    }

    fn port(&self) -> &str {
        &self.port
    }
}

impl Camera for HostedCamera {
    fn info(&mut self) -> Result<CameraInfo, CameraError> {
        self.connect()?;
        self.info.clone().ok_or_else(|| CameraError::NotFound { hint: format!(" on {}", self.port) })
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        match self.ask("tell its settings", &Request::Settings, self.deadlines.other)? {
            (Reply::Settings(settings), _) => Ok(settings),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn offered(&mut self) -> Result<Offered, CameraError> {
        match self.ask("list its settings", &Request::Offered, self.deadlines.other)? {
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
        match self.ask(&operation, &Request::Set(dial), self.deadlines.other)? {
            (Reply::Done, _) => Ok(()),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn lock(&mut self) -> Result<LockReport, CameraError> {
        match self.ask("tell how it is set", &Request::Lock, self.deadlines.other)? {
            (Reply::Locked(report), _) => Ok(report),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn preview(&mut self) -> Result<Vec<u8>, CameraError> {
        match self.ask("show a live picture", &Request::Preview, self.deadlines.other)? {
            (Reply::Preview, bytes) => Ok(bytes),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn end_preview(&mut self) -> Result<(), CameraError> {
        // A camera that nobody has open shows nothing.
        if !self.runs() {
            return Ok(());
        }
        match self.ask("end live view", &Request::EndPreview, self.deadlines.other)? {
            (Reply::Done, _) => Ok(()),
            (other, _) => Err(out_of_turn(&other)),
        }
    }

    fn recover(&mut self) -> Result<Vec<String>, CameraError> {
        recover::bring_back(self)
    }

    fn shoot(&mut self) -> Result<Shot, CameraError> {
        let began = Instant::now();
        // The host gives up a little earlier than it would be killed, while it can still say why.
        let request = Request::Shoot { patience: self.deadlines.shot.mul_f64(0.9) };
        let until_release = self.deadlines.shot.min(self.deadlines.other);
        let mut tries = 1;
        let mut shot = loop {
            let exposure = match self.ask(SHOOT, &request, until_release)? {
                (Reply::Releasing { exposure }, _) => exposure,
                (other, _) => return Err(out_of_turn(&other)),
            };
            match self.bring_in(exposure.unwrap_or(UNKNOWN_EXPOSURE) + self.deadlines.shot) {
                Ok(shot) => break shot,
                // A busy camera has not released.
                Err(CameraError::Busy(_)) if tries < BUSY_TRIES => {
                    tries += 1;
                    std::thread::sleep(BUSY_PAUSE);
                }
                Err(error) => {
                    self.frame_owed |= self.host.is_none();
                    return Err(error);
                }
            }
        };
        self.frame_owed = false;
        self.note_frame(&shot.raw.bytes)?;
        shot.times = ShotTimes { total: began.elapsed(), ..shot.times };
        Ok(shot)
    }
}
