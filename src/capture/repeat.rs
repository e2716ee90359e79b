//! How steady the known light is: many shots of one scene with nothing changed, each with the energy that the flash
//! controller measured of it (thesis, section 3.4; [`steadiness`] says what comes of them).
//!
//! Every shot is a dark frame and a lit one, proven by the controller's events as a pair's are, isolated on the sensor's
//! sites at scale 1 and averaged over the session's region (the middle half of the frame without one), sites that clip
//! left out. Frames are not kept: `calibration/repeatability.json` holds the figures of every shot.

use super::bench::FlashKind;
use super::engine::{ATTEMPTS, Engine, worth_another_try};
use super::error::CaptureError;
use super::events::Topic;
use super::hands::Hands;
use super::window::{MIDDLE, mean_light, part, safe_sites};
use crate::calibration::{FEWEST_SHOTS, SCHEMA, Steadiness, SteadyError, SteadyShot, steadiness};
use crate::pair::{FlashRecord, Reason, ReasonCode, Settings, Window, proof};
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::{Mosaic, NoiseModel, isolate};
use crate::pipeline::calibrate::{noise, report};
use crate::pipeline::energy::repeatability_file;
use crate::pipeline::levels;
use crate::progress::Progress;
use crate::raster::Image;
use crate::rig;
use crate::session::{Event, Session, SessionError, store, utc_now};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::HashSet;

/// Tags of the series at the flash controller begin here; pairs count from 1 up.
const TAGS: u32 = 0x8000_0000;
/// Shots that fail in a row before the series is given up.
const MOST_FAILURES_IN_A_ROW: u32 = 3;
/// `calibration/repeatability.json` ([`repeatability_file`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RepeatReport {
    /// Form of the file, that of the calibrations' records.
    pub schema: u32,
    /// When the series was taken, UTC.
    pub taken: String,
    /// The camera's settings of the first lit frame.
    pub settings: Settings,
    /// Where in the frame the light was averaged.
    pub region: Window,
    /// Shots that failed, were left out and taken again.
    pub left_out: u32,
    /// What calibrations of the session do not count for it, and why.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// What the series says.
    #[serde(flatten)]
    pub result: Steadiness,
}

/// A shot of the series, or why it does not count.
enum Outcome {
    Good(Box<Shot>),
    LeftOut(Reason),
}

/// Both frames of one shot, and what the controller measured of it.
struct Shot {
    off: Mosaic,
    on: Mosaic,
    /// Of the unlit and of the lit frame.
    settings: [Settings; 2],
    at: Option<f64>,
    energy_counts: f64,
    dark_energy_counts: f64,
}

/// What the shots of a series share.
struct Series<'a> {
    session: &'a Session,
    measured: &'a MeasuredLevels,
    window: Window,
    left_out: u32,
    /// What calibrations of the session do not count, and why.
    remarks: Vec<String>,
    /// What the first shot tells.
    first: Option<First>,
    /// Digests of the files that came, by which one that comes again is known.
    files: HashSet<String>,
}

/// What the first shot of a series fixes for the others.
struct First {
    /// Of its lit frame.
    settings: Settings,
    noise: NoiseModel,
    /// The sites that are averaged in every shot: far enough from clipping to stay unclipped in all of them. Were they
    /// chosen shot by shot, bright shots would lose their brightest sites, and look steadier than they are.
    sites: Image<bool>,
}

impl Engine {
    /// Shoots a series of `shots` (8 or more) of a plain surface, a card for instance, at the exposure on the camera's
    /// dials, and tells how far the known light spreads, as it comes and divided by the measured energy. Nobody may touch
    /// anything meanwhile. Shots that fail are told, left out and taken again. The report goes into the session.
    pub fn repeatability(
        &self,
        session: &Session,
        shots: usize,
        progress: &Progress,
    ) -> Result<Steadiness, CaptureError> {
        if shots < FEWEST_SHOTS {
            return Err(SteadyError::TooFew(shots).into());
        }
        let measured = levels::load(session).map_err(CaptureError::Levels)?;
        let window = session.manifest().region.unwrap_or(MIDDLE);
        let mut series = Series {
            session,
            measured: &measured,
            window,
            left_out: 0,
            remarks: vec![],
            first: None,
            files: HashSet::new(),
        };
        let mut bench = self.take_bench();
        let mut hands = Hands { bench: &mut bench, prompter: self.prompter(), progress };
        let taken = self.take_series(&mut hands, &mut series, shots);
        hands.disarm();
        drop(hands);
        drop(bench);
        let result = steadiness(taken?)?;
        let settings = series.first.map(|first| first.settings).unwrap_or_default();
        let (taken, left_out, remarks) = (utc_now(), series.left_out, series.remarks);
        for remark in &remarks {
            self.events().tell(Topic::Trouble, remark.clone(), json!({}));
        }
        let report = RepeatReport {
            schema: SCHEMA,
            taken,
            settings,
            region: window,
            left_out,
            remarks,
            result: result.clone(),
        };
        keep(session, &report)?;
        // The series counts from here on, whether anybody wants to stop or not.
        report::write(session, &progress.unstoppable())?;
        Ok(result)
    }

    fn take_series(
        &self,
        hands: &mut Hands,
        series: &mut Series,
        shots: usize,
    ) -> Result<Vec<SteadyShot>, CaptureError> {
        match hands.bench.flash()? {
            FlashKind::Controller(_) => {}
            FlashKind::Manual => return Err(CaptureError::NeedsController),
            FlashKind::None => return Err(CaptureError::NoFlash),
        }
        hands.lock()?;
        let mut taken = Vec::with_capacity(shots);
        let mut failed = 0;
        while taken.len() < shots {
            hands.progress.check()?;
            let number = taken.len() as u32 + 1;
            hands.progress.report(&format!("Shot {number} of {shots}"), taken.len(), shots);
            let reason = match self.take_shot(hands, series, number)? {
                Outcome::Good(shot) => match series.reading(number, &shot)? {
                    Ok(reading) => {
                        taken.push(reading);
                        failed = 0;
                        continue;
                    }
                    Err(reason) => reason,
                },
                Outcome::LeftOut(reason) => reason,
            };
            series.left_out += 1;
            failed += 1;
            if failed == MOST_FAILURES_IN_A_ROW {
                return Err(CaptureError::SeriesBroken { shot: number, times: failed, why: reason.sentence });
            }
            let words = format!("Shot {number} is left out and taken again: {}", reason.sentence);
            self.events().tell(Topic::Recovery, words, json!({ "code": reason.code }));
        }
        hands.progress.report("Series taken", shots, shots);
        Ok(taken)
    }

    /// One shot; a device that fails is brought back and both frames are taken again.
    fn take_shot(
        &self,
        hands: &mut Hands,
        series: &mut Series,
        number: u32,
    ) -> Result<Outcome, CaptureError> {
        let mut attempt = 1;
        loop {
            match hands.series_shot(series, number) {
                Err(error) if attempt < ATTEMPTS && worth_another_try(&error, hands.bench) => {
                    attempt += 1;
                    self.bring_back(hands.bench, &error, hands.progress)?;
                    hands.lock()?;
                }
                outcome => return outcome,
            }
        }
    }
}

impl Hands<'_> {
    fn series_shot(&mut self, series: &mut Series, number: u32) -> Result<Outcome, CaptureError> {
        self.darken()?;
        let off = self.release()?;
        let dark_syncs = self.count()?.unwrap_or_default();
        if let Some(reason) = proof::dark_frame(&dark_syncs) {
            return Ok(Outcome::LeftOut(reason));
        }
        let tag = TAGS + number;
        self.arm(tag)?;
        let on = self.release()?;
        let record = FlashRecord { off: dark_syncs, on: self.count()?.unwrap_or_default() };
        if let Some(reason) = proof::lit_frame(&record.on, tag, true) {
            return Ok(Outcome::LeftOut(reason));
        }
        let (Some(energy_counts), at) = (record.energy_counts(), record.pulse().and_then(|pulse| pulse.at))
        else {
            return Ok(Outcome::LeftOut(Reason {
                code: ReasonCode::Misfire,
                figure: record.pulse().map_or(0.0, |pulse| f64::from(pulse.clipped_samples)),
                limit: 0.0,
                sentence: "The photodiode was blinded by the flash, so that its energy is not known; move it farther \
                           from the tube or put paper before it."
                    .into(),
            }));
        };
        // Of dark syncs, most often one, the mean.
        let dark_energy_counts =
            record.off.iter().map(|sync| sync.energy_counts).sum::<f64>() / record.off.len().max(1) as f64;
        let off = series.decode(&off);
        let on = series.decode(&on);
        Ok(match (off, on) {
            (Ok((off, unlit)), Ok((on, lit))) => {
                let settings = [unlit, lit];
                Outcome::Good(Box::new(Shot { off, on, settings, at, energy_counts, dark_energy_counts }))
            }
            (Err(reason), _) | (_, Err(reason)) => Outcome::LeftOut(reason),
        })
    }
}

impl Series<'_> {
    /// The part of a frame that is averaged, if the file is new and whole.
    fn decode(&mut self, shot: &rig::Shot) -> Result<(Mosaic, Settings), Reason> {
        let refused = |code, sentence| Reason { code, figure: 1.0, limit: 0.0, sentence };
        if !self.files.insert(store::digest(&shot.raw.bytes)) {
            let words = "The camera gave a file of an earlier shot again; restart the camera if it goes on.";
            return Err(refused(ReasonCode::Repeated, words.into()));
        }
        let photo = levels::decode(&shot.raw.bytes, &shot.raw.name, self.measured).map_err(|error| {
            refused(ReasonCode::Unreadable, format!("The frame cannot be read: {error}."))
        })?;
        Ok((part(&photo.mosaic, self.window), photo.settings))
    }

    /// The figures of a shot; the reason why they do not count, if the camera was set otherwise than for the first.
    fn reading(&mut self, number: u32, shot: &Shot) -> Result<Result<SteadyShot, Reason>, CaptureError> {
        let exposure = |settings: &Settings| (settings.shutter, settings.aperture, settings.iso);
        let first = match &mut self.first {
            Some(first) => first,
            empty => empty.insert(First {
                settings: shot.settings[1].clone(),
                noise: {
                    let own = noise::of(self.session, &shot.settings[1]).map_err(CaptureError::Levels)?;
                    self.remarks.extend(levels::remark(self.measured, &shot.settings[1]));
                    self.remarks.extend(own.remark);
                    match own.model {
                        Some(measured) => measured,
                        None => NoiseModel::measure(&[shot.off.clone(), shot.on.clone()])?,
                    }
                },
                sites: safe_sites(&shot.on),
            }),
        };
        if shot.settings.iter().any(|settings| exposure(settings) != exposure(&first.settings)) {
            return Ok(Err(Reason {
                code: ReasonCode::SettingsChanged,
                figure: 1.0,
                limit: 0.0,
                sentence:
                    "The camera's settings differ from those of the first shot; leave the camera alone."
                        .into(),
            }));
        }
        let known = isolate(&shot.on, &shot.off, 1.0, &first.noise)?;
        let (light_dn, light_dn_standard_error) =
            mean_light(&known, &first.sites).ok_or(CaptureError::SeriesClipped { shot: number })?;
        Ok(Ok(SteadyShot {
            label: format!("shot {number}"),
            at: shot.at,
            light_dn,
            light_dn_standard_error,
            energy_counts: Some(shot.energy_counts),
            dark_energy_counts: Some(shot.dark_energy_counts),
            ..SteadyShot::default()
        }))
    }
}

fn keep(session: &Session, report: &RepeatReport) -> Result<(), CaptureError> {
    let path = repeatability_file(session);
    let json = serde_json::to_vec_pretty(report)
        .map_err(|e| SessionError::Damaged { path: path.clone(), why: e.to_string() })?;
    session.keep(&path, &json)?;
    let result = &report.result;
    let detail = json!({
        "shots": result.frames.len(),
        "light_deviation": result.light_deviation,
        "light_by_energy_deviation": result.light_by_energy_deviation,
    });
    session.record(Event::Note { what: "repeatability_measured".into(), detail })?;
    Ok(())
}

/// What a series says, in one sentence.
pub fn words_on_repeatability(result: &Steadiness) -> String {
    let percent = |part: f64| format!("{:.3} %", 100.0 * part);
    format!(
        "Known light: standard deviation {} over {} shots; divided by the measured energy: {}.",
        percent(result.light_deviation),
        result.frames.len(),
        result.light_by_energy_deviation.map_or_else(|| "not known".into(), percent)
    )
}
