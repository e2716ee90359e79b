//! Whether camera or object moved between the two frames.
//!
//! Flash and room light the same edges from different sides, so brightness cannot be compared; where the
//! edges are can. Both frames' gradients are divided by their strength (plus its median, which tames noise)
//! and correlated over small shifts, from coarse to fine; a quadric through the peak gives the fraction.
//! Noise of the two frames is independent, so that a peak which noise could have made is known as such.

use crate::photometry::Mosaic;
use crate::raster::Image;
use rayon::prelude::*;
use std::ops::Range;

/// Tiles of gradients, in cells of the level.
const TILE: usize = 96;
/// Tiles compared a level, those with the strongest edges first: bounds the work on large frames.
const MAX_TILES: usize = 64;
/// The finest level is at most this wide: a fraction of its cells is found to some hundredths, so that on a
/// 50 MP frame a cell of four sites still tells a tenth of a site.
const FINEST: usize = 2400;
/// The coarsest level is about this wide.
const COARSEST: usize = 80;
/// Shifts tried either way at the coarsest level, in its cells.
const COARSE_REACH: isize = 6;
/// Shifts tried either way round the coarser level's answer.
const FINE_REACH: isize = 3;
/// Standard deviations of pure noise by which a correlation must stand out.
const SIGNIFICANT: f64 = 7.0;

/// Displacement of the lit frame against the unlit one in sites (right, down); `None` where the frames
/// have too little structure in common to tell.
pub(super) fn shift(off: &Mosaic, on: &Mosaic) -> Option<(f64, f64)> {
    let mut sites_per_cell = 2.0;
    let mut finest = rayon::join(|| cells(off), || cells(on));
    while finest.0.width() > FINEST {
        finest = rayon::join(|| halved(&finest.0), || halved(&finest.1));
        sites_per_cell *= 2.0;
    }
    let mut levels = vec![finest];
    while let Some((a, b)) = levels.last()
        && a.width() > COARSEST
        && a.height() > 32
    {
        let next = (halved(a), halved(b));
        levels.push(next);
    }
    let mut guess = (0, 0);
    let mut answer = None;
    for (i, (off, on)) in levels.iter().enumerate().rev() {
        let reach = if i + 1 == levels.len() { COARSE_REACH } else { FINE_REACH };
        answer = correlate(off, on, guess, reach);
        let (x, y) = answer.map_or((0.0, 0.0), |(x, y)| (2.0 * x, 2.0 * y));
        guess = (x.round() as isize, y.round() as isize);
    }
    answer.map(|(x, y)| (sites_per_cell * x, sites_per_cell * y))
}

/// Means of the 2x2 cells, colours together, DN.
fn cells(mosaic: &Mosaic) -> Image<f32> {
    let (width, height) = (mosaic.dn.width() / 2, mosaic.dn.height() / 2);
    let dn = |x: usize, y: usize| f32::from(*mosaic.dn.at(x, y));
    Image::from_fn(width, height, |x, y| {
        let (x, y) = (2 * x, 2 * y);
        0.25 * (dn(x, y) + dn(x + 1, y) + dn(x, y + 1) + dn(x + 1, y + 1))
    })
}

fn halved(image: &Image<f32>) -> Image<f32> {
    Image::from_fn(image.width() / 2, image.height() / 2, |x, y| {
        let (x, y) = (2 * x, 2 * y);
        0.25 * (image.at(x, y) + image.at(x + 1, y) + image.at(x, y + 1) + image.at(x + 1, y + 1))
    })
}

fn length(gradient: &[f32; 2]) -> f32 {
    (gradient[0] * gradient[0] + gradient[1] * gradient[1]).sqrt()
}

/// Central differences, zero on the rim, each divided by its length plus the frame's median length.
fn unit_gradients(image: &Image<f32>) -> Image<[f32; 2]> {
    let (width, height) = (image.width(), image.height());
    let mut gradients = Image::from_fn(width, height, |x, y| {
        if x == 0 || y == 0 || x + 1 >= width || y + 1 >= height {
            return [0.0, 0.0];
        }
        [image.at(x + 1, y) - image.at(x - 1, y), image.at(x, y + 1) - image.at(x, y - 1)]
    });
    // Every seventh is plenty for a median.
    let mut lengths: Vec<f32> = gradients.pixels().iter().step_by(7).map(length).collect();
    let middle = lengths.len() / 2;
    let median =
        if lengths.is_empty() { 1.0 } else { *lengths.select_nth_unstable_by(middle, f32::total_cmp).1 };
    for g in gradients.pixels_mut() {
        let scale = 1.0 / (length(g) + median.max(f32::MIN_POSITIVE));
        *g = [g[0] * scale, g[1] * scale];
    }
    gradients
}

/// Best shift in cells round `guess`, or `None` if noise could have made the peak.
fn correlate(off: &Image<f32>, on: &Image<f32>, guess: (isize, isize), reach: isize) -> Option<(f64, f64)> {
    let (off, on) = (unit_gradients(off), unit_gradients(on));
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
    let columns = inside(guess.0 + reach, guess.0 - reach, on.width());
    let rows = inside(guess.1 + reach, guess.1 - reach, on.height());
    let tiles: Vec<Tile> = strongest_tiles(&on)
        .into_iter()
        .map(|(x, y)| Tile {
            columns: x.max(columns.start)..(x + TILE).min(columns.end),
            rows: y.max(rows.start)..(y + TILE).min(rows.end),
        })
        .filter(|tile| !tile.columns.is_empty())
        .collect();
    let per_shift: Vec<(f64, f64)> =
        shifts.par_iter().map(|&shift| correlation(&off, &on, &tiles, shift)).collect();
    let (still, _) = *per_shift.last()?;
    let scores: Vec<f64> = per_shift.iter().map(|&(score, _)| score).collect();
    let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    let (peak, noise) = per_shift[best];
    if peak < SIGNIFICANT * noise {
        return None;
    }
    if peak - still < SIGNIFICANT * noise && guess == (0, 0) && shifts[best] != (0, 0) {
        return Some((0.0, 0.0));
    }
    let (best_x, best_y) = shifts[best];
    let at = |dx: isize, dy: isize| {
        shifts.iter().position(|s| *s == (best_x + dx, best_y + dy)).map_or(f64::NAN, |i| scores[i])
    };
    let (x, y) = peak_of_quadric(at).unwrap_or((0.0, 0.0));
    Some((best_x as f64 + x, best_y as f64 + y))
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

/// Top left corners of the tiles with the strongest edges.
fn strongest_tiles(gradients: &Image<[f32; 2]>) -> Vec<(usize, usize)> {
    let across = gradients.width().div_ceil(TILE);
    let mut tiles: Vec<(f32, (usize, usize))> = (0..across * gradients.height().div_ceil(TILE))
        .map(|i| ((i % across) * TILE, (i / across) * TILE))
        .map(|(x, y)| {
            let rows = y..(y + TILE).min(gradients.height());
            let columns = x..(x + TILE).min(gradients.width());
            let strength = |y: usize| {
                columns.clone().map(|x| gradients.at(x, y)).map(|g| g[0] * g[0] + g[1] * g[1]).sum::<f32>()
            };
            (rows.map(strength).sum(), (x, y))
        })
        .collect();
    tiles.sort_by(|a, b| b.0.total_cmp(&a.0));
    tiles.into_iter().take(MAX_TILES).map(|(_, corner)| corner).collect()
}

/// A tile's cells in the lit frame, none of which leaves the unlit frame at any shift tried.
struct Tile {
    columns: Range<usize>,
    rows: Range<usize>,
}

/// Correlation over the tiles when `on` is moved by `shift` against `off`, and the standard deviation that
/// it would have if the two had nothing in common.
fn correlation(
    off: &Image<[f32; 2]>,
    on: &Image<[f32; 2]>,
    tiles: &[Tile],
    shift: (isize, isize),
) -> (f64, f64) {
    let width = on.width();
    let (mut score, mut variance) = (0.0, 0.0);
    for Tile { columns, rows } in tiles {
        for y in rows.clone() {
            let lit = &on.pixels()[y * width + columns.start..y * width + columns.end];
            let start = y.wrapping_add_signed(-shift.1) * width + columns.start.wrapping_add_signed(-shift.0);
            let unlit = &off.pixels()[start..start + lit.len()];
            let (mut row, mut row_variance) = (0.0f32, 0.0f32);
            for (a, b) in unlit.iter().zip(lit) {
                row += a[0] * b[0] + a[1] * b[1];
                row_variance += (a[0] * a[0] + a[1] * a[1]) * (b[0] * b[0] + b[1] * b[1]);
            }
            score += f64::from(row);
            variance += 0.5 * f64::from(row_variance);
        }
    }
    (score, variance.sqrt())
}
