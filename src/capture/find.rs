//! Finding the exposure at the rig: takes the test shots that [`Finding`] asks for, and sets the plan.
//!
//! Test shots are never stored. Whatever happens, the gate is closed again at the end, and a plan that was not
//! found changes nothing.

use super::bench::FlashKind;
use super::engine::{ATTEMPTS, Engine, worth_another_try};
use super::error::CaptureError;
use super::hands::{Hands, exposure_of};
use crate::codec::raw::Photo;
use crate::pair::finding::{Finding, Found, Keep, MOST_SHOTS, Next, Wish};
use crate::pair::{Exposure, Settings};
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::levels;
use crate::pipeline::scale::{RatioError, SessionScale};
use crate::progress::Progress;
use crate::session::{Event, Session};
use serde::{Deserialize, Serialize};
use serde_json::json;

/// What may be wished of an exposure to be found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposureWish {
    /// Share of saturation at which the brightest channel of the lit frame ends, 0 to 1.
    pub target_share: f64,
    /// Whether the unlit frame may be exposed longer.
    pub separate_off: bool,
    /// Whether the room is dark, so that no test shot without flash is needed.
    pub flash_only: bool,
    /// Settings that must stay as they are.
    pub keep: Keep,
}

impl Default for ExposureWish {
    fn default() -> Self {
        Self { target_share: 0.85, separate_off: false, flash_only: false, keep: Keep::default() }
    }
}

/// Tag of a test shot at the flash controller; pairs count from 1 up.
const TAG: u32 = u32::MAX;

impl Engine {
    /// Finds shutter, aperture and sensitivity in at most four test shots, in the session's region of interest, and
    /// makes them the session's plan.
    pub fn find_exposure(
        &self,
        session: &Session,
        wish: ExposureWish,
        progress: &Progress,
    ) -> Result<Found, CaptureError> {
        let measured = levels::load(session).map_err(CaptureError::Levels)?;
        let scale = SessionScale::load(session).map_err(CaptureError::Levels)?;
        let wish = Wish {
            target_share: wish.target_share,
            separate_off: wish.separate_off,
            flash_only: wish.flash_only,
            keep: wish.keep,
            ..Wish::of(session.manifest().region)
        };
        let mut bench = self.take_bench();
        let mut hands = Hands { bench: &mut bench, prompter: self.prompter(), progress };
        let outcome = self.look_for_it(&mut hands, wish, (&measured, &scale));
        hands.disarm();
        let found = outcome?;
        session.set_plan(found.plan)?;
        let detail =
            json!({ "plan": found.plan, "predicted_share": found.predicted_share, "shots": found.shots });
        session.record(Event::Note { what: "exposure_found".into(), detail })?;
        Ok(found)
    }

    fn look_for_it(
        &self,
        hands: &mut Hands,
        mut wish: Wish,
        (measured, scale): (&MeasuredLevels, &SessionScale),
    ) -> Result<Found, CaptureError> {
        if let Some(x_sync) = hands.lock_report()?.x_sync {
            wish.x_sync = x_sync;
        }
        let mut told = hands.lock()?;
        let start = exposure_of(&told).ok_or(CaptureError::ExposureUntold)?;
        let offered = hands.offered()?;
        // Drivers name bodies otherwise than files do: whose the table is, the test shots' own files tell.
        let table = scale.of(&Settings::default()).map_err(RatioError::from)?;
        let mut finding = Finding::new(wish, &offered, start, table)?;
        let mut taken = 0;
        loop {
            match finding.next()? {
                Next::Done(found) => {
                    hands.turn_dials(&told, &found.plan.on)?;
                    return Ok(found);
                }
                Next::Shoot { exposure, flash } => {
                    taken += 1;
                    hands.progress.check()?;
                    let words = format!("Test shot {taken} of at most {MOST_SHOTS}: {exposure}");
                    hands.progress.report(&words, taken - 1, MOST_SHOTS);
                    let shot = self.test_shot(hands, &mut told, &exposure, flash, measured)?;
                    scale.of(&shot.settings).map_err(RatioError::from)?;
                    finding.observe(&shot.mosaic)?;
                }
            }
        }
    }

    /// One test shot; a camera that fails is brought back and it is taken again.
    fn test_shot(
        &self,
        hands: &mut Hands,
        told: &mut Settings,
        exposure: &Exposure,
        flash: bool,
        measured: &MeasuredLevels,
    ) -> Result<Photo, CaptureError> {
        let mut attempt = 1;
        loop {
            match hands.test_shot(told, exposure, flash, measured) {
                Err(error) if attempt < ATTEMPTS && worth_another_try(&error, hands.bench) => {
                    attempt += 1;
                    self.bring_back(hands.bench, &error, hands.progress)?;
                    *told = hands.lock()?;
                }
                outcome => return outcome,
            }
        }
    }
}

impl Hands<'_> {
    fn test_shot(
        &mut self,
        told: &mut Settings,
        exposure: &Exposure,
        flash: bool,
        measured: &MeasuredLevels,
    ) -> Result<Photo, CaptureError> {
        self.turn_dials(told, exposure)?;
        *told = Settings {
            shutter: Some(exposure.shutter),
            aperture: Some(exposure.aperture),
            iso: Some(exposure.iso),
            ..std::mem::take(told)
        };
        self.darken_or_arm(flash)?;
        let shot = self.release()?;
        let pulses = self.count()?.map(|syncs| syncs.iter().filter(|sync| sync.triggered).count());
        if pulses.is_some_and(|pulses| pulses != usize::from(flash)) {
            return Err(CaptureError::TestShotMisfired { expected: flash });
        }
        levels::decode(&shot.raw.bytes, &shot.raw.name, measured).map_err(CaptureError::TestShot)
    }

    fn darken_or_arm(&mut self, flash: bool) -> Result<(), CaptureError> {
        // Nobody should be sent to switch a flash off and on again for one shot.
        let by_hand = matches!(self.bench.flash()?, FlashKind::Manual);
        if !(flash && by_hand) {
            self.darken()?;
        }
        if flash { self.arm(TAG) } else { Ok(()) }
    }
}
