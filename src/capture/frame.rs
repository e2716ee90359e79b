//! Single frames for calibrations: shot as the camera stands, and kept until their calibration is fitted.

use super::bench::FlashKind;
use super::engine::{ATTEMPTS, Engine, worth_another_try};
use super::error::CaptureError;
use super::events::Topic;
use super::hands::{Hands, exposure_of};
use super::place::name_of;
use crate::calibration::guide::{Kind, Role};
use crate::pair::{Exposure, FlashRecord, Settings};
use crate::pipeline::calibrate::waiting::{self, Incoming, Origin, WaitingShot};
use crate::progress::Progress;
use crate::rig::Shot;
use crate::session::Session;
use serde::{Deserialize, Serialize};
use serde_json::json;

/// What is to be shot for a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShotWish {
    /// For which.
    pub kind: Kind,
    /// As what; may be left out where there is one role only.
    pub role: Option<Role>,
    /// Distance from the lens to the card, metres; of card shots.
    pub distance_m: Option<f64>,
    /// Where the dials are to stand for it; as they stand if `None`. Afterwards they stand as before.
    pub exposure: Option<Exposure>,
    /// How many, one after the other, nothing changed in between.
    pub count: u32,
}

/// A frame, and the energy of its pulse in counts, if a controller measured it.
type Measured = (Shot, Option<f64>);

/// Tag of a calibration frame at the flash controller; test shots have the one above, pairs count from 1 up.
const TAG: u32 = u32::MAX - 1;

impl Engine {
    /// Shoots one frame for a calibration, with flash if its role is lit by it, and has it wait for the fit. It is the `n`th
    /// of `count`, from 0 up.
    pub(super) fn shoot_frame(
        &self,
        session: &Session,
        (kind, role): (Kind, Role),
        exposure: Option<Exposure>,
        (n, count): (u32, u32),
        progress: &Progress,
    ) -> Result<WaitingShot, CaptureError> {
        session.require_room()?;
        let step = |doing: &str, half: usize| match count {
            1 => progress.report(&format!("{doing} the frame"), half, 2),
            _ => progress.report(&format!("{doing} frame {} of {count}", n + 1), n as usize, count as usize),
        };
        step("Taking", 0);
        let (shot, energy_counts) = {
            let mut bench = self.take_bench();
            let mut hands = Hands { bench: &mut bench, prompter: self.prompter(), progress };
            let outcome = self.frame(&mut hands, role, exposure);
            if role.is_lit_by_flash() {
                hands.disarm();
            }
            outcome?
        };
        step("Storing", 1);
        let incoming = Incoming {
            role,
            distance_m: None,
            frame: (&shot.raw.name, &shot.raw.bytes),
            off: None,
            origin: Origin::Camera,
            energy_counts,
        };
        let kept = waiting::add(session, kind, incoming).map_err(CaptureError::Waiting)?;
        let words = format!("Frame {} for {} ({}) is stored.", kept.number, kind.name(), role.name());
        let data = json!({ "session": name_of(session), "kind": kind, "shot": kept.number.to_string() });
        self.events().tell(Topic::CalibrationShot, words, data);
        Ok(kept)
    }

    /// The shot; a device that fails is brought back and it is taken again.
    fn frame(
        &self,
        hands: &mut Hands,
        role: Role,
        exposure: Option<Exposure>,
    ) -> Result<Measured, CaptureError> {
        let mut attempt = 1;
        loop {
            hands.progress.check()?;
            match self.one_frame(hands, role.is_lit_by_flash(), exposure) {
                Err(error) if attempt < ATTEMPTS && worth_another_try(&error, hands.bench) => {
                    attempt += 1;
                    self.bring_back(hands.bench, &error, hands.progress)?;
                }
                outcome => return outcome,
            }
        }
    }

    /// The dials go where they are wanted, and back.
    fn one_frame(
        &self,
        hands: &mut Hands,
        flash: bool,
        exposure: Option<Exposure>,
    ) -> Result<Measured, CaptureError> {
        let told = hands.lock()?;
        let Some(wanted) = exposure else { return hands.calibration_frame(flash) };
        let before = exposure_of(&told).ok_or(CaptureError::ExposureUntold)?;
        let set = Settings {
            shutter: Some(wanted.shutter),
            aperture: Some(wanted.aperture),
            iso: Some(wanted.iso),
            ..told.clone()
        };
        let outcome = hands.turn_dials(&told, &wanted).and_then(|_| hands.calibration_frame(flash));
        if let Err(error) = hands.turn_dials(&set, &before) {
            // The frame is good all the same.
            let words = format!("The dials could not be turned back to {before}: {error}");
            self.events().tell(Topic::Trouble, words, json!({ "code": error.code() }));
        }
        outcome
    }
}

impl Hands<'_> {
    fn calibration_frame(&mut self, flash: bool) -> Result<Measured, CaptureError> {
        // Without flash it is the light that is there, whatever the flash is; a gate is closed all the same.
        match self.bench.flash()? {
            FlashKind::Controller(_) => self.close_gate()?,
            FlashKind::Manual | FlashKind::None => {}
        }
        if !flash {
            return Ok((self.release()?, None));
        }
        self.arm(TAG)?;
        let shot = self.release()?;
        let Some(syncs) = self.count()? else { return Ok((shot, None)) };
        let record = FlashRecord { off: vec![], on: syncs };
        match record.on.iter().filter(|sync| sync.triggered).count() {
            1 => Ok((shot, record.energy_counts())),
            _ => Err(CaptureError::FrameMisfired),
        }
    }
}
