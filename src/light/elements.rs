//! Surface elements: the meshes cut into small triangles that carry one irradiance and one reflectance each.
//!
//! Every triangle is cut into k^2 equal ones, k such that no edge is longer than asked, so that a floor of two
//! triangles can hold a shadow. The elements are the ray kernel's own triangles: what a ray hits is an element.

use super::RayKernel;
use crate::scene::Mesh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Most cuts along an edge; a larger triangle gets larger elements.
const MOST_CUTS: u32 = 512;

/// Elements of one mesh that cutting may lead to; beyond it they are left larger.
const MOST_ELEMENTS: f64 = 1e6;

/// Elements whose normals part by more than this (cosine) do not share light when smoothed: a crease.
const CREASE: f32 = 0.8;

/// All meshes as elements, with the kernel over them.
pub struct Elements {
    kernel: RayKernel,
    normals: Vec<Vec3>,
    /// Per mesh: index of its first element, and (first element, cuts) of each of its triangles.
    meshes: Vec<Vec<(u32, u32)>>,
    mesh_of: Vec<u32>,
    /// Elements that share light at a corner: `shared[starts[3 e + c] .. starts[3 e + c + 1]]`.
    starts: Vec<u32>,
    shared: Vec<u32>,
}

impl Elements {
    /// Cuts `meshes`; `longest[i]` (metres) bounds the edges of mesh `i`'s elements.
    pub fn build(meshes: &[&Mesh], longest: &[f32]) -> Self {
        let (mut corners, mut lattice, mut table, mut mesh_of) = (vec![], vec![], vec![], vec![]);
        for (m, (mesh, longest)) in meshes.iter().zip(longest).enumerate() {
            let mut of_mesh = Vec::with_capacity(mesh.triangles.len());
            let wanted: f64 = (0..mesh.triangles.len())
                .map(|t| f64::from(longest_edge(mesh.corners(t)) / longest).powi(2))
                .filter(|parts| *parts > 1.0 && parts.is_finite())
                .sum();
            let longest = longest * (wanted / MOST_ELEMENTS).sqrt().max(1.0) as f32;
            for t in 0..mesh.triangles.len() {
                let triangle = mesh.corners(t);
                let cuts = cuts_of(triangle, longest);
                of_mesh.push((corners.len() as u32, cuts));
                cut(triangle, cuts, &mut corners);
            }
            mesh_of.resize(corners.len(), m as u32);
            table.push(of_mesh);
        }
        let mut vertices = HashMap::new();
        for (element, triangle) in corners.iter().enumerate() {
            for corner in triangle {
                let next = vertices.len() as u32;
                let vertex = *vertices.entry((mesh_of[element], key(*corner))).or_insert(next);
                lattice.push(vertex);
            }
        }
        let normals: Vec<Vec3> =
            corners.par_iter().map(|[a, b, c]| (*b - *a).cross(*c - *a).normalize_or_zero()).collect();
        let (starts, shared) = share(&lattice, vertices.len(), &normals);
        Self { kernel: RayKernel::build(corners), normals, meshes: table, mesh_of, starts, shared }
    }

    /// How many elements there are.
    pub fn len(&self) -> usize {
        self.normals.len()
    }

    /// Whether there is nothing to light.
    pub fn is_empty(&self) -> bool {
        self.normals.is_empty()
    }

    /// Rays against the elements; [`super::Hit::triangle`] is an element's index.
    pub fn kernel(&self) -> &RayKernel {
        &self.kernel
    }

    /// Unit normals by the winding of the meshes, one an element; zero for a degenerate one.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Unit normal by the winding of the mesh; zero for a degenerate element.
    pub fn normal(&self, element: usize) -> Vec3 {
        self.normals[element]
    }

    /// Centroid in metres, world frame.
    pub fn centroid(&self, element: usize) -> Vec3 {
        let [a, b, c] = *self.kernel.corners(element as u32);
        (a + b + c) / 3.0
    }

    /// Area in square metres.
    pub fn area(&self, element: usize) -> f32 {
        let [a, b, c] = *self.kernel.corners(element as u32);
        0.5 * (b - a).cross(c - a).length()
    }

    /// From a place on the element to where rays may start without meeting it, metres.
    pub(crate) fn lift(&self, element: usize) -> Vec3 {
        let [a, b, c] = *self.kernel.corners(element as u32);
        let size = (b - a).length().max((c - a).length());
        let scale = a.abs().max_element().max(size);
        self.normal(element) * (1e-5 * scale + 1e-3 * size)
    }

    /// Barycentric weights of the second and third corner of a point that lies on the element.
    pub fn place(&self, element: usize, point: Vec3) -> [f32; 2] {
        let [a, b, c] = *self.kernel.corners(element as u32);
        let (p, q, r) = (b - a, c - a, point - a);
        let (pp, pq, qq, rp, rq) = (p.dot(p), p.dot(q), q.dot(q), r.dot(p), r.dot(q));
        let area = pp * qq - pq * pq;
        if area > 0.0 {
            [(rp * qq - rq * pq) / area, (rq * pp - rp * pq) / area].map(|w| w.clamp(0.0, 1.0))
        } else {
            [1.0 / 3.0; 2]
        }
    }

    /// Index of the mesh that the element belongs to.
    pub fn mesh_of(&self, element: usize) -> usize {
        self.mesh_of[element] as usize
    }

    /// The element at barycentric (u, v) of a mesh's triangle, and (u, v) inside the element.
    pub fn locate(&self, mesh: usize, triangle: usize, u: f32, v: f32) -> (usize, [f32; 2]) {
        let (first, cuts) = self.meshes[mesh][triangle];
        let (k, last) = (cuts as f32, cuts - 1);
        let (su, sv) = ((u * k).max(0.0), (v * k).max(0.0));
        let i = (su as u32).min(last);
        let j = (sv as u32).min(last - i);
        let (fu, fv) = ((su - i as f32).min(1.0), (sv - j as f32).min(1.0));
        let up = first + row_start(i, cuts) + 2 * j;
        if fu + fv > 1.0 && i + j < last {
            (up as usize + 1, [1.0 - fu, 1.0 - fv])
        } else {
            (up as usize, [fu, fv])
        }
    }

    /// Elements that share a corner with this one on the same smooth surface, itself among them, some more than once.
    pub(super) fn beside(&self, element: usize) -> &[u32] {
        &self.shared[self.starts[3 * element] as usize..self.starts[3 * element + 3] as usize]
    }

    /// Spreads one value an element to one a corner of each element, averaging with the neighbours that
    /// lie in the same smooth surface.
    pub fn smooth(&self, values: &[[f32; 3]]) -> Vec<[[f32; 3]; 3]> {
        (0..self.len())
            .into_par_iter()
            .map(|e| {
                std::array::from_fn(|c| {
                    let run = self.starts[3 * e + c] as usize..self.starts[3 * e + c + 1] as usize;
                    let count = run.len() as f32;
                    let mut sum = [0.0; 3];
                    for &near in &self.shared[run] {
                        for (s, v) in sum.iter_mut().zip(values[near as usize]) {
                            *s += v;
                        }
                    }
                    sum.map(|s| s / count)
                })
            })
            .collect()
    }
}

/// Cuts along the edges of a triangle so that no part's edge is longer than `longest`.
fn cuts_of(triangle: [Vec3; 3], longest: f32) -> u32 {
    // A NaN, from a corner that is not finite, becomes 1.
    (longest_edge(triangle) / longest).ceil().max(1.0).min(MOST_CUTS as f32) as u32
}

fn longest_edge([a, b, c]: [Vec3; 3]) -> f32 {
    (b - a).length().max((c - b).length()).max((a - c).length())
}

/// Value at (u, v) inside an element from its three corner values.
pub fn interpolate(corners: &[[f32; 3]; 3], [u, v]: [f32; 2]) -> [f32; 3] {
    std::array::from_fn(|c| corners[0][c] * (1.0 - u - v) + corners[1][c] * u + corners[2][c] * v)
}

/// Elements before row `i` of a triangle with `cuts` cuts: row i holds 2 (cuts - i) - 1.
fn row_start(i: u32, cuts: u32) -> u32 {
    i * (2 * cuts - i)
}

/// Appends the `cuts`^2 parts: row by row along the second corner, upright and inverted in turn.
fn cut([a, b, c]: [Vec3; 3], cuts: u32, out: &mut Vec<[Vec3; 3]>) {
    if cuts == 1 {
        out.push([a, b, c]);
        return;
    }
    let at = |i: u32, j: u32| a + (b - a) * (i as f32 / cuts as f32) + (c - a) * (j as f32 / cuts as f32);
    for i in 0..cuts {
        for j in 0..cuts - i {
            out.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
            if i + j + 1 < cuts {
                out.push([at(i + 1, j + 1), at(i, j + 1), at(i + 1, j)]);
            }
        }
    }
}

/// A position rounded to micrometres, so that neighbours that computed it differently agree.
fn key(p: Vec3) -> [i64; 3] {
    [p.x, p.y, p.z].map(|x| (f64::from(x) * 1e6).round() as i64)
}

/// For every element corner, the elements round its vertex that lie in one smooth surface with it.
fn share(lattice: &[u32], vertices: usize, normals: &[Vec3]) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; vertices + 1];
    for &v in lattice {
        first[v as usize + 1] += 1;
    }
    for v in 0..vertices {
        first[v + 1] += first[v];
    }
    let (mut fill, mut round) = (first.clone(), vec![0u32; lattice.len()]);
    for (corner, &v) in lattice.iter().enumerate() {
        round[fill[v as usize] as usize] = corner as u32 / 3;
        fill[v as usize] += 1;
    }
    let (mut starts, mut shared) = (vec![0u32], vec![]);
    for (corner, &v) in lattice.iter().enumerate() {
        let own = corner / 3;
        for &near in &round[first[v as usize] as usize..first[v as usize + 1] as usize] {
            if near as usize == own || normals[near as usize].dot(normals[own]) > CREASE {
                shared.push(near);
            }
        }
        starts.push(shared.len() as u32);
    }
    (starts, shared)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Mesh {
        Mesh { positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y], triangles: vec![[0, 1, 2]], ..Mesh::default() }
    }

    #[test]
    fn parts_cover_the_triangle_and_are_found_again() {
        let mesh = triangle();
        let elements = Elements::build(&[&mesh], &[0.2]);
        let covered: f32 = (0..elements.len()).map(|e| elements.area(e)).sum();
        assert!((covered - 0.5).abs() < 1e-5, "{covered}");
        for e in 0..elements.len() {
            let p = elements.centroid(e);
            let (found, [u, v]) = elements.locate(0, 0, p.x, p.y);
            assert_eq!(found, e);
            assert!((u - 1.0 / 3.0).abs() < 1e-4 && (v - 1.0 / 3.0).abs() < 1e-4);
            assert!(elements.normal(e).abs_diff_eq(Vec3::Z, 1e-5));
        }
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (-1e-6, 1.0)] {
            let (e, local) = elements.locate(0, 0, u, v);
            let [a, b, c] = *elements.kernel().corners(e as u32);
            let p = a * (1.0 - local[0] - local[1]) + b * local[0] + c * local[1];
            assert!((p - Vec3::new(u, v, 0.0)).length() < 1e-4, "{p} for {u} {v}");
        }
    }

    #[test]
    fn a_floor_much_larger_than_the_object_does_not_take_all_memory() {
        let steps = |i: u32| triangle().positions.into_iter().map(move |p| p * 1e4 + Vec3::Z * i as f32);
        let floor = Mesh {
            positions: (0..40).flat_map(steps).collect(),
            triangles: (0..40).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Mesh::default()
        };
        let elements = Elements::build(&[&floor], &[0.01]);
        assert!(elements.len() < 2_000_000, "{}", elements.len());
    }

    #[test]
    fn smoothing_keeps_a_constant_and_stops_at_a_crease() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 1, 2], [0, 3, 1]],
            ..Mesh::default()
        };
        let elements = Elements::build(&[&mesh], &[0.26]);
        let half = elements.len() / 2;
        let values: Vec<[f32; 3]> =
            (0..elements.len()).map(|e| if e < half { [1.0; 3] } else { [5.0; 3] }).collect();
        for (e, corners) in elements.smooth(&values).iter().enumerate() {
            let want = if e < half { 1.0 } else { 5.0 };
            assert!(corners.iter().flatten().all(|v| (v - want).abs() < 1e-6), "{e} {corners:?}");
        }
    }
}
