//! Cutting a surface into patches that lie flat enough to be projected on a plane.
//!
//! A patch grows from a seed, nearest and best-facing triangles first, as long as they face within a cone round
//! the patch's mean normal. Triangles that a patch cannot take stay for later ones; every patch keeps at least
//! its seed, so that any mesh ends, however noisy.

use super::surface::{NONE, Surface};
use crate::progress::{Cancelled, Progress};
use glam::Vec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Least cosine of a triangle's smoothed normal to its patch's.
const CONE: f32 = 0.6;

/// Least cosine of a triangle's own normal to its patch's: on the plane it is that much smaller than in space.
pub(super) const FLATTEST: f32 = 0.25;

/// Farthest that a patch reaches from its seed, relative to the root of the surface's area.
const REACH: f32 = 0.5;

/// Cost of that distance against one of facing away; keeps patches round.
const ROUND: f32 = 0.5;

/// Triangles between two looks at the cancel flag.
const STRIDE: usize = 1 << 14;

/// Triangles that can be projected along one axis, in the order in which they joined.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    pub(super) triangles: Vec<u32>,
    /// Unit normal of the plane.
    pub(super) axis: Vec3,
}

/// Cuts the triangles of `pool` into patches; each is in exactly one, but for those without area that no patch
/// reached, which are in none.
pub(super) fn grow(surface: &Surface, pool: &[u32], progress: &Progress) -> Result<Vec<Patch>, Cancelled> {
    let reach = REACH * surface.areas.iter().map(|a| f64::from(*a)).sum::<f64>().sqrt() as f32;
    let mut open = vec![false; surface.normals.len()];
    pool.iter().for_each(|&t| open[t as usize] = true);
    let mut patches = vec![];
    let mut looked = 0;
    // Seeds that face as their surroundings do come first: the others are noise and find a patch, or end alone.
    let typical = |t: usize| surface.normals[t].dot(surface.smooth[t]) > 0.7;
    for plain in [true, false] {
        for &seed in pool {
            looked += 1;
            if looked % STRIDE == 0 {
                progress.check()?;
            }
            let at = seed as usize;
            if open[at] && !surface.is_degenerate(at) && typical(at) == plain {
                let patch = from_seed(surface, seed, reach, plain, &mut open);
                looked += patch.triangles.len();
                patches.push(patch);
            }
        }
    }
    Ok(patches)
}

/// Grows one patch and closes its triangles in `open`.
fn from_seed(surface: &Surface, seed: u32, reach: f32, typical: bool, open: &mut [bool]) -> Patch {
    let start = seed as usize;
    let first = if typical { surface.smooth[start] } else { surface.normals[start] };
    let mut sum = first * surface.areas[start];
    let mut axis = first;
    let mut taken = vec![];
    let mut heap = BinaryHeap::from([(Reverse(0_u32), Reverse(seed))]);
    while let Some((_, Reverse(t))) = heap.pop() {
        let at = t as usize;
        if !open[at] {
            continue;
        }
        let degenerate = surface.is_degenerate(at);
        let fits = degenerate
            || t == seed
            || (surface.smooth[at].dot(axis) >= CONE && surface.normals[at].dot(axis) >= FLATTEST);
        if !fits {
            continue;
        }
        open[at] = false;
        taken.push(t);
        if !degenerate && t != seed {
            sum += surface.smooth[at] * surface.areas[at];
            axis = sum.normalize_or(axis);
        }
        for &n in surface.neighbours[at].iter().filter(|&&n| n != NONE && open[n as usize]) {
            let far = surface.centroids[n as usize].distance(surface.centroids[start]) / reach;
            if far <= 1.0 {
                let cost = (1.0 - surface.smooth[n as usize].dot(axis)).max(0.0) + ROUND * far;
                // Bits of a number that is not negative are in the number's order.
                heap.push((Reverse(cost.to_bits()), Reverse(n)));
            }
        }
    }
    settle(surface, taken, axis, seed, open)
}

/// Sets the patch's axis for good and gives back what does not lie flat on it.
fn settle(surface: &Surface, taken: Vec<u32>, axis: Vec3, seed: u32, open: &mut [bool]) -> Patch {
    let mean: Vec3 = taken.iter().map(|&t| surface.normals[t as usize] * surface.areas[t as usize]).sum();
    let mean = mean.normalize_or(axis);
    let flat = |t: u32, axis: Vec3| {
        surface.is_degenerate(t as usize) || surface.normals[t as usize].dot(axis) >= FLATTEST
    };
    // The seed faces its own normal, whatever the others do, so that no patch ends empty.
    let axis = if flat(seed, mean) { mean } else { surface.normals[seed as usize] };
    let (triangles, back): (Vec<u32>, Vec<u32>) = taken.into_iter().partition(|&t| flat(t, axis));
    back.into_iter().for_each(|t| open[t as usize] = true);
    Patch { triangles, axis }
}
