//! Small pictures of raw frames. For the eye alone: nothing is ever computed from them.
//!
//! Black is subtracted and whole 2x2 cells are averaged, so that no demosaicing is needed. One brightness
//! scale (saturation = white) and one neutral point (the frame's own mean, grey world) make frames
//! comparable; the sRGB curve follows.

use super::Mosaic;
use crate::raster::srgb::encode_u8;
use crate::raster::{Image, Rgb};

/// Means of blocks of whole filter cells, 0 = black, 1 = saturation, at most `edge` of them a side.
pub fn reduced(mosaic: &Mosaic, edge: usize) -> Rgb {
    let (cells_x, cells_y) = (mosaic.dn.width() / 2, mosaic.dn.height() / 2);
    let block = cells_x.max(cells_y).div_ceil(edge.max(1)).max(1);
    Image::from_fn(cells_x / block, cells_y / block, |x, y| average(mosaic, x, y, block))
}

/// The same as people are shown it.
pub fn for_the_eye(linear: &Rgb) -> Image<[u8; 3]> {
    let count = linear.pixels().len().max(1) as f32;
    let mean =
        linear.pixels().iter().fold([0.0f32; 3], |sum, p| std::array::from_fn(|c| sum[c] + p[c] / count));
    let neutral = mean.map(|m| if m > 1e-4 { mean[1] / m } else { 1.0 });
    linear.map(|p| std::array::from_fn(|c| encode_u8(p[c] * neutral[c])))
}

/// Mean of a block of cells per colour, 0 = black, 1 = saturation.
fn average(mosaic: &Mosaic, x: usize, y: usize, block: usize) -> [f32; 3] {
    let mut sum = [0.0f32; 3];
    let mut count = [0.0f32; 3];
    for row in y * block * 2..(y + 1) * block * 2 {
        for column in x * block * 2..(x + 1) * block * 2 {
            let (r, c) = (row & 1, column & 1);
            let (black, white) = (mosaic.levels.black[r][c], mosaic.levels.saturation[r][c]);
            let colour = mosaic.cfa.colour(column, row);
            sum[colour] += (f32::from(*mosaic.dn.at(column, row)) - black) / (white - black).max(1.0);
            count[colour] += 1.0;
        }
    }
    std::array::from_fn(|c| sum[c] / count[c].max(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};

    const EDGE: usize = 480;

    fn render(mosaic: &Mosaic) -> Image<[u8; 3]> {
        for_the_eye(&reduced(mosaic, EDGE))
    }

    fn even(width: usize, height: usize, dn: u16) -> Mosaic {
        Mosaic {
            dn: Image::filled(width, height, dn),
            cfa: Cfa::RGGB,
            levels: Levels {
                black: [[100.0; 2]; 2],
                saturation: [[1100.0; 2]; 2],
                black_source: LevelSource::FileTag,
                saturation_source: LevelSource::FileTag,
            },
        }
    }

    #[test]
    fn black_is_black_saturation_is_white_and_a_fifth_is_middle_grey() {
        assert_eq!(render(&even(8, 4, 100)).pixels()[0], [0; 3]);
        assert_eq!(render(&even(8, 4, 1100)).pixels()[0], [255; 3]);
        assert_eq!(render(&even(8, 4, 316)).pixels()[0], [128; 3]);
    }

    #[test]
    fn no_edge_is_longer_than_allowed_and_no_frame_is_too_small() {
        let small = render(&even(2 * EDGE * 3 + 2, 400, 500));
        assert!(small.width() <= EDGE && small.width() > EDGE / 2, "{}", small.width());
        assert_eq!(render(&even(1, 1, 500)).pixels().len(), 0);
    }
}
