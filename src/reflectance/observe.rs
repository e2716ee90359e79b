//! One view's look at one surface point: what was read there, and what a white surface would have read.

use super::stage::Stage;
use crate::calibration::FieldFactor;
use crate::light::{Draw, Elements, Occluders, Ring, SPOTS, Sight, Spot};
use crate::photometry::Known;
use crate::scene::Camera;
use glam::{DAffine3, DVec2, DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Least cosine between normal and direction to the camera: beyond it (84 degrees) a pixel's footprint is
/// ten times as long as wide.
pub(super) const GRAZING: f64 = 0.1;

/// Standard deviation, relative to the reading, of a pixel beside an occlusion edge: it counts only where
/// nothing better is to be had.
const EDGE_DEVIATION: f32 = 0.3;

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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Known light read, DN.
    pub known: [f32; 3],
    /// Its variance, DN^2.
    pub variance: [f32; 3],
    /// What a white surface would have read in the flash's light, DN.
    pub white: [f32; 3],
    /// Pixels per square metre of surface: how finely the view sees it.
    pub resolution: f32,
    /// Factor from irradiance (DN) to reading: field factor / pi. Bounced light enters `white` through it.
    pub response: f32,
    /// Cosine between normal and direction to the camera.
    pub facing: f32,
    /// Weight of the gloss, of whose mirrored light the reading is still to be freed; 0 where none was found.
    pub gloss: f32,
}

impl Observation {
    /// The mean of several looks at one patch; `None` of none.
    fn mean(looks: &[Self]) -> Option<Self> {
        let mut sum = *looks.first()?;
        let n = looks.len() as f32;
        for o in &looks[1..] {
            for c in 0..3 {
                sum.known[c] += o.known[c];
                sum.variance[c] += o.variance[c];
                sum.white[c] += o.white[c];
            }
            sum.resolution += o.resolution;
            sum.response += o.response;
            sum.facing += o.facing;
        }
        Some(Self {
            known: sum.known.map(|v| v / n),
            variance: sum.variance.map(|v| v / (n * n)),
            white: sum.white.map(|v| v / n),
            resolution: sum.resolution / n,
            response: sum.response / n,
            facing: sum.facing / n,
            gloss: sum.gloss,
        })
    }
}

/// A camera and its flash before the scene: what light falls where, before anyone looks at a photograph.
pub struct Illumination<'a> {
    camera: &'a Camera,
    lamp: &'a Lamp,
    elements: &'a Elements,
    sight: Sight,
    camera_from_world: DAffine3,
    /// Metres by which rays start off the surface.
    offset: f64,
}

impl<'a> Illumination<'a> {
    /// Looks round once; `offset` (metres) keeps rays off the surface they start from.
    pub fn new(camera: &'a Camera, lamp: &'a Lamp, elements: &'a Elements, offset: f64) -> Self {
        let sight = Sight::look(elements.kernel(), elements.normals(), camera, lamp.ring.reach());
        let camera_from_world = camera.world_from_camera.inverse();
        Self { camera, lamp, elements, sight, camera_from_world, offset }
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        self.camera
    }

    /// The lamp.
    pub fn lamp(&self) -> &Lamp {
        self.lamp
    }

    /// What the camera sees freely.
    pub fn sight(&self) -> &Sight {
        &self.sight
    }

    /// Ring irradiance per unit radiance at a point with unit normal (world frame), shadows included.
    pub fn direct(&self, point: Vec3, normal: Vec3) -> f64 {
        self.unless_free(point, normal, |place, facing| {
            self.lamp.ring.shadowed_irradiance(&self.occluders(), place, facing)
        })
    }

    /// The same with coarse half-shadows that are right in the mean over many points: for the mean over a pixel.
    pub fn glimpsed(&self, point: Vec3, normal: Vec3) -> f64 {
        self.unless_free(point, normal, |place, facing| {
            self.lamp.ring.glimpsed_irradiance(&self.occluders(), place, facing)
        })
    }

    /// The same at one of the spots over which a pixel's mean is taken.
    pub fn at_spot(&self, spot: &Spot) -> f64 {
        self.unless_free(spot.point, spot.normal, |place, facing| {
            self.lamp.ring.drawn_irradiance(&self.occluders(), place, facing, spot.draw)
        })
    }

    /// Ring irradiance per unit radiance at a point with unit normal (world frame) with nothing in the way.
    pub fn clear(&self, point: Vec3, normal: Vec3) -> f64 {
        let (place, facing) = self.local(point, normal);
        self.lamp.ring.irradiance(place, facing)
    }

    /// Share of [`Self::clear`] that shadows leave at a point with unit normal (world frame), by the lamp's points of a
    /// draw.
    pub fn drawn_share(&self, point: Vec3, normal: Vec3, draw: Draw) -> f64 {
        let (place, facing) = self.local(point, normal);
        if self.sight.is_free(place, facing) {
            return 1.0;
        }
        self.lamp.ring.drawn_share(&self.occluders(), place, facing, draw)
    }

    /// Irradiance at a point (world frame): the closed form where nothing can stand in the way, else `shadowed` of
    /// place and normal in the camera's frame.
    fn unless_free(&self, point: Vec3, normal: Vec3, shadowed: impl FnOnce(DVec3, DVec3) -> f64) -> f64 {
        let (place, facing) = self.local(point, normal);
        if self.sight.is_free(place, facing) {
            return self.lamp.ring.irradiance(place, facing);
        }
        shadowed(place, facing)
    }

    fn occluders(&self) -> Occluders<'_> {
        Occluders {
            kernel: self.elements.kernel(),
            world_from_camera: &self.camera.world_from_camera,
            offset: self.offset,
        }
    }

    /// Point and normal in the camera's frame.
    fn local(&self, point: Vec3, normal: Vec3) -> (DVec3, DVec3) {
        let place = self.camera_from_world.transform_point3(point.as_dvec3());
        (place, self.camera_from_world.transform_vector3(normal.as_dvec3()))
    }

    /// Whether the camera sees a point with unit normal (world frame), and whether beside an occlusion edge.
    fn sees(&self, point: Vec3, normal: Vec3) -> Option<bool> {
        let (local, facing) = self.local(point, normal);
        if !self.sight.is_free(local, facing) {
            let start = (point.as_dvec3() + normal.as_dvec3() * self.offset).as_vec3();
            let to_lens = self.camera.centre().as_vec3() - start;
            if self.elements.kernel().occluded(start, to_lens, 0.0, 1.0) {
                return None;
            }
        }
        Some(self.sight.beside_edge(local))
    }
}

/// A photograph under its illumination.
pub struct View<'a> {
    /// Camera, lamp and scene.
    pub illumination: &'a Illumination<'a>,
    /// The known light, of the camera's size.
    pub known: &'a Known,
}

impl View<'_> {
    /// The view's looks at all patches of which it sees anything, by index, in `direct` light (irradiance per unit
    /// radiance at each spot): the mean over those of a patch's spots that it sees.
    pub fn observe_patches(&self, stage: &Stage, direct: &[[f32; SPOTS]]) -> Vec<(u32, Observation)> {
        let Stage { elements, patches, .. } = stage;
        (0..patches.len())
            .into_par_iter()
            .filter_map(|p| {
                let spots = patches.spots(p).zip(direct[p]);
                let looks: Vec<Observation> = spots
                    .filter(|(e, _)| elements.normal(*e) != Vec3::ZERO)
                    .filter_map(|(e, lit)| self.observe(elements.centroid(e), elements.normal(e), lit))
                    .collect();
                Some((p as u32, Observation::mean(&looks)?))
            })
            .collect()
    }

    /// The view's look at a point (metres, world) with unit normal in `direct` light (irradiance per unit radiance);
    /// `None` where it does not see it, sees it at a grazing angle, or clipped.
    pub fn observe(&self, point: Vec3, normal: Vec3, direct: f32) -> Option<Observation> {
        let Illumination { camera, lamp, .. } = self.illumination;
        let way = camera.centre() - point.as_dvec3();
        if normal.as_dvec3().dot(way) <= GRAZING * way.length() {
            return None;
        }
        let (pixel, depth) = camera.project(point.as_dvec3())?;
        let (known, mut variance) = self.read(pixel)?;
        if self.illumination.sees(point, normal)? {
            for (v, k) in variance.iter_mut().zip(known) {
                *v += (EDGE_DEVIATION * k).powi(2);
            }
        }
        let unit = f64::from(direct);
        let response = lamp.field.at(&camera.intrinsics, pixel) / PI;
        let white = lamp.radiance.map(|r| (r * response * unit) as f32);
        let focal = camera.intrinsics.focal;
        let resolution = focal.x * focal.y * normal.as_dvec3().dot(way) / (depth * depth * depth);
        let (resolution, response) = (resolution as f32, response as f32);
        let facing = (normal.as_dvec3().dot(way) / way.length()) as f32;
        Some(Observation { known, variance, white, resolution, response, facing, gloss: 0.0 })
    }

    /// Reading of the known light between pixels: cubic convolution, which does not blur as bilinear does;
    /// bilinear where a pixel of the 4x4 is not known. `None` outside the frame or beside an unknown pixel.
    fn read(&self, pixel: DVec2) -> Option<([f32; 3], [f32; 3])> {
        let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = ((x - x0) as f32, (y - y0) as f32);
        let corner = (x0 as isize - 1, y0 as isize - 1);
        self.weighted(corner, &cubic(fx), &cubic(fy))
            .or_else(|| self.weighted(corner, &[0.0, 1.0 - fx, fx, 0.0], &[0.0, 1.0 - fy, fy, 0.0]))
    }

    /// Sum over 4x4 pixels from `corner` on; pixels of weight 0 need not be known.
    fn weighted(
        &self,
        corner: (isize, isize),
        across: &[f32; 4],
        down: &[f32; 4],
    ) -> Option<([f32; 3], [f32; 3])> {
        let (mut known, mut variance) = ([0.0; 3], [0.0; 3]);
        for (j, wy) in down.iter().enumerate() {
            for (i, wx) in across.iter().enumerate() {
                let w = wx * wy;
                if w == 0.0 {
                    continue;
                }
                let (px, py) = (corner.0 + i as isize, corner.1 + j as isize);
                if !*self.known.valid.get(px, py)? {
                    return None;
                }
                let (value, var) = (self.known.rgb.get(px, py)?, self.known.variance.get(px, py)?);
                for c in 0..3 {
                    known[c] += w * value[c];
                    variance[c] += w * w * var[c];
                }
            }
        }
        Some((known, variance))
    }
}

/// Weights of four neighbours for a position `f` between the middle two (Keys, "Cubic convolution
/// interpolation for digital image processing", 1981, a = -1/2).
fn cubic(f: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [-0.5 * f3 + f2 - 0.5 * f, 1.5 * f3 - 2.5 * f2 + 1.0, -1.5 * f3 + 2.0 * f2 + 0.5 * f, 0.5 * f3 - 0.5 * f2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_weights_reproduce_parabolas() {
        for f in [0.0f32, 0.2, 0.5, 0.9] {
            let sum = |power: i32| -> f32 {
                cubic(f).iter().enumerate().map(|(i, w)| w * (i as f32 - 1.0).powi(power)).sum()
            };
            assert!((sum(0) - 1.0).abs() < 1e-6);
            assert!((sum(1) - f).abs() < 1e-6 && (sum(2) - f * f).abs() < 1e-5, "{f}");
        }
    }
}
