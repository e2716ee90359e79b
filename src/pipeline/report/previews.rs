//! Small pictures of the texture, its views and its deviations, for the report.

use crate::codec::png::{self, PngError};
use crate::export::report::{Picture, Scale};
use crate::raster::{Image, srgb};
use crate::reflectance::solve::Estimate;

/// Longest edge of a preview in pixels.
const EDGE: usize = 512;

/// What shows where a preview has no surface or no view, sRGB.
const NOTHING: [u8; 3] = [72, 72, 72];

/// Colours for numbers, low to high, ever brighter, so that they can be told apart without seeing colour.
const SCALE: [[u8; 3]; 5] = [[32, 26, 66], [92, 44, 110], [176, 68, 96], [230, 130, 70], [250, 222, 150]];

/// Estimates by texel: columns and rows, and how to ask for one.
#[derive(Clone, Copy)]
pub(in crate::pipeline) struct Estimates<'a> {
    pub(in crate::pipeline) size: (usize, usize),
    pub(in crate::pipeline) at: &'a dyn Fn(usize, usize) -> Option<Estimate>,
}

impl<'a> Estimates<'a> {
    fn seen(self) -> impl Iterator<Item = Estimate> + 'a {
        let (width, height) = self.size;
        (0..height).flat_map(move |y| (0..width).filter_map(move |x| (self.at)(x, y)))
    }
}

pub(super) fn previews(estimates: Estimates<'_>) -> Result<Vec<Picture>, PngError> {
    let picture = |colour: &dyn Fn(&Estimate) -> [f32; 3], caption: &str, scale| {
        let png = png::encode_rgb8(&shrunk(estimates, colour))?;
        Ok(Picture { png, caption: caption.to_owned(), scale })
    };
    let most = estimates.seen().map(|e| e.views).max().unwrap_or(1).max(1);
    let mut deviations: Vec<f32> = estimates.seen().map(|e| deviation(&e)).collect();
    deviations.sort_by(f32::total_cmp);
    // The worst hundredth would take the contrast from all others.
    let worst = deviations.get(deviations.len() * 99 / 100).copied().unwrap_or(1.0).max(1e-6);
    let scale = |low: &str, high: String| Some(Scale { colours: SCALE.into(), low: low.into(), high });
    Ok(vec![
        picture(
            &|e| e.rho,
            "Diffuse reflectance, camera RGB shown as if it were sRGB. Grey: not seen.",
            None,
        )?,
        picture(
            &|e| on_scale(f32::from(e.views) / f32::from(most)),
            "Views that made up each texel.",
            scale("0", most.to_string()),
        )?,
        picture(
            &|e| on_scale(deviation(e) / worst),
            "Standard deviation of the reflectance, mean of the channels.",
            scale("0", format!("{worst:.3} and more")),
        )?,
    ])
}

/// Mean over the channels.
fn deviation(estimate: &Estimate) -> f32 {
    estimate.sd.iter().sum::<f32>() / 3.0
}

/// The scale's colour at 0..1, in linear light.
fn on_scale(value: f32) -> [f32; 3] {
    let place = value.clamp(0.0, 1.0) * (SCALE.len() - 1) as f32;
    let low = (place as usize).min(SCALE.len() - 2);
    let between = place - low as f32;
    let (a, b) = (SCALE[low], SCALE[low + 1]);
    std::array::from_fn(|c| {
        srgb::decode((f32::from(a[c]) * (1.0 - between) + f32::from(b[c]) * between) / 255.0)
    })
}

/// Averages the estimates' colours (linear) over square blocks, so that no edge is longer than [`EDGE`].
fn shrunk(estimates: Estimates<'_>, colour: &dyn Fn(&Estimate) -> [f32; 3]) -> Image<[u8; 3]> {
    let (width, height) = estimates.size;
    let block = width.max(height).div_ceil(EDGE).max(1);
    Image::from_fn(width.div_ceil(block), height.div_ceil(block), |left, top| {
        let (mut sum, mut count) = ([0.0_f32; 3], 0.0_f32);
        for y in top * block..((top + 1) * block).min(height) {
            for x in left * block..((left + 1) * block).min(width) {
                if let Some(estimate) = (estimates.at)(x, y) {
                    let value = colour(&estimate);
                    (0..3).for_each(|c| sum[c] += value[c]);
                    count += 1.0;
                }
            }
        }
        if count > 0.0 { sum.map(|s| srgb::encode_u8(s / count)) } else { NOTHING }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn previews_are_small_and_average_only_what_is_seen() {
        let estimate = Estimate { rho: [0.25; 3], sd: [0.0; 3], views: 1 };
        let at = |x: usize, _: usize| (x < 1).then_some(estimate);
        let small = shrunk(Estimates { size: (1500, 300), at: &at }, &|e| e.rho);
        assert_eq!((small.width(), small.height()), (500, 100));
        assert_eq!(*small.at(0, 0), [srgb::encode_u8(0.25); 3]);
        assert_eq!(*small.at(1, 0), NOTHING);
    }

    #[test]
    fn the_scale_runs_from_its_first_colour_to_its_last() {
        let shown = |v| on_scale(v).map(srgb::encode_u8);
        assert_eq!([shown(-1.0), shown(0.25), shown(2.0)], [SCALE[0], SCALE[1], SCALE[4]]);
    }
}
