//! A photograph as a linear function of the texture, and the transpose of it: what [`super::project`] makes.
//!
//! The texture's texels are numbered by a `Ground`: only those that some view speaks of, in rows, so that what is
//! solved for is as long as what is seen, however large the texture is.

use super::project::{GRID, Sample};
use crate::raster::blur::gaussian_each;
use crate::raster::{Image, Rgb};
use rayon::prelude::*;

/// Rows of the texture that one task writes.
const BAND: usize = 32;

/// Widest lens blur that a margin is kept for, pixels.
pub const WIDEST_BLUR: f32 = 2.5;

/// Parts that the distance between two texels is told in.
const PARTS: f32 = 65536.0;

/// One ray that meets the texture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// Pixel of the window, row-major.
    pub(super) pixel: u32,
    /// Upper left and lower left of the four texels round the place; the right ones follow them.
    pub(super) top: u32,
    below: u32,
    /// Where between them, from 0 to nearly 1.
    at: [u16; 2],
    /// Its share of the pixel's white.
    share: f32,
}

impl Ray {
    /// By the numbering of the whole texture, `size` x `size`; `white` is the sum over each pixel's rays.
    pub(super) fn of(s: &Sample, white: &Rgb, size: usize) -> Self {
        let all: f32 = white.pixels()[s.pixel as usize].iter().sum();
        let share = if all > 0.0 { s.white.iter().sum::<f32>() / all } else { 0.0 };
        let at = s.at.map(|f| (f * PARTS).clamp(0.0, PARTS - 1.0) as u16);
        Self { pixel: s.pixel, top: s.texel, below: s.texel + size as u32, at, share }
    }

    /// The four texels with their weights.
    fn texels(&self) -> [(usize, f32); 4] {
        let [fx, fy] = self.at.map(|f| f32::from(f) / PARTS);
        let (top, below) = (self.top as usize, self.below as usize);
        [
            (top, (1.0 - fx) * (1.0 - fy)),
            (top + 1, fx * (1.0 - fy)),
            (below, (1.0 - fx) * fy),
            (below + 1, fx * fy),
        ]
    }

    fn read(&self, texels: &[[f32; 3]]) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for (texel, weight) in self.texels() {
            let rho = &texels[texel];
            (0..3).for_each(|c| sum[c] += weight * rho[c]);
        }
        sum
    }
}

/// Numbers for the texels that some views speak of.
pub(super) struct Ground {
    /// Side of the texture.
    pub(super) size: usize,
    /// Place in the whole texture of each, ascending.
    pub(super) texels: Vec<u32>,
    /// Number of the first texel of each band of rows, and one past the last.
    bands: Vec<u32>,
}

impl Ground {
    /// Numbers the texels of a texture `size` x `size` that `views` speak of, and has the views use these numbers.
    pub(super) fn number<'a>(size: usize, views: impl Iterator<Item = &'a mut Projection>) -> Self {
        let mut views: Vec<&mut Projection> = views.collect();
        let mut used = vec![0u64; (size * size).div_ceil(64)];
        for ray in views.iter().flat_map(|view| &view.rays) {
            for texel in [ray.top, ray.top + 1, ray.below, ray.below + 1] {
                used[texel as usize / 64] |= 1 << (texel % 64);
            }
        }
        let mut before = Vec::with_capacity(used.len());
        let mut texels = vec![];
        for (k, word) in used.iter().enumerate() {
            before.push(texels.len() as u32);
            texels.extend((0..64).filter(|b| word >> b & 1 == 1).map(|b| k as u32 * 64 + b));
        }
        let number = |texel: u32| {
            let (word, bit) = (texel as usize / 64, texel % 64);
            before[word] + (used[word] & ((1u64 << bit) - 1)).count_ones()
        };
        let rows = size.div_ceil(BAND);
        let bands: Vec<u32> =
            (0..=rows).map(|b| texels.partition_point(|&t| (t as usize) < b * BAND * size) as u32).collect();
        views.par_iter_mut().for_each(|view| {
            view.sort(size, rows);
            for ray in &mut view.rays {
                (ray.top, ray.below) = (number(ray.top), number(ray.below));
            }
        });
        Self { size, texels, bands }
    }

    pub(super) fn len(&self) -> usize {
        self.texels.len()
    }

    /// Column and row of a numbered texel.
    pub(super) fn place(&self, number: usize) -> (usize, usize) {
        let texel = self.texels[number] as usize;
        (texel % self.size, texel / self.size)
    }

    /// Cuts what there is for every texel into the bands of one parity, each with the band that follows it.
    fn cut<'a, T>(&self, parity: usize, mut all: &'a mut [T]) -> Vec<(usize, &'a mut [T])> {
        let (mut done, mut parts) = (0, vec![]);
        for band in (parity..self.bands.len() - 1).step_by(2) {
            let (first, last) =
                (self.bands[band] as usize, self.bands[self.bands.len().min(band + 3) - 1] as usize);
            let (_, rest) = all.split_at_mut(first - done);
            let (part, rest) = rest.split_at_mut(last - first);
            parts.push((band, part));
            (all, done) = (rest, last);
        }
        parts
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
    /// In the order of pixels, or once they are numbered of the texture's bands, which begin at `bands`.
    pub(super) rays: Vec<Ray>,
    pub(super) bands: Vec<u32>,
    /// Light from surfaces that the texture does not hold, DN.
    pub(super) other: Rgb,
    /// What white would read in each pixel, DN, before the lens's blur.
    pub(super) white: Rgb,
    /// Share of each pixel's rays of which nothing is known.
    pub(super) unknown: Image<[f32; 1]>,
    pub(super) sites: Image<Site>,
    /// Columns and rows of the whole frame.
    pub(super) frame: (usize, usize),
}

impl Projection {
    /// Sorts the rays into bands of the texture, by counting.
    fn sort(&mut self, size: usize, rows: usize) {
        let band = |ray: &Ray| ray.top as usize / size / BAND;
        let mut starts = vec![0u32; rows + 1];
        self.rays.iter().for_each(|ray| starts[band(ray) + 1] += 1);
        (1..starts.len()).for_each(|b| starts[b] += starts[b - 1]);
        let (mut fill, mut sorted) = (starts.clone(), self.rays.clone());
        for ray in &self.rays {
            let next = &mut fill[band(ray)];
            sorted[*next as usize] = *ray;
            *next += 1;
        }
        (self.rays, self.bands) = (sorted, starts);
    }

    /// Whether light from beyond the frame reaches a pixel of the window through a blur of `reach` pixels.
    pub(super) fn at_frame_edge(&self, x: usize, y: usize, reach: usize) -> bool {
        let (x, y) = (self.window.left + x, self.window.top + y);
        x < reach || y < reach || x + reach >= self.frame.0 || y + reach >= self.frame.1
    }

    /// The texture as this view's pixels see it, before the lens's blur; with `others`, the light of other surfaces
    /// is in it.
    pub(super) fn pixels(&self, texels: &[[f32; 3]], others: bool) -> Rgb {
        let mut image = self.blank();
        let out = image.pixels_mut();
        for ray in &self.rays {
            let (rho, pixel) = (ray.read(texels), &mut out[ray.pixel as usize]);
            (0..3).for_each(|c| pixel[c] += ray.share * rho[c]);
        }
        for (i, pixel) in out.iter_mut().enumerate() {
            let (white, other) = (&self.white.pixels()[i], &self.other.pixels()[i]);
            for c in 0..3 {
                pixel[c] = pixel[c] * white[c] + if others { other[c] } else { 0.0 };
            }
        }
        image
    }

    /// The readings of all three colours in every pixel for a pulse of energy 1.
    pub(super) fn predict(&self, texels: &[[f32; 3]], others: bool, blur: [f32; 3]) -> Rgb {
        gaussian_each(&self.pixels(texels, others), blur)
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
    pub(super) fn plain(&self, texels: &[[f32; 3]], blur: [f32; 3]) -> (Rgb, Rgb) {
        let (mut seen, mut cover) = (self.blank(), self.blank());
        for ray in &self.rays {
            let (rho, at) = (ray.read(texels), ray.pixel as usize);
            (0..3).for_each(|c| seen.pixels_mut()[at][c] += rho[c]);
            cover.pixels_mut()[at].iter_mut().for_each(|n| *n += 1.0);
        }
        let share = |image: Rgb| image.map(|p| p.map(|v| v / (GRID * GRID) as f32));
        (gaussian_each(&share(seen), blur), gaussian_each(&share(cover), blur))
    }

    /// Adds to `out` what an image of residuals, already blurred by the lens, says of the texels: the transpose of
    /// [`Self::pixels`]. In bands of rows, each by one task and in one order, so that sums come out the same for any
    /// number of threads.
    pub(super) fn carry_back(&self, ground: &Ground, image: &Rgb, out: &mut [[f32; 3]]) {
        let mut lit = image.clone();
        for (pixel, white) in lit.pixels_mut().iter_mut().zip(self.white.pixels()) {
            (0..3).for_each(|c| pixel[c] *= white[c]);
        }
        for parity in 0..2 {
            ground.cut(parity, out).into_par_iter().for_each(|(band, part)| {
                let origin = ground.bands[band] as usize;
                for ray in &self.rays[self.bands[band] as usize..self.bands[band + 1] as usize] {
                    let pixel = &lit.pixels()[ray.pixel as usize];
                    for (texel, weight) in ray.texels() {
                        let (texel, weight) = (&mut part[texel - origin], weight * ray.share);
                        (0..3).for_each(|c| texel[c] += weight * pixel[c]);
                    }
                }
            });
        }
    }
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
        let mut samples = vec![];
        let mut view = Projection {
            window,
            rays: vec![],
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
                samples.push(Sample { pixel: pixel as u32, texel, at, white });
                (0..3).for_each(|c| view.white.pixels_mut()[pixel][c] += white[c]);
            }
        }
        view.rays = samples.iter().map(|s| Ray::of(s, &view.white, SIZE)).collect();
        view
    }
}
