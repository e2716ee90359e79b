//! What may stand between a lamp and a surface.

use super::RayKernel;
use glam::{DAffine3, DVec3, Vec3};

/// All surfaces, as shadow rays from a camera's neighbourhood meet them.
#[derive(Clone, Copy)]
pub struct Occluders<'a> {
    /// The surfaces, world frame.
    pub kernel: &'a RayKernel,
    /// Places the camera, whose frame lamps and points are given in, in the world.
    pub world_from_camera: &'a DAffine3,
    /// Metres by which rays start off the surface.
    pub offset: f64,
}

impl Occluders<'_> {
    /// Where shadow rays start from a point with unit normal (camera frame): world frame.
    pub(super) fn start(&self, point: DVec3, normal: DVec3) -> Vec3 {
        self.world_from_camera.transform_point3(point + normal * self.offset).as_vec3()
    }

    /// Whether a point of the lamp (camera frame) is seen from where a shadow ray starts.
    pub(super) fn let_see(&self, start: Vec3, lamp: DVec3) -> bool {
        let way = self.world_from_camera.transform_point3(lamp).as_vec3() - start;
        !self.kernel.occluded(start, way, 0.0, 1.0)
    }
}
