//! From views to a texture: collects every view's observations of the surface's patches, settles the bounces, then
//! solves all texels at once against the sensor sites of all views ([`super::joint`]).
//!
//! Views are added one at a time, and looked at twice: once for the bounces, once with them.

use super::atlas::{AtlasError, TexelPoint, fill, lay_out};
use super::bounce::{Bounces, Round, ViewLight};
use super::joint::{Photo, Run, solve_jointly};
use super::observe::{Lamp, View};
use super::pieces::{Piece, divide};
use super::project::Surroundings;
use super::projection::{Ground, Projection};
use super::solve::Estimate;
use super::stage::Stage;
use super::uncertainty::CELL;
use crate::light::interpolate;
use crate::photometry::{self, FlashGain, KnownMosaic};
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, Mesh};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Standard deviation of the simulated bounced light, relative: what is left of it at points against a path trace
/// (tests/all/irradiance.rs: 5 to 10 %).
const BOUNCE_ERROR: f32 = 0.08;

/// A piece tells a pulse's energy if it leaves less than this of the measurement's standard deviation.
const TOLD: f64 = 0.9;

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
    /// Reflectance of every texel on the surface: the estimate, or for what no view sees that of the nearest
    /// seen surface. Between charts anything.
    pub rho: Rgb,
    /// Texels that lie on the surface, seen or not.
    pub surface: Image<bool>,
    /// Those of them that a view sees.
    seen: Image<bool>,
    cells: Image<Known>,
    /// How the rounds of bounces converged.
    pub rounds: Vec<Round>,
    /// How the joint solve converged, of the part of the texture that most pixels show.
    pub runs: Vec<Run>,
    /// Parts that the texture was solved in.
    pub pieces: usize,
    /// How often a view was looked at for one of them.
    pub looks: usize,
    /// Energy of each view's pulse, as the texture and its measurement tell.
    pub gains: Vec<FlashGain>,
    /// Standard deviation of the lens's blur by channel, pixels.
    pub blur: [f32; 3],
    /// Bounced light and reflectance on the patches.
    pub bounces: Bounces,
}

/// What is known of a cell of texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Known {
    /// Standard deviation of the reflectance over a patch of 4x4 photo pixels, by what differs from view to view.
    pub sd: [f32; 3],
    /// Relative standard deviation by what all views share.
    pub shared: [f32; 3],
    /// Root mean square of the views' own means about each seen texel, of 1: how far they disagree.
    pub residual: f32,
    /// Views that see it.
    pub views: u16,
}

impl Texture {
    fn cell(&self, x: usize, y: usize) -> &Known {
        self.cells.at(x / CELL, y / CELL)
    }

    /// Estimate of a texel; `None` between charts and where no view sees the surface.
    pub fn estimate(&self, x: usize, y: usize) -> Option<Estimate> {
        self.seen.at(x, y).then(|| {
            let (rho, known) = (*self.rho.at(x, y), self.cell(x, y));
            let sd = std::array::from_fn(|c| known.sd[c].hypot(known.shared[c] * rho[c]));
            Estimate { rho, sd, views: known.views }
        })
    }

    /// All of them, row by row.
    pub fn estimates(&self) -> impl Iterator<Item = Option<Estimate>> {
        let (width, height) = (self.rho.width(), self.rho.height());
        (0..height).flat_map(move |y| (0..width).map(move |x| self.estimate(x, y)))
    }

    /// How far the views disagree about a texel, of 1; 0 where none sees it.
    pub fn residual(&self, x: usize, y: usize) -> f32 {
        if *self.seen.at(x, y) { self.cell(x, y).residual } else { 0.0 }
    }

    /// The surface's texels alone.
    pub fn filled(&self) -> Image<Option<[f32; 3]>> {
        Image::from_fn(self.rho.width(), self.rho.height(), |x, y| {
            self.surface.at(x, y).then(|| *self.rho.at(x, y))
        })
    }

    /// Adds a relative error that all texels share, by channel.
    pub fn add_scale_error(&mut self, error: [f32; 3]) {
        for known in self.cells.pixels_mut() {
            (0..3).for_each(|c| known.shared[c] = known.shared[c].hypot(error[c]));
        }
    }
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
        known: &photometry::Known,
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

    /// Settles the bounces; then the views are looked at again, part by part of the surface, each of which takes up
    /// about `memory` bytes.
    pub fn settle(self, memory: f64, progress: &Progress) -> Result<Settled<'a>, TextureError> {
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
        let pieces = divide(&self.stage.patches, &self.lights, memory);
        let rho = start(self.stage, &bounces, &self.points, self.size);
        let cells = self.size.div_ceil(CELL);
        Ok(Settled {
            stage: self.stage,
            size: self.size,
            points: self.points,
            around,
            bounces,
            pieces,
            photos: vec![],
            gains: vec![None; self.lights.len()],
            blur: None,
            runs: vec![],
            rho,
            seen: Image::filled(self.size, self.size, false),
            cells: Image::filled(cells, cells, Known::default()),
        })
    }
}

/// The patches' reflectance at every texel; in the gutters too: what lies beside a chart must not pull its border down.
fn start(stage: &Stage, bounces: &Bounces, points: &[TexelPoint], size: usize) -> Rgb {
    let corners = stage.smooth(&bounces.rho);
    let mut start = Image::filled(size, size, None);
    for p in points {
        let (element, at) = stage.elements.locate(0, p.triangle as usize, p.u, p.v);
        start.pixels_mut()[p.texel as usize] = Some(interpolate(&corners[element], at));
    }
    fill(&start)
}

/// Views with their bounces, for the texels.
pub struct Settled<'a> {
    stage: &'a Stage,
    size: usize,
    /// In the order of texels.
    points: Vec<TexelPoint>,
    around: Surroundings<'a>,
    bounces: Bounces,
    pieces: Vec<Piece>,
    /// Views of the piece at hand, with their indices.
    photos: Vec<(usize, Photo)>,
    /// Each view's energy, once a piece has told it, and the lens's blur.
    gains: Vec<Option<FlashGain>>,
    blur: Option<[f32; 3]>,
    runs: Vec<Run>,
    rho: Rgb,
    seen: Image<bool>,
    cells: Image<Known>,
}

/// What was found of one piece.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Places of its texels that views speak of, and their reflectance.
    pub texels: Vec<(u32, [f32; 3])>,
    /// Places of the cells of texels, and what is known of them.
    pub cells: Vec<(u32, Known)>,
    /// Energies of pulses, by view.
    pub gains: Vec<(u32, FlashGain)>,
    /// Standard deviation of the lens's blur by channel, pixels.
    pub blur: [f32; 3],
    /// How the solve converged.
    pub runs: Vec<Run>,
}

impl Settled<'_> {
    /// How many pieces there are.
    pub fn pieces(&self) -> usize {
        self.pieces.len()
    }

    /// Whether a view has to be looked at for a piece.
    pub fn sees(&self, piece: usize, view: usize) -> bool {
        self.pieces[piece].views[view]
    }

    /// Begins a piece; then those of its views are added that it needs.
    pub fn begin(&mut self, piece: usize) {
        self.photos.clear();
        let alone = self.pieces.len() == 1;
        self.around.hold((!alone).then_some(self.pieces[piece].held.as_slice()));
    }

    /// Adds a view's sensor sites to the piece at hand; `index` is its place in the order of [`Solver::add`], `gain` its
    /// pulse's measured energy.
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
        let found = self.gains[index];
        self.photos.extend(seen.map(|projection| (index, Photo { projection, gain, found })));
        Ok(())
    }

    /// Solves the texels of the piece that was begun; `shot_noise` is the sensor's variance per DN of light.
    pub fn solve(&mut self, piece: usize, shot_noise: f32, progress: &Progress) -> Result<Part, Cancelled> {
        let (views, mut photos): (Vec<usize>, Vec<Photo>) =
            std::mem::take(&mut self.photos).into_iter().unzip();
        let ground = Ground::number(self.size, photos.iter_mut().map(|p| &mut p.projection));
        let start = ground.texels.iter().map(|&t| self.rho.pixels()[t as usize]).collect();
        let joint = solve_jointly(&photos, &ground, start, self.blur, shot_noise, progress)?;
        let mut own = vec![false; self.stage.patches.len()];
        self.pieces[piece].own.iter().for_each(|&p| own[p as usize] = true);
        let mut part = Part { blur: joint.blur, runs: joint.runs, ..Part::default() };
        // A pulse that a piece hardly sees is left to one that tells its energy; of a single piece there is no other.
        let alone = self.pieces.len() == 1;
        let told = |photo: &Photo, gain: &FlashGain| alone || gain.deviation < TOLD * photo.gain.deviation;
        let gains = views.iter().zip(&photos).zip(&joint.gains);
        part.gains = gains.filter(|((_, p), g)| told(p, g)).map(|((v, _), g)| (*v as u32, *g)).collect();
        let cell_of = |place: u32| {
            let (x, y) = (place as usize % self.size, place as usize / self.size);
            ((y / CELL) * self.size.div_ceil(CELL) + x / CELL) as u32
        };
        let mut owned: BTreeMap<u32, usize> = BTreeMap::new();
        for (number, texel) in ground.texels.iter().enumerate() {
            let Ok(place) = self.points.binary_search_by_key(texel, |p| p.texel) else { continue };
            let p = &self.points[place];
            let (element, _) = self.stage.elements.locate(0, p.triangle as usize, p.u, p.v);
            let patch = self.stage.patches.of(element);
            if own[patch] && joint.spoken[number] {
                part.texels.push((p.texel, joint.texels[number]));
                owned.entry(cell_of(p.texel)).or_insert(patch);
            }
        }
        for (place, cell) in joint.cells {
            if let Some(&patch) = owned.get(&place).filter(|_| cell.views > 0) {
                let share = self.bounces.shares[patch];
                let shared = share.map(|s| joint.scale_error.hypot(BOUNCE_ERROR * s));
                let known = Known { sd: cell.sd, shared, residual: cell.residual, views: cell.views };
                part.cells.push((place, known));
            }
        }
        Ok(part)
    }

    /// Puts into the texture what was found of a piece: in the order of the pieces.
    pub fn take(&mut self, part: &Part) {
        for (place, known) in &part.cells {
            let cell = &mut self.cells.pixels_mut()[*place as usize];
            // Of two pieces that meet in a cell the one that sees it better.
            if known.views > cell.views {
                *cell = *known;
            }
        }
        for (place, rho) in &part.texels {
            self.rho.pixels_mut()[*place as usize] = *rho;
            self.seen.pixels_mut()[*place as usize] = true;
        }
        for (view, gain) in &part.gains {
            self.gains[*view as usize].get_or_insert(*gain);
        }
        self.blur.get_or_insert(part.blur);
        if self.runs.is_empty() {
            self.runs.clone_from(&part.runs);
        }
    }

    /// The texture, all pieces taken; `measured` are the energies of the views, for those that tell nothing.
    pub fn finish(mut self, measured: &[FlashGain]) -> Result<Texture, TextureError> {
        let side = self.size.div_ceil(CELL);
        for (at, seen) in self.seen.pixels_mut().iter_mut().enumerate() {
            let (x, y) = (at % self.size, at / self.size);
            *seen &= self.cells.pixels()[(y / CELL) * side + x / CELL].views > 0;
        }
        if !self.seen.pixels().contains(&true) {
            return Err(TextureError::TooSmall);
        }
        let mut surface = Image::filled(self.size, self.size, false);
        self.points.iter().for_each(|p| surface.pixels_mut()[p.texel as usize] = true);
        let gains = self.gains.iter().zip(measured).map(|(found, m)| found.unwrap_or(*m)).collect();
        let rounds = self.bounces.rounds.clone();
        Ok(Texture {
            rho: self.rho,
            surface,
            seen: self.seen,
            cells: self.cells,
            rounds,
            runs: self.runs,
            pieces: self.pieces.len(),
            looks: self.pieces.iter().map(|p| p.views.iter().filter(|sees| **sees).count()).sum(),
            gains,
            blur: self.blur.unwrap_or_default(),
            bounces: self.bounces,
        })
    }
}
