//! Which elements make a patch.
//!
//! Bounced light changes slowly over a surface, except where another surface is near. So elements whose centroids lie
//! in one cell of a grid and whose normals lie in one of 54 classes make a patch, and a patch is divided by halving its
//! cell as long as some of its rays meet another surface within about its own size (the solid angle under which one
//! patch sees another is what bounds the error of taking both as even: Hanrahan, Salzman and Aupperle, "A rapid
//! hierarchical radiosity algorithm", 1991).

use super::Elements;
use super::patches::{at_share, running_areas};
use glam::{Quat, Vec3};
use rayon::prelude::*;
use std::f32::consts::TAU;

/// How often a cell may be halved.
const HALVINGS: usize = 4;

/// Rays that ask whether another surface is near, how many patch sizes count as near, and how many rays must say so.
const ASKING: usize = 16;
const NEAR: f32 = 1.5;
const SAY_SO: usize = 2;

/// Elements grouped by cell and normal, cells halved where another surface is near.
pub(super) fn divide(elements: &Elements, sizes: &[f32]) -> Vec<Vec<u32>> {
    let size = |members: &[u32]| sizes[elements.mesh_of(members[0] as usize)];
    let mut open = group(elements, (0..elements.len() as u32).collect(), &|e| sizes[elements.mesh_of(e)]);
    let mut done = vec![];
    for halving in 0..HALVINGS {
        let part = 0.5f32.powi(halving as i32);
        let near: Vec<bool> =
            open.par_iter().map(|m| m.len() > 1 && crowded(elements, m, part * size(m))).collect();
        let mut next = vec![];
        for (members, near) in open.into_iter().zip(near) {
            if near {
                next.extend(group(elements, members, &|e| 0.5 * part * sizes[elements.mesh_of(e)]));
            } else {
                done.push(members);
            }
        }
        open = next;
    }
    done.extend(open);
    // In the order of their first elements, whatever made them.
    done.sort_unstable_by_key(|members| members[0]);
    done
}

fn group(elements: &Elements, members: Vec<u32>, size: &(dyn Fn(usize) -> f32 + Sync)) -> Vec<Vec<u32>> {
    let key = |e: u32| {
        let e = e as usize;
        let cell = (elements.centroid(e) / size(e)).floor();
        (elements.mesh_of(e), [cell.x as i32, cell.y as i32, cell.z as i32], class(elements.normal(e)))
    };
    let mut keyed: Vec<_> = members.into_par_iter().map(|e| (key(e), e)).collect();
    keyed.par_sort_unstable();
    keyed.chunk_by(|a, b| a.0 == b.0).map(|chunk| chunk.iter().map(|(_, e)| *e).collect()).collect()
}

/// One of 54 classes of directions: the cube's face that it points through, and the ninth of the face, 30 degrees wide.
fn class(normal: Vec3) -> u8 {
    let axis = normal.abs().max_position();
    let third = |i: usize| {
        let slant = (normal[i] / normal[axis].abs()).atan();
        u8::from(slant > -TAU / 24.0) + u8::from(slant > TAU / 24.0)
    };
    let face = 2 * axis as u8 + u8::from(normal[axis] > 0.0);
    9 * face + 3 * third((axis + 1) % 3) + third((axis + 2) % 3)
}

/// Whether another surface's front is near a patch of about this size.
fn crowded(elements: &Elements, members: &[u32], size: f32) -> bool {
    let areas = running_areas(elements, members);
    let met = (0..ASKING).filter(|&i| {
        let spread = |step: f32| ((i as f32 + 0.5) * step).fract();
        let element = at_share(members, &areas, spread(0.618_034));
        let normal = elements.normal(element);
        if normal == Vec3::ZERO {
            return false;
        }
        let share = (i as f32 + 0.5) / ASKING as f32;
        let (sin, cos) = (TAU * spread(0.754_877_7)).sin_cos();
        let flat = share.sqrt();
        let way = Quat::from_rotation_arc(Vec3::Z, normal)
            * Vec3::new(flat * cos, flat * sin, (1.0 - share).sqrt());
        let start = elements.centroid(element) + normal * (1e-3 * size);
        let hit = elements.kernel().nearest(start, way, 0.0, NEAR * size);
        hit.is_some_and(|hit| elements.normal(hit.triangle as usize).dot(way) < 0.0)
    });
    met.count() >= SAY_SO
}
