//! Two frames of the same light, reduced to small tiles: what differs between them is noise, what they share is pattern.

use crate::photometry::{Cfa, Mosaic};

/// Sites per edge of the smallest tile; even, so that every tile holds whole filter cells.
const TILE: usize = 16;
/// Tiles of a frame at most, about: large frames have larger tiles.
const MOST_TILES: usize = 1500;
/// Share of clipped sites up to which a colour's mean over the frame still stands: hot sites clip in any light.
const CLIPPED: f64 = 1e-4;

/// One filter position of one tile of a pair of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tile {
    /// 0 = red, 1 = green, 2 = blue.
    pub colour: usize,
    /// Mean of both frames, DN above black.
    pub signal: f64,
    /// Variance of one frame's site, DN^2, rounding included.
    pub variance: f64,
    /// Degrees of freedom of `variance`.
    pub freedom: f64,
    /// Covariance of the two frames, DN^2: variance of the fixed pattern.
    pub shared: f64,
}

/// Mean of a colour over the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Mean of both frames, DN above black.
    pub mean: f64,
    /// Standard error by the sites' noise alone, DN.
    pub noise: f64,
    /// Half of how far the two frames part, DN.
    pub apart: f64,
}

/// What two frames of the same light amount to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PairTiles {
    /// Tiles in which no site clips, at the top or at 0 DN.
    pub tiles: Vec<Tile>,
    /// Mean of each colour; absent where sites clip.
    pub signal: [Option<Signal>; 3],
    /// The two frames' places in the order given, from 0; empty if that is not told.
    pub shot_numbers: Vec<usize>,
}

/// Two frames that cannot be laid over each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "frames of {first:?} and {second:?} sites, or of two filter arrays, cannot be compared; give full frames of one camera"
)]
pub struct OtherSize {
    /// Width and height of the first.
    pub first: (usize, usize),
    /// Width and height of the second.
    pub second: (usize, usize),
}

/// Compares two frames. `black` in DN by filter position. In every tile a plane is taken off both frames, so that
/// neither a gradient of the light nor a lamp that flickers counts as noise.
pub fn compare(first: &Mosaic, second: &Mosaic, black: [[f64; 2]; 2]) -> Result<PairTiles, OtherSize> {
    let size = |frame: &Mosaic| (frame.dn.width(), frame.dn.height());
    if size(first) != size(second) || first.cfa != second.cfa {
        return Err(OtherSize { first: size(first), second: size(second) });
    }
    let (width, height) = size(first);
    let larger = (width * height) as f64 / (TILE * TILE * MOST_TILES) as f64;
    let edge = TILE * (larger.sqrt().ceil() as usize).max(1);
    let mut tiles = vec![];
    for y in (0..(height + 1).saturating_sub(edge)).step_by(edge) {
        for x in (0..(width + 1).saturating_sub(edge)).step_by(edge) {
            for position in Cfa::POSITIONS {
                tiles.extend(tile(first, second, (x, y), edge, position, black));
            }
        }
    }
    let signal = signals(first, second, black, &tiles);
    Ok(PairTiles { tiles, signal, shot_numbers: vec![] })
}

/// Sums over the sites of a tile; `a` and `b` are the frames' values, `u` and `v` the place from the tile's middle.
#[derive(Default)]
struct Sums {
    plain: [f64; 2],
    across: [f64; 2],
    down: [f64; 2],
    squares: [f64; 2],
    product: f64,
}

fn tile(
    first: &Mosaic,
    second: &Mosaic,
    (x0, y0): (usize, usize),
    edge: usize,
    (row, column): (usize, usize),
    black: [[f64; 2]; 2],
) -> Option<Tile> {
    let (side, black) = (edge / 2, black[row][column]);
    let middle = (side as f64 - 1.0) / 2.0;
    let top = first.levels.saturation[row][column].min(second.levels.saturation[row][column]);
    let mut sums = Sums::default();
    for j in 0..side {
        for i in 0..side {
            let (x, y) = (x0 + column + 2 * i, y0 + row + 2 * j);
            let pair = [*first.dn.at(x, y), *second.dn.at(x, y)];
            if pair.iter().any(|&dn| dn == 0 || f32::from(dn) >= top) {
                return None;
            }
            let values = pair.map(|dn| f64::from(dn) - black);
            let (u, v) = (i as f64 - middle, j as f64 - middle);
            for (k, value) in values.into_iter().enumerate() {
                sums.plain[k] += value;
                sums.across[k] += u * value;
                sums.down[k] += v * value;
                sums.squares[k] += value * value;
            }
            sums.product += values[0] * values[1];
        }
    }
    let n = (side * side) as f64;
    // Of the places from the middle: side times the sum of squares along one edge.
    let lever = n * (n - 1.0) / 12.0;
    let rest = |of_products: f64, k: usize, l: usize| {
        of_products
            - sums.plain[k] * sums.plain[l] / n
            - (sums.across[k] * sums.across[l] + sums.down[k] * sums.down[l]) / lever
    };
    let shared = rest(sums.product, 0, 1);
    let difference = rest(sums.squares[0], 0, 0) + rest(sums.squares[1], 1, 1) - 2.0 * shared;
    let freedom = n - 3.0;
    Some(Tile {
        colour: usize::from(first.cfa.0[row][column]).min(2),
        signal: 0.5 * (sums.plain[0] + sums.plain[1]) / n,
        variance: difference.max(0.0) / (2.0 * freedom),
        freedom,
        shared: shared / freedom,
    })
}

/// Means over the frame of the colours that do not clip.
fn signals(first: &Mosaic, second: &Mosaic, black: [[f64; 2]; 2], tiles: &[Tile]) -> [Option<Signal>; 3] {
    let mean = |frame: &Mosaic| {
        let (mut sum, mut sites) = ([0.0; 3], [0.0f64; 3]);
        for (y, line) in frame.dn.pixels().chunks_exact(frame.dn.width().max(1)).enumerate() {
            for (x, &dn) in line.iter().enumerate() {
                let colour = frame.cfa.colour(x, y).min(2);
                sum[colour] += f64::from(dn) - black[y & 1][x & 1];
                sites[colour] += 1.0;
            }
        }
        ([0, 1, 2].map(|c| sum[c] / sites[c].max(1.0)), sites)
    };
    let ((a, sites), (b, _)) = (mean(first), mean(second));
    let clipped = [first.clipped_shares(), second.clipped_shares()];
    [0, 1, 2].map(|c| {
        let own = || tiles.iter().filter(move |tile| tile.colour == c);
        let count = own().count();
        if clipped.iter().any(|shares| shares[c] > CLIPPED) || count == 0 {
            return None;
        }
        let variance = own().map(|tile| tile.variance).sum::<f64>() / count as f64;
        let noise = (variance / (2.0 * sites[c].max(1.0))).sqrt();
        Some(Signal { mean: 0.5 * (a[c] + b[c]), noise, apart: 0.5 * (a[c] - b[c]) })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{LevelSource, Levels};
    use crate::raster::Image;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal, Poisson};

    fn frame(dn: Image<u16>) -> Mosaic {
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[15_380.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn, cfa: Cfa::RGGB, levels }
    }

    #[test]
    fn noise_is_told_from_texture_gradient_and_flicker() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let electrons_per_dn = 3.4;
        let read = Normal::new(0.0, 1.5).unwrap();
        let shot = |light: f64, random: &mut rand_chacha::ChaCha8Rng| {
            frame(Image::from_fn(256, 192, |x, y| {
                let gradient = 1.0 + x as f64 / 512.0 - y as f64 / 900.0;
                // A checked surface, and one grain of dust.
                let texture = if (x / 2 + y / 2) % 2 == 0 { 1.02 } else { 0.98 };
                let dust = if (x / 4, y / 4) == (9, 11) { 0.5 } else { 1.0 };
                let mean = electrons_per_dn * light * gradient * texture * dust;
                let signal = Poisson::new(mean).unwrap().sample(random) / electrons_per_dn;
                (2048.0 + signal + read.sample(random)).round() as u16
            }))
        };
        let (a, b) = (shot(3000.0, &mut random), shot(3030.0, &mut random));
        let pair = compare(&a, &b, [[2048.0; 2]; 2]).unwrap();
        assert_eq!(pair.tiles.len(), 4 * 16 * 12);
        let expected = |tile: &Tile| tile.signal / electrons_per_dn + 1.5 * 1.5 + 1.0 / 12.0;
        let n = pair.tiles.len() as f64;
        let ratio = pair.tiles.iter().map(|t| t.variance / expected(t)).sum::<f64>() / n;
        assert!((ratio - 1.0).abs() < 0.025, "variance is {ratio} of what it should be");
        // The median: of the tiles with the dust, pattern is more.
        let mut patterns: Vec<f64> = pair.tiles.iter().map(|t| t.shared / t.signal.powi(2)).collect();
        patterns.sort_by(f64::total_cmp);
        let pattern = patterns[patterns.len() / 2];
        assert!((pattern.sqrt() / 0.02 - 1.0).abs() < 0.1, "pattern of {}", pattern.sqrt());
        let green = pair.signal[1].unwrap();
        assert!(green.mean > 3000.0 && green.noise < 1.0 && green.apart < -10.0, "{green:?}");
    }

    #[test]
    fn clipped_tiles_and_frames_of_two_sizes_are_not_compared() {
        let half = Image::from_fn(64, 32, |x, y| match x < 32 && (x + y) & 1 == 1 {
            true => 15_380,
            false => 9000,
        });
        let pair = compare(&frame(half.clone()), &frame(half), [[2048.0; 2]; 2]).unwrap();
        assert_eq!(pair.tiles.iter().filter(|t| t.colour == 1).count(), 2 * 2 * 2);
        assert_eq!(pair.tiles.iter().filter(|t| t.colour == 0).count(), 4 * 2);
        assert!(pair.signal[1].is_none() && pair.signal[0].unwrap().mean == 6952.0);
        let other = frame(Image::filled(32, 32, 3000));
        assert!(compare(&frame(Image::filled(64, 32, 3000)), &other, [[0.0; 2]; 2]).is_err());
        let clipped_at_black = frame(Image::filled(32, 32, 0));
        assert!(compare(&clipped_at_black, &clipped_at_black, [[0.0; 2]; 2]).unwrap().tiles.is_empty());
    }
}
