//! Texture coordinates of our own making, for meshes that have none or none that can be used.
//!
//! Takes a mesh, gives an atlas: the surface is cut into patches that face one way within a cone ([`Charts::cut`]),
//! each is projected on its plane, what would lie on top of itself is cut off and tried again, and the charts are
//! packed into the square with a gutter ([`Charts::pack`]). A projection keeps lengths along one direction and
//! shortens them at most by 1 / [`MOST_STRETCH`] along the other; all charts have one scale, so texels are about as
//! large everywhere. Cutting does not depend on the texture's size and is done once; packing does, because gutters are
//! counted in texels.
//!
//! Patches grow one after the other, in the order of the triangles, and everything that runs in parallel is collected in
//! order, so that the result is the same for any number of threads. Every patch keeps at least one triangle, so that any
//! mesh ends: noisy, torn, with edges of many triangles or with triangles without area.

mod flatten;
mod grow;
mod skyline;
mod surface;

use super::atlas::{AtlasError, lay_out};
use crate::progress::{Cancelled, Progress};
use crate::scene::Mesh;
use flatten::Chart;
use glam::Vec2;
use grow::{FLATTEST, Patch};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use surface::Surface;

/// Texels between a chart and the edge of its rectangle: two charts are at least twice as far apart, so that bilinear
/// look-ups and the first mip level never mix them.
pub const GUTTER: u32 = 2;

/// Bound on how much longer a length is on the surface than on the texture, relative to the charts' scale.
pub const MOST_STRETCH: f32 = 1.0 / FLATTEST;

/// Side of the texture on which given coordinates are tried.
const TRIAL: usize = 1024;

/// Share of the surface's area that may have no area in the texture before the coordinates are given up.
const MOST_LOST: f64 = 0.01;

/// Times that what was cut off is grown into patches anew; what then is left becomes charts of one triangle.
const ROUNDS: usize = 12;

/// Halvings of the interval in which the charts' scale is sought.
const SEARCH: usize = 14;

/// Where texture coordinates may come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UvChoice {
    /// The mesh's own where they can be used, else made.
    #[default]
    Auto,
    /// The mesh's own; an error tells what is wrong with them.
    Own,
    /// Made in any case.
    New,
}

/// Where the texture coordinates came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "from")]
pub enum UvSource {
    /// The mesh itself.
    #[default]
    Own,
    /// Made here.
    Made(Made),
}

/// An atlas that was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Why the mesh's own were not used.
    pub why: String,
    /// Charts.
    pub charts: usize,
    /// Largest and mean (by area) factor by which a length on the surface is shortened in the texture.
    pub stretch: [f32; 2],
    /// Share of the texture that charts cover.
    pub coverage: f64,
}

/// The mesh's own texture coordinates cannot be used, or none can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnwrapError {
    /// They are missing, leave the page, or overlap.
    #[error(transparent)]
    Atlas(#[from] AtlasError),
    /// Triangles that have an area in space but none in the texture.
    #[error(
        "mesh {mesh}: {share:.0} % of its surface has no area in its texture coordinates: unwrap it again, or have coordinates made"
    )]
    Lost {
        /// Mesh.
        mesh: String,
        /// Per cent of the area.
        share: f64,
    },
    /// The gutters alone fill the texture.
    #[error(
        "mesh {mesh} needs {charts} charts, which do not fit into a texture of {size} x {size} texels with {GUTTER} texels round each: use a larger --texture-size"
    )]
    Crowded {
        /// Mesh.
        mesh: String,
        /// Charts.
        charts: usize,
        /// Side.
        size: usize,
    },
    /// No triangle has an area.
    #[error("mesh {0} has no surface: none of its triangles has an area")]
    NoSurface(String),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl UnwrapError {
    /// What is wrong with the mesh's own coordinates, for a sentence that goes on to say that others were made.
    pub fn reason(&self) -> String {
        match self {
            Self::Atlas(AtlasError::NoUvs(_)) => "the mesh has none".into(),
            Self::Atlas(AtlasError::Outside { share, .. }) => {
                format!("the mesh's own lie outside 0..1 on {share:.0} % of its triangles")
            }
            Self::Atlas(AtlasError::Overlap { share, .. }) => {
                format!("the mesh's own overlap on {share:.0} % of the texels")
            }
            Self::Lost { share, .. } => {
                format!("the mesh's own give {share:.0} % of the surface no area")
            }
            other => other.to_string(),
        }
    }
}

/// Whether a mesh's own coordinates can carry a texture; the error says what is wrong with them.
pub fn check_own(mesh: &Mesh) -> Result<(), UnwrapError> {
    lay_out(mesh, TRIAL)?;
    let (mut all, mut lost) = (0.0f64, 0.0f64);
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        let area = f64::from((b - a).cross(c - a).length());
        let Some([p, q, r]) = mesh.uv_corners(t) else { continue };
        all += area;
        // Exactly nothing, or so thin that rounding made it.
        let longest = (q - p).length_squared().max((r - q).length_squared()).max((p - r).length_squared());
        if (q - p).perp_dot(r - p).abs() <= 1e-6 * longest {
            lost += area;
        }
    }
    if lost > MOST_LOST * all {
        return Err(UnwrapError::Lost { mesh: mesh.name.clone(), share: 100.0 * lost / all });
    }
    Ok(())
}

/// A mesh's surface cut into charts, in metres.
pub struct Charts {
    mesh: String,
    charts: Vec<Chart>,
    /// Triangles without area that no chart holds.
    loose: Vec<u32>,
    /// Largest and mean stretch.
    stretch: [f32; 2],
}

/// Charts in a texture.
pub struct Packed {
    /// Texture coordinates, v up.
    pub uvs: Vec<Vec2>,
    /// Corner indices into `uvs`, one triple a triangle.
    pub uv_triangles: Vec<[u32; 3]>,
    /// Share of the texture that charts cover.
    pub coverage: f64,
}

impl Charts {
    /// Cuts a mesh.
    pub fn cut(mesh: &Mesh, progress: &Progress) -> Result<Self, UnwrapError> {
        let surface = Surface::of(mesh);
        if !surface.areas.iter().any(|a| *a > 0.0) {
            return Err(UnwrapError::NoSurface(mesh.name.clone()));
        }
        let mut pool: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        let mut charts = vec![];
        for round in 0..ROUNDS {
            progress.check()?;
            progress.report("cutting the surface into charts", round, ROUNDS);
            let patches = grow::grow(&surface, &pool, progress)?;
            let parted: Vec<(Vec<Chart>, Vec<u32>)> =
                patches.into_par_iter().map(|p| Chart::of(mesh, p).part(mesh, &surface)).collect();
            pool.clear();
            for (kept, off) in parted {
                charts.extend(kept);
                pool.extend(off);
            }
            pool.sort_unstable();
            if pool.is_empty() {
                break;
            }
        }
        let alone = |t: u32| {
            let axis = surface.normals[t as usize];
            Chart::of(mesh, Patch { triangles: vec![t], axis })
        };
        charts.extend(pool.into_iter().filter(|&t| !surface.is_degenerate(t as usize)).map(alone));
        // Pieces without area need no place of their own.
        charts.retain(|c| c.triangles.iter().any(|&t| !surface.is_degenerate(t as usize)));
        let mut held = vec![false; mesh.triangles.len()];
        charts.iter().flat_map(|c| &c.triangles).for_each(|&t| held[t as usize] = true);
        let loose = (0_u32..).zip(held).filter(|(_, held)| !held).map(|(t, _)| t).collect();
        let stretch = stretch(&charts, &surface);
        Ok(Self { mesh: mesh.name.clone(), charts, loose, stretch })
    }

    /// How many charts there are.
    pub fn len(&self) -> usize {
        self.charts.len()
    }

    /// Never: a mesh without surface is not cut.
    pub fn is_empty(&self) -> bool {
        self.charts.is_empty()
    }

    /// Packs the charts of `mesh`, which was cut, into a texture of `size` x `size` texels, as large as they fit.
    pub fn pack(&self, mesh: &Mesh, size: usize) -> Result<Packed, UnwrapError> {
        let side = u32::try_from(size).unwrap_or(u32::MAX);
        let area: f64 = self.charts.iter().map(|c| f64::from(c.extent.element_product())).sum();
        let longest = self.charts.iter().map(|c| c.extent.x).fold(0.0, f32::max);
        let mut order: Vec<usize> = (0..self.charts.len()).collect();
        let try_scale = |scale: f32, order: &mut [usize]| {
            let box_of = |c: &Chart| c.extent.to_array().map(|e| (e * scale).ceil() as u32 + 1 + 2 * GUTTER);
            let boxes: Vec<(u32, u32)> = self.charts.iter().map(|c| box_of(c).into()).collect();
            order.sort_by_key(|&i| (Reverse((boxes[i].1, boxes[i].0)), i));
            skyline::pack(side, order.iter().map(|&i| boxes[i]))
        };
        // Texels per metre: no more than the boxes' area or the longest chart allow.
        let (mut low, mut high) =
            (0.0, (size as f64 / area.sqrt()).min(size as f64 / f64::from(longest)) as f32);
        let mut best = None;
        for step in 0..SEARCH {
            let scale = if step == 0 { high } else { (low + high) / 2.0 };
            match try_scale(scale, &mut order) {
                Some(places) => (low, best) = (scale, Some((scale, order.clone(), places))),
                None => high = scale,
            }
            if low == high {
                break;
            }
        }
        let crowded = || UnwrapError::Crowded { mesh: self.mesh.clone(), charts: self.charts.len(), size };
        let (scale, order, places) = best.ok_or_else(crowded)?;
        Ok(self.placed(mesh, size as f32, scale, &order, &places))
    }

    fn placed(&self, mesh: &Mesh, size: f32, scale: f32, order: &[usize], places: &[(u32, u32)]) -> Packed {
        let mut uvs = vec![];
        let mut uv_triangles = vec![[0; 3]; mesh.triangles.len()];
        let mut covered = 0.0;
        for (&i, &(x, y)) in order.iter().zip(places) {
            let chart = &self.charts[i];
            let corner = Vec2::new((x + GUTTER) as f32, (y + GUTTER) as f32) + 0.5;
            let first = uvs.len();
            uvs.extend(chart.points.iter().map(|p| (corner + *p * scale) / size));
            for &t in &chart.triangles {
                let corners = mesh.triangles[t as usize].map(|v| (first + chart.index(v)) as u32);
                let [a, b, c] = corners.map(|k| uvs[k as usize]);
                covered += f64::from((b - a).perp_dot(c - a)) / 2.0;
                uv_triangles[t as usize] = corners;
            }
        }
        // What has no surface has no texel either: all its corners are one point, at another chart's corner.
        for &t in &self.loose {
            uv_triangles[t as usize] = [0; 3];
        }
        Packed { uvs, uv_triangles, coverage: covered }
    }

    /// What to tell of the atlas.
    pub fn told(&self, packed: &Packed, why: String) -> Made {
        Made { why, charts: self.len(), stretch: self.stretch, coverage: packed.coverage }
    }
}

/// Largest and mean (by area) stretch: the reciprocal of the cosine between triangle and plane.
fn stretch(charts: &[Chart], surface: &Surface) -> [f32; 2] {
    let (mut most, mut sum, mut area) = (1.0f32, 0.0f64, 0.0f64);
    for chart in charts {
        for &t in chart.triangles.iter().filter(|&&t| !surface.is_degenerate(t as usize)) {
            let here = 1.0 / surface.normals[t as usize].dot(chart.axis).max(1e-6);
            most = most.max(here);
            sum += f64::from(here * surface.areas[t as usize]);
            area += f64::from(surface.areas[t as usize]);
        }
    }
    [most, if area > 0.0 { (sum / area) as f32 } else { 1.0 }]
}

#[cfg(test)]
mod tests;
