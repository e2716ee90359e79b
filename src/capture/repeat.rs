//! How steady the known light is: many shots of one scene with nothing changed, each with the energy that the flash
//! controller measured of it (thesis, section 3.4; [`repeatability`] says what comes of them).
//!
//! Every shot is a dark frame and a lit one, proven by the controller's events as a pair's are, isolated on the sensor's
//! sites at scale 1 and averaged over the session's region (the middle half of the frame without one), sites that clip
//! left out. Frames are not kept: `calibration/repeatability.json` holds the figures of every shot.

use super::bench::FlashKind;
use super::engine::{ATTEMPTS, Engine, worth_another_try};
use super::error::CaptureError;
use super::events::Topic;
use super::hands::Hands;
use crate::pair::energy::{FEWEST_SHOTS, RepeatError, RepeatShot, Repeatability, repeatability};
use crate::pair::{FlashRecord, Reason, ReasonCode, Settings, Window, proof};
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::{KnownMosaic, Mosaic, NoiseModel, isolate};
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
/// Share of the range below which a site of the first lit frame is safe from clipping in the others.
const SAFE: f32 = 0.85;
/// Where the light is averaged when the session has no region.
const MIDDLE: Window = Window { x: 0.25, y: 0.25, width: 0.5, height: 0.5 };

/// `calibration/repeatability.json` ([`repeatability_file`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RepeatReport {
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
    pub result: Repeatability,
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
    ) -> Result<Repeatability, CaptureError> {
        if shots < FEWEST_SHOTS {
            return Err(RepeatError::TooFew(shots).into());
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
        let result = repeatability(&taken?)?;
        let settings = series.first.map(|first| first.settings).unwrap_or_default();
        let (taken, left_out, remarks) = (utc_now(), series.left_out, series.remarks);
        for remark in &remarks {
            self.events().tell(Topic::Trouble, remark.clone(), json!({}));
        }
        let report =
            RepeatReport { taken, settings, region: window, left_out, remarks, result: result.clone() };
        keep(session, &report)?;
        report::write(session, progress)?;
        Ok(result)
    }

    fn take_series(
        &self,
        hands: &mut Hands,
        series: &mut Series,
        shots: usize,
    ) -> Result<Vec<RepeatShot>, CaptureError> {
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
    fn reading(&mut self, number: u32, shot: &Shot) -> Result<Result<RepeatShot, Reason>, CaptureError> {
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
        let (light, light_error) =
            mean_light(&known, &first.sites).ok_or(CaptureError::SeriesClipped { shot: number })?;
        let Shot { at, energy_counts, dark_energy_counts, .. } = *shot;
        Ok(Ok(RepeatShot { number, at, light, light_error, energy_counts, dark_energy_counts }))
    }
}

/// Sites of a lit frame that no later shot of a flash this steady can clip.
fn safe_sites(on: &Mosaic) -> Image<bool> {
    Image::from_fn(on.dn.width(), on.dn.height(), |x, y| {
        let (black, saturation) = (on.levels.black[y & 1][x & 1], on.levels.saturation[y & 1][x & 1]);
        f32::from(*on.dn.at(x, y)) - black < SAFE * (saturation - black)
    })
}

/// The sites of a window, whole cells of the filter array, so that colours and levels stay as they are.
fn part(frame: &Mosaic, window: Window) -> Mosaic {
    let region = window.sites(frame.dn.width(), frame.dn.height());
    let (x0, y0) = (region.x & !1, region.y & !1);
    let dn = Image::from_fn(region.width, region.height, |x, y| *frame.dn.at(x0 + x, y0 + y));
    Mosaic { dn, cfa: frame.cfa, levels: frame.levels }
}

/// Mean and its standard error of each colour over the given sites; `None` if one of them clips, or a colour has none.
fn mean_light(known: &KnownMosaic, sites: &Image<bool>) -> Option<([f64; 3], [f64; 3])> {
    let (mut light, mut variance, mut count) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    for y in 0..known.value.height() {
        for x in (0..known.value.width()).filter(|x| *sites.at(*x, y)) {
            let colour = known.cfa.colour(x, y);
            light[colour] += f64::from((*known.value.at(x, y))?);
            variance[colour] += f64::from(*known.variance.at(x, y));
            count[colour] += 1.0;
        }
    }
    count.iter().all(|n| *n > 0.0).then(|| {
        let of = |c: usize| (light[c] / count[c], variance[c].sqrt() / count[c]);
        let [r, g, b] = [of(0), of(1), of(2)];
        ([r.0, g.0, b.0], [r.1, g.1, b.1])
    })
}

fn keep(session: &Session, report: &RepeatReport) -> Result<(), CaptureError> {
    let path = repeatability_file(session);
    let json = serde_json::to_vec_pretty(report)
        .map_err(|e| SessionError::Damaged { path: path.clone(), why: e.to_string() })?;
    session.keep(&path, &json)?;
    let result = &report.result;
    let detail = json!({
        "shots": result.shots.len(), "spread": result.spread, "corrected": result.corrected,
    });
    session.record(Event::Note { what: "repeatability_measured".into(), detail })?;
    Ok(())
}

/// What a series says, in one sentence.
pub fn words_on_repeatability(result: &Repeatability) -> String {
    let percent = |part: f64| format!("{:.3} %", 100.0 * part);
    format!(
        "Known light: standard deviation {} over {} shots; divided by the measured energy: {}.",
        percent(result.spread),
        result.shots.len(),
        percent(result.corrected)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};

    fn frame(dn: impl FnMut(usize, usize) -> u16) -> Mosaic {
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[15300.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn: Image::from_fn(64, 48, dn), cfa: Cfa::RGGB, levels }
    }

    #[test]
    fn the_light_is_averaged_by_colour_in_the_window_without_clipped_sites() {
        let noise = NoiseModel { gain: 0.0, floor: 4.0 };
        let light = |x: usize, y: usize| [1000, 2000, 3000][Cfa::RGGB.colour(x, y)];
        let off = frame(|_, _| 2100);
        let on = frame(|x, y| match (x, y) {
            (20, 20) => 15300,
            _ if x < 16 => 9000,
            _ => 2100 + light(x, y),
        });
        let [off, on] = [&off, &on].map(|f| part(f, MIDDLE));
        assert_eq!((on.dn.width(), on.dn.height()), (32, 24));
        let sites = safe_sites(&on);
        let (mean, error) = mean_light(&isolate(&on, &off, 1.0, &noise).unwrap(), &sites).unwrap();
        assert_eq!(mean, [1000.0, 2000.0, 3000.0]);
        // Two frames of variance 4 over 191, 384 and 192 sites.
        for (error, sites) in error.into_iter().zip([191.0, 384.0, 192.0]) {
            assert!((error - (8.0_f64 / sites).sqrt()).abs() < 1e-9, "{error} for {sites} sites");
        }
        let blown = part(&frame(|_, _| 15300), MIDDLE);
        let known = isolate(&blown, &off, 1.0, &noise).unwrap();
        assert_eq!(mean_light(&known, &sites), None, "a site that was safe clips");
        assert_eq!(mean_light(&known, &safe_sites(&blown)), None, "no site is safe");
    }

    #[test]
    fn sites_near_saturation_do_not_make_a_flash_look_steady() {
        let noise = NoiseModel { gain: 0.0, floor: 4.0 };
        let off = frame(|_, _| 2048);
        // A tenth of the sites ends just below saturation at nominal energy.
        let shot = |energy: f64| {
            frame(|x, y| {
                let light = if (x / 2 + y / 2) % 10 == 0 { 12_900.0 } else { 6_000.0 };
                (2048.0 + light * energy).min(15300.0) as u16
            })
        };
        let sites = safe_sites(&shot(1.0));
        let mean =
            |energy: f64| mean_light(&isolate(&shot(energy), &off, 1.0, &noise).unwrap(), &sites).unwrap().0;
        let (low, high) = (mean(0.97), mean(1.03));
        assert!((high[1] / low[1] / (1.03 / 0.97) - 1.0).abs() < 1e-3, "{low:?} {high:?}");
    }
}
