//! Per-view images: the light a white surface would have sent to each pixel, and measured over simulated.
//!
//! For people who texture elsewhere (the thesis's way). Reflectance is absent where the view shows no mesh or
//! one from behind, where a site was clipped, and where so little light fell that noise alone would blur it by more than
//! [`MOST_DEVIATION`].
//!
//! Where the view shows the object, [`own_look`] does better than a ratio: light and colour change within the lens's
//! blur, and a ratio of blurred light is not the blurred ratio. What the texture leaves of the sensor sites is
//! interpolated instead of the sites themselves (demosaicing by residuals: Kiku, Monno, Tanaka and Okutomi, "Residual
//! interpolation for color image demosaicking", 2013), and counts by its own noise, and by how far the tenth of a pixel by
//! which a picture may be misplaced would move it, against `OWN`.

use super::joint::MISPLACED;
use super::observe::{GRAZING, Illumination};
use super::projection::Projection;
use super::stage::Stage;
use crate::light::{Finish, Spot, expose, interpolate};
use crate::photometry::Known;
use crate::progress::{Cancelled, Progress};
use crate::raster::{Image, Rgb};
use glam::DVec2;
use std::f64::consts::PI;

/// Largest standard deviation (of 1) of a reflectance that is given.
pub const MOST_DEVIATION: f32 = 0.1;

/// Standard deviation by which one view may honestly differ from the texture, of 1.
const OWN: f32 = 0.05;

/// Least share of a pixel, through the lens, that must be object.
const LEAST_COVER: f32 = 0.5;

/// One view's images, of the photo's size.
pub struct ViewMaps {
    /// What a white Lambertian surface would have read, DN; 0 where no mesh is seen.
    pub white: Rgb,
    /// Known light over white; `None` where unknown.
    pub reflectance: Image<Option<[f32; 3]>>,
}

/// Computes a view's images. `bounced` is the view's bounced irradiance, DN, one a patch.
pub fn view_maps(
    light: &Illumination,
    known: &Known,
    stage: &Stage,
    bounced: &[[f32; 3]],
    progress: &Progress,
) -> Result<ViewMaps, Cancelled> {
    let lens = &light.camera().intrinsics;
    let (width, height) = (lens.width, lens.height);
    let corners = stage.smooth(bounced);
    let (camera, lamp) = (light.camera(), light.lamp());
    let shade = |spot: &Spot| {
        (f64::from(spot.facing) > GRAZING).then(|| {
            let unit = light.at_spot(spot);
            let bounce = interpolate(&corners[spot.element], spot.at);
            std::array::from_fn(|c| (lamp.radiance[c] * unit) as f32 + bounce[c])
        })
    };
    let irradiance = expose(camera, &stage.elements, light.sight(), Finish::Fast, shade, progress)?;
    let white = Image::from_fn(width, height, |x, y| {
        let response = lamp.field.at(lens, DVec2::new(x as f64, y as f64) + 0.5) / PI;
        irradiance.at(x, y).map(|e| e.map(|e| (f64::from(e) * response) as f32))
    });
    let reflectance = Image::from_fn(width, height, |x, y| divided(known, x, y, (*white.at(x, y))?));
    Ok(ViewMaps { white: white.map(|m| m.unwrap_or([0.0; 3])), reflectance })
}

/// Known light over what white would have read, where both tell of a reflectance.
pub(crate) fn divided(known: &Known, x: usize, y: usize, white: [f32; 3]) -> Option<[f32; 3]> {
    if !known.valid.at(x, y) {
        return None;
    }
    let (p, variance) = (known.rgb.at(x, y), known.variance.at(x, y));
    let firm = (0..3).all(|c| white[c] > 0.0 && variance[c].sqrt() < MOST_DEVIATION * white[c]);
    firm.then(|| std::array::from_fn(|c| p[c] / white[c]))
}

/// The object as one view saw it: the texture through the lens, and what this view's sites say beside it, weighed by its
/// noise. Reflectance through the lens, by pixel of the frame; `None` elsewhere.
pub fn own_look(
    view: &Projection,
    texels: &[[f32; 3]],
    gain: f64,
    blur: [f32; 3],
) -> Image<Option<[f32; 3]>> {
    let (predicted, white) = (view.predict(texels, true, blur), view.white(blur));
    let (seen, cover) = view.plain(texels, blur);
    let mut out = Image::filled(view.frame.0, view.frame.1, None);
    let g = gain as f32;
    for y in 0..view.window.height {
        for x in 0..view.window.width {
            let (m, share) = (white.at(x, y), cover.at(x, y));
            if (0..3).any(|c| m[c] <= 0.0 || share[c] < LEAST_COVER) {
                continue;
            }
            let left = left_over(view, &predicted, g, x, y);
            // A view that has no unclipped site there has not seen it.
            let [Some(red), Some(green), Some(blue)] = left else { continue };
            let left = [red, green, blue];
            *out.at_mut(view.window.left + x, view.window.top + y) = Some(std::array::from_fn(|c| {
                let (value, variance) = (left[c].0 / (g * m[c]), left[c].1 / (g * m[c]).powi(2));
                let trust = OWN * OWN / (OWN * OWN + variance);
                seen.at(x, y)[c] / share[c] + trust * value
            }));
        }
    }
    out
}

/// What the prediction leaves of the sites round a pixel, by colour, and its variance: bilinear interpolation.
fn left_over(view: &Projection, predicted: &Rgb, g: f32, x: usize, y: usize) -> [Option<(f32, f32)>; 3] {
    let (mut sum, mut weight) = ([0.0f32; 3], [0.0f32; 3]);
    // Noise is each site's own, a displacement all sites'.
    let (mut variance, mut moved) = ([0.0f32; 3], [0.0f32; 3]);
    let own = view.sites.at(x, y);
    for dy in -1isize..=1 {
        for dx in -1isize..=1 {
            let (sx, sy) = (x as isize + dx, y as isize + dy);
            let (Some(site), Some(p)) = (view.sites.get(sx, sy), predicted.get(sx, sy)) else { continue };
            let c = usize::from(site.colour);
            let middle = site.colour == own.colour && own.variance.is_finite();
            if !site.variance.is_finite() || (middle && (dx, dy) != (0, 0)) {
                continue;
            }
            let w = ((2 - dx.abs()) * (2 - dy.abs())) as f32;
            sum[c] += w * (site.known - g * p[c]);
            weight[c] += w;
            variance[c] += w * w * site.variance;
            moved[c] += w * MISPLACED * g * slope(predicted, sx, sy, c);
        }
    }
    std::array::from_fn(|c| {
        (weight[c] > 0.0)
            .then(|| (sum[c] / weight[c], (variance[c] + moved[c] * moved[c]) / (weight[c] * weight[c])))
    })
}

/// Steepest change of a colour about a pixel, per pixel; the border's own value stands beyond it.
fn slope(image: &Rgb, x: isize, y: isize, c: usize) -> f32 {
    let at = |dx: isize, dy: isize| image.get(x + dx, y + dy).or(image.get(x, y)).map_or(0.0, |p| p[c]);
    (0.5 * (at(1, 0) - at(-1, 0))).hypot(0.5 * (at(0, 1) - at(0, -1)))
}

#[cfg(test)]
mod tests {
    use super::super::projection::Ground;
    use super::super::projection::tests::{SIZE, flat_view};
    use super::*;

    /// A view of paint of 0.5 whose light falls to a sixth across a column, as at a depth edge; its sites say what
    /// `reading` makes of the prediction there.
    fn look(reading: impl Fn(&Rgb, usize, usize, usize) -> f32) -> Image<Option<[f32; 3]>> {
        let mut view = flat_view(0, 3000.0);
        for (i, white) in view.white.pixels_mut().iter_mut().enumerate() {
            if i % SIZE >= SIZE / 2 {
                *white = white.map(|w| w / 6.0);
            }
        }
        let ground = Ground::number(SIZE, std::iter::once(&mut view));
        let texels = vec![[0.5; 3]; ground.len()];
        let predicted = view.predict(&texels, true, [0.6; 3]);
        for y in 0..SIZE {
            for x in 0..SIZE {
                let site = view.sites.at_mut(x, y);
                site.known = reading(&predicted, x, y, usize::from(site.colour));
                site.variance = 100.0;
            }
        }
        own_look(&view, &texels, 1.0, [0.6; 3])
    }

    fn largest_error(image: &Image<Option<[f32; 3]>>, truth: f32, columns: std::ops::Range<usize>) -> f32 {
        let places = columns.flat_map(|x| (30..34).map(move |y| (x, y)));
        let errors = places.filter_map(|(x, y)| *image.at(20 + x, 20 + y)).flatten();
        errors.map(|v| (v - truth).abs()).fold(f32::NAN, f32::max)
    }

    #[test]
    fn a_photograph_displaced_at_an_edge_of_light_does_not_make_bright_spots() {
        let shifted = |p: &Rgb, x: usize, y: usize, c: usize| {
            let left = p.at(x.saturating_sub(1), y)[c];
            0.85 * p.at(x, y)[c] + 0.15 * left
        };
        let error = largest_error(&look(shifted), 0.5, 24..40);
        assert!(error < 0.1, "{error}");
    }

    #[test]
    fn where_nothing_changes_fast_a_view_tells_its_own() {
        let brighter = |p: &Rgb, x: usize, y: usize, c: usize| 1.2 * p.at(x, y)[c];
        let image = look(brighter);
        let error = largest_error(&image, 0.6, 26..30);
        assert!(error < 0.015, "{error}");
        let error = largest_error(&image, 0.6, 35..38);
        assert!(error < 0.04, "{error}");
    }
}
