//! Regions that stand in rows and columns.

use super::regions::Region;
use glam::DVec2;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Column and row, from whichever region was first, and where it is in the picture.
pub(super) type Lattice = BTreeMap<(i32, i32), DVec2>;

/// Fewest regions of a lattice.
const LEAST: usize = 9;

/// Farthest column or row from the first region.
const REACH: i32 = 8;

/// How far from its place a region may be, over the step to it.
const TOLERANCE: f64 = 0.25;

/// Neighbours of a region that may be those beside and below it.
const NEIGHBOURS: usize = 8;

/// Lattices among regions, the fullest first. Rows run to the right of columns as in the picture: across, then down,
/// is a right-handed turn with y down, so that no lattice is a mirror's.
pub(super) fn lattices(regions: &[Region]) -> Vec<Lattice> {
    let mut out: Vec<Lattice> = vec![];
    let mut done = BTreeSet::new();
    for first in 0..regions.len() {
        if done.contains(&first) {
            continue;
        }
        let beside = neighbours(regions, first);
        let mut best = BTreeMap::new();
        for &across in &beside {
            for &down in &beside {
                let (across, down) = (across - regions[first].centre, down - regions[first].centre);
                if !is_cell(across, down) {
                    continue;
                }
                let corner = regions[first].centre + across + down;
                if nearest(regions, corner, TOLERANCE * across.length()).is_none() {
                    continue;
                }
                let (across, down) = reduced(across, down);
                let grown = grow(regions, first, across, down);
                if grown.len() > best.len() {
                    best = grown;
                }
            }
        }
        if best.len() >= LEAST {
            done.extend(best.values().copied());
            out.push(best.into_iter().map(|(place, region)| (place, regions[region].centre)).collect());
        }
    }
    out.sort_by_key(|lattice| std::cmp::Reverse(lattice.len()));
    // Every other row, or the diagonals, of a lattice are lattices too.
    let mut kept: Vec<Lattice> = vec![];
    for lattice in out {
        let shared = |other: &Lattice| lattice.values().filter(|at| other.values().any(|o| o == *at)).count();
        if kept.iter().all(|other| 2 * shared(other) < lattice.len()) {
            kept.push(lattice);
        }
    }
    kept
}

/// Centres of the nearest regions of a like size that lie as far off as neighbours in a chart do.
fn neighbours(regions: &[Region], first: usize) -> Vec<DVec2> {
    let own = &regions[first];
    let side = own.area.sqrt();
    let mut near: Vec<(f64, DVec2)> = regions
        .iter()
        .filter(|other| alike(own, other))
        .map(|other| (other.centre.distance(own.centre), other.centre))
        .filter(|(distance, _)| (0.8 * side..4.0 * side).contains(distance))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(NEIGHBOURS);
    near.into_iter().map(|(_, centre)| centre).collect()
}

fn alike(a: &Region, b: &Region) -> bool {
    (0.3..3.4).contains(&(a.area / b.area))
}

/// Whether two steps may be a cell's sides: of like length, at no flat angle, in a right-handed turn.
fn is_cell(across: DVec2, down: DVec2) -> bool {
    let (a, d) = (across.length(), down.length());
    (0.5..2.0).contains(&(a / d)) && across.perp_dot(down) > 0.7 * a * d
}

/// The shortest steps of the same lattice (Gauss's reduction): a diagonal and a side span it too, but its rows are then
/// no rows of the chart. Turns as before.
fn reduced(mut across: DVec2, mut down: DVec2) -> (DVec2, DVec2) {
    for _ in 0..8 {
        down -= across * (across.dot(down) / across.length_squared()).round();
        across -= down * (across.dot(down) / down.length_squared()).round();
    }
    (across, down)
}

fn nearest(regions: &[Region], place: DVec2, within: f64) -> Option<usize> {
    let near = regions.iter().enumerate().map(|(i, r)| (r.centre.distance(place), i));
    near.filter(|(distance, _)| *distance < within).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i)| i)
}

/// Takes in neighbour after neighbour; each step is told by the one before, so that perspective is followed.
fn grow(regions: &[Region], first: usize, across: DVec2, down: DVec2) -> BTreeMap<(i32, i32), usize> {
    let mut at = BTreeMap::from([((0, 0), first)]);
    let mut taken = BTreeSet::from([first]);
    let mut queue = VecDeque::from([((0, 0), first, across, down)]);
    while let Some(((column, row), from, across, down)) = queue.pop_front() {
        for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
            let place: (i32, i32) = (column + dx, row + dy);
            if place.0.abs() > REACH || place.1.abs() > REACH || at.contains_key(&place) {
                continue;
            }
            let step = across * f64::from(dx) + down * f64::from(dy);
            let expected = regions[from].centre + step;
            let Some(found) = nearest(regions, expected, TOLERANCE * step.length()) else { continue };
            if !alike(&regions[from], &regions[found]) || !taken.insert(found) {
                continue;
            }
            let real = (regions[found].centre - regions[from].centre) * f64::from(dx + dy);
            let (across, down) = if dx == 0 { (across, real) } else { (real, down) };
            at.insert(place, found);
            queue.push_back((place, found, across, down));
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::colour::plane::{patch_centre, project};
    use glam::DMat3;

    #[test]
    fn a_lattice_in_perspective_is_found_among_strays_and_with_gaps() {
        let plane = DMat3::from_cols_array(&[30.0, 14.0, 0.012, -13.0, 31.0, 0.02, 200.0, 120.0, 1.0]);
        let gaps = [7, 16, 23];
        let of = |k: usize| Region { centre: project(&plane, patch_centre(k)), area: 400.0 };
        let mut regions: Vec<Region> = (0..24).filter(|k| !gaps.contains(k)).map(of).collect();
        regions.extend((0..20).map(|k| Region {
            centre: DVec2::new(37.0 * f64::from(k) % 311.0, 11.0 + 53.0 * f64::from(k) % 97.0),
            area: 90.0,
        }));
        let found = lattices(&regions);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].len(), 21);
    }
}
