//! A walk round a stage with camera and flash: raw files into a session folder, as a photographer would bring
//! them, and the truth beside it.

use super::{ExperimentError, Options};
use crate::calibration::{Plane, Target};
use crate::codec::tiff16;
use crate::pipeline::flash::{self, CardFacts, CardFiles};
use crate::pipeline::process::{ProcessOptions, ProcessSummary, process};
use crate::pipeline::scene::{self, Lengths};
use crate::progress::Progress;
use crate::raster::blur::gaussian;
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, write_obj};
use crate::session::{More, NewFrame, NewPair, Session};
use crate::studio::truth::write_cameras;
use crate::studio::world::lab::{self, Lab};
use glam::DVec2;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Distances of the card in the calibration shots, metres.
const CARDS: [f64; 3] = [0.7, 1.0, 1.4];

/// Which mesh's texture is solved for.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Subject {
    Object,
    Floor,
}

/// What has been photographed.
pub(super) struct Walk {
    folder: tempfile::TempDir,
    pub(super) lab: Lab,
    pub(super) cameras: Vec<Camera>,
    /// Bytes and settings of each camera's frames: off, on.
    frames: Vec<[Frame; 2]>,
    /// True reflectance in each camera's pixels, before the lens.
    pub(super) albedo: Vec<Rgb>,
}

type Frame = (Vec<u8>, crate::pair::Settings);

impl Walk {
    /// Renders and exposes all views.
    pub(super) fn shoot(
        lab: Lab,
        cameras: Vec<Camera>,
        rays: (u32, u32),
        options: Options,
        progress: &Progress,
    ) -> Result<Self, ExperimentError> {
        let (mut frames, mut albedo) = (vec![], vec![]);
        for (i, camera) in cameras.iter().enumerate() {
            let seed = options.seed.wrapping_mul(10_007).wrapping_add(2 * i as u32);
            let shot = lab.shoot(camera, rays, seed, progress)?;
            let lit = super::photo::sum(&shot.ambient, &shot.flash, 1.0);
            let noise = u64::from(options.seed) << 32 | (2 * i as u64 + 1000);
            frames.push([lab::raw_file(&shot.ambient, noise)?, lab::raw_file(&lit, noise + 1)?]);
            albedo.push(shot.albedo);
        }
        let folder = tempfile::Builder::new().prefix("unlit-experiment").tempdir()?;
        Ok(Self { folder, lab, cameras, frames, albedo })
    }

    fn geometry(&self, subject: Subject) -> Result<(PathBuf, Vec<PathBuf>), ExperimentError> {
        let folder = self.folder.path().join("geometry");
        std::fs::create_dir_all(&folder)?;
        let cameras = folder.join("cameras.xml");
        write_cameras(&cameras, &self.cameras)?;
        let [object, floor] = ["object.obj", "floor.obj"].map(|name| folder.join(name));
        write_obj(&object, &self.lab.meshes()[0], &[])?;
        write_obj(&floor, &self.lab.meshes()[1], &[])?;
        let meshes = if subject == Subject::Object { vec![object, floor] } else { vec![floor, object] };
        Ok((cameras, meshes))
    }

    /// A session of this walk, calibrated from card shots and processed for the subject's texture.
    pub(super) fn process(
        &self,
        subject: Subject,
        texture_size: Option<usize>,
        views: bool,
        progress: &Progress,
    ) -> Result<(Session, ProcessSummary), ExperimentError> {
        let name = if subject == Subject::Object { "object" } else { "floor" };
        let session = Session::create(&self.folder.path().join(name), name)?;
        let (cameras, meshes) = self.geometry(subject)?;
        scene::import(&session, &cameras, &meshes, Lengths::default(), progress)?;
        let mut shots = vec![];
        for (i, distance) in CARDS.into_iter().enumerate() {
            let (bytes, _) = lab::raw_file(&lab::card(&self.cameras[0].intrinsics, distance), i as u64 + 1)?;
            let on = self.folder.path().join(format!("card{i}.dng"));
            std::fs::write(&on, bytes)?;
            shots.push(CardFiles { plane: Some(Plane::facing(distance)), on, off: None, held_out: false });
        }
        let (ring_radii, _) = lab::ring();
        let facts = CardFacts::plain(Target::lambertian(lab::CARD), ring_radii);
        flash::calibrate(&session, &shots, &facts, progress)?;
        for (camera, [off, on]) in self.cameras.iter().zip(&self.frames) {
            progress.check()?;
            session.commit_pair(NewPair {
                name: Some(&camera.name),
                off: new_frame("off.dng", off),
                on: new_frame("on.dng", on),
                reasons: vec![],
                flash: None,
                more: More::default(),
            })?;
        }
        let options = ProcessOptions { texture_size, views, ..Default::default() };
        let summary = process(&session, &options, progress)?;
        Ok((session, summary))
    }

    /// Writes the truth of the subject as `evaluate` reads it; gives its folder.
    pub(super) fn truth(&self, subject: Subject) -> Result<PathBuf, ExperimentError> {
        let (name, surface) = match subject {
            Subject::Object => ("truth-object", 0),
            Subject::Floor => ("truth-floor", 1),
        };
        let folder = self.folder.path().join(name);
        for part in ["albedo", "mask"] {
            std::fs::create_dir_all(folder.join(part))?;
        }
        for (camera, albedo) in self.cameras.iter().zip(&self.albedo) {
            let file = format!("{}.tif", camera.name);
            tiff16::write_rgb16(&folder.join("albedo").join(&file), &gaussian(albedo, lab::LENS_SIGMA))?;
            tiff16::write_grey8(&folder.join("mask").join(&file), &self.mask(camera, surface))?;
        }
        let facts =
            json!({ "sensor": { "lens_psf_sigma_px": f64::from(lab::LENS_SIGMA * 1e3).round() / 1e3 } });
        std::fs::write(folder.join("scene.json"), facts.to_string())?;
        Ok(folder)
    }

    /// 255 where all of a pixel's 3 x 3 rays meet the surface.
    fn mask(&self, camera: &Camera, surface: usize) -> Image<u8> {
        Image::from_fn(camera.intrinsics.width, camera.intrinsics.height, |x, y| {
            let whole = (0..9).all(|k| {
                let inside = DVec2::new((k % 3) as f64, (k / 3) as f64) / 2.0;
                let at =
                    DVec2::new(x as f64, y as f64) + inside.clamp(DVec2::splat(0.01), DVec2::splat(0.99));
                self.lab.shown(camera, at) == Some(surface)
            });
            if whole { 255 } else { 0 }
        })
    }

    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }
}

fn new_frame<'a>(original_name: &'a str, (bytes, settings): &'a Frame) -> NewFrame<'a> {
    NewFrame { bytes, original_name, settings: settings.clone(), prepared: None, jpeg: None }
}
