//! What solving leaves in `model/`: texture, deviations, views and summary.

use super::process::{Inputs, ProcessError, ProcessSummary, io};
use super::uvs;
use crate::codec::exr_image::{self, Exr, Meta};
use crate::raster::{Image, Rgb};
use crate::reflectance::atlas;
use crate::reflectance::range::OutOfRange;
use crate::reflectance::texture::Texture;
use crate::scene::Camera;
use crate::session::{Session, store};
use glam::Vec3;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

pub(super) fn summarise(inputs: &Inputs, texture: &Texture, size: usize) -> ProcessSummary {
    let (mut deviations, mut sum) = (vec![], [0.0f64; 3]);
    for e in texture.estimates().flatten() {
        deviations.push(e.sd.iter().sum::<f32>() / 3.0);
        for (sum, rho) in sum.iter_mut().zip(e.rho) {
            *sum += f64::from(rho);
        }
    }
    deviations.sort_by(f32::total_cmp);
    let seen = deviations.len();
    let surface = texture.surface.pixels().iter().filter(|s| **s).count();
    ProcessSummary {
        used: inputs.matched.iter().map(|(p, _)| p.name.clone()).collect(),
        left_out: inputs.left_out.clone(),
        remarks: inputs.remarks.clone(),
        texture_size: size,
        seen: seen as f64 / surface.max(1) as f64,
        median_deviation: deviations.get(seen / 2).map_or(0.0, |d| f64::from(*d)),
        mean_reflectance: sum.map(|s| s / seen.max(1) as f64),
        rounds: texture.rounds.clone(),
        runs: texture.runs.clone(),
        pieces: texture.pieces,
        looks: texture.looks,
        gains: inputs
            .matched
            .iter()
            .map(|(p, _)| p.name.clone())
            .zip(texture.gains.iter().copied())
            .collect(),
        ratios: inputs.scale.ratios(inputs.matched.iter().map(|(p, _)| p.as_ref()), &inputs.calibration),
        blur: texture.blur,
        gloss: texture.bounces.gloss.clone(),
        costs: vec![],
        turned: vec![],
        uv_choice: inputs.uvs.0,
        uvs: inputs.uvs.1.clone(),
        object: inputs.scene.meshes.first().map(uvs::digest).unwrap_or_default(),
        out_of_range: OutOfRange::of(texture.estimates().flatten().map(|e| e.rho)),
        up_to_date: false,
        views: (0, 0),
    }
}

pub(super) fn write(session: &Session, texture: &Texture) -> Result<(), ProcessError> {
    let model = session.model_dir();
    let meta = |what: &str| Meta {
        colour_space: Some("camera RGB, uncalibrated".into()),
        software: Some(concat!("unlit ", env!("CARGO_PKG_VERSION")).into()),
        comments: Some(what.into()),
    };
    let rho: Rgb = atlas::fill(&texture.filled());
    whole(&model.join("reflectance.exr"), |to| {
        exr_image::write_rgb(to, &rho, &meta("diffuse reflectance, 0 to 1; row 0 at v = 1"))
    })?;
    let sd =
        Image::from_fn(rho.width(), rho.height(), |x, y| texture.estimate(x, y).map_or([0.0; 3], |e| e.sd));
    whole(&model.join("stddev.exr"), |to| {
        exr_image::write_rgb(
            to,
            &sd,
            &meta(
                "standard deviation of the mean reflectance over a patch of 4x4 photo pixels; 0 where views.exr is 0",
            ),
        )
    })?;
    drop(sd);
    let views = texture.estimates().map(|e| e.map_or(0.0, |e| f32::from(e.views))).collect();
    let places = (0..rho.height()).flat_map(|y| (0..rho.width()).map(move |x| (x, y)));
    let residual = places.map(|(x, y)| texture.residual(x, y)).collect();
    let surface = texture.surface.pixels().iter().map(|on| f32::from(u8::from(*on))).collect();
    let counts = Exr {
        width: rho.width(),
        height: rho.height(),
        channels: vec![("Y".into(), views), ("residual".into(), residual), ("surface".into(), surface)],
        meta: meta(
            "Y: views that made up each texel; residual: how far their own means part, of 1; surface: 1 where the object is, 0 in the gutters; surface 1 and Y 0: not seen, filled",
        ),
    };
    whole(&model.join("views.exr"), |to| exr_image::write(to, counts))
}

/// Writes a file under a temporary name and gives it its own when it is whole.
pub(super) fn whole<E>(path: &Path, write: impl FnOnce(&Path) -> Result<(), E>) -> Result<(), ProcessError>
where
    ProcessError: From<E>,
{
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let beside = tempfile::Builder::new()
        .prefix(store::TEMPORARY_PREFIX)
        .suffix(".exr")
        // As every other file: readable by whom the process's mask lets read it.
        .permissions(std::fs::Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .map_err(io(folder))?;
    write(beside.path())?;
    beside.as_file().sync_all().map_err(io(path))?;
    beside.persist(path).map_err(|e| ProcessError::Io { path: path.to_owned(), source: e.error })?;
    store::sync_folder(folder).map_err(io(folder))
}

/// The world axis that the cameras hold up; `None` when they do not agree on one.
pub(super) fn up(cameras: &[Camera]) -> Option<Vec3> {
    let sum: glam::DVec3 = cameras.iter().map(|c| -c.world_from_camera.matrix3.y_axis).sum();
    let mean = (sum / cameras.len().max(1) as f64).as_vec3();
    let axis = mean.abs().max_position();
    let snapped = Vec3::AXES[axis] * mean[axis].signum();
    (mean.length() > 0.2 && mean.normalize().dot(snapped) > 0.8).then_some(snapped)
}
