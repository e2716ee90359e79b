//! The flash calibration of a session: card shots in, `calibration/flash.json` out (a [`Record`], with its figure
//! `flash.svg`). Shots are read one by one and reduced to means over cells at once.

mod correct;
mod error;
mod order;
mod validity;
mod vignetting;

pub use correct::correct;
pub use error::FlashError;
pub use order::FlashOrder;
pub(super) use validity::{doubt, scaled_for};

use super::calibrate::{self, Series};
use super::card_tags::{self, TagFacts};
use super::develop::room_ratio;
use super::{levels, scene};
use crate::calibration::statistics::Z95;
use crate::calibration::tags::{CardPose, CardSight};
use crate::calibration::{
    CardShot, FieldFactor, FlashCalibration, FlashFacts, Plane, Record, Target, fit_flash,
};
use crate::export::chart::{self, Chart};
use crate::light::Ring;
use crate::pair::{FlashRecord, FrameRecord, Lighting, Settings};
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::{Mosaic, NoiseGauge};
use crate::pipeline::scale::SessionScale;
use crate::progress::Progress;
use crate::scene::{Distortion, Intrinsics};
use crate::session::{Session, store};
use glam::DVec2;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// One shot of the card.
#[derive(Clone, Debug, PartialEq)]
pub struct CardFiles {
    /// Where the card was, camera frame; absent where AprilTags tell.
    pub plane: Option<Plane>,
    /// The frame lit by the flash.
    pub on: PathBuf,
    /// The frame without it; absent for shots in a dark room.
    pub off: Option<PathBuf>,
    /// Keeps it from the fit, to check the fit by it.
    pub held_out: bool,
}

/// What is known beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct CardFacts {
    /// What the card reflects.
    pub target: Target,
    /// Whether its reflectance is that of office paper, taken for granted.
    pub paper: bool,
    /// The lens's vignetting, taken as it is; absent for the session's flat field, where it has one of this lens and
    /// aperture.
    pub vignetting: Option<FieldFactor>,
    /// Inner and outer radius of the ring, metres.
    pub ring_radii: [f64; 2],
    /// Focal length in pixels, where no scene tells it.
    pub focal_px: Option<f64>,
    /// Lets the shots tell the ring's radii where they can, in place of the ruler.
    pub free_radii: bool,
    /// Polariser and flash power of the shots, where they are not the session's.
    pub lighting: Option<Lighting>,
    /// AprilTags on the card.
    pub tags: Option<TagFacts>,
}

impl CardFacts {
    /// A card of known reflectance before a ring of these radii; everything else as the session has it.
    pub fn plain(target: Target, ring_radii: [f64; 2]) -> Self {
        Self {
            target,
            paper: false,
            vignetting: None,
            ring_radii,
            focal_px: None,
            free_radii: false,
            lighting: None,
            tags: None,
        }
    }
}

/// Kind of the record.
const KIND: &str = "flash";

/// Fits the flash to card shots and stores the result as `calibration/flash.json`; the shots' files are kept
/// under `calibration/flash/`.
pub fn calibrate(
    session: &Session,
    shots: &[CardFiles],
    facts: &CardFacts,
    progress: &Progress,
) -> Result<Record<FlashCalibration>, FlashError> {
    let ring = Ring::new(facts.ring_radii[0], facts.ring_radii[1])?;
    let mut reader = Reader::new(session, facts)?;
    let (mut cards, mut numbers) = (vec![], vec![]);
    for (i, shot) in shots.iter().enumerate() {
        progress.check()?;
        progress.report("reading card shots", i, shots.len());
        numbers.push(reader.series.shots().len());
        cards.push(reader.card(shot)?);
    }
    let settings = reader.first.ok_or(FlashError::NoShots)?;
    let size = cards.first().map(|c| c.size).ok_or(FlashError::NoShots)?;
    progress.report("fitting the flash", 0, 1);
    let mut series = reader.series;
    let own = calibrate::noise::of(session, &settings)?;
    own.remark.into_iter().for_each(|remark| series.remark(remark));
    let noise = match own.model {
        Some(measured) => measured,
        None => reader.gauge.fit()?,
    };
    let intrinsics = lens(session, size, facts.focal_px)?;
    let known = vignetting::of(session, series.rig(), &settings, facts.vignetting)?;
    if let Some(colours) = &known.colours {
        cards.iter_mut().for_each(|card| card.even_colours(colours));
    }
    let of_flash = FlashFacts {
        intrinsics: &intrinsics,
        ring,
        target: &facts.target,
        noise,
        vignetting: known.vignetting,
        free_radii: facts.free_radii,
    };
    let mut fit = fit_flash(&cards, &of_flash)?;
    fit.colour_vignetting = known.colours;
    fit.findings.flat_field = known.source;
    fit.findings.card_tags = reader.sights;
    tell_settings(&mut fit, &settings);
    progress.check()?;
    for (card, number) in fit.cards.iter().zip(numbers) {
        if let Some(why) = &card.left_out {
            series.leave_out(number, why.clone());
        }
    }
    let (mut verdict, figure) = (fit.verdict(facts.paper), picture(&fit));
    verdict.sentences.extend(known.sentence);
    verdict.sentences.extend(card_tags::sentences(&fit.findings.card_tags));
    verdict.sentences.extend(reader.notes);
    let record = series.keep(fit, verdict, &figure, progress)?;
    progress.report("fitting the flash", 1, 1);
    Ok(record)
}

fn tell_settings(fit: &mut FlashCalibration, settings: &Settings) {
    fit.iso = settings.iso.map(|s| s.0);
    fit.aperture = settings.aperture.map(|n| n.0);
    fit.focal_length_mm = settings.focal_length_mm;
}

/// Reads card shots one by one.
struct Reader<'a> {
    series: Series<'a>,
    measured: MeasuredLevels,
    scale: SessionScale,
    /// Settings of the first lit frame.
    first: Option<Settings>,
    /// Frames of the room that were read.
    rooms: HashSet<PathBuf>,
    gauge: NoiseGauge,
    session: &'a Session,
    focal_px: Option<f64>,
    tags: Option<TagFacts>,
    /// What the tags told, shot by shot.
    sights: Vec<CardSight>,
    /// What people must be told of shots whose tags tell nothing.
    notes: Vec<String>,
}

impl<'a> Reader<'a> {
    fn new(session: &'a Session, facts: &CardFacts) -> Result<Self, FlashError> {
        let mut series = Series::new(session, KIND)?;
        if let Some(lighting) = facts.lighting {
            series.lit(lighting);
        }
        Ok(Self {
            series,
            measured: levels::load(session)?,
            scale: SessionScale::load(session)?,
            first: None,
            rooms: HashSet::new(),
            gauge: NoiseGauge::default(),
            session,
            focal_px: facts.focal_px,
            tags: facts.tags,
            sights: vec![],
            notes: vec![],
        })
    }

    fn card(&mut self, shot: &CardFiles) -> Result<CardShot, FlashError> {
        let on = self.series.read(&shot.on)?;
        same_settings(self.first.get_or_insert_with(|| on.settings.clone()), &on.settings, &shot.on)?;
        let off = match &shot.off {
            // Several shots may share the frame of the room.
            Some(off) if !self.rooms.insert(off.clone()) => Some(levels::read(off, &self.measured)?),
            Some(off) => Some(self.series.read(off)?),
            None => None,
        };
        let label = label(&shot.on);
        let room = match &off {
            Some(off) => Some((&off.mosaic, room_ratio(&label, &self.scale, [&on.settings, &off.settings])?)),
            None => None,
        };
        self.gauge.add(&on.mosaic);
        let seen = self.seen(shot, &label, &on.mosaic, off.as_ref().map(|off| &off.mosaic))?;
        let plane = shot.plane.or(seen.as_ref().map(|(pose, _)| pose.plane));
        let plane = plane.ok_or_else(|| FlashError::NoDistance(label.clone()))?;
        let mut card = CardShot::reduce(label.clone(), plane, &on.mosaic, room)
            .map_err(|source| FlashError::Isolate { label: label.clone(), source })?;
        if let (Some((pose, intrinsics)), Some(facts)) = (seen, &self.tags) {
            let edge = card.edge as f64;
            card.cells.retain(|cell| !pose.covers(&intrinsics, cell.centre, edge, facts.outset()));
            let given_distance_m = shot.plane.map(|plane| plane.distance());
            self.sights.push(CardSight { label, given_distance_m, pose });
        }
        card.energy_counts = energy_beside(&shot.on)?;
        card.held_out = shot.held_out;
        Ok(card)
    }
}

impl Reader<'_> {
    /// Where the tags say that the card stands, and the lens. A shot whose distance is given need not show them.
    fn seen(
        &mut self,
        shot: &CardFiles,
        label: &str,
        on: &Mosaic,
        off: Option<&Mosaic>,
    ) -> Result<Option<(CardPose, Intrinsics)>, FlashError> {
        let Some(facts) = self.tags else { return Ok(None) };
        let intrinsics = lens(self.session, (on.dn.width(), on.dn.height()), self.focal_px)?;
        let frames: Vec<&Mosaic> = std::iter::once(on).chain(off).collect();
        match card_tags::look(&frames, &intrinsics, &facts) {
            Ok(pose) => Ok(Some((pose, intrinsics))),
            Err(error) if shot.plane.is_some() => {
                self.notes.push(format!(
                    "{label}: its distance was used unchecked, and a tag's black, if there is one, is in the fit: {error}."
                ));
                Ok(None)
            }
            Err(source) => Err(FlashError::Tags { label: label.to_owned(), source }),
        }
    }
}

/// Each shot's light over what the fit says of its distance.
pub(super) fn picture(fit: &FlashCalibration) -> Chart {
    let points = |held_out: bool| {
        let shown = fit.cards.iter().filter(move |c| c.held_out == held_out);
        shown
            .filter_map(|c| {
                let gain = c.gain? / c.measured_gain.unwrap_or(1.0);
                Some((c.distance_m, 100.0 * (gain - 1.0), 100.0 * Z95 * fit.findings.jitter_deviation))
            })
            .collect::<Vec<_>>()
    };
    let named = |name: &str, held_out: bool| {
        let points = points(held_out);
        (!points.is_empty()).then(|| chart::Series { name: name.to_owned(), points })
    };
    Chart {
        caption: "Light of the card shots against the fitted flash, over the card's distance; the intervals are those of the flash's jitter".into(),
        across: "Distance, m".into(),
        up: "Measured over fitted - 1, %".into(),
        series: [named("used for the fit", false), named("kept from the fit", true)]
            .into_iter()
            .flatten()
            .collect(),
    }
}

/// Reads the session's flash calibration with its origin.
pub fn record(session: &Session) -> Result<Record<FlashCalibration>, FlashError> {
    calibrate::load(session, KIND)?.ok_or_else(|| FlashError::None(session.path().to_owned()))
}

/// Reads the session's flash calibration.
pub fn load(session: &Session) -> Result<FlashCalibration, FlashError> {
    Ok(record(session)?.fit)
}

/// Whether the session has a flash calibration.
pub fn exists(session: &Session) -> bool {
    file(session).is_file()
}

pub(super) fn file(session: &Session) -> PathBuf {
    session.calibration_dir().join("flash.json")
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> FlashError + '_ {
    move |source| FlashError::Io { path: path.to_owned(), source }
}

/// File name, with its folder's where that alone would not tell shots apart (`d00700_1/on.cr2`).
pub(super) fn label(path: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    let own = name(path).unwrap_or_else(|| path.display().to_string());
    match path.parent().and_then(name) {
        Some(folder) if path.file_stem().is_some_and(|stem| stem == "on") => format!("{folder}/{own}"),
        _ => own,
    }
}

/// What is read of the record that capture keeps beside a card shot's frames.
#[derive(serde::Deserialize)]
struct ShotRecord {
    /// Absent of shots that wait, which nobody measured.
    #[serde(default)]
    on: Option<FrameRecord>,
    #[serde(default)]
    flash: Option<FlashRecord>,
}

/// Name of that record.
pub const SHOT_RECORD: &str = "shot.json";

/// Energy of a card shot's pulse, if the flash controller's account of this very frame lies beside it.
pub(super) fn energy_beside(frame: &Path) -> Result<Option<f64>, FlashError> {
    let path = frame.with_file_name(SHOT_RECORD);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(FlashError::Io { path, source }),
    };
    let record: ShotRecord = match serde_json::from_slice(&bytes) {
        Ok(record) => record,
        Err(error) => {
            tracing::warn!(
                "{} is no record of a card shot ({error}); its energy is not known",
                path.display()
            );
            return Ok(None);
        }
    };
    let Some(on) = record.on else { return Ok(None) };
    let same = frame.file_name().is_some_and(|name| name == on.file.as_str())
        && store::digest_file(frame).map_err(io(frame))? == on.blake3;
    Ok(record.flash.as_ref().filter(|_| same).and_then(FlashRecord::energy_counts))
}

/// The flash's light goes with ISO and aperture, not with the shutter.
fn same_settings(first: &Settings, next: &Settings, path: &Path) -> Result<(), FlashError> {
    let setting = if first.iso != next.iso {
        "ISO"
    } else if first.aperture != next.aperture {
        "aperture"
    } else if first.focal_length_mm != next.focal_length_mm {
        "focal length"
    } else {
        return Ok(());
    };
    Err(FlashError::Settings { label: label(path), setting })
}

/// The lens that took the shots: the scene's camera of the same size, else the focal length given.
fn lens(session: &Session, size: (usize, usize), focal_px: Option<f64>) -> Result<Intrinsics, FlashError> {
    if let Some(focal) = focal_px.filter(|f| f.is_finite() && *f > 0.0) {
        return Ok(Intrinsics {
            width: size.0,
            height: size.1,
            focal: DVec2::splat(focal),
            principal: DVec2::new(size.0 as f64, size.1 as f64) / 2.0,
            distortion: Distortion::default(),
        });
    }
    let scene = scene::load_file(session).map_err(|_| FlashError::NoLens)?;
    let fits = |i: &Intrinsics| (i.width, i.height) == size;
    scene.cameras.iter().map(|c| c.intrinsics).find(fits).ok_or(FlashError::NoLens)
}
