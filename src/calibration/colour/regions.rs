//! Even regions of a picture that have about the shape of a patch.

use crate::raster::{Image, Rgb};
use glam::DVec2;

/// Largest steps between neighbours within a region, as shares of the picture's bright end, on a square root's scale:
/// a sharp picture wants a high one, one out of focus and dark patches a low one.
const STEPS: [f32; 5] = [0.006, 0.012, 0.024, 0.048, 0.096];

/// Keeps the square root from lifting the noise of black.
const FLOOR: f32 = 0.002;

/// Fewest pixels of a region.
const LEAST_AREA: f64 = 9.0;

/// Most regions that are looked at; a picture with more is texture.
const MOST: usize = 900;

/// A region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Region {
    /// Centre of gravity, pixels.
    pub centre: DVec2,
    /// Pixels.
    pub area: f64,
}

/// Regions at all steps, each place once.
pub(super) fn regions(image: &Rgb) -> Vec<Region> {
    let roughness = roughness(&stabilised(image));
    let mut found: Vec<Region> = STEPS.iter().flat_map(|step| at_step(&roughness, *step)).collect();
    found.sort_by(|a, b| b.area.total_cmp(&a.area));
    let mut kept: Vec<Region> = vec![];
    for region in found {
        let same = |other: &Region| {
            other.area < 5.0 * region.area && other.centre.distance(region.centre) < 0.3 * region.area.sqrt()
        };
        if !kept.iter().any(same) {
            kept.push(region);
        }
        if kept.len() == MOST {
            break;
        }
    }
    kept
}

/// Square roots of each channel over its own bright end: a colour cast goes, and noise is about even.
fn stabilised(image: &Rgb) -> Rgb {
    let bright: [f32; 3] = std::array::from_fn(|c| {
        let mut values: Vec<f32> = image.pixels().iter().map(|p| p[c]).collect();
        let at = values.len() * 99 / 100;
        match values.get(at) {
            Some(_) => *values.select_nth_unstable_by(at, f32::total_cmp).1,
            None => 1.0,
        }
    });
    let bright = bright.map(|b| if b > 0.0 { b } else { 1.0 });
    image.map(|p| std::array::from_fn(|c| (p[c].max(0.0) / bright[c] + FLOOR).sqrt()))
}

/// Largest difference within 3x3 pixels over the channels; endless at the border.
fn roughness(image: &Rgb) -> Image<f32> {
    let (width, height) = (image.width(), image.height());
    Image::from_fn(width, height, |x, y| {
        if x == 0 || y == 0 || x + 1 >= width || y + 1 >= height {
            return f32::INFINITY;
        }
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for sy in y - 1..=y + 1 {
            for sx in x - 1..=x + 1 {
                let p = image.at(sx, sy);
                for c in 0..3 {
                    low[c] = low[c].min(p[c]);
                    high[c] = high[c].max(p[c]);
                }
            }
        }
        (0..3).map(|c| high[c] - low[c]).fold(0.0, f32::max)
    })
}

/// Connected pixels smoother than `step`, where they have a patch's shape.
fn at_step(roughness: &Image<f32>, step: f32) -> Vec<Region> {
    let (width, height) = (roughness.width(), roughness.height());
    let most = (width * height) as f64 / 30.0;
    let mut open: Vec<bool> = roughness.pixels().iter().map(|r| *r < step).collect();
    let (mut out, mut stack) = (vec![], vec![]);
    for first in 0..open.len() {
        if !open[first] {
            continue;
        }
        open[first] = false;
        stack.push(first);
        let (mut n, mut sum, mut squares) = (0.0, DVec2::ZERO, [0.0f64; 3]);
        let origin = DVec2::new((first % width) as f64, (first / width) as f64);
        while let Some(at) = stack.pop() {
            let p = DVec2::new((at % width) as f64, (at / width) as f64) - origin;
            n += 1.0;
            sum += p;
            squares = [squares[0] + p.x * p.x, squares[1] + p.y * p.y, squares[2] + p.x * p.y];
            // The border is not open, so that no neighbour lies outside.
            for next in [at - 1, at + 1, at - width, at + width] {
                if open[next] {
                    open[next] = false;
                    stack.push(next);
                }
            }
        }
        let mean = sum / n;
        // A pixel is a square itself, of variance 1/12.
        let own = 1.0 / 12.0;
        let (xx, yy) = (squares[0] / n - mean.x * mean.x + own, squares[1] / n - mean.y * mean.y + own);
        let xy = squares[2] / n - mean.x * mean.y;
        if n >= LEAST_AREA && n <= most && is_patch(n, xx, yy, xy) {
            out.push(Region { centre: origin + mean + 0.5, area: n });
        }
    }
    out
}

/// Whether second moments are those of a filled parallelogram, for which area^2 = 144 det; not too slim.
fn is_patch(area: f64, xx: f64, yy: f64, xy: f64) -> bool {
    let determinant = (xx * yy - xy * xy).max(0.0);
    let fullness = 12.0 * determinant.sqrt() / area;
    let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    (0.88..1.2).contains(&fullness) && mean + half < 12.0 * (mean - half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_turned_and_dark_are_regions_and_a_frame_is_none() {
        let turned = |x: f64, y: f64| ((x + y) / 2f64.sqrt(), (y - x) / 2f64.sqrt());
        let image = Image::from_fn(160, 100, |x, y| {
            let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
            let (a, b) = turned(x - 110.0, y - 50.0);
            let frame = (x - 40.0).abs().max((y - 50.0).abs());
            if a.abs() < 12.0 && b.abs() < 12.0 {
                [0.1, 0.02, 0.05]
            } else if frame < 8.0 {
                [0.5; 3]
            } else if (14.0..18.0).contains(&frame) {
                [0.8; 3]
            } else {
                [0.02; 3]
            }
        });
        let found = regions(&image);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found.iter().any(|r| r.centre.distance(DVec2::new(110.0, 50.0)) < 0.3), "{found:?}");
        assert!(found.iter().any(|r| r.centre.distance(DVec2::new(40.0, 50.0)) < 0.3), "{found:?}");
    }
}
