//! Transport of bounces: which patch sees which, once and for all views and all rounds.
//!
//! From places all over every patch leave `rays` cosine-distributed directions (Malley's method on a Kronecker sequence,
//! shifted for each patch) against the full surface, and the patch that each meets is kept. With cosine-distributed directions the
//! irradiance from a diffuse surrounding is the plain mean of what is met: E = mean of rho E_total, since the
//! radiance of a Lambertian surface is rho E / pi. (Kajiya 1986, for Lambertian surfaces: radiosity by
//! gathering.) Geometry alone decides it, so it serves every view and every estimate of the reflectance.

use super::{Elements, Patches};
use crate::progress::{Cancelled, Progress};
use glam::{Quat, Vec3};
use rayon::prelude::*;
use std::f32::consts::TAU;

/// No patch in this direction: darkness.
const NOTHING: u32 = u32::MAX;

/// Patches per tile between two looks at the cancel flag.
const TILE: usize = 256;

/// For every patch, the patches that its rays meet, in order.
pub struct Transport {
    rays: usize,
    met: Vec<u32>,
}

impl Transport {
    /// Traces `rays` directions from every patch. A ray that meets a back face meets nothing: that is the
    /// inside of a closed body.
    pub fn trace(
        elements: &Elements,
        patches: &Patches,
        rays: usize,
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let mut met = vec![NOTHING; rays * patches.len()];
        let tiles = patches.len().div_ceil(TILE);
        let done = std::sync::atomic::AtomicUsize::new(0);
        met.par_chunks_mut(rays * TILE).enumerate().try_for_each(|(tile, chunk)| {
            progress.check()?;
            for (k, row) in chunk.chunks_mut(rays).enumerate() {
                gather(elements, patches, tile * TILE + k, row);
                row.sort_unstable();
            }
            let finished = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress.report("tracing bounces", finished, tiles);
            Ok(())
        })?;
        Ok(Self { rays, met })
    }

    /// Bounces until they add up: `irradiance` (laid out as in [`Transport::gather`]) is taken as a first guess and
    /// ends as the sum of the series E = T (rho (D + E)). `emit` gives the exitance rho (D + E) of the irradiance E
    /// so far. It ends when a bounce changes the sum over all patches by less than `tolerance` of it, or after
    /// `most` bounces, and gives that change after every bounce.
    pub fn settle(
        &self,
        width: usize,
        irradiance: &mut [f32],
        (tolerance, most): (f64, usize),
        emit: impl Fn(&[f32], &mut [f32]),
        progress: &Progress,
    ) -> Result<Vec<f64>, Cancelled> {
        let (mut exitance, mut changes) = (vec![0.0f32; irradiance.len()], vec![]);
        while changes.len() < most {
            progress.check()?;
            emit(irradiance, &mut exitance);
            let change = self.gather(&exitance, width, irradiance);
            changes.push(change);
            if change < tolerance {
                break;
            }
        }
        Ok(changes)
    }

    /// One bounce: irradiance on every patch from `exitance` = rho E of all others; `width` values a patch (views and
    /// their colours) are laid side by side (`exitance[patch * width + i]`). Gives the sum of |change| of `out` over the
    /// sum of what is there now.
    pub fn gather(&self, exitance: &[f32], width: usize, out: &mut [f32]) -> f64 {
        let scale = 1.0 / self.rays as f32;
        // Tile by tile, so that the sums do not depend on threads.
        let tiles = out.par_chunks_mut(width * TILE).zip(self.met.par_chunks(self.rays * TILE));
        let changes: Vec<(f64, f64)> = tiles
            .map(|(out, met)| {
                let (mut off, mut all, mut sum) = (0.0, 0.0, vec![0.0f32; width]);
                for (out, met) in out.chunks_mut(width).zip(met.chunks(self.rays)) {
                    sum.fill(0.0);
                    // Sorted: a patch that is met often is read once.
                    for run in met.chunk_by(|a, b| a == b).filter(|run| run[0] != NOTHING) {
                        let (other, times) = (run[0] as usize, run.len() as f32);
                        let from = &exitance[other * width..(other + 1) * width];
                        for (s, x) in sum.iter_mut().zip(from) {
                            *s += times * x;
                        }
                    }
                    for (out, s) in out.iter_mut().zip(&sum) {
                        let now = scale * s;
                        off += f64::from((now - *out).abs());
                        all += f64::from(now.abs());
                        *out = now;
                    }
                }
                (off, all)
            })
            .collect();
        let (off, all) = changes.iter().fold((0.0, 0.0), |sum, tile| (sum.0 + tile.0, sum.1 + tile.1));
        if all > 0.0 { off / all } else { 0.0 }
    }
}

fn gather(elements: &Elements, patches: &Patches, patch: usize, row: &mut [u32]) {
    let shift: [f32; 5] = std::array::from_fn(|d| hashed(patch as u32, d as u32));
    for (i, met) in row.iter_mut().enumerate() {
        let s: [f32; 5] = std::array::from_fn(|d| (shift[d] + (i as f32 + 0.5) * KRONECKER[d]).fract());
        let element = patches.element_at(patch, s[4]);
        let normal = elements.normal(element);
        if normal == Vec3::ZERO {
            continue;
        }
        let corners = *elements.kernel().corners(element as u32);
        let lift = elements.lift(element);
        let (radius, angle) = (s[0].sqrt(), TAU * s[1]);
        let local = Vec3::new(radius * angle.cos(), radius * angle.sin(), (1.0 - s[0]).max(0.0).sqrt());
        let (mut u, mut v) = (s[2], s[3]);
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        let start = corners[0] + (corners[1] - corners[0]) * u + (corners[2] - corners[0]) * v + lift;
        let direction = Quat::from_rotation_arc(Vec3::Z, normal) * local;
        if let Some(hit) = elements.kernel().nearest(start, direction, 0.0, f32::INFINITY)
            && elements.normal(hit.triangle as usize).dot(direction) < 0.0
        {
            *met = patches.of(hit.triangle as usize) as u32;
        }
    }
}

/// Fractional parts of the powers of 1 / 1.134724, root of x^6 = x + 1: an even spread in five dimensions.
const KRONECKER: [f32; 5] = [0.881_271_5, 0.776_639_5, 0.684_430_2, 0.603_168_8, 0.531_555_6];

/// A number in 0..1 that depends on both arguments without visible pattern (Wellons, "lowbias32").
fn hashed(a: u32, b: u32) -> f32 {
    let mut x = a.wrapping_mul(5).wrapping_add(b).wrapping_add(0x9e37_79b9);
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    (x >> 8) as f32 / (1u32 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mesh;

    /// A closed sphere seen from inside.
    fn furnace() -> Elements {
        let n = 24u32;
        let mut mesh = Mesh::default();
        for i in 0..=n {
            for j in 0..2 * n {
                let (t, p) = (i as f32 / n as f32 * TAU / 2.0, j as f32 / n as f32 * TAU / 2.0);
                mesh.positions.push(Vec3::new(t.sin() * p.cos(), t.sin() * p.sin(), t.cos()));
            }
        }
        for i in 0..n {
            for j in 0..2 * n {
                let at = |i: u32, j: u32| i * 2 * n + j % (2 * n);
                mesh.triangles.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
                mesh.triangles.push([at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]);
            }
        }
        Elements::build(&[&mesh], &[10.0])
    }

    #[test]
    fn in_a_furnace_bounces_add_up_to_the_geometric_series() {
        let elements = furnace();
        let transport =
            Transport::trace(&elements, &Patches::single(&elements), 64, &Progress::silent()).unwrap();
        let (rho, direct) = (0.6f32, 2.0f32);
        let mut bounced = vec![0.0f32; elements.len()];
        let mut next = bounced.clone();
        for _ in 0..40 {
            let exitance: Vec<f32> = bounced.iter().map(|b| rho * (direct + b)).collect();
            transport.gather(&exitance, 1, &mut next);
            std::mem::swap(&mut bounced, &mut next);
        }
        let live: Vec<f32> =
            (0..elements.len()).filter(|&e| elements.area(e) > 1e-6).map(|e| bounced[e]).collect();
        let mean = live.iter().sum::<f32>() / live.len() as f32;
        let want = direct * rho / (1.0 - rho);
        assert!((mean / want - 1.0).abs() < 0.01, "{mean} for {want}");
    }

    #[test]
    fn the_series_ends_by_its_own_change_and_not_before_it_adds_up() {
        let elements = furnace();
        let transport =
            Transport::trace(&elements, &Patches::single(&elements), 64, &Progress::silent()).unwrap();
        let settled = |rho: f32, tolerance: f64| {
            let mut bounced = vec![0.0f32; elements.len()];
            let emit = |e: &[f32], out: &mut [f32]| {
                out.iter_mut().zip(e).for_each(|(o, e)| *o = rho * (2.0 + e));
            };
            let progress = Progress::silent();
            let changes = transport.settle(1, &mut bounced, (tolerance, 200), emit, &progress).unwrap();
            let live = (0..elements.len()).filter(|&e| elements.area(e) > 1e-6);
            let (sum, count) = live.fold((0.0, 0.0), |(s, n), e| (s + bounced[e], n + 1.0));
            (sum / count, changes)
        };
        for rho in [0.2, 0.6, 0.9] {
            let (mean, changes) = settled(rho, 1e-4);
            let want = 2.0 * rho / (1.0 - rho);
            assert!((mean / want - 1.0).abs() < 0.01, "{mean} for {want}");
            assert!(changes.windows(2).all(|w| w[1] < w[0]), "{changes:?}");
        }
        assert!(settled(0.2, 1e-4).1.len() < 8 && settled(0.9, 1e-4).1.len() > 40);
    }

    #[test]
    fn two_facing_plates_exchange_by_their_form_factor() {
        // Two unit squares one apart: F = 0.19982 (Hottel's tables, closed form in Howell's catalogue C-11).
        let plate = |z: f32, up: bool| {
            let p = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, z));
            Mesh {
                positions: p.to_vec(),
                triangles: if up { vec![[0, 1, 2], [0, 2, 3]] } else { vec![[0, 2, 1], [0, 3, 2]] },
                ..Mesh::default()
            }
        };
        let (low, high) = (plate(0.0, true), plate(1.0, false));
        let elements = Elements::build(&[&low, &high], &[0.1, 0.1]);
        let transport =
            Transport::trace(&elements, &Patches::single(&elements), 64, &Progress::silent()).unwrap();
        let exitance: Vec<f32> = (0..elements.len()).map(|e| elements.mesh_of(e) as f32).collect();
        let mut got = vec![0.0; elements.len()];
        transport.gather(&exitance, 1, &mut got);
        let factor: f32 = (0..elements.len())
            .filter(|&e| elements.mesh_of(e) == 0)
            .map(|e| got[e] * elements.area(e))
            .sum();
        assert!((factor - 0.19982).abs() < 0.002, "{factor}");
    }
}
