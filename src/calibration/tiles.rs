//! A frame of something even, reduced to the means of tiles: what the series of [`exposure`](super::exposure) and
//! [`flat`](super::flat) keep of each shot.
//!
//! The frame is divided into whole filter cells, all of it, at most `MOST` tiles along a side and none smaller than
//! `LEAST` sites. A tile tells, by colour, the mean above black and the variance of that mean. The variance is that of
//! the body's noise where it was measured; the sensor's fixed pattern is not in it: frames of one series share it, so that
//! it cancels in their ratio, and in a curve over the frame it shows as residual. Else the variance is the frame's own, in
//! which the fixed pattern counts as noise: along a row, `x0 - 2 x1 + x2` of three sites of one colour has six times the variance of one site, and
//! no slope of the light is in it. A single tile holds few sites to tell it from, so a straight line over all tiles of
//! the frame, variance against mean, is put in its place; it lies between a constant (read noise alone) and the
//! proportional (shot noise alone) one.
//!
//! A tile is over-exposed in a colour if its mean lies above `HIGHEST` of the range or more than `STRAY` of its
//! sites are clipped. Whole tiles go by their mean, never single sites by their own value: leaving out the sites that
//! noise has lifted over a limit would make the rest too dark. Single clipped sites in a dark tile are defects of the
//! sensor and are left out. A tile of which as much lies at 0 DN is left out too: what noise makes of it below that was cut
//! off, and its mean lies too high.

use crate::pair::Settings;
use crate::photometry::{Cfa, Mosaic, NoiseModel};

/// Most tiles along a side.
const MOST: usize = 96;
/// Least sites along a tile's side.
const LEAST: usize = 8;
/// Share of the range from black to saturation up to which a tile's mean is believed.
pub const HIGHEST: f64 = 0.9;
/// Share of clipped sites, and of sites at 0 DN, that are taken for defects.
pub(super) const STRAY: f64 = 1e-3;

/// One colour of one tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tile {
    /// Mean above black, DN.
    pub mean: f64,
    /// Variance of the mean, DN^2.
    pub variance: f64,
    /// Sites that the mean is of.
    pub sites: f64,
}

/// A frame's tiles.
#[derive(Clone, Debug, PartialEq)]
pub struct Tiles {
    /// Columns and rows of the frame, in sites.
    pub size: (usize, usize),
    /// Filter array.
    pub cfa: Cfa,
    /// Tiles along a row, and rows of tiles.
    pub grid: (usize, usize),
    /// Row by row, by colour (R, G, B); none where over-exposed, or where the filter array has no such colour.
    pub tiles: Vec<[Option<Tile>; 3]>,
    /// Share of tiles and colours that are over-exposed, 0 to 1.
    pub over_exposed: f64,
    /// Share of tiles and colours that are cut off at 0 DN, 0 to 1.
    pub cut_off: f64,
}

/// A frame of something even, reduced.
#[derive(Clone, Debug, PartialEq)]
pub struct EvenFrame {
    /// What its file tells.
    pub settings: Settings,
    /// Its light.
    pub tiles: Tiles,
}

/// The frame is too small to be divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the frame has {0} x {1} pixels only; give raw files of the whole sensor")]
pub struct TooSmall(pub usize, pub usize);

/// Sums over one filter position of one tile.
#[derive(Clone, Copy, Default)]
struct Sums {
    light: f64,
    sites: f64,
    clipped: f64,
    /// Sites at 0 DN.
    nought: f64,
    /// Squared second differences, and their count.
    squares: f64,
    differences: f64,
}

impl Tiles {
    /// Divides and measures a frame; `noise` is the body's at the frame's ISO, where it was measured.
    pub fn of(frame: &Mosaic, noise: Option<NoiseModel>) -> Result<Self, TooSmall> {
        let (width, height) = (frame.dn.width(), frame.dn.height());
        let along = |sites: usize| (sites / LEAST).min(MOST);
        let grid = (along(width), along(height));
        if grid.0 == 0 || grid.1 == 0 {
            return Err(TooSmall(width, height));
        }
        let (mut tiles, mut spreads) = (vec![], vec![]);
        let (mut lost, mut cut, mut all) = (0.0, 0.0, 0.0);
        for (row, column) in (0..grid.1).flat_map(|row| (0..grid.0).map(move |column| (row, column))) {
            let (x, y) = (edges(width, grid.0, column), edges(height, grid.1, row));
            let mut tile = [None; 3];
            let mut spread = [None; 3];
            for colour in 0..3 {
                let Some((mean, variance, sites)) = measure(frame, x, y, colour) else { continue };
                all += 1.0;
                match mean {
                    Mean::Known(mean) => {
                        tile[colour] = Some(Tile { mean, variance: 0.0, sites });
                        spread[colour] = variance;
                    }
                    Mean::OverExposed => lost += 1.0,
                    Mean::CutOff => cut += 1.0,
                }
            }
            tiles.push(tile);
            spreads.push(spread);
        }
        let measured = noise.map(|noise| [f64::from(noise.floor), f64::from(noise.gain)]);
        let lines = [0, 1, 2].map(|colour| measured.unwrap_or_else(|| line(&tiles, &spreads, colour)));
        for (colour, tile) in tiles.iter_mut().flat_map(|tile| tile.iter_mut().enumerate()) {
            if let Some(tile) = tile {
                // Rounding to whole DN is noise too.
                let [constant, slope] = lines[colour];
                tile.variance = (constant + slope * tile.mean.max(0.0)).max(1.0 / 12.0) / tile.sites;
            }
        }
        let over_exposed = if all > 0.0 { lost / all } else { 1.0 };
        let cut_off = if all > 0.0 { cut / all } else { 0.0 };
        Ok(Self { size: (width, height), cfa: frame.cfa, grid, tiles, over_exposed, cut_off })
    }

    /// Mean above black of each colour over the tiles that are not over-exposed, DN; `None` without any.
    pub fn means(&self) -> [Option<f64>; 3] {
        std::array::from_fn(|c| {
            let tiles = || self.tiles.iter().filter_map(|tile| tile[c]);
            let sites: f64 = tiles().map(|t| t.sites).sum();
            (sites > 0.0).then(|| tiles().map(|t| t.sites * t.mean).sum::<f64>() / sites)
        })
    }

    /// The sites that a tile reaches over: first and last but one, across and down.
    pub fn reach(&self, tile: usize) -> [(usize, usize); 2] {
        let (row, column) = (tile / self.grid.0, tile % self.grid.0);
        [edges(self.size.0, self.grid.0, column), edges(self.size.1, self.grid.1, row)]
    }
}

/// Where the tile of this number begins and the next one does, whole filter cells.
fn edges(sites: usize, tiles: usize, number: usize) -> (usize, usize) {
    let cells = sites / 2;
    (2 * (number * cells / tiles), 2 * ((number + 1) * cells / tiles))
}

/// Mean above black of one colour of a tile, DN, or why there is none.
enum Mean {
    Known(f64),
    OverExposed,
    CutOff,
}

/// Mean above black, variance of single sites and their count; `None` without sites.
fn measure(
    frame: &Mosaic,
    x: (usize, usize),
    y: (usize, usize),
    colour: usize,
) -> Option<(Mean, Option<f64>, f64)> {
    let width = frame.dn.width();
    let (mut light, mut sites, mut squares, mut differences) = (0.0, 0.0, 0.0, 0.0);
    let (mut found, mut over, mut cut) = (false, false, false);
    for (py, px) in frame.cfa.positions(colour) {
        found = true;
        let (black, saturation) = (frame.levels.black[py][px], frame.levels.saturation[py][px]);
        let mut sums = Sums::default();
        for row in (y.0 + py..y.1).step_by(2) {
            let values = frame.dn.pixels().get(row * width + x.0 + px..row * width + x.1).unwrap_or_default();
            let (mut before, mut last) = (None, None);
            for &dn in values.iter().step_by(2) {
                sums.nought += f64::from(u8::from(dn == 0));
                let dn = f32::from(dn);
                if dn >= saturation {
                    sums.clipped += 1.0;
                    (before, last) = (None, None);
                    continue;
                }
                let value = f64::from(dn - black);
                sums.light += value;
                sums.sites += 1.0;
                if let (Some(first), Some(middle)) = (before, last) {
                    let bend: f64 = first - 2.0 * middle + value;
                    sums.squares += bend * bend / 6.0;
                    sums.differences += 1.0;
                }
                (before, last) = (last, Some(value));
            }
        }
        let top = HIGHEST * f64::from(saturation - black);
        over |= sums.clipped > STRAY * (sums.sites + sums.clipped) || sums.light > top * sums.sites;
        cut |= sums.nought > STRAY * sums.sites;
        light += sums.light;
        sites += sums.sites;
        squares += sums.squares;
        differences += sums.differences;
    }
    if !found || sites == 0.0 {
        return found.then_some((Mean::OverExposed, None, 0.0));
    }
    let variance = (differences > 0.0).then(|| squares / differences);
    let mean = match (over, cut) {
        (true, _) => Mean::OverExposed,
        (false, true) => Mean::CutOff,
        (false, false) => Mean::Known(light / sites),
    };
    Some((mean, variance, sites))
}

/// The line through the tiles' own variances of a single site: constant, DN^2, and slope against the mean, DN.
fn line(tiles: &[[Option<Tile>; 3]], spreads: &[[Option<f64>; 3]], colour: usize) -> [f64; 2] {
    let points: Vec<(f64, f64)> = tiles
        .iter()
        .zip(spreads)
        .filter_map(|(tile, spread)| Some((tile[colour]?.mean, spread[colour]?)))
        .collect();
    let n = points.len().max(1) as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let (xx, xy) =
        points.iter().fold((0.0, 0.0), |(xx, xy), p| (xx + (p.0 - x).powi(2), xy + (p.0 - x) * (p.1 - y)));
    let slope = if xx > 0.0 && x > 0.0 { (xy / xx).clamp(0.0, y / x) } else { 0.0 };
    [y - slope * x, slope]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};
    use crate::raster::Image;

    fn frame(width: usize, height: usize, mut dn: impl FnMut(usize, usize) -> u16) -> Mosaic {
        let levels = Levels {
            black: [[100.0; 2]; 2],
            saturation: [[10_100.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn: Image::from_fn(width, height, &mut dn), cfa: Cfa::RGGB, levels }
    }

    #[test]
    fn tiles_reach_over_the_whole_frame_in_whole_cells() {
        let tiles = Tiles::of(&frame(1003, 334, |_, _| 600), None).unwrap();
        assert_eq!(tiles.grid, (96, 41));
        let sites: f64 = tiles.tiles.iter().flatten().flatten().map(|t| t.sites).sum();
        assert_eq!(sites, 1002.0 * 334.0);
        assert_eq!(tiles.reach(0)[0].0, 0);
        assert_eq!(tiles.reach(96 * 41 - 1).map(|r| r.1), [1002, 334]);
        assert_eq!(tiles.means(), [Some(500.0); 3]);
        assert_eq!(Tiles::of(&frame(6, 80, |_, _| 600), None), Err(TooSmall(6, 80)));
    }

    #[test]
    fn a_slope_is_no_noise_and_noise_is_told() {
        let slope = Tiles::of(&frame(64, 64, |x, _| 600 + 8 * x as u16), None).unwrap();
        let tile = slope.tiles[0][1].unwrap();
        assert!((tile.variance * tile.sites - 1.0 / 12.0).abs() < 1e-9, "{tile:?}");
        // +-30 at every second site of a colour: variance 900, and second differences of 120.
        let noisy = frame(64, 64, |x, _| if (x / 2) % 2 == 0 { 570 } else { 630 });
        let tile = Tiles::of(&noisy, None).unwrap().tiles[3][0].unwrap();
        assert!((tile.variance * tile.sites - 120.0 * 120.0 / 6.0).abs() < 1e-6, "{tile:?}");
        // A pattern that the sensor has by itself is no noise where noise is known.
        let known = NoiseModel { gain: 0.3, floor: 2.0 };
        let tile = Tiles::of(&noisy, Some(known)).unwrap().tiles[3][0].unwrap();
        assert!((tile.variance * tile.sites - (2.0 + 0.3 * tile.mean)).abs() < 1e-4, "{tile:?}");
    }

    #[test]
    fn over_exposed_tiles_go_and_single_defects_do_not() {
        let frame = frame(64, 64, |x, y| match (x, y) {
            (0..8, 0..8) => 9500,
            (40, 40) => 12_000,
            _ if x % 2 == 1 && y % 2 == 0 && x > 32 && y < 8 => 12_000,
            _ => 600,
        });
        let tiles = Tiles::of(&frame, None).unwrap();
        assert_eq!(tiles.tiles[0], [None; 3]);
        assert!(tiles.tiles[7][0].is_some() && tiles.tiles[7][1].is_none());
        assert!(tiles.tiles[5 * 8 + 5][0].is_none(), "one of sixteen sites is more than a stray one");
        assert!((tiles.over_exposed - (3.0 + 4.0 + 1.0) / 192.0).abs() < 1e-12, "{}", tiles.over_exposed);
        assert_eq!(tiles.cut_off, 0.0);
    }

    #[test]
    fn a_tile_whose_noise_is_cut_off_at_nought_does_not_count() {
        let tiles = Tiles::of(
            &frame(64, 64, |x, y| match (x, y) {
                (0..8, 0..8) if (x / 2 + y / 2) % 2 == 0 => 0,
                _ => 600,
            }),
            None,
        )
        .unwrap();
        assert_eq!(tiles.tiles[0], [None; 3]);
        assert_eq!((tiles.over_exposed, tiles.cut_off), (0.0, 3.0 / 192.0));
        assert_eq!(tiles.means(), [Some(500.0); 3]);
    }
}
