//! The white card of the calibration shots, in closed form but for one angle.
//!
//! A flat Lambertian card faces the camera at a known distance, fills the frame, in a dark room. Irradiance of a
//! point `s` off the axis from a ring of radiance L in a parallel plane at distance d: the integral over the ring
//! of L cos^2 / r^2, which is L d^2 times the integral of dA / (d^2 + |a - s|^2)^2.

use super::path::Ring;
use crate::raster::Rgb;
use crate::scene::Intrinsics;
use std::f64::consts::{PI, TAU};

/// Reflectance of the card.
pub(super) const REFLECTANCE: f64 = 0.94;

/// Steps across and round the ring; the integrand is smooth, so midpoints suffice.
const ACROSS: usize = 32;
const ROUND: usize = 64;
/// Steps from the axis to the corner; linear between them.
const STEPS: usize = 256;

/// Radiance of a card at `distance` metres from the lens along the axis, by the flash at nominal energy.
pub(super) fn radiance(ring: &Ring, intrinsics: &Intrinsics, distance: f64) -> Rgb {
    let offset = |x: usize, y: usize| {
        let dx = (x as f64 + 0.5 - intrinsics.principal.x) / intrinsics.focal.x;
        let dy = (y as f64 + 0.5 - intrinsics.principal.y) / intrinsics.focal.y;
        dx.hypot(dy) * distance
    };
    let (width, height) = (intrinsics.width, intrinsics.height);
    let reach = [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)]
        .into_iter()
        .map(|(x, y)| offset(x, y))
        .fold(1e-9, f64::max);
    let table: Vec<f64> =
        (0..=STEPS + 1).map(|i| form(ring, distance, reach * i as f64 / STEPS as f64)).collect();
    Rgb::from_fn(width, height, |x, y| {
        let place = offset(x, y) / reach * STEPS as f64;
        let (i, f) = (place as usize, place.fract());
        let factor = REFLECTANCE / PI * (table[i] * (1.0 - f) + table[i + 1] * f);
        ring.radiance.map(|l| (factor * f64::from(l)) as f32)
    })
}

/// Irradiance over radiance at `s` metres off the axis of a ring `d` metres away.
fn form(ring: &Ring, d: f64, s: f64) -> f64 {
    let (inner, outer) = (f64::from(ring.inner).powi(2), f64::from(ring.outer).powi(2));
    let mut sum = 0.0;
    for i in 0..ACROSS {
        let a = (inner + (i as f64 + 0.5) / ACROSS as f64 * (outer - inner)).sqrt();
        for j in 0..ROUND {
            let angle = TAU * (j as f64 + 0.5) / ROUND as f64;
            let square = d * d + a * a + s * s - 2.0 * a * s * angle.cos();
            sum += 1.0 / (square * square);
        }
    }
    d * d * sum * PI * (outer - inner) / (ACROSS * ROUND) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centre_of_the_card_has_the_radiance_of_the_closed_form() {
        let ring = Ring { inner: 0.010, outer: 0.100, radiance: [60.0; 3] };
        assert!((REFLECTANCE / PI * 60.0 * form(&ring, 1.0, 0.0) - 0.5528).abs() < 1e-4);
    }

    #[test]
    fn the_corner_of_a_far_card_falls_by_the_fourth_power_of_the_cosine() {
        let ring = Ring { inner: 0.001, outer: 0.002, radiance: [1.0; 3] };
        let (d, s) = (2.0, 1.3);
        let cos = d / f64::hypot(d, s);
        assert!((form(&ring, d, s) / form(&ring, d, 0.0) / cos.powi(4) - 1.0).abs() < 1e-4);
    }
}
