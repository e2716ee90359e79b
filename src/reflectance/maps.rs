//! Per-view images: the light a white surface would have sent to each pixel, and measured over simulated.
//!
//! For people who texture elsewhere (the thesis's way). Reflectance is absent where the view shows no mesh or
//! one from behind, where a site was clipped, and where so little light fell that noise alone would blur it by more than
//! [`MOST_DEVIATION`].

use super::observe::Illumination;
use crate::light::{Elements, interpolate};
use crate::photometry::Known;
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use glam::DVec2;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Samples per pixel edge.
const GRID: usize = 2;

/// Least cosine towards the camera: beyond it (84 degrees), and from behind, nothing is told.
const GRAZING: f32 = 0.1;

/// Largest standard deviation (of 1) of a reflectance that is given.
pub const MOST_DEVIATION: f32 = 0.1;

/// One view's images, of the photo's size.
pub struct ViewMaps {
    /// What a white Lambertian surface would have read, DN; 0 where no mesh is seen.
    pub white: Rgb,
    /// Known light over white; `None` where unknown.
    pub reflectance: Image<Option<[f32; 3]>>,
}

/// Computes a view's images. `bounced` is the view's bounced irradiance, DN, one an element.
pub fn view_maps(
    light: &Illumination,
    known: &Known,
    elements: &Elements,
    bounced: &[[f32; 3]],
    progress: &Progress,
) -> Result<ViewMaps, Cancelled> {
    let lens = &light.camera().intrinsics;
    let (width, height) = (lens.width, lens.height);
    let corners = elements.smooth(bounced);
    let rows: Vec<Vec<Option<[f32; 3]>>> = (0..height)
        .into_par_iter()
        .map(|y| {
            progress.check()?;
            Ok((0..width).map(|x| white(light, elements, &corners, x, y)).collect())
        })
        .collect::<Result<_, Cancelled>>()?;
    let white = Image::from_fn(width, height, |x, y| rows[y][x]);
    let reflectance = Image::from_fn(width, height, |x, y| {
        let m = (*white.at(x, y))?;
        if !known.valid.at(x, y) {
            return None;
        }
        let (p, var) = (known.rgb.at(x, y), known.variance.at(x, y));
        let firm = (0..3).all(|c| m[c] > 0.0 && var[c].sqrt() < MOST_DEVIATION * m[c]);
        firm.then(|| std::array::from_fn(|c| p[c] / m[c]))
    });
    Ok(ViewMaps { white: white.map(|m| m.unwrap_or([0.0; 3])), reflectance })
}

/// Mean over the pixel of what white would have read; `None` unless every sample meets a mesh.
fn white(
    light: &Illumination,
    elements: &Elements,
    bounced: &[[[f32; 3]; 3]],
    x: usize,
    y: usize,
) -> Option<[f32; 3]> {
    let (camera, lamp) = (light.camera(), light.lamp());
    let origin = camera.centre().as_vec3();
    let mut sum = [0.0f64; 3];
    for k in 0..GRID * GRID {
        let inside = (DVec2::new((k % GRID) as f64, (k / GRID) as f64) + 0.5) / GRID as f64;
        let ray = camera.ray(DVec2::new(x as f64, y as f64) + inside).as_vec3();
        let hit = elements.kernel().nearest(origin, ray, 0.0, f32::INFINITY)?;
        let element = hit.triangle as usize;
        let normal = elements.normal(element);
        if normal.dot(ray) >= -GRAZING * ray.length() {
            return None;
        }
        let unit = light.direct(origin + ray * hit.t, normal);
        let bounce = interpolate(&bounced[element], [hit.u, hit.v]);
        for c in 0..3 {
            sum[c] += lamp.radiance[c] * unit + f64::from(bounce[c]);
        }
    }
    let pixel = DVec2::new(x as f64, y as f64) + 0.5;
    let response = lamp.field.at(&camera.intrinsics, pixel) / PI / (GRID * GRID) as f64;
    Some(sum.map(|s| (s * response) as f32))
}
