//! What cutting needs to know of a mesh: which triangles share an edge, where each one faces, how large it is.

use crate::scene::Mesh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// No neighbour across an edge.
pub(super) const NONE: u32 = u32::MAX;

/// Rounds of averaging normals with the neighbours': enough for the noise of a reconstruction, whose triangles
/// are noisy one by one, and few enough to leave shapes of a dozen triangles alone.
const ROUNDS: usize = 6;

/// A mesh's triangles as a surface.
pub(super) struct Surface {
    /// Triangles across the three edges; [`NONE`] at borders, and where an edge has more than two triangles.
    pub(super) neighbours: Vec<[u32; 3]>,
    /// Unit normals by the winding; zero for triangles without area.
    pub(super) normals: Vec<Vec3>,
    /// Unit normals averaged along the surface, but not over creases.
    pub(super) smooth: Vec<Vec3>,
    /// Areas in square metres.
    pub(super) areas: Vec<f32>,
    /// Centroids in metres.
    pub(super) centroids: Vec<Vec3>,
}

impl Surface {
    pub(super) fn of(mesh: &Mesh) -> Self {
        let count = mesh.triangles.len();
        let facing: Vec<(Vec3, f32)> = (0..count).into_par_iter().map(|t| facing(mesh.corners(t))).collect();
        let (normals, areas): (Vec<Vec3>, Vec<f32>) = facing.into_iter().unzip();
        let centroids =
            (0..count).into_par_iter().map(|t| mesh.corners(t).iter().sum::<Vec3>() / 3.0).collect();
        let neighbours = neighbours(mesh);
        let mut smooth = normals.clone();
        for _ in 0..ROUNDS {
            smooth = (0..count)
                .into_par_iter()
                .map(|t| {
                    let own = smooth[t];
                    // A neighbour counts by how much it faces the same way, so that creases stay.
                    let share = |&n: &u32| {
                        let other = smooth.get(n as usize).copied().unwrap_or(Vec3::ZERO);
                        other
                            * areas.get(n as usize).copied().unwrap_or(0.0)
                            * own.dot(other).max(0.0).powi(2)
                    };
                    (own * areas[t] + neighbours[t].iter().map(share).sum::<Vec3>()).normalize_or(own)
                })
                .collect();
        }
        Self { neighbours, normals, smooth, areas, centroids }
    }

    /// Whether the triangle has no area, or corners that are no places.
    pub(super) fn is_degenerate(&self, triangle: usize) -> bool {
        self.normals[triangle] == Vec3::ZERO
    }
}

/// Normal and area; zero for what is too thin to have a normal.
fn facing([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    let (a, b, c) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
    let cross = (b - a).cross(c - a);
    let twice = cross.length();
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    // Positions are rounded to single precision: a triangle a ten-thousandth as high as it is long has a normal
    // made of that rounding.
    if !twice.is_finite() || twice <= 1e-4 * longest {
        return (Vec3::ZERO, 0.0);
    }
    ((cross / twice).as_vec3(), (twice / 2.0) as f32)
}

/// Pairs triangles over the edges that exactly two share. Vertices at one place count as one, because programs
/// split them at seams of their own.
fn neighbours(mesh: &Mesh) -> Vec<[u32; 3]> {
    let mut places = HashMap::with_capacity(mesh.positions.len());
    let place: Vec<u32> = (0_u32..)
        .zip(&mesh.positions)
        // Adding zero makes one zero of the two that floating point has.
        .map(|(i, p)| *places.entry((*p + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert(i))
        .collect();
    let mut edges: Vec<(u32, u32, u32, u8)> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .map(|(t, corners)| (t, corners.map(|c| place[c as usize])))
        // One that is no more than an edge would part the two triangles that share it.
        .filter(|(_, [a, b, c])| a != b && b != c && c != a)
        .flat_map_iter(|(t, corners)| {
            (0..3_u8).map(move |k| {
                let (a, b) = (corners[k as usize], corners[(k as usize + 1) % 3]);
                (a.min(b), a.max(b), t as u32, k)
            })
        })
        .collect();
    edges.par_sort_unstable();
    let mut found = vec![[NONE; 3]; mesh.triangles.len()];
    for shared in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if let &[(.., t, i), (.., u, k)] = shared
            && t != u
        {
            found[t as usize][i as usize] = u;
            found[u as usize][k as usize] = t;
        }
    }
    found
}
