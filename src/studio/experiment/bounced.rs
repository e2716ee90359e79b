//! Table 2.4: photographs with bounced light, and three opinions on how to simulate it.
//!
//! The photographs are the studio's own renders, all bounces in them, rounded to whole numbers. The irradiance is
//! simulated with bounces between white surfaces (the thesis), without bounces, and with the reflectance found so
//! far, again and again until it stands still (ours).

use super::photo::{Both, Exposed, known, sum};
use super::{ExperimentError, Options, Outcome, Row, Table};
use crate::light::Transport;
use crate::photometry::Known;
use crate::progress::Progress;
use crate::raster::Rgb;
use crate::reflectance::bounce::{Bounces, ViewLight, simulate};
use crate::reflectance::maps::view_maps;
use crate::reflectance::observe::{Lamp, View};
use crate::reflectance::stage::Stage;
use crate::scene::Camera;
use crate::studio::world::lab::{self, Lab, Setting, Shot};

/// Stops that also stand alone: a low one and a high one.
const ALONE: [usize; 2] = [1, 9];

/// One view of the walk.
struct Look {
    camera: Camera,
    shot: Shot,
    known: Known,
    lamp: Lamp,
}

/// Table 2.4, of 255: with bounces between white surfaces, and without; whole image and object only.
const THESIS_WHITE: [[f64; 2]; 2] = [[-31.8876, 32.4318], [-4.7059, 13.8529]];
const THESIS_NONE: [[f64; 2]; 2] = [[34.2450, 39.4582], [7.1200, 26.0751]];

pub(super) fn gi(options: Options, progress: &Progress) -> Result<Outcome, ExperimentError> {
    let lab = Lab::new(Setting { floor: 1.2, varnish: None, bounces: true });
    let stage = Stage::build(lab.meshes(), 1);
    let transport = stage.transport(progress)?;
    let stored = lab::stored(progress)?;
    let bits = if options.quick { vec![8] } else { vec![8, 14] };
    let mut tables = vec![];
    for bits in bits {
        let looks = looks(&stored, bits)?;
        let chosen: Vec<&Look> =
            if options.quick { looks.iter().step_by(2).collect() } else { looks.iter().collect() };
        let white = vec![[1.0; 3]; stage.patches.len()];
        let none = vec![[0.0; 3]; stage.patches.len()];
        let shared = estimate(&stage, &transport, &chosen, progress)?;
        let mut rows: Vec<Row> = vec![];
        for (name, rho, thesis) in [
            ("bounces between white surfaces", &white, Some(THESIS_WHITE)),
            ("no bounces", &none, Some(THESIS_NONE)),
            ("bounces with our estimate, all views", &shared, None),
        ] {
            let errors = errors(&stage, &transport, &chosen, rho, progress)?;
            rows.extend(errors.rows(name, thesis)?);
        }
        let mut alone = Both::default();
        for look in ALONE.iter().filter_map(|stop| looks.get(stop - 1)) {
            let rho = estimate(&stage, &transport, &[look], progress)?;
            add_errors(&stage, &transport, look, &rho, &mut alone, progress)?;
        }
        rows.extend(alone.rows("bounces with our estimate, one view alone", None)?);
        tables.push(Table {
            title: format!("Table 2.4, bounces in the photographs, {bits} bits, {} views", chosen.len()),
            rows,
        });
    }
    Ok(Outcome {
        about: "the studio's stops, 336 x 224 pixels, all bounces in the photographs, rounded to whole \
                numbers. Estimate - truth, image by image."
            .into(),
        tables,
        notes: vec![
            "The thesis had one view and 8 bits. \"One view alone\" simulates the bounces with what this view \
             itself tells; surfaces that it does not see take after those beside them."
                .into(),
        ],
    })
}

fn looks(stored: &[(Camera, Shot)], bits: u32) -> Result<Vec<Look>, ExperimentError> {
    let mut looks = vec![];
    for (camera, shot) in stored {
        let lit = sum(&shot.ambient, &shot.flash, 1.0);
        let exposed = Exposed::for_object(&lit, &shot.object, bits);
        let known = known(&lit, &shot.ambient, exposed, exposed)?;
        let copy = Shot {
            ambient: shot.ambient.clone(),
            flash: shot.flash.clone(),
            albedo: shot.albedo.clone(),
            object: shot.object.clone(),
        };
        looks.push(Look { camera: camera.clone(), shot: copy, known, lamp: exposed.lamp(1.0) });
    }
    Ok(looks)
}

/// Reflectance of the surface's patches as these views give it, bounces simulated again and again with it.
fn estimate(
    stage: &Stage,
    transport: &Transport,
    looks: &[&Look],
    progress: &Progress,
) -> Result<Vec<[f32; 3]>, ExperimentError> {
    let mut views = vec![];
    for look in looks {
        progress.check()?;
        let light = stage.illuminate(&look.camera, &look.lamp);
        let view = View { illumination: &light, known: &look.known };
        let spots = stage.direct_at_spots(&light);
        let (direct, seen) = (stage.mean(&spots), view.observe_patches(stage, &spots));
        views.push(ViewLight {
            eye: look.camera.centre().as_vec3(),
            direct,
            radiance: look.lamp.radiance,
            seen,
        });
    }
    Ok(Bounces::settle(stage, transport, &views, progress)?.rho)
}

fn errors(
    stage: &Stage,
    transport: &Transport,
    looks: &[&Look],
    rho: &[[f32; 3]],
    progress: &Progress,
) -> Result<Both, ExperimentError> {
    let mut errors = Both::default();
    for look in looks {
        add_errors(stage, transport, look, rho, &mut errors, progress)?;
    }
    Ok(errors)
}

fn add_errors(
    stage: &Stage,
    transport: &Transport,
    look: &Look,
    rho: &[[f32; 3]],
    errors: &mut Both,
    progress: &Progress,
) -> Result<(), ExperimentError> {
    let light = stage.illuminate(&look.camera, &look.lamp);
    let bounced = simulate(transport, &stage.direct(&light), look.lamp.radiance, rho, progress)?;
    let white: Rgb = view_maps(&light, &look.known, stage, &bounced, progress)?.white;
    errors.add_reflectance(&look.shot, &look.known, &white);
    Ok(())
}
