//! The texture as a camera sees it: 16 stratified rays a pixel, nearest surface, bilinear lookup, pixel mean,
//! then the lens's blur.
//!
//! Rays that meet another mesh or nothing have no value. The blur is normalised by the share of a pixel's
//! rays that have one, so that nothing from outside the object bleeds in; the truth is blurred with its
//! background instead, but what is scored lies more than three standard deviations inside the object, where
//! the two are the same to a part in a thousand.

use crate::light::RayKernel;
use crate::progress::{Cancelled, Progress};
use crate::raster::blocks::dilate;
use crate::raster::blur::{gaussian, gaussian_radius};
use crate::raster::sample::bilinear;
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, Mesh, Scene};
use glam::DVec2;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Strata along each side of a pixel.
const STRATA: usize = 4;

pub(super) struct Renderer<'a> {
    kernel: RayKernel,
    object: &'a Mesh,
    texture: &'a Rgb,
}

impl<'a> Renderer<'a> {
    /// `None` unless the first mesh has texture coordinates for each of its triangles.
    pub(super) fn new(scene: &'a Scene, texture: &'a Rgb) -> Option<Self> {
        let object = scene.meshes.first()?;
        if object.uv_triangles.len() != object.triangles.len() {
            return None;
        }
        // The object comes first, so its triangles keep their indices.
        let triangles =
            scene.meshes.iter().flat_map(|m| (0..m.triangles.len()).map(|t| m.corners(t))).collect();
        Some(Self { kernel: RayKernel::build(triangles), object, texture })
    }

    /// Reflectance through the camera's lens, alpha 1 where the blurred value rests on the object alone;
    /// computed for the `wanted` pixels and 0 elsewhere.
    pub(super) fn view(
        &self,
        camera: &Camera,
        wanted: &Image<bool>,
        lens_sigma: f32,
        progress: &Progress,
    ) -> Result<Image<[f32; 4]>, Cancelled> {
        let (width, height) = (wanted.width(), wanted.height());
        let needed = dilate(wanted, gaussian_radius(lens_sigma));
        let mut sharp = Image::filled(width, height, [0.0; 4]);
        sharp.pixels_mut().par_chunks_mut(width.max(1)).enumerate().try_for_each(|(y, row)| {
            progress.check()?;
            let mut rng = ChaCha8Rng::seed_from_u64(y as u64);
            for (x, pixel) in row.iter_mut().enumerate() {
                if *needed.at(x, y) {
                    *pixel = self.pixel(camera, x, y, &mut rng);
                }
            }
            Ok::<_, Cancelled>(())
        })?;
        let blurred = gaussian(&sharp, lens_sigma);
        Ok(Image::from_fn(width, height, |x, y| {
            let [r, g, b, covered] = *blurred.at(x, y);
            // A wanted pixel that no ray found on the object is not known, whatever its neighbours say.
            if *wanted.at(x, y) && sharp.at(x, y)[3] > 0.0 && covered > 0.0 {
                [r / covered, g / covered, b / covered, 1.0]
            } else {
                [0.0; 4]
            }
        }))
    }

    /// Sum of the values over all strata, divided by their number, and the share of strata with a value.
    fn pixel(&self, camera: &Camera, x: usize, y: usize, rng: &mut ChaCha8Rng) -> [f32; 4] {
        let mut sum = [0.0; 4];
        for stratum in 0..STRATA * STRATA {
            let jitter = DVec2::new(rng.random(), rng.random());
            let corner = DVec2::new((stratum % STRATA) as f64, (stratum / STRATA) as f64);
            let position = DVec2::new(x as f64, y as f64) + (corner + jitter) / STRATA as f64;
            if let Some(value) = self.along(camera, position) {
                for (s, v) in sum.iter_mut().zip([value[0], value[1], value[2], 1.0]) {
                    *s += v;
                }
            }
        }
        sum.map(|s| s / (STRATA * STRATA) as f32)
    }

    /// Texture value where the ray through a pixel position first meets the scene, if that is the object.
    fn along(&self, camera: &Camera, position: DVec2) -> Option<[f32; 3]> {
        let direction = camera.ray(position).as_vec3();
        let hit = self.kernel.nearest(camera.centre().as_vec3(), direction, 1e-4, f32::INFINITY)?;
        let [a, b, c] = self.object.uv_corners(hit.triangle as usize)?;
        let uv = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        let (width, height) = (self.texture.width() as f32, self.texture.height() as f32);
        let value = bilinear(self.texture, uv.x * width, (1.0 - uv.y) * height)?;
        value.iter().all(|v| v.is_finite()).then_some(value)
    }
}
