//! The tree that rays go down: boxes in fours, triangles in fours, each four tested at once.
//!
//! The hierarchy itself is obvhs's binary one (locally ordered clustering of split triangles, Meister and Bittner,
//! "Parallel Locally-Ordered Clustering", 2018). Here it is folded until every node has four children and every leaf up
//! to four triangles, which lie in the tree's own order, a coordinate of all four side by side: a ray meets no
//! indirection, and one step of the processor's vector unit serves four boxes or four triangles. (Wald, Benthin and
//! Boulos, "Getting Rid of Packets", 2008.)
//!
//! The triangle test is the watertight one of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT
//! 2(1), 2013, because a ray that slips through an edge is light that was never there.

use super::Hit;
use glam::{BVec4A, Vec3, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::{Bvh2, builder::build_bvh2_from_tris};
use obvhs::triangle::Triangle;
use std::cell::Cell;
use std::time::Duration;

/// Children of a node and triangles of a leaf.
const FOUR: usize = 4;

/// Marks a child that is a leaf.
const LEAF: u32 = 1 << 31;

/// Lane of a leaf that holds no triangle, child of a node that is not there.
const NOTHING: u32 = u32::MAX;

/// By how much a box's far side is moved away, so that rounding never takes a ray past a corner that it touches.
const ROUNDING: f32 = 1.0 + 4.0 * f32::EPSILON;

/// By how much a box is wider than its triangles, relative to the largest coordinate.
const PADDING: f32 = 4.0 * f32::EPSILON;

/// Below this a component of a ray's direction counts as nothing; its inverse must be finite.
const SMALLEST: f32 = 1e-30;

/// Entries that a traversal holds without asking for memory.
const SHALLOW: usize = 64;

thread_local! {
    /// The leaf that hid this thread's last ray that was hidden.
    static LAST: Cell<u32> = const { Cell::new(0) };
}

/// Up to four boxes and what lies in each.
struct Node {
    /// Least x, y, z of the four children, then the largest.
    sides: [Vec4; 6],
    children: [u32; FOUR],
}

/// Up to four triangles.
struct Leaf {
    /// x, y, z of the four first corners, of the second, of the third; lanes that are not used hold NaN.
    corners: [[Vec4; 3]; 3],
    triangles: [u32; FOUR],
}

/// Nodes and leaves over triangles.
pub(super) struct Tree {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    root: u32,
}

impl Tree {
    /// Over the triangles whose corners are all finite; `None` if there is none.
    pub(super) fn build(corners: &[[Vec3; 3]]) -> Option<Self> {
        let (mut known, mut primitives) = (vec![], vec![]);
        for (i, t) in corners.iter().enumerate().filter(|(_, t)| t.iter().all(|c| c.is_finite())) {
            known.push(i as u32);
            primitives.push(Triangle { v0: t[0].into(), v1: t[1].into(), v2: t[2].into() });
        }
        if primitives.is_empty() {
            return None;
        }
        let plan = BvhBuildParams {
            max_prims_per_leaf: 1,
            post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
            ..BvhBuildParams::slow_build()
        };
        let binary = build_bvh2_from_tris(&primitives, plan, &mut Duration::default());
        Some(Folding::new(&binary, corners, &known).fold())
    }

    /// The nearest triangle with `t_min < t < t_max`, `t` in lengths of `direction`.
    pub(super) fn nearest(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Option<Hit> {
        let ray = Ray::new(origin, direction, t_min)?;
        let (mut found, mut limit) = (None, t_max);
        let mut open = Stack::new();
        let mut next = Some((t_min, self.root));
        while let Some((near, at)) = next {
            if near > limit {
                next = open.pop();
                continue;
            }
            if at & LEAF != 0 {
                let leaf = &self.leaves[(at ^ LEAF) as usize];
                if let Some(hit) = ray.nearest_of(leaf, limit) {
                    limit = hit.t;
                    found = Some(hit);
                }
                next = open.pop();
                continue;
            }
            let node = &self.nodes[at as usize];
            let (near, mut hit) = ray.enters(node, limit);
            if hit == 0 {
                next = open.pop();
                continue;
            }
            // Go on with the nearest; keep the others, the farthest lowest.
            let near = near.to_array();
            let first = hit.trailing_zeros() as usize;
            hit &= hit - 1;
            let mut best = (near[first], node.children[first]);
            let from = open.len();
            while hit != 0 {
                let i = hit.trailing_zeros() as usize;
                hit &= hit - 1;
                let mut other = (near[i], node.children[i]);
                if other.0 < best.0 {
                    std::mem::swap(&mut other, &mut best);
                }
                open.insert(from, other);
            }
            next = Some(best);
        }
        found
    }

    /// Whether any triangle lies at `t_min < t < t_max`.
    pub(super) fn occluded(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        let Some(ray) = Ray::new(origin, direction, t_min) else { return false };
        // What hid the last ray hides the next one often, and the answer is the same whoever gives it.
        let last = LAST.get() as usize;
        if self.leaves.get(last).is_some_and(|leaf| ray.meets(leaf, t_max)) {
            return true;
        }
        let mut open = Stack::new();
        let mut next = Some((t_min, self.root));
        while let Some((_, at)) = next {
            if at & LEAF != 0 {
                let leaf = at ^ LEAF;
                if ray.meets(&self.leaves[leaf as usize], t_max) {
                    LAST.set(leaf);
                    return true;
                }
                next = open.pop();
                continue;
            }
            let node = &self.nodes[at as usize];
            let (_, mut hit) = ray.enters(node, t_max);
            if hit == 0 {
                next = open.pop();
                continue;
            }
            let first = hit.trailing_zeros() as usize;
            hit &= hit - 1;
            while hit != 0 {
                let i = hit.trailing_zeros() as usize;
                hit &= hit - 1;
                open.push((0.0, node.children[i]));
            }
            next = Some((0.0, node.children[first]));
        }
        false
    }
}

/// Boxes that are still to be entered: distance and child.
struct Stack {
    few: [(f32, u32); SHALLOW],
    count: usize,
    /// Where a tree is deeper than any that is sound.
    more: Vec<(f32, u32)>,
}

impl Stack {
    #[inline(always)]
    fn new() -> Self {
        Self { few: [(0.0, 0); SHALLOW], count: 0, more: vec![] }
    }

    #[inline(always)]
    fn len(&self) -> usize {
        self.count + self.more.len()
    }

    #[inline(always)]
    fn push(&mut self, entry: (f32, u32)) {
        if self.count < SHALLOW {
            self.few[self.count] = entry;
            self.count += 1;
        } else {
            self.more.push(entry);
        }
    }

    /// Pushes, and keeps what lies from `from` on in order, the nearest on top.
    #[inline(always)]
    fn insert(&mut self, from: usize, entry: (f32, u32)) {
        self.push(entry);
        if self.more.is_empty() {
            let mut i = self.count - 1;
            while i > from && self.few[i - 1].0 < self.few[i].0 {
                self.few.swap(i - 1, i);
                i -= 1;
            }
        }
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<(f32, u32)> {
        if !self.more.is_empty() {
            return self.more.pop();
        }
        self.count = self.count.checked_sub(1)?;
        Some(self.few[self.count])
    }
}

/// A ray made ready: for boxes its inverse direction, for triangles its own coordinates, the dominant axis last,
/// sheared so that the ray runs along it.
struct Ray {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
    /// Which of a node's six sides the ray meets first along each axis, and which last.
    first: [usize; 3],
    last: [usize; 3],
    axes: [usize; 3],
    shear: [f32; 3],
    t_min: f32,
}

impl Ray {
    #[inline(always)]
    fn new(origin: Vec3, direction: Vec3, t_min: f32) -> Option<Self> {
        if !direction.is_finite() || direction == Vec3::ZERO {
            return None;
        }
        let d = direction.to_array();
        // The axes in cyclic order with the dominant last. A ray towards its negative end sees triangles mirrored,
        // which is one to a test that takes both sides.
        let dominant = direction.abs().max_position();
        let axes = [(dominant + 1) % 3, (dominant + 2) % 3, dominant];
        // By the sign bit, as the inverse: -0 runs backwards too.
        let side =
            |back: bool| std::array::from_fn(|i| i + if d[i].is_sign_negative() == back { 0 } else { 3 });
        Some(Self {
            origin: origin.to_array().map(Vec4::splat),
            inverse: d.map(|d| Vec4::splat(1.0 / if d.abs() < SMALLEST { SMALLEST.copysign(d) } else { d })),
            first: side(false),
            last: side(true),
            axes,
            shear: [d[axes[0]] / d[dominant], d[axes[1]] / d[dominant], 1.0 / d[dominant]],
            t_min,
        })
    }

    /// Where the ray enters each child, and a bit for each that it enters before `limit`.
    #[inline(always)]
    fn enters(&self, node: &Node, limit: f32) -> (Vec4, u32) {
        let at = |side: usize, axis: usize| (node.sides[side] - self.origin[axis]) * self.inverse[axis];
        let [nx, ny, nz] = [at(self.first[0], 0), at(self.first[1], 1), at(self.first[2], 2)];
        let [fx, fy, fz] = [at(self.last[0], 0), at(self.last[1], 1), at(self.last[2], 2)];
        let near = nx.max(ny).max(nz.max(Vec4::splat(self.t_min)));
        let far = fx.min(fy).min(fz) * ROUNDING;
        (near, near.cmple(far.min(Vec4::splat(limit))).bitmask())
    }

    /// Lanes whose triangle the ray meets anywhere, with the edge functions and their sum, and the sum of depths.
    #[inline(always)]
    fn through(&self, leaf: &Leaf) -> Option<(BVec4A, [Vec4; 4], Vec4)> {
        let [x, y, z] = self.axes;
        let [sx, sy] = [Vec4::splat(self.shear[0]), Vec4::splat(self.shear[1])];
        let flat = |corner: &[Vec4; 3]| {
            let depth = corner[z] - self.origin[z];
            (corner[x] - self.origin[x] - sx * depth, corner[y] - self.origin[y] - sy * depth, depth)
        };
        let [(x0, y0, z0), (x1, y1, z1), (x2, y2, z2)] =
            [flat(&leaf.corners[0]), flat(&leaf.corners[1]), flat(&leaf.corners[2])];
        let mut u = x2 * y1 - y2 * x1;
        let mut v = x0 * y2 - y0 * x2;
        let mut w = x1 * y0 - y1 * x0;
        let zero = Vec4::ZERO;
        if (u.cmpeq(zero) | v.cmpeq(zero) | w.cmpeq(zero)).any() {
            // On an edge: the sign decides between two neighbours, so it is taken exactly.
            u = cross(x2, y1, y2, x1);
            v = cross(x0, y2, y0, x2);
            w = cross(x1, y0, y1, x0);
        }
        let outside =
            (u.cmplt(zero) | v.cmplt(zero) | w.cmplt(zero)) & (u.cmpgt(zero) | v.cmpgt(zero) | w.cmpgt(zero));
        let sum = u + v + w;
        let inside = !outside & (sum.cmplt(zero) | sum.cmpgt(zero));
        inside.any().then(|| (inside, [u, v, w, sum], u * z0 + v * z1 + w * z2))
    }

    /// Lanes met at `t_min < t < limit`, and t.
    #[inline(always)]
    fn between(&self, inside: BVec4A, depths: Vec4, sum: Vec4, limit: f32) -> (u32, Vec4) {
        let t = depths * self.shear[2] / sum;
        let between = t.cmpgt(Vec4::splat(self.t_min)) & t.cmplt(Vec4::splat(limit));
        ((inside & between).bitmask(), t)
    }

    #[inline(always)]
    fn meets(&self, leaf: &Leaf, limit: f32) -> bool {
        let Some((inside, [.., sum], depths)) = self.through(leaf) else { return false };
        self.between(inside, depths, sum, limit).0 != 0
    }

    #[inline(always)]
    fn nearest_of(&self, leaf: &Leaf, limit: f32) -> Option<Hit> {
        let (inside, [_, v, w, sum], depths) = self.through(leaf)?;
        let (mut lanes, t) = self.between(inside, depths, sum, limit);
        let mut best = None::<usize>;
        while lanes != 0 {
            let i = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            if best.is_none_or(|b| t[i] < t[b]) {
                best = Some(i);
            }
        }
        let i = best?;
        Some(Hit { triangle: leaf.triangles[i], t: t[i], u: v[i] / sum[i], v: w[i] / sum[i] })
    }
}

/// p q - r s in every lane, rounded once.
#[cold]
fn cross(p: Vec4, q: Vec4, r: Vec4, s: Vec4) -> Vec4 {
    let wide = |v: Vec4| v.as_dvec4();
    (wide(p) * wide(q) - wide(r) * wide(s)).as_vec4()
}

/// A binary hierarchy on its way into a [`Tree`].
struct Folding<'a> {
    binary: &'a Bvh2,
    corners: &'a [[Vec3; 3]],
    /// Index among `corners` of every triangle that the hierarchy holds.
    known: &'a [u32],
    /// Triangles below every binary node.
    counts: Vec<u32>,
}

impl<'a> Folding<'a> {
    fn new(binary: &'a Bvh2, corners: &'a [[Vec3; 3]], known: &'a [u32]) -> Self {
        let (mut order, mut open) = (vec![], vec![0usize]);
        while let Some(at) = open.pop() {
            order.push(at);
            if !binary.nodes[at].is_leaf() {
                let first = binary.nodes[at].first_index as usize;
                open.extend([first, first + 1]);
            }
        }
        let mut counts = vec![0u32; binary.nodes.len()];
        for &at in order.iter().rev() {
            let node = &binary.nodes[at];
            let first = node.first_index as usize;
            counts[at] = if node.is_leaf() { node.prim_count } else { counts[first] + counts[first + 1] };
        }
        Self { binary, corners, known, counts }
    }

    fn fold(&self) -> Tree {
        let mut tree = Tree { nodes: vec![], leaves: vec![], root: NOTHING };
        // Binary node, and the node and child that it becomes.
        let mut open = vec![(0usize, None::<(usize, usize)>)];
        while let Some((at, place)) = open.pop() {
            let made = if self.is_small(at) {
                tree.leaves.push(self.leaf(at));
                (tree.leaves.len() - 1) as u32 | LEAF
            } else {
                let number = tree.nodes.len();
                let children = self.children(at);
                let [mut low, mut high] = [[Vec4::INFINITY; 3], [Vec4::NEG_INFINITY; 3]];
                for (i, &child) in children.iter().enumerate() {
                    let bounds = self.binary.nodes[child].aabb();
                    for axis in 0..3 {
                        // Boxes of triangles that were cut are rounded: a ray must not miss one that it touches.
                        let (from, to) = (bounds.min[axis], bounds.max[axis]);
                        let room = PADDING * from.abs().max(to.abs());
                        (low[axis][i], high[axis][i]) = (from - room, to + room);
                    }
                    open.push((child, Some((number, i))));
                }
                let ([a, b, c], [d, e, f]) = (low, high);
                tree.nodes.push(Node { sides: [a, b, c, d, e, f], children: [NOTHING; FOUR] });
                number as u32
            };
            match place {
                Some((node, child)) => tree.nodes[node].children[child] = made,
                None => tree.root = made,
            }
        }
        tree
    }

    fn is_small(&self, at: usize) -> bool {
        self.counts[at] as usize <= FOUR || self.binary.nodes[at].is_leaf()
    }

    /// The binary node's two children, the largest of them replaced by its own two, until there are four.
    fn children(&self, at: usize) -> Vec<usize> {
        let first = self.binary.nodes[at].first_index as usize;
        let mut children = vec![first, first + 1];
        while children.len() < FOUR {
            let area = |i: &usize| self.binary.nodes[children[*i]].aabb().half_area();
            let largest = (0..children.len())
                .filter(|&i| !self.is_small(children[i]))
                .max_by(|a, b| area(a).total_cmp(&area(b)));
            let Some(largest) = largest else { break };
            let first = self.binary.nodes[children[largest]].first_index as usize;
            children[largest] = first;
            children.push(first + 1);
        }
        children
    }

    fn leaf(&self, at: usize) -> Leaf {
        let mut leaf = Leaf { corners: [[Vec4::NAN; 3]; 3], triangles: [NOTHING; FOUR] };
        let (mut open, mut count) = (vec![at], 0);
        while let Some(at) = open.pop() {
            let node = &self.binary.nodes[at];
            let first = node.first_index as usize;
            if !node.is_leaf() {
                open.extend([first, first + 1]);
                continue;
            }
            for &primitive in &self.binary.primitive_indices[first..first + node.prim_count as usize] {
                let triangle = self.known[primitive as usize];
                // Split triangles come more than once.
                if leaf.triangles.contains(&triangle) {
                    continue;
                }
                for (c, corner) in self.corners[triangle as usize].iter().enumerate() {
                    (0..3).for_each(|axis| leaf.corners[c][axis][count] = corner[axis]);
                }
                leaf.triangles[count] = triangle;
                count += 1;
            }
        }
        leaf
    }
}
