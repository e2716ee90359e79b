//! What a gloss mirrors of the lit surfaces round it.
//!
//! From a few places of each glossy patch leave rays along the lobe, as the camera sees it: microfacets drawn with
//! density D cos, the view mirrored in them, each counting by G (v.h) / (cos_v cos_h) (Walter et al., EGSR 2007,
//! eq. 41). Their mean of the exitance that they meet, times the lobe's weight, adds to the reading as a white
//! surface's bounced irradiance would.

use super::robust::{Lobe, passed};
use super::stage::Stage;
use crate::light::Elements;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Fewest rays a patch, where neighbours are averaged because the result is smoothed.
pub(super) const FEW: usize = 12;

/// Rays a patch for a lobe of width 1, where the result tells the lobe's weight: noise in what a weight is fitted to makes
/// it too small, and a wide lobe gathers more of it.
const RAYS: f32 = 240.0;

/// Steps of an even spread in two dimensions: powers of 1 / 1.324718, root of x^3 = x + 1.
const KRONECKER: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];

/// The same for the shifts of elements: fractions of the golden mean and of the root of two.
const SHIFTS: [f64; 2] = [0.618_033_988_749_895, 0.414_213_562_373_095];

/// Mirrored light, DN of irradiance, on every patch whose mesh has a gloss and that faces `eye` (metres, world frame);
/// 0 elsewhere. `exitance`, DN, is what each patch sends out; `rays` are how many it takes for a lobe.
pub(super) fn mirrored(
    stage: &Stage,
    eye: Vec3,
    gloss: &[Option<Lobe>],
    exitance: &[[f32; 3]],
    rays: impl Fn(&Lobe) -> usize + Sync,
) -> Vec<[f32; 3]> {
    let Stage { elements, patches, .. } = stage;
    let met = |element: usize| exitance[patches.of(element)];
    (0..patches.len())
        .into_par_iter()
        .map(|p| match gloss[patches.mesh_of(p)] {
            Some(lobe) => {
                let spots: Vec<usize> = patches.spots(p).collect();
                let rays = rays(&lobe).div_ceil(spots.len().max(1));
                let mut mean = [0.0; 3];
                for &e in &spots {
                    let light = of_element(elements, e, eye, (lobe.alpha, rays), &met);
                    (0..3).for_each(|c| mean[c] += light[c] / spots.len() as f32);
                }
                mean
            }
            None => [0.0; 3],
        })
        .collect()
}

/// Rays a patch that tell a lobe's weight.
pub(super) fn many(lobe: &Lobe) -> usize {
    ((RAYS * lobe.alpha) as usize).max(FEW)
}

fn of_element(
    elements: &Elements,
    e: usize,
    eye: Vec3,
    (alpha, rays): (f32, usize),
    exitance: &impl Fn(usize) -> [f32; 3],
) -> [f32; 3] {
    let (normal, centre) = (elements.normal(e), elements.centroid(e));
    let view = (eye - centre).normalize_or_zero();
    let facing = normal.dot(view);
    let mut sum = [0.0; 3];
    if facing <= 0.0 {
        return sum;
    }
    let start = centre + elements.lift(e);
    let (side, other) = normal.any_orthonormal_pair();
    // Shifts of its own for every element, so that what one misses another finds.
    let shifts = SHIFTS.map(|s| (e as f64 * s).fract());
    for i in 0..rays {
        let spread = |d: usize| ((i as f64 + 0.5) * KRONECKER[d] + shifts[d]).fract() as f32;
        let [u, turn] = [0, 1].map(spread);
        let tilt = ((1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u)).max(0.0).sqrt();
        let (sin, cos) = (TAU * turn).sin_cos();
        let half = normal * tilt + (side * cos + other * sin) * (1.0 - tilt * tilt).max(0.0).sqrt();
        let seen = view.dot(half);
        let way = half * (2.0 * seen) - view;
        let leaving = normal.dot(way);
        if seen <= 0.0 || leaving <= 0.0 || tilt <= 0.0 {
            continue;
        }
        let Some(hit) = elements.kernel().nearest(start, way, 0.0, f32::INFINITY) else { continue };
        let met = hit.triangle as usize;
        if elements.normal(met).dot(way) >= 0.0 {
            continue;
        }
        let share = passed(alpha, facing) * passed(alpha, leaving) * seen / (facing * tilt);
        let exitance = exitance(met);
        (0..3).for_each(|c| sum[c] += share * exitance[c] / rays as f32);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Patches;
    use crate::scene::Mesh;

    /// Two plates of 2 m at right angles, the first lying, the second standing at x = 1.
    fn corner() -> Stage {
        let quad = |p: [[f32; 3]; 4]| Mesh {
            positions: p.map(Vec3::from).into(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let lying = quad([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]);
        let standing = quad([[1.0, -9.0, 0.0], [1.0, -9.0, 9.0], [1.0, 9.0, 9.0], [1.0, 9.0, 0.0]]);
        let elements = Elements::build(&[&lying, &standing], &[0.2, 1.0]);
        let patches = Patches::single(&elements);
        Stage { elements, patches, offset: 1e-4 }
    }

    #[test]
    fn few_rays_of_a_wide_lobe_are_right_in_the_mean_over_many_elements() {
        let stage = corner();
        let elements = &stage.elements;
        let exitance: Vec<[f32; 3]> = (0..elements.len()).map(|e| [elements.mesh_of(e) as f32; 3]).collect();
        for alpha in [0.1, 0.3, 0.5] {
            let gloss = [Some(Lobe { weight: 0.1, alpha }), None];
            for eye in [Vec3::new(-3.0, 0.0, 3.0), Vec3::new(0.0, 4.0, 2.0), Vec3::new(0.0, -4.0, 2.0)] {
                let mean = |rays: usize| {
                    let all = mirrored(&stage, eye, &gloss, &exitance, |_| rays);
                    all.iter().map(|light| f64::from(light[0])).sum::<f64>()
                };
                let (few, many) = (mean(3), mean(3000));
                assert!((few / many - 1.0).abs() < 0.05, "{few} for {many} at {alpha} from {eye}");
            }
        }
    }

    #[test]
    fn a_narrow_lobe_mirrors_what_stands_opposite_the_eye_and_nothing_else() {
        let stage = corner();
        let elements = &stage.elements;
        let exitance: Vec<[f32; 3]> = (0..elements.len())
            .map(|e| if elements.mesh_of(e) == 1 { [5.0, 2.0, 1.0] } else { [0.0; 3] })
            .collect();
        let gloss = [Some(Lobe { weight: 0.1, alpha: 0.02 }), None];
        let opposite = mirrored(&stage, Vec3::new(-3.0, 0.0, 3.0), &gloss, &exitance, |_| FEW);
        let away = mirrored(&stage, Vec3::new(9.0, 0.0, 9.0), &gloss, &exitance, |_| FEW);
        let lying: Vec<usize> = (0..elements.len()).filter(|&e| elements.mesh_of(e) == 0).collect();
        let mean = lying.iter().map(|&e| opposite[e][0]).sum::<f32>() / lying.len() as f32;
        // GGX has a long tail: some of it misses the plate.
        assert!((mean - 4.9).abs() < 0.15, "{mean}");
        for &e in &lying {
            assert!((opposite[e][0] - 5.0).abs() < 0.5, "{:?}", opposite[e]);
        }
        let strayed = lying.iter().map(|&e| away[e][0]).sum::<f32>() / lying.len() as f32;
        assert!(strayed < 0.1, "{strayed}");
        assert!((0..elements.len()).filter(|&e| elements.mesh_of(e) == 1).all(|e| opposite[e] == [0.0; 3]));
    }
}
