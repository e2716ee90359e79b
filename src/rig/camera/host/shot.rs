//! One release of the shutter: nothing stale before it, every file of it, ready after it.
//!
//! The release is [`trigger_capture`](gphoto2::Camera::trigger_capture); then the camera's events are asked for with
//! pauses of our own, as the library's own waiting backs off to 200 ms. libgphoto2 fetches a frame out of a body's
//! memory within the very call that reports it; one on a card is only named, and fetched here.

use super::body::Body;
use super::failure::{Answer, Failure};
use super::harvest::{Harvest, Release};
use crate::rig::camera::protocol::Trouble;
use crate::rig::{Shot, ShotFile, ShotTimes};
use gphoto2::camera::CameraEvent;
use gphoto2::error::ErrorKind;
use gphoto2::file::CameraFilePath;
use std::time::{Duration, Instant};

/// Pause between two questions for the camera's events.
const PAUSE: Duration = Duration::from_millis(10);
/// Where libgphoto2 shows frames that lie in the camera's memory, not on a card.
const MEMORY: &str = "/";
/// How long a camera may chatter before it is taken for quiet.
const CHATTER: Duration = Duration::from_secs(3);
/// How long a frame is waited for that was released for a host which is gone.
const OWED_AT_MOST: Duration = Duration::from_secs(2);
/// Assumed while the dial does not tell: the longest exposure on a dial.
const UNKNOWN_EXPOSURE: Duration = Duration::from_secs(30);
/// Settings that tell why a camera may not release.
const BATTERY: &[&str] = &["batterylevel"];
const FOCUS: &[&str] = &["focusmode", "focusmode2"];
/// libgphoto2's word for Canon's status 1.
const BUSY_WORD: &str = "Camera Status 1";

impl Body {
    /// Gets rid of whatever the camera still holds for the computer. So many files of earlier releases are waited
    /// for a while.
    pub(super) fn clear(&mut self, files_owed: usize) -> Answer<()> {
        let until = Instant::now() + OWED_AT_MOST;
        self.files_owed = files_owed;
        self.drain()?;
        while self.files_owed > 0 && Instant::now() < until {
            std::thread::sleep(PAUSE);
            self.drain()?;
        }
        Ok(())
    }

    /// Takes every event that waits, and with them every frame that nobody waits for any more.
    fn drain(&mut self) -> Answer<()> {
        let until = Instant::now() + CHATTER;
        while Instant::now() < until {
            match self.camera.wait_event(Duration::ZERO).wait() {
                Ok(CameraEvent::Timeout) => break,
                Ok(CameraEvent::NewFile(path)) => {
                    self.files_owed = self.files_owed.saturating_sub(1);
                    tracing::warn!("{} is of an earlier release and is left out", path.name());
                    self.forget(&path)?;
                }
                Ok(_) => {}
                Err(error) if gone(&error) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Makes sure that nothing stale waits and that no live view runs; gives the exposure time on the dial, and how
    /// many files the release will make.
    pub(super) fn get_ready(&mut self, files_owed: usize) -> Answer<(Option<Duration>, usize)> {
        self.files_owed = files_owed;
        self.end_live()?;
        let ready = (self.exposure()?, self.files_a_release()?);
        self.drain()?;
        Ok(ready)
    }

    /// Releases the shutter once and brings its files; returns when the camera is ready for the next.
    pub(super) fn release(
        &mut self,
        (exposure, files): (Option<Duration>, usize),
        patience: Duration,
    ) -> Answer<Shot> {
        let began = Instant::now();
        self.camera.trigger_capture().wait().map_err(|error| self.why_not(error.into()))?;
        let until = began + exposure.unwrap_or(UNKNOWN_EXPOSURE) + patience;
        let owed = self.files_owed;
        let mut harvest = Harvest::new(Release { files, owed, exposure, began });
        let times = self.bring_in(&mut harvest, began, until);
        self.files_owed = harvest.owed_if_given_up(Instant::now());
        let times = times.map_err(Failure::after_release)?;
        let (raw, jpeg) = harvest.files_in()?;
        self.files_owed = 0;
        Ok(Shot { raw, jpeg, times })
    }

    /// Why a camera that answers did not release: the library often says no more than "unspecified".
    fn why_not(&mut self, failure: Failure) -> Failure {
        if failure.trouble != Trouble::Lost {
            return failure;
        }
        let (Ok(battery), Ok(focus)) = (self.text(BATTERY), self.text(FOCUS)) else { return failure };
        let battery = battery.unwrap_or_default();
        if battery.to_lowercase().starts_with("low") || battery == "0%" {
            return Failure::new(Trouble::BatteryLow, format!("{}, battery {battery}", failure.reason));
        }
        match focus {
            Some(mode) if !mode.to_lowercase().starts_with('m') => {
                Failure::new(Trouble::NoFocus, format!("{}, focus mode {mode}", failure.reason))
            }
            _ => Failure::new(Trouble::Refused, failure.reason),
        }
    }

    fn bring_in(&mut self, harvest: &mut Harvest, began: Instant, until: Instant) -> Answer<ShotTimes> {
        let mut times = ShotTimes::default();
        let mut last_byte = began;
        loop {
            let asked = Instant::now();
            match self.camera.wait_event(Duration::ZERO).wait() {
                Ok(CameraEvent::NewFile(path)) => {
                    let named = if path.folder() == MEMORY { asked } else { Instant::now() };
                    if times.exposing.is_zero() {
                        times.exposing = named - began;
                    }
                    let file = self.fetch(&path)?;
                    last_byte = Instant::now();
                    times.transfer += last_byte - named;
                    harvest.take(file, asked, last_byte)?;
                }
                Ok(CameraEvent::CaptureComplete) => {
                    harvest.done = true;
                    harvest.heard(asked);
                }
                Ok(CameraEvent::Timeout) => std::thread::sleep(PAUSE),
                Ok(event) => {
                    harvest.busy |= matches!(&event, CameraEvent::Unknown(word) if word == BUSY_WORD);
                    harvest.heard(asked);
                }
                // Announced twice, or taken out of the camera meanwhile.
                Err(error) if gone(&error) => {
                    harvest.missing += 1;
                    harvest.heard(asked);
                }
                // The frame is whole and will not come again; whatever is wrong meets the next request.
                Err(error) if harvest.finished_but_for_ready(asked) => {
                    tracing::warn!("camera gave its files, then no word that it is ready: {error}");
                    break;
                }
                Err(error) => return Err(error.into()),
            }
            let now = Instant::now();
            if harvest.finished(now) {
                break;
            }
            if harvest.lost(now) {
                let reason = "it announced the frame but could not give it";
                return Err(Failure::new(Trouble::Lost, reason));
            }
            if harvest.in_vain(now) {
                let reason = "all that came came before its exposure can have ended";
                return Err(Failure::new(Trouble::Untrusted, reason));
            }
            if now > until {
                if harvest.finished_but_for_ready(now) {
                    tracing::warn!("camera gave its files, then no word that it is ready");
                    break;
                }
                let reason = format!("no frame came within {:.1?} of the release", now - began);
                return Err(Failure::new(Trouble::Silent, reason));
            }
        }
        times.until_ready = last_byte.elapsed();
        Ok(times)
    }

    /// Downloads a file, whole. A frame in the camera's memory is forgotten there, or the memory would fill up;
    /// one on a card stays, as the photographer's own copy.
    fn fetch(&mut self, path: &CameraFilePath) -> Answer<ShotFile> {
        let (folder, name) = (path.folder(), path.name());
        let announced = self.camera.fs().file_info(&folder, &name).wait()?.file().size().unwrap_or(0);
        let mut bytes = self.download(path);
        let whole = bytes.as_ref().is_ok_and(|bytes| !is_cut(bytes, announced));
        if !whole && folder != MEMORY {
            tracing::warn!("{name} did not come whole from the card and is fetched again");
            self.forget_copies();
            bytes = self.download(path);
        }
        let bytes = bytes?;
        self.forget(path)?;
        if is_cut(&bytes, announced) {
            let trouble = Trouble::Incomplete { got: bytes.len() as u64, announced };
            return Err(Failure::new(trouble, name));
        }
        Ok(ShotFile { name: name.into_owned(), bytes })
    }

    fn download(&self, path: &CameraFilePath) -> Answer<Vec<u8>> {
        let file = self.camera.fs().download(&path.folder(), &path.name()).wait()?;
        Ok(file.get_data(&self.context).wait()?.into_vec())
    }

    /// Lets the camera, and the library, forget a file in the camera's memory.
    fn forget(&self, path: &CameraFilePath) -> Answer<()> {
        if path.folder() == MEMORY {
            self.camera.fs().delete_file(&path.folder(), &path.name()).wait()?;
        }
        Ok(())
    }

    /// Lets the library forget the files that it keeps, so that the next download asks the camera again.
    fn forget_copies(&self) {
        let camera: &gphoto2::libgphoto2_sys::Camera = self.camera.as_ref();
        // SAFETY: `fs` belongs to the open camera and is valid as long as it is; nothing else uses the library in
        // this process meanwhile, as each of its tasks has been waited for.
        #[allow(unsafe_code)]
        let reset = unsafe { gphoto2::libgphoto2_sys::gp_filesystem_reset(camera.fs) };
        tracing::debug!("library's copies forgotten ({reset})");
    }
}

fn is_cut(bytes: &[u8], announced: u64) -> bool {
    bytes.is_empty() || (bytes.len() as u64) < announced
}

/// Whether an announced object was no longer there.
fn gone(error: &gphoto2::Error) -> bool {
    error.kind() == ErrorKind::FileNotFound
}
