//! The mean over each pixel's square of something that is known at surface points.
//!
//! One sample at each pixel's centre, which is exact to second order where a pixel shows one smooth piece of surface
//! in even light; where the eight neighbours tell of anything else (another surface, a shadow's edge, a change
//! of slope), a grid of samples over the pixel takes its place. (Adaptive supersampling: Whitted, "An improved
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
    /// 2 x 2 samples.
    Fast,
    /// 4 x 4 samples.
    Fine,
}

impl Finish {
    /// Samples along a pixel's edge.
    fn grid(self) -> usize {
        match self {
            Self::Fast => 2,
            Self::Fine => 4,
        }
    }
}

/// Neighbours that differ by more than this, relative to the larger, are not one smooth piece.
const CONTRAST: f32 = 0.05;

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
            if !is_even(&centres, (width, height), (x, y)) {
                *value = over_square(&sample, (x, y), finish.grid());
            }
        }
        Ok(())
    })?;
    Ok(Image::from_fn(width, height, |x, y| means[y * width + x]))
}

/// Whether the eight neighbours of a pixel and itself are alike.
fn is_even(values: &[Option<[f32; 3]>], (width, height): (usize, usize), (x, y): (usize, usize)) -> bool {
    let own = values[y * width + x];
    (y.saturating_sub(1)..(y + 2).min(height)).all(|v| {
        (x.saturating_sub(1)..(x + 2).min(width)).all(|u| match (own, values[v * width + u]) {
            (Some(a), Some(b)) => (0..3).all(|c| (a[c] - b[c]).abs() <= CONTRAST * a[c].max(b[c])),
            (None, None) => true,
            _ => false,
        })
    })
}

fn over_square(
    sample: impl Fn(DVec2) -> Option<[f32; 3]>,
    (x, y): (usize, usize),
    grid: usize,
) -> Option<[f32; 3]> {
    let (mut sum, count) = ([0.0; 3], (grid * grid) as u32);
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
