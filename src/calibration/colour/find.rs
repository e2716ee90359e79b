//! A chart in a picture, without help or with its corners given.
//!
//! Even regions of about a patch's shape are sought, lattices among them, and windows of 6x4 in each lattice. A
//! homography through a window's regions tells where all 24 patches must be, those that no region was found for too
//! (dark ones on a dark frame). A linear matrix from the colours there to a chart's references, in each of the
//! window's two orientations, then leaves small differences for the right chart the right way round only.

use super::charts::{COLUMNS, ChartKind, PATCHES, ROWS};
use super::cielab::{delta_e_2000, lab};
use super::fit::linear;
use super::lattice::{Lattice, lattices};
use super::plane::{chart_corners, homography, measured_corners, patch_centre, project};
use super::regions::regions;
use crate::raster::Rgb;
use glam::{DMat3, DVec2, DVec3};

/// Mean CIEDE2000 after a linear matrix up to which patches are those of a chart. Cameras leave 2 to 6 under even
/// light, uneven light more; the right chart turned round leaves 20 and more.
const MOST_DIFFERENCE: f64 = 12.0;

/// By how much the next best chart or orientation must be worse.
const CLEARLY: f64 = 1.25;

/// Fewest patches of a window that must have been found as regions.
const LEAST_SEEN: usize = 9;

/// Windows of a lattice that are looked at, the fullest first.
const MOST_WINDOWS: usize = 24;

/// Root mean square distance of regions from their places, in steps between patches, up to which they are a chart.
const MOST_OFF: f64 = 0.12;

/// A chart that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Which; of editions that differ in their values alone, the one that fits best.
    pub kind: ChartKind,
    /// Pixels of the picture from columns and rows of the chart, (0, 0) being the first patch's centre.
    pub image_from_chart: DMat3,
    /// Patches whose regions were found; the others' places follow from these. 0 if corners were given.
    pub patches_seen: usize,
    /// Mean CIEDE2000 after a linear matrix.
    pub mean_difference: f64,
}

/// Finds the best chart of these kinds; `None` if none is seen clearly. The picture is linear camera RGB in any unit;
/// a chart wants about 60 pixels of width or more.
pub fn find(image: &Rgb, kinds: &[ChartKind]) -> Option<Found> {
    let mut guesses = vec![];
    for lattice in lattices(&regions(image)) {
        for window in windows(&lattice) {
            guesses.extend(judge(image, &window, kinds));
        }
    }
    best(guesses)
}

/// Finds out which chart lies between four corners, the outer ones of its corner patches in any order, and how it is
/// turned.
pub fn between(image: &Rgb, corners: [DVec2; 4], kinds: &[ChartKind]) -> Option<Found> {
    let middle = corners.iter().sum::<DVec2>() / 4.0;
    let mut turn = corners;
    turn.sort_by(|a, b| (*a - middle).to_angle().total_cmp(&(*b - middle).to_angle()));
    let mut guesses = vec![];
    for first in 0..4 {
        let pairs: Vec<_> = (0..4).map(|k| (chart_corners()[k], turn[(first + k) % 4])).collect();
        let Some(image_from_chart) = homography(&pairs) else { continue };
        guesses.extend(compare(image, image_from_chart, 0, kinds));
    }
    best(guesses)
}

fn best(mut guesses: Vec<Found>) -> Option<Found> {
    guesses.sort_by(|a, b| a.mean_difference.total_cmp(&b.mean_difference));
    let first = *guesses.first()?;
    let differs = |other: &&Found| {
        let near = project(&other.image_from_chart, DVec2::ZERO)
            .distance(project(&first.image_from_chart, DVec2::ZERO));
        let step = project(&first.image_from_chart, DVec2::X)
            .distance(project(&first.image_from_chart, DVec2::ZERO));
        !first.kind.same_chart(other.kind) || near > 0.5 * step
    };
    let next = guesses.iter().find(differs);
    let clear = next.is_none_or(|n| n.mean_difference > CLEARLY * first.mean_difference);
    (first.mean_difference < MOST_DIFFERENCE && clear).then_some(first)
}

/// Regions of a 6x4 window in the chart's columns and rows, in one of the two orientations that fit.
type Window = Vec<(DVec2, DVec2)>;

fn windows(lattice: &Lattice) -> Vec<Window> {
    let span = |pick: fn(&(i32, i32)) -> i32, wide: usize| {
        let (low, high) =
            lattice.keys().map(pick).fold((i32::MAX, i32::MIN), |(l, h), v| (l.min(v), h.max(v)));
        let wide = wide as i32;
        // Also windows that reach two columns or rows past what was found: whole rows may be too dark to find.
        let (from, to) = (low - 2, high + 3 - wide);
        from..=to.max(from)
    };
    let mut out: Vec<Window> = vec![];
    for turned in [false, true] {
        let (wide, high) = if turned { (ROWS, COLUMNS) } else { (COLUMNS, ROWS) };
        for row in span(|p| p.1, high) {
            for column in span(|p| p.0, wide) {
                let inside = |p: &(i32, i32)| {
                    let (x, y) = (p.0 - column, p.1 - row);
                    (0..wide as i32).contains(&x) && (0..high as i32).contains(&y)
                };
                let place = |p: &(i32, i32)| {
                    let (x, y) = (f64::from(p.0 - column), f64::from(p.1 - row));
                    // A quarter turn, no mirror: the chart's columns run down the lattice.
                    if turned { DVec2::new(y, (ROWS - 1) as f64 - x) } else { DVec2::new(x, y) }
                };
                let window: Window =
                    lattice.iter().filter(|(p, _)| inside(p)).map(|(p, at)| (place(p), *at)).collect();
                if window.len() >= LEAST_SEEN {
                    out.push(window);
                }
            }
        }
    }
    out.sort_by_key(|window| std::cmp::Reverse(window.len()));
    out.truncate(MOST_WINDOWS);
    out
}

/// A window both ways round, for every chart.
fn judge(image: &Rgb, window: &Window, kinds: &[ChartKind]) -> Vec<Found> {
    let last = DVec2::new((COLUMNS - 1) as f64, (ROWS - 1) as f64);
    let mut out = vec![];
    for round in [false, true] {
        let pairs: Vec<_> = window.iter().map(|(p, at)| (if round { last - *p } else { *p }, *at)).collect();
        let Some(image_from_chart) = homography(&pairs) else { continue };
        let off =
            pairs.iter().map(|(p, at)| project(&image_from_chart, *p).distance_squared(*at)).sum::<f64>();
        let step = (project(&image_from_chart, last) - project(&image_from_chart, DVec2::ZERO)).length()
            / last.length();
        if (off / pairs.len() as f64).sqrt() > MOST_OFF * step {
            continue;
        }
        out.extend(compare(image, image_from_chart, window.len(), kinds));
    }
    out
}

fn compare(image: &Rgb, image_from_chart: DMat3, patches_seen: usize, kinds: &[ChartKind]) -> Vec<Found> {
    let Some(colours) = colours(image, &image_from_chart) else { return vec![] };
    let of = |&kind: &ChartKind| {
        let references = kind.reference_xyz();
        let matrix = linear(colours.iter().copied().zip(references))?;
        let difference = |k: usize| delta_e_2000(kind.patches()[k].1, lab(matrix * colours[k]));
        let mean_difference = (0..PATCHES).map(difference).sum::<f64>() / PATCHES as f64;
        mean_difference.is_finite().then_some(Found { kind, image_from_chart, patches_seen, mean_difference })
    };
    kinds.iter().filter_map(of).collect()
}

/// Means over the middle of each patch; `None` if any lies outside the picture.
fn colours(image: &Rgb, image_from_chart: &DMat3) -> Option<Vec<DVec3>> {
    const STEPS: i32 = 2;
    let one = |patch: usize| {
        let reach = measured_corners(image_from_chart, patch);
        let (mut sum, mut n) = (DVec3::ZERO, 0.0);
        for j in -STEPS..=STEPS {
            for i in -STEPS..=STEPS {
                let inner = DVec2::new(f64::from(i), f64::from(j)) * 0.08;
                let at = project(image_from_chart, patch_centre(patch) + inner);
                if !at.is_finite() || at.min_element() < 0.0 {
                    return None;
                }
                let pixel = image.get(at.x as isize, at.y as isize)?;
                sum += DVec3::from_array(pixel.map(f64::from));
                n += 1.0;
            }
        }
        reach.iter().all(|p| p.is_finite()).then(|| sum / n)
    };
    (0..PATCHES).map(one).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::calibration::colour::fit::tests::{camera, even, normal};
    use crate::raster::Image;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    /// A chart on a dark card on a bright table, seen by a camera; each channel's noise is relative to its white.
    pub(in super::super) fn scene(
        kind: ChartKind,
        size: (usize, usize),
        image_from_chart: DMat3,
        rgb_from_xyz: DMat3,
        noise: f64,
        seed: u64,
    ) -> Rgb {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let chart_from_image = image_from_chart.inverse();
        let references = kind.reference_xyz();
        let white = rgb_from_xyz * DVec3::new(0.9642, 1.0, 0.8249);
        let seen = |p: DVec2| {
            let at = project(&chart_from_image, p);
            let (column, row) = (at.x.round(), at.y.round());
            let inside = (0.0..COLUMNS as f64).contains(&column) && (0.0..ROWS as f64).contains(&row);
            let off = (at - DVec2::new(column, row)).abs().max_element();
            let frame = at.x > -1.2 && at.x < 6.2 && at.y > -1.0 && at.y < 4.0;
            match (frame, inside && off < 0.42) {
                (true, true) => rgb_from_xyz * references[row as usize * COLUMNS + column as usize],
                (true, false) => white * 0.035,
                (false, _) => {
                    white * (0.45 + 0.1 * (0.05 * p.x).sin() + 0.1 * (0.03 * (p.x + 2.0 * p.y)).cos())
                }
            }
        };
        Image::from_fn(size.0, size.1, |x, y| {
            let mut sum = DVec3::ZERO;
            for (i, j) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                sum += seen(DVec2::new(x as f64 + i, y as f64 + j)) / 4.0;
            }
            let noisy = sum + white * noise * DVec3::from_array([0; 3].map(|_| normal(&mut rng)));
            noisy.to_array().map(|v| v as f32)
        })
    }

    /// What the finder sees, for a test that fails.
    fn seen(image: &Rgb) -> String {
        let regions = regions(image);
        let mut text = format!("{} regions", regions.len());
        for lattice in lattices(&regions) {
            text += &format!("\nlattice of {}:", lattice.len());
            for window in windows(&lattice) {
                let best = judge(image, &window, &ChartKind::ALL).into_iter();
                let best = best.min_by(|a, b| a.mean_difference.total_cmp(&b.mean_difference));
                text += &format!(" {}:{:.1?}", window.len(), best.map(|b| (b.kind, b.mean_difference)));
            }
        }
        text
    }

    /// A chart turned by an angle, of `step` pixels a patch, with a little perspective.
    pub(in super::super) fn pose(centre: DVec2, step: f64, angle: f64, tilt: DVec2) -> DMat3 {
        let perspective =
            DMat3::from_cols(DVec3::new(1.0, 0.0, tilt.x), DVec3::new(0.0, 1.0, tilt.y), DVec3::Z);
        DMat3::from_translation(centre)
            * perspective
            * DMat3::from_angle(angle)
            * DMat3::from_scale(DVec2::splat(step))
            * DMat3::from_translation(DVec2::new(-2.5, -1.5))
    }

    #[test]
    fn charts_turned_tilted_small_and_under_a_cast_are_found_the_right_way_round() {
        let mut rng = ChaCha8Rng::seed_from_u64(21);
        for case in 0..10 {
            let kind = ChartKind::ALL[case % 3];
            let step = 12.0 + 16.0 * even(&mut rng);
            let angle = std::f64::consts::TAU * even(&mut rng);
            let tilt = DVec2::new(even(&mut rng) - 0.5, even(&mut rng) - 0.5) * 0.002;
            let truth = pose(DVec2::new(170.0, 125.0), step, angle, tilt);
            let image = scene(kind, (340, 250), truth, camera(&mut rng) * 900.0, 0.004, case as u64);
            let found = find(&image, &ChartKind::ALL)
                .unwrap_or_else(|| panic!("case {case}: {kind:?} {step} {angle}\n{}", seen(&image)));
            assert!(found.kind.same_chart(kind), "case {case}: {found:?}");
            for k in 0..PATCHES {
                let [there, expected] = [found.image_from_chart, truth].map(|h| project(&h, patch_centre(k)));
                assert!(there.distance(expected) < 0.1 * step, "case {case} patch {k}: {there} {expected}");
            }
        }
    }

    #[test]
    fn corners_in_any_order_do_as_well_as_no_help() {
        let truth = pose(DVec2::new(120.0, 90.0), 22.0, 2.6, DVec2::new(0.001, -0.0007));
        let image = scene(ChartKind::Spydercheckr24, (240, 180), truth, DMat3::IDENTITY, 0.002, 3);
        let [a, b, c, d] = chart_corners().map(|p| project(&truth, p));
        for corners in [[a, b, c, d], [c, a, d, b], [d, c, b, a]] {
            let found = between(&image, corners, &ChartKind::ALL).unwrap();
            assert_eq!(found.kind, ChartKind::Spydercheckr24);
            assert!(
                project(&found.image_from_chart, DVec2::ZERO).distance(project(&truth, DVec2::ZERO)) < 0.5
            );
        }
    }

    #[test]
    fn frames_without_a_chart_have_none() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let noise = Image::from_fn(200, 150, |_, _| [0; 3].map(|_| even(&mut rng) as f32));
        assert_eq!(find(&noise, &ChartKind::ALL), None);
        assert_eq!(find(&Image::filled(200, 150, [0.3; 3]), &ChartKind::ALL), None);
        assert_eq!(find(&Image::filled(2, 1, [0.3; 3]), &ChartKind::ALL), None);
        // Tiles of random colours in rows and columns are no chart.
        let tiles: Vec<[f32; 3]> = (0..200).map(|_| [0; 3].map(|_| even(&mut rng) as f32)).collect();
        let wall = Image::from_fn(240, 180, |x, y| match (x % 20 < 16, y % 20 < 16) {
            (true, true) => tiles[(y / 20) * 12 + x / 20],
            _ => [0.02; 3],
        });
        assert_eq!(find(&wall, &ChartKind::ALL), None);
    }
}
