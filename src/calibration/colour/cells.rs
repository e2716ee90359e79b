//! A frame with one RGB value a cell of the filter array: half as wide and half as high as the sensor.
//!
//! Binning a cell's sites keeps every value a plain mean of measured ones; no interpolation blurs a patch into its
//! neighbours from farther away than the cell.

use crate::photometry::Mosaic;
use crate::raster::{Image, Rgb};

/// Share of the range between black and saturation above which a site counts as clipped, as in isolation.
const CLIP: f32 = 0.985;

/// Linear camera RGB of a frame's cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// DN above black, greens averaged; negatives are kept.
    pub rgb: Rgb,
    /// Whether a site of the cell is clipped.
    pub clipped: Image<bool>,
}

/// Two frames of different sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the lit frame is {on:?} cells of the filter array and the unlit one {off:?}: both must be of one camera and format")]
pub struct OtherSize {
    /// Width and height of the lit frame.
    pub on: (usize, usize),
    /// Width and height of the unlit frame.
    pub off: (usize, usize),
}

impl Cells {
    /// Bins a frame.
    pub fn of(mosaic: &Mosaic) -> Self {
        let (width, height) = (mosaic.dn.width() / 2, mosaic.dn.height() / 2);
        let (black, saturation) = (mosaic.levels.black, mosaic.levels.saturation);
        let counts = mosaic.cfa.0.as_flattened().iter().fold([0.0f32; 3], |mut counts, colour| {
            counts[usize::from(*colour).min(2)] += 1.0;
            counts
        });
        let site = |x: usize, y: usize| f32::from(*mosaic.dn.at(x, y)) - black[y & 1][x & 1];
        let rgb = Image::from_fn(width, height, |x, y| {
            let mut sum = [0.0f32; 3];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                sum[mosaic.cfa.colour(dx, dy).min(2)] += site(2 * x + dx, 2 * y + dy);
            }
            std::array::from_fn(|c| sum[c] / counts[c].max(1.0))
        });
        let clipped = Image::from_fn(width, height, |x, y| {
            [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().any(|(dx, dy)| {
                site(2 * x + dx, 2 * y + dy) >= CLIP * (saturation[dy][dx] - black[dy][dx])
            })
        });
        Self { rgb, clipped }
    }

    /// The light that this frame has and the other has not: lit minus unlit, at equal settings. What is clipped in
    /// either is clipped.
    pub fn minus(mut self, off: &Self) -> Result<Self, OtherSize> {
        let size = |cells: &Self| (cells.rgb.width(), cells.rgb.height());
        if size(&self) != size(off) {
            return Err(OtherSize { on: size(&self), off: size(off) });
        }
        for (on, off) in self.rgb.pixels_mut().iter_mut().zip(off.rgb.pixels()) {
            *on = std::array::from_fn(|c| on[c] - off[c]);
        }
        for (on, off) in self.clipped.pixels_mut().iter_mut().zip(off.clipped.pixels()) {
            *on |= off;
        }
        Ok(self)
    }

    /// Means over blocks of `factor` x `factor` cells; what is left over at right and bottom is dropped.
    pub fn shrunk(&self, factor: usize) -> Rgb {
        let factor = factor.max(1);
        let per = 1.0 / (factor * factor) as f32;
        Image::from_fn(self.rgb.width() / factor, self.rgb.height() / factor, |x, y| {
            let mut sum = [0.0f32; 3];
            for row in y * factor..(y + 1) * factor {
                for column in x * factor..(x + 1) * factor {
                    let value = self.rgb.at(column, row);
                    (0..3).for_each(|c| sum[c] += value[c]);
                }
            }
            sum.map(|s| s * per)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};

    fn mosaic(cfa: Cfa, dn: impl Fn(usize, usize, usize) -> u16) -> Mosaic {
        let levels = Levels {
            black: [[100.0; 2]; 2],
            saturation: [[1100.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn: Image::from_fn(9, 6, |x, y| dn(cfa.colour(x, y), x, y)), cfa, levels }
    }

    #[test]
    fn cells_hold_each_colours_mean_above_black_whatever_the_array() {
        for cfa in [Cfa::RGGB, Cfa([[1, 2], [0, 1]]), Cfa([[2, 1], [1, 0]])] {
            let cells = Cells::of(&mosaic(cfa, |c, x, y| [140, 300, 60][c] + (x + y) as u16));
            assert_eq!((cells.rgb.width(), cells.rgb.height()), (4, 3));
            let [r, g, b] = *cells.rgb.at(0, 0);
            assert!((g - 201.0).abs() <= 1.0 && (40.0..=42.0).contains(&r) && (-40.0..=-38.0).contains(&b));
            assert!(!cells.clipped.pixels().contains(&true));
        }
    }

    #[test]
    fn the_unlit_frame_is_taken_off_and_clipping_stays() {
        let lit = Cells::of(&mosaic(Cfa::RGGB, |_, x, y| if (x, y) == (2, 2) { 1099 } else { 500 }));
        let off = Cells::of(&mosaic(Cfa::RGGB, |_, x, _| if x == 7 { 1100 } else { 150 }));
        let known = lit.minus(&off).unwrap();
        assert_eq!(*known.rgb.at(0, 0), [350.0; 3]);
        let clipped: Vec<usize> = (0..12).filter(|i| known.clipped.pixels()[*i]).collect();
        assert_eq!(clipped, [3, 5, 7, 11]);
        let small = Cells { rgb: Image::filled(2, 2, [0.0; 3]), clipped: Image::filled(2, 2, false) };
        assert!(known.minus(&small).unwrap_err().to_string().contains("one camera"));
    }

    #[test]
    fn shrinking_averages() {
        let cells = Cells::of(&mosaic(Cfa::RGGB, |_, x, _| 100 + (x as u16 / 2) * 10));
        let small = cells.shrunk(2);
        assert_eq!((small.width(), small.height()), (2, 1));
        assert_eq!(*small.at(1, 0), [25.0; 3]);
    }
}
