//! The mean over each pixel's square of something that is known at surface points.
//!
//! One sample at each pixel's centre, which is exact to second order where a pixel shows one smooth piece of surface
//! in even light; where the eight neighbours tell of anything else (another surface, a shadow's edge, a change
//! of slope), samples all over the pixel take its place. (Adaptive supersampling: Whitted, "An improved
//! illumination model for shaded display", 1980.)
//!
//! A pixel and its neighbours that lie in one plane need no rays of the camera for it. If light also changes evenly
//! over them, as in a wide half-shadow, the mean of their centres is the pixel's mean, and what one of them has missed
//! of the lamp others have found. (Keller and Heidrich, "Interleaved Sampling", 2001.) That blurs by a
//! pixel at the most, and is left to the fast finish.

use super::{Draw, Elements, Sight};
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::scene::Camera;
use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

/// How exact a pixel's mean is made where it shows more than one smooth piece of surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// Up to 12 samples a pixel.
    Fast,
    /// Up to 64.
    Fine,
}

impl Finish {
    /// Samples for a pixel that differs from its neighbours by `contrast`, relative to the larger.
    fn samples(self, contrast: f32) -> u32 {
        let (even, mild, some, many) = match self {
            Self::Fast => (0.12, 0.3, 4, 12),
            Self::Fine => (0.05, 0.2, 16, 64),
        };
        match contrast {
            c if c <= even => 1,
            c if c <= mild => some,
            _ => many,
        }
    }
}

/// Lamp points asked at each sample, and at a pixel's centre, where they also tell whether there is half-shadow.
const DRAW: u32 = 2;
const FIRST_DRAW: u32 = 4;

/// A pixel shows one plane if its neighbours' normals part from its own by no more than this (cosine), and their points
/// from its plane by no more than so many pixels' widths.
const ONE_SLOPE: f32 = 0.998;
const FLAT: f32 = 0.25;

/// Light changes evenly over a plane if it does so by no more than this from one pixel to the next, relative.
const STEEP: f32 = 0.12;

/// Rows between two looks at the cancel flag, and that share their neighbours.
const TILE: usize = 16;

/// A place on the surface that a camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Metres, world frame.
    pub point: Vec3,
    /// Unit normal by the winding of the mesh.
    pub normal: Vec3,
    /// Element, and the place inside it.
    pub element: usize,
    /// Barycentric weights of its second and third corner.
    pub at: [f32; 2],
    /// Cosine between the normal and the direction to the camera; negative when seen from behind.
    pub facing: f32,
    /// The lamp's points that this spot's light is to be asked of.
    pub draw: Draw,
}

/// Means over the pixels of `camera` of what `shade` gives; `None` where any sample of a pixel meets nothing or
/// `shade` gives nothing.
pub fn expose(
    camera: &Camera,
    elements: &Elements,
    sight: &Sight,
    finish: Finish,
    shade: impl Fn(&Spot) -> Option<[f32; 3]> + Sync,
    progress: &Progress,
) -> Result<Image<Option<[f32; 3]>>, Cancelled> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let film = Film { camera, elements, eye: camera.centre().as_vec3(), shade };
    let mut centres = vec![Centre::default(); width * height];
    centres.par_chunks_mut((width * TILE).max(1)).enumerate().try_for_each(|(tile, chunk)| {
        progress.check()?;
        for (i, centre) in chunk.iter_mut().enumerate() {
            *centre = film.centre(sight, (i % width, tile * TILE + i / width));
        }
        Ok(())
    })?;
    let mut means = vec![None; width * height];
    means.par_chunks_mut((width * TILE).max(1)).enumerate().try_for_each(|(tile, chunk)| {
        progress.check()?;
        for (i, value) in chunk.iter_mut().enumerate() {
            let round = Round::of(&centres, (width, height), (i % width, tile * TILE + i / width));
            *value = match finish.samples(round.contrast()) {
                1 => round.own.value,
                samples => {
                    let plane = Plane::round(&film, &round);
                    let even = if finish == Finish::Fast && plane.is_some() { round.even() } else { None };
                    even.or_else(|| film.mean(&round, plane, samples))
                }
            };
        }
        Ok(())
    })?;
    Ok(Image::from_fn(width, height, |x, y| means[y * width + x]))
}

/// What the ray through a pixel's centre met, element and depth, and its value.
#[derive(Clone, Copy, Default)]
struct Centre {
    met: Option<(u32, f32)>,
    value: Option<[f32; 3]>,
}

/// A pixel's centre and those of the pixels round it.
struct Round {
    pixel: (usize, usize),
    own: Centre,
    /// With where they lie from the pixel.
    near: [Option<([f32; 2], Centre)>; 8],
}

struct Film<'a, S> {
    camera: &'a Camera,
    elements: &'a Elements,
    eye: Vec3,
    shade: S,
}

impl<S: Fn(&Spot) -> Option<[f32; 3]>> Film<'_, S> {
    fn ray(&self, pixel: DVec2) -> Vec3 {
        self.camera.ray(pixel).as_vec3()
    }

    fn centre(&self, sight: &Sight, (x, y): (usize, usize)) -> Centre {
        let ray = self.ray(DVec2::new(x as f64, y as f64) + 0.5);
        let draw = Draw::of_pixel((x, y), 0, FIRST_DRAW);
        let met = sight.met(x, y).unwrap_or_else(|| {
            let hit = self.elements.kernel().nearest(self.eye, ray, 0.0, f32::INFINITY)?;
            Some((hit.triangle, hit.t))
        });
        let value = met.and_then(|(element, depth)| {
            let (element, point) = (element as usize, self.eye + ray * depth);
            self.see(ray, element, depth, self.elements.place(element, point), draw)
        });
        Centre { met, value }
    }

    fn see(&self, ray: Vec3, element: usize, depth: f32, at: [f32; 2], draw: Draw) -> Option<[f32; 3]> {
        let normal = self.elements.normal(element);
        let facing = -normal.dot(ray) / ray.length();
        (self.shade)(&Spot { point: self.eye + ray * depth, normal, element, at, facing, draw })
    }

    fn mean(&self, round: &Round, plane: Option<Plane>, count: u32) -> Option<[f32; 3]> {
        let (x, y) = round.pixel;
        let corner = DVec2::new(x as f64, y as f64);
        let mut sum = [0.0; 3];
        for k in 0..count {
            // Hammersley's points, every one in a row and a column of its own.
            let inside = DVec2::new(
                (f64::from(k) + 0.5) / f64::from(count),
                f64::from(k.reverse_bits()) / 2f64.powi(32) + 0.5 / f64::from(count),
            );
            let draw = Draw::of_pixel(round.pixel, k * DRAW, DRAW);
            let value = match &plane {
                Some(plane) => {
                    let (ray, depth) = plane.at(inside.as_vec2() - 0.5);
                    self.see(ray, plane.element, depth, plane.place, draw)
                }
                None => {
                    let ray = self.ray(corner + inside);
                    let hit = self.elements.kernel().nearest(self.eye, ray, 0.0, f32::INFINITY)?;
                    self.see(ray, hit.triangle as usize, hit.t, [hit.u, hit.v], draw)
                }
            }?;
            for (s, v) in sum.iter_mut().zip(value) {
                *s += v / count as f32;
            }
        }
        Some(sum)
    }
}

/// The one plane that a pixel and its neighbours show.
struct Plane {
    element: usize,
    place: [f32; 2],
    /// Ray through the pixel's centre, and its change a column and a row.
    rays: [Vec3; 3],
    /// Inverse depth likewise.
    inverse: [f32; 3],
}

impl Plane {
    fn round<S: Fn(&Spot) -> Option<[f32; 3]>>(film: &Film<S>, round: &Round) -> Option<Self> {
        let (element, depth) = round.own.met?;
        let element = element as usize;
        let normal = film.elements.normal(element);
        let centre = DVec2::new(round.pixel.0 as f64, round.pixel.1 as f64) + 0.5;
        let ray = film.ray(centre);
        let rays = [ray, film.ray(centre + DVec2::X) - ray, film.ray(centre + DVec2::Y) - ray];
        let facing = normal.dot(ray);
        let inverse = rays.map(|ray| normal.dot(ray) / (facing * depth));
        let flat = FLAT * depth * rays[1].length() * ray.length() / facing.abs();
        for near in round.near {
            let ([dx, dy], Centre { met, .. }) = near?;
            let (other, t) = met?;
            let off = t * t * (inverse[0] + inverse[1] * dx + inverse[2] * dy) - t;
            let near = off.abs() <= flat;
            if !near || film.elements.normal(other as usize).dot(normal) < ONE_SLOPE {
                return None;
            }
        }
        let place = film.elements.place(element, film.eye + ray * depth);
        inverse.iter().all(|i| i.is_finite()).then_some(Self { element, place, rays, inverse })
    }

    /// Ray and depth at an offset from the pixel's centre.
    fn at(&self, off: Vec2) -> (Vec3, f32) {
        let ray = self.rays[0] + self.rays[1] * off.x + self.rays[2] * off.y;
        (ray, 1.0 / (self.inverse[0] + self.inverse[1] * off.x + self.inverse[2] * off.y))
    }
}

impl Round {
    fn of(centres: &[Centre], (width, height): (usize, usize), (x, y): (usize, usize)) -> Self {
        let around = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
        let near = around.map(|(dx, dy)| {
            let (u, v) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            (u < width && v < height).then(|| ([dx as f32, dy as f32], centres[v * width + u]))
        });
        Self { pixel: (x, y), own: centres[y * width + x], near }
    }

    /// The mean of the pixel and its neighbours, which is the pixel's own where light changes evenly; `None` where it
    /// does not.
    fn even(&self) -> Option<[f32; 3]> {
        let (mut sum, mut across, mut down) = (self.own.value?, 0.0, 0.0);
        for near in self.near {
            let ([dx, dy], Centre { value, .. }) = near?;
            let value = value?;
            (0..3).for_each(|c| sum[c] += value[c]);
            across += dx * value[0];
            down += dy * value[0];
        }
        let mean = sum.map(|s| s / 9.0);
        (across.abs().max(down.abs()) / 6.0 <= STEEP * mean[0]).then_some(mean)
    }

    /// The largest difference between the pixel and its neighbours, relative to the larger; endless between something
    /// and nothing.
    fn contrast(&self) -> f32 {
        let mut most = 0.0f32;
        for (_, near) in self.near.iter().flatten() {
            match (self.own.value, near.value) {
                (Some(a), Some(b)) => {
                    for (a, b) in a.into_iter().zip(b).filter(|(a, b)| a != b) {
                        most = most.max((a - b).abs() / a.max(b));
                    }
                }
                (None, None) => {}
                _ => return f32::INFINITY,
            }
        }
        most
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Distortion, Intrinsics, Mesh};
    use glam::DAffine3;

    fn camera(distortion: Distortion) -> Camera {
        let (focal, principal) = (DVec2::splat(60.0), DVec2::new(20.3, 15.0));
        Camera {
            name: "1".into(),
            intrinsics: Intrinsics { width: 40, height: 30, focal, principal, distortion },
            world_from_camera: DAffine3::IDENTITY,
        }
    }

    /// A wall at 1 m that ends at x = 0.
    fn wall() -> Elements {
        let p = [[-2.0, -2.0], [0.0, -2.0], [0.0, 2.0], [-2.0, 2.0]];
        let mesh = Mesh {
            positions: p.map(|[x, y]| Vec3::new(x, y, 1.0)).into(),
            triangles: vec![[0, 2, 1], [0, 3, 2]],
            ..Mesh::default()
        };
        Elements::build(&[&mesh], &[9.0])
    }

    fn exposed(camera: &Camera, shade: impl Fn(&Spot) -> Option<[f32; 3]> + Sync) -> Image<Option<[f32; 3]>> {
        let elements = wall();
        let sight = Sight::look(elements.kernel(), elements.normals(), camera, 0.085);
        expose(camera, &elements, &sight, Finish::Fine, shade, &Progress::silent()).unwrap()
    }

    #[test]
    fn a_pixel_holds_the_mean_over_its_square_even_across_a_step() {
        // Bright above y = 0.0021: the row whose square the step crosses sees its share.
        let image = exposed(&camera(Distortion::default()), |s| {
            Some(if s.point.y < 0.0021 { [1.0, 0.5, 0.1] } else { [0.0; 3] })
        });
        let row = 15.0 + 60.0 * 0.0021f32;
        for y in 0..30 {
            let share = (row - y as f32).clamp(0.0, 1.0);
            let got = image.at(5, y).unwrap();
            assert!(
                (got[0] - share).abs() < 0.02 && (got[1] - 0.5 * share).abs() < 0.02,
                "{got:?} in row {y}"
            );
        }
        // The wall ends at column 20.3.
        assert!(image.at(19, 15).is_some() && image.at(20, 15).is_none() && image.at(30, 15).is_none());
    }

    #[test]
    fn rays_of_the_sight_and_rays_of_its_own_show_the_same() {
        let shade = |s: &Spot| Some([s.point.x + 3.0, s.at[0] + 0.1, s.element as f32 + 1.0]);
        let reused = exposed(&camera(Distortion::default()), shade);
        // The least of distortions forbids the sight's grid.
        let traced = exposed(&camera(Distortion { k1: 1e-12, ..Distortion::default() }), shade);
        for (a, b) in reused.pixels().iter().zip(traced.pixels()) {
            match (a, b) {
                (Some(a), Some(b)) => assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-4), "{a:?} {b:?}"),
                _ => assert_eq!(a, b),
            }
        }
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let shade = |s: &Spot| Some([(s.point.x * 40.0).sin() + 1.5, s.point.y + 3.0, 1.0]);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| exposed(&camera(Distortion::default()), shade))
        };
        assert_eq!(on(1), on(3));
    }
}
