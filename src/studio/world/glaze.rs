//! Reflectances of the photographed object and of the floor, as functions of the place.
//!
//! Camera RGB, clamped to 0.05..0.85 when painted. Every function is continuous, so that a texel does not hang on
//! the last bit of a coordinate, and its finest lines are some 4 mm wide, about two pixels of the photographs.

use super::bowl::ease;
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// A smooth wave between 0 and 1 with the given period.
fn wave(x: f64, period: f64) -> f64 {
    0.5 + 0.5 * (TAU * x / period).sin()
}

/// A smooth stain between 0 and 1, `scale` metres across, that does not repeat within the scene.
fn stain(p: DVec3, scale: f64) -> f64 {
    let q = p / scale;
    let a = (q.dot(DVec3::new(2.1, 1.3, -0.7)) + 1.1 * (q.dot(DVec3::new(-0.9, 1.7, 1.9))).sin()).sin();
    let b = (q.dot(DVec3::new(-1.2, 2.3, 1.6)) + 1.4 * (q.dot(DVec3::new(1.8, 0.4, -1.3))).sin()).sin();
    let c = (q.dot(DVec3::new(3.7, -2.9, 3.1)) + 0.9 * (q.dot(DVec3::new(2.6, 3.3, 0.8))).sin()).sin();
    (0.5 + 0.25 * a + 0.17 * b + 0.08 * c).clamp(0.0, 1.0)
}

/// Dark specks between 0 (none) and 1.
fn specks(p: DVec3, scale: f64) -> f64 {
    ease(0.70, 0.82, stain(p, scale))
}

fn rgb(r: f64, g: f64, b: f64) -> DVec3 {
    DVec3::new(r, g, b)
}

/// The plinth: grey stone with veins.
pub(super) fn stone(p: DVec3, _: DVec2) -> DVec3 {
    let base = rgb(0.40, 0.38, 0.36).lerp(rgb(0.58, 0.56, 0.50), stain(p, 0.03));
    let vein = 1.0 - ease(0.0, 0.035, (stain(p + DVec3::new(0.3, 0.1, 0.2), 0.045) - 0.5).abs());
    let veined = base.lerp(rgb(0.80, 0.77, 0.70), 0.8 * vein);
    veined.lerp(rgb(0.14, 0.13, 0.13), 0.7 * specks(p, 0.006))
}

/// The bowl's outside: cream ware with cobalt bands, a zigzag and an ochre belt.
pub(super) fn ware(p: DVec3, _: DVec2) -> DVec3 {
    let angle = p.y.atan2(p.x);
    let cream = rgb(0.80, 0.76, 0.66).lerp(rgb(0.70, 0.66, 0.55), stain(p, 0.02));
    let cobalt = rgb(0.07, 0.13, 0.42);
    let near = |height: f64, half: f64| 1.0 - ease(half, half + 0.0015, (p.z - height).abs());
    // A zigzag that closes after the full turn: nine teeth.
    let turn = (9.0 * angle / TAU).rem_euclid(1.0);
    let tooth = 4.0 * (turn - 0.5).abs() - 1.0;
    let zigzag = 1.0 - ease(0.0035, 0.0055, (p.z - 0.205 - 0.016 * tooth).abs());
    let lines = near(0.178, 0.002).max(near(0.232, 0.002)).max(near(0.270, 0.004)).max(zigzag);
    let ochre = rgb(0.62, 0.38, 0.12).lerp(rgb(0.50, 0.25, 0.08), wave(angle, TAU / 60.0));
    let foot = rgb(0.45, 0.20, 0.12).lerp(rgb(0.60, 0.30, 0.18), stain(p, 0.008));
    let belt = near(0.251, 0.008);
    let painted = cream.lerp(ochre, belt).lerp(cobalt, lines);
    painted.lerp(foot, 1.0 - ease(0.136, 0.140, p.z))
}

/// The bowl's rim: brown with a pale dot now and then.
pub(super) fn rim(p: DVec3, _: DVec2) -> DVec3 {
    let angle = p.y.atan2(p.x);
    rgb(0.28, 0.15, 0.08).lerp(rgb(0.72, 0.62, 0.42), ease(0.6, 0.8, wave(angle, TAU / 36.0)))
}

/// The bowl's inside: turquoise with cream petals and a dark star at the bottom.
pub(super) fn well(p: DVec3, _: DVec2) -> DVec3 {
    let (angle, radius) = (p.y.atan2(p.x), p.x.hypot(p.y));
    let turquoise = rgb(0.10, 0.50, 0.48).lerp(rgb(0.18, 0.62, 0.52), stain(p, 0.025));
    let cream = rgb(0.82, 0.78, 0.70);
    let petal = radius - 0.085 - 0.045 * (4.5 * angle).cos().powi(2);
    let outline = 1.0 - ease(0.002, 0.004, petal.abs());
    let inner = ease(0.001, -0.001, petal) * ease(0.4, 0.6, wave(radius, 0.012)) * ease(0.03, 0.05, radius);
    let star = ease(0.002, -0.002, radius - 0.022 - 0.010 * (5.0 * angle).cos());
    turquoise.lerp(cream, outline.max(0.75 * inner)).lerp(rgb(0.10, 0.08, 0.20), star)
}

/// A red egg with a wavy girdle.
pub(super) fn egg_red(p: DVec3, _: DVec2) -> DVec3 {
    let girdle = 1.0 - ease(0.003, 0.005, (p.z - 0.192 - 0.004 * (300.0 * p.x).sin()).abs());
    rgb(0.66, 0.12, 0.08).lerp(rgb(0.82, 0.70, 0.45), girdle)
}

/// A pale, speckled egg.
pub(super) fn egg_pale(p: DVec3, _: DVec2) -> DVec3 {
    rgb(0.80, 0.80, 0.74).lerp(rgb(0.25, 0.18, 0.12), specks(p, 0.004))
}

/// A dark green egg.
pub(super) fn egg_dark(p: DVec3, _: DVec2) -> DVec3 {
    rgb(0.07, 0.15, 0.09).lerp(rgb(0.16, 0.30, 0.14), stain(p, 0.01))
}

/// The floor: planks 12 cm wide along x, with joints and grain.
pub(super) fn planks(p: DVec3, _: DVec2) -> DVec3 {
    let across = (p.y / 0.12 + 0.5 * (std::f64::consts::PI * p.y / 0.12).sin().powi(2)) * 0.12;
    let joint = 1.0 - ease(0.0, 0.08, (std::f64::consts::PI * p.y / 0.12).sin().abs());
    let grain = wave(across + 0.02 * stain(p * DVec3::new(0.15, 1.0, 1.0), 0.05), 0.017);
    let tone = stain(DVec3::new(p.x * 0.2, p.y, 0.4), 0.09);
    let wood = rgb(0.34, 0.21, 0.12).lerp(rgb(0.52, 0.35, 0.20), 0.45 * grain + 0.55 * tone);
    wood.lerp(rgb(0.09, 0.06, 0.05), 0.85 * joint)
}
