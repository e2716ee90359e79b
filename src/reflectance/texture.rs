//! From views to a texture: collects every view's observations of the surface's patches, settles the bounces, then
//! solves all texels at once against the sensor sites of all views ([`super::joint`]).
//!
//! Views are added one at a time, and looked at twice: once for the bounces, once with them.

use super::atlas::{AtlasError, TexelPoint, fill, lay_out};
use super::bounce::{Bounces, Round, ViewLight};
use super::joint::{Joint, Photo, Run, solve_jointly};
use super::observe::{Lamp, View};
use super::project::{Projection, Surroundings};
use super::solve::Estimate;
use super::stage::Stage;
use super::uncertainty::CELL;
use crate::light::interpolate;
use crate::photometry::{FlashGain, Known, KnownMosaic};
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::scene::{Camera, Mesh};

/// Standard deviation of the simulated bounced light, relative: what its rays scatter (benches/light.rs: 6 to 10 % at
/// points, less over a patch).
const BOUNCE_ERROR: f32 = 0.05;

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
    /// Every pixel of it mixes with what lies behind.
    #[error(
        "the object is so small or thin in the photos that no pixel shows it alone: go nearer, or use a longer lens"
    )]
    TooSmall,
}

/// The finished texture, `size` x `size`, row 0 at v = 1.
pub struct Texture {
    /// Estimate of each texel; `None` between charts and where no view sees the surface.
    pub estimates: Image<Option<Estimate>>,
    /// Reflectance of every texel on the surface: the estimate, or for what no view sees that of the nearest
    /// seen surface.
    pub filled: Image<Option<[f32; 3]>>,
    /// Root mean square of the views' own means about each seen texel, of 1: how far they disagree.
    pub residual: Image<f32>,
    /// Texels that lie on the surface, seen or not.
    pub surface: usize,
    /// How the rounds of bounces converged.
    pub rounds: Vec<Round>,
    /// How the joint solve converged.
    pub runs: Vec<Run>,
    /// Energy of each view's pulse, as the texture and its measurement tell.
    pub gains: Vec<FlashGain>,
    /// Standard deviation of the lens's blur by channel, pixels.
    pub blur: [f32; 3],
    /// Bounced light and reflectance on the patches.
    pub bounces: Bounces,
}

/// Collects views for the bounces.
pub struct Solver<'a> {
    meshes: &'a [Mesh],
    stage: &'a Stage,
    size: usize,
    points: Vec<TexelPoint>,
    lights: Vec<ViewLight>,
}

impl<'a> Solver<'a> {
    /// A texture of `size` x `size` for the first of `meshes`, of which `stage` is made.
    pub fn new(meshes: &'a [Mesh], stage: &'a Stage, size: usize) -> Result<Self, TextureError> {
        let object = meshes.first().ok_or(TextureError::Unseen)?;
        let points = lay_out(object, size)?;
        Ok(Self { meshes, stage, size, points, lights: vec![] })
    }

    /// Adds a view's observations of the patches.
    pub fn add(
        &mut self,
        camera: &Camera,
        known: &Known,
        lamp: &Lamp,
        progress: &Progress,
    ) -> Result<(), Cancelled> {
        progress.check()?;
        let light = self.stage.illuminate(camera, lamp);
        let view = View { illumination: &light, known };
        progress.check()?;
        let spots = self.stage.direct_at_spots(&light);
        progress.check()?;
        let (direct, seen) = (self.stage.mean(&spots), view.observe_patches(self.stage, &spots));
        self.lights.push(ViewLight { eye: camera.centre().as_vec3(), direct, radiance: lamp.radiance, seen });
        Ok(())
    }

    /// Settles the bounces; then the views are looked at again, in the same order.
    pub fn settle(self, progress: &Progress) -> Result<Settled<'a>, TextureError> {
        if self
            .lights
            .iter()
            .all(|v| v.seen.iter().all(|(p, _)| self.stage.patches.mesh_of(*p as usize) != 0))
        {
            return Err(TextureError::Unseen);
        }
        let transport = self.stage.transport(progress)?;
        let bounces = Bounces::settle(self.stage, &transport, &self.lights, progress)?;
        let around = Surroundings::new(self.meshes, self.stage, &bounces.rho, &bounces.gloss, self.size)
            .ok_or(TextureError::Unseen)?;
        Ok(Settled {
            stage: self.stage,
            size: self.size,
            points: self.points,
            around,
            bounces,
            photos: vec![],
            places: vec![],
        })
    }
}

/// Views with their bounces, for the texels.
pub struct Settled<'a> {
    stage: &'a Stage,
    size: usize,
    points: Vec<TexelPoint>,
    around: Surroundings<'a>,
    bounces: Bounces,
    photos: Vec<Photo>,
    /// Per added view, its place among `photos` and its measured energy.
    places: Vec<(Option<usize>, FlashGain)>,
}

impl Settled<'_> {
    /// Adds a view's sensor sites; `index` is its place in the order of [`Solver::add`], `gain` its pulse's energy.
    pub fn add(
        &mut self,
        index: usize,
        camera: &Camera,
        known: &KnownMosaic,
        lamp: &Lamp,
        gain: FlashGain,
        progress: &Progress,
    ) -> Result<(), Cancelled> {
        let light = self.stage.illuminate(camera, lamp);
        let bounced = self.bounces.of_view(index);
        let seen = Projection::look(&self.around, &light, &bounced, known, progress)?;
        self.places.push((seen.is_some().then_some(self.photos.len()), gain));
        self.photos.extend(seen.map(|projection| Photo { projection, gain }));
        Ok(())
    }

    /// Solves every texel; `shot_noise` is the sensor's variance per DN of light.
    pub fn solve(self, shot_noise: f32, progress: &Progress) -> Result<Texture, TextureError> {
        let joint = solve_jointly(&self.photos, self.start(), self.size, shot_noise, progress)?;
        let Joint { texels, gains, blur, runs, cells, spoken, scale_error } = joint;
        let elements = &self.stage.elements;
        let mut estimates = Image::filled(self.size, self.size, None);
        let mut filled = Image::filled(self.size, self.size, None);
        let mut residual = Image::filled(self.size, self.size, 0.0);
        for p in &self.points {
            let at = p.texel as usize;
            let cell = cells.at(at % self.size / CELL, at / self.size / CELL);
            let rho = texels[at];
            filled.pixels_mut()[at] = Some(rho);
            if spoken[at] && cell.views > 0 {
                let (element, _) = elements.locate(0, p.triangle as usize, p.u, p.v);
                let share = self.bounces.shares[self.stage.patches.of(element)];
                let sd = std::array::from_fn(|c| {
                    cell.sd[c].hypot(scale_error * rho[c]).hypot(BOUNCE_ERROR * share[c] * rho[c])
                });
                estimates.pixels_mut()[at] = Some(Estimate { rho, sd, views: cell.views });
                residual.pixels_mut()[at] = cell.residual;
            }
        }
        if estimates.pixels().iter().all(Option::is_none) {
            return Err(TextureError::TooSmall);
        }
        let gains = self.places.iter().map(|(at, measured)| at.map_or(*measured, |at| gains[at])).collect();
        let rounds = self.bounces.rounds.clone();
        let surface = self.points.len();
        Ok(Texture { estimates, filled, residual, surface, rounds, runs, gains, blur, bounces: self.bounces })
    }

    /// The patches' reflectance at every texel.
    fn start(&self) -> Vec<[f32; 3]> {
        let elements = &self.stage.elements;
        let corners = self.stage.smooth(&self.bounces.rho);
        let mut start = Image::filled(self.size, self.size, None);
        for p in &self.points {
            let (element, at) = elements.locate(0, p.triangle as usize, p.u, p.v);
            start.pixels_mut()[p.texel as usize] = Some(interpolate(&corners[element], at));
        }
        // Gutters too: what lies beside a chart must not pull its border down.
        fill(&start).pixels().to_vec()
    }
}
