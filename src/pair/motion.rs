//! Whether camera or object moved between the two frames.
//!
//! Flash and room light the same edges from different sides, so brightness cannot be compared; where the
//! edges are can. Both frames' gradients are divided by their strength (plus its median, which tames noise)
//! and correlated over small shifts, from coarse to fine; a quadric through the peak gives the fraction.
//! Noise of the two frames is independent, so that a peak which noise could have made is known as such.
//! Only tiles with strong edges are compared, and gradients are computed in them alone: that bounds the work.

use super::survey::Cells;
use crate::raster::Image;
use rayon::prelude::*;
use std::ops::Range;

/// Tiles of gradients, in cells of the level.
const TILE: usize = 96;
/// Tiles compared a level, those with the strongest edges first: bounds the work on large frames.
const MAX_TILES: usize = 64;
/// The coarsest level is about this wide.
const COARSEST: usize = 80;
/// Shifts tried either way at the coarsest level, in its cells.
const COARSE_REACH: isize = 6;
/// Shifts tried either way round the coarser level's answer.
const FINE_REACH: isize = 3;
/// Standard deviations of pure noise by which a correlation must stand out.
const SIGNIFICANT: f64 = 7.0;
/// Rows between those that are looked at to find the strongest tiles.
const STRIDE: usize = 4;
/// Sums run in this many lanes, so that they become vector instructions.
const LANES: usize = 8;

/// Displacement of the lit frame against the unlit one in sites (right, down); `None` where the frames
/// have too little structure in common to tell.
pub(super) fn shift(off: &Cells, on: &Cells) -> Option<(f64, f64)> {
    let mut coarser: Vec<[Image<f32>; 2]> = vec![];
    loop {
        let [a, b] = coarser.last().map_or([&off.means, &on.means], |[a, b]| [a, b]);
        if a.width() <= COARSEST || a.height() <= 32 {
            break;
        }
        let (a, b) = rayon::join(|| halved(a), || halved(b));
        coarser.push([a, b]);
    }
    let finest = std::iter::once([&off.means, &on.means]);
    let levels: Vec<[&Image<f32>; 2]> = finest.chain(coarser.iter().map(|[a, b]| [a, b])).collect();
    let mut guess = (0, 0);
    let mut answer = None;
    for (i, [off, on]) in levels.iter().enumerate().rev() {
        let reach = if i + 1 == levels.len() { COARSE_REACH } else { FINE_REACH };
        answer = correlate(off, on, guess, reach);
        let (x, y) = answer.map_or((0.0, 0.0), |(x, y)| (2.0 * x, 2.0 * y));
        guess = (x.round() as isize, y.round() as isize);
    }
    let size = off.size as f64;
    answer.map(|(x, y)| (size * x, size * y))
}

fn halved(image: &Image<f32>) -> Image<f32> {
    let (width, height) = (image.width() / 2, image.height() / 2);
    let mut pixels = Vec::with_capacity(width * height);
    for rows in image.pixels().chunks_exact(2 * image.width().max(1)).take(height) {
        let (top, bottom) = rows.split_at(image.width());
        let cells = top.as_chunks::<2>().0.iter().zip(bottom.as_chunks::<2>().0);
        pixels.extend(cells.map(|(a, b)| 0.25 * (a[0] + a[1] + b[0] + b[1])));
    }
    // Width and height were halved as the rows and chunks were.
    Image::from_pixels(width, height, pixels).unwrap_or_else(|| Image::filled(0, 0, 0.0))
}

/// Central difference at a cell; zero on the rim.
fn gradient(image: &Image<f32>, x: usize, y: usize) -> [f32; 2] {
    if x == 0 || y == 0 || x + 1 >= image.width() || y + 1 >= image.height() {
        return [0.0, 0.0];
    }
    [image.at(x + 1, y) - image.at(x - 1, y), image.at(x, y + 1) - image.at(x, y - 1)]
}

fn length(gradient: [f32; 2]) -> f32 {
    (gradient[0] * gradient[0] + gradient[1] * gradient[1]).sqrt()
}

/// A frame's cells and the strength of its ordinary gradients.
struct Level<'a> {
    image: &'a Image<f32>,
    median: f32,
}

impl<'a> Level<'a> {
    fn new(image: &'a Image<f32>) -> Self {
        // Every seventeenth is plenty for a median.
        let width = image.width().max(1);
        let mut lengths: Vec<f32> = (0..image.pixels().len())
            .step_by(17)
            .map(|i| length(gradient(image, i % width, i / width)))
            .collect();
        let middle = lengths.len() / 2;
        let median =
            if lengths.is_empty() { 1.0 } else { *lengths.select_nth_unstable_by(middle, f32::total_cmp).1 };
        Self { image, median: median.max(f32::MIN_POSITIVE) }
    }

    /// Gradients of an area, each divided by its length plus the median. Beyond the frame there are none.
    fn unit_gradients(&self, left: isize, top: isize, width: usize, height: usize) -> Patch {
        let (columns, rows) = (self.image.width(), self.image.height());
        let mut patch = Patch { width, x: vec![0.0; width * height], y: vec![0.0; width * height] };
        let inner = |from: isize, size: usize, whole: usize| {
            let low = (1 - from).max(0) as usize;
            let high = (whole as isize - 1 - from).clamp(0, size as isize) as usize;
            low.min(high)..high
        };
        let (across, down) = (inner(left, width, columns), inner(top, height, rows));
        for row in down {
            let y = (top + row as isize) as usize;
            let start = (left + across.start as isize) as usize;
            let line = |y: usize, x: usize| &self.image.pixels()[y * columns + x..][..across.len()];
            let (west, east) = (line(y, start - 1), line(y, start + 1));
            let (north, south) = (line(y - 1, start), line(y + 1, start));
            let out = row * width + across.start..row * width + across.end;
            let (gx, gy) = (&mut patch.x[out.clone()], &mut patch.y[out]);
            for i in 0..across.len().min(gx.len()).min(gy.len()) {
                let (dx, dy) = (east[i] - west[i], south[i] - north[i]);
                let scale = 1.0 / ((dx * dx + dy * dy).sqrt() + self.median);
                gx[i] = dx * scale;
                gy[i] = dy * scale;
            }
        }
        patch
    }

    /// Top left corners of the tiles with the strongest edges.
    fn strongest_tiles(&self) -> Vec<(usize, usize)> {
        let (width, height) = (self.image.width(), self.image.height());
        let across = width.div_ceil(TILE);
        let corners = (0..across * height.div_ceil(TILE)).map(|i| ((i % across) * TILE, (i / across) * TILE));
        let mut tiles: Vec<(f32, (usize, usize))> = corners
            .map(|(x, y)| {
                let rows = (y..(y + TILE).min(height)).step_by(STRIDE);
                let strength = |y: usize| {
                    let line = self.unit_gradients(x as isize, y as isize, TILE.min(width - x), 1);
                    line.x.iter().zip(&line.y).map(|(x, y)| x * x + y * y).sum::<f32>()
                };
                (rows.map(strength).sum(), (x, y))
            })
            .collect();
        tiles.sort_by(|a, b| b.0.total_cmp(&a.0));
        tiles.into_iter().take(MAX_TILES).map(|(_, corner)| corner).collect()
    }
}

/// Unit gradients of an area, row by row.
struct Patch {
    width: usize,
    x: Vec<f32>,
    y: Vec<f32>,
}

impl Patch {
    fn row(&self, y: usize, columns: Range<usize>) -> (&[f32], &[f32]) {
        let at = y * self.width + columns.start..y * self.width + columns.end;
        (&self.x[at.clone()], &self.y[at])
    }
}

/// One tile of the lit frame and what of the unlit frame it may lie on.
struct Tile {
    lit: Patch,
    rows: usize,
    /// The unlit frame round the guess, wider by the reach on every side.
    near: Patch,
    /// The unlit frame at the same place.
    still: Patch,
}

/// Best shift in cells round `guess`, or `None` if noise could have made the peak.
fn correlate(off: &Image<f32>, on: &Image<f32>, guess: (isize, isize), reach: isize) -> Option<(f64, f64)> {
    let (off, on) = (Level::new(off), Level::new(on));
    let side = 2 * reach + 1;
    // No movement is always among the candidates, last.
    let shifts: Vec<(isize, isize)> = (0..side * side)
        .map(|i| (guess.0 + i % side - reach, guess.1 + i / side - reach))
        .chain([(0, 0)])
        .collect();
    // One region for all shifts, so that no shift is favoured for its larger overlap.
    let inside = |low: isize, high: isize, size: usize| {
        (low.max(0) as usize)..(size as isize + high.min(0)).max(0) as usize
    };
    let columns = inside(guess.0 + reach, guess.0 - reach, on.image.width());
    let rows = inside(guess.1 + reach, guess.1 - reach, on.image.height());
    let tiles: Vec<Tile> = on
        .strongest_tiles()
        .into_par_iter()
        .filter_map(|(x, y)| {
            let columns = x.max(columns.start)..(x + TILE).min(columns.end);
            let rows = y.max(rows.start)..(y + TILE).min(rows.end);
            if columns.is_empty() || rows.is_empty() {
                return None;
            }
            let (left, top, width, height) =
                (columns.start as isize, rows.start as isize, columns.len(), rows.len());
            let margin = 2 * reach as usize;
            Some(Tile {
                lit: on.unit_gradients(left, top, width, height),
                rows: height,
                near: off.unit_gradients(
                    left - guess.0 - reach,
                    top - guess.1 - reach,
                    width + margin,
                    height + margin,
                ),
                still: off.unit_gradients(left, top, width, height),
            })
        })
        .collect();
    // Where the shift of index `i` lies on the unlit frame's patch.
    let place = |i: usize| match i as isize {
        i if i < side * side => (false, (2 * reach - i % side) as usize, (2 * reach - i / side) as usize),
        _ => (true, 0, 0),
    };
    let sum = |i: usize, of: fn(&Patch, usize, &Patch, usize, usize) -> f64| -> f64 {
        let tile = |tile: &Tile| {
            let (still, x, y) = place(i);
            of(&tile.lit, tile.rows, if still { &tile.still } else { &tile.near }, x, y)
        };
        tiles.iter().map(tile).sum()
    };
    let scores: Vec<f64> = (0..shifts.len()).into_par_iter().map(|i| sum(i, product)).collect();
    let still = *scores.last()?;
    let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    let (peak, noise) = (scores[best], sum(best, variance).sqrt());
    if peak < SIGNIFICANT * noise {
        return None;
    }
    let (mut best_x, mut best_y) = shifts[best];
    if peak - still < SIGNIFICANT * noise && guess == (0, 0) {
        // A peak that does not stand out above no movement may be the neighbour of one between the two; farther
        // off it is chance.
        if best_x.abs() > 1 || best_y.abs() > 1 {
            return Some((0.0, 0.0));
        }
        (best_x, best_y) = (0, 0);
    }
    let at = |dx: isize, dy: isize| {
        shifts.iter().position(|s| *s == (best_x + dx, best_y + dy)).map_or(f64::NAN, |i| scores[i])
    };
    let (x, y) = peak_of_quadric(at).unwrap_or((0.0, 0.0));
    Some((best_x as f64 + x, best_y as f64 + y))
}

/// Sum of the scalar products of the lit patch's gradients and those of the unlit one from (x, y) on.
fn product(lit: &Patch, rows: usize, unlit: &Patch, x: usize, y: usize) -> f64 {
    over_rows(lit, rows, unlit, x, y, |ax, ay, bx, by| ax * bx + ay * by)
}

/// Variance that [`product`] would have if the two had nothing in common.
fn variance(lit: &Patch, rows: usize, unlit: &Patch, x: usize, y: usize) -> f64 {
    over_rows(lit, rows, unlit, x, y, |ax, ay, bx, by| 0.5 * (ax * ax + ay * ay) * (bx * bx + by * by))
}

fn over_rows(
    lit: &Patch,
    rows: usize,
    unlit: &Patch,
    x: usize,
    y: usize,
    term: impl Fn(f32, f32, f32, f32) -> f32,
) -> f64 {
    let mut total = 0.0;
    for row in 0..rows {
        let (ax, ay) = lit.row(row, 0..lit.width);
        let (bx, by) = unlit.row(y + row, x..x + lit.width);
        let mut lanes = [0f32; LANES];
        let whole = ax.as_chunks::<LANES>().0.iter().zip(ay.as_chunks::<LANES>().0);
        let other = bx.as_chunks::<LANES>().0.iter().zip(by.as_chunks::<LANES>().0);
        for ((ax, ay), (bx, by)) in whole.zip(other) {
            for i in 0..LANES {
                lanes[i] += term(ax[i], ay[i], bx[i], by[i]);
            }
        }
        let rest = ax.len() / LANES * LANES..ax.len();
        let rest: f32 = rest.map(|i| term(ax[i], ay[i], bx[i], by[i])).sum();
        total += f64::from(lanes.iter().sum::<f32>() + rest);
    }
    total
}

/// Where the quadric through the nine values round a peak has its top; `None` if it has none within one
/// cell, or a neighbour was not computed.
fn peak_of_quadric(at: impl Fn(isize, isize) -> f64) -> Option<(f64, f64)> {
    let (gx, gy) = (0.5 * (at(1, 0) - at(-1, 0)), 0.5 * (at(0, 1) - at(0, -1)));
    let (hxx, hyy) = (at(1, 0) + at(-1, 0) - 2.0 * at(0, 0), at(0, 1) + at(0, -1) - 2.0 * at(0, 0));
    let hxy = 0.25 * (at(1, 1) + at(-1, -1) - at(1, -1) - at(-1, 1));
    let determinant = hxx * hyy - hxy * hxy;
    if !(determinant > 0.0 && hxx < 0.0) {
        return None;
    }
    let x = (hxy * gy - hyy * gx) / determinant;
    let y = (hxy * gx - hxx * gy) / determinant;
    (x.abs() <= 1.0 && y.abs() <= 1.0).then_some((x, y))
}
