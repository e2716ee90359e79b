//! Noise-free images of a stop: the path tracer's mean over many rays a pixel.

use super::path::{Ring, Seen, Tracer};
use super::sampler::{Sampler, combine};
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::scene::Camera;
use glam::DVec2;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Rays a pixel in each of two independent passes: where the lens blur can mix in the object, and elsewhere.
/// Powers of two, so that each pass is a complete low-discrepancy set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Effort {
    /// Rays a pixel and pass on and around the object.
    pub(super) object: u32,
    /// Rays a pixel and pass elsewhere.
    pub(super) elsewhere: u32,
    /// Seed of the first pass; the second takes the next.
    pub(super) seed: u32,
}

/// The effort behind the committed renders.
pub(super) const FULL: Effort = Effort { object: 256, elsewhere: 32, seed: 1 };

/// One stop's light, before lens and sensor.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Render {
    /// Mean of both passes over the pixel's square.
    pub(super) image: Image<Seen>,
    /// Standard error of the flash's radiance over its mean, on pixels that are all object; from the difference
    /// of the two passes.
    pub(super) noise: f64,
}

/// Renders `rows` of a camera's image (all others stay zero) in two passes.
pub(super) fn render(
    tracer: &Tracer,
    ring: &Ring,
    camera: &Camera,
    effort: Effort,
    rows: std::ops::Range<usize>,
    progress: &Progress,
) -> Result<Render, Cancelled> {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let near = near_object(tracer, camera);
    let stage = format!("rendering stop {}", camera.name);
    let done = AtomicUsize::new(0);
    let total = rows.len();
    let mut passes = vec![[Seen::default(); 2]; width * height];
    passes.par_chunks_mut(width).enumerate().filter(|(y, _)| rows.contains(y)).try_for_each(|(y, row)| {
        progress.check()?;
        for (x, pixel) in row.iter_mut().enumerate() {
            let rays = if near[y * width + x] { effort.object } else { effort.elsewhere };
            for (pass, mean) in pixel.iter_mut().enumerate() {
                let seed = combine(effort.seed + pass as u32, (y * width + x) as u32);
                *mean = gather(tracer, ring, camera, (x, y), seed, rays);
            }
        }
        progress.report(&stage, done.fetch_add(1, Ordering::Relaxed) + 1, total);
        Ok(())
    })?;
    let noise = relative_noise(&passes);
    let image = Image::from_fn(width, height, |x, y| {
        let [a, b] = passes[y * width + x];
        let mut mean = Seen::default();
        mean.add(&a, 0.5);
        mean.add(&b, 0.5);
        mean
    });
    Ok(Render { image, noise })
}

/// Mean over `rays` rays through one pixel.
fn gather(
    tracer: &Tracer,
    ring: &Ring,
    camera: &Camera,
    (x, y): (usize, usize),
    seed: u32,
    rays: u32,
) -> Seen {
    let eye = camera.centre().as_vec3();
    // The room's light is the same in both frames of a pair and goes out with the subtraction: fewer rays do.
    let room_rays = rays.min(64.max(rays / 4));
    let mut mean = Seen::default();
    for index in 0..rays {
        let mut sampler = Sampler::new(seed, index);
        let place = DVec2::new(x as f64, y as f64) + sampler.next().as_dvec2();
        let direction = camera.ray(place).as_vec3();
        let room = index < room_rays;
        let mut seen =
            tracer.trace(eye, direction, Some((ring, &camera.world_from_camera)), room, &mut sampler);
        seen.ambient = seen.ambient.map(|a| a * rays as f32 / room_rays as f32);
        mean.add(&seen, 1.0 / rays as f32);
    }
    mean
}

/// Pixels from which the object is at most a few pixels away, by one ray a pixel.
fn near_object(tracer: &Tracer, camera: &Camera) -> Vec<bool> {
    const REACH: usize = 4;
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let eye = camera.centre().as_vec3();
    let mut near = vec![false; width * height];
    for y in 0..height {
        for x in 0..width {
            let direction = camera.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).as_vec3();
            if tracer.meets_object(eye, direction) {
                for v in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
                    near[v * width + x.saturating_sub(REACH)..v * width + (x + REACH + 1).min(width)]
                        .fill(true);
                }
            }
        }
    }
    near
}

fn relative_noise(passes: &[[Seen; 2]]) -> f64 {
    let (mut square, mut sum, mut count) = (0.0, 0.0, 0.0);
    for [a, b] in passes.iter().filter(|[a, b]| a.object == 1.0 && b.object == 1.0) {
        for k in 0..3 {
            let half_difference = f64::from(a.flash[k] - b.flash[k]) / 2.0;
            square += half_difference * half_difference;
            sum += f64::from(a.flash[k] + b.flash[k]) / 2.0;
            count += 1.0;
        }
    }
    if sum > 0.0 { (square / f64::max(count, 1.0)).sqrt() / (sum / count) } else { 0.0 }
}
