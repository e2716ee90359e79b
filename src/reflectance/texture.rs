//! From views to a texture: collects every view's observations, settles the bounces, solves every texel.
//!
//! Views are added one at a time, so that only one photograph is in memory; what stays is a few numbers a
//! texel and view that sees it.

use super::atlas::{AtlasError, TexelPoint, lay_out};
use super::bounce::{Bounces, Round, ViewLight, reading};
use super::observe::{Illumination, Lamp, Observation, View};
use super::solve::{Estimate, Reading, solve};
use crate::light::{Elements, Transport, interpolate};
use crate::photometry::Known;
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::scene::{Camera, Mesh};
use glam::Vec3;
use rayon::prelude::*;

/// Longest edge of an element of the object, and of the other meshes, relative to the object's diagonal.
const OBJECT_EDGE: f32 = 0.02;
const OTHER_EDGE: f32 = 0.04;

/// Distance by which rays start off the surface, relative to the object's diagonal.
const OFFSET: f64 = 1e-4;

/// Rays per element for the bounces, and the bound on all of them together (4 bytes each).
const RAYS: usize = 64;
const MOST_RAYS: usize = 160_000_000;

/// Texels per tile between two looks at the cancel flag.
const TILE: usize = 8192;

/// The texture cannot be solved.
#[derive(Debug, thiserror::Error)]
pub enum TextureError {
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The mesh cannot carry one.
    #[error(transparent)]
    Atlas(#[from] AtlasError),
    /// No view has seen any of it.
    #[error(
        "no view sees the object: do scene and photos belong together, and are cameras and mesh in the same frame and unit?"
    )]
    Unseen,
}

/// The finished texture, `size` x `size`, row 0 at v = 1.
pub struct Texture {
    /// Estimate of each texel; `None` between charts and where no view sees the surface.
    pub estimates: Image<Option<Estimate>>,
    /// Reflectance of every texel on the surface: the estimate, or for what no view sees that of the nearest
    /// seen surface.
    pub filled: Image<Option<[f32; 3]>>,
    /// Texels that lie on the surface, seen or not.
    pub surface: usize,
    /// How the rounds of bounces converged.
    pub rounds: Vec<Round>,
    /// Bounced light and reflectance on the elements.
    pub bounces: Bounces,
}

/// The meshes made ready for light.
pub struct Stage {
    /// Surface elements and ray kernel of all meshes.
    pub elements: Elements,
    /// Metres by which rays start off a surface.
    pub offset: f64,
}

impl Stage {
    /// Cuts the meshes into elements; the first is the object and sets the scale.
    pub fn build(meshes: &[Mesh]) -> Self {
        let diagonal = meshes.first().map_or(1.0, diagonal).max(1e-6);
        let edges: Vec<f32> =
            (0..meshes.len()).map(|i| diagonal * if i == 0 { OBJECT_EDGE } else { OTHER_EDGE }).collect();
        let meshes: Vec<&Mesh> = meshes.iter().collect();
        Self { elements: Elements::build(&meshes, &edges), offset: OFFSET * f64::from(diagonal) }
    }

    /// Traces the bounces' transport.
    pub fn transport(&self, progress: &Progress) -> Result<Transport, Cancelled> {
        let rays = RAYS.min(MOST_RAYS / self.elements.len().max(1)).max(8);
        Transport::trace(&self.elements, rays, progress)
    }

    /// A camera and its flash before this stage.
    pub fn illuminate<'a>(&'a self, camera: &'a Camera, lamp: &'a Lamp) -> Illumination<'a> {
        Illumination::new(camera, lamp, &self.elements, self.offset)
    }

    /// The flash's irradiance per unit radiance on every element.
    pub fn direct(&self, light: &Illumination) -> Vec<f32> {
        let elements = &self.elements;
        let of = |e| light.direct(elements.centroid(e), elements.normal(e)) as f32;
        (0..elements.len()).into_par_iter().map(of).collect()
    }
}

fn diagonal(mesh: &Mesh) -> f32 {
    let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
    for p in mesh.positions.iter().filter(|p| p.is_finite()) {
        (low, high) = (low.min(*p), high.max(*p));
    }
    if low.x <= high.x { (high - low).length() } else { 0.0 }
}

/// Collects views and solves.
pub struct Solver<'a> {
    object: &'a Mesh,
    stage: &'a Stage,
    size: usize,
    points: Vec<TexelPoint>,
    lights: Vec<ViewLight>,
    /// By view: observations by index into `points`, ascending.
    texels: Vec<Vec<(u32, Observation)>>,
}

impl<'a> Solver<'a> {
    /// A texture of `size` x `size` for the first mesh of `stage`.
    pub fn new(object: &'a Mesh, stage: &'a Stage, size: usize) -> Result<Self, AtlasError> {
        let points = lay_out(object, size)?;
        Ok(Self { object, stage, size, points, lights: vec![], texels: vec![] })
    }

    /// Adds a view's observations.
    pub fn add(
        &mut self,
        camera: &Camera,
        known: &Known,
        lamp: &Lamp,
        progress: &Progress,
    ) -> Result<(), Cancelled> {
        let elements = &self.stage.elements;
        progress.check()?;
        let light = self.stage.illuminate(camera, lamp);
        let view = View { illumination: &light, known };
        progress.check()?;
        let direct = self.stage.direct(&light);
        progress.check()?;
        let observe = |point, normal| if normal == Vec3::ZERO { None } else { view.observe(point, normal) };
        let seen = (0..elements.len())
            .into_par_iter()
            .filter_map(|e| Some((e as u32, observe(elements.centroid(e), elements.normal(e))?)))
            .collect();
        self.lights.push(ViewLight { direct, radiance: lamp.radiance, seen });
        let of_texels = self
            .points
            .par_iter()
            .enumerate()
            .map(|(i, p)| {
                if i % TILE == 0 {
                    progress.check()?;
                }
                let [a, b, c] = self.object.corners(p.triangle as usize);
                let point = a * (1.0 - p.u - p.v) + b * p.u + c * p.v;
                let (element, _) = elements.locate(0, p.triangle as usize, p.u, p.v);
                Ok(observe(point, elements.normal(element)).map(|o| (i as u32, o)))
            })
            .filter_map(Result::transpose)
            .collect::<Result<_, Cancelled>>()?;
        self.texels.push(of_texels);
        Ok(())
    }

    /// Settles the bounces and solves every texel.
    pub fn solve(mut self, progress: &Progress) -> Result<Texture, TextureError> {
        if self.texels.iter().all(Vec::is_empty) {
            return Err(TextureError::Unseen);
        }
        let elements = &self.stage.elements;
        let transport = self.stage.transport(progress)?;
        let bounces = Bounces::settle(elements, &transport, &self.lights, progress)?;
        for (v, texels) in self.texels.iter_mut().enumerate() {
            progress.check()?;
            progress.report("adding bounces", v, self.lights.len());
            let corners = elements.smooth(&bounces.of_view(v));
            let gloss = bounces.gloss.first().copied().flatten();
            texels.par_iter_mut().for_each(|(i, o)| {
                let p = &self.points[*i as usize];
                let (element, at) = elements.locate(0, p.triangle as usize, p.u, p.v);
                if let Some(lobe) = gloss {
                    lobe.take_off(o);
                }
                let whole = reading(o, &interpolate(&corners[element], at));
                (o.known, o.white) = (whole.known, whole.white);
            });
        }
        let tiles = self.points.len().div_ceil(TILE);
        let done = std::sync::atomic::AtomicUsize::new(0);
        let solved: Vec<Vec<Option<Estimate>>> = (0..tiles)
            .into_par_iter()
            .map(|tile| {
                progress.check()?;
                let estimates = self.solve_tile(tile * TILE..((tile + 1) * TILE).min(self.points.len()));
                let finished = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
                progress.report("solving texels", finished, tiles);
                Ok(estimates)
            })
            .collect::<Result<_, Cancelled>>()?;
        let mut estimates = Image::filled(self.size, self.size, None);
        let mut filled = Image::filled(self.size, self.size, None);
        for (p, e) in self.points.iter().zip(solved.into_iter().flatten()) {
            estimates.pixels_mut()[p.texel as usize] = e;
            let (element, _) = elements.locate(0, p.triangle as usize, p.u, p.v);
            filled.pixels_mut()[p.texel as usize] = Some(e.map_or(bounces.rho[element], |e| e.rho));
        }
        let rounds = bounces.rounds.clone();
        Ok(Texture { estimates, filled, surface: self.points.len(), rounds, bounces })
    }

    fn solve_tile(&self, range: std::ops::Range<usize>) -> Vec<Option<Estimate>> {
        let mut readings: Vec<Vec<Reading>> = vec![vec![]; range.len()];
        for texels in &self.texels {
            let first = texels.partition_point(|(i, _)| (*i as usize) < range.start);
            for (i, o) in texels[first..].iter().take_while(|(i, _)| (*i as usize) < range.end) {
                readings[*i as usize - range.start].push(reading(o, &[0.0; 3]));
            }
        }
        readings.iter().map(|r| solve(r)).collect()
    }
}
