//! What a pinhole sees first at each point of a grid, by scan conversion: every triangle is projected once and covers
//! the points inside its image. Where the points are many and the triangles small, this costs a fraction of a ray a
//! point. (Pineda, "A Parallel Algorithm for Polygon Rasterization", 1988, for the edge functions.)
//!
//! An edge's function is taken between its ends in one order whichever triangle asks, and a point on an edge belongs to
//! both, so no point falls between two neighbours. Of two triangles at the same depth the one with the lower index is
//! seen, so the order in which they come does not matter.

use super::RayKernel;
use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;

/// Nearest depth, metres; what reaches nearer is cut off there.
const NEAREST: f64 = 1e-4;

/// A grid of points in the image plane of a pinhole.
pub(super) struct Grid {
    /// Points per unit of x/z.
    pub(super) focal: f64,
    /// Position of the optical axis; the first point lies at (0.5, 0.5).
    pub(super) axis: DVec2,
    pub(super) width: usize,
    pub(super) height: usize,
}

/// By point, row-major: the first of the kernel's `count` triangles and its depth along the optical axis in metres.
pub(super) fn first_seen(
    kernel: &RayKernel,
    count: usize,
    camera_from_world: &DAffine3,
    grid: &Grid,
) -> Vec<Option<(u32, f32)>> {
    let parts = rayon::current_num_threads();
    let nearest = (0..parts)
        .into_par_iter()
        .map(|part| {
            let mut nearest = vec![0u64; grid.width * grid.height];
            for triangle in part * count / parts..(part + 1) * count / parts {
                let corners = kernel
                    .corners(triangle as u32)
                    .map(|corner| camera_from_world.transform_point3(corner.as_dvec3()));
                draw(triangle as u32, &corners, grid, &mut nearest);
            }
            nearest
        })
        .reduce_with(|mut a, b| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = b.max(*a));
            a
        });
    nearest.unwrap_or_default().into_iter().map(seen).collect()
}

/// Larger for what is nearer, then for the lower index; 0 for nothing.
fn mark(inverse: f32, triangle: u32) -> u64 {
    u64::from(inverse.to_bits()) << 32 | u64::from(!triangle)
}

fn seen(mark: u64) -> Option<(u32, f32)> {
    (mark != 0).then(|| (!(mark as u32), 1.0 / f32::from_bits((mark >> 32) as u32)))
}

fn draw(triangle: u32, corners: &[DVec3; 3], grid: &Grid, nearest: &mut [u64]) {
    let [a, b, c] = *corners;
    if !(a.is_finite() && b.is_finite() && c.is_finite()) || a.z.max(b.z).max(c.z) <= NEAREST {
        return;
    }
    let project = |p: DVec3| p.truncate() / p.z * grid.focal + grid.axis;
    if a.z.min(b.z).min(c.z) > NEAREST {
        cover(triangle, corners, [project(a), project(b), project(c)], grid, nearest);
        return;
    }
    let mut kept = vec![];
    for (p, q) in [(a, b), (b, c), (c, a)] {
        if p.z > NEAREST {
            kept.push(p);
        }
        if (p.z > NEAREST) != (q.z > NEAREST) {
            kept.push(p + (q - p) * ((NEAREST - p.z) / (q.z - p.z)));
        }
    }
    for i in 1..kept.len().saturating_sub(1) {
        cover(triangle, corners, [kept[0], kept[i], kept[i + 1]].map(project), grid, nearest);
    }
}

/// Enters the points inside `image`, at the depths of the plane through `corners`.
fn cover(triangle: u32, corners: &[DVec3; 3], image: [DVec2; 3], grid: &Grid, nearest: &mut [u64]) {
    let [p, q, r] = image;
    let (low, high) = (p.min(q).min(r) - 0.5, p.max(q).max(r) - 0.5);
    let first = low.ceil().max(DVec2::ZERO);
    let end = (high.floor() + 1.0).min(DVec2::new(grid.width as f64, grid.height as f64));
    if first.x >= end.x || first.y >= end.y {
        return;
    }
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let distance = normal.dot(corners[0]);
    if distance == 0.0 {
        // Seen edge-on, or no triangle.
        return;
    }
    // Inverse depth is linear over the image.
    let slope = normal / (distance * grid.focal);
    // A sliver seen nearly edge-on has no slope to speak of: it lies where its corners lie.
    let (near, far) = corners.iter().fold((f64::INFINITY, 0.0f64), |(a, b), c| (a.min(c.z), b.max(c.z)));
    let (least, most) = (1.0 / far, 1.0 / near.max(NEAREST));
    let (columns, rows) = (first.x as usize..end.x as usize, first.y as usize..end.y as usize);
    for y in rows {
        for x in columns.clone() {
            let at = DVec2::new(x as f64, y as f64) + 0.5;
            let [u, v, w] = [edge(p, q, at), edge(q, r, at), edge(r, p, at)];
            if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
                continue;
            }
            let off = at - grid.axis;
            let inverse = slope.x * off.x + slope.y * off.y + slope.z * grid.focal;
            let inverse = inverse.max(least).min(most) as f32;
            if inverse > 0.0 {
                let point = &mut nearest[y * grid.width + x];
                *point = mark(inverse, triangle).max(*point);
            }
        }
    }
}

/// Twice the area of the triangle (p, q, at), by its sign the side of the edge; exactly opposite for (q, p).
fn edge(p: DVec2, q: DVec2, at: DVec2) -> f64 {
    if (p.x, p.y) < (q.x, q.y) { (q - p).perp_dot(at - p) } else { -(p - q).perp_dot(at - q) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn grid() -> Grid {
        Grid { focal: 90.0, axis: DVec2::new(40.3, 29.1), width: 80, height: 60 }
    }

    /// Triangles all round the camera, some through its plane.
    fn soup(count: u32) -> Vec<[Vec3; 3]> {
        let number = |k: u32| (f64::from(k) * 0.754_877_666_246_693).fract() as f32 - 0.5;
        let place = |k: u32| Vec3::new(number(k), number(k + 7919), number(k + 104_729));
        (0..count)
            .map(|i| {
                let centre = place(9 * i) * 3.0 + Vec3::Z;
                [1, 2, 3].map(|c| centre + place(9 * i + c) * if i % 5 == 0 { 4.0 } else { 0.5 })
            })
            .collect()
    }

    #[test]
    fn scan_conversion_sees_what_rays_meet() {
        let (grid, triangles) = (grid(), soup(400));
        let kernel = RayKernel::build(triangles.clone());
        let seen = first_seen(&kernel, triangles.len(), &DAffine3::IDENTITY, &grid);
        let (mut met, mut other) = (0, 0);
        for (i, seen) in seen.iter().enumerate() {
            let at = DVec2::new((i % grid.width) as f64, (i / grid.width) as f64) + 0.5;
            let ray = ((at - grid.axis) / grid.focal).extend(1.0).as_vec3();
            let hit = kernel.nearest(Vec3::ZERO, ray, NEAREST as f32, f32::INFINITY);
            met += i32::from(hit.is_some());
            let same = match (hit, seen) {
                (Some(hit), Some((triangle, depth))) => {
                    hit.triangle == *triangle && (hit.t / depth - 1.0).abs() < 1e-4
                }
                (None, None) => true,
                _ => false,
            };
            other += i32::from(!same);
        }
        assert!(met > 2000 && other <= 3, "{other} of {met} differ");
    }

    #[test]
    fn no_point_falls_between_neighbours() {
        // A fan whose edges run through points of the grid.
        let (grid, hub) = (Grid { axis: DVec2::new(40.5, 30.5), ..grid() }, Vec3::Z);
        let spoke = |k: u32| {
            let angle = std::f32::consts::TAU * k as f32 / 16.0;
            Vec3::new(angle.cos(), angle.sin(), 1.0) * Vec3::new(3.0, 3.0, 1.0)
        };
        let fan: Vec<_> = (0..16).map(|k| [hub, spoke(k), spoke((k + 1) % 16)]).collect();
        let kernel = RayKernel::build(fan);
        let seen = first_seen(&kernel, 16, &DAffine3::IDENTITY, &grid);
        assert!(seen.iter().all(|s| s.is_some_and(|(_, depth)| (depth - 1.0).abs() < 1e-6)));
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let kernel = RayKernel::build(soup(300));
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| first_seen(&kernel, 300, &DAffine3::IDENTITY, &grid()))
        };
        assert_eq!(on(1), on(3));
    }
}
