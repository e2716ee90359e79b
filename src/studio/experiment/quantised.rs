//! Tables 2.2 and 2.3: what rounding to whole numbers costs.
//!
//! As in the thesis, the photographs are free of noise and show no light bounced from surface to surface: room's
//! light, room and flash, each rounded to 8 or 14 bits. Truth is the unrounded flash image and the renderer's
//! reflectance.

use super::photo::{Both, Exposed, known, sum};
use super::{ExperimentError, Options, Outcome, Row, Table};
use crate::light::Ring;
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use crate::reflectance::observe::{Illumination, Lamp};
use crate::reflectance::stage::Stage;
use crate::scene::Camera;
use crate::studio::world::lab::{self, Lab, Setting, Shot};
use glam::{DAffine3, DVec2};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Stops of the studio's walk whose views are taken: a low one and a high one.
const STOPS: [usize; 2] = [1, 9];

/// The ring is simulated as this many rings of equal area, one inside the other, each at several turns about the
/// lens: round as it is, each turn gives the same but for the samples of its shadows.
const RINGS: usize = 4;
const TURNS: usize = 12;

/// Samples of a pixel's square along each side.
const GRID: usize = 4;

/// Floor of the studio, metres.
const FLOOR: f64 = 1.2;

/// Flash over its nominal energy in the "low factor" half of table 2.3.
const LOW: f32 = 0.125;

/// A view without bounces and the light of a white surface for a lamp of one DN.
struct Look {
    shot: Shot,
    white: Rgb,
}

/// What a pixel shows.
#[derive(Clone, Copy, PartialEq)]
enum Pixel {
    /// The spot at its centre.
    Spot,
    /// The mean over its square, as an antialiasing renderer gives it.
    Square,
}

fn looks(pixel: Pixel, options: Options, progress: &Progress) -> Result<Vec<Look>, ExperimentError> {
    let lab = Lab::new(Setting { floor: FLOOR, varnish: None, bounces: false });
    let stage = Stage::build(lab.meshes(), 1);
    let cameras = lab::studio_cameras();
    let stops = if options.quick { &STOPS[1..] } else { &STOPS };
    let mut looks = vec![];
    for stop in stops {
        let camera = &cameras[stop - 1];
        let shot = match (pixel, options.quick) {
            (Pixel::Spot, true) => lab.shoot_spots(camera, 256, options.seed, progress)?,
            (Pixel::Spot, false) => lab.shoot_spots(camera, 1024, options.seed, progress)?,
            (Pixel::Square, true) => lab.shoot(camera, (32, 8), options.seed, progress)?,
            (Pixel::Square, false) => lab.shoot(camera, (256, 64), options.seed, progress)?,
        };
        progress.report("simulating the flash", 0, 1);
        let white = white_without_bounces(&stage, camera, pixel, progress)?;
        looks.push(Look { shot, white });
    }
    Ok(looks)
}

/// What a white surface would read in each pixel, were the lamp's radiance the ring's own number of DN.
fn white_without_bounces(
    stage: &Stage,
    camera: &Camera,
    pixel: Pixel,
    progress: &Progress,
) -> Result<Rgb, Cancelled> {
    let lamp = Exposed { scale: 1.0, bits: 1 }.lamp(1.0);
    let (grid, rings, turns) = if pixel == Pixel::Spot { (1, RINGS, TURNS) } else { (GRID, 1, 2) };
    let lamps: Vec<Lamp> = (0..rings)
        .map(|k| {
            let (low, high) = (lamp.ring.inner.powi(2), lamp.ring.outer.powi(2));
            let radius = |part: usize| (low + (high - low) * part as f64 / rings as f64).sqrt();
            Lamp { ring: Ring { inner: radius(k), outer: radius(k + 1), ..lamp.ring }, ..lamp }
        })
        .collect();
    let turned: Vec<Camera> = (0..turns)
        .map(|k| {
            let turn = DAffine3::from_rotation_z(TAU * (k as f64 * 0.618_033_988_749_895).fract());
            Camera { world_from_camera: camera.world_from_camera * turn, ..camera.clone() }
        })
        .collect();
    let lights: Vec<Illumination> =
        turned.iter().flat_map(|camera| lamps.iter().map(|lamp| stage.illuminate(camera, lamp))).collect();
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut white = vec![[0.0; 3]; width * height];
    white.par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
        progress.check()?;
        for (x, value) in row.iter_mut().enumerate() {
            let at = |k: usize| {
                let inside = DVec2::new((k % grid) as f64, (k / grid) as f64) + 0.5;
                DVec2::new(x as f64, y as f64) + inside / grid as f64
            };
            let sum: Option<f64> = (0..grid * grid).map(|k| irradiance(stage, camera, &lights, at(k))).sum();
            // A pixel that looks past all surfaces keeps 0, which is not known.
            let unit = sum.unwrap_or(0.0) / (grid * grid * turns) as f64;
            *value = reading(&lamp, unit);
        }
        Ok::<_, Cancelled>(())
    })?;
    Ok(Image::from_fn(width, height, |x, y| white[y * width + x]))
}

/// Reading of a white surface in this irradiance per unit radiance.
fn reading(lamp: &Lamp, unit: f64) -> [f32; 3] {
    lamp.radiance.map(|r| (r * unit / PI) as f32)
}

/// Irradiance per unit radiance of all `lights` together where a pixel position meets a surface.
fn irradiance(stage: &Stage, camera: &Camera, lights: &[Illumination], at: DVec2) -> Option<f64> {
    let (origin, ray) = (camera.centre().as_vec3(), camera.ray(at).as_vec3());
    let hit = stage.elements.kernel().nearest(origin, ray, 0.0, f32::INFINITY)?;
    let (point, normal) = (origin + ray * hit.t, stage.elements.normal(hit.triangle as usize));
    let sum: f64 = lights.iter().map(|light| light.direct(point, normal)).sum();
    (normal.dot(ray) < 0.0).then_some(sum)
}

/// How the two photographs of one trial are taken.
#[derive(Clone, Copy)]
struct Trial {
    bits: u32,
    /// Flash over its nominal energy.
    energy: f32,
    /// Whether the room alone is exposed as brightly as room and flash together.
    own_exposure: bool,
}

/// Errors of the isolated flash (of the range) and of the reflectance.
fn errors(looks: &[Look], trial: Trial) -> Result<[Both; 2], ExperimentError> {
    let (mut flash, mut reflectance) = (Both::default(), Both::default());
    for Look { shot, white } in looks {
        let lit = sum(&shot.ambient, &shot.flash, trial.energy);
        let on = Exposed::for_object(&lit, &shot.object, trial.bits);
        let off = if trial.own_exposure {
            Exposed::for_object(&shot.ambient, &shot.object, trial.bits)
        } else {
            on
        };
        let known = known(&lit, &shot.ambient, on, off)?;
        let (gain, top) = ((on.scale * on.top()) as f32, on.top() as f32);
        flash.add(shot, |x, y| {
            let (p, truth) = (known.rgb.at(x, y), shot.flash.at(x, y));
            let told = *known.valid.at(x, y);
            told.then(|| [0, 1, 2].map(|c| (p[c] - truth[c] * trial.energy * gain) / top))
        });
        let white = white.map(|m| m.map(|m| m * trial.energy * gain));
        reflectance.add_reflectance(shot, &known, &white);
    }
    Ok([flash, reflectance])
}

fn rows(looks: &[Look], trial: Trial, thesis: Option<[[f64; 2]; 4]>) -> Result<Vec<Row>, ExperimentError> {
    let [flash, reflectance] = errors(looks, trial)?;
    let pair = |k: usize| thesis.map(|t| [t[k], t[k + 1]]);
    let rows = [flash.rows("flash", pair(0))?, reflectance.rows("reflectance", pair(2))?];
    Ok(rows.into_iter().flatten().collect())
}

/// Table 2.2, of 255: flash, flash object only, reflectance, reflectance object only.
const THESIS_POC: [[f64; 2]; 4] = [[0.2729, 0.5251], [0.0603, 0.2565], [0.9422, 2.4152], [0.1080, 0.9914]];

pub(super) fn poc(options: Options, progress: &Progress) -> Result<Outcome, ExperimentError> {
    let spots = looks(Pixel::Spot, options, progress)?;
    let squares = looks(Pixel::Square, options, progress)?;
    let mut tables = vec![];
    for (looks, how) in [(&spots, "a pixel is a spot"), (&squares, "a pixel is a square")] {
        for bits in [8, 14] {
            tables.push(Table {
                title: format!("Table 2.2, proof of concept, {bits} bits, {how}"),
                rows: rows(looks, Trial { bits, energy: 1.0, own_exposure: false }, Some(THESIS_POC))?,
            });
        }
    }
    Ok(Outcome {
        about: about(spots.len()),
        tables,
        notes: vec![
            "The thesis's photographs have 8 bits; its figures stand beside both.".into(),
            "Where a pixel is the mean over its square, the ratio of means is not the mean of ratios: across an \
             edge between two surfaces it parts from the truth whatever the bits."
                .into(),
        ],
    })
}

/// Table 2.3, of 255, in the same order; [same, own exposure][low, high flash].
const THESIS_PRECISION: [[[[f64; 2]; 4]; 2]; 2] = [
    [
        [[0.2602, 1.3186], [0.0627, 0.2608], [2.2833, 13.1587], [0.2851, 2.3622]],
        [[0.2719, 0.5301], [0.0620, 0.2679], [1.1626, 2.8791], [0.1333, 1.1902]],
    ],
    // The flash's rows of the low half are torn in the printed table and left out.
    [
        [[f64::NAN; 2], [0.0417, 0.2200], [1.4442, 13.3170], [0.1599, 2.0603]],
        [[f64::NAN, 0.4974], [0.0075, 0.2008], [0.0973, 2.6719], [-0.0272, 0.9783]],
    ],
];

pub(super) fn precision(options: Options, progress: &Progress) -> Result<Outcome, ExperimentError> {
    let looks = looks(Pixel::Spot, options, progress)?;
    let mut tables = vec![];
    for bits in [8, 14] {
        for (own, exposure) in ["one exposure", "the room exposed for itself"].into_iter().enumerate() {
            for (high, flash) in ["low flash", "high flash"].into_iter().enumerate() {
                let energy = if high == 1 { 1.0 } else { LOW };
                let trial = Trial { bits, energy, own_exposure: own == 1 };
                let mut rows = rows(&looks, trial, Some(THESIS_PRECISION[own][high]))?;
                for row in &mut rows {
                    row.thesis = row.thesis.filter(|t| t.iter().all(|v| v.is_finite()));
                }
                tables.push(Table { title: format!("Table 2.3, {bits} bits, {exposure}, {flash}"), rows });
            }
        }
    }
    let notes = vec![
        format!("Low flash: 1/{:.0} of the energy. The thesis's photographs have 8 bits.", 1.0 / LOW),
        "The thesis's table is torn in its last rows; what cannot be read is left out.".into(),
    ];
    Ok(Outcome { about: about(looks.len()), tables, notes })
}

fn about(views: usize) -> String {
    format!(
        "{views} view(s) of 336 x 224 pixels without noise and without bounces, rounded to whole numbers; the \
         object's brightest pixel at 92 % of the range. Estimate - truth; clipped pixels are not \
         counted, nor those where white is below ten times the rounding's own scatter."
    )
}
