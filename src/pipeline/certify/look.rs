//! What a model and its views say of a place on the scene's surface.
//!
//! A place on the object is read from the finished texture, seen texels alone; its standard deviation is the mean of
//! theirs, as if their errors went together, for most of them do. A place on another surface of the scene (the object's
//! table, a chart beside it) is not in the texture and is read from the per-view images: the mean over the views of
//! each view's own mean, and how far one view's scatters.

use super::patches::{Place, within};
use crate::codec::asset::AssetError;
use crate::codec::exr_image;
use crate::light::{Hit, RayKernel};
use crate::progress::{Cancelled, Progress};
use crate::raster::sample::bilinear;
use crate::raster::{Image, Rgb};
use crate::reflectance::atlas::{AtlasError, TexelPoint, lay_out};
use crate::scene::{Camera, Mesh, Scene};
use glam::{DVec2, DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Fewest texels or pixels of a patch: less than 3 x 3 are blurred by what lies beside it.
const LEAST: usize = 9;

/// Least share of a patch's surface that must have been seen.
const LEAST_SEEN: f64 = 0.5;

/// How far the surface may lie off a quadrangle's plane, of its size: reconstructed surfaces are rough.
const OFF_PLANE: f64 = 0.25;

/// Cosine between the surface's normals within a patch, at least: what lies behind a thin card is not its front.
const FACING: f32 = 0.5;

/// Where a value was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "from", rename_all = "snake_case")]
pub enum Source {
    /// The model's texture.
    Texture {
        /// Texels, or pixels of the view that were looked up in it.
        texels: usize,
        /// Share of the patch's surface that a view has seen.
        seen_share: f64,
    },
    /// Per-view images, for it lies beside the object.
    Views {
        /// The views.
        names: Vec<String>,
        /// Pixels, all views together.
        pixels: usize,
    },
}

/// What was found at a place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Found {
    pub(super) mean: [f64; 3],
    /// Standard deviation of the mean.
    pub(super) deviation: Option<[f64; 3]>,
    pub(super) source: Source,
}

/// Where a place turned out to be.
pub(super) enum Looked {
    /// Read.
    Found(Found),
    /// Not on the object: to be read from the views.
    Beside,
    /// Not seen, and why.
    Unseen(String),
}

/// A model to look at.
pub(super) struct Surface<'a> {
    scene: &'a Scene,
    object: &'a Mesh,
    kernel: RayKernel,
    reflectance: Rgb,
    deviation: Rgb,
    /// Views that saw each texel.
    seen: Vec<f32>,
    /// 1 on the object, 0 between charts.
    surface: Vec<f32>,
    points: Vec<TexelPoint>,
}

impl<'a> Surface<'a> {
    /// Reads the model in `folder`; `None` if its pictures do not fit each other.
    pub(super) fn read(scene: &'a Scene, folder: &Path) -> Result<Option<Self>, AssetError> {
        let reflectance = exr_image::read(&folder.join("reflectance.exr"))?.rgb();
        let deviation = exr_image::read(&folder.join("stddev.exr"))?.rgb();
        let counts = exr_image::read(&folder.join("views.exr"))?;
        let (Some(reflectance), Some(deviation), Some(object)) =
            (reflectance, deviation, scene.meshes.first())
        else {
            return Ok(None);
        };
        let channel = |name: &str| counts.channel(name).unwrap_or_default().to_vec();
        let (seen, surface) = (channel("Y"), channel("surface"));
        let texels = reflectance.pixels().len();
        let square = reflectance.width() == reflectance.height();
        if !square || [deviation.pixels().len(), seen.len(), surface.len()] != [texels; 3] {
            return Ok(None);
        }
        // The object comes first, so its triangles keep their indices.
        let triangles =
            scene.meshes.iter().flat_map(|m| (0..m.triangles.len()).map(|t| m.corners(t))).collect();
        let kernel = RayKernel::build(triangles);
        Ok(Some(Self { scene, object, kernel, reflectance, deviation, seen, surface, points: vec![] }))
    }

    /// Gets ready for places in space.
    pub(super) fn lay_out(&mut self) -> Result<(), AtlasError> {
        self.points = lay_out(self.object, self.reflectance.width())?;
        Ok(())
    }

    /// Looks for a place on the object.
    pub(super) fn look(&self, place: &Place) -> Looked {
        match place {
            Place::Texture { from_uv, to_uv } => self.in_texture(*from_uv, *to_uv),
            Place::View { name, polygon_px } => {
                let Some(camera) = self.camera(name) else {
                    return Looked::Unseen(format!("the scene has no camera of view {name}"));
                };
                self.through(camera, polygon_px)
            }
            Place::Point { .. } | Place::Quad { .. } => match Region::of(place) {
                Some(region) => self.in_space(&region),
                None => Looked::Unseen("its place is none in space".into()),
            },
        }
    }

    fn camera(&self, name: &str) -> Option<&Camera> {
        self.scene.cameras.iter().find(|camera| camera.name == name)
    }

    /// A rectangle of the texture.
    fn in_texture(&self, from: [f64; 2], to: [f64; 2]) -> Looked {
        let side = self.reflectance.width() as f64;
        // Row 0 is at v = 1; a texel counts if its centre lies inside.
        let range = |a: f64, b: f64| {
            let (low, high) = (a.min(b) * side - 0.5, a.max(b) * side - 0.5);
            (low.ceil().max(0.0) as usize)..((high + 1.0).floor().clamp(0.0, side) as usize)
        };
        let (columns, rows) = (range(from[0], to[0]), range(1.0 - from[1], 1.0 - to[1]));
        let texels = rows.flat_map(|y| columns.clone().map(move |x| y * side as usize + x));
        let on: Vec<usize> = texels.filter(|&t| self.surface[t] > 0.5).collect();
        if on.is_empty() {
            return Looked::Unseen("no part of the object has its texture there".into());
        }
        self.mean(&on)
    }

    /// Texels of one region of space.
    fn in_space(&self, region: &Region) -> Looked {
        let candidates: Vec<(usize, DVec3, Vec3)> = self
            .points
            .iter()
            .filter_map(|point| {
                let [a, b, c] = self.object.corners(point.triangle as usize);
                let place = (a * (1.0 - point.u - point.v) + b * point.u + c * point.v).as_dvec3();
                let normal = (b - a).cross(c - a).normalize_or_zero();
                region.holds(place).then_some((point.texel as usize, place, normal))
            })
            .collect();
        // Of a thin card's two sides the one that was seen.
        let near = |a: &&(usize, DVec3, Vec3), b: &&(usize, DVec3, Vec3)| {
            let far = |c: &(usize, DVec3, Vec3)| (self.seen[c.0] == 0.0, c.1.distance_squared(region.centre));
            let (a, b) = (far(a), far(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        };
        let Some(&(_, _, front)) = candidates.iter().min_by(near) else { return Looked::Beside };
        let texels: Vec<usize> =
            candidates.iter().filter(|c| c.2.dot(front) > FACING).map(|(texel, ..)| *texel).collect();
        self.mean(&texels)
    }

    /// What a view's polygon shows.
    fn through(&self, camera: &Camera, polygon: &[[f64; 2]]) -> Looked {
        let pixels = pixels_within(camera, polygon);
        let hits: Vec<Option<Hit>> = pixels.iter().map(|p| self.hit(camera, *p)).collect();
        let own = self.object.triangles.len() as u32;
        let on: Vec<&Hit> = hits.iter().flatten().filter(|hit| hit.triangle < own).collect();
        let beside = hits.iter().flatten().count() - on.len();
        if hits.is_empty() {
            return Looked::Unseen("no pixel of the view has its centre in the polygon".into());
        }
        if on.len() < beside {
            return Looked::Beside;
        }
        if 2 * on.len() < hits.len() {
            return Looked::Unseen("most of the polygon shows no surface of the scene".into());
        }
        let side = self.reflectance.width();
        let places: Vec<(f32, f32)> = on
            .iter()
            .filter_map(|hit| {
                let [a, b, c] = self.object.uv_corners(hit.triangle as usize)?;
                let uv = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
                Some((uv.x * side as f32, (1.0 - uv.y) * side as f32))
            })
            .collect();
        let texel = |(x, y): &(f32, f32)| {
            let cell = |p: f32| (p.max(0.0) as usize).min(side - 1);
            cell(*y) * side + cell(*x)
        };
        let seen: Vec<&(f32, f32)> = places.iter().filter(|p| self.seen[texel(p)] > 0.0).collect();
        let at = |image: &Rgb| seen.iter().filter_map(|(x, y)| bilinear(image, *x, *y)).collect::<Vec<_>>();
        found(&at(&self.reflectance), &at(&self.deviation), places.len())
    }

    /// The mean over texels on the surface.
    fn mean(&self, texels: &[usize]) -> Looked {
        let seen: Vec<usize> = texels.iter().copied().filter(|&t| self.seen[t] > 0.0).collect();
        let of = |image: &Rgb| seen.iter().map(|&t| image.pixels()[t]).collect::<Vec<_>>();
        found(&of(&self.reflectance), &of(&self.deviation), texels.len())
    }

    fn hit(&self, camera: &Camera, pixel: DVec2) -> Option<Hit> {
        self.kernel.nearest(camera.centre().as_vec3(), camera.ray(pixel).as_vec3(), 1e-4, f32::INFINITY)
    }

    /// Pixel centres of a view at which it shows a place beside the object.
    fn beside(&self, camera: &Camera, place: &Place) -> Vec<DVec2> {
        let pixels = match (place, Region::of(place)) {
            (Place::View { name, .. }, _) if *name != camera.name => vec![],
            (Place::View { polygon_px, .. }, _) => pixels_within(camera, polygon_px),
            (_, Some(region)) => region.pixels(camera),
            (_, None) => vec![],
        };
        let region = Region::of(place);
        let own = self.object.triangles.len() as u32;
        let shows = |p: &DVec2| {
            self.hit(camera, *p).is_some_and(|hit| {
                let point = camera.centre() + camera.ray(*p) * f64::from(hit.t);
                hit.triangle >= own && region.as_ref().is_none_or(|region| region.holds(point))
            })
        };
        pixels.into_iter().filter(shows).collect()
    }

    /// Reads places beside the object from the views' own images, which `read` gives.
    pub(super) fn look_beside<E: From<Cancelled>>(
        &self,
        places: &[&Place],
        views: &[&str],
        read: impl Fn(&str) -> Result<Image<[f32; 4]>, E>,
        progress: &Progress,
    ) -> Result<Vec<Looked>, E> {
        let mut means: Vec<Vec<(String, usize, [f64; 3])>> = vec![vec![]; places.len()];
        for (done, name) in views.iter().enumerate() {
            progress.check()?;
            progress.report("looking beside the object", done, views.len());
            let Some(camera) = self.camera(name) else { continue };
            let pixels: Vec<Vec<DVec2>> = places.iter().map(|place| self.beside(camera, place)).collect();
            if pixels.iter().all(Vec::is_empty) {
                continue;
            }
            let image = read(name)?;
            for (means, pixels) in means.iter_mut().zip(pixels) {
                let known = pixels.iter().filter_map(|p| image.get(p.x as isize, p.y as isize));
                let known: Vec<[f32; 3]> =
                    known.filter(|p| p[3] > 0.5).map(|&[r, g, b, _]| [r, g, b]).collect();
                if known.len() >= LEAST && known.len() as f64 >= LEAST_SEEN * pixels.len() as f64 {
                    means.push(((*name).to_owned(), known.len(), mean_of(&known)));
                }
            }
        }
        Ok(means.into_iter().map(over_views).collect())
    }
}

fn over_views(means: Vec<(String, usize, [f64; 3])>) -> Looked {
    let n = means.len() as f64;
    if means.is_empty() {
        return Looked::Unseen(
            "neither the model nor any view shows a surface there of which it knows the reflectance".into(),
        );
    }
    let mean: [f64; 3] = std::array::from_fn(|c| means.iter().map(|m| m.2[c]).sum::<f64>() / n);
    let deviation = (means.len() > 1).then(|| {
        std::array::from_fn(|c| {
            (means.iter().map(|m| (m.2[c] - mean[c]).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
        })
    });
    let pixels = means.iter().map(|m| m.1).sum();
    let names = means.into_iter().map(|m| m.0).collect();
    Looked::Found(Found { mean, deviation, source: Source::Views { names, pixels } })
}

/// Of values that were seen, of `all` on the patch.
fn found(values: &[[f32; 3]], deviations: &[[f32; 3]], all: usize) -> Looked {
    let seen_share = values.len() as f64 / all.max(1) as f64;
    if seen_share < LEAST_SEEN {
        return Looked::Unseen(format!(
            "no photo shows more than {:.0} % of it: the rest of the texture there is filled, not measured",
            100.0 * seen_share
        ));
    }
    if values.len() < LEAST {
        return Looked::Unseen(format!(
            "only {} texels of it were seen, and {LEAST} are needed: give a larger part of the patch",
            values.len()
        ));
    }
    let (mean, deviation) = (mean_of(values), Some(mean_of(deviations)));
    Looked::Found(Found { mean, deviation, source: Source::Texture { texels: values.len(), seen_share } })
}

fn mean_of(values: &[[f32; 3]]) -> [f64; 3] {
    std::array::from_fn(|c| values.iter().map(|v| f64::from(v[c])).sum::<f64>() / values.len().max(1) as f64)
}

/// Pixel centres of a frame within a polygon.
fn pixels_within(camera: &Camera, polygon: &[[f64; 2]]) -> Vec<DVec2> {
    let polygon: Vec<DVec2> = polygon.iter().map(|p| DVec2::from_array(*p)).collect();
    let (low, high) =
        polygon.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high): (DVec2, DVec2), p| {
            (low.min(*p), high.max(*p))
        });
    centres(camera, low, high).into_iter().filter(|p| within(&polygon, *p)).collect()
}

/// Pixel centres of a frame in a box.
fn centres(camera: &Camera, low: DVec2, high: DVec2) -> Vec<DVec2> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let range = |low: f64, high: f64, n: usize| {
        (low.floor().clamp(0.0, n as f64) as usize)..(high.ceil().clamp(0.0, n as f64) as usize)
    };
    let columns = range(low.x, high.x, width);
    range(low.y, high.y, height)
        .flat_map(|y| columns.clone().map(move |x| DVec2::new(x as f64, y as f64) + 0.5))
        .collect()
}

/// A part of space.
struct Region {
    centre: DVec3,
    radius: f64,
    /// Corners of a flat part; absent for a ball.
    quad: Option<[DVec3; 4]>,
}

impl Region {
    fn of(place: &Place) -> Option<Self> {
        match place {
            Place::Point { at_m, radius_m } => {
                Some(Self { centre: DVec3::from_array(*at_m), radius: *radius_m, quad: None })
            }
            Place::Quad { corners_m } => {
                let corners = corners_m.map(DVec3::from_array);
                let centre = corners.iter().sum::<DVec3>() / 4.0;
                let radius = corners.iter().map(|c| c.distance(centre)).fold(0.0, f64::max);
                Some(Self { centre, radius, quad: Some(corners) })
            }
            Place::Texture { .. } | Place::View { .. } => None,
        }
    }

    fn holds(&self, p: DVec3) -> bool {
        let Some(corners) = &self.quad else { return p.distance(self.centre) <= self.radius };
        let twice = (corners[2] - corners[0]).cross(corners[3] - corners[1]);
        let (normal, size) = (twice.normalize_or_zero(), (0.5 * twice.length()).sqrt());
        if (p - self.centre).dot(normal).abs() > OFF_PLANE * size {
            return false;
        }
        let (x, y) = normal.any_orthonormal_pair();
        let flat = |q: DVec3| DVec2::new((q - self.centre).dot(x), (q - self.centre).dot(y));
        within(&corners.map(flat), flat(p))
    }

    /// Pixel centres of a frame that may show it.
    fn pixels(&self, camera: &Camera) -> Vec<DVec2> {
        let Some((middle, depth)) = camera.project(self.centre) else { return vec![] };
        if depth <= self.radius {
            return vec![];
        }
        // A little more than the ball's outline, for the lens may distort.
        let reach = 1.2 * camera.intrinsics.focal * self.radius / (depth - self.radius) + 2.0;
        centres(camera, middle - reach, middle + reach)
    }
}

#[cfg(test)]
mod tests;
