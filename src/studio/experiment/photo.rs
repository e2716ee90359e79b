//! Photographs as the thesis's experiments had them: noise-free renders rounded to whole numbers, three colours a
//! pixel, no filter array; and what the program makes of them.

use super::ExperimentError;
use super::table::Pool;
use crate::calibration::FieldFactor;
use crate::photometry::{Cfa, IsolateError, Known, LevelSource, Levels, Mosaic, NoiseModel, isolate};
use crate::raster::{Image, Rgb};
use crate::reflectance::maps::divided;
use crate::reflectance::observe::Lamp;
use crate::studio::world::lab::{self, Shot};

/// Brightest object pixels stand at this share of the range: well exposed, nothing clipped.
const WELL_EXPOSED: f64 = 0.92;

/// A camera without noise: radiance times `scale` is the share of the range, rounded to `bits`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exposed {
    pub(super) scale: f64,
    pub(super) bits: u32,
}

impl Exposed {
    /// Exposes an image so that the object's brightest parts are well exposed.
    pub(super) fn for_object(image: &Rgb, object: &Image<f32>, bits: u32) -> Self {
        let brightest = image
            .pixels()
            .iter()
            .zip(object.pixels())
            .filter(|(_, share)| **share > 0.0)
            .flat_map(|(p, _)| *p)
            .fold(1e-6, f32::max);
        Self { scale: WELL_EXPOSED / f64::from(brightest), bits }
    }

    /// Largest number of the file.
    pub(super) fn top(&self) -> f64 {
        f64::from((1u32 << self.bits) - 1)
    }

    /// DN a unit of radiance.
    fn gain(&self) -> f64 {
        self.scale * self.top()
    }

    fn frame(&self, radiance: &Rgb, channel: usize) -> Mosaic {
        let top = self.top();
        let gain = self.gain();
        Mosaic {
            dn: radiance.map(|p| (f64::from(p[channel]) * gain).round().clamp(0.0, top) as u16),
            cfa: Cfa::RGGB,
            levels: Levels {
                black: [[0.0; 2]; 2],
                saturation: [[top as f32; 2]; 2],
                black_source: LevelSource::FileTag,
                saturation_source: LevelSource::FileTag,
            },
        }
    }

    /// The flash as these photographs show it.
    pub(super) fn lamp(&self, energy: f64) -> Lamp {
        let ([inner, outer], radiance) = lab::ring();
        Lamp {
            ring: crate::light::Ring { inner, outer, offset: 0.0, lobe: 0.0 },
            radiance: radiance.map(|r| f64::from(r) * energy * self.gain()),
            field: FieldFactor { coefficients: [0.0; 3] },
        }
    }
}

/// The known light out of two rounded frames, by the program's own isolation, one colour at a time. `off` may be
/// exposed otherwise.
pub(super) fn known(lit: &Rgb, room: &Rgb, on: Exposed, off: Exposed) -> Result<Known, IsolateError> {
    let ratio = on.scale / off.scale;
    // Rounding alone: a twelfth of a step squared.
    let noise = NoiseModel { gain: 0.0, floor: 1.0 / 12.0 };
    let mut planes = vec![];
    for channel in 0..3 {
        planes.push(isolate(&on.frame(lit, channel), &off.frame(room, channel), ratio as f32, &noise)?);
    }
    let (width, height) = (lit.width(), lit.height());
    Ok(Known {
        rgb: Image::from_fn(width, height, |x, y| [0, 1, 2].map(|c| planes[c].value.at(x, y).unwrap_or(0.0))),
        variance: Image::from_fn(width, height, |x, y| [0, 1, 2].map(|c| *planes[c].variance.at(x, y))),
        valid: Image::from_fn(width, height, |x, y| planes.iter().all(|p| p.value.at(x, y).is_some())),
    })
}

/// Adds up two radiance images.
pub(super) fn sum(a: &Rgb, b: &Rgb, weight: f32) -> Rgb {
    Image::from_fn(a.width(), a.height(), |x, y| {
        let (a, b) = (a.at(x, y), b.at(x, y));
        [0, 1, 2].map(|c| a[c] + weight * b[c])
    })
}

/// Errors over the whole image and over the pixels that are object and nothing else.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Both {
    pub(super) whole: Pool,
    pub(super) object: Pool,
}

impl Both {
    /// Adds `error` at each pixel that has one.
    pub(super) fn add(&mut self, shot: &Shot, error: impl Fn(usize, usize) -> Option<[f32; 3]>) {
        for y in 0..shot.object.height() {
            for x in 0..shot.object.width() {
                if let Some(error) = error(x, y) {
                    self.whole.add(error);
                    if *shot.object.at(x, y) >= 1.0 {
                        self.object.add(error);
                    }
                }
            }
        }
    }

    /// Adds the errors of reflectance = known / white against a shot's truth, where the light is enough for the
    /// program to give a reflectance.
    pub(super) fn add_reflectance(&mut self, shot: &Shot, known: &Known, white: &Rgb) {
        self.add(shot, |x, y| {
            let (m, truth) = (white.at(x, y), shot.albedo.at(x, y));
            divided(known, x, y, *m).map(|rho| [0, 1, 2].map(|c| rho[c] - truth[c]))
        });
    }

    /// Rows for both, beside the thesis's figures of 255.
    pub(super) fn rows(
        &self,
        name: &str,
        thesis: Option<[[f64; 2]; 2]>,
    ) -> Result<[super::Row; 2], ExperimentError> {
        let row = |suffix: &str, pool: &Pool, k: usize| {
            Ok::<_, ExperimentError>(super::Row {
                name: format!("{name}{suffix}"),
                ours: pool.figures().ok_or(ExperimentError::Nothing("a photograph"))?,
                thesis: thesis.map(|t| super::table::of_255(t[k])),
            })
        };
        Ok([row("", &self.whole, 0)?, row(", object only", &self.object, 1)?])
    }
}
