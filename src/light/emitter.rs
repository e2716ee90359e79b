//! Lamps that a camera carries: where they sit in its frame, how they shine, and what falls on a small surface.
//!
//! A lamp is a shape (point, disc, ring, triangles), a pose that maps its own frame to the camera's, and a lobe: how
//! its radiance falls with the angle from the direction in which it shines. Discs and rings lie in the plane z = 0 of
//! their own frame and shine towards +z; triangles shine on the side from which they are seen counter-clockwise; a
//! point's axis is +z.
//!
//! Without a lobe the irradiance is closed: the contour integral round discs ([`super::Ring`]) and round polygons
//! clipped at the element's horizon, `E = L/2 sum of theta_i (n . g_i)`, theta_i the angle under which edge i is seen
//! and g_i the unit normal of its plane through the element (Lambert, "Photometria", 1760; Arvo, "Analytic Methods
//! for Simulated Light Transport", 1995, ch. 3). With a lobe `cos^k` and in half-shadow, sums over equal-area points
//! take its place. All irradiance is per unit radiance along the axis (for a point: per unit intensity), so radiance
//! per channel stays with the caller.

use super::{Occluders, Ring, RingError};
use glam::{DAffine3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Points on the lamp: tried first, and to sum over where those disagree or there is a lobe.
const PROBES: usize = 16;
const POINTS: usize = 64;

/// The shape of a lamp, metres, in its own frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// All light from the origin; intensity falls by the lobe alone.
    Point,
    /// A disc of this radius.
    Disc {
        /// Metres.
        radius: f64,
    },
    /// An annulus.
    Ring(Ring),
    /// One-sided triangles.
    Mesh {
        /// Corners in metres.
        triangles: Vec<[DVec3; 3]>,
    },
}

/// A lamp and its place in the camera's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Emitter {
    shape: Shape,
    camera_from_lamp: DAffine3,
    exponent: f64,
}

/// The numbers do not make a lamp.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EmitterError {
    /// Of a ring.
    #[error(transparent)]
    Ring(#[from] RingError),
    /// Of a disc.
    #[error("a disc of radius {0} m is no lamp: expected more than 0 and less than 10 m")]
    Disc(f64),
    /// Of triangles.
    #[error("triangle {0} of the lamp's mesh has no area: give a mesh of sound triangles, and at least one")]
    Triangle(usize),
    /// Of the lobe.
    #[error("a lobe's exponent of {0} is out of range: expected 0 (even in all directions) to 1000")]
    Lobe(f64),
    /// Of the pose.
    #[error(
        "the lamp's pose turns and shifts by more than a rigid body can, or is not finite: expected a rotation and metres"
    )]
    Pose,
}

impl From<Ring> for Emitter {
    fn from(ring: Ring) -> Self {
        let camera_from_lamp = DAffine3::from_translation(ring.offset * DVec3::Z);
        Self { shape: Shape::Ring(ring.placed(0.0, 0.0)), camera_from_lamp, exponent: ring.lobe }
    }
}

impl Emitter {
    /// A lamp at a pose in the camera's frame (rigid; metres); `exponent` k makes its radiance fall with cos^k of the
    /// angle from the axis, 0 being the same in all directions.
    pub fn new(shape: Shape, camera_from_lamp: DAffine3, exponent: f64) -> Result<Self, EmitterError> {
        match &shape {
            Shape::Point => {}
            Shape::Ring(ring) => {
                // Its own offset and lobe go into the pose and the exponent.
                let shift = DAffine3::from_translation(ring.offset * DVec3::Z);
                if ring.offset != 0.0 || ring.lobe != 0.0 {
                    let shape = Shape::Ring(Ring::new(ring.inner, ring.outer)?);
                    return Self::new(shape, camera_from_lamp * shift, exponent + ring.lobe);
                }
                Ring::new(ring.inner, ring.outer)?;
            }
            Shape::Disc { radius } if *radius > 0.0 && *radius < 10.0 => {}
            Shape::Disc { radius } => return Err(EmitterError::Disc(*radius)),
            Shape::Mesh { triangles } => {
                let sound = |t: &[DVec3; 3]| t.iter().all(|c| c.is_finite()) && area(t) > 0.0;
                if let Some(bad) = triangles.iter().position(|t| !sound(t)) {
                    return Err(EmitterError::Triangle(bad));
                }
                if triangles.is_empty() {
                    return Err(EmitterError::Triangle(0));
                }
            }
        }
        if !(0.0..=1000.0).contains(&exponent) {
            return Err(EmitterError::Lobe(exponent));
        }
        let m = camera_from_lamp.matrix3;
        let off = m.transpose() * m - glam::DMat3::IDENTITY;
        let most = off.to_cols_array().iter().fold(0.0f64, |most, x| most.max(x.abs()));
        if !camera_from_lamp.is_finite() || most > 1e-6 || m.determinant() < 0.0 {
            return Err(EmitterError::Pose);
        }
        Ok(Self { shape, camera_from_lamp, exponent })
    }

    /// The shape.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Radius in metres of a sphere round the lens that holds all of the lamp.
    pub fn reach(&self) -> f64 {
        let far = |p: DVec3| self.camera_from_lamp.transform_point3(p).length();
        match &self.shape {
            Shape::Point => far(DVec3::ZERO),
            Shape::Disc { radius } => far(DVec3::ZERO) + radius,
            Shape::Ring(ring) => far(DVec3::ZERO) + ring.outer,
            Shape::Mesh { triangles } => triangles.iter().flatten().fold(0.0, |most, &p| far(p).max(most)),
        }
    }

    /// Whether the whole lamp lies in the plane of the lens, which is what [`super::Sight`] takes for granted.
    pub fn is_in_lens_plane(&self) -> bool {
        let flat = |p: DVec3| self.camera_from_lamp.transform_point3(p).z.abs() < 1e-6;
        let level = self.camera_from_lamp.matrix3.z_axis.truncate().length() < 1e-6 && flat(DVec3::ZERO);
        match &self.shape {
            Shape::Point => flat(DVec3::ZERO),
            Shape::Disc { .. } | Shape::Ring(_) => level,
            Shape::Mesh { triangles } => triangles.iter().flatten().all(|&p| flat(p)),
        }
    }

    /// Irradiance per unit radiance on an element at `point` with unit `normal`, both in the camera's frame,
    /// with nothing in the way. For a point lamp: per unit intensity, 1/m^2.
    pub fn irradiance(&self, point: DVec3, normal: DVec3) -> f64 {
        let (point, normal) = self.local(point, normal);
        self.clear(point, normal)
    }

    /// The same with shadows.
    pub fn shadowed_irradiance(&self, occluders: &Occluders, point: DVec3, normal: DVec3) -> f64 {
        match self.as_ring() {
            Some(ring) => ring.shadowed_irradiance(occluders, point, normal),
            None => self.partly(occluders, point, normal, POINTS),
        }
    }

    /// The same by four points of the lamp alone, for whoever takes the mean over many elements: the mean is right,
    /// a single value hardly ever in the half-shadow.
    pub fn glimpsed_irradiance(&self, occluders: &Occluders, point: DVec3, normal: DVec3) -> f64 {
        match self.as_ring() {
            Some(ring) => ring.glimpsed_irradiance(occluders, point, normal),
            None => self.partly(occluders, point, normal, 4),
        }
    }

    /// The even ring round the lens, if it is one.
    fn as_ring(&self) -> Option<&Ring> {
        match &self.shape {
            Shape::Ring(ring) if self.is_even_and_centred() => Some(ring),
            _ => None,
        }
    }

    fn partly(&self, occluders: &Occluders, point: DVec3, normal: DVec3, points: usize) -> f64 {
        let (place, facing) = self.local(point, normal);
        let clear = self.clear(place, facing);
        if clear <= 0.0 {
            return 0.0;
        }
        let start = occluders.start(point, normal);
        let turn = f64::from(super::ring::scrambled(start));
        let visible = |lamp: DVec3| occluders.let_see(start, self.camera_from_lamp.transform_point3(lamp));
        if matches!(self.shape, Shape::Point) {
            return if visible(DVec3::ZERO) { clear } else { 0.0 };
        }
        let share_of = |n: usize| {
            let (mut all, mut lit, mut whole) = (0.0, 0.0, true);
            for i in 0..n {
                let (lamp, axis) = self.sample(i, n, turn);
                let share = self.form(lamp, axis, place, facing);
                if share > 0.0 {
                    all += share;
                    let seen = visible(lamp);
                    whole &= seen;
                    lit += if seen { share } else { 0.0 };
                }
            }
            (if all > 0.0 { lit / all } else { 1.0 }, whole)
        };
        let (share, whole) = share_of(points.min(PROBES));
        if whole || points <= PROBES { clear * share } else { clear * share_of(points).0 }
    }

    fn is_even_and_centred(&self) -> bool {
        self.exponent == 0.0 && self.camera_from_lamp == DAffine3::IDENTITY
    }

    /// Point and normal in the lamp's frame.
    fn local(&self, point: DVec3, normal: DVec3) -> (DVec3, DVec3) {
        let m = self.camera_from_lamp.matrix3.transpose();
        (m * (point - self.camera_from_lamp.translation), m * normal)
    }

    /// In the lamp's frame, with nothing in the way.
    fn clear(&self, point: DVec3, normal: DVec3) -> f64 {
        match &self.shape {
            Shape::Point => {
                let square = point.length_squared();
                let distance = square.sqrt();
                let (here, there) = (-normal.dot(point) / distance, point.z / distance);
                let facing = square > 0.0 && here > 0.0 && there > 0.0;
                if facing { here / square * there.powf(self.exponent) } else { 0.0 }
            }
            _ if self.exponent != 0.0 => self.summed(point, normal),
            Shape::Disc { radius } => {
                Ring { inner: 0.0, outer: *radius, offset: 0.0, lobe: 0.0 }.irradiance(point, normal)
            }
            Shape::Ring(ring) => ring.irradiance(point, normal),
            Shape::Mesh { triangles } => triangles.iter().map(|t| polygon(t, point, normal)).sum(),
        }
    }

    /// By the sum over equal-area points.
    fn summed(&self, point: DVec3, normal: DVec3) -> f64 {
        const FINE: usize = 256;
        let total: f64 = (0..FINE)
            .map(|i| {
                let (lamp, axis) = self.sample(i, FINE, 0.0);
                self.form(lamp, axis, point, normal)
            })
            .sum();
        total * self.area() / FINE as f64
    }

    /// cos cos' cos'^k / d^2 between a lamp's point and the element.
    fn form(&self, lamp: DVec3, axis: DVec3, point: DVec3, normal: DVec3) -> f64 {
        let way = lamp - point;
        let square = way.length_squared();
        let distance = square.sqrt();
        let (here, there) = (normal.dot(way) / distance, -axis.dot(way) / distance);
        if here > 0.0 && there > 0.0 { here * there.powf(1.0 + self.exponent) / square } else { 0.0 }
    }

    fn area(&self) -> f64 {
        match &self.shape {
            Shape::Point => 0.0,
            Shape::Disc { radius } => PI * radius * radius,
            Shape::Ring(ring) => PI * (ring.outer * ring.outer - ring.inner * ring.inner),
            Shape::Mesh { triangles } => triangles.iter().map(area).sum(),
        }
    }

    /// The i-th of `n` equal-area points (a Kronecker sequence) and the direction in which it shines, in the lamp's
    /// frame.
    fn sample(&self, i: usize, n: usize, turn: f64) -> (DVec3, DVec3) {
        let first = (i as f64 + 0.5) / n as f64;
        let second = (i as f64 * 0.618_033_988_749_895 + turn).fract();
        let round = |inner: f64, outer: f64| {
            let radius = (inner * inner * (1.0 - first) + outer * outer * first).sqrt();
            ((radius * DVec2::from_angle(TAU * second)).extend(0.0), DVec3::Z)
        };
        match &self.shape {
            Shape::Point => (DVec3::ZERO, DVec3::Z),
            Shape::Disc { radius } => round(0.0, *radius),
            Shape::Ring(ring) => round(ring.inner, ring.outer),
            Shape::Mesh { triangles } => {
                let mut left = first * self.area();
                let mut chosen = &triangles[triangles.len() - 1];
                let mut share = 1.0;
                for t in triangles {
                    let a = area(t);
                    if left < a {
                        (chosen, share) = (t, left / a);
                        break;
                    }
                    left -= a;
                }
                // Uniform over the triangle (Turk, "Generating Random Points in Triangles", 1990).
                let root = share.sqrt();
                let [a, b, c] = chosen;
                let point = *a * (1.0 - root) + *b * (root * (1.0 - second)) + *c * (root * second);
                (point, (*b - *a).cross(*c - *a).normalize())
            }
        }
    }
}

fn area([a, b, c]: &[DVec3; 3]) -> f64 {
    0.5 * (*b - *a).cross(*c - *a).length()
}

/// Irradiance per unit radiance of a one-sided triangle, the part above the element's horizon.
fn polygon(triangle: &[DVec3; 3], point: DVec3, normal: DVec3) -> f64 {
    let [a, b, c] = triangle.map(|corner| corner - point);
    if (b - a).cross(c - a).dot(a) >= 0.0 {
        // Seen from behind, or edge-on.
        return 0.0;
    }
    let heights = [a, b, c].map(|corner| normal.dot(corner));
    let mut corners = Vec::with_capacity(4);
    for i in 0..3 {
        let j = (i + 1) % 3;
        let (p, q) = ([a, b, c][i], [a, b, c][j]);
        if heights[i] >= 0.0 {
            corners.push(p);
        }
        if (heights[i] >= 0.0) != (heights[j] >= 0.0) {
            corners.push(p + (q - p) * (heights[i] / (heights[i] - heights[j])));
        }
    }
    let mut sum = 0.0;
    for (i, p) in corners.iter().enumerate() {
        let q = corners[(i + 1) % corners.len()];
        let across = p.cross(q);
        let sine = across.length();
        if sine > 0.0 {
            sum += sine.atan2(p.dot(q)) * normal.dot(across) / sine;
        }
    }
    (0.5 * sum).abs()
}

#[cfg(test)]
#[path = "emitter_tests.rs"]
mod tests;
