//! From sensor sites to three colours a pixel, linearly: means of the nearest sites of each colour.
//!
//! Linear, because the values may be negative and their errors must stay Gaussian. A pixel is known only if
//! every site that enters it is.

use super::KnownMosaic;
use crate::raster::{Image, Rgb};
use rayon::prelude::*;

/// The known light as an image: linear camera RGB in DN, its variance, and where it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    /// DN of known light.
    pub rgb: Rgb,
    /// Variance of each value in DN^2.
    pub variance: Rgb,
    /// False where a clipped site took part.
    pub valid: Image<bool>,
}

/// Bilinear interpolation of each colour over a mosaic.
pub fn demosaic(mosaic: &KnownMosaic) -> Known {
    let (width, height) = (mosaic.value.width(), mosaic.value.height());
    let rows: Vec<Vec<([f32; 3], [f32; 3], bool)>> =
        (0..height).into_par_iter().map(|y| (0..width).map(|x| pixel(mosaic, x, y)).collect()).collect();
    let all = Image::from_fn(width, height, |x, y| rows[y][x]);
    Known { rgb: all.map(|p| p.0), variance: all.map(|p| p.1), valid: all.map(|p| p.2) }
}

/// Weighted mean over the 3x3 neighbourhood: 4 for the site itself, 2 beside, 1 at the corners; for every
/// colour of a Bayer array this is bilinear interpolation.
fn pixel(mosaic: &KnownMosaic, x: usize, y: usize) -> ([f32; 3], [f32; 3], bool) {
    let (mut sum, mut weight, mut variance, mut valid) = ([0.0f32; 3], [0.0f32; 3], [0.0f32; 3], true);
    let own = mosaic.cfa.colour(x, y);
    for dy in -1isize..=1 {
        for dx in -1isize..=1 {
            let (sx, sy) = (x as isize + dx, y as isize + dy);
            let Some(value) = mosaic.value.get(sx, sy) else { continue };
            let colour = mosaic.cfa.colour(sx as usize, sy as usize);
            if colour == own && (dx, dy) != (0, 0) {
                continue;
            }
            let Some(value) = value else {
                valid = false;
                continue;
            };
            let w = ((2 - dx.abs()) * (2 - dy.abs())) as f32;
            sum[colour] += w * value;
            weight[colour] += w;
            variance[colour] += w * w * mosaic.variance.at(sx as usize, sy as usize);
        }
    }
    if !valid || weight.contains(&0.0) {
        return ([0.0; 3], [0.0; 3], false);
    }
    let mean = std::array::from_fn(|c| sum[c] / weight[c]);
    (mean, std::array::from_fn(|c| variance[c] / (weight[c] * weight[c])), true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{NoiseModel, isolate::tests::mosaic, isolate_dark};

    #[test]
    fn a_linear_ramp_of_each_colour_is_reproduced_inside() {
        let ramp = |c: usize, x: usize, y: usize| [100.0, 400.0, 50.0][c] + 3.0 * x as f32 + 5.0 * y as f32;
        let mut frame = mosaic(12, 10, |_, _| 0);
        let cfa = frame.cfa;
        frame.levels.black = [[0.0; 2]; 2];
        frame.dn = Image::from_fn(12, 10, |x, y| ramp(cfa.colour(x, y), x, y) as u16);
        let known = demosaic(&isolate_dark(&frame, &NoiseModel { gain: 0.0, floor: 1.0 }));
        for y in 1..9 {
            for x in 1..11 {
                for c in 0..3 {
                    assert!((known.rgb.at(x, y)[c] - ramp(c, x, y)).abs() < 1e-3, "{x} {y} {c}");
                }
            }
        }
        assert!((known.variance.at(5, 5)[frame.cfa.colour(5, 5)] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_clipped_site_takes_its_neighbours_with_it() {
        let frame = mosaic(8, 8, |x, y| if (x, y) == (4, 4) { 15000 } else { 4000 });
        let known = demosaic(&isolate_dark(&frame, &NoiseModel { gain: 0.0, floor: 1.0 }));
        assert!(!known.valid.at(4, 4) && !known.valid.at(3, 5) && *known.valid.at(1, 1));
    }
}
