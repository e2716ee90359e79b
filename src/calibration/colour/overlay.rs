//! A picture of where the patches were found.

use crate::raster::{Image, Rgb, srgb};
use glam::DVec2;

/// The preview as sRGB with the outline of each patch's measured part: green, red for those left out. `white` is
/// what white reads in the preview's unit; corners are in its pixels, each with whether the patch was used.
pub fn overlay(preview: &Rgb, white: [f64; 3], patches: &[([DVec2; 4], bool)]) -> Image<[u8; 3]> {
    let gain = white.map(|w| if w > 0.0 { (0.9 / w) as f32 } else { 1.0 });
    let mut out = preview.map(|p| std::array::from_fn(|c| srgb::encode_u8(p[c] * gain[c])));
    for (corners, used) in patches {
        let colour = if *used { [0, 255, 0] } else { [255, 0, 0] };
        for k in 0..4 {
            line(&mut out, corners[k], corners[(k + 1) % 4], colour);
        }
    }
    out
}

fn line(image: &mut Image<[u8; 3]>, from: DVec2, to: DVec2, colour: [u8; 3]) {
    // Ends far outside would draw for ever.
    let size = (image.width() + image.height()) as f64;
    let steps = (to - from).abs().max_element().ceil();
    if !(steps.is_finite() && steps <= 4.0 * size) {
        return;
    }
    for k in 0..=steps as usize {
        let at = from.lerp(to, k as f64 / steps.max(1.0));
        if at.min_element() >= 0.0 && (at.x as usize) < image.width() && (at.y as usize) < image.height() {
            *image.at_mut(at.x as usize, at.y as usize) = colour;
        }
    }
}
