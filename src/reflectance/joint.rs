//! The texture that explains all photographs at once.
//!
//! Minimises, over the texels' reflectance rho and the pulses' energies g,
//!
//! ```text
//! sum over views v and sites s of  w_s (P_s - g_v (A_v rho)_s)^2  +  sum over texels of (rho - rho_0)^2 / prior^2
//!                                                          +  sum over views of (g_v - m_v)^2 / sigma_v^2
//! ```
//!
//! with A the linear view of [`super::project`], m and sigma the energies as measured (or 1 and a strobe's own
//! spread), and rho_0 the elements' robust estimate. w = trust / variance; the variance is the sensor's at the light
//! *expected* (weights that follow the noise of what was read would pull the result down) and the model's own error:
//! a share of the reading, what a small misplacement of the picture changes, and what other surfaces add through the
//! lens's blur. Trust is Tukey's biweight of the residual, taken anew every round.
//!
//! rho by preconditioned conjugate gradients on the normal equations (Hestenes and Stiefel 1952), the preconditioner
//! being the row sums of A'WA, which bound its eigenvalues because A has no negative entry; g and the trusts between
//! the runs. The prior's precision also keeps texels that hardly any site speaks of near the elements' estimate.

use super::project::Projection;
use super::solve::tukey;
use super::uncertainty::{self, Cell};
use crate::photometry::FlashGain;
use crate::progress::{Cancelled, Progress};
use crate::raster::blur::gaussian;
use crate::raster::{Image, Rgb};
use rayon::prelude::*;

/// Standard deviation of a texel about the elements' estimate, of 1: how much detail there may be.
const PRIOR: f32 = 0.2;

/// Model error, relative to the reading.
const MODEL_ERROR: f32 = 0.01;

/// Misplacement of the picture, pixels.
const MISPLACED: f32 = 0.1;

/// Error of the light of other surfaces, relative.
const OTHER_ERROR: f32 = 0.3;

/// Largest share of unknown light in a site that still counts.
const MOST_UNKNOWN: f32 = 0.004;

/// Runs of conjugate gradients, and steps in each.
const RUNS: usize = 3;
const STEPS: usize = 5;

/// Reflectance by texel, row-major, all of the texture's square.
pub(super) type Texels = Vec<[f32; 3]>;

/// What the joint solve found.
pub struct Joint {
    /// Reflectance by texel.
    pub texels: Texels,
    /// Energy of each view's pulse.
    pub gains: Vec<FlashGain>,
    /// Standard deviation of the lens's blur, pixels.
    pub blur: f32,
    /// What each run did.
    pub runs: Vec<Run>,
    /// What is known of each cell of texels.
    pub(super) cells: Image<Cell>,
}

/// One run of the solve.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Run {
    /// Weighted sum of squared residuals over the number of sites, after it.
    pub misfit: f64,
    /// Root mean square change of the texels' reflectance by it.
    pub change: f64,
}

/// What is needed of every view beside the projection.
pub struct Photo {
    /// The view.
    pub projection: Projection,
    /// Its pulse's energy as measured, or a strobe's own spread.
    pub gain: FlashGain,
}

/// Weights of a view's sites; 0 where a site does not count.
pub(super) struct Weights {
    pub(super) sites: Vec<f32>,
}

/// Solves; `start` is the elements' estimate at every texel of a texture `size` x `size`, `shot_noise` the sensor's variance by DN of light.
pub fn solve_jointly(
    photos: &[Photo],
    start: Texels,
    size: usize,
    blur: f32,
    shot_noise: f32,
    progress: &Progress,
) -> Result<Joint, Cancelled> {
    let mut gains: Vec<FlashGain> = photos.iter().map(|p| p.gain).collect();
    let mut texels = start.clone();
    let mut runs = vec![];
    for run in 0..RUNS {
        let state = State { photos, gains: &gains, blur, shot_noise };
        let weights = state.weights(&texels, progress)?;
        let before = texels.clone();
        let misfit = state.descend(&weights, &start, &mut texels, run, progress)?;
        gains = state.energies(&weights, &mut texels);
        let n = texels.len().max(1) as f64;
        let moved: f64 = texels
            .iter()
            .zip(&before)
            .map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>() / 3.0)
            .sum();
        runs.push(Run { misfit, change: (moved / n).sqrt() });
    }
    progress.report("telling the error", 0, 1);
    let state = State { photos, gains: &gains, blur, shot_noise };
    let weights = state.weights(&texels, progress)?;
    let cells = uncertainty::cells(&state, &weights, &texels, size, progress)?;
    Ok(Joint { texels, gains, blur, runs, cells })
}

pub(super) struct State<'a> {
    pub(super) photos: &'a [Photo],
    pub(super) gains: &'a [FlashGain],
    pub(super) blur: f32,
    pub(super) shot_noise: f32,
}

impl State<'_> {
    /// Does something for every view, a few views at a time, and takes the results in the views' order.
    pub(super) fn each_view<T: Send>(
        &self,
        make: impl Fn(usize, &Photo) -> Result<T, Cancelled> + Sync,
        mut take: impl FnMut(usize, T),
    ) -> Result<(), Cancelled> {
        let few = rayon::current_num_threads().max(1);
        for (k, batch) in self.photos.chunks(few).enumerate() {
            let made: Vec<T> = batch
                .par_iter()
                .enumerate()
                .map(|(i, photo)| make(k * few + i, photo))
                .collect::<Result<_, Cancelled>>()?;
            for (i, t) in made.into_iter().enumerate() {
                take(k * few + i, t);
            }
        }
        Ok(())
    }

    pub(super) fn weights(&self, texels: &[[f32; 3]], progress: &Progress) -> Result<Vec<Weights>, Cancelled> {
        let mut all = vec![];
        self.each_view(
            |v, photo| {
                progress.check()?;
                Ok(self.weights_of(v, photo, texels))
            },
            |_, w| all.push(w),
        )?;
        Ok(all)
    }

    fn weights_of(&self, v: usize, photo: &Photo, texels: &[[f32; 3]]) -> Weights {
        let view = &photo.projection;
        let g = self.gains[v].value as f32;
        let predicted = view.predict(texels, true, self.blur);
        let others = view.others(self.blur);
        let unknown = gaussian(&view.unknown, self.blur);
        let (width, height) = (view.window.width, view.window.height);
        let white = view.white(self.blur);
        let mut sites = vec![0.0f32; width * height];
        let mut squares = vec![];
        for y in 0..height {
            for x in 0..width {
                let (i, site) = (y * width + x, view.sites.at(x, y));
                let c = usize::from(site.colour);
                let m = white.at(x, y)[c];
                if !site.variance.is_finite() || unknown.at(x, y)[0] > MOST_UNKNOWN || m <= 0.0 {
                    continue;
                }
                let expected = g * predicted.at(x, y)[c];
                let near = |dx: isize, dy: isize| {
                    predicted.get(x as isize + dx, y as isize + dy).map_or(expected, |p| g * p[c])
                };
                let slope = (near(1, 0) - near(-1, 0)).hypot(near(0, 1) - near(0, -1)) / 2.0;
                let noise =
                    (site.variance + self.shot_noise * (expected.max(0.0) - site.known.max(0.0))).max(0.25);
                let model = (MODEL_ERROR * expected).powi(2)
                    + (MISPLACED * slope).powi(2)
                    + (OTHER_ERROR * g * others.at(x, y)[c]).powi(2);
                let variance = noise + model;
                sites[i] = 1.0 / variance;
                squares.push((i, (site.known - expected) / variance.sqrt()));
            }
        }
        // How far residuals reach is taken from themselves: the start is coarser than the noise.
        let mut sizes: Vec<f32> = squares.iter().map(|(_, e)| e.abs()).collect();
        if let Some(middle) = sizes.len().checked_sub(1).map(|n| n / 2) {
            let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
            let scale = (*median / 0.6745).max(1.0);
            for (i, e) in squares {
                sites[i] *= tukey(e / scale);
            }
        }
        Weights { sites }
    }

    /// Residuals of a view weighted and brought to where [`Projection::carry_back`] takes them, for light `lit`
    /// (through the lens, pulse of energy 1) against the sites; without `known`, minus the light alone.
    fn weighted(&self, v: usize, weights: &Weights, lit: &Rgb, known: bool) -> (Rgb, f64, usize) {
        let view = &self.photos[v].projection;
        let g = self.gains[v].value as f32;
        let mut out = view.blank();
        let (mut misfit, mut count) = (0.0, 0);
        for (i, (site, w)) in view.sites.pixels().iter().zip(&weights.sites).enumerate() {
            if *w > 0.0 {
                let c = usize::from(site.colour);
                let residual = if known { site.known } else { 0.0 } - g * lit.pixels()[i][c];
                out.pixels_mut()[i][c] = g * w * residual;
                misfit += f64::from(w * residual * residual);
                count += 1;
            }
        }
        (gaussian(&out, self.blur), misfit, count)
    }

    /// A' W (P - A rho) (`known`) or -A' W A rho, summed over the views; and the misfit.
    fn gradient(
        &self,
        weights: &[Weights],
        texels: &[[f32; 3]],
        known: bool,
        progress: &Progress,
    ) -> Result<(Texels, f64), Cancelled> {
        let mut sum = vec![[0.0; 3]; texels.len()];
        let (mut misfit, mut count) = (0.0, 0);
        self.each_view(
            |v, photo| {
                progress.check()?;
                let lit = photo.projection.predict(texels, known, self.blur);
                Ok(self.weighted(v, &weights[v], &lit, known))
            },
            |v, (image, m, n)| {
                misfit += m;
                count += n;
                self.photos[v].projection.carry_back(&image, &mut sum);
            },
        )?;
        Ok((sum, misfit / count.max(1) as f64))
    }

    /// Row sums of A' W A.
    fn sums(&self, weights: &[Weights], n: usize, progress: &Progress) -> Result<Texels, Cancelled> {
        let mut sum = vec![[0.0; 3]; n];
        self.each_view(
            |v, photo| {
                progress.check()?;
                let (image, _, _) = self.weighted(v, &weights[v], &photo.projection.white(self.blur), false);
                Ok(image.map(|p| p.map(|x| -x)))
            },
            |v, image| self.photos[v].projection.carry_back(&image, &mut sum),
        )?;
        Ok(sum)
    }

    /// Steps of conjugate gradients; gives the misfit before them.
    fn descend(
        &self,
        weights: &[Weights],
        start: &[[f32; 3]],
        texels: &mut Texels,
        run: usize,
        progress: &Progress,
    ) -> Result<f64, Cancelled> {
        let precision = PRIOR.powi(-2);
        let sums = self.sums(weights, texels.len(), progress)?;
        let (mut residual, misfit) = self.gradient(weights, texels, true, progress)?;
        for ((r, x), s) in residual.iter_mut().zip(texels.iter()).zip(start) {
            (0..3).for_each(|c| r[c] += precision * (s[c] - x[c]));
        }
        let conditioned = |r: &Texels| -> Texels {
            r.par_iter()
                .zip(&sums)
                .map(|(r, m)| std::array::from_fn(|c| r[c] / (m[c] + precision)))
                .collect()
        };
        let mut z = conditioned(&residual);
        let mut direction = z.clone();
        let mut strength = dot(&residual, &z);
        for step in 0..STEPS {
            progress.check()?;
            progress.report("solving texels", run * STEPS + step, RUNS * STEPS);
            let (mut moved, _) = self.gradient(weights, &direction, false, progress)?;
            for (m, d) in moved.iter_mut().zip(&direction) {
                (0..3).for_each(|c| m[c] = precision * d[c] - m[c]);
            }
            let curvature = dot(&direction, &moved);
            let length: [f64; 3] = std::array::from_fn(|c| {
                if curvature[c] > 0.0 { strength[c] / curvature[c] } else { 0.0 }
            });
            for ((x, d), (r, m)) in texels.iter_mut().zip(&direction).zip(residual.iter_mut().zip(&moved)) {
                for c in 0..3 {
                    x[c] += length[c] as f32 * d[c];
                    r[c] -= length[c] as f32 * m[c];
                }
            }
            z = conditioned(&residual);
            let next = dot(&residual, &z);
            for (d, z) in direction.iter_mut().zip(&z) {
                for c in 0..3 {
                    let keep = if strength[c] > 0.0 { (next[c] / strength[c]) as f32 } else { 0.0 };
                    d[c] = z[c] + keep * d[c];
                }
            }
            strength = next;
        }
        Ok(misfit)
    }

    /// Every pulse's energy from its own photograph and its measurement, the texture being what it is. The mean over
    /// the pulses belongs to the texture: it goes where the measurements want it.
    fn energies(&self, weights: &[Weights], texels: &mut Texels) -> Vec<FlashGain> {
        let found: Vec<(f64, f64)> = self
            .photos
            .par_iter()
            .enumerate()
            .map(|(v, photo)| {
                let lit = photo.projection.predict(texels, true, self.blur);
                let (mut above, mut below) = (0.0f64, 0.0f64);
                for (i, site) in photo.projection.sites.pixels().iter().enumerate() {
                    let w = weights[v].sites[i];
                    if w > 0.0 {
                        let a = lit.pixels()[i][usize::from(site.colour)];
                        above += f64::from(w * a * site.known);
                        below += f64::from(w * a * a);
                    }
                }
                (above, below)
            })
            .collect();
        let precision = |photo: &Photo| photo.gain.deviation.max(1e-5).powi(-2);
        let mut gains: Vec<FlashGain> = found
            .iter()
            .zip(self.photos)
            .map(|((above, below), photo)| {
                let p = precision(photo);
                let value = (above + p * photo.gain.value) / (below + p);
                FlashGain { value, deviation: (below + p).sqrt().recip() }
            })
            .collect();
        // g k and rho / k explain the photographs alike: k is such that the measurements agree best.
        let (mut above, mut below) = (0.0, 0.0);
        for (gain, photo) in gains.iter().zip(self.photos) {
            above += precision(photo) * photo.gain.value * gain.value;
            below += precision(photo) * gain.value * gain.value;
        }
        let common = if below > 0.0 { above / below } else { 1.0 };
        gains.iter_mut().for_each(|g| g.value *= common);
        texels.iter_mut().flatten().for_each(|t| *t /= common as f32);
        gains
    }
}

/// Inner products by channel, in an order that does not hang on threads.
fn dot(a: &Texels, b: &Texels) -> [f64; 3] {
    let parts: Vec<[f64; 3]> = a
        .par_chunks(1 << 14)
        .zip(b.par_chunks(1 << 14))
        .map(|(a, b)| {
            let mut sum = [0.0f64; 3];
            for (a, b) in a.iter().zip(b) {
                (0..3).for_each(|c| sum[c] += f64::from(a[c]) * f64::from(b[c]));
            }
            sum
        })
        .collect();
    let mut sum = [0.0; 3];
    for p in parts {
        (0..3).for_each(|c| sum[c] += p[c]);
    }
    sum
}
