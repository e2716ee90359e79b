//! The ring lamp: an annulus of uniform radiance in the lens plane, and the irradiance that it throws on a
//! small surface.
//!
//! Closed form. By Lambert's formula the irradiance of a uniform Lambertian source on an element with normal
//! n is E = n . F, where the vector irradiance F = L/2 * closed integral of (r x dl) / |r|^2 runs round the
//! source's rim, r reaching from the element to the rim. (Gershun, "The Light Field", 1939; Arvo, "Analytic
//! Methods for Simulated Light Transport", 1995, ch. 3.) For a disc of radius a in the plane z = 0, seen from
//! a point at distance rho from its axis and height h, with A = a^2 + rho^2 + h^2 and B = 2 a rho,
//!
//! ```text
//! I0 = closed integral of dt / (A - B cos t)       = 2 pi / sqrt(A^2 - B^2)
//! I1 = closed integral of cos t dt / (A - B cos t) = (A I0 - 2 pi) / B
//! F_radial = -L/2 h a I1
//! F_axial  = -L/2 (pi - I0 (A - 2 a^2) / 2)
//! ```
//!
//! and an annulus is the outer disc less the inner. The form holds while the whole annulus is above the
//! element's horizon; where the horizon cuts it, the sum over 256 equal-area points takes its place.
//! The ring may lie a little before or behind the lens, and its radiance may fall with `cos^n` of the emission angle
//! (a lobe beside Lambert's own cosine): the closed form is then multiplied by the mean of that factor over 36
//! points, each weighed by its share of the light.
//! Shadow rays go to points on the rims first, to equal-area points where those disagree.

use super::Occluders;
use glam::{DVec2, DVec3, Vec3, Vec3Swizzles};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

/// Points on the rims that are tried first: if all of them see the element, the ring is taken as unshadowed. A
/// straight edge that eight points on the outer rim miss hides less than 1 % of the disc.
const OUTER_PROBES: usize = 8;
const INNER_PROBES: usize = 4;

/// Else so many circles of so many points each, every point standing for the same area, share the light.
const CIRCLES: usize = 4;
const SECTORS: usize = 12;

/// Points that a glimpse takes.
const GLIMPSE: u32 = 4;

/// Points of the sum that takes over where the horizon cuts the ring.
const FINE: usize = 256;

/// Cosine of the emission angle below which a lobe changes no more.
const LEAST_COSINE: f64 = 1e-3;

/// Circles of a sum over the ring, by Gauss and Legendre over the area: share of the area that lies farther in, and weight.
const GAUSS: [(f64, f64); 3] =
    [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];

/// Points on each of them.
const SPOKES: usize = 12;

/// Points of the lamp that one of several looks at much the same place takes, so that all looks together take an even
/// spread of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// 0..1, of the place's own: what one place's points miss another's find.
    pub(super) seed: [f32; 2],
    /// Number of the first point in the place's series.
    pub(super) first: u32,
    /// How many.
    pub(super) count: u32,
}

impl Draw {
    /// `count` points for a look at a pixel of an image, the `first` of which is the pixel's own first-th.
    pub fn of_pixel((x, y): (usize, usize), first: u32, count: u32) -> Self {
        let p = Vec3::new(x as f32 + 0.5, y as f32 + 0.5, 1.0);
        Self { seed: [scrambled(p), scrambled(p.zxy())], first, count }
    }
}

/// An annulus round the lens's axis, in a plane z = const of the camera frame, shining one-sidedly towards +z.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ring {
    /// Inner radius, metres.
    #[serde(rename = "inner_radius_m")]
    pub inner: f64,
    /// Outer radius, metres.
    #[serde(rename = "outer_radius_m")]
    pub outer: f64,
    /// Where its plane lies along the axis, metres from the lens's centre of projection, towards the scene positive.
    #[serde(default, rename = "offset_m")]
    pub offset: f64,
    /// Exponent n of its lobe: radiance falls with cos^n of the emission angle; 0 shines alike in all directions.
    #[serde(default, rename = "lobe_exponent")]
    pub lobe: f64,
}

/// The radii do not make a ring.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("ring radii {inner} m and {outer} m make no ring: expected 0 <= inner < outer < 10 m, inner first")]
pub struct RingError {
    inner: f64,
    outer: f64,
}

impl Ring {
    /// A ring of these radii in metres.
    pub fn new(inner: f64, outer: f64) -> Result<Self, RingError> {
        if inner >= 0.0 && inner < outer && outer < 10.0 {
            Ok(Self { inner, outer, offset: 0.0, lobe: 0.0 })
        } else {
            Err(RingError { inner, outer })
        }
    }

    /// The same ring, its plane `offset` metres along the axis and with a lobe of exponent `lobe`.
    pub fn placed(self, offset: f64, lobe: f64) -> Self {
        Self { offset, lobe, ..self }
    }

    /// Radius in metres of the disc in the plane of the lens through which the ring's light passes on its way to
    /// points within 63 degrees of the axis: its own, and twice what its plane is off that of the lens.
    pub fn reach(&self) -> f64 {
        self.outer + 2.0 * self.offset.abs()
    }

    /// Irradiance per unit radiance along the axis (steradian-projected, unit-free) on an element at `point` with
    /// unit `normal`, both in the camera frame, with nothing in the way.
    pub fn irradiance(&self, point: DVec3, normal: DVec3) -> f64 {
        let place = DVec3::new(point.x, point.y, point.z - self.offset);
        let even = self.even_irradiance(place, normal);
        if self.lobe == 0.0 || even <= 0.0 {
            return even;
        }
        let (mut all, mut lobed) = (0.0, 0.0);
        for (place, weight) in &PLACES.gauss {
            let lamp = self.at(place, DVec2::X);
            let share = weight * form(lamp, point, normal);
            all += share;
            lobed += share * self.lobe_towards(lamp, point);
        }
        // Where the horizon leaves none of the points, the sliver's highest stands for all.
        let highest = (self.outer * normal.truncate().normalize_or_zero()).extend(self.offset);
        even * if all > 0.0 { lobed / all } else { self.lobe_towards(highest, point) }
    }

    /// The same without the closed form, as a sum over 36 points of the ring: a render of its own, to check by.
    pub fn summed_irradiance(&self, point: DVec3, normal: DVec3) -> f64 {
        let area = PI * (self.outer * self.outer - self.inner * self.inner);
        let of = |(place, weight): &(Place, f64)| {
            let lamp = self.at(place, DVec2::X);
            let lobe = if self.lobe == 0.0 { 1.0 } else { self.lobe_towards(lamp, point) };
            weight * form(lamp, point, normal) * lobe
        };
        area * PLACES.gauss.iter().map(of).sum::<f64>()
    }

    /// cos^n of the angle under which a point of the ring shines at a place.
    fn lobe_towards(&self, lamp: DVec3, point: DVec3) -> f64 {
        let way = point - lamp;
        (way.z / way.length()).max(LEAST_COSINE).powf(self.lobe)
    }

    /// Irradiance without lobe; `point` from the ring's centre.
    fn even_irradiance(&self, point: DVec3, normal: DVec3) -> f64 {
        if point.z <= 0.0 {
            return 0.0;
        }
        let to_centre = -normal.dot(point);
        let reach = self.outer * normal.truncate().length();
        if to_centre <= -reach {
            0.0
        } else if to_centre >= reach {
            let flux = disc_vector(self.outer, point) - disc_vector(self.inner, point);
            normal.dot(flux).max(0.0)
        } else {
            // The horizon cuts the ring.
            let area = PI * (self.outer * self.outer - self.inner * self.inner);
            let centred = Self { offset: 0.0, ..*self };
            let lamps = PLACES.fine.iter().map(|place| centred.at(place, DVec2::X));
            lamps.map(|lamp| form(lamp, point, normal)).sum::<f64>() * area / FINE as f64
        }
    }

    /// The same with shadows.
    pub fn shadowed_irradiance(&self, occluders: &Occluders, point: DVec3, normal: DVec3) -> f64 {
        let clear = self.irradiance(point, normal);
        if clear <= 0.0 {
            return 0.0;
        }
        let element = Element::new(occluders, point, normal);
        // A turn of its own for every point: what one point's samples miss another's find, and no bands appear.
        let turn = DVec2::from_angle(TAU * f64::from(scrambled(element.start)));
        let places = &*PLACES;
        let mut rims = places
            .rims
            .iter()
            .map(|place| self.at(place, turn))
            .filter(|&lamp| element.share(lamp) > 0.0)
            .peekable();
        // Rims that are all below the horizon tell nothing.
        if rims.peek().is_some() && rims.all(|lamp| element.sees(lamp)) {
            return clear;
        }
        clear * element.lit(places.spread.iter().map(|place| self.at(place, turn)), self)
    }

    /// The same by the share of four points of the ring alone that see the element, for whoever takes the mean over
    /// many elements: the mean is right, a single value hardly ever in the half-shadow.
    pub fn glimpsed_irradiance(&self, occluders: &Occluders, point: DVec3, normal: DVec3) -> f64 {
        let start = occluders.start(point, normal);
        let seed = [scrambled(start), scrambled(start.zxy())];
        self.drawn_irradiance(occluders, point, normal, Draw { seed, first: 0, count: GLIMPSE })
    }

    /// The same by the points of a draw, for whoever looks several times at one place.
    pub fn drawn_irradiance(&self, occluders: &Occluders, point: DVec3, normal: DVec3, draw: Draw) -> f64 {
        let clear = self.irradiance(point, normal);
        if clear > 0.0 { clear * self.drawn_share(occluders, point, normal, draw) } else { 0.0 }
    }

    /// Share of [`Self::irradiance`] that shadows leave, by the points of a draw.
    pub fn drawn_share(&self, occluders: &Occluders, point: DVec3, normal: DVec3, draw: Draw) -> f64 {
        let turn = DVec2::from_angle(TAU * f64::from(draw.seed[1]));
        let slide = f64::from(draw.seed[0]);
        let points = (draw.first..draw.first + draw.count).map(|i| {
            let place = PLACES.even[i as usize % FINE];
            self.at(&Place { share: (slide + place.share).fract(), ..place }, turn)
        });
        Element::new(occluders, point, normal).lit(points, self)
    }

    /// A place on the ring, turned round its axis: camera frame, metres.
    fn at(&self, place: &Place, turn: DVec2) -> DVec3 {
        let square = self.inner * self.inner * (1.0 - place.share) + self.outer * self.outer * place.share;
        (square.sqrt() * turn.rotate(place.direction)).extend(self.offset)
    }
}

/// A place on any ring: the share of the area that lies farther in, and a unit vector.
#[derive(Clone, Copy, Debug)]
struct Place {
    share: f64,
    direction: DVec2,
}

impl Place {
    /// At an angle in turns.
    fn new(share: f64, angle: f64) -> Self {
        Self { share, direction: DVec2::from_angle(TAU * angle) }
    }

    /// The i-th of `n` that stand for equal areas; any run of them is spread over the ring: the angle goes on by the
    /// golden section, the share of the area by halving what is left.
    fn spread(i: usize, n: usize) -> Self {
        let halving = f64::from((i as u32).reverse_bits()) / 2f64.powi(32);
        let share = halving + 0.5 / n.next_power_of_two() as f64;
        Self::new(share, (i as f64 * 0.618_033_988_749_895).fract())
    }
}

/// All places that sums and shadow rays take, for their sines are dear.
struct Places {
    fine: Vec<Place>,
    rims: Vec<Place>,
    spread: Vec<Place>,
    even: Vec<Place>,
    gauss: Vec<(Place, f64)>,
}

static PLACES: LazyLock<Places> = LazyLock::new(|| {
    let outer = (0..OUTER_PROBES).map(|i| Place::new(1.0, i as f64 / OUTER_PROBES as f64));
    let inner = (0..INNER_PROBES).map(|i| Place::new(0.0, (i as f64 + 0.5) / INNER_PROBES as f64));
    let spread = (0..CIRCLES * SECTORS).map(|i| {
        let (circle, sector) = (i % CIRCLES, i / CIRCLES);
        let slant = circle as f64 / CIRCLES as f64;
        Place::new((circle as f64 + 0.5) / CIRCLES as f64, (sector as f64 + slant) / SECTORS as f64)
    });
    // Halton's sequence: any run of it is even, and every second place lies opposite the one before it.
    let even = (0..FINE as u32).map(|i| Place::new(behind_point(i, 3), behind_point(i, 2)));
    let gauss = (0..GAUSS.len() * SPOKES).map(|i| {
        let (share, weight) = GAUSS[i / SPOKES];
        (Place::new(share, (i % SPOKES) as f64 / SPOKES as f64), weight / SPOKES as f64)
    });
    Places {
        fine: (0..FINE).map(|i| Place::spread(i, FINE)).collect(),
        rims: outer.chain(inner).collect(),
        spread: spread.collect(),
        even: even.collect(),
        gauss: gauss.collect(),
    }
});

/// The digits of `i` to a base behind the point, the last first.
fn behind_point(mut i: u32, base: u32) -> f64 {
    let (mut value, mut place) = (0.0, 1.0);
    while i > 0 {
        place /= f64::from(base);
        value += place * f64::from(i % base);
        i /= base;
    }
    value
}

/// An element under the lamp, camera frame, and where its shadow rays start, world frame.
struct Element<'a> {
    occluders: &'a Occluders<'a>,
    point: DVec3,
    normal: DVec3,
    start: Vec3,
}

impl<'a> Element<'a> {
    fn new(occluders: &'a Occluders<'a>, point: DVec3, normal: DVec3) -> Self {
        Self { occluders, point, normal, start: occluders.start(point, normal) }
    }

    /// What a point of the lamp gives it if nothing is in the way.
    fn share(&self, lamp: DVec3) -> f64 {
        form(lamp, self.point, self.normal)
    }

    fn sees(&self, lamp: DVec3) -> bool {
        self.occluders.let_see(self.start, lamp)
    }

    /// Share of these points' light that reaches it. Where the horizon hides all of them, the highest point of the
    /// outer rim stands for the sliver that is left.
    fn lit(&self, points: impl Iterator<Item = DVec3>, ring: &Ring) -> f64 {
        let (mut all, mut lit) = (0.0, 0.0);
        for lamp in points {
            let even = self.share(lamp);
            if even > 0.0 {
                let lobe = if ring.lobe == 0.0 { 1.0 } else { ring.lobe_towards(lamp, self.point) };
                let share = even * lobe;
                all += share;
                lit += if self.sees(lamp) { share } else { 0.0 };
            }
        }
        if all > 0.0 {
            return lit / all;
        }
        let highest = ring.outer * self.normal.truncate().normalize_or_zero();
        f64::from(u8::from(self.sees(highest.extend(ring.offset))))
    }
}

/// A number in 0..1 that depends on a position without visible pattern, the same on every machine and thread.
pub(super) fn scrambled(p: Vec3) -> f32 {
    let mut x = p.x.to_bits() ^ p.y.to_bits().rotate_left(11) ^ p.z.to_bits().rotate_left(22);
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    (x >> 8) as f32 / (1u32 << 24) as f32
}

/// cos cos' / d^2 between a lamp point facing +z and the element.
fn form(lamp: DVec3, point: DVec3, normal: DVec3) -> f64 {
    let way = lamp - point;
    let d2 = way.length_squared();
    (normal.dot(way).max(0.0) * (-way.z).max(0.0)) / (d2 * d2)
}

/// Vector irradiance of a unit-radiance disc of radius `a` at a point of the camera frame, pointing to the lamp.
fn disc_vector(a: f64, point: DVec3) -> DVec3 {
    if a <= 0.0 {
        return DVec3::ZERO;
    }
    let across = point.truncate();
    let (rho, h) = (across.length(), point.z);
    let sum = a * a + rho * rho + h * h;
    let cross = 2.0 * a * rho;
    let i0 = TAU / ((sum - cross) * (sum + cross)).sqrt();
    let ratio = cross / sum;
    let i1 =
        if ratio < 1e-4 { PI * ratio / sum * (1.0 + 0.75 * ratio * ratio) } else { (sum * i0 - TAU) / cross };
    let axial = -0.5 * (PI - 0.5 * i0 * (sum - 2.0 * a * a));
    let radial = -0.5 * h * a * i1;
    let outward = if rho > 0.0 { across / rho } else { DVec2::ZERO };
    (outward * radial).extend(axial)
}

#[cfg(test)]
#[path = "ring_tests.rs"]
mod tests;
