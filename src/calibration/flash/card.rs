//! Shots of the card, each reduced to means over small cells as soon as it is read.

use super::FieldFactor;
use crate::calibration::flat::FlatField;
use crate::calibration::tiles::STRAY;
use crate::light::Ring;
use crate::photometry::{Cfa, IsolateError, Mosaic, NoiseModel, linear};
use crate::scene::{Camera, Intrinsics};
use glam::{DAffine3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Cells across the frame.
const ACROSS: usize = 60;

/// Fewest sites per edge of a cell.
const LEAST_EDGE: usize = 8;

/// Where the card was: a plane in the camera's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plane {
    /// A point of it, metres.
    #[serde(rename = "point_m")]
    pub point: DVec3,
    /// Its unit normal, towards the camera.
    pub normal: DVec3,
}

/// What the card reflects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Reflectance factor under light and view along the normal, 0 to 1.
    pub reflectance: f64,
    /// How it falls where light and view come from nearly one direction: angle from the normal in radians, rising, and
    /// the factor by which `reflectance` is multiplied; straight lines between. Empty: alike under all angles
    /// (Lambertian).
    #[serde(default)]
    pub curve: Vec<[f64; 2]>,
}

/// Means over a cell of one shot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Its centre, pixels.
    pub centre: DVec2,
    /// Known light, DN, red green blue.
    pub value: [f64; 3],
    /// With what shot noise goes: lit frame, and unlit frame times the square of its factor, DN.
    pub signal: [f64; 3],
    /// Sites of each colour.
    pub sites: [f64; 3],
}

/// One shot of the card, of which only the flash's light is left.
#[derive(Clone, Debug, PartialEq)]
pub struct CardShot {
    /// File name, for reports.
    pub label: String,
    /// Where the card was.
    pub plane: Plane,
    /// Width and height of the frame, sites.
    pub size: (usize, usize),
    /// The filter array.
    pub cfa: Cfa,
    /// Sites per edge of a cell; 0 if cells are points.
    pub edge: usize,
    /// Cells without clipped sites, but for a stray one.
    pub cells: Vec<Cell>,
    /// How often the sensor's variance without light is in a value: 1, and the unlit frame's factor squared.
    pub floors: f64,
    /// Share of cells that clipping took.
    pub clipped: f64,
    /// Energy of its pulse in the flash controller's counts, where it was measured.
    pub energy_counts: Option<f64>,
    /// Kept from the fit, to check it.
    pub held_out: bool,
}

impl Plane {
    /// A card that stands square to the lens's axis, `distance` metres from the centre of projection.
    pub fn facing(distance: f64) -> Self {
        Self { point: distance * DVec3::Z, normal: -DVec3::Z }
    }

    /// Distance along the axis, metres.
    pub fn distance(&self) -> f64 {
        self.point.dot(self.normal) / self.normal.z
    }

    /// Where a ray from the lens meets its front.
    pub(in crate::calibration) fn meets(&self, ray: DVec3) -> Option<DVec3> {
        let slant = ray.dot(self.normal);
        let far = self.point.dot(self.normal) / slant;
        (slant < 0.0 && far > 0.0 && far.is_finite()).then(|| far * ray)
    }
}

impl Target {
    /// A card that reflects alike under all angles.
    pub fn lambertian(reflectance: f64) -> Self {
        Self { reflectance, curve: vec![] }
    }

    /// Reflectance factor at a cosine of the angle from the normal.
    fn towards(&self, cosine: f64) -> f64 {
        let angle = cosine.clamp(-1.0, 1.0).acos();
        let after = self.curve.partition_point(|[a, _]| *a < angle);
        let factor = match (after.checked_sub(1).and_then(|i| self.curve.get(i)), self.curve.get(after)) {
            (Some([a, f]), Some([b, g])) => f + (g - f) * (angle - a) / (b - a),
            (Some([_, f]), None) | (None, Some([_, f])) => *f,
            (None, None) => 1.0,
        };
        self.reflectance * factor
    }
}

impl CardShot {
    /// Takes out by what the colours' vignettings differ, so that one field holds for all colours.
    pub fn even_colours(&mut self, vignetting: &FlatField) {
        for cell in &mut self.cells {
            for c in 0..3 {
                cell.value[c] /= vignetting.over_mean(self.size, cell.centre, c);
            }
        }
    }

    /// Means of a lit frame's cells, less `ratio` times those of an unlit one where the room was not dark.
    pub fn reduce(
        label: String,
        plane: Plane,
        on: &Mosaic,
        off: Option<(&Mosaic, f64)>,
    ) -> Result<Self, IsolateError> {
        let size = (on.dn.width(), on.dn.height());
        if let Some((off, _)) = off {
            let other = (off.dn.width(), off.dn.height());
            if other != size {
                return Err(IsolateError::Size { on: size, off: other });
            }
            if off.cfa != on.cfa {
                return Err(IsolateError::Cfa);
            }
        }
        let edge = (2 * size.0.div_ceil(2 * ACROSS)).max(LEAST_EDGE);
        let square = off.map_or(0.0, |(_, ratio)| ratio * ratio);
        let (mut cells, mut all) = (vec![], 0usize);
        for y in (0..(size.1 + 1).saturating_sub(edge)).step_by(edge) {
            for x in (0..(size.0 + 1).saturating_sub(edge)).step_by(edge) {
                all += 1;
                cells.extend(cell(on, off, (x, y), edge));
            }
        }
        let clipped = if all > 0 { 1.0 - cells.len() as f64 / all as f64 } else { 1.0 };
        Ok(Self {
            label,
            plane,
            size,
            cfa: on.cfa,
            edge,
            cells,
            floors: 1.0 + square,
            clipped,
            energy_counts: None,
            held_out: false,
        })
    }
}

/// One cell; `None` if more of it is clipped than stray sites are.
fn cell(on: &Mosaic, off: Option<(&Mosaic, f64)>, first: (usize, usize), edge: usize) -> Option<Cell> {
    let (mut value, mut signal, mut sites) = ([0.0; 3], [0.0; 3], [0.0f64; 3]);
    let mut clipped = 0;
    for y in first.1..first.1 + edge {
        for x in first.0..first.0 + edge {
            let c = on.cfa.colour(x, y);
            let room = off.map_or(Some((0.0, 0.0)), |(off, ratio)| Some((linear(off, x, y)?.into(), ratio)));
            let (Some(lit), Some((room, ratio))) = (linear(on, x, y).map(f64::from), room) else {
                clipped += 1;
                continue;
            };
            value[c] += lit - ratio * room;
            signal[c] += lit + ratio * ratio * room;
            sites[c] += 1.0;
        }
    }
    if f64::from(clipped) > STRAY * (edge * edge) as f64 {
        return None;
    }
    let mean = |sum: [f64; 3]| -> [f64; 3] { std::array::from_fn(|c| sum[c] / sites[c].max(1.0)) };
    let centre = DVec2::new(first.0 as f64, first.1 as f64) + edge as f64 / 2.0;
    Some(Cell { centre, value: mean(value), signal: mean(signal).map(|s| s.max(0.0)), sites })
}

/// A cell as the model needs it.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    /// (r / half diagonal)^2.
    pub(super) q: f64,
    /// On the card, camera frame, metres.
    pub(super) point: DVec3,
    /// Reflectance factor over pi.
    pub(super) target: f64,
    /// Known light at the centre, DN.
    pub(super) value: [f64; 3],
    /// Its variance by the sensor's noise, DN^2.
    pub(super) variance: [f64; 3],
}

/// A shot as the model needs it.
#[derive(Clone, Debug)]
pub(super) struct SeenShot {
    pub(super) cells: Vec<Seen>,
    pub(super) normal: DVec3,
    /// Along the axis, metres.
    pub(super) distance: f64,
    /// Of its pulse, the mean being 1; 1 where it is not known.
    pub(super) energy: f64,
}

/// What all shots of a series share.
pub(super) struct Setting<'a> {
    pub(super) intrinsics: &'a Intrinsics,
    pub(super) ring: Ring,
    pub(super) target: &'a Target,
    pub(super) noise: NoiseModel,
}

impl Setting<'_> {
    /// Lays a shot's cells out on the card. The mean over a colour's sites in a cell, which lie a little aside of its
    /// centre, is brought to the centre by the model at the ruler's values.
    pub(super) fn see(&self, shot: &CardShot, energy: f64) -> SeenShot {
        let camera = Camera {
            name: String::new(),
            intrinsics: *self.intrinsics,
            world_from_camera: DAffine3::IDENTITY,
        };
        let normal = shot.plane.normal;
        let look = |pixel: DVec2| {
            let point = shot.plane.meets(camera.ray(pixel))?;
            let target = self.target.towards(-normal.dot(point) / point.length()) / PI;
            let light = self.ring.irradiance(point, normal) * target;
            (light > 0.0).then_some((point, target, light))
        };
        // Four points of equal weight have a square's mean to the third order.
        let reach = shot.edge as f64 / 12f64.sqrt();
        let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
        let shifts: [DVec2; 3] = std::array::from_fn(|c| shot.cfa.aside(c).into());
        let seen = |cell: &Cell| {
            let (point, target, light) = look(cell.centre)?;
            let (mut value, mut variance) = (cell.value, [0.0; 3]);
            for c in 0..3 {
                if shot.edge > 0 {
                    let mut mean = 0.0;
                    for (x, y) in corners {
                        mean += look(cell.centre + shifts[c] + reach * DVec2::new(x, y))?.2 / 4.0;
                    }
                    value[c] *= light / mean;
                }
                let floor = f64::from(self.noise.floor) * shot.floors;
                variance[c] = (f64::from(self.noise.gain) * cell.signal[c] + floor) / cell.sites[c];
            }
            let sound = variance.iter().all(|v| v.is_finite() && *v > 0.0);
            let q = field_q(self.intrinsics, cell.centre);
            sound.then_some(Seen { q, point, target, value, variance })
        };
        let cells = shot.cells.iter().filter_map(seen).collect();
        SeenShot { cells, normal, distance: shot.plane.distance(), energy }
    }
}

impl FieldFactor {
    /// Factor at a pixel position.
    pub fn at(&self, intrinsics: &Intrinsics, pixel: DVec2) -> f64 {
        self.at_q(field_q(intrinsics, pixel))
    }

    pub(super) fn at_q(&self, q: f64) -> f64 {
        let [a, b, c] = self.coefficients;
        1.0 + q * (a + q * (b + q * c))
    }
}

/// (r / half diagonal)^2 of a pixel position.
pub(super) fn field_q(intrinsics: &Intrinsics, pixel: DVec2) -> f64 {
    let half = DVec2::new(intrinsics.width as f64, intrinsics.height as f64) / 2.0;
    (pixel - intrinsics.principal).length_squared() / half.length_squared()
}
