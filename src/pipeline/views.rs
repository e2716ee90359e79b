//! Per-view images: `derived/views/NAME/{known,irradiance,reflectance}.exr`, for those who texture elsewhere.
//!
//! `known`: the flash's own light, linear camera RGB in DN, as a pulse of the calibration's energy would have given it. `irradiance`: what a white
//! Lambertian surface would have read there, bounces included, in DN. `reflectance` of the object is the
//! texture as this view sees it through its lens and what its own sites add to that, weighed by their noise; of other
//! surfaces the one over the other. A fourth channel A is 1 where it is known, 0 (and R, G, B 0) where the view shows
//! no mesh, sites were clipped, or too little light fell beside the object.

use super::develop::{known_sites, lamp};
use super::manifest::{StageManifest, digest};
use super::output::whole;
use super::process::{Inputs, ProcessError, ProcessOptions, io, process};
use super::solve::stage;
use crate::codec::exr_image::{self, Meta};
use crate::photometry::demosaic;
use crate::progress::Progress;
use crate::reflectance::bounce::{sent_by, sent_on, simulate};
use crate::reflectance::maps::{own_look, view_maps};
use crate::reflectance::project::Surroundings;
use crate::reflectance::projection::Projection;
use crate::session::{Session, store};

/// Reflectance of the surface's patches as the texture's run left it, three little-endian f32 a patch.
pub(super) const PATCHES: &str = "derived/patches.f32";

/// Makes the per-view images that are missing or out of date, and the texture if that is. Gives the numbers of
/// images made and of those that still stood.
pub fn ensure(session: &Session, progress: &Progress) -> Result<(usize, usize), ProcessError> {
    let stored = super::process::stored(session);
    let uvs = stored.as_ref().map(|s| s.uv_choice).unwrap_or_default();
    let texture_size = stored.map(|s| s.texture_size);
    let options = ProcessOptions { texture_size, views: true, uvs, ..ProcessOptions::default() };
    Ok(process(session, &options, progress)?.views)
}

pub(super) fn keep_patches(session: &Session, rho: &[[f32; 3]]) -> Result<(), ProcessError> {
    let path = session.path().join(PATCHES);
    let folder = session.derived_dir();
    std::fs::create_dir_all(&folder).map_err(io(&folder))?;
    let bytes: Vec<u8> = rho.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    store::write_atomic(&path, &bytes).map_err(io(&path))
}

fn patches(session: &Session) -> Result<Vec<[f32; 3]>, ProcessError> {
    let path = session.path().join(PATCHES);
    let bytes = std::fs::read(&path).map_err(io(&path))?;
    let number = |at: &[u8]| f32::from_le_bytes([at[0], at[1], at[2], at[3]]);
    Ok(bytes.chunks_exact(12).map(|e| [number(e), number(&e[4..]), number(&e[8..])]).collect())
}

/// The finished texture and its side.
fn texels(session: &Session) -> Result<(Vec<[f32; 3]>, usize), ProcessError> {
    let path = session.model_dir().join("reflectance.exr");
    let texture = exr_image::read(&path)?.rgb().filter(|t| t.width() == t.height());
    let texture = texture.ok_or(ProcessError::Stale(path))?;
    Ok((texture.pixels().to_vec(), texture.width()))
}

pub(super) fn make(
    session: &Session,
    inputs: &Inputs,
    manifest: &mut StageManifest,
    progress: &Progress,
) -> Result<(usize, usize), ProcessError> {
    let stage_name = |name: &str| format!("view {name}");
    let rho_file = session.path().join(PATCHES);
    let rho_digest = store::digest_file(&rho_file).map_err(io(&rho_file))?;
    let summary = super::process::stored(session).ok_or_else(|| ProcessError::Stale(rho_file.clone()))?;
    let texture_file = session.model_dir().join("reflectance.exr");
    let texture_digest = store::digest_file(&texture_file).map_err(io(&texture_file))?;
    let key = |name: &str| {
        let found = format!("{:?} {:?} {:?}", summary.gains.get(name), summary.blur, summary.gloss);
        let parts = [&inputs.key, &rho_digest, &texture_digest, name, &found];
        digest(&parts.map(str::as_bytes))
    };
    let (mut missing, mut standing) = (vec![], 0);
    for (pair, camera) in &inputs.matched {
        if manifest.is_done(session, &stage_name(&pair.name), &key(&pair.name)) {
            standing += 1;
        } else {
            missing.push((pair, camera));
        }
    }
    if missing.is_empty() {
        return Ok((0, standing));
    }
    let mut scene = inputs.scene.clone();
    let (stage, _) = stage(&mut scene, inputs.matched.len());
    let transport = stage.transport(progress)?;
    let rho = patches(session)?;
    if rho.len() != stage.patches.len() {
        return Err(ProcessError::Stale(rho_file));
    }
    let gloss = sent_by(&summary.gloss);
    // What a patch sends on: its reflectance, and what a gloss adds.
    let sent: Vec<[f32; 3]> = rho
        .iter()
        .enumerate()
        .map(|(p, rho)| sent_on(*rho, gloss.get(stage.patches.mesh_of(p)).copied().unwrap_or(0.0)))
        .collect();
    let (texels, size) = texels(session)?;
    let Some(around) = Surroundings::new(&scene.meshes, &stage, &rho, &summary.gloss, size) else {
        return Err(ProcessError::Stale(rho_file));
    };
    let made = missing.len();
    for (i, (pair, camera)) in missing.into_iter().enumerate() {
        progress.report("per-view images", i, made);
        let sites = known_sites(session, pair, &inputs.calibration)?;
        let gain = summary.gains.get(&pair.name).copied().unwrap_or(inputs.gain(pair));
        let known = demosaic(&sites, inputs.calibration.radiance_dn).at_reference(gain);
        let lamp = lamp(pair, &inputs.calibration, &inputs.scale)?;
        let light = stage.illuminate(camera, &lamp);
        let bounced = simulate(&transport, &stage.direct(&light), lamp.radiance, &sent, progress)?;
        let mut maps = view_maps(&light, &known, &stage, &bounced, progress)?;
        if let Some(view) = Projection::look(&around, &light, &bounced, &sites, progress)? {
            let own = own_look(&view, &texels, gain.value, summary.blur);
            for (to, from) in maps.reflectance.pixels_mut().iter_mut().zip(own.pixels()) {
                if from.is_some() {
                    *to = *from;
                }
            }
        }
        let folder = format!("derived/views/{}", pair.name);
        let names = ["known", "irradiance", "reflectance"].map(|n| format!("{folder}/{n}.exr"));
        let meta = |what: &str| Meta {
            colour_space: Some("camera RGB, uncalibrated".into()),
            software: Some(concat!("unlit ", env!("CARGO_PKG_VERSION")).into()),
            comments: Some(what.into()),
        };
        let [known_file, irradiance_file, reflectance_file] =
            names.each_ref().map(|n| session.path().join(n));
        whole(&known_file, |to| {
            exr_image::write_rgb(
                to,
                &known.rgb,
                &meta("light of the flash alone at the reference energy, DN; 0 where clipped"),
            )
        })?;
        whole(&irradiance_file, |to| {
            exr_image::write_rgb(
                to,
                &maps.white,
                &meta("reading of a white surface in the flash's light, DN"),
            )
        })?;
        let reflectance = maps.reflectance.map(|p| p.map_or([0.0; 4], |[r, g, b]| [r, g, b, 1.0]));
        whole(&reflectance_file, |to| {
            exr_image::write_rgba(
                to,
                &reflectance,
                &meta("reflectance as this view sees it; A = 1 where known"),
            )
        })?;
        let note = manifest.note(session, &stage_name(&pair.name), &key(&pair.name), &names);
        note.map_err(io(&session.derived_dir()))?;
    }
    Ok((made, standing))
}
