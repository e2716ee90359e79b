//! The ray kernel: a set of triangles, the nearest one along a ray, and whether anything is in the way.

use super::tree::Tree;
use glam::Vec3;

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
    tree: Option<Tree>,
}

impl RayKernel {
    /// Builds the hierarchy over triangles given by their corners in metres, world frame.
    /// Triangles with a corner that is not finite are never hit.
    pub fn build(triangles: Vec<[Vec3; 3]>) -> Self {
        Self { tree: Tree::build(&triangles), corners: triangles }
    }

    /// Corners of the triangle with this index.
    pub fn corners(&self, triangle: u32) -> &[Vec3; 3] {
        &self.corners[triangle as usize]
    }

    /// The nearest triangle with `t_min < t < t_max`, `t` in lengths of `direction`.
    pub fn nearest(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Option<Hit> {
        self.tree.as_ref()?.nearest(origin, direction, t_min, t_max)
    }

    /// Whether any triangle lies at `t_min < t < t_max`.
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        self.tree.as_ref().is_some_and(|tree| tree.occluded(origin, direction, t_min, t_max))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3Swizzles as _;

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
    fn rays_along_the_axes_hit_whatever_the_sign_of_their_zeros() {
        // A hundred small plates round the origin, before and behind.
        let plate = |i: usize| {
            let z = if i.is_multiple_of(2) { 2.0 } else { -2.0 } + i as f32 * 0.01;
            [[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, z))
        };
        let kernel = RayKernel::build((0..100).map(plate).collect());
        for turn in [Vec3::X, Vec3::Y, Vec3::Z] {
            // The same soup with the axis that the plates face turned to each of the three.
            let axis = |p: Vec3| {
                if turn == Vec3::X {
                    p.zxy()
                } else if turn == Vec3::Y {
                    p.yzx()
                } else {
                    p
                }
            };
            let turned: Vec<[Vec3; 3]> = (0..100).map(|i| kernel.corners(i).map(axis)).collect();
            let turned = RayKernel::build(turned);
            for zero in [0.0f32, -0.0] {
                for sign in [1.0f32, -1.0] {
                    let way = axis(Vec3::new(zero, zero, sign));
                    let hit = turned.nearest(Vec3::ZERO, way, 0.0, f32::INFINITY);
                    assert!(hit.is_some_and(|h| h.t > 1.0 && h.t < 2.1), "{way}: {hit:?}");
                    assert!(turned.occluded(Vec3::ZERO, way, 0.0, f32::INFINITY), "{way}");
                }
            }
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

    #[test]
    fn the_tree_finds_what_a_look_at_every_triangle_finds() {
        let number = |k: u32| (f64::from(k) * 0.754_877_666_246_693).fract() as f32 - 0.5;
        let place = |k: u32| Vec3::new(number(k), number(k + 7919), number(k + 104_729));
        let triangle = |i: u32| [1, 2, 3].map(|c| place(9 * i) * 2.0 + place(9 * i + c) * 0.4);
        let soup: Vec<_> = (0..500).map(triangle).collect();
        let kernel = RayKernel::build(soup.clone());
        let each: Vec<_> = soup.iter().map(|t| RayKernel::build(vec![*t])).collect();
        let mut met = 0;
        for k in 0..400u32 {
            let (origin, way) = (place(31 * k + 5), place(17 * k + 2));
            let alone = each.iter().filter_map(|kernel| kernel.nearest(origin, way, 0.1, 3.0));
            let want = alone.map(|hit| hit.t).min_by(f32::total_cmp);
            let found = kernel.nearest(origin, way, 0.1, 3.0);
            assert_eq!(found.map(|hit| hit.t), want);
            let owner = found.and_then(|hit| each[hit.triangle as usize].nearest(origin, way, 0.1, 3.0));
            assert_eq!(owner.map(|hit| [hit.t, hit.u, hit.v]), found.map(|hit| [hit.t, hit.u, hit.v]));
            assert_eq!(kernel.occluded(origin, way, 0.1, 3.0), want.is_some());
            met += i32::from(want.is_some());
        }
        assert!(met > 100, "{met}");
    }

    #[test]
    fn triangles_that_are_not_finite_are_never_hit_and_the_others_keep_their_numbers() {
        let [a, b, c] = *quad().corners(0);
        let kernel = RayKernel::build(vec![[Vec3::NAN, b, c], [a, b, c]]);
        assert_eq!(kernel.nearest(Vec3::ZERO, (a + b + c) / 3.0, 0.0, 9.0).unwrap().triangle, 1);
        assert!(
            RayKernel::build(vec![[Vec3::INFINITY, b, c]]).nearest(Vec3::ZERO, Vec3::Z, 0.0, 9.0).is_none()
        );
        assert!(!RayKernel::build(vec![]).occluded(Vec3::ZERO, Vec3::Z, 0.0, 9.0));
    }

    #[test]
    fn a_thousand_triangles_in_one_place_are_no_trouble() {
        let [a, b, c] = *quad().corners(0);
        let kernel = RayKernel::build(vec![[a, b, c]; 1000]);
        let centre = (a + b + c) / 3.0;
        assert!(kernel.occluded(Vec3::ZERO, centre, 0.0, 2.0));
        assert!((kernel.nearest(Vec3::ZERO, centre, 0.0, 2.0).unwrap().t - 1.0).abs() < 1e-6);
    }
}
