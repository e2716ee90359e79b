//! How steady the flash is, from lit frames alone: `calibration/steadiness.json` (a [`Record`]) and its figure.
//!
//! The light is averaged over the middle half of the frame, over the sites that are far from clipping in the first one:
//! were they chosen frame by frame, bright shots would lose their brightest sites and look steadier than they are. The
//! room must be dark, and nothing may move.

use super::calibrate::{Series, SeriesError, noise};
use super::flash::{FlashError, energy_beside, label};
use crate::calibration::statistics::Z95;
use crate::calibration::{Record, Steadiness, SteadyError, SteadyShot, steadiness};
use crate::export::chart::{self, Chart};
use crate::pair::Settings;
use crate::photometry::{Mosaic, NoNoise, NoiseGauge, NoiseModel};
use crate::progress::{Cancelled, Progress};
use crate::session::Session;
use std::path::PathBuf;

/// Share of the range below which a site of the first frame is safe from clipping in the others.
const SAFE: f64 = 0.85;

/// Kind of the record.
const KIND: &str = "steadiness";

/// Why steadiness was not found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SteadinessError {
    /// The frames do not make a series.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// The account of a shot's energy cannot be read.
    #[error(transparent)]
    Energy(#[from] FlashError),
    /// A frame at other settings.
    #[error(
        "{label} was shot at other settings than the first frame; shoot all frames with one shutter, aperture and ISO"
    )]
    Settings {
        /// The frame.
        label: String,
    },
    /// A frame of another size.
    #[error("{label} has another size than the first frame; give frames of one camera and format")]
    Size {
        /// The frame.
        label: String,
    },
    /// Clipped.
    #[error(
        "{label} is over-exposed where the first frame was not, or shows no unclipped site of a colour; shoot the series darker"
    )]
    Clipped {
        /// The frame.
        label: String,
    },
    /// Noise could not be measured.
    #[error(transparent)]
    Noise(#[from] NoNoise),
    /// The series says nothing.
    #[error(transparent)]
    Steady(#[from] SteadyError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A lit frame of the series.
#[derive(Clone, Debug, PartialEq)]
pub struct SteadyFile {
    /// Raw file.
    pub frame: PathBuf,
    /// Energy of its pulse, where it was measured, in any unit; else what `shot.json` beside the frame tells.
    pub energy_counts: Option<f64>,
}

/// What the first frame fixes.
struct First {
    settings: Settings,
    size: (usize, usize),
    noise: NoiseModel,
    /// Column and row of the sites that are averaged.
    sites: Vec<(u32, u32)>,
}

/// Tells from lit frames, in the order in which they were shot, how steady the flash is, and keeps it.
pub fn calibrate(
    session: &Session,
    files: &[SteadyFile],
    progress: &Progress,
) -> Result<Record<Steadiness>, SteadinessError> {
    let mut series = Series::new(session, KIND)?;
    let (mut shots, mut first) = (vec![], None::<First>);
    for (i, file) in files.iter().enumerate() {
        progress.check()?;
        progress.report("reading lit frames", i, files.len());
        let photo = series.read(&file.frame)?;
        let (label, frame) = (label(&file.frame), &photo.mosaic);
        let size = (frame.dn.width(), frame.dn.height());
        let known = match &mut first {
            Some(known) => known,
            empty => {
                let own = noise::of(session, &photo.settings).map_err(SeriesError::from)?;
                own.remark.into_iter().for_each(|remark| series.remark(remark));
                let mut gauge = NoiseGauge::default();
                gauge.add(frame);
                let measured_noise = own.model.map_or_else(|| gauge.fit(), Ok)?;
                let sites = safe_sites(frame);
                empty.insert(First { settings: photo.settings.clone(), size, noise: measured_noise, sites })
            }
        };
        let exposure = |s: &Settings| (s.shutter, s.aperture, s.iso);
        if exposure(&photo.settings) != exposure(&known.settings) {
            return Err(SteadinessError::Settings { label });
        }
        if size != known.size {
            return Err(SteadinessError::Size { label });
        }
        let energy_counts = match file.energy_counts {
            Some(energy) => Some(energy),
            None => energy_beside(&file.frame)?,
        };
        let Some((light_dn, light_dn_standard_error)) = mean_light(frame, known) else {
            return Err(SteadinessError::Clipped { label });
        };
        shots.push(SteadyShot {
            label,
            light_dn,
            light_dn_standard_error,
            energy_counts,
            ..SteadyShot::default()
        });
    }
    let found = steadiness(shots)?;
    let (verdict, figure) = (found.verdict(), picture(&found));
    let record = series.keep(found, verdict, &figure, progress)?;
    progress.report("reading lit frames", files.len(), files.len());
    Ok(record)
}

/// Sites of the frame's middle half that no later frame of a flash this steady can clip.
fn safe_sites(frame: &Mosaic) -> Vec<(u32, u32)> {
    let (width, height) = (frame.dn.width(), frame.dn.height());
    let places = (height / 4..3 * height / 4).flat_map(|y| (width / 4..3 * width / 4).map(move |x| (x, y)));
    let safe = |(x, y): &(usize, usize)| {
        let black = f64::from(frame.levels.black[y & 1][x & 1]);
        let saturation = f64::from(frame.levels.saturation[y & 1][x & 1]);
        f64::from(*frame.dn.at(*x, *y)) - black < SAFE * (saturation - black)
    };
    places.filter(safe).map(|(x, y)| (x as u32, y as u32)).collect()
}

/// Mean and its standard error of each colour over the sites; `None` if one of them clips, or a colour has none.
fn mean_light(frame: &Mosaic, known: &First) -> Option<([f64; 3], [f64; 3])> {
    let (mut light, mut count) = ([0.0; 3], [0.0f64; 3]);
    for &(x, y) in &known.sites {
        let (x, y) = (x as usize, y as usize);
        if frame.is_clipped(x, y) {
            return None;
        }
        let colour = frame.cfa.colour(x, y);
        light[colour] += f64::from(*frame.dn.at(x, y)) - f64::from(frame.levels.black[y & 1][x & 1]);
        count[colour] += 1.0;
    }
    if count.contains(&0.0) {
        return None;
    }
    let mean: [f64; 3] = std::array::from_fn(|c| light[c] / count[c]);
    let error = std::array::from_fn(|c| (f64::from(known.noise.variance(mean[c] as f32)) / count[c]).sqrt());
    Some((mean, error))
}

pub(super) fn picture(found: &Steadiness) -> Chart {
    let sensor = 100.0 * Z95 * found.sensor_deviation;
    let points = |of: &dyn Fn(&SteadyShot) -> Option<f64>| {
        let frames = found.frames.iter().enumerate();
        frames.filter_map(|(i, f)| Some((i as f64 + 1.0, 100.0 * (of(f)? - 1.0), sensor))).collect::<Vec<_>>()
    };
    let mut series =
        vec![chart::Series { name: "as they came".into(), points: points(&|f| Some(f.relative_light)) }];
    if found.corrected_deviation.is_some() {
        let points = points(&|f| f.relative_light_by_energy);
        series.push(chart::Series { name: "divided by the measured energy".into(), points });
    }
    Chart {
        caption: "Light of each frame against the mean of all; the intervals are those of the sensor's noise"
            .into(),
        across: "Frame".into(),
        up: "Light over the mean - 1, %".into(),
        series,
    }
}
