//! The step towards the texels: preconditioned conjugate gradients.

use super::state::{State, Weights};
use super::{PRIOR, Texels};
use crate::progress::{Cancelled, Progress};
use crate::raster::Rgb;
use rayon::prelude::*;

/// Preconditioned conjugate gradients on texels and, if asked, the variance of the lens's blur by channel.
pub(super) struct System<'a> {
    state: &'a State<'a>,
    weights: &'a [Weights],
    slopes: Vec<Rgb>,
    sums: Texels,
    residual: Texels,
    direction: Texels,
    /// The same of the blur's variance, by channel, and what it has come to.
    lens: Lens,
    pub(super) blur: [f64; 3],
    strength: [f64; 3],
    pub(super) misfit: f64,
}

#[derive(Clone, Copy, Default)]
struct Lens {
    sum: [f64; 3],
    residual: [f64; 3],
    direction: [f64; 3],
}

impl<'a> System<'a> {
    pub(super) fn new(
        state: &'a State<'a>,
        weights: &'a [Weights],
        start: &[[f32; 3]],
        texels: &Texels,
        lens: bool,
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let slopes = if lens { state.lens_slopes(texels, progress)? } else { vec![] };
        let sums = state.sums(weights, progress)?;
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

    pub(super) fn step(&mut self, texels: &mut Texels, progress: &Progress) -> Result<(), Cancelled> {
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
