//! The sides of a tag's black square, point by point.
//!
//! Across a side the light goes from black inside to white paper outside. Between an inner and an outer end at the
//! distance r from where the side is looked for, the side lies at `r - integral of (light - black) / (white - black)`
//! from there: exact for any symmetric blur that ends within r, and for white and black that are read at the ends of a
//! wider one, once the middle is the side itself. So it is looked for twice, the second time about a parabola through
//! the first points, which the lens's distortion may ask for.

use super::{Grey, TagError};
use crate::calibration::linear::Normal;
use crate::codec::apriltag::Tag;
use crate::raster::sample::bilinear;
use glam::DVec2;

/// Bits across the black square.
const BITS: f64 = 8.0;

/// Ends of the profile, as a share of a bit, and at most, pixels.
const REACH: (f64, f64) = (0.5, 6.0);

/// Share of a side that is left out at either end, where its neighbour's blur reaches.
const ENDS: f64 = 0.1;

/// Distance of points along a side, pixels; nearer ones would share their noise.
const STEP: f64 = 2.0;

/// Fewest and most points along a side.
const POINTS: (f64, f64) = (8.0, 80.0);

/// Steps of a profile per pixel.
const FINE: f64 = 4.0;

/// Share of white by which black must be darker.
const LEAST_CONTRAST: f32 = 0.3;

/// Share of the points that must be found.
const LEAST_FOUND: f64 = 0.7;

/// Points on the four sides (from corner k to the next), pixels of the grey picture.
pub(super) fn sides(grey: &Grey, tag: &Tag) -> Result<[Vec<DVec2>; 4], TagError> {
    let corners = tag.corners;
    let lengths: [f64; 4] = std::array::from_fn(|k| corners[k].distance(corners[(k + 1) % 4]));
    let reach = (REACH.0 * lengths.iter().copied().fold(f64::INFINITY, f64::min) / BITS).min(REACH.1);
    let mut out = [const { vec![] }; 4];
    for k in 0..4 {
        let (from, to) = (corners[k], corners[(k + 1) % 4]);
        // Clockwise on a picture whose y goes down, so the left hand is outside.
        let outward = -(to - from).perp().normalize_or_zero();
        let count = (lengths[k] * (1.0 - 2.0 * ENDS) / STEP).clamp(POINTS.0, POINTS.1).round();
        let along: Vec<f64> =
            (0..count as usize).map(|i| ENDS + (1.0 - 2.0 * ENDS) * (i as f64 + 0.5) / count).collect();
        let look = |s: f64, about: f64| {
            let place = from.lerp(to, s);
            match crossing(grey, place + about * outward, outward, reach) {
                Crossing::At(off) => Some((s, about + off)),
                Crossing::None | Crossing::Clipped => None,
            }
        };
        let clipped = along
            .iter()
            .filter(|s| matches!(crossing(grey, from.lerp(to, **s), outward, reach), Crossing::Clipped))
            .count();
        if clipped as f64 > (1.0 - LEAST_FOUND) * count {
            return Err(TagError::Clipped(tag.id));
        }
        let first: Vec<(f64, f64)> = along.iter().filter_map(|s| look(*s, 0.0)).collect();
        let curve = parabola(&first).ok_or(TagError::Blurred(tag.id))?;
        let second: Vec<(f64, f64)> = along.iter().filter_map(|s| look(*s, curve(*s))).collect();
        if (second.len() as f64) < LEAST_FOUND * count {
            return Err(TagError::Blurred(tag.id));
        }
        out[k] = second.into_iter().map(|(s, off)| from.lerp(to, s) + off * outward).collect();
    }
    Ok(out)
}

enum Crossing {
    /// From the middle outwards, pixels.
    At(f64),
    None,
    Clipped,
}

/// Where light crosses from black to white along a profile.
fn crossing(grey: &Grey, middle: DVec2, outward: DVec2, reach: f64) -> Crossing {
    let steps = (2.0 * reach * FINE).ceil().max(8.0);
    let count = steps as usize + 1;
    let mut profile = Vec::with_capacity(count);
    let (width, height) = (grey.image.width() as f64, grey.image.height() as f64);
    for i in 0..count {
        let p = middle + outward * (2.0 * reach * i as f64 / steps - reach);
        if p.min_element() < 0.5 || p.x > width - 0.5 || p.y > height - 0.5 {
            return Crossing::None;
        }
        let Some([value]) = bilinear(&grey.image, p.x as f32, p.y as f32) else { return Crossing::None };
        profile.push(value);
    }
    let end = (count / 6).max(1);
    let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
    let (black, white) = (mean(&profile[..end]), mean(&profile[count - end..]));
    if white >= grey.ceiling {
        return Crossing::Clipped;
    }
    if white - black < LEAST_CONTRAST * white {
        return Crossing::None;
    }
    let share = |v: f32| f64::from((v - black) / (white - black));
    let ends = (share(profile[0]) + share(profile[count - 1])) / 2.0;
    let sum = profile.iter().map(|v| share(*v)).sum::<f64>() - ends;
    let off = reach - sum * 2.0 * reach / steps;
    if off.abs() < reach { Crossing::At(off) } else { Crossing::None }
}

/// The parabola through points by least squares.
fn parabola(points: &[(f64, f64)]) -> Option<impl Fn(f64) -> f64 + use<>> {
    let mut normal = Normal::zero(3);
    for (s, off) in points {
        let t = s - 0.5;
        normal.add(&[1.0, t, t * t], *off, 1.0);
    }
    let (x, _) = normal.solve()?;
    Some(move |s: f64| {
        let t = s - 0.5;
        x[0] + t * (x[1] + t * x[2])
    })
}
