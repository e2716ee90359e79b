//! One view's look at one surface point: what was read there, and what a white surface would have read.

use crate::calibration::FieldFactor;
use crate::light::{Elements, Ring};
use crate::photometry::Known;
use crate::raster::Image;
use crate::scene::Camera;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Least cosine between normal and direction to the camera: beyond it (84 degrees) a pixel's footprint is
/// ten times as long as wide.
const GRAZING: f64 = 0.1;

/// Pixels round an occlusion edge in which lens blur and demosaicing mix two surfaces.
const EDGE_RADIUS: usize = 2;

/// Standard deviation, relative to the reading, of a pixel beside an occlusion edge: it counts only where
/// nothing better is to be had.
const EDGE_DEVIATION: f32 = 0.3;

/// A step between neighbouring pixels of more than this many pixel footprints is an occlusion edge.
const EDGE_STEP: f64 = 4.0;

/// Edges are looked for on a grid of about this many points at the most.
const EDGE_POINTS: usize = 1_500_000;

/// The flash as it shone for one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Geometry, in the camera's frame.
    pub ring: Ring,
    /// Radiance per channel in DN at this view's settings.
    pub radiance: [f64; 3],
    /// Vignetting times lobe.
    pub field: FieldFactor,
}

/// What one view tells of one surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Known light read, DN.
    pub known: [f32; 3],
    /// Its variance, DN^2.
    pub variance: [f32; 3],
    /// What a white surface would have read in the flash's light, DN.
    pub white: [f32; 3],
    /// Factor from irradiance (DN) to reading: field factor / pi. Bounced light enters `white` through it.
    pub response: f32,
}

/// A posed photograph with everything needed to observe through it.
pub struct View<'a> {
    camera: &'a Camera,
    known: &'a Known,
    lamp: &'a Lamp,
    elements: &'a Elements,
    edges: Edges,
    /// Metres by which rays start off the surface.
    offset: f64,
}

impl<'a> View<'a> {
    /// Prepares a view; finds its occlusion edges. `known` must have the camera's size, `offset` (metres)
    /// keeps rays off the surface they start from.
    pub fn new(
        camera: &'a Camera,
        known: &'a Known,
        lamp: &'a Lamp,
        elements: &'a Elements,
        offset: f64,
    ) -> Self {
        Self { camera, known, lamp, elements, edges: Edges::find(camera, elements), offset }
    }

    /// Ring irradiance per unit radiance at a point with unit normal (world frame), shadows included.
    pub fn direct(&self, point: Vec3, normal: Vec3) -> f64 {
        direct(self.camera, self.lamp, self.elements, self.offset, point, normal)
    }

    /// The view's look at a point (metres, world) with unit normal; `None` where it does not see it, sees it
    /// at a grazing angle, or clipped.
    pub fn observe(&self, point: Vec3, normal: Vec3) -> Option<Observation> {
        let (position, facing) = (point.as_dvec3(), normal.as_dvec3());
        let way = self.camera.centre() - position;
        if facing.dot(way) <= GRAZING * way.length() {
            return None;
        }
        let (pixel, _) = self.camera.project(position)?;
        let (known, mut variance) = self.read(pixel)?;
        if self.edges.near(pixel) {
            for (v, k) in variance.iter_mut().zip(known) {
                *v += (EDGE_DEVIATION * k).powi(2);
            }
        }
        let start = (position + facing * self.offset).as_vec3();
        let to_lens = self.camera.centre().as_vec3() - start;
        if self.elements.kernel().occluded(start, to_lens, 0.0, 1.0) {
            return None;
        }
        let unit = self.direct(point, normal);
        let response = self.lamp.field.at(&self.camera.intrinsics, pixel) / PI;
        let white = self.lamp.radiance.map(|r| (r * response * unit) as f32);
        Some(Observation { known, variance, white, response: response as f32 })
    }

    /// Bilinear reading of the known light; `None` outside the frame or beside an unknown pixel.
    fn read(&self, pixel: DVec2) -> Option<([f32; 3], [f32; 3])> {
        let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = ((x - x0) as f32, (y - y0) as f32);
        let (mut known, mut variance) = ([0.0; 3], [0.0; 3]);
        for (dx, dy, w) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let (px, py) = (x0 as isize + dx, y0 as isize + dy);
            if !*self.known.valid.get(px, py)? {
                return None;
            }
            let (value, var) = (self.known.rgb.get(px, py)?, self.known.variance.get(px, py)?);
            for c in 0..3 {
                known[c] += w * value[c];
                variance[c] += w * var[c];
            }
        }
        Some((known, variance))
    }
}

/// Ring irradiance per unit radiance at a point with unit normal (world frame), shadows included.
pub fn direct(
    camera: &Camera,
    lamp: &Lamp,
    elements: &Elements,
    offset: f64,
    point: Vec3,
    normal: Vec3,
) -> f64 {
    let camera_from_world = camera.world_from_camera.inverse();
    let local = camera_from_world.transform_point3(point.as_dvec3());
    let facing: DVec3 = camera_from_world.transform_vector3(normal.as_dvec3());
    lamp.ring.shadowed_irradiance(elements.kernel(), &camera.world_from_camera, local, facing, offset)
}

/// Where one surface ends before another.
struct Edges {
    stride: usize,
    near: Image<bool>,
}

impl Edges {
    fn find(camera: &Camera, elements: &Elements) -> Self {
        let lens = &camera.intrinsics;
        let stride = ((lens.width * lens.height) as f64 / EDGE_POINTS as f64).sqrt().ceil().max(1.0) as usize;
        let (width, height) = (lens.width.div_ceil(stride), lens.height.div_ceil(stride));
        let origin = camera.centre();
        let hits: Vec<Option<(DVec3, DVec3)>> = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let cell = DVec2::new((i % width) as f64, (i / width) as f64) + 0.5;
                let ray = camera.ray(cell * stride as f64);
                let hit = elements.kernel().nearest(origin.as_vec3(), ray.as_vec3(), 0.0, f32::INFINITY)?;
                Some((origin + ray * f64::from(hit.t), elements.normal(hit.triangle as usize).as_dvec3()))
            })
            .collect();
        let footprint = stride as f64 / lens.focal.min_element();
        let step = |a: usize, b: usize| match (hits[a], hits[b]) {
            (Some((p, n)), Some((q, m))) => {
                let allowed = EDGE_STEP * footprint * (p - origin).length();
                (q - p).dot(n).abs() > allowed && (q - p).dot(m).abs() > allowed
            }
            (None, None) => false,
            _ => true,
        };
        let mut near = Image::filled(width, height, false);
        let radius = EDGE_RADIUS.div_ceil(stride);
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let edge = (x + 1 < width && step(i, i + 1)) || (y + 1 < height && step(i, i + width));
                if edge {
                    for v in y.saturating_sub(radius)..(y + radius + 2).min(height) {
                        for u in x.saturating_sub(radius)..(x + radius + 2).min(width) {
                            *near.at_mut(u, v) = true;
                        }
                    }
                }
            }
        }
        Self { stride, near }
    }

    fn near(&self, pixel: DVec2) -> bool {
        let cell = pixel / self.stride as f64;
        *self.near.get(cell.x.floor() as isize, cell.y.floor() as isize).unwrap_or(&true)
    }
}
