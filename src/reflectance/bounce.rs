//! Bounced light, simulated again and again with the reflectance found so far.
//!
//! On the patches of [`crate::light::Patches`], for every view v: `E_v = T (rho (D_v + E_v))`, D being the
//! flash's direct light and T the geometry's transport. White bounces (the thesis) leave the result too dark,
//! none too bright; with the estimate put back in, both errors shrink round by round.

use super::mirror::{many, mirrored};
use super::observe::Observation;
use super::robust::{Glint, Lobe};
use super::solve::{Reading, solve};
use super::stage::Stage;
use crate::light::{Patches, Transport};
use crate::progress::{Cancelled, Progress};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Most rounds of simulating and solving.
const MOST_ROUNDS: usize = 6;

/// The estimate stands still when its mean change per round is below this (of 1).
const STILL: f64 = 2e-4;

/// Bounces are followed until one changes the bounced light by less than this share, and at most so many.
const SETTLED: f64 = 1e-3;
const MOST_BOUNCES: usize = 40;

/// Transport loses no energy of its own, so a reflectance at or above one would grow without end.
const MOST_REFLECTANCE: f32 = 0.97;

/// Most rounds of looking for a gloss: while it counts as paint, too much bounced light is taken off the readings that it
/// is looked for in, and what it mirrors is only guessed. It stands still when its width is the same and its weight changes
/// by less than a share.
const GLOSS_ROUNDS: usize = 8;
const GLOSS_STILL: f32 = 0.03;

/// Relative error of a reading beside noise when the gloss is looked for: texture within a patch, pose, mesh.
const SCATTER: f32 = 0.03;

/// Readings in less direct light than this share of a point's brightest tell no gloss.
const LIT: f32 = 0.1;

/// How far one round moved the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// Area-weighted mean of |change of rho| over the observed patches and channels.
    pub mean_change: f64,
}

/// Light and reflectance on the patches.
pub struct Bounces {
    views: usize,
    /// Irradiance by bounces in DN, `[patch][view][channel]`.
    irradiance: Vec<f32>,
    /// What a gloss mirrors of other surfaces, laid out likewise; before any gloss is found, empty.
    mirrored: Vec<f32>,
    /// Reflectance by patch.
    pub rho: Vec<[f32; 3]>,
    /// What each round changed.
    pub rounds: Vec<Round>,
    /// Share of bounced light in each patch's light, by channel.
    pub shares: Vec<[f32; 3]>,
    /// The gloss of each mesh, where one was found: to be taken off every observation of it.
    pub gloss: Vec<Option<Lobe>>,
}

/// What one view gives: where its camera stands, the flash's irradiance per unit radiance on every patch, its radiance per channel
/// (DN), and its observations by patch, ascending.
pub struct ViewLight {
    /// Centre of the camera, metres, world frame.
    pub eye: Vec3,
    /// Irradiance per unit radiance, one a patch.
    pub direct: Vec<f32>,
    /// Radiance, DN.
    pub radiance: [f64; 3],
    /// Observations of patches.
    pub seen: Vec<(u32, Observation)>,
}

impl Bounces {
    /// Simulates and solves until the estimate stands still.
    pub fn settle(
        stage: &Stage,
        transport: &Transport,
        views: &[ViewLight],
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let patches = &stage.patches;
        let width = 3 * views.len();
        let mut seen = by_patch(patches.len(), views);
        let meshes = (0..patches.len()).map(|e| patches.mesh_of(e) + 1).max().unwrap_or(0);
        let mut state = Self {
            views: views.len(),
            irradiance: vec![0.0; patches.len() * width],
            mirrored: vec![],
            rho: vec![],
            rounds: vec![],
            shares: vec![],
            gloss: vec![None; meshes],
        };
        state.rho = state.solve_patches(patches, &seen);
        state.iterate(patches, transport, views, &seen, progress)?;
        for _ in 0..GLOSS_ROUNDS {
            let before = state.gloss.clone();
            if !state.find_gloss(patches, &mut seen, progress)? {
                break;
            }
            let still = |(before, now): (&Option<Lobe>, &Option<Lobe>)| match (before, now) {
                (Some(a), Some(b)) => {
                    a.alpha == b.alpha && (a.weight - b.weight).abs() < GLOSS_STILL * b.weight
                }
                (a, b) => a.is_none() && b.is_none(),
            };
            let still = before.iter().zip(&state.gloss).all(still);
            state.mirror(stage, views, progress)?;
            state.rho = state.solve_patches(patches, &seen);
            state.iterate(patches, transport, views, &seen, progress)?;
            if still {
                break;
            }
        }
        state.shares = state.shares(views);
        state.mirrored = vec![];
        Ok(state)
    }

    /// Rounds of simulating and solving.
    fn iterate(
        &mut self,
        patches: &Patches,
        transport: &Transport,
        views: &[ViewLight],
        seen: &Seen,
        progress: &Progress,
    ) -> Result<(), Cancelled> {
        let state = self;
        let width = 3 * views.len();
        for round in 0..MOST_ROUNDS {
            progress.report("bounces, round", round, MOST_ROUNDS);
            // The later rounds go on from the earlier ones' light.
            let mut irradiance = std::mem::take(&mut state.irradiance);
            let emit = |bounced: &[f32], exitance: &mut [f32]| state.emit(patches, views, bounced, exitance);
            transport.settle(width, &mut irradiance, (SETTLED, MOST_BOUNCES), emit, progress)?;
            state.irradiance = irradiance;
            let next = state.solve_patches(patches, seen);
            let change = mean_change(patches, seen, &state.rho, &next);
            state.rho = next;
            state.rounds.push(Round { mean_change: change });
            if change < STILL {
                break;
            }
        }
        Ok(())
    }

    /// Looks for a gloss on each mesh and takes it off what was seen of it, in place of the one found before; tells
    /// whether there is any.
    fn find_gloss(
        &mut self,
        patches: &Patches,
        seen: &mut Seen,
        progress: &Progress,
    ) -> Result<bool, Cancelled> {
        for e in 0..patches.len() {
            if let Some(lobe) = self.gloss[patches.mesh_of(e)] {
                seen.of_mut(e).iter_mut().for_each(|(_, o)| lobe.put_back(o));
            }
        }
        for mesh in 0..self.gloss.len() {
            progress.check()?;
            let glints: Vec<Vec<Glint>> = (0..patches.len())
                .into_par_iter()
                .filter(|&e| patches.mesh_of(e) == mesh)
                .map(|e| self.glints(e, seen.of(e)))
                .collect();
            self.gloss[mesh] = Lobe::fit(&glints);
            if let Some(lobe) = self.gloss[mesh] {
                tracing::info!("mesh {mesh} is glossy: weight {:.3}, alpha {:.3}", lobe.weight, lobe.alpha);
            }
        }
        for e in 0..patches.len() {
            if let Some(lobe) = self.gloss[patches.mesh_of(e)] {
                seen.of_mut(e).iter_mut().for_each(|(_, o)| lobe.take_off(o));
            }
        }
        Ok(self.gloss.iter().any(Option::is_some))
    }

    /// Traces what the glosses found mirror of the present light.
    fn mirror(&mut self, stage: &Stage, views: &[ViewLight], progress: &Progress) -> Result<(), Cancelled> {
        let width = 3 * self.views;
        let mut exitance = vec![0.0; self.irradiance.len()];
        self.emit(&stage.patches, views, &self.irradiance, &mut exitance);
        self.mirrored.resize(self.irradiance.len(), 0.0);
        for (v, view) in views.iter().enumerate() {
            progress.check()?;
            let of_view = |e: usize| [0, 1, 2].map(|c| exitance[e * width + 3 * v + c]);
            let sent: Vec<[f32; 3]> = (0..stage.patches.len()).map(of_view).collect();
            for (e, light) in mirrored(stage, view.eye, &self.gloss, &sent, many).into_iter().enumerate() {
                let at = e * width + 3 * v;
                self.mirrored[at..at + 3].copy_from_slice(&light);
            }
        }
        Ok(())
    }

    /// Mirrored light at a place of the layout; as good as any guess before it is traced is the bounced light.
    fn mirrored_at(&self, at: usize) -> f32 {
        *self.mirrored.get(at).unwrap_or(&self.irradiance[at])
    }

    /// A patch's readings, bounced light taken off by the present estimate.
    fn glints(&self, patch: usize, seen: &[(u16, Observation)]) -> Vec<Glint> {
        let brightest = seen.iter().map(|(_, o)| o.white[1]).fold(0.0, f32::max);
        let glint = |(view, o): &(u16, Observation)| {
            let at = 3 * (patch * self.views + usize::from(*view));
            let (mut ratio, mut variance, mut mirrored) = (0.0, 0.0, 0.0);
            for c in 0..3 {
                let rho = self.rho[patch][c];
                ratio += (o.known[c] - rho * o.response * self.irradiance[at + c]) / o.white[c] / 3.0;
                mirrored += o.response * self.mirrored_at(at + c) / o.white[c] / 3.0;
                let scatter = SCATTER * rho * o.white[c];
                variance += (o.variance[c] + scatter * scatter) / (3.0 * o.white[c]).powi(2);
            }
            Glint { ratio, weight: variance.recip(), facing: o.facing, mirrored }
        };
        let lit = seen.iter().filter(|(_, o)| o.white.iter().all(|&m| m > LIT * brightest && m > 0.0));
        lit.map(glint).filter(|g| g.ratio.is_finite() && g.weight.is_finite() && g.weight > 0.0).collect()
    }

    /// Irradiance by bounces on every patch for one view, DN.
    pub fn of_view(&self, view: usize) -> Vec<[f32; 3]> {
        let all = self.irradiance.chunks_exact(3 * self.views);
        all.map(|all| [all[3 * view], all[3 * view + 1], all[3 * view + 2]]).collect()
    }

    /// Share of bounced light in all the light of the views that light a patch, by channel.
    fn shares(&self, views: &[ViewLight]) -> Vec<[f32; 3]> {
        self.irradiance
            .par_chunks_exact(3 * self.views)
            .enumerate()
            .map(|(e, bounced)| {
                let (mut part, mut all) = ([0.0f32; 3], [0.0f32; 3]);
                for (view, bounced) in views.iter().zip(bounced.chunks_exact(3)) {
                    for c in 0..3 {
                        let direct = view.direct[e] * view.radiance[c] as f32;
                        // Views in whose light it is brightest tell most of it.
                        part[c] += direct * bounced[c];
                        all[c] += direct * (direct + bounced[c]);
                    }
                }
                std::array::from_fn(|c| if all[c] > 0.0 { part[c] / all[c] } else { 1.0 })
            })
            .collect()
    }

    /// Exitance rho (D + E) of every patch for every view.
    fn emit(&self, patches: &Patches, views: &[ViewLight], irradiance: &[f32], exitance: &mut [f32]) {
        let width = 3 * self.views;
        let gloss = sent_by(&self.gloss);
        exitance.par_chunks_mut(width).zip(irradiance.par_chunks(width)).enumerate().for_each(
            |(e, (out, bounced))| {
                let sent = sent_on(self.rho[e], gloss[patches.mesh_of(e)]);
                for (v, view) in views.iter().enumerate() {
                    for c in 0..3 {
                        let light = view.direct[e] * view.radiance[c] as f32 + bounced[3 * v + c];
                        out[3 * v + c] = sent[c] * light;
                    }
                }
            },
        );
    }

    /// Reflectance of every patch with the present bounces; what no view sees takes after the seen surface
    /// round it, and what is not connected to any takes its mesh's mean.
    fn solve_patches(&self, patches: &Patches, seen: &Seen) -> Vec<[f32; 3]> {
        let width = 3 * self.views;
        let mut solved: Vec<Option<[f32; 3]>> = (0..patches.len())
            .into_par_iter()
            .map(|e| {
                let readings: Vec<Reading> = seen
                    .of(e)
                    .iter()
                    .map(|(view, o)| {
                        let at = e * width + 3 * *view as usize;
                        let mirrored = [0, 1, 2].map(|c| self.mirrored_at(at + c));
                        reading(o, &[0, 1, 2].map(|c| self.irradiance[at + c]), &mirrored)
                    })
                    .collect();
                solve(&readings).map(|estimate| estimate.rho)
            })
            .collect();
        let meshes = (0..patches.len()).map(|e| patches.mesh_of(e) + 1).max().unwrap_or(0);
        let (mut sum, mut area) = (vec![[0.0f64; 3]; meshes], vec![0.0f64; meshes]);
        for (e, rho) in solved.iter().enumerate() {
            if let Some(rho) = rho {
                let (mesh, a) = (patches.mesh_of(e), f64::from(patches.area(e)));
                area[mesh] += a;
                for c in 0..3 {
                    sum[mesh][c] += a * f64::from(rho[c]);
                }
            }
        }
        let mean = |m: usize| sum[m].map(|s| if area[m] > 0.0 { (s / area[m]) as f32 } else { 0.0 });
        let means: Vec<[f32; 3]> = (0..meshes).map(mean).collect();
        patches.spread(&mut solved);
        solved.iter().enumerate().map(|(e, rho)| rho.unwrap_or(means[patches.mesh_of(e)])).collect()
    }
}

/// Share of its light that a patch of reflectance `rho` sends on: its paint's, and what a gloss throws on others
/// ([`Lobe::sends_on`]), which goes all ways on the whole, as from paint.
pub fn sent_on(rho: [f32; 3], gloss: f32) -> [f32; 3] {
    rho.map(|rho| (rho + gloss).clamp(0.0, MOST_REFLECTANCE))
}

/// Share of light that the gloss of each mesh sends on.
pub fn sent_by(gloss: &[Option<Lobe>]) -> Vec<f32> {
    gloss.iter().map(|lobe| lobe.map_or(0.0, |lobe| lobe.sends_on())).collect()
}

/// Irradiance by bounces (DN) on every patch in one view's light, for patches of which it is known already what
/// share of their light they send on ([`sent_on`]).
pub fn simulate(
    transport: &Transport,
    direct: &[f32],
    radiance: [f64; 3],
    sent: &[[f32; 3]],
    progress: &Progress,
) -> Result<Vec<[f32; 3]>, Cancelled> {
    let mut irradiance = vec![0.0f32; 3 * sent.len()];
    let emit = |bounced: &[f32], exitance: &mut [f32]| {
        exitance.par_chunks_mut(3).zip(bounced.par_chunks(3)).enumerate().for_each(|(e, (out, bounced))| {
            for c in 0..3 {
                let light = direct[e] * radiance[c] as f32 + bounced[c];
                out[c] = sent[e][c].clamp(0.0, MOST_REFLECTANCE) * light;
            }
        });
    };
    transport.settle(3, &mut irradiance, (SETTLED, MOST_BOUNCES), emit, progress)?;
    Ok(irradiance.chunks_exact(3).map(|e| [e[0], e[1], e[2]]).collect())
}

/// The observation with bounced irradiance (DN) added to what white would have read, and what a gloss mirrors (DN)
/// taken off.
fn reading(o: &Observation, bounced: &[f32; 3], mirrored: &[f32; 3]) -> Reading {
    let white = std::array::from_fn(|c| o.white[c] + o.response * bounced[c]);
    let known = std::array::from_fn(|c| o.known[c] - o.gloss * o.response * mirrored[c]);
    Reading { known, variance: o.variance, white, resolution: o.resolution }
}

/// Observations sorted by patch.
struct Seen {
    starts: Vec<u32>,
    list: Vec<(u16, Observation)>,
}

impl Seen {
    fn of(&self, patch: usize) -> &[(u16, Observation)] {
        &self.list[self.starts[patch] as usize..self.starts[patch + 1] as usize]
    }

    fn of_mut(&mut self, patch: usize) -> &mut [(u16, Observation)] {
        &mut self.list[self.starts[patch] as usize..self.starts[patch + 1] as usize]
    }
}

fn by_patch(patches: usize, views: &[ViewLight]) -> Seen {
    let mut starts = vec![0u32; patches + 1];
    let observed =
        || views.iter().enumerate().flat_map(|(v, view)| view.seen.iter().map(move |s| (v as u16, s)));
    observed().for_each(|(_, (p, _))| starts[*p as usize + 1] += 1);
    (0..patches).for_each(|p| starts[p + 1] += starts[p]);
    let (mut next, mut list) = (starts.clone(), vec![(0, Observation::default()); starts[patches] as usize]);
    for (v, (p, o)) in observed() {
        let next = &mut next[*p as usize];
        list[*next as usize] = (v, *o);
        *next += 1;
    }
    Seen { starts, list }
}

fn mean_change(patches: &Patches, seen: &Seen, before: &[[f32; 3]], after: &[[f32; 3]]) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for e in (0..patches.len()).filter(|&e| !seen.of(e).is_empty()) {
        let a = f64::from(patches.area(e));
        area += a;
        sum += a * (0..3).map(|c| f64::from((after[e][c] - before[e][c]).abs())).sum::<f64>() / 3.0;
    }
    if area > 0.0 { sum / area } else { 0.0 }
}
