//! One state of the joint solve: what the views' sites are worth, what they leave to explain, and their pulses.

use super::{Photo, Texels, precision};
use crate::photometry::FlashGain;
use crate::progress::{Cancelled, Progress};
use crate::raster::blur::{gaussian, gaussian_each};
use crate::raster::{Image, Rgb};
use crate::reflectance::projection::Ground;
use crate::reflectance::solve::{MEDIAN_OF_NORMAL, tukey};
use rayon::prelude::*;

/// Model error, relative to the reading.
pub(in crate::reflectance) const MODEL_ERROR: f32 = 0.01;

/// Misplacement of the picture, pixels.
pub(in crate::reflectance) const MISPLACED: f32 = 0.1;

/// Error of the light of other surfaces, relative.
pub(in crate::reflectance) const OTHER_ERROR: f32 = 0.3;

/// Largest share of unknown light in a site that still counts.
const MOST_UNKNOWN: f32 = 0.004;

/// Sites within this many standard deviations of the blur from the frame's border do not count.
const FRAME_REACH: f32 = 3.0;

/// Least share of a site's own noise that is left when less light is expected than was read.
const LEAST_NOISE: f32 = 0.1;

/// What poses, mesh and bounces may do to a whole view, relative: no photograph tells its pulse's energy better.
const ENERGY_ERROR: f64 = 1e-3;

/// Weights of a view's sites; 0 where a site does not count.
pub(in crate::reflectance) struct Weights {
    pub(in crate::reflectance) sites: Vec<f32>,
}

pub(in crate::reflectance) struct State<'a> {
    pub(in crate::reflectance) photos: &'a [Photo],
    pub(in crate::reflectance) ground: &'a Ground,
    pub(in crate::reflectance) gains: &'a [FlashGain],
    pub(in crate::reflectance) blur: [f32; 3],
    pub(in crate::reflectance) shot_noise: f32,
}

impl State<'_> {
    /// Does something for every view, a few views at a time, and takes the results in the views' order.
    pub(in crate::reflectance) fn each_view<T: Send>(
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

    pub(in crate::reflectance) fn weights(
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
        let reach = self.blur.into_iter().fold(0.0, f32::max) * FRAME_REACH;
        let mut sites = vec![0.0f32; width * height];
        let mut squares = vec![];
        for y in 0..height {
            for x in 0..width {
                let (i, site) = (y * width + x, view.sites.at(x, y));
                let c = usize::from(site.colour);
                let m = white.at(x, y)[c];
                let open =
                    unknown.at(x, y)[0] > MOST_UNKNOWN || view.at_frame_edge(x, y, reach.ceil() as usize);
                if !site.variance.is_finite() || open || m <= 0.0 {
                    continue;
                }
                let expected = g * predicted.at(x, y)[c];
                let near = |dx: isize, dy: isize| {
                    predicted.get(x as isize + dx, y as isize + dy).map_or(expected, |p| g * p[c])
                };
                let slope = (near(1, 0) - near(-1, 0)).hypot(near(0, 1) - near(0, -1)) / 2.0;
                // Shot noise grows with light: less of it is expected than was read, or more.
                let shot = self.shot_noise * (expected.max(0.0) - site.known.max(0.0));
                let noise = (site.variance + shot).max(LEAST_NOISE * site.variance);
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
            let scale = (*median / MEDIAN_OF_NORMAL).max(1.0);
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
    pub(super) fn gradient(
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
                    self.photos[v].projection.carry_back(self.ground, &image, &mut sum);
                }
            },
        )?;
        Ok((sum, all))
    }

    /// How each view's reading changes with the blur's variance: by the heat equation, half its Laplacian.
    pub(super) fn lens_slopes(
        &self,
        texels: &[[f32; 3]],
        progress: &Progress,
    ) -> Result<Vec<Rgb>, Cancelled> {
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
    pub(super) fn sums(&self, weights: &[Weights], progress: &Progress) -> Result<Texels, Cancelled> {
        let mut sum = vec![[0.0; 3]; self.ground.len()];
        self.each_view(
            |v, photo| {
                progress.check()?;
                let white = photo.projection.white(self.blur);
                Ok(self.weighted(v, &weights[v], &white, false, None).image)
            },
            |v, image| {
                if let Some(image) = image {
                    self.photos[v].projection.carry_back(self.ground, &image, &mut sum);
                }
            },
        )?;
        sum.iter_mut().flatten().for_each(|s| *s = -*s);
        Ok(sum)
    }

    /// Every pulse's energy from its own photograph and its measurement, the texture being what it is. The mean over
    /// the pulses belongs to the texture: it goes where the measurements want it.
    pub(super) fn energies(&self, weights: &[Weights], texels: &mut Texels) -> Vec<FlashGain> {
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
        let mut gains: Vec<FlashGain> = found
            .iter()
            .zip(self.photos)
            .map(|((above, below), photo)| {
                if let Some(found) = photo.found {
                    return found;
                }
                let p = precision(photo);
                // Errors of one view hang together, so its millions of sites do not make it exact.
                let share = (ENERGY_ERROR.powi(-2) / below).min(1.0);
                let (above, below) = (above * share, below * share);
                let value = (above + p * photo.gain.value) / (below + p);
                FlashGain { value, deviation: (below + p).sqrt().recip() }
            })
            .collect();
        // g k and rho / k explain the photographs alike: k is such that the measurements agree best, unless another
        // part of the texture has settled it.
        if self.photos.iter().any(|p| p.found.is_some()) {
            return gains;
        }
        let (mut above, mut below) = (0.0, 0.0);
        for (gain, photo) in gains.iter().zip(self.photos) {
            above += precision(photo) * photo.gain.value * gain.value;
            below += precision(photo) * gain.value * gain.value;
        }
        let common = if below > 0.0 { above / below } else { 1.0 };
        gains.iter_mut().for_each(|g| (g.value, g.deviation) = (g.value * common, g.deviation * common));
        texels.iter_mut().flatten().for_each(|t| *t /= common as f32);
        gains
    }
}

/// What one view, or all of them, add to a gradient.
#[derive(Default)]
pub(super) struct Part {
    image: Option<Rgb>,
    pub(super) misfit: f64,
    pub(super) count: usize,
    pub(super) lens: [f64; 3],
    pub(super) lens_square: [f64; 3],
}
