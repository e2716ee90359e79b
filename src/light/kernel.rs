//! The ray kernel: a set of triangles, the nearest one along a ray, and whether anything is in the way.
//!
//! The hierarchy is obvhs's compressed wide tree; the triangle test is the watertight one of Woop, Benthin
//! and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013, because a ray that slips through an
//! edge is light that was never there.

use glam::{Vec3, Vec3A, Vec3Swizzles};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use std::time::Duration;

/// Where a ray met a triangle: point = (1 - u - v) * v0 + u * v1 + v * v2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle in the order given to [`RayKernel::build`].
    pub triangle: u32,
    /// Distance in lengths of the ray's direction.
    pub t: f32,
    /// Barycentric weight of the second corner.
    pub u: f32,
    /// Barycentric weight of the third corner.
    pub v: f32,
}

/// Triangles in a bounding volume hierarchy. Both sides of a triangle stop a ray.
pub struct RayKernel {
    corners: Vec<[Vec3; 3]>,
    tree: Option<CwBvh>,
}

impl RayKernel {
    /// Builds the hierarchy over triangles given by their corners in metres, world frame.
    /// Triangles with a corner that is not finite are never hit.
    pub fn build(triangles: Vec<[Vec3; 3]>) -> Self {
        let primitives: Vec<Triangle> = triangles
            .iter()
            .map(|t| {
                let t = if t.iter().all(|c| c.is_finite()) { *t } else { [Vec3::ZERO; 3] };
                Triangle { v0: t[0].into(), v1: t[1].into(), v2: t[2].into() }
            })
            .collect();
        let tree = (!primitives.is_empty()).then(|| {
            build_cwbvh_from_tris(&primitives, BvhBuildParams::slow_build(), &mut Duration::default())
        });
        Self { corners: triangles, tree }
    }

    /// Corners of the triangle with this index.
    pub fn corners(&self, triangle: u32) -> &[Vec3; 3] {
        &self.corners[triangle as usize]
    }

    /// The nearest triangle with `t_min < t < t_max`, `t` in lengths of `direction`.
    pub fn nearest(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Option<Hit> {
        let tree = self.tree.as_ref()?;
        let shear = Shear::new(direction)?;
        let ray = Ray::new(origin.into(), direction.into(), t_min, t_max);
        let mut found = RayHit::none();
        let mut best = None::<Hit>;
        tree.ray_traverse(ray, &mut found, |ray, slot| {
            let triangle = tree.primitive_indices[slot];
            match shear.intersect(ray.origin, &self.corners[triangle as usize]) {
                Some((t, u, v)) if t > t_min && t < ray.tmax => {
                    best = Some(Hit { triangle, t, u, v });
                    t
                }
                _ => f32::INFINITY,
            }
        });
        best
    }

    /// Whether any triangle lies at `t_min < t < t_max`.
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        let (Some(tree), Some(shear)) = (self.tree.as_ref(), Shear::new(direction)) else { return false };
        let ray = Ray::new(origin.into(), direction.into(), t_min, t_max);
        !tree.ray_traverse_miss(ray, |ray, slot| {
            match shear.intersect(ray.origin, &self.corners[tree.primitive_indices[slot] as usize]) {
                Some((t, _, _)) if t > t_min && t < t_max => t,
                _ => f32::INFINITY,
            }
        })
    }
}

/// The ray's own coordinates: its dominant axis last, sheared so that the ray runs along it.
struct Shear {
    dominant: usize,
    shear: [f32; 3],
}

impl Shear {
    fn new(direction: Vec3) -> Option<Self> {
        if !direction.is_finite() || direction == Vec3::ZERO {
            return None;
        }
        let dominant = direction.abs().max_position();
        let d = turned(direction, dominant);
        Some(Self { dominant, shear: [d.x / d.z, d.y / d.z, 1.0 / d.z] })
    }

    fn intersect(&self, origin: Vec3A, triangle: &[Vec3; 3]) -> Option<(f32, f32, f32)> {
        let [sx, sy, sz] = self.shear;
        let origin = Vec3::from(origin);
        let [a, b, c] = triangle.map(|corner| turned(corner - origin, self.dominant));
        let (ka, kb, kc) = (a.z, b.z, c.z);
        let flat = |p: Vec3| (p.x - sx * p.z, p.y - sy * p.z);
        let ((x0, y0), (x1, y1), (x2, y2)) = (flat(a), flat(b), flat(c));
        let mut u = x2 * y1 - y2 * x1;
        let mut v = x0 * y2 - y0 * x2;
        let mut w = x1 * y0 - y1 * x0;
        if u == 0.0 || v == 0.0 || w == 0.0 {
            // On an edge: the sign decides between two neighbours, so it is taken exactly.
            let cross = |p: f32, q: f32, r: f32, s: f32| {
                (f64::from(p) * f64::from(q) - f64::from(r) * f64::from(s)) as f32
            };
            u = cross(x2, y1, y2, x1);
            v = cross(x0, y2, y0, x2);
            w = cross(x1, y0, y1, x0);
        }
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let t = (u * ka + v * kb + w * kc) * sz / determinant;
        Some((t, v / determinant, w / determinant))
    }
}

/// The axes in cyclic order with `last` last. A ray towards its negative end sees triangles mirrored, which is one
/// to a test that takes both sides.
fn turned(p: Vec3, last: usize) -> Vec3 {
    match last {
        0 => p.yzx(),
        1 => p.zxy(),
        _ => p,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> RayKernel {
        let (a, b, c, d) = (
            Vec3::new(-1.0, -1.0, 2.0),
            Vec3::new(1.0, -1.0, 2.0),
            Vec3::new(1.0, 1.0, 2.0),
            Vec3::new(-1.0, 1.0, 2.0),
        );
        RayKernel::build(vec![[a, b, c], [a, c, d]])
    }

    #[test]
    fn barycentric_weights_give_back_the_point() {
        let kernel = quad();
        let target = Vec3::new(0.31, -0.47, 2.0);
        let hit = kernel.nearest(Vec3::ZERO, target, 0.0, f32::INFINITY).unwrap();
        let [a, b, c] = *kernel.corners(hit.triangle);
        let point = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        assert!((point - target).length() < 1e-5, "{point}");
        assert!((hit.t - 1.0).abs() < 1e-6);
    }

    #[test]
    fn no_ray_slips_through_the_shared_edge() {
        let kernel = quad();
        for i in 0..1000 {
            let s = -0.999 + 1.998 * i as f32 / 999.0;
            let direction = Vec3::new(s, s, 2.0) - Vec3::new(0.2, -0.3, -0.7);
            assert!(kernel.occluded(Vec3::new(0.2, -0.3, -0.7), direction, 0.0, 2.0), "leak at {s}");
        }
    }

    #[test]
    fn range_limits_what_is_hit() {
        let kernel = quad();
        let forward = Vec3::new(0.1, 0.0, 1.0);
        assert!(kernel.nearest(Vec3::ZERO, forward, 0.0, 1.9).is_none());
        assert!(!kernel.occluded(Vec3::ZERO, forward, 2.1, 9.0));
        assert!(kernel.occluded(Vec3::ZERO, forward, 0.0, 2.1));
        assert!(!kernel.occluded(Vec3::ZERO, Vec3::NAN, 0.0, 9.0));
    }
}
