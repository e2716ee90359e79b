//! A patch on its plane: projected, turned to its smallest box, cut where it would lie on top of itself.

use super::grow::Patch;
use super::surface::{NONE, Surface};
use crate::scene::Mesh;
use glam::{Vec2, Vec3};
use std::collections::HashMap;

/// Directions tried over a quarter turn.
const TURNS: usize = 24;

/// Triangles are drawn in by this much, relative to the way to their middle, before they are held against each other:
/// neighbours share an edge, and rounding must not make an overlap of it.
const DRAWN_IN: f32 = 2e-3;

/// A patch laid flat: metres, its box's lower left corner at the origin.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    /// Triangles of the mesh.
    pub(super) triangles: Vec<u32>,
    /// Unit normal of the plane.
    pub(super) axis: Vec3,
    /// Vertices of the mesh that the triangles use, ascending.
    pub(super) vertices: Vec<u32>,
    /// Where they lie, one each.
    pub(super) points: Vec<Vec2>,
    /// Width and height; the width is the longer.
    pub(super) extent: Vec2,
}

impl Chart {
    /// Projects a patch and turns it so that its box is smallest.
    pub(super) fn of(mesh: &Mesh, patch: Patch) -> Self {
        let Patch { triangles, axis } = patch;
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let (right, up) = axis.any_orthonormal_pair();
        // Right, up and axis are right-handed when right x up = axis; then front stays front.
        let up = if right.cross(up).dot(axis) < 0.0 { -up } else { up };
        let at = |&v: &u32| mesh.positions[v as usize];
        // A vertex that is no place belongs to triangles without area alone.
        let origin = vertices.iter().map(at).find(|p| p.is_finite()).unwrap_or(Vec3::ZERO);
        let flat: Vec<Vec2> = vertices
            .iter()
            .map(|v| {
                let from = at(v) - origin;
                if from.is_finite() { Vec2::new(from.dot(right), from.dot(up)) } else { Vec2::ZERO }
            })
            .collect();
        let turned = |turn: usize, flat: &[Vec2]| -> Vec<Vec2> {
            let way = Vec2::from_angle(turn as f32 / TURNS as f32 * std::f32::consts::FRAC_PI_2);
            flat.iter().map(|p| way.rotate(*p)).collect()
        };
        let size = |points: &[Vec2]| {
            let (low, high) = bounds(points);
            (high - low).element_product()
        };
        // Few points tell enough of the box of many.
        let few: Vec<Vec2> = flat.iter().step_by(flat.len().div_ceil(2000)).copied().collect();
        let best = (0..TURNS)
            .min_by(|&a, &b| size(&turned(a, &few)).total_cmp(&size(&turned(b, &few))))
            .unwrap_or_default();
        let mut points = turned(best, &flat);
        let (low, high) = bounds(&points);
        let mut extent = high - low;
        points.iter_mut().for_each(|p| *p -= low);
        if extent.y > extent.x {
            // A quarter turn clockwise.
            points.iter_mut().for_each(|p| *p = Vec2::new(p.y, extent.x - p.x));
            extent = Vec2::new(extent.y, extent.x);
        }
        Self { triangles, axis, vertices, points, extent }
    }

    /// Index of a vertex of the mesh among the chart's.
    pub(super) fn index(&self, vertex: u32) -> usize {
        self.vertices.partition_point(|&v| v < vertex)
    }

    fn corners(&self, mesh: &Mesh, triangle: u32) -> [Vec2; 3] {
        mesh.triangles[triangle as usize].map(|v| self.points[self.index(v)])
    }

    /// Which triangles lie on top of ones that joined before them: true, in the order of `triangles`.
    fn folded(&self, mesh: &Mesh) -> Vec<bool> {
        let mut folded = vec![false; self.triangles.len()];
        if self.triangles.len() < 2 {
            return folded;
        }
        let triangles: Vec<[Vec2; 3]> = self.triangles.iter().map(|&t| self.corners(mesh, t)).collect();
        let count = triangles.len() as f32;
        let edge = |t: &[Vec2; 3]| {
            let (low, high) = bounds(t);
            (high - low).max_element()
        };
        // Cells about as large as triangles, and not many more of them.
        let cell = (triangles.iter().map(edge).sum::<f32>() / count)
            .max((self.extent.element_product() / (4.0 * count)).sqrt())
            .max(self.extent.x / 4096.0);
        if !(cell > 0.0 && cell.is_finite()) {
            return folded;
        }
        let [columns, rows] = self.extent.to_array().map(|e| (e / cell) as usize + 1);
        let mut cells: Vec<Vec<u32>> = vec![vec![]; columns * rows];
        for (i, triangle) in triangles.iter().enumerate() {
            let [a, b, c] = *triangle;
            if (b - a).perp_dot(c - a) <= 0.0 {
                continue;
            }
            let (low, high) = bounds(triangle);
            let [left, bottom] = (low / cell).to_array().map(|x| x as usize);
            let [right, top] =
                [((high.x / cell) as usize).min(columns - 1), ((high.y / cell) as usize).min(rows - 1)];
            let here = || (bottom..=top).flat_map(|y| (left..=right).map(move |x| y * columns + x));
            folded[i] = here().any(|k| cells[k].iter().any(|&o| overlap(triangle, &triangles[o as usize])));
            if !folded[i] {
                here().for_each(|k| cells[k].push(i as u32));
            }
        }
        folded
    }

    /// Cuts off what is folded, and parts what hangs together no more. Gives the charts and what was cut off.
    pub(super) fn part(self, mesh: &Mesh, surface: &Surface) -> (Vec<Chart>, Vec<u32>) {
        let folded = self.folded(mesh);
        let (mut kept, mut off) = (vec![], vec![]);
        for (&triangle, fold) in self.triangles.iter().zip(folded) {
            if fold { off.push(triangle) } else { kept.push(triangle) }
        }
        if off.is_empty() && hangs_together(&kept, surface) {
            return (vec![self], off);
        }
        let pieces = pieces(&kept, surface);
        let chart = |triangles| Chart::of(mesh, Patch { triangles, axis: self.axis });
        (pieces.into_iter().map(chart).collect(), off)
    }
}

fn hangs_together(triangles: &[u32], surface: &Surface) -> bool {
    triangles.len() == 1 || pieces(triangles, surface).len() == 1
}

/// Connected pieces, each in the order of `triangles`, by their first triangle.
fn pieces(triangles: &[u32], surface: &Surface) -> Vec<Vec<u32>> {
    let place: HashMap<u32, usize> = triangles.iter().copied().zip(0..).collect();
    let mut piece = vec![usize::MAX; triangles.len()];
    let mut count = 0;
    for start in 0..triangles.len() {
        if piece[start] != usize::MAX {
            continue;
        }
        let mut stack = vec![start];
        piece[start] = count;
        while let Some(i) = stack.pop() {
            for n in surface.neighbours[triangles[i] as usize].iter().filter(|&&n| n != NONE) {
                if let Some(&k) = place.get(n)
                    && piece[k] == usize::MAX
                {
                    piece[k] = count;
                    stack.push(k);
                }
            }
        }
        count += 1;
    }
    let mut out = vec![vec![]; count];
    for (&triangle, piece) in triangles.iter().zip(piece) {
        out[piece].push(triangle);
    }
    out
}

/// Whether two triangles, counter-clockwise and drawn in a little, have a point in common: no edge of either has the
/// other wholly on its outer side.
fn overlap(a: &[Vec2; 3], b: &[Vec2; 3]) -> bool {
    let (a, b) = (drawn_in(a), drawn_in(b));
    let parted = |from: &[Vec2; 3], other: &[Vec2; 3]| {
        (0..3).any(|k| {
            let (start, along) = (from[k], from[(k + 1) % 3] - from[k]);
            other.iter().all(|p| along.perp_dot(*p - start) <= 0.0)
        })
    };
    !parted(&a, &b) && !parted(&b, &a)
}

fn drawn_in(triangle: &[Vec2; 3]) -> [Vec2; 3] {
    let middle = (triangle[0] + triangle[1] + triangle[2]) / 3.0;
    triangle.map(|p| p + (middle - p) * DRAWN_IN)
}

fn bounds(points: &[Vec2]) -> (Vec2, Vec2) {
    points.iter().fold((Vec2::MAX, Vec2::MIN), |(low, high), p| (low.min(*p), high.max(*p)))
}
