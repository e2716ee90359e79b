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
/// An answer younger than this shows that the camera is there.
const FRESH: Duration = Duration::from_secs(3);
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
    /// Model by which libgphoto2 lists it; not always the name that the body gives itself.
    listed_as: String,
    /// When it answered last.
    heard: Instant,
    /// The last host was killed or lost its camera: the next one may need more than opening.
    wounded: bool,
    /// Files of releases that were given up, which may still come.
    files_owed: usize,
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
            listed_as: String::new(),
            heard: Instant::now(),
            wounded: false,
            files_owed: 0,
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

    /// Starts a host on `port`, opens the camera in it and, if it is ours, makes it ready. Another one is left as it
    /// is, and no answer is given. `alone` says that no other of its model can be on that port.
    fn open_on(&mut self, port: &str, alone: bool) -> Result<Option<Opened>, CameraError> {
        let began = Instant::now();
        let host = self.launch.start(Some(port))?;
        let (host, info, listed_as) = match self.ask_new(host, port, &Request::Open, began)? {
            (host, Reply::Opened { info, listed_as }) => (host, info, listed_as),
            (_, other) => return Err(out_of_turn(&other)),
        };
        if self.info.as_ref().is_some_and(|mine| !is_same(mine, &info, alone)) {
            return Ok(None);
        }
        let prepare = Request::Prepare { target: self.target, files_owed: self.files_owed };
        match self.ask_new(host, port, &prepare, began)? {
            (host, Reply::Prepared { files_owed }) => Ok(Some(Opened { host, info, listed_as, files_owed })),
            (_, other) => Err(out_of_turn(&other)),
        }
    }

    /// Asks a host that is not settled yet, and ends it if that fails; `began` is when the opening began.
    fn ask_new(
        &self,
        mut host: Process,
        port: &str,
        request: &Request,
        began: Instant,
    ) -> Result<(Process, Reply), CameraError> {
        match host.ask(request, self.deadlines.open.saturating_sub(began.elapsed())) {
            Ok((Reply::Failed { trouble, reason, .. }, _)) => {
                host.kill();
                let hint = format!(" on {port} ({reason})");
                Err(match trouble {
                    // A link that cannot even be opened has nobody at its other end; on USB somebody is plugged in.
                    Trouble::Lost if !port.starts_with("usb:") => CameraError::NotFound { hint },
                    trouble => self.error("open", trouble, reason, began.elapsed()),
                })
            }
            Ok((reply, _)) => Ok((host, reply)),
            Err(AskError::Deadline) => {
                host.kill();
                Err(CameraError::Deadline { operation: "open".into(), deadline: self.deadlines.open })
            }
            Err(AskError::GoneBefore(error) | AskError::Gone(error)) => Err(gone(&error)),
        }
    }

    fn settle(&mut self, opened: Opened) {
        let Opened { host, info, listed_as, files_owed } = opened;
        self.port.clone_from(&info.port);
        (self.host, self.info, self.listed_as) = (Some(host), Some(info), listed_as);
        self.files_owed = files_owed;
        self.heard = Instant::now();
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

    /// Asks the host that runs, once: whatever is wrong is told at once, and nothing is brought back.
    fn ask_only(
        &mut self,
        operation: &str,
        request: &Request,
        deadline: Duration,
    ) -> Result<(Reply, Vec<u8>), CameraError> {
        let began = Instant::now();
        if !self.runs() {
            self.host = None;
        }
        let Some(host) = &mut self.host else {
            return Err(CameraError::Lost {
                operation: operation.into(),
                reason: "its driver was stopped by an earlier failure".into(),
            });
        };
        let answer = host.ask(request, deadline);
        self.sort(operation, answer, began, deadline)
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
            Ok((Reply::Failed { trouble, reason, .. }, _)) => {
                self.heard = Instant::now();
                if matches!(trouble, Trouble::Silent | Trouble::Lost | Trouble::NotFound) {
                    self.kill();
                }
                Err(self.error(operation, trouble, reason, began.elapsed()))
            }
            Ok(answer) => {
                self.heard = Instant::now();
                Ok(answer)
            }
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
            if let Ok((Reply::Failed { files_owed: Some(owed), .. }, _)) = &frame {
                self.files_owed = *owed;
            }
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

/// A camera opened in a host, and ready.
struct Opened {
    host: Process,
    info: CameraInfo,
    listed_as: String,
    files_owed: usize,
}

/// Whether whoever was found is the camera that was opened first. Without serial numbers only one that is `alone`
/// is taken for it.
fn is_same(mine: &CameraInfo, found: &CameraInfo, alone: bool) -> bool {
    mine.model == found.model
        && match (&mine.serial, &found.serial) {
            (None, None) => alone,
            (mine, found) => mine == found,
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
        // Whoever is plugged in anew gets an address of its own, so that nobody else is expected at this one.
        match self.open_on(&port, true)? {
            Some(opened) => self.settle(opened),
            None => return Err(CameraError::Unplugged { port }),
        }
        Ok(())
    }

    fn on_usb(&self) -> bool {
        self.port.starts_with("usb:")
    }

    fn find_again(&mut self) -> Result<String, CameraError> {
        let until = Instant::now() + AWAY_AT_MOST;
        loop {
            let mut found = list_with(&self.launch)?;
            found.retain(|camera| camera.model == self.listed_as);
            let alone = found.len() == 1;
            for found in found {
                match self.open_on(&found.port, alone) {
                    Ok(Some(opened)) => {
                        self.settle(opened);
                        return Ok(self.port.clone());
                    }
                    Ok(None) => tracing::debug!("{} is another camera", found.port),
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
        // A host that idles does not notice that its camera has gone.
        if self.heard.elapsed() >= FRESH {
            match self.ask_only("tell whether it is there", &Request::Greet, self.deadlines.other) {
                Ok((Reply::Done, _)) | Err(CameraError::Busy(_)) => {}
                Ok((other, _)) => return Err(out_of_turn(&other)),
                Err(error) => {
                    self.kill();
                    return Err(error);
                }
            }
        }
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
        // Live view asks again and again: climbing the ladder each time would hold the rig for seconds.
        match self.ask_only("show a live picture", &Request::Preview, self.deadlines.other)? {
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
        let patience = self.deadlines.shot.mul_f64(0.9);
        let until_release = self.deadlines.shot.min(self.deadlines.other);
        let mut tries = 1;
        let mut shot = loop {
            // Opening the camera may bring in some of what is owed, and must come before it is told what is.
            self.connect()?;
            let request = Request::Shoot { patience, files_owed: self.files_owed };
            let exposure = match self.ask(SHOOT, &request, until_release)? {
                (Reply::Releasing { exposure, files_owed }, _) => {
                    self.files_owed = files_owed;
                    exposure
                }
                (other, _) => return Err(out_of_turn(&other)),
            };
            match self.bring_in(exposure.unwrap_or(UNKNOWN_EXPOSURE) + self.deadlines.shot) {
                Ok(shot) => break shot,
                // A busy camera has not released.
                Err(CameraError::Busy(_)) if tries < BUSY_TRIES => {
                    tries += 1;
                    std::thread::sleep(BUSY_PAUSE);
                }
                Err(error) => return Err(error),
            }
        };
        // The frame of another release leaves this one's owed.
        self.note_frame(&shot.raw.bytes)?;
        self.files_owed = 0;
        shot.times = ShotTimes { total: began.elapsed(), ..shot.times };
        Ok(shot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(model: &str, serial: Option<&str>) -> CameraInfo {
        CameraInfo { model: model.into(), port: "usb:001,004".into(), serial: serial.map(str::to_owned) }
    }

    #[test]
    fn a_camera_is_known_by_model_and_serial_and_without_one_only_when_it_is_alone() {
        let (mine, dumb) = (camera("5DS", Some("42")), camera("5DS", None));
        for alone in [false, true] {
            assert!(is_same(&mine, &mine, alone));
            assert!(!is_same(&mine, &camera("5DS", Some("77")), alone));
            assert!(!is_same(&mine, &dumb, alone), "it told its number before");
            assert!(!is_same(&mine, &camera("5DS R", Some("42")), alone));
            assert_eq!(is_same(&dumb, &dumb, alone), alone);
        }
    }
}
