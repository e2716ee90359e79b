//! The reference for simulated light: irradiance under a ring flash by brute force, without bias.
//!
//! Takes meshes with their reflectance, a ring round the lens, and asks at surface points or over a pixel's square:
//! how much of the ring's light falls there, straight and by way of other surfaces? Straight light is the mean over
//! random points of the ring with a shadow ray each; bounced light the mean of pi times the radiance that comes
//! from cosine-distributed directions, each followed as a path (`super::path`). Neither a closed form nor the
//! transport operator of [`crate::light`] has any part in it: the ray kernel alone is shared.
//!
//! Every answer comes in two halves with independent noise, m1 and m2, so that a tested value e has the mean square
//! error `mean of (e - m1)(e - m2)`, in which the reference's own noise does not count.

use super::patch::Texture;
use super::path::{Ring, Surface, Tracer, cosine_direction};
use super::sampler::{Sampler, combine};
use crate::raster::Rgb;
use crate::scene::{Camera, Mesh};
use glam::{DVec2, Vec3};
use std::f32::consts::PI;

/// Irradiance per unit radiance of the ring.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    /// Straight from the ring.
    pub direct: f64,
    /// By way of other surfaces, camera RGB.
    pub bounced: [f64; 3],
}

/// The scene, ready to be asked.
pub struct Reference {
    tracer: Tracer,
    ring: Ring,
}

impl Reference {
    /// Meshes with their reflectance, in their texture coordinates (row 0 at v = 1; a 1x1 image is one reflectance
    /// all over), the object first; `radii` are the ring's, metres. Reflectance is held in steps of 1/65535.
    ///
    /// Panics never; a mesh without texture coordinates is read at (0, 0).
    pub fn new(surfaces: Vec<(Mesh, Rgb)>, radii: [f64; 2]) -> Self {
        let surfaces = surfaces
            .into_iter()
            .map(|(mesh, reflectance)| Surface {
                mesh,
                reflectance: Texture {
                    size: reflectance.width(),
                    texels: reflectance
                        .pixels()
                        .iter()
                        .map(|p| p.map(|v| (v.clamp(0.0, 1.0) * 65535.0).round() as u16))
                        .collect(),
                },
                emission: [0.0; 3],
                varnish: None,
            })
            .collect();
        let ring = Ring { inner: radii[0] as f32, outer: radii[1] as f32, radiance: [1.0; 3] };
        Self { tracer: Tracer::new(surfaces, vec![], [0.0; 3]), ring }
    }

    /// Mean over a pixel's square, in two halves of `rays` (a power of two) each; `None` unless every ray meets the
    /// object (the first mesh) first. Without `bounces` only the straight light is told.
    pub fn pixel(
        &self,
        camera: &Camera,
        (x, y): (usize, usize),
        rays: u32,
        bounces: bool,
    ) -> Option<[Light; 2]> {
        let eye = camera.centre().as_vec3();
        let place = (y * camera.intrinsics.width + x) as u32;
        let half = |half: u32| {
            let mut mean = Light::default();
            for index in 0..rays {
                let mut sampler = Sampler::new(combine(half, place), index);
                let inside = DVec2::new(x as f64, y as f64) + sampler.next().as_dvec2();
                let met = self.tracer.meets(eye, camera.ray(inside).as_vec3())?;
                if met.surface != 0 {
                    return None;
                }
                self.add(camera, met.point, met.normal, bounces, &mut sampler, f64::from(rays), &mut mean);
            }
            Some(mean)
        };
        Some([half(0)?, half(1)?])
    }

    /// At a surface point (metres, world) with unit normal, in two halves of `rays` (a power of two) each; `key`
    /// sets the noise of one point apart from another's.
    pub fn point(&self, camera: &Camera, point: Vec3, normal: Vec3, key: u32, rays: u32) -> [Light; 2] {
        [0, 1].map(|half| {
            let mut mean = Light::default();
            for index in 0..rays {
                let mut sampler = Sampler::new(combine(half, key), index);
                self.add(
                    camera,
                    point + normal * 2e-6,
                    normal,
                    true,
                    &mut sampler,
                    f64::from(rays),
                    &mut mean,
                );
            }
            mean
        })
    }

    #[expect(clippy::too_many_arguments, reason = "one sample's inputs, used twice above")]
    fn add(
        &self,
        camera: &Camera,
        point: Vec3,
        normal: Vec3,
        bounces: bool,
        sampler: &mut Sampler,
        rays: f64,
        mean: &mut Light,
    ) {
        let pose = &camera.world_from_camera;
        let (direct, _) = self.tracer.light_of_ring(point, normal, &self.ring, pose, sampler.next());
        mean.direct += f64::from(direct) / rays;
        if bounces {
            let direction = cosine_direction(normal, sampler.next());
            let seen = self.tracer.trace(point, direction, Some((&self.ring, pose)), false, sampler);
            for (sum, radiance) in mean.bounced.iter_mut().zip(seen.flash) {
                *sum += f64::from(PI * radiance) / rays;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Distortion, Intrinsics};
    use glam::{DAffine3, Vec2};

    fn camera() -> Camera {
        Camera {
            name: "1".into(),
            intrinsics: Intrinsics {
                width: 100,
                height: 100,
                focal: DVec2::splat(120.0),
                principal: DVec2::splat(50.0),
                distortion: Distortion::default(),
            },
            world_from_camera: DAffine3::IDENTITY,
        }
    }

    fn wall(half: f32, z: f32) -> Mesh {
        let corner = |x: f32, y: f32| Vec3::new(x * half, y * half, z);
        Mesh {
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
            uvs: vec![Vec2::splat(0.5)],
            uv_triangles: vec![[0; 3]; 2],
            ..Mesh::default()
        }
    }

    #[test]
    fn a_lone_wall_gets_the_rings_light_and_no_bounces() {
        let white = Rgb::filled(1, 1, [0.9; 3]);
        let reference = Reference::new(vec![(wall(1.0, 1.0), white)], [0.010, 0.100]);
        let [a, b] = reference.pixel(&camera(), (50, 50), 256, true).unwrap();
        // Radiance 0.5528 of a surface of 0.94 under a radiance of 60, as a renderer gave it.
        let want = 0.5528 * std::f64::consts::PI / 0.94 / 60.0;
        assert!((a.direct / want - 1.0).abs() < 1e-3 && (b.direct / want - 1.0).abs() < 1e-3, "{a:?}");
        assert_ne!(a.direct, b.direct);
        assert_eq!(a.bounced, [0.0; 3]);
    }

    #[test]
    fn a_pixel_that_is_not_all_object_has_no_reference() {
        let white = Rgb::filled(1, 1, [0.9; 3]);
        let scene = vec![(wall(0.1, 0.8), white.clone()), (wall(1.0, 1.0), white)];
        let reference = Reference::new(scene, [0.035, 0.085]);
        assert!(reference.pixel(&camera(), (50, 50), 16, false).is_some());
        assert!(reference.pixel(&camera(), (65, 50), 16, false).is_none());
        assert!(reference.pixel(&camera(), (90, 50), 16, false).is_none());
    }
}
