//! The reference path tracer: what a camera would see, without bias, at whatever cost.
//!
//! Takes surfaces of known Lambertian reflectance, spherical lamps, an even glow from beyond the scene and a ring
//! flash round the lens; gives radiance along camera rays, the room's light and the flash's apart. Each path
//! scatters by the cosine law and, at each point that it meets, adds the light that reaches the point straight
//! from a random point of the ring and of one random lamp (Kajiya, "The Rendering Equation", 1986, with
//! next-event estimation). Paths run six bounces and then go on by Russian roulette. Nothing here is shared with
//! the code that later inverts the photographs but the ray kernel.
//!
//! Lamps and ring give light but have no body: rays pass through them, and no path meets them by chance.
//!
//! A surface may carry a [`Varnish`]; its paths then go on along either lobe, weighed by the density of both
//! together (Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, one-sample form).

use super::patch::Texture;
use super::sampler::Sampler;
use super::varnish::Varnish;
use crate::light::RayKernel;
use crate::scene::Mesh;
use glam::{DAffine3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// Changes whenever the tracer computes something else from the same scene.
pub(super) const VERSION: &str = "path 1";

/// Off the facet by more than rounding, less than anything that matters; metres.
const LIFT: f32 = 2e-6;

/// Bounces before Russian roulette begins.
const SURE_BOUNCES: usize = 6;

/// A surface of the scene: Lambertian on both sides.
#[derive(Clone)]
pub(super) struct Surface {
    /// Exactly these triangles.
    pub(super) mesh: Mesh,
    /// Reflectance in camera RGB, in the mesh's texture coordinates.
    pub(super) reflectance: Texture,
    /// Radiance that the surface gives off by itself, camera RGB.
    pub(super) emission: [f32; 3],
    /// Gloss on top of it.
    pub(super) varnish: Option<Varnish>,
}

/// A glowing sphere, seen by surfaces only.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lamp {
    /// Centre, metres, world frame.
    pub(super) centre: Vec3,
    /// Radius, metres.
    pub(super) radius: f32,
    /// Radiance, camera RGB.
    pub(super) radiance: [f32; 3],
}

/// The ring flash: an annulus in the plane of the lens, centred on it, one-sided Lambertian emitter towards +z of
/// the camera frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ring {
    /// Inner radius, metres.
    pub(super) inner: f32,
    /// Outer radius, metres.
    pub(super) outer: f32,
    /// Radiance at nominal energy, camera RGB.
    pub(super) radiance: [f32; 3],
}

/// What one camera ray found, or the mean over several.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Seen {
    /// Radiance by the room's light.
    pub(super) ambient: [f32; 3],
    /// Radiance by the flash at nominal energy.
    pub(super) flash: [f32; 3],
    /// Reflectance of the surface met first; 0 where there is none.
    pub(super) albedo: [f32; 3],
    /// Share of the rays that met the object (the first surface) first.
    pub(super) object: f32,
}

impl Seen {
    /// Adds `weight` times `other`.
    pub(super) fn add(&mut self, other: &Seen, weight: f32) {
        for k in 0..3 {
            self.ambient[k] += other.ambient[k] * weight;
            self.flash[k] += other.flash[k] * weight;
            self.albedo[k] += other.albedo[k] * weight;
        }
        self.object += other.object * weight;
    }
}

/// A point where a ray ends.
pub(super) struct Met {
    /// Just off the surface, metres.
    pub(super) point: Vec3,
    /// Unit normal on the ray's side.
    pub(super) normal: Vec3,
    /// Index of the surface.
    pub(super) surface: usize,
}

struct Facet {
    normal: Vec3,
    uvs: [Vec2; 3],
    surface: usize,
}

/// The scene, ready to be traced.
pub(super) struct Tracer {
    kernel: RayKernel,
    facets: Vec<Facet>,
    surfaces: Vec<Surface>,
    lamps: Vec<Lamp>,
    glow: [f32; 3],
    bounces: bool,
}

impl Tracer {
    /// Prepares surfaces (the object first), lamps, and `glow`, the radiance that comes from beyond the scene.
    pub(super) fn new(surfaces: Vec<Surface>, lamps: Vec<Lamp>, glow: [f32; 3]) -> Self {
        let mut corners = Vec::new();
        let mut facets = Vec::new();
        for (index, surface) in surfaces.iter().enumerate() {
            for triangle in 0..surface.mesh.triangles.len() {
                let [a, b, c] = surface.mesh.corners(triangle);
                corners.push([a, b, c]);
                facets.push(Facet {
                    normal: (b - a).cross(c - a).normalize_or_zero(),
                    uvs: surface.mesh.uv_corners(triangle).unwrap_or_default(),
                    surface: index,
                });
            }
        }
        Self { kernel: RayKernel::build(corners), facets, surfaces, lamps, glow, bounces: true }
    }

    /// The same scene without light that one surface throws on another.
    pub(super) fn without_bounces(self) -> Self {
        Self { bounces: false, ..self }
    }

    /// Index of the surface that is the first thing along a ray.
    pub(super) fn surface_met(&self, origin: Vec3, direction: Vec3) -> Option<usize> {
        let hit = self.kernel.nearest(origin, direction, 0.0, f32::INFINITY)?;
        Some(self.facets[hit.triangle as usize].surface)
    }

    /// Whether the object (the first surface) is the first thing along a ray.
    pub(super) fn meets_object(&self, origin: Vec3, direction: Vec3) -> bool {
        self.surface_met(origin, direction) == Some(0)
    }

    /// Whether nothing lies between two points; the first is on a surface with unit `normal`.
    pub(super) fn is_open(&self, from: Vec3, normal: Vec3, to: Vec3) -> bool {
        let start = from + normal * LIFT;
        !self.kernel.occluded(start, to - start, 0.0, 1.0)
    }

    /// The first thing along a ray.
    pub(super) fn meets(&self, origin: Vec3, direction: Vec3) -> Option<Met> {
        let hit = self.kernel.nearest(origin, direction, 0.0, f32::INFINITY)?;
        let facet = &self.facets[hit.triangle as usize];
        let [a, b, c] = self.kernel.corners(hit.triangle);
        let normal = if facet.normal.dot(direction) > 0.0 { -facet.normal } else { facet.normal };
        let point = *a * (1.0 - hit.u - hit.v) + *b * hit.u + *c * hit.v + normal * 2e-6;
        Some(Met { point, normal, surface: facet.surface })
    }

    /// Follows one path from the camera. `ring` comes with the camera's pose; without `room`, the room's light
    /// is left out.
    pub(super) fn trace(
        &self,
        origin: Vec3,
        direction: Vec3,
        ring: Option<(&Ring, &DAffine3)>,
        room: bool,
        sampler: &mut Sampler,
    ) -> Seen {
        let mut seen = Seen::default();
        let mut throughput = [1.0_f32; 3];
        let (mut origin, mut direction) = (origin, direction.normalize());
        for bounce in 0.. {
            let Some(hit) = self.kernel.nearest(origin, direction, 0.0, f32::INFINITY) else {
                if room {
                    accumulate(&mut seen.ambient, &throughput, &self.glow, 1.0);
                }
                break;
            };
            if bounce > 0 && !self.bounces {
                break;
            }
            let facet = &self.facets[hit.triangle as usize];
            let surface = &self.surfaces[facet.surface];
            if room {
                accumulate(&mut seen.ambient, &throughput, &surface.emission, 1.0);
            }
            let [a, b, c] = self.kernel.corners(hit.triangle);
            let w = 1.0 - hit.u - hit.v;
            let normal = if facet.normal.dot(direction) > 0.0 { -facet.normal } else { facet.normal };
            let point = *a * w + *b * hit.u + *c * hit.v + normal * LIFT;
            let uv = facet.uvs[0] * w + facet.uvs[1] * hit.u + facet.uvs[2] * hit.v;
            let albedo = surface.reflectance.at(uv);
            if bounce == 0 {
                seen.albedo = albedo;
                seen.object = if facet.surface == 0 { 1.0 } else { 0.0 };
            }
            let gloss = surface.varnish.map(|varnish| Gloss { varnish, normal, to_eye: -direction });
            // What the lobe sends on from a direction, in the same units as the base's albedo.
            let shine = |way: Vec3| gloss.map_or(0.0, |g| PI * g.value(way));
            let before = throughput;
            for k in 0..3 {
                throughput[k] *= albedo[k];
            }
            if let Some((ring, pose)) = ring {
                let (light, way) = self.light_of_ring(point, normal, ring, pose, sampler.next());
                accumulate(&mut seen.flash, &throughput, &ring.radiance, light / PI);
                if gloss.is_some() && light > 0.0 {
                    accumulate(&mut seen.flash, &before, &ring.radiance, light * shine(way) / PI);
                }
            }
            if room && !self.lamps.is_empty() {
                let choice = sampler.next().x;
                let lamp =
                    &self.lamps[((choice * self.lamps.len() as f32) as usize).min(self.lamps.len() - 1)];
                let (light, way) = self.light_of_lamp(point, normal, lamp, sampler.next());
                let light = light * self.lamps.len() as f32 / PI;
                accumulate(&mut seen.ambient, &throughput, &lamp.radiance, light);
                if gloss.is_some() && light > 0.0 {
                    accumulate(&mut seen.ambient, &before, &lamp.radiance, light * shine(way));
                }
            }
            if bounce >= SURE_BOUNCES {
                let survival = throughput.iter().copied().fold(0.0, f32::max).min(1.0);
                if sampler.next().x >= survival {
                    break;
                }
                throughput = throughput.map(|t| t / survival);
            }
            origin = point;
            direction = match gloss {
                None => cosine_direction(normal, sampler.next()),
                Some(gloss) => {
                    let Some((way, factor)) = gloss.go_on(&albedo, sampler) else { break };
                    for k in 0..3 {
                        // Russian roulette has scaled what the base alone would carry on.
                        let roulette = if albedo[k] > 0.0 { throughput[k] / albedo[k] } else { 0.0 };
                        throughput[k] = roulette * factor[k];
                    }
                    way
                }
            };
        }
        seen
    }

    /// One estimate of the irradiance at a point from a ring of unit radiance, and the unit way to its source.
    pub(super) fn light_of_ring(
        &self,
        point: Vec3,
        normal: Vec3,
        ring: &Ring,
        pose: &DAffine3,
        u: Vec2,
    ) -> (f32, Vec3) {
        let (inner, outer) = (ring.inner * ring.inner, ring.outer * ring.outer);
        let radius = (inner + u.x * (outer - inner)).sqrt();
        let (sin, cos) = (TAU * u.y).sin_cos();
        let at = pose
            .transform_point3(glam::DVec3::new((radius * cos).into(), (radius * sin).into(), 0.0))
            .as_vec3();
        let axis = pose.matrix3.z_axis.as_vec3();
        let way = at - point;
        let square = way.length_squared();
        // Both cosines times the distance.
        let (here, there) = (normal.dot(way), -axis.dot(way));
        if here <= 0.0 || there <= 0.0 || self.kernel.occluded(point, way, 0.0, 1.0) {
            return (0.0, way);
        }
        (here * there * PI * (outer - inner) / (square * square), way / square.sqrt())
    }

    /// One estimate of the irradiance at a point from a lamp of unit radiance, sampled over the cone that it fills,
    /// and the unit way to its source.
    fn light_of_lamp(&self, point: Vec3, normal: Vec3, lamp: &Lamp, u: Vec2) -> (f32, Vec3) {
        let way = lamp.centre - point;
        let distance = way.length();
        if distance <= lamp.radius {
            return (0.0, way);
        }
        let sin_square = (lamp.radius / distance).powi(2);
        let opening = sin_square / (1.0 + (1.0 - sin_square).sqrt());
        let lowered = u.x * opening;
        let axis = way / distance;
        let (side, other) = axis.any_orthonormal_pair();
        let (sin, cos) = (TAU * u.y).sin_cos();
        let across = (lowered * (2.0 - lowered)).max(0.0).sqrt();
        let direction = axis * (1.0 - lowered) + (side * cos + other * sin) * across;
        let here = normal.dot(direction);
        if here <= 0.0 {
            return (0.0, direction);
        }
        let along = distance * (1.0 - lowered);
        let depth = lamp.radius.powi(2) - (distance * across).powi(2);
        let reach = along - depth.max(0.0).sqrt();
        if self.kernel.occluded(point, direction, 0.0, reach) {
            return (0.0, direction);
        }
        (here * TAU * opening, direction)
    }
}

/// The varnish at one point, as one direction looks at it.
#[derive(Clone, Copy)]
struct Gloss {
    varnish: Varnish,
    normal: Vec3,
    to_eye: Vec3,
}

impl Gloss {
    fn value(&self, to_light: Vec3) -> f32 {
        self.varnish.value(self.normal, self.to_eye, to_light)
    }

    /// Where the path goes on, by base or lobe, and what it carries on in each channel.
    fn go_on(&self, albedo: &[f32; 3], sampler: &mut Sampler) -> Option<(Vec3, [f32; 3])> {
        let base = albedo.iter().copied().fold(0.0, f32::max);
        let lobe = self.varnish.weight / (self.varnish.weight + base).max(1e-6);
        let way = if sampler.next().x < lobe {
            self.varnish.direction(self.normal, self.to_eye, sampler.next())
        } else {
            cosine_direction(self.normal, sampler.next())
        };
        let cos = self.normal.dot(way);
        if cos <= 0.0 {
            return None;
        }
        let chance = lobe * self.varnish.chance(self.normal, self.to_eye, way) + (1.0 - lobe) * cos / PI;
        let shine = self.value(way);
        Some((way, albedo.map(|a| (a / PI + shine) * cos / chance.max(1e-12))))
    }
}

fn accumulate(sum: &mut [f32; 3], throughput: &[f32; 3], light: &[f32; 3], factor: f32) {
    for k in 0..3 {
        sum[k] += throughput[k] * light[k] * factor;
    }
}

/// A direction with density cosine over pi about a normal.
pub(super) fn cosine_direction(normal: Vec3, u: Vec2) -> Vec3 {
    let (side, other) = normal.any_orthonormal_pair();
    let (sin, cos) = (TAU * u.y).sin_cos();
    let radius = u.x.sqrt();
    ((side * cos + other * sin) * radius + normal * (1.0 - u.x).max(1e-12).sqrt()).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(half: f32, z: f32) -> Mesh {
        let corner = |x: f32, y: f32| Vec3::new(x * half, y * half, z);
        Mesh {
            name: "square".into(),
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            uvs: vec![Vec2::splat(0.5)],
            uv_triangles: vec![[0; 3]; 2],
        }
    }

    /// An icosphere's worth of facets about the origin: a latitude-longitude sphere.
    fn sphere(n: usize) -> Mesh {
        let mut mesh = Mesh { uvs: vec![Vec2::splat(0.5)], ..Mesh::default() };
        for j in 0..=n {
            for i in 0..2 * n {
                let (st, ct) = (PI * j as f32 / n as f32).sin_cos();
                let (sp, cp) = (PI * i as f32 / n as f32).sin_cos();
                mesh.positions.push(Vec3::new(st * cp, st * sp, ct));
            }
        }
        let at = |i: usize, j: usize| (j * 2 * n + i % (2 * n)) as u32;
        for j in 0..n {
            for i in 0..2 * n {
                mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i + 1, j)]);
                mesh.triangles.push([at(i, j), at(i, j + 1), at(i + 1, j + 1)]);
            }
        }
        mesh.uv_triangles = vec![[0; 3]; mesh.triangles.len()];
        mesh
    }

    fn mean(tracer: &Tracer, direction: Vec3, ring: Option<&Ring>, n: u32) -> Seen {
        let mut sum = Seen::default();
        for index in 0..n {
            let mut sampler = Sampler::new(3, index);
            let ring = ring.map(|r| (r, &DAffine3::IDENTITY));
            sum.add(&tracer.trace(Vec3::ZERO, direction, ring, true, &mut sampler), 1.0 / n as f32);
        }
        sum
    }

    #[test]
    fn white_square_under_the_ring_has_the_radiance_of_the_closed_form() {
        let surface = Surface {
            mesh: square(0.5, 1.0),
            reflectance: Texture::plain(0.94),
            emission: [0.0; 3],
            varnish: None,
        };
        let tracer = Tracer::new(vec![surface], vec![], [0.0; 3]);
        let ring = Ring { inner: 0.010, outer: 0.100, radiance: [60.0; 3] };
        let seen = mean(&tracer, Vec3::Z, Some(&ring), 4096);
        assert!((seen.flash[1] - 0.5528).abs() < 2e-4, "{}", seen.flash[1]);
        assert_eq!(seen.ambient, [0.0; 3]);
        assert_eq!(seen.object, 1.0);
    }

    #[test]
    fn closed_glowing_sphere_sums_all_its_bounces() {
        for rho in [0.5, 0.8] {
            let surface = Surface {
                mesh: sphere(24),
                reflectance: Texture::plain(rho),
                emission: [1.0, 2.0, 0.5],
                varnish: None,
            };
            let tracer = Tracer::new(vec![surface], vec![], [0.0; 3]);
            let seen = mean(&tracer, Vec3::new(0.3, 0.5, 0.7), None, 4096);
            let expected = 1.0 / (1.0 - rho);
            assert!((seen.ambient[0] / expected - 1.0).abs() < 0.01, "{} for {expected}", seen.ambient[0]);
            assert!((seen.ambient[1] / expected - 2.0).abs() < 0.02);
        }
    }

    #[test]
    fn plane_under_a_spherical_lamp_obeys_the_inverse_square_of_its_centre() {
        // A sphere above the horizon gives exactly pi L (r/d)^2 cos, whatever its size.
        let surface = Surface {
            mesh: square(2.0, 1.0),
            reflectance: Texture::plain(0.6),
            emission: [0.0; 3],
            varnish: None,
        };
        let lamp = Lamp { centre: Vec3::new(0.4, 0.3, -0.2), radius: 0.15, radiance: [7.0; 3] };
        let tracer = Tracer::new(vec![surface], vec![lamp], [0.0; 3]);
        let seen = mean(&tracer, Vec3::Z, None, 4096);
        let way = lamp.centre - Vec3::Z;
        let expected = 0.6 * 7.0 * 0.15_f32.powi(2) / way.length_squared() * (1.2 / way.length());
        assert!((seen.ambient[2] / expected - 1.0).abs() < 1e-3, "{} for {expected}", seen.ambient[2]);
    }

    #[test]
    fn even_glow_on_a_lone_plane_returns_its_reflectance() {
        let surface = Surface {
            mesh: square(2.0, 1.0),
            reflectance: Texture::plain(0.3),
            emission: [0.0; 3],
            varnish: None,
        };
        let tracer = Tracer::new(vec![surface], vec![], [2.0; 3]);
        let seen = mean(&tracer, Vec3::Z, None, 64);
        assert!((seen.ambient[0] - 0.6).abs() < 1e-3, "{}", seen.ambient[0]);
    }

    #[test]
    fn a_varnished_closed_sphere_of_even_light_sends_back_what_both_lobes_reflect() {
        // Inside an even glow every lobe returns its directional albedo, whatever way the path goes on.
        let varnish = Varnish { weight: 0.2, alpha: 0.4 };
        let surface = Surface {
            mesh: square(40.0, 1.0),
            reflectance: Texture::plain(0.3),
            emission: [0.0; 3],
            varnish: Some(varnish),
        };
        let tracer = Tracer::new(vec![surface], vec![], [1.0; 3]);
        let seen = mean(&tracer, Vec3::Z, None, 1 << 14);
        // The lobe's share at normal view, by a Monte Carlo integration outside of this program.
        assert!((seen.ambient[0] - 0.3 - 0.2 * 0.786).abs() < 0.003, "{}", seen.ambient[0]);
    }

    #[test]
    fn a_highlight_under_the_ring_has_the_radiance_of_its_closed_form() {
        // Small ring: the half vector is the normal, so the lobe adds weight D(0) / 4 times the irradiance.
        let varnish = Varnish { weight: 0.1, alpha: 0.3 };
        let ring = Ring { inner: 0.0, outer: 0.002, radiance: [1.0; 3] };
        let shone = |varnish| {
            let surface = Surface {
                mesh: square(0.5, 1.0),
                reflectance: Texture::plain(0.5),
                emission: [0.0; 3],
                varnish,
            };
            let tracer = Tracer::new(vec![surface], vec![], [0.0; 3]);
            mean(&tracer, Vec3::Z, Some(&ring), 256).flash[0]
        };
        let (matt, glossy) = (shone(None), shone(Some(varnish)));
        let expected = 1.0 + 0.1 / (PI * 0.09) / 4.0 / (0.5 / PI);
        assert!((glossy / matt / expected - 1.0).abs() < 1e-3, "{} for {expected}", glossy / matt);
    }

    #[test]
    fn without_bounces_a_closed_sphere_shows_its_first_light_alone() {
        let surface =
            Surface { mesh: sphere(24), reflectance: Texture::plain(0.5), emission: [1.0; 3], varnish: None };
        let tracer = Tracer::new(vec![surface], vec![], [0.0; 3]).without_bounces();
        let seen = mean(&tracer, Vec3::new(0.3, 0.5, 0.7), None, 64);
        assert!((seen.ambient[0] - 1.0).abs() < 1e-5, "{}", seen.ambient[0]);
    }
}
