//! Patches: groups of elements that share one irradiance by bounces and one reflectance in simulating them.
//!
//! Bounced light changes slowly over a surface, except where another surface is near. So elements whose centroids lie
//! in one cell of a grid and whose normals lie in one of 54 classes make a patch, and a patch is divided by halving its
//! cell as long as some of its rays meet another surface within about its own size (the solid angle under which one
//! patch sees another is what bounds the error of taking both as even: Hanrahan, Salzman and Aupperle, "A rapid
//! hierarchical radiosity algorithm", 1991). Rays always go against the full surface: only what they bring is kept by
//! patch. There are no more of them than `MOST_PATCHES`, however fine the mesh is.
//!
//! Between patches light is interpolated: at each element the patches round it count by a Gaussian of their distance
//! and by how much their normals agree.

use super::Elements;
use glam::{Quat, Vec3};
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Most patches; where finer cells would lead to more, all are larger.
const MOST_PATCHES: usize = 120_000;

/// Cells do not grow beyond so many times their size.
const COARSEST: f32 = 1e4;

/// How often a cell may be halved.
const HALVINGS: usize = 4;

/// Rays that ask whether another surface is near, how many patch sizes count as near, and how many rays must say so.
const ASKING: usize = 16;
const NEAR: f32 = 1.5;
const SAY_SO: usize = 2;

/// Most elements of a patch that stand for it when light falls on it.
pub const SPOTS: usize = 4;

/// Patches that an element's light is interpolated from.
const ROUND: usize = 6;

/// Power of the normals' cosine by which patches count.
const AGREE: i32 = 10;

/// Standard deviation of the interpolation, in the roots of the patches' areas.
const REACH: f32 = 0.6;

/// Groups of elements.
pub struct Patches {
    of: Vec<u32>,
    all: Vec<Patch>,
    /// Neighbouring patches on the same smooth surface: `round[starts[p]..starts[p + 1]]`.
    starts: Vec<u32>,
    round: Vec<u32>,
    /// Per element, patches and their weights, which add up to one; unused ones have none.
    shares: Vec<[(u32, f32); ROUND]>,
}

/// One patch.
struct Patch {
    mesh: u32,
    area: f32,
    centre: Vec3,
    normal: Vec3,
    members: Vec<u32>,
    /// Members that stand for all, each for the same area.
    spots: Vec<u32>,
}

impl Patches {
    /// Groups `elements`; `sizes[i]` (metres) is the largest cell of mesh `i`.
    pub fn build(elements: &Elements, sizes: &[f32]) -> Self {
        // The first mesh is the object: the others, which may be a whole room, are made coarser before it is.
        let mut coarser = [1.0f32; 2];
        loop {
            let sizes: Vec<f32> =
                sizes.iter().enumerate().map(|(m, s)| s * coarser[usize::from(m > 0)]).collect();
            let groups = divide(elements, &sizes);
            let others = groups.iter().filter(|g| elements.mesh_of(g[0] as usize) > 0).count();
            let which = usize::from(others > MOST_PATCHES / 4);
            // Whatever the cells, normals part patches.
            if groups.len() <= MOST_PATCHES || coarser[which] > COARSEST {
                return Self::of_groups(elements, groups);
            }
            coarser[which] *= (groups.len() as f32 / MOST_PATCHES as f32).sqrt().max(1.5);
        }
    }

    /// Every element a patch of its own.
    pub fn single(elements: &Elements) -> Self {
        Self::of_groups(elements, (0..elements.len() as u32).map(|e| vec![e]).collect())
    }

    fn of_groups(elements: &Elements, groups: Vec<Vec<u32>>) -> Self {
        let mut of = vec![0; elements.len()];
        for (p, group) in groups.iter().enumerate() {
            group.iter().for_each(|&e| of[e as usize] = p as u32);
        }
        let all: Vec<Patch> = groups.into_par_iter().map(|members| Patch::of(elements, members)).collect();
        let mut pairs: Vec<(u32, u32)> = (0..elements.len())
            .flat_map(|e| elements.beside(e).iter().map(move |&near| (e, near)))
            .map(|(e, near)| (of[e], of[near as usize]))
            .filter(|(a, b)| a != b)
            .collect();
        pairs.par_sort_unstable();
        pairs.dedup();
        let mut starts = vec![0u32; all.len() + 1];
        pairs.iter().for_each(|(a, _)| starts[*a as usize + 1] += 1);
        (0..all.len()).for_each(|p| starts[p + 1] += starts[p]);
        let round: Vec<u32> = pairs.into_iter().map(|(_, b)| b).collect();
        let mut patches = Self { of, all, starts, round, shares: vec![] };
        patches.shares =
            (0..elements.len()).into_par_iter().map(|e| patches.shares_of(elements, e)).collect();
        patches
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The patch that an element belongs to.
    pub fn of(&self, element: usize) -> usize {
        self.of[element] as usize
    }

    /// Index of the mesh that the patch belongs to.
    pub fn mesh_of(&self, patch: usize) -> usize {
        self.all[patch].mesh as usize
    }

    /// Centroid in metres, world frame.
    pub fn centre(&self, patch: usize) -> Vec3 {
        self.all[patch].centre
    }

    /// Area in square metres.
    pub fn area(&self, patch: usize) -> f32 {
        self.all[patch].area
    }

    /// Elements that stand for the patch, each for the same area.
    pub fn spots(&self, patch: usize) -> impl Iterator<Item = usize> {
        self.all[patch].spots.iter().map(|&e| e as usize)
    }

    /// The element at a share (0 to 1) of the patch's area.
    pub fn element_at(&self, elements: &Elements, patch: usize, share: f32) -> usize {
        at_share(elements, &self.all[patch].members, self.all[patch].area, share)
    }

    /// From one value a patch to one a corner of each element.
    pub fn smooth(&self, elements: &Elements, values: &[[f32; 3]]) -> Vec<[[f32; 3]; 3]> {
        let of_elements: Vec<[f32; 3]> = self
            .shares
            .par_iter()
            .map(|shares| {
                let mut sum = [0.0; 3];
                for (patch, weight) in shares {
                    (0..3).for_each(|c| sum[c] += weight * values[*patch as usize][c]);
                }
                sum
            })
            .collect();
        elements.smooth(&of_elements)
    }

    /// Gives every patch without a value the mean of its neighbours', ring by ring outwards from those that
    /// have one; what no ring reaches keeps none.
    pub fn spread(&self, values: &mut [Option<[f32; 3]>]) {
        let mut open: Vec<usize> = (0..self.len()).filter(|&p| values[p].is_none()).collect();
        loop {
            let found: Vec<(usize, Option<[f32; 3]>)> =
                open.par_iter().map(|&p| (p, self.mean_of_neighbours(p, values))).collect();
            open.clear();
            let mut grown = false;
            for (p, value) in found {
                grown |= value.is_some();
                values[p] = value;
                if value.is_none() {
                    open.push(p);
                }
            }
            if !grown {
                return;
            }
        }
    }

    fn beside(&self, patch: usize) -> &[u32] {
        &self.round[self.starts[patch] as usize..self.starts[patch + 1] as usize]
    }

    fn mean_of_neighbours(&self, patch: usize, values: &[Option<[f32; 3]>]) -> Option<[f32; 3]> {
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for value in self.beside(patch).iter().filter_map(|&near| values[near as usize]) {
            count += 1.0;
            (0..3).for_each(|c| sum[c] += value[c]);
        }
        (count > 0.0).then(|| sum.map(|s| s / count))
    }

    fn shares_of(&self, elements: &Elements, element: usize) -> [(u32, f32); ROUND] {
        let own = self.of[element];
        let (place, normal) = (elements.centroid(element), elements.normal(element));
        let mut found: Vec<(u32, f32)> = std::iter::once(own)
            .chain(self.beside(own as usize).iter().copied())
            .map(|p| {
                let patch = &self.all[p as usize];
                let apart = (patch.centre - place).length_squared() / (REACH * REACH * patch.area.max(1e-20));
                (p, (-0.5 * apart).exp() * normal.dot(patch.normal).max(0.0).powi(AGREE))
            })
            .collect();
        // The heaviest, and among equals the first.
        found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        found.truncate(ROUND);
        let all: f32 = found.iter().map(|f| f.1).sum();
        let mut shares = [(own, 0.0); ROUND];
        if all > f32::MIN_POSITIVE {
            shares.iter_mut().zip(found).for_each(|(s, (p, w))| *s = (p, w / all));
        } else {
            shares[0].1 = 1.0;
        }
        shares
    }
}

impl Patch {
    fn of(elements: &Elements, members: Vec<u32>) -> Self {
        let (mut area, mut centre, mut normal) = (0.0, Vec3::ZERO, Vec3::ZERO);
        for &e in &members {
            let (e, a) = (e as usize, elements.area(e as usize));
            area += a;
            centre += elements.centroid(e) * a;
            normal += elements.normal(e) * a;
        }
        let first = members[0] as usize;
        let centre = if area > 0.0 { centre / area } else { elements.centroid(first) };
        let mut spots: Vec<u32> = (0..SPOTS)
            .map(|i| at_share(elements, &members, area, (i as f32 + 0.5) / SPOTS as f32) as u32)
            .collect();
        spots.dedup();
        let mesh = elements.mesh_of(first) as u32;
        Self { mesh, area, centre, normal: normal.normalize_or_zero(), members, spots }
    }
}

fn at_share(elements: &Elements, members: &[u32], area: f32, share: f32) -> usize {
    let mut left = share * area;
    for &e in members {
        left -= elements.area(e as usize);
        if left < 0.0 {
            return e as usize;
        }
    }
    members.last().map_or(0, |&e| e as usize)
}

/// Elements grouped by cell and normal, cells halved where another surface is near.
fn divide(elements: &Elements, sizes: &[f32]) -> Vec<Vec<u32>> {
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
    let area: f32 = members.iter().map(|&e| elements.area(e as usize)).sum();
    let met = (0..ASKING).filter(|&i| {
        let spread = |step: f32| ((i as f32 + 0.5) * step).fract();
        let element = at_share(elements, members, area, spread(0.618_034));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mesh;

    fn plate(corner: Vec3, a: Vec3, b: Vec3) -> Mesh {
        Mesh {
            positions: vec![corner, corner + a, corner + a + b, corner + b],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    /// A floor and a wall that meet along an edge.
    fn corner() -> (Elements, Patches) {
        let meshes = [plate(Vec3::ZERO, Vec3::X, Vec3::Y), plate(Vec3::ZERO, Vec3::Y, Vec3::Z)];
        let elements = Elements::build(&[&meshes[0], &meshes[1]], &[0.02, 0.02]);
        let patches = Patches::build(&elements, &[0.2, 0.2]);
        (elements, patches)
    }

    #[test]
    fn every_element_has_one_patch_and_areas_add_up() {
        let (elements, patches) = corner();
        assert!(patches.len() * 5 < elements.len(), "{} of {}", patches.len(), elements.len());
        let all: f32 = (0..patches.len()).map(|p| patches.area(p)).sum();
        assert!((all - 2.0).abs() < 1e-3, "{all}");
        for e in 0..elements.len() {
            assert_eq!(patches.mesh_of(patches.of(e)), elements.mesh_of(e));
        }
    }

    #[test]
    fn patches_are_smaller_where_another_surface_is_near() {
        let (elements, patches) = corner();
        let mean_area = |low: f32, high: f32| {
            let within = |p: &usize| {
                let x = patches.all[*p].centre.x;
                elements.mesh_of(patches.all[*p].members[0] as usize) == 0 && x >= low && x < high
            };
            let found: Vec<f32> = (0..patches.len()).filter(within).map(|p| patches.area(p)).collect();
            found.iter().sum::<f32>() / found.len() as f32
        };
        assert!(mean_area(0.0, 0.1) < 0.2 * mean_area(0.6, 1.0));
    }

    #[test]
    fn interpolation_keeps_a_constant_and_follows_a_slope() {
        let (elements, patches) = corner();
        let even = patches.smooth(&elements, &vec![[3.0; 3]; patches.len()]);
        assert!(even.iter().flatten().flatten().all(|v| (v - 3.0).abs() < 1e-4));
        let slope: Vec<[f32; 3]> = patches.all.iter().map(|p| p.centre.to_array()).collect();
        let corners = patches.smooth(&elements, &slope);
        for e in (0..elements.len()).filter(|&e| elements.mesh_of(e) == 0) {
            let place = elements.centroid(e);
            let got: f32 = corners[e].iter().map(|c| c[1]).sum::<f32>() / 3.0;
            let inside = place.y > 0.2 && place.y < 0.8 && place.x > 0.2 && place.x < 0.8;
            assert!(!inside || (got - place.y).abs() < 0.04, "{got} at {place}");
        }
    }

    #[test]
    fn values_spread_to_the_whole_of_a_connected_surface() {
        let (_, patches) = corner();
        let mut values = vec![None; patches.len()];
        values[0] = Some([0.25, 0.5, 0.75]);
        patches.spread(&mut values);
        for (p, value) in values.iter().enumerate() {
            let want = (patches.mesh_of(p) == patches.mesh_of(0)).then_some([0.25, 0.5, 0.75]);
            assert_eq!(*value, want, "patch {p}");
        }
    }

    #[test]
    fn a_large_floor_does_not_take_the_patches_of_the_object() {
        let object = plate(Vec3::ZERO, Vec3::X, Vec3::Y);
        let floor = plate(Vec3::new(-50.0, -50.0, -1.0), Vec3::X * 100.0, Vec3::Y * 100.0);
        let meshes =
            [Elements::build(&[&object], &[0.02]), Elements::build(&[&object, &floor], &[0.02, 0.2])];
        let own = |elements: &Elements| {
            let patches = Patches::build(elements, &[0.04, 0.2]);
            assert!(patches.len() <= MOST_PATCHES, "{}", patches.len());
            (0..patches.len()).filter(|&p| patches.mesh_of(p) == 0).count()
        };
        assert_eq!(own(&meshes[0]), own(&meshes[1]));
    }

    #[test]
    fn there_are_never_more_patches_than_memory_is_for() {
        let mesh = plate(Vec3::ZERO, Vec3::X, Vec3::Y);
        let elements = Elements::build(&[&mesh], &[0.002]);
        assert!(elements.len() > 2 * MOST_PATCHES);
        let patches = Patches::build(&elements, &[0.001]);
        assert!(patches.len() <= MOST_PATCHES, "{}", patches.len());
    }
}
