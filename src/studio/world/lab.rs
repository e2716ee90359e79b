//! The stage to experiment on: the same object, lamps and sensor with other cameras, another floor or a varnish.

use super::path::{Ring, Seen, Tracer};
use super::render::{self, Effort};
use super::sampler::{Sampler, combine};
use super::varnish::Varnish;
use super::{WorldError, cache, card, sensor, stage};
use crate::codec::dng::{self, DngContent, DngError};
use crate::pair::{Exposure, Settings};
use crate::progress::{Cancelled, Progress};
use crate::raster::blur::gaussian;
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, Intrinsics, Mesh};
use crate::units::{FNumber, Iso, Seconds};
use glam::{DVec2, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

pub(in crate::studio) use super::stage::Circle;

/// The lens blur, pixels.
pub(in crate::studio) const LENS_SIGMA: f32 = sensor::LENS_SIGMA;

/// Reflectance of the white card.
pub(in crate::studio) const CARD: f64 = card::REFLECTANCE;

/// Settings of every frame: those at which the studio's factors are all 1.
const EXPOSURE: Exposure =
    Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) };

/// Paths a spot that carry the room's light: the same in both frames of a pair, it goes out with the subtraction.
const SPOT_ROOM_RAYS: u32 = 32;

/// What is not as in the studio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::studio) struct Setting {
    /// Half the floor's width, metres.
    pub(in crate::studio) floor: f64,
    /// Gloss on the object.
    pub(in crate::studio) varnish: Option<Varnish>,
    /// Whether surfaces light each other.
    pub(in crate::studio) bounces: bool,
}

/// One camera's noise-free images, before lens and sensor.
pub(in crate::studio) struct Shot {
    /// Radiance by the room's light.
    pub(in crate::studio) ambient: Rgb,
    /// Radiance by the flash.
    pub(in crate::studio) flash: Rgb,
    /// Reflectance of the surface met (under its varnish); 0 beyond all surfaces.
    pub(in crate::studio) albedo: Rgb,
    /// Share of the pixel that is object.
    pub(in crate::studio) object: Image<f32>,
}

impl From<Image<Seen>> for Shot {
    fn from(image: Image<Seen>) -> Self {
        Self {
            ambient: image.map(|s| s.ambient),
            flash: image.map(|s| s.flash),
            albedo: image.map(|s| s.albedo),
            object: image.map(|s| s.object),
        }
    }
}

/// A stage that can be photographed.
pub(in crate::studio) struct Lab {
    tracer: Tracer,
    meshes: [Mesh; 2],
    textures: [Rgb; 2],
}

impl Lab {
    /// Builds the stage.
    pub(in crate::studio) fn new(setting: Setting) -> Self {
        let surfaces = stage::surfaces_on(setting.floor, setting.varnish);
        let textures = surfaces.each_ref().map(|surface| {
            let t = &surface.reflectance;
            Rgb::from_fn(t.size, t.size, |x, y| t.texels[y * t.size + x].map(|v| f32::from(v) / 65535.0))
        });
        let meshes = surfaces.each_ref().map(|surface| surface.mesh.clone());
        let tracer = stage::tracer(&surfaces);
        let tracer = if setting.bounces { tracer } else { tracer.without_bounces() };
        Self { tracer, meshes, textures }
    }

    /// Object and floor.
    pub(in crate::studio) fn meshes(&self) -> &[Mesh; 2] {
        &self.meshes
    }

    /// True reflectance of object and floor in their texture coordinates, row 0 at v = 1.
    pub(in crate::studio) fn textures(&self) -> &[Rgb; 2] {
        &self.textures
    }

    /// Renders one camera's images: twice `rays` a pixel on and about the object, twice `elsewhere` on the rest.
    pub(in crate::studio) fn shoot(
        &self,
        camera: &Camera,
        (rays, elsewhere): (u32, u32),
        seed: u32,
        progress: &Progress,
    ) -> Result<Shot, Cancelled> {
        let effort = Effort { object: rays, elsewhere, seed };
        let rows = 0..camera.intrinsics.height;
        Ok(render::render(&self.tracer, &stage::RING, camera, effort, rows, progress)?.image.into())
    }

    /// The same with every pixel the one spot at its centre, seen by `rays` paths: nothing is mixed in a pixel.
    pub(in crate::studio) fn shoot_spots(
        &self,
        camera: &Camera,
        rays: u32,
        seed: u32,
        progress: &Progress,
    ) -> Result<Shot, Cancelled> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let eye = camera.centre().as_vec3();
        let mut spots = vec![Seen::default(); width * height];
        let done = AtomicUsize::new(0);
        spots.par_chunks_mut(width).enumerate().try_for_each(|(y, row)| {
            progress.check()?;
            for (x, mean) in row.iter_mut().enumerate() {
                let way = camera.ray(DVec2::new(x as f64, y as f64) + 0.5).as_vec3();
                let room_rays = rays.min(SPOT_ROOM_RAYS);
                for index in 0..rays {
                    let mut sampler = Sampler::new(combine(seed, (y * width + x) as u32), index);
                    let ring = Some((&stage::RING, &camera.world_from_camera));
                    let mut seen = self.tracer.trace(eye, way, ring, index < room_rays, &mut sampler);
                    seen.ambient = seen.ambient.map(|a| a * rays as f32 / room_rays as f32);
                    mean.add(&seen, 1.0 / rays as f32);
                }
            }
            progress.report("rendering spots", done.fetch_add(1, Ordering::Relaxed) + 1, height);
            Ok::<_, Cancelled>(())
        })?;
        Ok(Image::from_fn(width, height, |x, y| spots[y * width + x]).into())
    }

    /// Which surface (0 object, 1 floor) a pixel position shows.
    pub(in crate::studio) fn shown(&self, camera: &Camera, at: DVec2) -> Option<usize> {
        self.tracer.surface_met(camera.centre().as_vec3(), camera.ray(at).as_vec3())
    }

    /// Whether a camera sees a surface point (metres) with this unit normal, inside its frame and less obliquely
    /// than at the cosine `grazing`.
    pub(in crate::studio) fn sees(&self, camera: &Camera, point: Vec3, normal: Vec3, grazing: f32) -> bool {
        let (lens, centre) = (&camera.intrinsics, camera.centre().as_vec3());
        let way = centre - point;
        let framed = camera.project(point.as_dvec3()).is_some_and(|(p, _)| {
            p.min_element() >= 0.0 && p.x < lens.width as f64 && p.y < lens.height as f64
        });
        framed && normal.dot(way) > grazing * way.length() && self.tracer.is_open(point, normal, centre)
    }
}

/// The studio's own noise-free images of all its stops, with all bounces, and their cameras.
pub(in crate::studio) fn stored(progress: &Progress) -> Result<Vec<(Camera, Shot)>, WorldError> {
    let cameras = stage::cameras();
    let renders = cache::load(&stage::surfaces(), &cameras, progress)?;
    Ok(cameras.into_iter().zip(renders.into_iter().map(|render| render.image.into())).collect())
}

/// Cameras of the studio's own walk.
pub(in crate::studio) fn studio_cameras() -> Vec<Camera> {
    stage::cameras()
}

/// Cameras on circles round the object.
pub(in crate::studio) fn cameras(circles: &[Circle], intrinsics: Intrinsics) -> Vec<Camera> {
    stage::cameras_on(circles, intrinsics)
}

/// Radiance of the white card at `distance` metres in the flash's light.
pub(in crate::studio) fn card(intrinsics: &Intrinsics, distance: f64) -> Rgb {
    card::radiance(&stage::RING, intrinsics, distance)
}

/// Through lens and sensor into a raw file, with the settings that are in it. `shot` seeds the noise.
pub(in crate::studio) fn raw_file(radiance: &Rgb, shot: u64) -> Result<(Vec<u8>, Settings), DngError> {
    let frame = sensor::expose(&gaussian(radiance, sensor::LENS_SIGMA), 1.0, shot);
    let settings = Settings {
        make: Some("Canon".into()),
        model: Some("Canon EOS 5DS".into()),
        shutter: Some(EXPOSURE.shutter),
        aperture: Some(EXPOSURE.aperture),
        iso: Some(EXPOSURE.iso),
        ..Settings::default()
    };
    let bytes = dng::encode(&DngContent {
        mosaic: &frame.mosaic,
        settings: &settings,
        masked_left: Some(&frame.masked),
    })?;
    Ok((bytes, settings))
}

/// The ring as measured with a ruler: inner and outer radius, metres, and its radiance.
pub(in crate::studio) fn ring() -> ([f64; 2], [f32; 3]) {
    let Ring { inner, outer, radiance } = stage::RING;
    // Written down in millimetres, so that the single precision of the tracer leaves no trace.
    ([inner, outer].map(|r| (f64::from(r) * 1e6).round() / 1e6), radiance)
}
