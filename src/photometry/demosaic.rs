//! From sensor sites to three colours a pixel, linearly.
//!
//! Linear, because the values may be negative and their errors must stay Gaussian. Bilinear interpolation blurs red
//! and blue; the gradient-corrected filters of Malvar, He and Cutler ("High-quality linear interpolation for
//! demosaicing of Bayer-patterned color images", ICASSP 2004) add the fine structure of the colour that was
//! measured on the spot. They take grey to have equal values in all colours, so the sites are divided by what a
//! white surface reads before, and multiplied again after. Where the 5x5 neighbourhood is not whole (frame
//! border, clipped site), plain bilinear interpolation over the 3x3 one takes its place; a pixel whose 3x3
//! neighbourhood has a clipped site is not known.

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

/// Green on a red or blue site; weights in eighths, rows from top.
const CROSS: [[f32; 5]; 5] = [
    [0.0, 0.0, -1.0, 0.0, 0.0],
    [0.0, 0.0, 2.0, 0.0, 0.0],
    [-1.0, 2.0, 4.0, 2.0, -1.0],
    [0.0, 0.0, 2.0, 0.0, 0.0],
    [0.0, 0.0, -1.0, 0.0, 0.0],
];

/// Red or blue on a green site whose row holds that colour.
const ALONG: [[f32; 5]; 5] = [
    [0.0, 0.0, 0.5, 0.0, 0.0],
    [0.0, -1.0, 0.0, -1.0, 0.0],
    [-1.0, 4.0, 5.0, 4.0, -1.0],
    [0.0, -1.0, 0.0, -1.0, 0.0],
    [0.0, 0.0, 0.5, 0.0, 0.0],
];

/// Red on a blue site, blue on a red one.
const CORNERS: [[f32; 5]; 5] = [
    [0.0, 0.0, -1.5, 0.0, 0.0],
    [0.0, 2.0, 0.0, 2.0, 0.0],
    [-1.5, 0.0, 6.0, 0.0, -1.5],
    [0.0, 2.0, 0.0, 2.0, 0.0],
    [0.0, 0.0, -1.5, 0.0, 0.0],
];

const GREEN: usize = 1;

type Pixel = ([f32; 3], [f32; 3], bool);

/// Interpolates each colour; `white` is what a white surface reads in each, up to a common factor.
pub fn demosaic(mosaic: &KnownMosaic, white: [f64; 3]) -> Known {
    let white = if white.iter().all(|w| w.is_finite() && *w > 0.0) { white } else { [1.0; 3] };
    let white = white.map(|w| w as f32);
    let (width, height) = (mosaic.value.width(), mosaic.value.height());
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        corrected(mosaic, &white, x, y).unwrap_or_else(|| bilinear(mosaic, x, y))
    };
    let pixels: Vec<Pixel> = (0..width * height).into_par_iter().map(pixel).collect();
    Known {
        rgb: Image::from_fn(width, height, |x, y| pixels[y * width + x].0),
        variance: Image::from_fn(width, height, |x, y| pixels[y * width + x].1),
        valid: Image::from_fn(width, height, |x, y| pixels[y * width + x].2),
    }
}

/// The gradient-corrected filters; `None` unless the whole 5x5 neighbourhood is there.
fn corrected(mosaic: &KnownMosaic, white: &[f32; 3], x: usize, y: usize) -> Option<Pixel> {
    let (width, height) = (mosaic.value.width(), mosaic.value.height());
    if x < 2 || y < 2 || x + 2 >= width || y + 2 >= height {
        return None;
    }
    let (mut values, mut variances) = ([[0.0f32; 5]; 5], [[0.0f32; 5]; 5]);
    for (j, (values, variances)) in values.iter_mut().zip(&mut variances).enumerate() {
        for (i, (value, variance)) in values.iter_mut().zip(variances).enumerate() {
            let (sx, sy) = (x + i - 2, y + j - 2);
            let scale = white[mosaic.cfa.colour(sx, sy)];
            *value = (*mosaic.value.at(sx, sy))? / scale;
            *variance = mosaic.variance.at(sx, sy) / (scale * scale);
        }
    }
    let own = mosaic.cfa.colour(x, y);
    let (mut rgb, mut variance) = ([0.0; 3], [0.0; 3]);
    for c in 0..3 {
        let (mean, var) = if c == own {
            (values[2][2], variances[2][2])
        } else if c == GREEN {
            filter(&CROSS, false, &values, &variances)
        } else if own != GREEN {
            filter(&CORNERS, false, &values, &variances)
        } else {
            let in_row = mosaic.cfa.colour(x + 1, y) == c;
            filter(&ALONG, !in_row, &values, &variances)
        };
        rgb[c] = mean * white[c];
        variance[c] = var * white[c] * white[c];
    }
    Some((rgb, variance, true))
}

fn filter(
    weights: &[[f32; 5]; 5],
    turned: bool,
    values: &[[f32; 5]; 5],
    variances: &[[f32; 5]; 5],
) -> (f32, f32) {
    let (mut sum, mut variance) = (0.0, 0.0);
    for j in 0..5 {
        for i in 0..5 {
            let w = if turned { weights[i][j] } else { weights[j][i] } / 8.0;
            sum += w * values[j][i];
            variance += w * w * variances[j][i];
        }
    }
    (sum, variance)
}

/// Weighted mean over the 3x3 neighbourhood: 4 for the site itself, 2 beside, 1 at the corners; for every
/// colour of a Bayer array this is bilinear interpolation.
fn bilinear(mosaic: &KnownMosaic, x: usize, y: usize) -> Pixel {
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

    const QUIET: NoiseModel = NoiseModel { gain: 0.0, floor: 1.0 };

    fn developed(value: impl Fn(usize, usize, usize) -> f32, white: [f64; 3]) -> Known {
        let mut frame = mosaic(12, 10, |_, _| 0);
        let cfa = frame.cfa;
        frame.levels.black = [[0.0; 2]; 2];
        frame.dn = Image::from_fn(12, 10, |x, y| value(cfa.colour(x, y), x, y) as u16);
        demosaic(&isolate_dark(&frame, &QUIET), white)
    }

    #[test]
    fn a_linear_ramp_of_each_colour_is_reproduced_inside() {
        let ramp = |c: usize, x: usize, y: usize| [100.0, 400.0, 50.0][c] + 3.0 * x as f32 + 5.0 * y as f32;
        let known = developed(ramp, [1.0; 3]);
        for y in 1..9 {
            for x in 1..11 {
                for c in 0..3 {
                    assert!((known.rgb.at(x, y)[c] - ramp(c, x, y)).abs() < 1e-3, "{x} {y} {c}");
                }
            }
        }
        let own = crate::photometry::Cfa::RGGB.colour(5, 5);
        assert!((known.variance.at(5, 5)[own] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn fine_grey_stripes_are_sharper_than_bilinear_would_make_them() {
        let stripes = |x: usize| if x % 4 < 2 { 400.0 } else { 1200.0 };
        let value = |c: usize, x: usize, _: usize| [0.5, 1.0, 0.7][c] * stripes(x);
        let known = developed(value, [50.0, 100.0, 70.0]);
        let mut error = [0.0f32; 2];
        let frame_error =
            |rgb: [f32; 3], x: usize| (0..3).map(|c| (rgb[c] - value(c, x, 0)).abs()).sum::<f32>();
        let mut frame = mosaic(12, 10, |_, _| 0);
        let cfa = frame.cfa;
        frame.levels.black = [[0.0; 2]; 2];
        frame.dn = Image::from_fn(12, 10, |x, y| value(cfa.colour(x, y), x, y) as u16);
        let sites = isolate_dark(&frame, &QUIET);
        for y in 2..8 {
            for x in 2..10 {
                error[0] += frame_error(*known.rgb.at(x, y), x);
                error[1] += frame_error(bilinear(&sites, x, y).0, x);
            }
        }
        assert!(error[0] < 0.7 * error[1], "{error:?}");
    }

    #[test]
    fn a_clipped_site_takes_its_neighbours_with_it() {
        let frame = mosaic(8, 8, |x, y| if (x, y) == (4, 4) { 15000 } else { 4000 });
        let known = demosaic(&isolate_dark(&frame, &QUIET), [1.0; 3]);
        assert!(!known.valid.at(4, 4) && !known.valid.at(3, 5) && *known.valid.at(1, 1));
    }
}
