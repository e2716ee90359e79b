//! A glossy varnish over a Lambertian base.
//!
//! A single lobe of microfacets after Walter, Marschner, Li and Torrance, "Microfacet Models for Refraction
//! through Rough Surfaces" (EGSR 2007): GGX distribution, Smith's separable masking, no Fresnel term, the same in
//! all channels. `f = weight D G / (4 cos cos')` is added to the base's `rho / pi`; the base is not dimmed, so
//! that the truth is the base's own reflectance and `weight` is the share of light that the lobe sends back
//! (less what single scattering loses: 3 % at a width of 0.15, 8 % at 0.25, 22 % at 0.4).

use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// The lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::studio) struct Varnish {
    /// Share of the light that it reflects, 0 to 1.
    pub(in crate::studio) weight: f32,
    /// Width of the GGX distribution (in renderers that ask for a "roughness", often its square).
    pub(in crate::studio) alpha: f32,
}

impl Varnish {
    /// Value of the lobe, 1/sr, for unit directions away from the surface.
    pub(super) fn value(&self, normal: Vec3, to_eye: Vec3, to_light: Vec3) -> f32 {
        let (eye, light) = (normal.dot(to_eye), normal.dot(to_light));
        if eye <= 0.0 || light <= 0.0 {
            return 0.0;
        }
        let half = (to_eye + to_light).normalize_or_zero();
        let shape = self.density(normal.dot(half)) * self.passed(eye) * self.passed(light);
        self.weight * shape / (4.0 * eye * light)
    }

    /// Density per steradian with which [`Varnish::direction`] gives `to_light`.
    pub(super) fn chance(&self, normal: Vec3, to_eye: Vec3, to_light: Vec3) -> f32 {
        let half = (to_eye + to_light).normalize_or_zero();
        let (tilt, turn) = (normal.dot(half), to_eye.dot(half));
        if tilt <= 0.0 || turn <= 0.0 { 0.0 } else { self.density(tilt) * tilt / (4.0 * turn) }
    }

    /// `to_eye` mirrored in a microfacet drawn with density D cos; may point below the surface.
    pub(super) fn direction(&self, normal: Vec3, to_eye: Vec3, u: Vec2) -> Vec3 {
        let square = self.alpha * self.alpha;
        let cos = ((1.0 - u.x) / (1.0 + (square - 1.0) * u.x)).max(0.0).sqrt();
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let (side, other) = normal.any_orthonormal_pair();
        let (sp, cp) = (TAU * u.y).sin_cos();
        let half = (side * cp + other * sp) * sin + normal * cos;
        (2.0 * to_eye.dot(half) * half - to_eye).normalize_or(normal)
    }

    /// GGX: density of microfacet normals per steradian and unit area.
    fn density(&self, tilt: f32) -> f32 {
        if tilt <= 0.0 {
            return 0.0;
        }
        let square = self.alpha * self.alpha;
        let d = tilt * tilt * (square - 1.0) + 1.0;
        square / (PI * d * d)
    }

    /// Smith's share of microfacets that a direction at this cosine sees.
    fn passed(&self, cos: f32) -> f32 {
        let square = self.alpha * self.alpha;
        2.0 * cos / (cos + (square + (1.0 - square) * cos * cos).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studio::world::sampler::Sampler;

    #[test]
    fn directions_are_drawn_with_the_chance_that_is_told_and_the_lobe_reflects_its_weight() {
        let to_eye = Vec3::new(0.3, 0.1, 0.9).normalize();
        // Shares by a Monte Carlo integration outside of this program.
        for (alpha, share) in [(0.15, 0.970), (0.4, 0.782)] {
            let varnish = Varnish { weight: 0.2, alpha };
            // Light that the lobe sends back, by its own directions and by even ones: both must agree.
            let (mut own, mut even) = (0.0, 0.0);
            let n = 1 << 16;
            for i in 0..n {
                let mut sampler = Sampler::new(9, i);
                let way = varnish.direction(Vec3::Z, to_eye, sampler.next());
                let chance = varnish.chance(Vec3::Z, to_eye, way);
                if way.z > 0.0 && chance > 0.0 {
                    own += varnish.value(Vec3::Z, to_eye, way) * way.z / chance;
                }
                let u = sampler.next();
                let across = (1.0 - u.x * u.x).sqrt();
                let way = Vec3::new(across * (TAU * u.y).cos(), across * (TAU * u.y).sin(), u.x);
                even += varnish.value(Vec3::Z, to_eye, way) * way.z * TAU;
            }
            let (own, even) = (own / n as f32, even / n as f32);
            assert!((own / even - 1.0).abs() < 0.01, "{own} {even}");
            assert!((own / 0.2 - share).abs() < 0.01, "{own} at {alpha}");
        }
    }
}
