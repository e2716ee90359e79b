//! Patches: groups of elements that share one irradiance by bounces and one reflectance in simulating them.
//!
//! Which elements make a patch: `divide`. Rays always go against the full surface: only what they bring is kept by
//! patch. There are no more of them than asked for, however fine the mesh is.
//!
//! Between patches light is interpolated: at each element the patches round it count by a Gaussian of their distance
//! and by how much their normals agree.

use super::Elements;
use super::divide::divide;
use glam::Vec3;
use rayon::prelude::*;

/// Cells do not grow beyond so many times their size.
const COARSEST: f32 = 1e4;

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
    /// Area of each member and all before it.
    areas: Vec<f32>,
    /// Members that stand for all, each for the same area.
    spots: Vec<u32>,
}

impl Patches {
    /// Groups `elements`; `sizes[i]` (metres) is the largest cell of mesh `i`. Where that leads to more than `most`
    /// patches, cells are larger, those of the first mesh last.
    pub fn build(elements: &Elements, sizes: &[f32], most: usize) -> Self {
        // The first mesh is the object: the others, which may be a whole room, are made coarser before it is.
        let mut coarser = [1.0f32; 2];
        loop {
            let sizes: Vec<f32> =
                sizes.iter().enumerate().map(|(m, s)| s * coarser[usize::from(m > 0)]).collect();
            let groups = divide(elements, &sizes);
            let others = groups.iter().filter(|g| elements.mesh_of(g[0] as usize) > 0).count();
            let which = usize::from(others > most / 4 && coarser[1] <= COARSEST);
            // Whatever the cells, normals part patches.
            if groups.len() <= most || coarser[which] > COARSEST {
                return Self::of_groups(elements, groups);
            }
            coarser[which] *= (groups.len() as f32 / most as f32).sqrt().max(1.5);
        }
    }

    /// Every element a patch of its own.
    #[cfg(test)]
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
    pub fn element_at(&self, patch: usize, share: f32) -> usize {
        let patch = &self.all[patch];
        at_share(&patch.members, &patch.areas, share)
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
        let areas = running_areas(elements, &members);
        for &e in &members {
            let (e, a) = (e as usize, elements.area(e as usize));
            area += a;
            centre += elements.centroid(e) * a;
            normal += elements.normal(e) * a;
        }
        let first = members[0] as usize;
        let centre = if area > 0.0 { centre / area } else { elements.centroid(first) };
        let mut spots: Vec<u32> =
            (0..SPOTS).map(|i| at_share(&members, &areas, (i as f32 + 0.5) / SPOTS as f32) as u32).collect();
        spots.dedup();
        let mesh = elements.mesh_of(first) as u32;
        Self { mesh, area, centre, normal: normal.normalize_or_zero(), members, areas, spots }
    }
}

/// Area of each element and all before it.
pub(super) fn running_areas(elements: &Elements, members: &[u32]) -> Vec<f32> {
    let mut area = 0.0;
    let up_to = |e: &u32| {
        area += elements.area(*e as usize);
        area
    };
    members.iter().map(up_to).collect()
}

/// The element at a share (0 to 1) of all area, `areas` being [`running_areas`].
pub(super) fn at_share(members: &[u32], areas: &[f32], share: f32) -> usize {
    let at = share * areas.last().copied().unwrap_or(0.0);
    let place = areas.partition_point(|area| *area <= at).min(members.len().saturating_sub(1));
    members.get(place).map_or(0, |&e| e as usize)
}

#[cfg(test)]
#[path = "patches_tests.rs"]
mod tests;
