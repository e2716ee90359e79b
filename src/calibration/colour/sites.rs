//! A chart's light on sensor sites, and what each patch reads.

use super::charts::PATCHES;
use super::plane::{MEASURED_HALF, measured_corners, patch_centre, project};
use crate::photometry::{Mosaic, linear};
use crate::raster::{Image, Rgb};
use glam::{DMat3, DVec2};

/// Share of a patch's sites that may be clipped: hot pixels, not highlights.
const MOST_CLIPPED: f64 = 0.002;

/// Fewest sites of each colour in a patch.
const LEAST_SITES: usize = 12;

/// Deviations from the median, in standard deviations, beyond which a site is dust or a defect.
const OUTLIER: f64 = 4.0;

/// A frame of a chart, or the difference of a lit and an unlit one, on sensor sites. Nothing is copied.
#[derive(Clone, Copy)]
pub struct ChartFrame<'a> {
    on: &'a Mosaic,
    off: Option<(&'a Mosaic, f32)>,
}

/// Two frames of different size or filter array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the frames differ in size or colour filter array: the frame without flash must be of the same camera and format"
)]
pub struct FramesDiffer;

/// What a patch reads.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Mean over the patch's middle, R, G, B, DN above black.
    pub rgb_dn: [f64; 3],
    /// Standard error of the mean from the sites' scatter, DN.
    pub error_dn: [f64; 3],
    /// Sites counted.
    pub sites: usize,
    /// Share of clipped sites, 0 to 1.
    pub clipped_share: f64,
    /// Why the patch cannot be used; absent if it can.
    pub left_out: Option<String>,
}

impl<'a> ChartFrame<'a> {
    /// The light on `on`, less `scale` times that on the second frame; `scale` is the ratio of their exposures.
    pub fn new(on: &'a Mosaic, off: Option<(&'a Mosaic, f32)>) -> Result<Self, FramesDiffer> {
        let size = |m: &Mosaic| (m.dn.width(), m.dn.height(), m.cfa);
        match off {
            Some((off, _)) if size(off) != size(on) => Err(FramesDiffer),
            _ => Ok(Self { on, off }),
        }
    }

    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.on.dn.width(), self.on.dn.height())
    }

    /// DN above black of the known light; `None` where either frame is clipped.
    fn value(&self, x: usize, y: usize) -> Option<f32> {
        let on = linear(self.on, x, y)?;
        match self.off {
            Some((off, scale)) => Some(on - scale * linear(off, x, y)?),
            None => Some(on),
        }
    }

    /// The same, with the sensor's range where it is clipped: good for looking only.
    fn shown(&self, x: usize, y: usize) -> f32 {
        let levels = &self.on.levels;
        let range = levels.saturation[y & 1][x & 1] - levels.black[y & 1][x & 1];
        self.value(x, y).unwrap_or(range)
    }

    /// Means of each colour over blocks of `block` x `block` sites, at least 2, as linear camera RGB. Sites at the
    /// right and lower border that fill no block are left out.
    pub fn preview(&self, block: usize) -> Rgb {
        let block = block.max(2);
        let (width, height) = self.size();
        Image::from_fn(width / block, height / block, |column, row| {
            let (mut sum, mut count) = ([0.0f32; 3], [0.0f32; 3]);
            for y in row * block..(row + 1) * block {
                for x in column * block..(column + 1) * block {
                    let c = self.on.cfa.colour(x, y);
                    sum[c] += self.shown(x, y);
                    count[c] += 1.0;
                }
            }
            std::array::from_fn(|c| if count[c] > 0.0 { sum[c] / count[c] } else { 0.0 })
        })
    }

    /// What all patches read; `image_from_chart` maps to sites.
    pub fn readings(&self, image_from_chart: &DMat3) -> Vec<Reading> {
        (0..PATCHES).map(|patch| self.reading(image_from_chart, patch)).collect()
    }

    fn reading(&self, image_from_chart: &DMat3, patch: usize) -> Reading {
        let corners = measured_corners(image_from_chart, patch);
        let chart_from_image = image_from_chart.inverse();
        let (width, height) = self.size();
        let low = corners.iter().fold(DVec2::INFINITY, |m, p| m.min(*p)).max(DVec2::ZERO);
        let high = corners.iter().fold(DVec2::NEG_INFINITY, |m, p| m.max(*p));
        let mut values: [Vec<f32>; 3] = Default::default();
        let (mut clipped, mut sites) = (0usize, 0usize);
        // Negative or endless borders turn to 0 and the frame's size.
        for y in low.y as usize..(high.y.ceil() as usize).min(height) {
            for x in low.x as usize..(high.x.ceil() as usize).min(width) {
                let at = project(&chart_from_image, DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                if (at - patch_centre(patch)).abs().max_element() > MEASURED_HALF {
                    continue;
                }
                sites += 1;
                match self.value(x, y) {
                    Some(v) => values[self.on.cfa.colour(x, y)].push(v),
                    None => clipped += 1,
                }
            }
        }
        let clipped_share = clipped as f64 / sites.max(1) as f64;
        let few = values.iter().any(|v| v.len() < LEAST_SITES);
        let means = values.each_mut().map(|v| robust_mean(v));
        let rgb_dn = means.map(|m| m.0);
        let left_out = if clipped_share > MOST_CLIPPED {
            Some(format!("{:.1} % of its sites are clipped; expose less", 100.0 * clipped_share))
        } else if few {
            Some(format!("only {sites} sites of it are in the frame; shoot the chart larger"))
        } else if rgb_dn.iter().sum::<f64>() <= 0.0 {
            Some("it has no light; expose more".into())
        } else {
            None
        };
        Reading { rgb_dn, error_dn: means.map(|m| m.1), sites, clipped_share, left_out }
    }
}

/// Mean and its standard error without those far off the median; zeros without values.
fn robust_mean(values: &mut [f32]) -> (f64, f64) {
    let Some(median) = median(values) else { return (0.0, 0.0) };
    let mut off: Vec<f32> = values.iter().map(|v| (v - median).abs()).collect();
    // A scatter below a DN's own rounding is none.
    let scatter = self::median(&mut off).map_or(0.0, |m| 1.4826 * f64::from(m)).max(0.5);
    let near = |v: &&f32| f64::from((**v - median).abs()) <= OUTLIER * scatter;
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for v in values.iter().filter(near) {
        let v = f64::from(*v - median);
        (n, sum, squares) = (n + 1.0, sum + v, squares + v * v);
    }
    let mean: f64 = sum / n;
    let error = if n > 1.0 { ((squares / n - mean * mean).max(0.0) / (n - 1.0)).sqrt() } else { 0.0 };
    (f64::from(median) + mean, error)
}

fn median(values: &mut [f32]) -> Option<f32> {
    let at = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(at, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dust_does_not_move_a_patch_and_noise_gives_its_error() {
        let mut values: Vec<f32> = (0..400).map(|k| 1000.0 + [-10.0, 10.0][k % 2]).collect();
        values[..20].fill(0.0);
        let (mean, error) = robust_mean(&mut values);
        assert!(
            (mean - 1000.0).abs() < 1e-6 && (error - 10.0 / 379f64.sqrt()).abs() < 0.01,
            "{mean} {error}"
        );
        assert_eq!(robust_mean(&mut []), (0.0, 0.0));
        assert_eq!(robust_mean(&mut [7.0; 9]), (7.0, 0.0));
    }
}
