//! The shape of the photographed object: a lobed bowl with three eggs in it, on a square carved plinth.
//!
//! A bowl, because light that bounces about inside it is what a solver must get right; eggs, because they cast
//! shadows in there; a carved plinth, for edges and shallow relief. Metres, z up, standing on z = 0 at the origin.

use super::glaze;
use super::patch::Patch;
use glam::{DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

/// Columns of facets in a quarter of the bowl; the bowl's inside has as many along each side of its square.
const QUARTER: usize = 48;
const PLINTH_HEIGHT: f64 = 0.09;
const BOWL_FLOOR: f64 = 0.150;
const RIM_HEIGHT: f64 = 0.285;
const WALL: f64 = 0.012;

/// The whole object as patches.
pub(super) fn patches() -> Vec<Patch> {
    let mut patches = plinth();
    patches.extend(bowl());
    patches.extend(eggs());
    patches
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn ease(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn turned(p: DVec3, angle: f64) -> DVec3 {
    let (sin, cos) = angle.sin_cos();
    DVec3::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos, p.z)
}

/// Half the plinth's width at a height between 0 (floor) and 1 (top).
fn plinth_half_width(t: f64) -> f64 {
    0.096 - 0.012 * t
}

fn plinth() -> Vec<Patch> {
    let cells = 28;
    let mut patches: Vec<Patch> = (0..4)
        .map(|side| Patch {
            cells: (cells, 16),
            size: (0.18, PLINTH_HEIGHT),
            surface: Box::new(move |st: DVec2| {
                let half = plinth_half_width(st.y);
                let panel = ease(0.10, 0.17, st.x)
                    * ease(0.90, 0.83, st.x)
                    * ease(0.16, 0.28, st.y)
                    * ease(0.86, 0.74, st.y);
                let carving = 0.5 + 0.5 * (TAU * 3.0 * st.x).cos() * (TAU * 1.5 * st.y).cos();
                let depth = panel * (0.009 - 0.007 * carving);
                let p = DVec3::new(half - depth, (2.0 * st.x - 1.0) * half, st.y * PLINTH_HEIGHT);
                turned(p, f64::from(side) * FRAC_PI_2)
            }),
            glaze: glaze::stone,
        })
        .collect();
    patches.push(Patch {
        cells: (cells, cells),
        size: (2.0 * plinth_half_width(1.0), 2.0 * plinth_half_width(1.0)),
        surface: Box::new(|st: DVec2| {
            let p = (2.0 * st - 1.0) * plinth_half_width(1.0);
            DVec3::new(p.x, p.y, PLINTH_HEIGHT)
        }),
        glaze: glaze::stone,
    });
    patches
}

/// Radius and height of the bowl's outside, from foot (0) to rim (1): a Catmull-Rom curve.
fn profile(t: f64) -> DVec2 {
    const POINTS: [[f64; 2]; 8] = [
        [0.076, 0.068],
        [0.058, PLINTH_HEIGHT],
        [0.043, 0.112],
        [0.066, 0.134],
        [0.122, 0.162],
        [0.149, 0.220],
        [0.165, RIM_HEIGHT],
        [0.181, 0.350],
    ];
    let x = t * 5.0;
    let segment = (x.floor().clamp(0.0, 4.0)) as usize;
    let u = x - segment as f64;
    let p = |k: usize| DVec2::from(POINTS[segment + k]);
    0.5 * (2.0 * p(1)
        + (p(2) - p(0)) * u
        + (2.0 * p(0) - 5.0 * p(1) + 4.0 * p(2) - p(3)) * u * u
        + (3.0 * p(1) - p(0) - 3.0 * p(2) + p(3)) * u * u * u)
}

/// Outer radius in metres and height at an angle and a place on the profile, lobes and beads included.
fn outside(angle: f64, t: f64) -> DVec3 {
    let p = profile(t);
    let lobes = 0.045 * ease(0.40, 0.95, t) * (9.0 * angle).cos();
    let band = ease(0.62, 0.70, t) * ease(0.92, 0.84, t);
    let beads = 0.0035 * band * (16.0 * angle + 10.0 * t).cos();
    let radius = p.x * (1.0 + lobes) + beads;
    DVec3::new(radius * angle.cos(), radius * angle.sin(), p.y)
}

/// A point of the bowl's inside at an angle, `reach` of the way from the middle (0) to the rim (1).
fn inside(angle: f64, reach: f64) -> DVec3 {
    let lobes = 0.045 * reach * reach * (9.0 * angle).cos();
    let radius = reach * (0.165 * (1.0 + lobes) - WALL);
    let height = BOWL_FLOOR + (RIM_HEIGHT - BOWL_FLOOR) * reach.powf(2.4);
    DVec3::new(radius * angle.cos(), radius * angle.sin(), height)
}

fn bowl() -> Vec<Patch> {
    let mut patches = Vec::new();
    for quarter in 0..4 {
        let angle = move |s: f64| (f64::from(quarter) + s) * FRAC_PI_2 - FRAC_PI_4;
        for (from, to, rows, size) in
            [(0.0, 0.3, 10, (0.085, 0.055)), (0.3, 0.65, 12, (0.170, 0.080)), (0.65, 1.0, 22, (0.250, 0.115))]
        {
            patches.push(Patch {
                cells: (QUARTER, rows),
                size,
                surface: Box::new(move |st: DVec2| outside(angle(st.x), from + (to - from) * st.y)),
                glaze: glaze::ware,
            });
        }
        patches.push(Patch {
            cells: (QUARTER, 4),
            size: (0.250, 0.018),
            surface: Box::new(move |st: DVec2| {
                let (outer, inner) = (outside(angle(st.x), 1.0), inside(angle(st.x), 1.0));
                let p = outer + (inner - outer) * st.y;
                p + DVec3::Z * (0.024 * st.y * (1.0 - st.y))
            }),
            glaze: glaze::rim,
        });
    }
    patches.push(Patch {
        cells: (QUARTER, QUARTER),
        size: (0.36, 0.36),
        surface: Box::new(|st: DVec2| {
            let (angle, reach) = disc(2.0 * st - 1.0);
            inside(angle, reach)
        }),
        glaze: glaze::well,
    });
    patches
}

/// Angle and radius of a point of the square from -1 to 1 in the concentric map of Shirley and Chiu,
/// "A Low Distortion Map Between Disk and Square", 1997.
fn disc(p: DVec2) -> (f64, f64) {
    if p == DVec2::ZERO {
        return (0.0, 0.0);
    }
    let (angle, signed) = if p.x.abs() > p.y.abs() {
        (FRAC_PI_4 * p.y / p.x, p.x)
    } else {
        (FRAC_PI_2 - FRAC_PI_4 * p.x / p.y, p.y)
    };
    (if signed < 0.0 { angle + PI } else { angle }, signed.abs())
}

fn eggs() -> Vec<Patch> {
    let mut patches = Vec::new();
    let glazes = [glaze::egg_red, glaze::egg_pale, glaze::egg_dark];
    for (egg, glaze) in glazes.into_iter().enumerate() {
        let angle = TAU * (egg as f64 / 3.0 + 0.05);
        let centre = turned(DVec3::new(0.044, 0.0, 0.1895), angle);
        for (normal, along) in [
            (DVec3::X, DVec3::Y),
            (DVec3::NEG_X, DVec3::Z),
            (DVec3::Y, DVec3::Z),
            (DVec3::NEG_Y, DVec3::X),
            (DVec3::Z, DVec3::X),
            (DVec3::NEG_Z, DVec3::Y),
        ] {
            let across = normal.cross(along);
            patches.push(Patch {
                cells: (10, 10),
                size: (0.046, 0.046),
                surface: Box::new(move |st: DVec2| {
                    // Equal angles rather than equal lengths on the cube's face even the chart out.
                    let q = (2.0 * st - 1.0) * FRAC_PI_4;
                    let unit = (normal + along * q.x.tan() + across * q.y.tan()).normalize();
                    let blunt = 0.028 * (1.0 - 0.10 * unit.z);
                    centre + turned(unit * DVec3::new(blunt, 0.034, blunt), angle + 0.5)
                }),
                glaze,
            });
        }
    }
    patches
}

#[cfg(test)]
mod tests {
    use super::super::patch::assemble;
    use super::*;
    use glam::Vec3;
    use std::collections::HashMap;

    #[test]
    fn every_edge_is_shared_by_two_facets_but_for_the_ones_that_stand_on_something() {
        let (mesh, _) = assemble("object", &patches(), 512);
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for t in &mesh.triangles {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        for ((a, b), balance) in edges {
            let height = |i: u32| f64::from(mesh.positions[i as usize].z);
            let stands = |h: f64| h.abs() < 1e-6 || (h - PLINTH_HEIGHT).abs() < 1e-6;
            assert!(
                balance == 0 || (stands(height(a)) && stands(height(b))),
                "open edge at {} {}",
                mesh.positions[a as usize],
                mesh.positions[b as usize]
            );
        }
        assert!((20_000..=40_000).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
    }

    #[test]
    fn facets_face_outwards() {
        let (mesh, _) = assemble("object", &patches(), 512);
        for triangle in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(triangle);
            let (normal, middle) = ((b - a).cross(c - a), (a + b + c) / 3.0);
            assert!(normal.length() > 0.0, "degenerate facet at {middle}");
            if middle.z < 0.0899 {
                let side =
                    if middle.x.abs() > middle.y.abs() { Vec3::X * middle.x } else { Vec3::Y * middle.y };
                assert!(normal.dot(side) > 0.0, "plinth facet inside out at {middle}");
            }
        }
    }
}
