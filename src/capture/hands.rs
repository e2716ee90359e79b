//! The single actions at the devices that pairs and test shots are made of: lock, dials, gate, release, count.

use super::bench::{Bench, FlashKind};
use super::error::CaptureError;
use super::prompt::Prompter;
use crate::pair::{Dial, Exposure, FlashSync, Offered, Settings};
use crate::progress::{Cancelled, Progress};
use crate::rig::{CameraError, Flash, FlashError, LockReport, LockState, RECYCLE_PATIENCE, Shot};
use std::time::{Duration, Instant};

/// How long the gate stays open for the lit frame. A tethered body may take seconds from the request to the
/// release.
const ARMED_FOR: Duration = Duration::from_secs(15);
/// How long the controller's word on a sync may be under way after the camera has delivered the file.
const SYNC_PATIENCE: Duration = Duration::from_millis(700);
/// How often a flash that recycles is asked whether it is ready, and the operator whether he still wants it.
const RECYCLE_GLANCE: Duration = Duration::from_millis(250);
/// Stops by which two labels of the same dial position may differ; neighbours are a third of a stop apart.
const SAME_LABEL_STOPS: f64 = 0.05;

/// Both hands at the rig, for as long as one pair or one series of test shots takes.
pub(super) struct Hands<'a> {
    pub(super) bench: &'a mut Bench,
    pub(super) prompter: &'a Prompter,
    pub(super) progress: &'a Progress,
}

/// A gate that was opened is closed again whatever becomes of whoever opened it: an error, a panic, or nothing at all.
impl Drop for Hands<'_> {
    fn drop(&mut self) {
        if self.bench.armed {
            tracing::warn!("the gate was left open; it is closed now");
            self.disarm();
        }
    }
}

impl Hands<'_> {
    /// Goes through the exposure lock, once an opened camera, and reads the dials.
    pub(super) fn lock(&mut self) -> Result<Settings, CaptureError> {
        self.lock_report()?;
        self.camera(|bench| bench.camera()?.settings())
    }

    /// The exposure lock, gone through once an opened camera; an error if a setting would spoil every pair.
    pub(super) fn lock_report(&mut self) -> Result<LockReport, CaptureError> {
        let report = self.camera(|bench| bench.lock())?;
        let wrong = report.sentences(LockState::Wrong);
        if wrong.is_empty() { Ok(report) } else { Err(CaptureError::NotLocked(wrong.join(" "))) }
    }

    /// What the dials offer.
    pub(super) fn offered(&mut self) -> Result<Offered, CaptureError> {
        self.camera(|bench| bench.camera()?.offered())
    }

    /// Turns the dials that do not stand as they should, and reads them back; says whether any was turned.
    pub(super) fn turn_dials(&mut self, now: &Settings, wanted: &Exposure) -> Result<bool, CaptureError> {
        let turns = turns(now, wanted);
        if turns.is_empty() {
            return Ok(false);
        }
        for dial in turns {
            self.camera(|bench| bench.camera()?.set(dial))?;
        }
        let now = self.camera(|bench| bench.camera()?.settings())?;
        if self::turns(&now, wanted).is_empty() { Ok(true) } else { Err(disobeyed(&now, wanted)) }
    }

    /// Closes the gate and forgets the syncs of the past, or asks the operator to switch the flash off.
    pub(super) fn darken(&mut self) -> Result<(), CaptureError> {
        // Without a camera nobody should be sent to switch a flash.
        self.camera(|bench| bench.camera().map(drop))?;
        if let FlashKind::Manual = self.bench.flash()? {
            self.prompter.ask("Switch the flash off, then confirm.", self.progress)?;
        }
        self.close_gate()
    }

    /// Closes the gate and forgets the syncs of the past, where a controller has it.
    pub(super) fn close_gate(&mut self) -> Result<(), CaptureError> {
        let done = match self.bench.flash()? {
            FlashKind::Controller(flash) => {
                flash.disarm().and_then(|()| flash.syncs(Duration::ZERO).map(drop))
            }
            FlashKind::Manual => Ok(()),
            FlashKind::None => return Err(CaptureError::NoFlash),
        };
        self.bench.armed &= done.is_err();
        done.map_err(|error| self.flash_failed(error))
    }

    /// Opens the gate for one sync, or asks the operator to switch the flash on.
    pub(super) fn arm(&mut self, tag: u32) -> Result<(), CaptureError> {
        // An answer that is lost may have opened it.
        self.bench.armed = true;
        let done = match self.bench.flash()? {
            FlashKind::Controller(flash) => arm_when_recycled(flash.as_mut(), tag, self.progress)?,
            FlashKind::Manual => {
                self.prompter.ask("Switch the flash on, then confirm.", self.progress)?;
                Ok(())
            }
            FlashKind::None => return Err(CaptureError::NoFlash),
        };
        done.map_err(|error| self.flash_failed(error))
    }

    /// Closes the gate, best effort: it was opened once, with a time to live, and closes by itself.
    pub(super) fn disarm(&mut self) {
        self.bench.armed = false;
        if let Ok(FlashKind::Controller(flash)) = self.bench.flash()
            && let Err(error) = flash.disarm()
        {
            tracing::warn!("the flash could not be disarmed: {error}");
            self.bench.note_flash_error(&error);
        }
    }

    /// Releases the shutter once.
    pub(super) fn release(&mut self) -> Result<Shot, CaptureError> {
        self.camera(|bench| bench.camera()?.shoot())
    }

    /// The syncs since the last count; `None` where no controller counts.
    pub(super) fn count(&mut self) -> Result<Option<Vec<FlashSync>>, CaptureError> {
        let syncs = match self.bench.flash()? {
            FlashKind::Controller(flash) => flash.syncs(SYNC_PATIENCE),
            FlashKind::Manual => return Ok(None),
            // A controller that went in the middle of a pair must not pass for one that was never there.
            FlashKind::None => return Err(CaptureError::NoFlash),
        };
        syncs.map(Some).map_err(|error| self.flash_failed(error))
    }

    fn camera<T>(
        &mut self,
        act: impl FnOnce(&mut Bench) -> Result<T, CameraError>,
    ) -> Result<T, CaptureError> {
        act(self.bench).map_err(|error| {
            self.bench.note_camera_error(&error);
            error.into()
        })
    }

    fn flash_failed(&mut self, error: FlashError) -> CaptureError {
        self.bench.note_flash_error(&error);
        error.into()
    }
}

/// The dials to be turned. What the camera does not tell is not touched: the frame's own EXIF will tell.
fn turns(now: &Settings, wanted: &Exposure) -> Vec<Dial> {
    let off = |now: f64, wanted: f64| (now / wanted).log2().abs() > SAME_LABEL_STOPS;
    let mut turns = Vec::new();
    if now.shutter.is_some_and(|v| off(v.0, wanted.shutter.0)) {
        turns.push(Dial::Shutter(wanted.shutter));
    }
    if now.aperture.is_some_and(|v| off(v.0, wanted.aperture.0)) {
        turns.push(Dial::Aperture(wanted.aperture));
    }
    if now.iso.is_some_and(|v| off(v.0, wanted.iso.0)) {
        turns.push(Dial::Iso(wanted.iso));
    }
    turns
}

fn disobeyed(now: &Settings, wanted: &Exposure) -> CaptureError {
    let told = |value: Option<String>| value.unwrap_or_else(|| "nothing".into());
    CaptureError::ExposureNotSet {
        wanted: wanted.to_string(),
        found: format!(
            "{}, {}, {}",
            told(now.shutter.map(|v| v.to_string())),
            told(now.aperture.map(|v| v.to_string())),
            told(now.iso.map(|v| v.to_string()))
        ),
    }
}

/// What the dials show, if the camera tells all three.
pub(super) fn exposure_of(settings: &Settings) -> Option<Exposure> {
    Some(Exposure { shutter: settings.shutter?, aperture: settings.aperture?, iso: settings.iso? })
}

/// Arms, waiting for a flash that recycles up to [`RECYCLE_PATIENCE`] from now.
fn arm_when_recycled(
    flash: &mut dyn Flash,
    tag: u32,
    progress: &Progress,
) -> Result<Result<(), FlashError>, Cancelled> {
    let end = Instant::now() + RECYCLE_PATIENCE;
    loop {
        let outcome = flash.arm(tag, ARMED_FOR);
        let wait = match &outcome {
            Err(FlashError::NotReady { wait_ms }) => Duration::from_millis(*wait_ms),
            Err(FlashError::ReadyLow) => RECYCLE_GLANCE,
            _ => return Ok(outcome),
        };
        if Instant::now() + wait > end {
            return Ok(outcome);
        }
        progress.check()?;
        std::thread::sleep(wait.clamp(Duration::from_millis(10), RECYCLE_GLANCE));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::FlashStatus;
    use crate::units::{FNumber, Iso, Seconds};

    #[test]
    fn only_the_dials_that_stand_wrong_are_turned() {
        let wanted = Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) };
        let settings = |shutter: f64, iso: Option<f64>| Settings {
            shutter: Some(Seconds(shutter)),
            aperture: Some(FNumber(11.0)),
            iso: iso.map(Iso),
            ..Settings::default()
        };
        assert_eq!(turns(&settings(0.008, Some(100.0)), &wanted), []);
        assert_eq!(turns(&settings(0.0078, None), &wanted), []);
        assert_eq!(
            turns(&settings(0.01, Some(200.0)), &wanted),
            [Dial::Shutter(wanted.shutter), Dial::Iso(wanted.iso)]
        );
        assert_eq!(exposure_of(&settings(0.01, None)), None);
    }

    /// A flash that is never ready.
    struct Never(fn() -> FlashError);

    impl Flash for Never {
        fn status(&mut self) -> FlashStatus {
            unreachable!("nobody asks")
        }

        fn arm(&mut self, _: u32, _: Duration) -> Result<(), FlashError> {
            Err((self.0)())
        }

        fn disarm(&mut self) -> Result<(), FlashError> {
            Ok(())
        }

        fn syncs(&mut self, _: Duration) -> Result<Vec<FlashSync>, FlashError> {
            Ok(Vec::new())
        }
    }

    #[test]
    fn a_wait_for_a_flash_that_is_not_ready_ends_when_it_is_cancelled() {
        for trouble in [|| FlashError::ReadyLow, || FlashError::NotReady { wait_ms: 20_000 }] {
            let progress = Progress::silent();
            let asked = progress.clone();
            let begun = Instant::now();
            std::thread::scope(|scope| {
                scope.spawn(move || {
                    std::thread::sleep(Duration::from_millis(100));
                    asked.cancel();
                });
                let outcome = arm_when_recycled(&mut Never(trouble), 1, &progress);
                assert!(outcome.is_err(), "{outcome:?}");
            });
            assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
        }
    }

    #[test]
    fn a_recycling_longer_than_anyone_waits_is_told_at_once() {
        let begun = Instant::now();
        let mut flash = Never(|| FlashError::NotReady { wait_ms: 45_000 });
        let outcome = arm_when_recycled(&mut flash, 1, &Progress::silent()).unwrap();
        assert!(outcome.unwrap_err().to_string().contains("wait 45.0 s"));
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
}
