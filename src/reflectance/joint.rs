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

use super::project::{Projection, WIDEST_BLUR};
use super::solve::tukey;
use super::uncertainty::{self, Cell};
use crate::photometry::FlashGain;
use crate::progress::{Cancelled, Progress};
use crate::raster::blur::{gaussian, gaussian_each};
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

/// Runs of conjugate gradients: steps in each, and whether the lens's blur is found along.
const RUNS: [(usize, bool); 5] = [(5, false), (5, false), (8, true), (6, true), (6, true)];

/// Standard deviation of the lens's blur before anything is known, pixels, and its bounds.
const FIRST_BLUR: f32 = 0.8;
const BLUR_BOUNDS: (f32, f32) = (0.3, WIDEST_BLUR);

/// Reflectance by texel, row-major, all of the texture's square.
pub(super) type Texels = Vec<[f32; 3]>;

/// What the joint solve found.
pub struct Joint {
    /// Reflectance by texel.
    pub texels: Texels,
    /// Energy of each view's pulse.
    pub gains: Vec<FlashGain>,
    /// Standard deviation of the lens's blur by channel, pixels.
    pub blur: [f32; 3],
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
    /// Standard deviation of the lens's blur after it, by channel, pixels.
    pub blur: [f32; 3],
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
    shot_noise: f32,
    progress: &Progress,
) -> Result<Joint, Cancelled> {
    let mut gains: Vec<FlashGain> = photos.iter().map(|p| p.gain).collect();
    let mut texels = start.clone();
    let mut blur = [FIRST_BLUR; 3];
    let (mut runs, mut done) = (vec![], 0);
    for (steps, lens) in RUNS {
        let state = State { photos, gains: &gains, blur, shot_noise };
        let weights = state.weights(&texels, progress)?;
        let before = texels.clone();
        let mut system = System::new(&state, &weights, &start, &texels, lens, progress)?;
        let misfit = system.misfit;
        for step in 0..steps {
            progress.report("solving texels", done + step, RUNS.iter().map(|r| r.0).sum());
            system.step(&mut texels, progress)?;
        }
        done += steps;
        let wider = system.blur;
        gains = state.energies(&weights, &mut texels);
        for c in 0..3 {
            let (least, most) = BLUR_BOUNDS;
            blur[c] = (blur[c] * blur[c] + wider[c] as f32).max(least * least).sqrt().min(most);
        }
        let n = texels.len().max(1) as f64;
        let moved: f64 = texels
            .iter()
            .zip(&before)
            .map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>() / 3.0)
            .sum();
        runs.push(Run { misfit, change: (moved / n).sqrt(), blur });
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
    pub(super) blur: [f32; 3],
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

    pub(super) fn weights(
        &self,
        texels: &[[f32; 3]],
        progress: &Progress,
    ) -> Result<Vec<Weights>, Cancelled> {
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
        let unknown = gaussian(&view.unknown, self.blur.into_iter().fold(0.0, f32::max));
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

    /// What the light `lit` (through the lens, pulse of energy 1) leaves of the sites, or with `known` false minus that
    /// light alone, weighted and brought to where [`Projection::carry_back`] takes it.
    fn weighted(&self, v: usize, weights: &Weights, lit: &Rgb, known: bool, lens: Option<&Rgb>) -> Part {
        let view = &self.photos[v].projection;
        let g = self.gains[v].value as f32;
        let mut image = view.blank();
        let mut part = Part::default();
        for (i, (site, w)) in view.sites.pixels().iter().zip(&weights.sites).enumerate() {
            if *w > 0.0 {
                let c = usize::from(site.colour);
                let residual = if known { site.known } else { 0.0 } - g * lit.pixels()[i][c];
                image.pixels_mut()[i][c] = g * w * residual;
                part.misfit += f64::from(w * residual * residual);
                part.count += 1;
                if let Some(lens) = lens {
                    let slope = g * lens.pixels()[i][c];
                    part.lens[c] += f64::from(slope * w * residual);
                    part.lens_square[c] += f64::from(slope * slope * w);
                }
            }
        }
        part.image = Some(gaussian_each(&image, self.blur));
        part
    }

    /// A' W (P - A rho) (`known`) or -A' W A rho, summed over the views; `wider` adds as much of the lens's slopes.
    fn gradient(
        &self,
        weights: &[Weights],
        texels: &[[f32; 3]],
        known: bool,
        lens: Option<(&[Rgb], [f64; 3])>,
        progress: &Progress,
    ) -> Result<(Texels, Part), Cancelled> {
        let mut sum = vec![[0.0; 3]; texels.len()];
        let mut all = Part::default();
        self.each_view(
            |v, photo| {
                progress.check()?;
                let mut lit = photo.projection.predict(texels, known, self.blur);
                let slopes = lens.map(|(slopes, wider)| {
                    for (l, s) in lit.pixels_mut().iter_mut().zip(slopes[v].pixels()) {
                        (0..3).for_each(|c| l[c] += wider[c] as f32 * s[c]);
                    }
                    &slopes[v]
                });
                Ok(self.weighted(v, &weights[v], &lit, known, slopes))
            },
            |v, mut part| {
                all.misfit += part.misfit;
                all.count += part.count;
                for c in 0..3 {
                    all.lens[c] += part.lens[c];
                    all.lens_square[c] += part.lens_square[c];
                }
                if let Some(image) = part.image.take() {
                    self.photos[v].projection.carry_back(&image, &mut sum);
                }
            },
        )?;
        Ok((sum, all))
    }

    /// How each view's reading changes with the blur's variance: by the heat equation, half its Laplacian.
    fn lens_slopes(&self, texels: &[[f32; 3]], progress: &Progress) -> Result<Vec<Rgb>, Cancelled> {
        let mut all = vec![];
        self.each_view(
            |_, photo| {
                progress.check()?;
                let lit = photo.projection.predict(texels, true, self.blur);
                Ok(Image::from_fn(lit.width(), lit.height(), |x, y| {
                    let own = *lit.at(x, y);
                    let near =
                        |dx: isize, dy: isize| *lit.get(x as isize + dx, y as isize + dy).unwrap_or(&own);
                    let (l, r, u, d) = (near(-1, 0), near(1, 0), near(0, -1), near(0, 1));
                    std::array::from_fn(|c| 0.5 * (l[c] + r[c] + u[c] + d[c] - 4.0 * own[c]))
                }))
            },
            |_, slopes| all.push(slopes),
        )?;
        Ok(all)
    }

    /// Row sums of A' W A.
    fn sums(&self, weights: &[Weights], n: usize, progress: &Progress) -> Result<Texels, Cancelled> {
        let mut sum = vec![[0.0; 3]; n];
        self.each_view(
            |v, photo| {
                progress.check()?;
                let white = photo.projection.white(self.blur);
                Ok(self.weighted(v, &weights[v], &white, false, None).image)
            },
            |v, image| {
                if let Some(image) = image {
                    self.photos[v].projection.carry_back(&image, &mut sum);
                }
            },
        )?;
        sum.iter_mut().flatten().for_each(|s| *s = -*s);
        Ok(sum)
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

/// What one view, or all of them, add to a gradient.
#[derive(Default)]
struct Part {
    image: Option<Rgb>,
    misfit: f64,
    count: usize,
    lens: [f64; 3],
    lens_square: [f64; 3],
}

/// Preconditioned conjugate gradients on texels and, if asked, the variance of the lens's blur by channel.
struct System<'a> {
    state: &'a State<'a>,
    weights: &'a [Weights],
    slopes: Vec<Rgb>,
    sums: Texels,
    residual: Texels,
    direction: Texels,
    /// The same of the blur's variance, by channel, and what it has come to.
    lens: Lens,
    blur: [f64; 3],
    strength: [f64; 3],
    misfit: f64,
}

#[derive(Clone, Copy, Default)]
struct Lens {
    sum: [f64; 3],
    residual: [f64; 3],
    direction: [f64; 3],
}

impl<'a> System<'a> {
    fn new(
        state: &'a State<'a>,
        weights: &'a [Weights],
        start: &[[f32; 3]],
        texels: &Texels,
        lens: bool,
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let slopes = if lens { state.lens_slopes(texels, progress)? } else { vec![] };
        let sums = state.sums(weights, texels.len(), progress)?;
        let with = lens.then_some((slopes.as_slice(), [0.0; 3]));
        let (mut residual, part) = state.gradient(weights, texels, true, with, progress)?;
        for ((r, x), s) in residual.iter_mut().zip(texels).zip(start) {
            (0..3).for_each(|c| r[c] += PRIOR.powi(-2) * (s[c] - x[c]));
        }
        let mut system = Self {
            state,
            weights,
            slopes,
            sums,
            residual,
            direction: vec![],
            lens: Lens { sum: part.lens_square, residual: part.lens, direction: [0.0; 3] },
            blur: [0.0; 3],
            strength: [0.0; 3],
            misfit: part.misfit / part.count.max(1) as f64,
        };
        let (z, lens_z) = system.conditioned();
        system.strength = system.product(&z, &lens_z);
        (system.direction, system.lens.direction) = (z, lens_z);
        Ok(system)
    }

    fn conditioned(&self) -> (Texels, [f64; 3]) {
        let z = self.residual.par_iter().zip(&self.sums);
        let z = z.map(|(r, m)| std::array::from_fn(|c| r[c] / (m[c] + PRIOR.powi(-2)))).collect();
        let lens = std::array::from_fn(|c| {
            if self.lens.sum[c] > 0.0 { self.lens.residual[c] / self.lens.sum[c] } else { 0.0 }
        });
        (z, lens)
    }

    fn product(&self, z: &Texels, lens: &[f64; 3]) -> [f64; 3] {
        let d = dot(&self.residual, z);
        std::array::from_fn(|c| d[c] + self.lens.residual[c] * lens[c])
    }

    fn step(&mut self, texels: &mut Texels, progress: &Progress) -> Result<(), Cancelled> {
        let with = (!self.slopes.is_empty()).then_some((self.slopes.as_slice(), self.lens.direction));
        let (mut moved, part) = self.state.gradient(self.weights, &self.direction, false, with, progress)?;
        for (m, d) in moved.iter_mut().zip(&self.direction) {
            (0..3).for_each(|c| m[c] = PRIOR.powi(-2) * d[c] - m[c]);
        }
        let curvature = dot(&self.direction, &moved);
        let length: [f64; 3] = std::array::from_fn(|c| {
            let curvature = curvature[c] - self.lens.direction[c] * part.lens[c];
            if curvature > 0.0 { self.strength[c] / curvature } else { 0.0 }
        });
        let rows = texels.iter_mut().zip(&self.direction).zip(self.residual.iter_mut().zip(&moved));
        for ((x, d), (r, m)) in rows {
            for c in 0..3 {
                x[c] += length[c] as f32 * d[c];
                r[c] -= length[c] as f32 * m[c];
            }
        }
        for (c, length) in length.into_iter().enumerate() {
            self.blur[c] += length * self.lens.direction[c];
            self.lens.residual[c] += length * part.lens[c];
        }
        let (z, lens_z) = self.conditioned();
        let next = self.product(&z, &lens_z);
        let keep: [f64; 3] =
            std::array::from_fn(|c| if self.strength[c] > 0.0 { next[c] / self.strength[c] } else { 0.0 });
        for (d, z) in self.direction.iter_mut().zip(&z) {
            (0..3).for_each(|c| d[c] = z[c] + keep[c] as f32 * d[c]);
        }
        (0..3).for_each(|c| self.lens.direction[c] = lens_z[c] + keep[c] * self.lens.direction[c]);
        self.strength = next;
        Ok(())
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
