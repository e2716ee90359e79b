//! A photograph as a linear function of the texture: what every sensor site would have read.
//!
//! Through each pixel of the part of the frame that shows the object go `GRID` x `GRID` rays. Where one meets the
//! object, the light that a white surface would have sent back there is known (direct flash, bounces, field factor:
//! `white`, DN), so that the reading of a site of colour c is
//!
//! ```text
//! P_s = g * sum over pixels p of L(s - p) * ( mean over rays r of p of white_c(r) * rho_c(r)  +  other_c(p) )
//! ```
//!
//! with rho bilinear between texels, L the lens's blur (a Gaussian), g the pulse's energy and `other` the light from
//! surfaces that the texture does not hold. Sites are compared as the sensor has them, one colour each: nothing is
//! demosaiced. The transpose of the same function carries residuals back to the texels. (Irani and Peleg, "Improving
//! resolution by image registration", 1991, for the idea of solving in the scene for what blurred images show.)

use super::bounce::{sent_by, sent_on};
use super::mirror::{FEW, mirrored};
use super::observe::{GRAZING, Illumination};
use super::projection::{Projection, Ray, Site, WIDEST_BLUR, Window};
use super::robust::Lobe;
use super::stage::Stage;
use crate::light::{Draw, RayKernel, interpolate};
use crate::photometry::KnownMosaic;
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::raster::blocks::dilate;
use crate::raster::blur::gaussian_radius;
use crate::scene::{Camera, Mesh};
use glam::{DVec2, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Rays along each side of a pixel.
pub(super) const GRID: usize = 2;

/// The rays of a pixel share one shadow test if their surfaces part by no more than this (cosine), and lie no
/// farther apart than so many pixels' footprints.
const ONE_FACE: f32 = 0.95;
const ONE_PLACE: f32 = 4.0;

/// Points of the lamp that each ray's surface asks, where it may lie in shadow; a pixel's rays ask different ones.
const LAMP_POINTS: u32 = 8;

/// Step of the search for the object, pixels; what lies within a step and the blur's reach of it counts.
const SEARCH_STEP: usize = 2;

/// Rows of the window that are looked at together.
const ROWS: usize = 128;

/// By how much texture coordinates may leave the unit square by rounding.
const OUTSIDE: f32 = 1e-4;

/// What one ray finds on the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Pixel of the window, row-major.
    pub(super) pixel: u32,
    /// Upper left of the four texels of the whole texture, row-major, and where between them.
    pub(super) texel: u32,
    pub(super) at: [f32; 2],
    /// What white would add to the pixel's reading, DN.
    pub(super) white: [f32; 3],
}

/// What surrounds the views: meshes, elements, and rays against the meshes' own triangles.
pub struct Surroundings<'a> {
    object: &'a Mesh,
    kernel: RayKernel,
    /// (mesh, triangle) of each of the kernel's triangles.
    owners: Vec<(u32, u32)>,
    stage: &'a Stage,
    /// Reflectance by element corner.
    rho: Vec<[[f32; 3]; 3]>,
    /// Gloss of each mesh, where one was found; its light is `other` light.
    gloss: Vec<Option<Lobe>>,
    size: usize,
    /// By element, whether the texture holds it; `None`: all of the object.
    held: Option<Vec<bool>>,
}

impl<'a> Surroundings<'a> {
    /// From now on only such patches of the object (`patches[p]`) are looked at as texture, and the others as one looks at
    /// other meshes; `None`: all of them.
    pub fn hold(&mut self, patches: Option<&[bool]>) {
        let stage = self.stage;
        let held =
            |patches: &[bool]| (0..stage.elements.len()).map(|e| patches[stage.patches.of(e)]).collect();
        self.held = patches.map(held);
    }

    fn holds(&self, element: usize) -> bool {
        match &self.held {
            Some(held) => held[element],
            None => self.stage.elements.mesh_of(element) == 0,
        }
    }

    /// Meshes (the object first), the stage made of them, its patches' reflectance, the meshes' gloss, and the
    /// texture's side.
    pub fn new(
        meshes: &'a [Mesh],
        stage: &'a Stage,
        rho: &[[f32; 3]],
        gloss: &[Option<Lobe>],
        size: usize,
    ) -> Option<Self> {
        let object = meshes.first()?;
        let (mut corners, mut owners) = (vec![], vec![]);
        for (m, mesh) in meshes.iter().enumerate() {
            for t in 0..mesh.triangles.len() {
                corners.push(mesh.corners(t));
                owners.push((m as u32, t as u32));
            }
        }
        let kernel = RayKernel::build(corners);
        let rho = stage.smooth(rho);
        Some(Self { object, kernel, owners, stage, rho, gloss: gloss.to_vec(), size, held: None })
    }
}

impl Window {
    /// Bounds of the projection of what the texture holds, with room for the lens's blur; `None` where nothing of it is
    /// in the frame.
    fn of(camera: &Camera, around: &Surroundings) -> Option<Self> {
        let object = around.object;
        let (mut low, mut high) = (DVec2::MAX, DVec2::MIN);
        let held: Box<dyn Iterator<Item = Vec3>> = match &around.held {
            None => Box::new(object.positions.iter().copied()),
            Some(held) => {
                let kernel = around.stage.elements.kernel();
                let held = held.iter().enumerate().filter(|(_, held)| **held);
                Box::new(held.flat_map(move |(e, _)| *kernel.corners(e as u32)))
            }
        };
        for p in held.filter(|p| p.is_finite()) {
            match camera.project(p.as_dvec3()) {
                Some((pixel, _)) => (low, high) = (low.min(pixel), high.max(pixel)),
                // Behind the camera or beyond the lens's field: a triangle may reach from there into any part.
                None => (low, high) = (DVec2::MIN, DVec2::MAX),
            }
        }
        let margin = gaussian_radius(WIDEST_BLUR) as f64;
        let (w, h) = (camera.intrinsics.width as f64, camera.intrinsics.height as f64);
        let bound = |v: f64, most: f64| v.clamp(0.0, most) as usize;
        let (left, top) = (bound((low.x - margin).floor(), w), bound((low.y - margin).floor(), h));
        let (right, bottom) = (bound((high.x + margin).ceil(), w), bound((high.y + margin).ceil(), h));
        (right > left && bottom > top).then(|| Self { left, top, width: right - left, height: bottom - top })
    }
}

impl Projection {
    /// Looks through one view. `bounced` is the view's irradiance by bounces, DN, one a patch; `known` its light at
    /// whatever energy the pulse had. `None` where the object is not in the frame.
    pub fn look(
        around: &Surroundings,
        light: &Illumination,
        bounced: &[[f32; 3]],
        known: &KnownMosaic,
        progress: &Progress,
    ) -> Result<Option<Self>, Cancelled> {
        let Some(window) = Window::of(light.camera(), around) else { return Ok(None) };
        let mirrored = around.mirrored(light, bounced);
        let bounced = around.stage.smooth(bounced);
        let lit = Lit { direct: light, bounced: &bounced, mirrored: &mirrored };
        let wanted = around.wanted(light, &window, progress)?;
        let blank = || Image::filled(window.width, window.height, [0.0; 3]);
        let (mut white, mut other) = (blank(), blank());
        let mut unknown = Image::filled(window.width, window.height, [0.0]);
        let mut rays = vec![];
        // A band of rows at a time, so that their samples and the rays made of them are not held together for all.
        for top in (0..window.height).step_by(ROWS) {
            progress.check()?;
            let band = top..(top + ROWS).min(window.height);
            let rows: Vec<Row> =
                band.into_par_iter().map(|y| row(around, &lit, &window, &wanted, y)).collect();
            for (y, row) in (top..).zip(&rows) {
                for s in &row.samples {
                    let pixel = &mut white.pixels_mut()[s.pixel as usize];
                    (0..3).for_each(|c| pixel[c] += s.white[c]);
                }
                rays.extend(row.samples.iter().map(|s| Ray::of(s, &white, around.size)));
                let across = y * window.width..(y + 1) * window.width;
                other.pixels_mut()[across.clone()].copy_from_slice(&row.other);
                unknown.pixels_mut()[across].copy_from_slice(&row.unknown);
            }
        }
        rays.shrink_to_fit();
        let view = Self {
            window,
            rays,
            bands: vec![],
            other,
            white,
            unknown,
            sites: Image::from_fn(window.width, window.height, |x, y| {
                let (sx, sy) = (window.left + x, window.top + y);
                let colour = known.cfa.colour(sx, sy) as u8;
                match known.value.get(sx as isize, sy as isize) {
                    Some(Some(value)) => Site { colour, known: *value, variance: *known.variance.at(sx, sy) },
                    _ => Site { colour, known: 0.0, variance: f32::INFINITY },
                }
            }),
            frame: (light.camera().intrinsics.width, light.camera().intrinsics.height),
        };
        Ok(Some(view))
    }
}

/// One row of the window.
struct Row {
    samples: Vec<Sample>,
    other: Vec<[f32; 3]>,
    unknown: Vec<[f32; 1]>,
}

/// All light of one view: the flash's own, and by element corner what bounces and what a gloss mirrors (DN; empty
/// where nothing is glossy).
struct Lit<'a> {
    direct: &'a Illumination<'a>,
    bounced: &'a [[[f32; 3]; 3]],
    mirrored: &'a [[[f32; 3]; 3]],
}

fn row(around: &Surroundings, lit: &Lit, window: &Window, wanted: &Image<bool>, y: usize) -> Row {
    let &Lit { direct: light, bounced, mirrored } = lit;
    let (camera, lamp) = (light.camera(), light.lamp());
    let one = 1.0 / (GRID * GRID) as f32;
    let mut out =
        Row { samples: vec![], other: vec![[0.0; 3]; window.width], unknown: vec![[0.0]; window.width] };
    for x in 0..window.width {
        if !wanted.at(x, y) {
            out.unknown[x] = [1.0];
            continue;
        }
        let corner = DVec2::new((window.left + x) as f64, (window.top + y) as f64);
        let response = lamp.field.at(&camera.intrinsics, corner + 0.5) / PI / (GRID * GRID) as f64;
        let met: [Option<Met>; GRID * GRID] = std::array::from_fn(|k| {
            let inside = (DVec2::new((k % GRID) as f64, (k / GRID) as f64) + 0.5) / GRID as f64;
            around.meet(camera, corner + inside)
        });
        let pixel = (window.left + x, window.top + y);
        let shared = shared_share(light, &met, pixel);
        for (k, met) in met.into_iter().enumerate() {
            let Some(met) = met else {
                out.unknown[x][0] += one;
                continue;
            };
            let share = shared.unwrap_or_else(|| {
                let draw = Draw::of_pixel(pixel, k as u32 * LAMP_POINTS, LAMP_POINTS);
                light.drawn_share(met.point, met.normal, draw)
            });
            let unit = share * light.clear(met.point, met.normal);
            let (element, at) =
                around.stage.elements.locate(met.mesh as usize, met.triangle as usize, met.uv[0], met.uv[1]);
            let bounce = interpolate(&bounced[element], at);
            let white: [f32; 3] =
                std::array::from_fn(|c| ((lamp.radiance[c] * unit + f64::from(bounce[c])) * response) as f32);
            if let Some(lobe) = around.gloss[met.mesh as usize] {
                let mirrored = mirrored.get(element).map_or([0.0; 3], |corners| interpolate(corners, at));
                for (c, (other, mirrored)) in out.other[x].iter_mut().zip(mirrored).enumerate() {
                    let direct = lamp.radiance[c] * unit * response;
                    *other += lobe.sent(met.facing, direct as f32, mirrored * response as f32);
                }
            }
            let place =
                if around.holds(element) { place(around, met.triangle as usize, met.uv) } else { None };
            match place {
                Some((texel, at)) => {
                    if f64::from(met.facing) < GRAZING {
                        out.unknown[x][0] += one;
                    }
                    out.samples.push(Sample { pixel: (y * window.width + x) as u32, texel, at, white });
                }
                None => {
                    let rho = interpolate(&around.rho[element], at);
                    (0..3).for_each(|c| out.other[x][c] += rho[c] * white[c]);
                }
            }
        }
    }
    out
}

/// What a ray meets from its front.
#[derive(Clone, Copy)]
struct Met {
    mesh: u32,
    triangle: u32,
    uv: [f32; 2],
    point: Vec3,
    normal: Vec3,
    /// Cosine between normal and the way back to the camera.
    facing: f32,
    /// Metres that a pixel covers there, across the ray.
    footprint: f32,
}

impl Surroundings<'_> {
    /// What the glosses mirror of the lit surfaces, by element corner; nothing where there is no gloss.
    fn mirrored(&self, light: &Illumination, bounced: &[[f32; 3]]) -> Vec<[[f32; 3]; 3]> {
        if self.gloss.iter().all(Option::is_none) {
            return vec![];
        }
        let (stage, elements, gloss) = (self.stage, &self.stage.elements, sent_by(&self.gloss));
        let exitance: Vec<[f32; 3]> = (0..stage.patches.len())
            .into_par_iter()
            .map(|p| {
                let mut sum = ([0.0f32; 3], 0.0);
                for e in stage.patches.spots(p) {
                    let direct = light.direct(elements.centroid(e), elements.normal(e));
                    let rho = interpolate(&self.rho[e], [1.0 / 3.0; 2]);
                    let sent = sent_on(rho, gloss[stage.patches.mesh_of(p)]);
                    for c in 0..3 {
                        let lit = (direct * light.lamp().radiance[c]) as f32 + bounced[p][c];
                        sum.0[c] += sent[c] * lit;
                    }
                    sum.1 += 1.0;
                }
                sum.0.map(|s| s / f32::max(sum.1, 1.0))
            })
            .collect();
        stage.smooth(&mirrored(stage, light.camera().centre().as_vec3(), &self.gloss, &exitance, |_| FEW))
    }

    fn meet(&self, camera: &Camera, pixel: DVec2) -> Option<Met> {
        let (origin, ray) = (camera.centre().as_vec3(), camera.ray(pixel).as_vec3());
        let hit = self.kernel.nearest(origin, ray, 0.0, f32::INFINITY)?;
        let (mesh, triangle) = self.owners[hit.triangle as usize];
        let [a, b, c] = *self.kernel.corners(hit.triangle);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let facing = -normal.dot(ray) / ray.length();
        let footprint = hit.t / camera.intrinsics.focal.min_element() as f32;
        let point = origin + ray * hit.t;
        (facing > 0.0).then_some(Met { mesh, triangle, uv: [hit.u, hit.v], point, normal, facing, footprint })
    }

    /// Pixels of the window that show the object or may do so through the lens's blur.
    fn wanted(
        &self,
        light: &Illumination,
        window: &Window,
        progress: &Progress,
    ) -> Result<Image<bool>, Cancelled> {
        let (width, height) = (window.width.div_ceil(SEARCH_STEP), window.height.div_ceil(SEARCH_STEP));
        let lens = &light.camera().intrinsics;
        let spacing = SEARCH_STEP as f64 / lens.focal.max_element();
        let rows: Vec<Vec<bool>> = (0..height)
            .into_par_iter()
            .map(|y| {
                progress.check()?;
                let shows = |x: usize| {
                    let corner = DVec2::new(
                        (window.left + x * SEARCH_STEP) as f64,
                        (window.top + y * SEARCH_STEP) as f64,
                    );
                    let towards = lens.distortion.undistort((corner + 0.5 - lens.principal) / lens.focal);
                    let of_object = |element| self.holds(element as usize);
                    light.sight().shows(towards.extend(1.0), spacing, of_object)
                };
                Ok((0..width).map(shows).collect())
            })
            .collect::<Result<_, Cancelled>>()?;
        let found = Image::from_fn(width, height, |x, y| rows[y][x]);
        let near = dilate(&found, (gaussian_radius(WIDEST_BLUR) / SEARCH_STEP) + 1);
        Ok(Image::from_fn(window.width, window.height, |x, y| *near.at(x / SEARCH_STEP, y / SEARCH_STEP)))
    }
}

/// The share of light that shadows leave to all rays of a pixel, if they meet one surface in one place.
fn shared_share(
    light: &Illumination,
    met: &[Option<Met>; GRID * GRID],
    pixel: (usize, usize),
) -> Option<f64> {
    let first = met[0]?;
    let (mut point, mut normal) = (Vec3::ZERO, Vec3::ZERO);
    for m in met {
        let m = (*m)?;
        let apart = (m.point - first.point).dot(first.normal).abs();
        if m.mesh != first.mesh
            || m.normal.dot(first.normal) < ONE_FACE
            || apart > ONE_PLACE * first.footprint
        {
            return None;
        }
        point += m.point / met.len() as f32;
        normal += m.normal;
    }
    let draw = Draw::of_pixel(pixel, 0, LAMP_POINTS * met.len() as u32);
    Some(light.drawn_share(point, normal.normalize_or_zero(), draw))
}

/// Upper left of the four texels round a point of the object's surface, and where between them.
fn place(around: &Surroundings, triangle: usize, [u, v]: [f32; 2]) -> Option<(u32, [f32; 2])> {
    let [a, b, c] = around.object.uv_corners(triangle)?;
    let uv = a * (1.0 - u - v) + b * u + c * v;
    // A triangle without room in the texture has no texel of its own, nor has one outside of it.
    let inside = uv.min_element() >= -OUTSIDE && uv.max_element() <= 1.0 + OUTSIDE;
    if !inside || (b - a).perp_dot(c - a) == 0.0 {
        return None;
    }
    let n = around.size as f32;
    let cell = |p: f32| {
        let p = p.clamp(0.0, n - 1.0);
        let low = (p as usize).min(around.size - 2);
        (low, p - low as f32)
    };
    let ((x, fx), (y, fy)) = (cell(uv.x * n - 0.5), cell((1.0 - uv.y) * n - 0.5));
    Some(((y * around.size + x) as u32, [fx, fy]))
}
