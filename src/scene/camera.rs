//! A posed pinhole camera with lens distortion in OpenCV's order.

use glam::{DAffine3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Pinhole intrinsics in pixels; pixel centres at `(i + 0.5, j + 0.5)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal lengths in pixels, x and y.
    pub focal: DVec2,
    /// Principal point in pixels from the top-left corner.
    pub principal: DVec2,
    /// Lens distortion.
    pub distortion: Distortion,
}

/// Brown-Conrady distortion in OpenCV's order k1 k2 p1 p2 k3, on normalised coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, second order.
    pub k1: f64,
    /// Radial, fourth order.
    pub k2: f64,
    /// First tangential.
    pub p1: f64,
    /// Second tangential.
    pub p2: f64,
    /// Radial, sixth order.
    pub k3: f64,
}

/// One photo's camera. Camera frame: x right, y down, z forward, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// File stem of the photo.
    pub name: String,
    /// Lens and sensor.
    pub intrinsics: Intrinsics,
    /// Rigid transform that maps camera coordinates to world coordinates.
    pub world_from_camera: DAffine3,
}

impl Distortion {
    /// Distorts normalised image coordinates (x/z, y/z).
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let (x, y) = (p.x, p.y);
        DVec2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Inverts [`Distortion::distort`] by fixed-point iteration.
    pub fn undistort(&self, distorted: DVec2) -> DVec2 {
        let mut p = distorted;
        for _ in 0..32 {
            let next = p + (distorted - self.distort(p));
            if (next - p).length_squared() < 1e-24 {
                return next;
            }
            p = next;
        }
        p
    }
}

impl Camera {
    /// Camera centre in the world, metres.
    pub fn centre(&self) -> DVec3 {
        self.world_from_camera.translation
    }

    /// Pixel coordinates of a world point, and its depth along the optical axis in metres; `None` behind the
    /// camera, and where the lens distortion no longer has an inverse. The point may lie outside the frame.
    pub fn project(&self, world: DVec3) -> Option<(DVec2, f64)> {
        let p = self.world_from_camera.inverse().transform_point3(world);
        if p.z <= 1e-9 {
            return None;
        }
        let straight = DVec2::new(p.x / p.z, p.y / p.z);
        let distortion = &self.intrinsics.distortion;
        let d = distortion.distort(straight);
        // Far outside its field a distortion polynomial folds back into the frame.
        if *distortion != Distortion::default()
            && (distortion.undistort(d) - straight).length() > 1e-6 * (1.0 + straight.length())
        {
            return None;
        }
        Some((d * self.intrinsics.focal + self.intrinsics.principal, p.z))
    }

    /// Direction in the world of the ray through a pixel position, scaled so that one unit is one metre of
    /// depth along the optical axis.
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        let distorted = (pixel - self.intrinsics.principal) / self.intrinsics.focal;
        let p = self.intrinsics.distortion.undistort(distorted);
        self.world_from_camera.transform_vector3(DVec3::new(p.x, p.y, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn a_ray_through_a_pixel_projects_back_to_it() {
        let camera = Camera {
            name: "0001".into(),
            intrinsics: Intrinsics {
                width: 600,
                height: 400,
                focal: DVec2::new(700.0, 705.0),
                principal: DVec2::new(299.0, 203.5),
                distortion: Distortion { k1: -0.11, k2: 0.03, p1: 0.001, p2: -0.0007, k3: 0.002 },
            },
            world_from_camera: DAffine3::from_mat3_translation(
                DMat3::from_rotation_x(0.4) * DMat3::from_rotation_y(-1.1),
                DVec3::new(0.3, -0.2, 1.5),
            ),
        };
        for pixel in [DVec2::new(0.5, 0.5), DVec2::new(599.5, 12.25), DVec2::new(310.0, 399.0)] {
            let point = camera.centre() + camera.ray(pixel) * 0.83;
            let (back, depth) = camera.project(point).unwrap();
            assert!((back - pixel).length() < 1e-9, "{back} for {pixel}");
            assert!((depth - 0.83).abs() < 1e-12);
        }
        assert!(camera.project(camera.centre() - camera.ray(DVec2::new(300.0, 200.0))).is_none());
    }

    #[test]
    fn a_point_so_far_aside_that_the_distortion_folds_back_is_not_seen() {
        let lens = Distortion { k1: -0.11, ..Distortion::default() };
        let camera = Camera {
            name: "0001".into(),
            intrinsics: Intrinsics {
                width: 600,
                height: 400,
                focal: DVec2::splat(600.0),
                principal: DVec2::new(300.0, 200.0),
                distortion: lens,
            },
            world_from_camera: DAffine3::IDENTITY,
        };
        let folded = lens.distort(DVec2::new(2.7, 0.0));
        assert!(folded.x.abs() < 0.6, "{folded} is not inside the frame, so this test tells nothing");
        assert!(camera.project(DVec3::new(2.7, 0.0, 1.0)).is_none());
        assert!(camera.project(DVec3::new(0.4, 0.2, 1.0)).is_some());
    }
}
