//! The mean over each pixel's square of something that is known at surface points.
//!
//! One sample at each pixel's centre, which is exact to second order where a pixel shows one smooth piece of surface
//! in even light; where the eight neighbours tell of anything else (another surface, a shadow's edge, a change
//! of slope), samples all over the pixel take its place. (Adaptive supersampling: Whitted, "An improved
//! illumination model for shaded display", 1980.)

use super::{Elements, Sight};
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::scene::Camera;
use glam::{DVec2, Vec3};
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
            Self::Fast => (0.1, 0.3, 4, 12),
            Self::Fine => (0.05, 0.2, 16, 64),
        };
        match contrast {
            c if c <= even => 1,
            c if c <= mild => some,
            _ => many,
        }
    }
}

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
    let eye = camera.centre().as_vec3();
    let see = |ray: Vec3, element: usize, depth: f32, at: [f32; 2]| {
        let normal = elements.normal(element);
        let facing = -normal.dot(ray) / ray.length();
        shade(&Spot { point: eye + ray * depth, normal, element, at, facing })
    };
    let sample = |pixel: DVec2| {
        let ray = camera.ray(pixel).as_vec3();
        let hit = elements.kernel().nearest(eye, ray, 0.0, f32::INFINITY)?;
        see(ray, hit.triangle as usize, hit.t, [hit.u, hit.v])
    };
    let centre = |x: usize, y: usize| {
        let pixel = DVec2::new(x as f64, y as f64) + 0.5;
        let Some(met) = sight.met(x, y) else { return sample(pixel) };
        let (element, depth) = met?;
        let ray = camera.ray(pixel).as_vec3();
        see(ray, element as usize, depth, elements.place(element as usize, eye + ray * depth))
    };
    let mut centres: Vec<Option<[f32; 3]>> = vec![None; width * height];
    centres.par_chunks_mut((width * TILE).max(1)).enumerate().try_for_each(|(tile, chunk)| {
        progress.check()?;
        for (i, value) in chunk.iter_mut().enumerate() {
            let (x, y) = (i % width, tile * TILE + i / width);
            *value = centre(x, y);
        }
        Ok(())
    })?;
    let mut means = centres.clone();
    means.par_chunks_mut((width * TILE).max(1)).enumerate().try_for_each(|(tile, chunk)| {
        progress.check()?;
        for (i, value) in chunk.iter_mut().enumerate() {
            let (x, y) = (i % width, tile * TILE + i / width);
            let samples = finish.samples(contrast(&centres, (width, height), (x, y)));
            if samples > 1 {
                *value = over_square(sample, (x, y), samples);
            }
        }
        Ok(())
    })?;
    Ok(Image::from_fn(width, height, |x, y| means[y * width + x]))
}

/// The largest difference between a pixel and its eight neighbours, relative to the larger; endless between something
/// and nothing.
fn contrast(values: &[Option<[f32; 3]>], (width, height): (usize, usize), (x, y): (usize, usize)) -> f32 {
    let own = values[y * width + x];
    let mut most = 0.0f32;
    for v in y.saturating_sub(1)..(y + 2).min(height) {
        for u in x.saturating_sub(1)..(x + 2).min(width) {
            match (own, values[v * width + u]) {
                (Some(a), Some(b)) => {
                    for (a, b) in a.into_iter().zip(b).filter(|(a, b)| a != b) {
                        most = most.max((a - b).abs() / a.max(b));
                    }
                }
                (None, None) => {}
                _ => return f32::INFINITY,
            }
        }
    }
    most
}

fn over_square(
    sample: impl Fn(DVec2) -> Option<[f32; 3]>,
    (x, y): (usize, usize),
    count: u32,
) -> Option<[f32; 3]> {
    let mut sum = [0.0; 3];
    for k in 0..count {
        // Hammersley's points, every one in a row and a column of its own.
        let inside = DVec2::new(
            (f64::from(k) + 0.5) / f64::from(count),
            f64::from(k.reverse_bits()) / 2f64.powi(32) + 0.5 / f64::from(count),
        );
        let value = sample(DVec2::new(x as f64, y as f64) + inside)?;
        for (s, v) in sum.iter_mut().zip(value) {
            *s += v / count as f32;
        }
    }
    Some(sum)
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
