//! Where a camera with a lamp round its lens looks freely, found once a view from its depth map.
//!
//! A surface point x at depth z, seen at image position p (focal length f), is shadowed from a lamp point y in
//! the lens plane, |y| <= R, by an occluder o on the way from x to y. Both lie on one line, so o appears at depth
//! z_o displaced by `f |y| (1/z_o - 1/z)` from p. Hence nothing can stand between x and the whole disc of
//! radius R round the lens, the lens itself included, unless some image position q has
//! `1/z(q) - |p - q| / (f R) > 1/z`: a grey-scale dilation of inverse depth by a cone, done in two chamfer passes.
//! What hides o from the lens is nearer still and dilates farther. The map is as coarse as its points, so the
//! surface's own slope over a neighbourhood of them is allowed for; beyond that the test errs on the safe side, and
//! a point that fails it is asked by rays.
//!
//! The same depth map tells where one surface ends before another.

use super::RayKernel;
use super::depth::{Grid, first_seen};
use crate::raster::Image;
use crate::scene::{Camera, Distortion};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

/// Depth maps have about this many points at the most.
const MOST_POINTS: usize = 1_500_000;

/// Pixels round an occlusion edge in which lens blur and demosaicing mix two surfaces.
const EDGE_RADIUS: usize = 2;

/// A step between neighbouring pixels of more than this many pixel footprints is an occlusion edge.
const EDGE_STEP: f64 = 4.0;

/// Most that is allowed for the surface's own slope, in points of the map times the cone's fall: a steeper surface
/// may shadow itself.
const STEEPEST: f32 = 1.5;

/// Points over which the surface's own slope enters the dilated map: the 3x3 neighbourhood's corner, and half a
/// point from the look-up.
const NEIGHBOURHOOD: f64 = 2.2;

/// Rounding of inverse depth, relative.
const ROUNDING: f64 = 1e-4;

/// Chamfer weights, a little short of 1 and the root of 2, so that distances are not overestimated.
const STRAIGHT: f32 = 0.95;
const DIAGONAL: f32 = 1.36;

/// A view's free sight, in its camera's frame.
pub struct Sight {
    /// Points of the map per unit of x/z.
    focal: f64,
    /// Map position of the optical axis.
    axis: DVec2,
    /// Inverse depth dilated by the cone, 1/m.
    dilated: Image<f32>,
    edge: Image<bool>,
    steepest: f64,
    /// What each point of the map met: triangle and depth in metres.
    met: Image<Option<(u32, f32)>>,
    /// Map point of the camera's first pixel, where the map's points are the camera's pixels.
    first_pixel: Option<(usize, usize)>,
}

impl Sight {
    /// Looks through `camera` at the kernel's triangles, whose normals are `normals`; the lamp's outer radius is
    /// `reach`, metres.
    pub fn look(kernel: &RayKernel, normals: &[Vec3], camera: &Camera, reach: f64) -> Self {
        let (map, first_pixel) = map_of(camera, reach);
        let local = |i: usize| {
            let at = DVec2::new((i % map.width) as f64, (i / map.width) as f64) + 0.5;
            ((at - map.axis) / map.focal).extend(1.0)
        };
        let met = first_seen(kernel, normals.len(), &camera.world_from_camera.inverse(), &map);
        let inverse = Image::from_fn(map.width, map.height, |x, y| {
            met[y * map.width + x].map_or(0.0, |(_, depth)| 1.0 / depth)
        });
        let fall = (1.0 / (map.focal * reach)) as f32;
        let to_camera = camera.world_from_camera.matrix3.transpose();
        let hits: Vec<Option<(DVec3, DVec3)>> = met
            .par_iter()
            .enumerate()
            .map(|(i, hit)| {
                let (triangle, depth) = (*hit)?;
                let normal = normals[triangle as usize].as_dvec3();
                Some((local(i) * f64::from(depth), to_camera * normal))
            })
            .collect();
        Self {
            focal: map.focal,
            axis: map.axis,
            dilated: dilate(inverse, fall),
            edge: edges(&hits, &map),
            steepest: f64::from(STEEPEST * fall),
            met: Image::from_fn(map.width, map.height, |x, y| met[y * map.width + x]),
            first_pixel,
        }
    }

    /// What the ray through the centre of pixel (x, y) meets first: triangle and depth along the optical axis in
    /// metres. The outer `None`: not known here, trace it.
    pub fn met(&self, x: usize, y: usize) -> Option<Option<(u32, f32)>> {
        let (left, top) = self.first_pixel?;
        self.met.get((x + left) as isize, (y + top) as isize).copied()
    }

    /// Whether a triangle that fulfils `test` is seen towards a direction (camera frame, z > 0), or beside it if the
    /// map's points lie farther apart than `spacing` (units of x/z).
    pub fn shows(&self, direction: DVec3, spacing: f64, test: impl Fn(u32) -> bool) -> bool {
        let reach = if self.focal * spacing >= 1.0 { 0 } else { 1 };
        let p = direction.truncate() / direction.z * self.focal + self.axis;
        let (x, y) = (p.x.floor() as isize, p.y.floor() as isize);
        let mut round = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (x + dx, y + dy)));
        round.any(|(u, v)| matches!(self.met.get(u, v), Some(Some((triangle, _))) if test(*triangle)))
    }

    /// Whether nothing stands between a surface point with unit normal (camera frame, metres) and the lamp's
    /// disc. False means: ask.
    pub fn is_free(&self, local: DVec3, facing: DVec3) -> bool {
        // Inverse depth of a plane is linear over the image; this is its change a point of the map.
        let slope = facing.truncate().length() / (facing.dot(local).abs() * self.focal);
        let allowed = (NEIGHBOURHOOD * slope).min(self.steepest) + ROUNDING / local.z;
        self.at(&self.dilated, local).is_some_and(|d| f64::from(*d) <= 1.0 / local.z + allowed)
    }

    /// Whether a point (camera frame, metres) is seen beside an occlusion edge, or outside the map.
    pub fn beside_edge(&self, local: DVec3) -> bool {
        *self.at(&self.edge, local).unwrap_or(&true)
    }

    fn at<'a, P>(&self, map: &'a Image<P>, local: DVec3) -> Option<&'a P> {
        if local.z <= 0.0 {
            return None;
        }
        let p = local.truncate() / local.z * self.focal + self.axis;
        map.get(p.x.floor() as isize, p.y.floor() as isize)
    }
}

/// An undistorted pinhole image that covers the camera's frame and what may shadow it from outside; and the map point
/// of the camera's first pixel, where the points are its pixels.
fn map_of(camera: &Camera, reach: f64) -> (Grid, Option<(usize, usize)>) {
    let lens = &camera.intrinsics;
    let (w, h) = (lens.width as f64, lens.height as f64);
    let (mut low, mut high) = (DVec2::MAX, DVec2::MIN);
    for k in 0..=8 {
        let t = f64::from(k) / 8.0;
        for pixel in
            [DVec2::new(t * w, 0.0), DVec2::new(t * w, h), DVec2::new(0.0, t * h), DVec2::new(w, t * h)]
        {
            let p = lens.distortion.undistort((pixel - lens.principal) / lens.focal);
            (low, high) = (low.min(p), high.max(p));
        }
    }
    // Parallax of an occluder that halves the way to a point one metre off.
    (low, high) = (low - reach, high + reach);
    let size = high - low;
    let most = (MOST_POINTS as f64 / (size.x * size.y)).sqrt();
    let focal = lens.focal.min_element().min(most);
    let pinhole = lens.distortion == Distortion::default() && lens.focal == DVec2::splat(focal);
    // A pinhole's own pixels, so that their rays serve twice.
    let margin = (-low * focal - lens.principal).ceil();
    let axis = if pinhole { lens.principal + margin } else { -low * focal };
    let extent = (axis + high * focal).ceil().max(DVec2::ONE);
    let first_pixel = pinhole.then_some((margin.x as usize, margin.y as usize));
    (Grid { focal, axis, width: extent.x as usize, height: extent.y as usize }, first_pixel)
}

/// Largest of each point's 3x3 neighbourhood, then dilated by a cone that falls by `fall` a point.
fn dilate(inverse: Image<f32>, fall: f32) -> Image<f32> {
    let (width, height) = (inverse.width() as isize, inverse.height() as isize);
    let mut out = Image::from_fn(inverse.width(), inverse.height(), |x, y| {
        let mut most = 0.0f32;
        for dy in -1..=1 {
            for dx in -1..=1 {
                most = most.max(*inverse.get(x as isize + dx, y as isize + dy).unwrap_or(&0.0));
            }
        }
        most
    });
    let before = [(-1, 0, STRAIGHT), (-1, -1, DIAGONAL), (0, -1, STRAIGHT), (1, -1, DIAGONAL)];
    let mut relax = |x: isize, y: isize, sign: isize| {
        let mut most = *out.at(x as usize, y as usize);
        for (dx, dy, weight) in before {
            if let Some(near) = out.get(x + sign * dx, y + sign * dy) {
                most = most.max(near - weight * fall);
            }
        }
        *out.at_mut(x as usize, y as usize) = most;
    };
    for y in 0..height {
        (0..width).for_each(|x| relax(x, y, 1));
    }
    for y in (0..height).rev() {
        (0..width).rev().for_each(|x| relax(x, y, -1));
    }
    out
}

/// Points within [`EDGE_RADIUS`] of a step between two surfaces.
fn edges(hits: &[Option<(DVec3, DVec3)>], map: &Grid) -> Image<bool> {
    let step = |a: usize, b: usize| match (hits[a], hits[b]) {
        (Some((p, n)), Some((q, m))) => {
            let allowed = EDGE_STEP * p.length() / map.focal;
            (q - p).dot(n).abs() > allowed && (q - p).dot(m).abs() > allowed
        }
        (None, None) => false,
        _ => true,
    };
    let mut near = Image::filled(map.width, map.height, false);
    for y in 0..map.height {
        for x in 0..map.width {
            let i = y * map.width + x;
            if (x + 1 < map.width && step(i, i + 1)) || (y + 1 < map.height && step(i, i + map.width)) {
                for v in y.saturating_sub(EDGE_RADIUS)..(y + EDGE_RADIUS + 2).min(map.height) {
                    for u in x.saturating_sub(EDGE_RADIUS)..(x + EDGE_RADIUS + 2).min(map.width) {
                        *near.at_mut(u, v) = true;
                    }
                }
            }
        }
    }
    near
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{Occluders, Ring};
    use crate::scene::Intrinsics;
    use glam::DAffine3;

    fn camera() -> Camera {
        Camera {
            name: "1".into(),
            intrinsics: Intrinsics {
                width: 200,
                height: 150,
                focal: DVec2::splat(250.0),
                principal: DVec2::new(100.0, 75.0),
                distortion: Distortion::default(),
            },
            world_from_camera: DAffine3::IDENTITY,
        }
    }

    /// A wall at 1 m with a small plate before it at 0.7 m.
    fn plate_before_wall() -> RayKernel {
        let quad = |s: f32, z: f32| {
            let p = [[-s, -s], [s, -s], [s, s], [-s, s]].map(|[x, y]| Vec3::new(x, y, z));
            [[p[0], p[1], p[2]], [p[0], p[2], p[3]]]
        };
        RayKernel::build([quad(2.0, 1.0), quad(0.05, 0.7)].concat())
    }

    #[test]
    fn a_point_called_free_is_lit_by_the_whole_ring_and_most_lit_points_are_called_free() {
        let (kernel, camera) = (plate_before_wall(), camera());
        let ring = Ring::new(0.035, 0.085).unwrap();
        let sight = Sight::look(&kernel, &[-Vec3::Z; 4], &camera, ring.outer);
        let occluders = Occluders { kernel: &kernel, world_from_camera: &DAffine3::IDENTITY, offset: 1e-4 };
        let (mut free, mut lit) = (0, 0);
        for i in 0..80 {
            for j in 0..60 {
                let point = DVec3::new(i as f64 / 100.0 - 0.4, j as f64 / 100.0 - 0.3, 1.0);
                let clear = ring.irradiance(point, -DVec3::Z);
                let got = ring.shadowed_irradiance(&occluders, point, -DVec3::Z);
                let is_lit = got > 0.999 * clear;
                assert!(is_lit || !sight.is_free(point, -DVec3::Z), "{point}: {}", got / clear);
                lit += i32::from(is_lit);
                free += i32::from(sight.is_free(point, -DVec3::Z));
            }
        }
        assert!(free < 4800 && f64::from(free) > 0.9 * f64::from(lit), "{free} free of {lit} lit");
    }

    #[test]
    fn a_wall_close_behind_a_plate_is_not_called_free() {
        let quad = |s: f32, z: f32| {
            let p = [[-s, -s], [s, -s], [s, s], [-s, s]].map(|[x, y]| Vec3::new(x, y, z));
            [[p[0], p[1], p[2]], [p[0], p[2], p[3]]]
        };
        let kernel = RayKernel::build([quad(2.0, 1.0), quad(0.05, 0.99)].concat());
        let sight = Sight::look(&kernel, &[-Vec3::Z; 4], &camera(), 0.085);
        assert!(!sight.is_free(DVec3::new(0.0, 0.0, 1.0), -DVec3::Z));
        assert!(sight.is_free(DVec3::new(0.0, 0.0, 0.99), -DVec3::Z));
        assert!(sight.is_free(DVec3::new(0.2, 0.1, 1.0), -DVec3::Z));
    }

    #[test]
    fn the_plates_rim_is_an_edge_and_its_middle_is_not() {
        let (kernel, camera) = (plate_before_wall(), camera());
        let sight = Sight::look(&kernel, &[-Vec3::Z; 4], &camera, 0.085);
        assert!(!sight.beside_edge(DVec3::new(0.0, 0.0, 0.7)));
        assert!(sight.beside_edge(DVec3::new(0.05, 0.0, 0.7)));
        assert!(!sight.beside_edge(DVec3::new(0.2, 0.1, 1.0)));
        assert!(sight.beside_edge(DVec3::new(0.0, 0.0, -1.0)));
    }
}
