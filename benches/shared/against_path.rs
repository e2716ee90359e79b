//! Scenes, and the simulated light's error against the studio's path trace.

use crate::samples::shared;
use glam::Vec3;
use rayon::prelude::*;
use unlit::calibration::FieldFactor;
use unlit::codec::tiff16;
use unlit::light::Ring;
use unlit::progress::Progress;
use unlit::raster::Rgb;
use unlit::reflectance::observe::Lamp;
use unlit::reflectance::stage::Stage;
use unlit::scene::import::blocks_exchange;
use unlit::scene::{Camera, Mesh, read_obj};
use unlit::studio::world::irradiance::{Light, Reference};

/// The flash of both scenes, metres.
const RADII: [f64; 2] = [0.035, 0.085];

/// A reflectance close to what white paint has.
const WHITE: f32 = 0.9;

/// Meshes (the object first), the object's reflectance, the cameras.
pub(crate) struct Scene {
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) texture: Rgb,
    pub(crate) cameras: Vec<Camera>,
}

/// Name, reflectance by patch, reflectance by mesh as the path tracer wants it.
pub(crate) type Painted = (&'static str, Vec<[f32; 3]>, Vec<Rgb>);

/// A surface point that a camera sees, and the light there.
pub(crate) struct Point {
    pub(crate) element: usize,
    pub(crate) at: [f32; 2],
    pub(crate) point: Vec3,
    pub(crate) normal: Vec3,
    pub(crate) reference: [Light; 2],
}

impl Scene {
    /// The shared scene.
    pub(crate) fn birdbath() -> Self {
        let file = |name: &str| shared(&format!("scenes/birdbath/{name}"));
        let meshes = ["geometry/object.obj", "geometry/floor.obj"];
        let xml = std::fs::read_to_string(file("geometry/cameras.xml")).unwrap();
        Self {
            meshes: meshes.map(|m| read_obj(&file(m), 1.0).unwrap()).into(),
            texture: tiff16::read_rgb(&file("truth/texture.tif")).unwrap().map(|p| p.map(|v| v.min(1.0))),
            cameras: blocks_exchange::parse(&xml).unwrap().cameras,
        }
    }

    /// The studio's own, with its cameras' frame made as large as the birdbath's.
    pub(crate) fn studio() -> Self {
        let known = unlit::studio::world::known(&Progress::silent()).unwrap();
        let mut cameras = known.cameras;
        for lens in cameras.iter_mut().map(|c| &mut c.intrinsics) {
            let scale = 600.0 / lens.width as f64;
            (lens.width, lens.height) = (600, 400);
            (lens.focal, lens.principal) = (lens.focal * scale, lens.principal * scale);
        }
        Self { meshes: vec![known.object, known.floor], texture: known.texture, cameras }
    }

    pub(crate) fn stage(&self) -> Stage {
        Stage::build(&self.meshes, 1)
    }

    /// The ring at a radiance of one.
    pub(crate) fn lamp(&self) -> Lamp {
        let ring = Ring::new(RADII[0], RADII[1]).unwrap();
        Lamp { ring, radiance: [1.0; 3], field: FieldFactor { coefficients: [0.0; 3] } }
    }

    /// White, and coloured by the truth.
    pub(crate) fn materials(&self, stage: &Stage) -> Vec<Painted> {
        let plain = |value: f32| Rgb::filled(1, 1, [value; 3]);
        let white = vec![[WHITE; 3]; stage.patches.len()];
        let (mut sum, mut count) = (white.clone(), vec![0.0f32; stage.patches.len()]);
        for p in 0..stage.patches.len() {
            if stage.patches.mesh_of(p) == 0 {
                sum[p] = [0.0; 3];
            } else {
                (sum[p], count[p]) = ([0.4; 3], 1.0);
            }
        }
        let n = 12;
        for triangle in 0..self.meshes[0].triangles.len() {
            let [a, b, c] = self.meshes[0].uv_corners(triangle).unwrap();
            for (i, j) in (0..n).flat_map(|i| (0..n - i).map(move |j| (i, j))) {
                let (u, v) = ((i as f32 + 0.33) / n as f32, (j as f32 + 0.33) / n as f32);
                let (element, _) = stage.elements.locate(0, triangle, u, v);
                let (patch, area) = (stage.patches.of(element), stage.elements.area(element));
                let uv = a * (1.0 - u - v) + b * u + c * v;
                let size = self.texture.width() as f32;
                let texel = |t: f32| (t * size).clamp(0.0, size - 1.0) as usize;
                let value = self.texture.at(texel(uv.x), texel(1.0 - uv.y));
                count[patch] += area;
                (0..3).for_each(|k| sum[patch][k] += area * value[k]);
            }
        }
        let coloured = sum.iter().zip(&count).map(|(s, n)| s.map(|s| s / n)).collect();
        vec![
            ("white", white, vec![plain(WHITE), plain(WHITE)]),
            ("true albedo", coloured, vec![self.texture.clone(), plain(0.4)]),
        ]
    }

    fn reference(&self, materials: &[Rgb]) -> Reference {
        Reference::new(self.meshes.iter().cloned().zip(materials.iter().cloned()).collect(), RADII)
    }

    pub(crate) fn direct_reference(&self, camera: &Camera, stride: usize) -> Vec<(usize, usize, [Light; 2])> {
        let dark = vec![Rgb::filled(1, 1, [0.0; 3]); self.meshes.len()];
        pixels(&self.reference(&dark), camera, stride, 256, false)
    }

    pub(crate) fn bounced_reference(
        &self,
        materials: &[Rgb],
        camera: &Camera,
        stride: usize,
    ) -> Vec<(usize, usize, [Light; 2])> {
        pixels(&self.reference(materials), camera, stride, 128, true)
    }

    /// Some `wanted` points, evenly spread over the image, that the camera sees of the object.
    pub(crate) fn points(
        &self,
        materials: &[Rgb],
        stage: &Stage,
        camera: &Camera,
        wanted: usize,
    ) -> Vec<Point> {
        let reference = self.reference(materials);
        let (width, height) = (camera.intrinsics.width as f64, camera.intrinsics.height as f64);
        let eye = camera.centre().as_vec3();
        (0..4 * wanted as u32)
            .into_par_iter()
            .filter_map(|i| {
                let spread = |step: f64| (f64::from(i) * step).fract();
                let pixel = glam::DVec2::new(spread(0.754_877_666) * width, spread(0.569_840_291) * height);
                let ray = camera.ray(pixel).as_vec3();
                let hit = stage.elements.kernel().nearest(eye, ray, 0.0, f32::INFINITY)?;
                let element = hit.triangle as usize;
                let normal = stage.elements.normal(element);
                if stage.elements.mesh_of(element) != 0 || normal.dot(ray) > -0.1 {
                    return None;
                }
                let [a, b, c] = *stage.elements.kernel().corners(hit.triangle);
                let point = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
                let reference = reference.point(camera, point, normal, i, 256);
                Some(Point { element, at: [hit.u, hit.v], point, normal, reference })
            })
            .collect()
    }
}

fn pixels(
    reference: &Reference,
    camera: &Camera,
    stride: usize,
    rays: u32,
    bounces: bool,
) -> Vec<(usize, usize, [Light; 2])> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let places: Vec<(usize, usize)> =
        (0..height).step_by(stride).flat_map(|y| (0..width).step_by(stride).map(move |x| (x, y))).collect();
    places
        .into_par_iter()
        .filter_map(|(x, y)| Some((x, y, reference.pixel(camera, (x, y), rays, bounces)?)))
        .collect()
}

/// How far values are off a reference that comes in two halves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Error {
    /// Mean error over the mean.
    pub(crate) bias: f64,
    /// Standard error of the bias by the reference's noise.
    pub(crate) bias_noise: f64,
    /// Root mean square error over the mean, the reference's noise taken out.
    pub(crate) rmse: f64,
    /// How many values were compared.
    pub(crate) count: usize,
    /// How many had a reference and no value.
    pub(crate) missing: usize,
}

impl Error {
    /// Of (value, first half, second half).
    pub(crate) fn of(values: impl Iterator<Item = (Option<f64>, f64, f64)>) -> Self {
        let (mut n, mut missing) = (0usize, 0);
        let (mut mean, mut off, mut square, mut noise) = (0.0, 0.0, 0.0, 0.0);
        for (value, a, b) in values {
            let Some(value) = value else {
                missing += 1;
                continue;
            };
            n += 1;
            mean += (a + b) / 2.0;
            off += value - (a + b) / 2.0;
            square += (value - a) * (value - b);
            noise += (a - b).powi(2) / 4.0;
        }
        Self {
            bias: off / mean,
            bias_noise: noise.sqrt() / mean,
            rmse: (square.max(0.0) * n as f64).sqrt() / mean,
            count: n,
            missing,
        }
    }

    pub(crate) fn print(&self, name: &str) {
        println!(
            "  {name:<40} bias {:>7.3} % (+-{:.3}) RMSE {:>6.2} % of {} ({} missing)",
            100.0 * self.bias,
            100.0 * self.bias_noise,
            100.0 * self.rmse,
            self.count,
            self.missing
        );
    }
}
