//! Tables 2.2 and 2.3: what rounding to whole numbers costs.
//!
//! As in the thesis, the photographs are free of noise and show no light bounced from surface to surface: room's
//! light, room and flash, each rounded to 8 or 14 bits. Truth is the unrounded flash image and the renderer's
//! reflectance.

use super::photo::{Both, Exposed, coarser, finer, known, sum};
use super::{ExperimentError, Options, Outcome, Row, Table};
use crate::photometry::Known;
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use crate::reflectance::maps::view_maps;
use crate::reflectance::texture::Stage;
use crate::scene::Camera;
use crate::studio::world::lab::{self, Lab, Setting, Shot};

/// Stops of the studio's walk whose views are taken: a low one and a high one.
const STOPS: [usize; 2] = [1, 9];

/// The irradiance map has this many times the photograph's pixels each way, and 2 x 2 samples in each.
const FINER: usize = 4;

/// Floor of the studio, metres.
const FLOOR: f64 = 1.2;

/// Flash over its nominal energy in the "low factor" half of table 2.3.
const LOW: f32 = 0.125;

/// A view without bounces and the light of a white surface for a lamp of one DN.
struct Look {
    shot: Shot,
    white: Rgb,
}

fn looks(options: Options, progress: &Progress) -> Result<Vec<Look>, ExperimentError> {
    let lab = Lab::new(Setting { floor: FLOOR, varnish: None, bounces: false });
    let rays = if options.quick { (32, 8) } else { (256, 64) };
    let stage = Stage::build(lab.meshes());
    let cameras = lab::studio_cameras();
    let stops = if options.quick { &STOPS[1..] } else { &STOPS };
    let mut looks = vec![];
    for stop in stops {
        let camera = &cameras[stop - 1];
        let shot = lab.shoot(camera, rays, options.seed, progress)?;
        progress.report("simulating the flash", 0, 1);
        let white = white_without_bounces(&stage, camera, progress)?;
        looks.push(Look { shot, white });
    }
    Ok(looks)
}

/// What a white surface would read, pixel by pixel, were the lamp's radiance the ring's own number of DN.
fn white_without_bounces(stage: &Stage, camera: &Camera, progress: &Progress) -> Result<Rgb, Cancelled> {
    let fine = finer(camera, FINER);
    let (width, height) = (fine.intrinsics.width, fine.intrinsics.height);
    let lamp = Exposed { scale: 1.0, bits: 1 }.lamp(1.0);
    let light = stage.illuminate(&fine, &lamp);
    // Only the light is wanted; nothing was read.
    let nothing = Known {
        rgb: Rgb::filled(width, height, [0.0; 3]),
        variance: Rgb::filled(width, height, [1.0; 3]),
        valid: Image::filled(width, height, false),
    };
    let dark = vec![[0.0; 3]; stage.elements.len()];
    let maps = view_maps(&light, &nothing, &stage.elements, &dark, progress)?;
    Ok(coarser(&maps.white, FINER))
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
    let looks = looks(options, progress)?;
    let table = |bits, thesis| {
        Ok::<_, ExperimentError>(Table {
            title: format!("Table 2.2, proof of concept, photographs of {bits} bits"),
            rows: rows(&looks, Trial { bits, energy: 1.0, own_exposure: false }, thesis)?,
        })
    };
    Ok(Outcome {
        about: about(looks.len()),
        tables: vec![table(8, Some(THESIS_POC))?, table(14, Some(THESIS_POC))?],
        notes: vec!["The thesis's photographs have 8 bits; its figures stand beside both.".into()],
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
    let looks = looks(options, progress)?;
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
         object's brightest pixel at 92 % of the range. Estimate - truth; clipped pixels are not counted."
    )
}
