//! Per-view images: the light a white surface would have sent to each pixel, and measured over simulated.
//!
//! For people who texture elsewhere (the thesis's way). Reflectance is absent where the view shows no mesh or
//! one from behind, where a site was clipped, and where so little light fell that noise alone would blur it by more than
//! [`MOST_DEVIATION`].

use super::observe::Illumination;
use crate::light::{Elements, Finish, Spot, expose, interpolate};
use crate::photometry::Known;
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use glam::DVec2;
use std::f64::consts::PI;

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
    let (camera, lamp) = (light.camera(), light.lamp());
    let shade = |spot: &Spot| {
        (spot.facing > GRAZING).then(|| {
            let unit = light.glimpsed(spot.point, spot.normal);
            let bounce = interpolate(&corners[spot.element], spot.at);
            std::array::from_fn(|c| (lamp.radiance[c] * unit) as f32 + bounce[c])
        })
    };
    let irradiance = expose(camera, elements, light.sight(), Finish::Fast, shade, progress)?;
    let white = Image::from_fn(width, height, |x, y| {
        let response = lamp.field.at(lens, DVec2::new(x as f64, y as f64) + 0.5) / PI;
        irradiance.at(x, y).map(|e| e.map(|e| (f64::from(e) * response) as f32))
    });
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
