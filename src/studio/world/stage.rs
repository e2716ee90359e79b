//! The stage: object, floor, lamps, ring flash, and the stops at which the operator stands.

use super::bowl;
use super::glaze;
use super::patch::{Patch, assemble};
use super::path::{Lamp, Ring, Surface, Tracer};
use super::varnish::Varnish;
use crate::scene::{Camera, Distortion, Intrinsics};
use glam::{DAffine3, DMat3, DVec2, DVec3, Vec3};

/// The ring flash. Its radii are what a user would measure with a ruler.
pub(super) const RING: Ring = Ring { inner: 0.035, outer: 0.085, radiance: [60.0, 57.0, 51.0] };

/// Lamps: a warm one high on the left, a cool one on the right, a small greenish one behind. Each is small
/// enough to throw a hard shadow.
pub(super) const LAMPS: [Lamp; 3] = [
    Lamp { centre: Vec3::new(-1.1, -0.9, 1.5), radius: 0.06, radiance: [270.0, 205.0, 127.0] },
    Lamp { centre: Vec3::new(1.3, -0.5, 1.2), radius: 0.05, radiance: [123.0, 172.0, 230.0] },
    Lamp { centre: Vec3::new(0.2, 1.4, 1.0), radius: 0.04, radiance: [123.0, 197.0, 135.0] },
];

/// Radiance from the room beyond the floor.
pub(super) const GLOW: [f32; 3] = [0.033, 0.036, 0.039];

/// Focal length in millimetres on a sensor 36 mm wide.
pub(super) const FOCAL_MM: f64 = 45.0;

/// Lens and sensor, in pixels.
pub(super) const INTRINSICS: Intrinsics = Intrinsics {
    width: 336,
    height: 224,
    focal: DVec2::new(420.0, 420.0),
    principal: DVec2::new(168.0, 112.0),
    distortion: Distortion { k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0, k3: 0.0 },
};

/// Half the floor's width, metres.
const FLOOR: f64 = 1.2;

/// Cameras on a circle round the object, all looking at one point on the object's axis.
pub(in crate::studio) struct Circle {
    pub(in crate::studio) stops: usize,
    /// Height of the point looked at, metres.
    pub(in crate::studio) target: f64,
    /// Of the cameras above the point looked at, radians.
    pub(in crate::studio) elevation: f64,
    /// From the point looked at, metres.
    pub(in crate::studio) distance: f64,
    /// Azimuth of the first stop, radians.
    pub(in crate::studio) first: f64,
}

const CIRCLES: [Circle; 2] = [
    Circle { stops: 8, target: 0.148, elevation: 0.26, distance: 0.80, first: -1.50 },
    Circle { stops: 6, target: 0.168, elevation: 0.86, distance: 0.82, first: -1.30 },
];

/// The object and the floor, in this order.
pub(super) fn surfaces() -> [Surface; 2] {
    surfaces_on(FLOOR, None)
}

/// The object, varnished or not, on a floor of this half width (metres).
pub(super) fn surfaces_on(half_width: f64, varnish: Option<Varnish>) -> [Surface; 2] {
    let (object, paint) = assemble("object", &bowl::patches(), 1024);
    let floor = Patch {
        cells: (1, 1),
        size: (2.0 * half_width, 2.0 * half_width),
        surface: Box::new(move |st: DVec2| ((2.0 * st - 1.0) * half_width).extend(0.0)),
        glaze: glaze::planks,
    };
    let (floor, planks) = assemble("floor", &[floor], 1024);
    [
        Surface { mesh: object, reflectance: paint, emission: [0.0; 3], varnish },
        Surface { mesh: floor, reflectance: planks, emission: [0.0; 3], varnish: None },
    ]
}

/// The tracer of the lit stage.
pub(super) fn tracer(surfaces: &[Surface]) -> Tracer {
    Tracer::new(surfaces.to_vec(), LAMPS.to_vec(), GLOW)
}

/// Cameras of all stops in the order of the walk; names `0001` and on, as the pairs are numbered.
pub(super) fn cameras() -> Vec<Camera> {
    cameras_on(&CIRCLES, INTRINSICS)
}

/// Cameras on these circles, numbered on from `0001`.
pub(super) fn cameras_on(circles: &[Circle], intrinsics: Intrinsics) -> Vec<Camera> {
    let mut cameras = Vec::new();
    for &Circle { stops, target, elevation, distance, first } in circles {
        let target = DVec3::Z * target;
        for k in 0..stops {
            let azimuth: f64 = first + std::f64::consts::TAU * k as f64 / stops as f64;
            let from =
                DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            cameras.push(Camera {
                name: format!("{:04}", cameras.len() + 1),
                intrinsics,
                world_from_camera: looking(target + from * distance, target),
            });
        }
    }
    cameras
}

/// Pose of a level camera at `eye` that looks at `target`; camera frame x right, y down, z forward.
fn looking(eye: DVec3, target: DVec3) -> DAffine3 {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let down = forward.cross(right);
    DAffine3::from_mat3_translation(DMat3::from_cols(right, down, forward), eye)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stop_has_the_whole_object_in_frame_the_right_way_up() {
        let surfaces = surfaces();
        for camera in cameras() {
            for p in &surfaces[0].mesh.positions {
                let (pixel, _) = camera.project(p.as_dvec3()).unwrap();
                assert!(
                    pixel.x > 3.0 && pixel.x < 333.0 && pixel.y > 3.0 && pixel.y < 221.0,
                    "{p} at {pixel} in {}",
                    camera.name
                );
            }
            let top = camera.project(DVec3::new(0.0, 0.0, 0.28)).unwrap().0;
            let foot = camera.project(DVec3::ZERO).unwrap().0;
            assert!(top.y < foot.y, "upside down in {}", camera.name);
        }
    }
}
