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

use super::mirror::mirrored;
use super::observe::{GRAZING, Illumination};
use super::robust::Lobe;
use super::stage::Stage;
use crate::light::{Draw, RayKernel, interpolate};
use crate::photometry::KnownMosaic;
use crate::progress::{Cancelled, Progress};
use crate::raster::blocks::dilate;
use crate::raster::blur::{gaussian_each, gaussian_radius};
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, Mesh};
use glam::{DVec2, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Rays along each side of a pixel.
const GRID: usize = 2;

/// The rays of a pixel share one shadow test if their surfaces part by no more than this (cosine), and lie no
/// farther apart than so many pixels' footprints.
const ONE_FACE: f32 = 0.95;
const ONE_PLACE: f32 = 4.0;

/// Points of the lamp that each ray's surface asks, where it may lie in shadow; a pixel's rays ask different ones.
const LAMP_POINTS: u32 = 8;

/// Step of the search for the object, pixels; what lies within a step and the blur's reach of it counts.
const SEARCH_STEP: usize = 2;

/// By how much texture coordinates may leave the unit square by rounding.
const OUTSIDE: f32 = 1e-4;

/// Rows of the texture that one task writes.
const BAND: usize = 32;

/// Widest lens blur that a margin is kept for, pixels.
pub const WIDEST_BLUR: f32 = 2.5;

/// One ray that meets the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Pixel of the window, row-major.
    pub(super) pixel: u32,
    /// Upper left of the four texels, row-major, and where between them.
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
}

impl<'a> Surroundings<'a> {
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
        Some(Self { object, kernel, owners, stage, rho, gloss: gloss.to_vec(), size })
    }
}

/// The part of a frame that shows the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) left: usize,
    pub(super) top: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Window {
    /// Bounds of the object's projection, with room for the lens's blur; `None` where it is not in the frame.
    fn of(camera: &Camera, object: &Mesh) -> Option<Self> {
        let (mut low, mut high) = (DVec2::MAX, DVec2::MIN);
        for p in object.positions.iter().filter(|p| p.is_finite()) {
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

/// One sensor site of the window.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Site {
    /// Colour: 0, 1, 2.
    pub(super) colour: u8,
    /// Known light, DN.
    pub(super) known: f32,
    /// Its variance by the sensor's noise, DN^2; infinite where nothing is known.
    pub(super) variance: f32,
}

/// A view, ready to be predicted from any texture.
pub struct Projection {
    pub(super) window: Window,
    pub(super) samples: Vec<Sample>,
    /// Indices of samples sorted by the texture band they fall in, and where each band begins.
    order: Vec<u32>,
    bands: Vec<u32>,
    /// Light from surfaces that the texture does not hold, DN.
    other: Rgb,
    /// What white would read in each pixel, DN, before the lens's blur.
    pub(super) white: Rgb,
    /// Share of each pixel's rays of which nothing is known.
    pub(super) unknown: Image<[f32; 1]>,
    pub(super) sites: Image<Site>,
    /// Columns and rows of the whole frame.
    frame: (usize, usize),
    size: usize,
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
        let Some(window) = Window::of(light.camera(), around.object) else { return Ok(None) };
        let mirrored = around.mirrored(light, bounced);
        let bounced = around.stage.smooth(bounced);
        let lit = Lit { direct: light, bounced: &bounced, mirrored: &mirrored };
        let wanted = around.wanted(light, &window, progress)?;
        let rows: Vec<Row> = (0..window.height)
            .into_par_iter()
            .map(|y| {
                progress.check()?;
                Ok(row(around, &lit, &window, &wanted, y))
            })
            .collect::<Result<_, Cancelled>>()?;
        let mut view = Self {
            window,
            samples: Vec::with_capacity(rows.iter().map(|r| r.samples.len()).sum()),
            order: vec![],
            bands: vec![],
            other: Image::from_fn(window.width, window.height, |x, y| rows[y].other[x]),
            white: Image::filled(window.width, window.height, [0.0; 3]),
            unknown: Image::from_fn(window.width, window.height, |x, y| [rows[y].unknown[x]]),
            sites: Image::from_fn(window.width, window.height, |x, y| {
                let (sx, sy) = (window.left + x, window.top + y);
                let colour = known.cfa.colour(sx, sy) as u8;
                match known.value.get(sx as isize, sy as isize) {
                    Some(Some(value)) => Site { colour, known: *value, variance: *known.variance.at(sx, sy) },
                    _ => Site { colour, known: 0.0, variance: f32::INFINITY },
                }
            }),
            frame: (light.camera().intrinsics.width, light.camera().intrinsics.height),
            size: around.size,
        };
        view.samples.extend(rows.into_iter().flat_map(|r| r.samples));
        for s in &view.samples {
            let pixel = &mut view.white.pixels_mut()[s.pixel as usize];
            (0..3).for_each(|c| pixel[c] += s.white[c]);
        }
        view.sort();
        Ok(Some(view))
    }

    /// Sorts the samples into bands of the texture, by counting.
    fn sort(&mut self) {
        let band = |s: &Sample| s.texel as usize / self.size / BAND;
        let mut starts = vec![0u32; self.size.div_ceil(BAND) + 1];
        for s in &self.samples {
            starts[band(s) + 1] += 1;
        }
        for b in 1..starts.len() {
            starts[b] += starts[b - 1];
        }
        let (mut fill, mut order) = (starts.clone(), vec![0u32; self.samples.len()]);
        for (i, s) in self.samples.iter().enumerate() {
            order[fill[band(s)] as usize] = i as u32;
            fill[band(s)] += 1;
        }
        (self.order, self.bands) = (order, starts);
    }

    /// Whether light from beyond the frame reaches a pixel of the window through a blur of `reach` pixels.
    pub(super) fn at_frame_edge(&self, x: usize, y: usize, reach: usize) -> bool {
        let (x, y) = (self.window.left + x, self.window.top + y);
        x < reach || y < reach || x + reach >= self.frame.0 || y + reach >= self.frame.1
    }

    /// The texture as this view's pixels see it, before the lens's blur; with `others`, the light of other surfaces
    /// is in it.
    pub(super) fn pixels(&self, texture: &[[f32; 3]], others: bool) -> Rgb {
        let mut image = if others { self.other.clone() } else { self.blank() };
        let out = image.pixels_mut();
        for s in &self.samples {
            let rho = self.read(texture, s);
            let pixel = &mut out[s.pixel as usize];
            (0..3).for_each(|c| pixel[c] += s.white[c] * rho[c]);
        }
        image
    }

    /// The readings of all three colours in every pixel for a pulse of energy 1.
    pub(super) fn predict(&self, texture: &[[f32; 3]], others: bool, blur: [f32; 3]) -> Rgb {
        gaussian_each(&self.pixels(texture, others), blur)
    }

    /// What white would read everywhere, through the lens.
    pub(super) fn white(&self, blur: [f32; 3]) -> Rgb {
        gaussian_each(&self.white, blur)
    }

    /// Light of other surfaces, through the lens.
    pub(super) fn others(&self, blur: [f32; 3]) -> Rgb {
        gaussian_each(&self.other, blur)
    }

    pub(super) fn blank(&self) -> Rgb {
        Image::filled(self.window.width, self.window.height, [0.0; 3])
    }

    /// The texture itself through the lens, whatever light falls on it, times the share of each pixel that is object;
    /// and that share.
    pub(super) fn plain(&self, texture: &[[f32; 3]], blur: [f32; 3]) -> (Rgb, Rgb) {
        let (mut seen, mut cover) = (self.blank(), self.blank());
        for s in &self.samples {
            let rho = self.read(texture, s);
            let at = s.pixel as usize;
            (0..3).for_each(|c| seen.pixels_mut()[at][c] += rho[c]);
            cover.pixels_mut()[at].iter_mut().for_each(|n| *n += 1.0);
        }
        let share = |image: Rgb| image.map(|p| p.map(|v| v / (GRID * GRID) as f32));
        (gaussian_each(&share(seen), blur), gaussian_each(&share(cover), blur))
    }

    fn read(&self, texture: &[[f32; 3]], s: &Sample) -> [f32; 3] {
        let (i, [fx, fy]) = (s.texel as usize, s.at);
        let (a, b) = (&texture[i], &texture[i + 1]);
        let (c, d) = (&texture[i + self.size], &texture[i + self.size + 1]);
        std::array::from_fn(|k| {
            let top = a[k] + (b[k] - a[k]) * fx;
            let low = c[k] + (d[k] - c[k]) * fx;
            top + (low - top) * fy
        })
    }

    /// Adds to `out` what an image of residuals, already blurred by the lens, says of the texels: the transpose of
    /// [`Self::pixels`]. In bands of rows, each by one task and in one order, so that sums come out the same for any
    /// number of threads.
    pub(super) fn carry_back(&self, image: &Rgb, out: &mut [[f32; 3]]) {
        let chunk = 2 * BAND * self.size;
        for parity in 0..2 {
            let from = (parity * BAND * self.size).min(out.len());
            out[from..].par_chunks_mut(chunk).enumerate().for_each(|(k, rows)| {
                let band = 2 * k + parity;
                let Some(&[start, end]) = self.bands.get(band..band + 2).and_then(|b| b.first_chunk::<2>())
                else {
                    return;
                };
                let origin = band * BAND * self.size;
                for &i in &self.order[start as usize..end as usize] {
                    let s = &self.samples[i as usize];
                    let pixel = &image.pixels()[s.pixel as usize];
                    let at = s.texel as usize - origin;
                    let [fx, fy] = s.at;
                    for (offset, w) in [
                        (0, (1.0 - fx) * (1.0 - fy)),
                        (1, fx * (1.0 - fy)),
                        (self.size, (1.0 - fx) * fy),
                        (self.size + 1, fx * fy),
                    ] {
                        let texel = &mut rows[at + offset];
                        (0..3).for_each(|c| texel[c] += w * s.white[c] * pixel[c]);
                    }
                }
            });
        }
    }
}

/// One row of the window.
struct Row {
    samples: Vec<Sample>,
    other: Vec<[f32; 3]>,
    unknown: Vec<f32>,
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
        Row { samples: vec![], other: vec![[0.0; 3]; window.width], unknown: vec![0.0; window.width] };
    for x in 0..window.width {
        if !wanted.at(x, y) {
            out.unknown[x] = 1.0;
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
                out.unknown[x] += one;
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
            let place = if met.mesh == 0 { place(around, met.triangle as usize, met.uv) } else { None };
            match place {
                Some((texel, at)) => {
                    if f64::from(met.facing) < GRAZING {
                        out.unknown[x] += one;
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
        let (stage, elements) = (self.stage, &self.stage.elements);
        let exitance: Vec<[f32; 3]> = (0..stage.patches.len())
            .into_par_iter()
            .map(|p| {
                let mut sum = ([0.0f32; 3], 0.0);
                let gloss = self.gloss[stage.patches.mesh_of(p)].map_or(0.0, |lobe| lobe.weight);
                for e in stage.patches.spots(p) {
                    let direct = light.direct(elements.centroid(e), elements.normal(e));
                    for c in 0..3 {
                        let rho = self.rho[e].iter().map(|corner| corner[c]).sum::<f32>() / 3.0 + gloss;
                        let lit = (direct * light.lamp().radiance[c]) as f32 + bounced[p][c];
                        sum.0[c] += rho.clamp(0.0, 1.0) * lit;
                    }
                    sum.1 += 1.0;
                }
                sum.0.map(|s| s / f32::max(sum.1, 1.0))
            })
            .collect();
        stage.smooth(&mirrored(stage, light.camera().centre().as_vec3(), &self.gloss, &exitance))
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
                    let of_object = |element| self.stage.elements.mesh_of(element as usize) == 0;
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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use glam::Vec2;

    /// Side of the texture that [`flat_view`] looks at.
    pub(in crate::reflectance) const SIZE: usize = 64;

    /// A picture of a texture lying flat, a texel a pixel, turned, shifted and seen from aside
    /// by its number; evenly lit. (A blur shows only in views that differ in how large a texel is.)
    pub(in crate::reflectance) fn flat_view(number: usize, white: f32) -> Projection {
        let window = Window { left: 20, top: 20, width: SIZE, height: SIZE };
        let blank = Image::filled(SIZE, SIZE, [0.0f32; 3]);
        let (sin, cos) = (0.3 * number as f32).sin_cos();
        let mut view = Projection {
            window,
            samples: vec![],
            order: vec![],
            bands: vec![],
            other: blank.clone(),
            white: blank,
            unknown: Image::filled(SIZE, SIZE, [0.0]),
            sites: Image::from_fn(SIZE, SIZE, |x, y| Site {
                colour: crate::photometry::Cfa::RGGB.colour(x, y) as u8,
                known: 0.0,
                variance: 1.0,
            }),
            frame: (SIZE + 40, SIZE + 40),
            size: SIZE,
        };
        for pixel in 0..SIZE * SIZE {
            for k in 0..GRID * GRID {
                let inside = Vec2::new((k % GRID) as f32 + 0.5, (k / GRID) as f32 + 0.5) / GRID as f32;
                let p = Vec2::new((pixel % SIZE) as f32, (pixel / SIZE) as f32) + inside - SIZE as f32 / 2.0;
                let p = p * Vec2::new(1.0, [1.0, 2.0, 1.4][number % 3]);
                let turned = Vec2::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y);
                let at = turned + SIZE as f32 / 2.0 - 0.5 + 0.21 * number as f32;
                if at.min_element() < 0.0 || at.max_element() >= (SIZE - 1) as f32 {
                    view.unknown.pixels_mut()[pixel][0] += 1.0 / (GRID * GRID) as f32;
                    continue;
                }
                let corner = at.floor();
                let white = [white / (GRID * GRID) as f32; 3];
                let texel = corner.y as u32 * SIZE as u32 + corner.x as u32;
                let at = (at - corner).to_array();
                view.samples.push(Sample { pixel: pixel as u32, texel, at, white });
                (0..3).for_each(|c| view.white.pixels_mut()[pixel][c] += white[c]);
            }
        }
        view.sort();
        view
    }
}
