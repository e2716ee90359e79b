//! One walk over the sensor values of both frames, from which all checks live.
//!
//! Takes the two frames, gives what is clipped inside and outside the region of interest, how much light came
//! in block by block against its own noise, and both frames shrunk to the cells in which movement and stops
//! are told. Every site is read once while its rows are in the cache; inner loops run over fixed lanes, which
//! compilers turn into vector instructions.

use crate::photometry::Mosaic;
use crate::photometry::inspect::Region;
use crate::raster::Image;
use rayon::prelude::*;

/// Blocks are this many sites wide and high: 256 sites bring the noise of a mean down sixteenfold.
pub(super) const BLOCK: usize = 16;
/// Shrunken frames are at most this many cells wide: a fraction of a cell is found to some hundredths, so that
/// on a 50 MP frame a cell of four sites still tells a tenth of a site.
const MAX_CELLS: usize = 2400;
/// Sites looked at together for a clipped one before any is counted.
const CHUNK: usize = 256;

/// One block's mean change between the frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    /// Mean of the lit frame minus the scaled unlit one, DN.
    pub(super) rise: f64,
    /// Standard error of that mean, DN, from the spread inside the block: noise and the light's own
    /// structure, so never too small.
    pub(super) error: f64,
    /// Mean of the room's light as the lit frame should have it, DN above black.
    pub(super) ambient: f64,
    /// Whether the block touches the region of interest.
    pub(super) inside: bool,
}

/// Clipped sites of one frame by colour (R, G, B), inside and outside the region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Clipped {
    pub(super) inside: [Tally; 3],
    pub(super) outside: [Tally; 3],
}

/// Sites of one colour, and how many of them are clipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    pub(super) clipped: u64,
    pub(super) sites: u64,
}

impl Tally {
    /// 0 without sites.
    pub(super) fn share(self) -> f64 {
        self.clipped as f64 / self.sites.max(1) as f64
    }
}

/// A frame shrunk by averaging over square cells, colours together.
#[derive(Clone, Debug)]
pub(super) struct Cells {
    /// Mean DN as read.
    pub(super) means: Image<f32>,
    /// Sites along a cell's edge; even.
    pub(super) size: usize,
}

/// What both frames are, in short. The unlit frame comes first.
pub(super) struct Survey {
    /// All whole blocks, row by row; frames smaller than one block have none.
    pub(super) blocks: Vec<Block>,
    pub(super) clipped: [Clipped; 2],
    pub(super) cells: [Cells; 2],
}

/// Surveys two frames of one size and filter array. `scale` is S_on / S_off, by which the unlit frame's light
/// is multiplied before it is compared; `region` must lie inside the frame.
pub(super) fn survey(off: &Mosaic, on: &Mosaic, scale: f32, region: Region) -> Survey {
    let (width, height) = (off.dn.width(), off.dn.height());
    let size = cell_size(width);
    let frames = [Frame::new(off), Frame::new(on)];
    let bands: Vec<Band> = (0..height.div_ceil(BLOCK))
        .into_par_iter()
        .map(|band| {
            let rows = band * BLOCK..((band + 1) * BLOCK).min(height);
            Band {
                clipped: [0, 1].map(|f| frames[f].clipped(rows.clone(), region)),
                blocks: if rows.len() == BLOCK { blocks(&frames, scale, rows.start, region) } else { vec![] },
                cells: [0, 1].map(|f| frames[f].cells(rows.clone(), size)),
            }
        })
        .collect();
    let mut clipped = [Clipped::default(); 2];
    for (total, frame) in clipped.iter_mut().zip([off, on]) {
        *total = site_counts(frame, region);
    }
    let mut blocks = Vec::with_capacity((width / BLOCK) * (height / BLOCK));
    let mut means = [0, 1].map(|_| Vec::with_capacity((width / size) * (height / size)));
    for band in bands {
        blocks.extend(band.blocks);
        for f in [0, 1] {
            means[f].extend_from_slice(&band.cells[f]);
            let [inside, outside] = band.clipped[f];
            for (tally, count) in clipped[f].inside.iter_mut().zip(inside) {
                tally.clipped += count;
            }
            for (tally, count) in clipped[f].outside.iter_mut().zip(outside) {
                tally.clipped += count;
            }
        }
    }
    let cells = means.map(|means| Cells {
        means: Image::from_pixels(width / size, height / size, means)
            .unwrap_or_else(|| Image::filled(0, 0, 0.0)),
        size,
    });
    Survey { blocks, clipped, cells }
}

/// Share of the blocks for which `holds`; 0 without blocks.
pub(super) fn share<'a>(blocks: impl IntoIterator<Item = &'a Block>, holds: impl Fn(&Block) -> bool) -> f64 {
    let (mut held, mut all) = (0usize, 0usize);
    for block in blocks {
        all += 1;
        held += usize::from(holds(block));
    }
    if all == 0 { 0.0 } else { held as f64 / all as f64 }
}

/// The rise that a hundredth of the blocks reach or pass, DN.
pub(super) fn best_hundredth<'a>(blocks: impl IntoIterator<Item = &'a Block>) -> f64 {
    let mut rises: Vec<f64> = blocks.into_iter().map(|b| b.rise).collect();
    if rises.is_empty() {
        return 0.0;
    }
    let at = (rises.len() - 1) * 99 / 100;
    *rises.select_nth_unstable_by(at, f64::total_cmp).1
}

/// Smallest power of two that brings the frame below the most cells; a band holds whole cells.
fn cell_size(width: usize) -> usize {
    let mut size = 2;
    while size < BLOCK && width / size > MAX_CELLS {
        size *= 2;
    }
    size
}

/// What is found in one row of blocks.
struct Band {
    /// Clipped sites by frame; inside, outside; colour.
    clipped: [[[u64; 3]; 2]; 2],
    blocks: Vec<Block>,
    cells: [Vec<f32>; 2],
}

/// A frame with its levels brought into the form that the loops want.
struct Frame<'a> {
    dn: &'a [u16],
    width: usize,
    colours: [[u8; 2]; 2],
    black: [[f32; 2]; 2],
    /// Lowest clipped value by position; `None` where no value of 16 bits is clipped.
    clips_at: [[Option<u16>; 2]; 2],
}

impl<'a> Frame<'a> {
    fn new(mosaic: &'a Mosaic) -> Self {
        let first = |level: f32| u16::try_from(level.ceil().max(0.0) as u32).ok();
        Self {
            dn: mosaic.dn.pixels(),
            width: mosaic.dn.width(),
            colours: mosaic.cfa.0,
            black: mosaic.levels.black,
            clips_at: mosaic.levels.saturation.map(|row| row.map(first)),
        }
    }

    fn row(&self, y: usize) -> &'a [u16] {
        &self.dn[y * self.width..][..self.width]
    }

    fn clipped(&self, rows: std::ops::Range<usize>, region: Region) -> [[u64; 3]; 2] {
        let mut counts = [[0; 3]; 2];
        for y in rows {
            let (row, clips_at, colours) = (self.row(y), self.clips_at[y & 1], self.colours[y & 1]);
            let Some(lowest) = clips_at.into_iter().flatten().min() else { continue };
            for (i, chunk) in row.chunks(CHUNK).enumerate() {
                if chunk.iter().fold(0, |a, &b| a.max(b)) < lowest {
                    continue;
                }
                for (x, &dn) in (i * CHUNK..).zip(chunk) {
                    if clips_at[x & 1].is_some_and(|limit| dn >= limit) {
                        let outside = usize::from(!holds(region, x, y));
                        let count = &mut counts[outside][usize::from(colours[x & 1])];
                        *count = u64::wrapping_add(*count, 1);
                    }
                }
            }
        }
        counts
    }

    /// Means of the whole cells of a band.
    fn cells(&self, rows: std::ops::Range<usize>, size: usize) -> Vec<f32> {
        match size {
            2 => self.cells_of::<2>(rows),
            4 => self.cells_of::<4>(rows),
            8 => self.cells_of::<8>(rows),
            _ => self.cells_of::<16>(rows),
        }
    }

    fn cells_of<const N: usize>(&self, rows: std::ops::Range<usize>) -> Vec<f32> {
        let across = self.width / N;
        let mut means = Vec::with_capacity(across * (rows.len() / N));
        let mut columns = vec![0u32; across * N];
        for top in rows.clone().step_by(N).filter(|top| top + N <= rows.end) {
            columns.fill(0);
            for y in top..top + N {
                for (sum, &dn) in columns.iter_mut().zip(self.row(y)) {
                    *sum = sum.wrapping_add(u32::from(dn));
                }
            }
            means.extend(columns.as_chunks::<N>().0.iter().map(|cell| {
                cell.iter().fold(0u32, |a, &b| a.wrapping_add(b)) as f32 * (1.0 / (N * N) as f32)
            }));
        }
        means
    }
}

fn holds(region: Region, x: usize, y: usize) -> bool {
    // Wraps to something large left of and above the region.
    x.wrapping_sub(region.x) < region.width && y.wrapping_sub(region.y) < region.height
}

/// How many sites of each colour there are.
fn site_counts(mosaic: &Mosaic, region: Region) -> Clipped {
    let odd_and_even = |from: usize, size: usize| {
        let odd = (from + size) / 2 - from / 2;
        [size - odd, odd]
    };
    let all = [odd_and_even(0, mosaic.dn.width()), odd_and_even(0, mosaic.dn.height())];
    let within = [odd_and_even(region.x, region.width), odd_and_even(region.y, region.height)];
    let mut counts = Clipped::default();
    for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let colour = usize::from(mosaic.cfa.0[row][column]);
        let inside = (within[0][column] * within[1][row]) as u64;
        counts.inside[colour].sites += inside;
        counts.outside[colour].sites += (all[0][column] * all[1][row]) as u64 - inside;
    }
    counts
}

/// The row of blocks that begins at site row `top`.
fn blocks(frames: &[Frame; 2], scale: f32, top: usize, region: Region) -> Vec<Block> {
    let [off, on] = frames;
    let black = off.black.concat().into_iter().map(f64::from).sum::<f64>() / 4.0;
    let touches = |from: usize, start: usize, size: usize| from < start + size && start < from + BLOCK;
    let rows_inside = touches(top, region.y, region.height);
    // What no light at all leaves in the difference, by row parity, repeated over the lanes.
    let dark: [[f32; BLOCK]; 2] =
        [0, 1].map(|row| std::array::from_fn(|i| on.black[row][i & 1] - scale * off.black[row][i & 1]));
    (0..off.width / BLOCK)
        .map(|bx| {
            let x = bx * BLOCK;
            let (mut sum, mut squares, mut ambient) = ([0f32; BLOCK], [0f32; BLOCK], [0f32; BLOCK]);
            for y in top..top + BLOCK {
                let dark = &dark[y & 1];
                let start = y * off.width + x;
                let (Some(unlit), Some(lit)) =
                    (off.dn[start..].first_chunk::<BLOCK>(), on.dn[start..].first_chunk::<BLOCK>())
                else {
                    continue;
                };
                for i in 0..BLOCK {
                    let unlit = f32::from(unlit[i]);
                    let rise = f32::from(lit[i]) - scale * unlit - dark[i];
                    sum[i] += rise;
                    squares[i] += rise * rise;
                    ambient[i] += unlit;
                }
            }
            let total = |lanes: [f32; BLOCK]| lanes.into_iter().map(f64::from).sum::<f64>();
            let n = (BLOCK * BLOCK) as f64;
            let rise = total(sum) / n;
            // Rounding to whole DN alone has a variance of 1/12 a frame.
            let variance = (total(squares) / n - rise * rise).max(1.0 / 6.0);
            Block {
                rise,
                error: (variance / (n - 1.0)).sqrt(),
                ambient: f64::from(scale) * (total(ambient) / n - black),
                inside: rows_inside && touches(x, region.x, region.width),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};

    fn mosaic(width: usize, height: usize, dn: impl FnMut(usize, usize) -> u16) -> Mosaic {
        let levels = Levels {
            black: [[100.0, 102.0], [104.0, 106.0]],
            saturation: [[999.5, 1000.0], [1000.0, 1010.0]],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn: Image::from_fn(width, height, dn), cfa: Cfa::RGGB, levels }
    }

    fn all(mosaic: &Mosaic) -> Region {
        Region { x: 0, y: 0, width: mosaic.dn.width(), height: mosaic.dn.height() }
    }

    #[test]
    fn clipped_sites_are_counted_as_the_mosaic_counts_them() {
        let noisy = mosaic(301, 75, |x, y| 900 + ((x * 7919 + y * 104_729) % 140) as u16);
        let found = survey(&noisy, &noisy, 1.0, all(&noisy));
        assert_eq!(found.clipped[0].inside.map(Tally::share), noisy.clipped_shares());
        let region = Region { x: 33, y: 11, width: 100, height: 41 };
        let split = survey(&noisy, &noisy, 1.0, region).clipped[1];
        for c in 0..3 {
            let whole = found.clipped[1].inside[c];
            assert_eq!(split.inside[c].clipped + split.outside[c].clipped, whole.clipped);
            assert_eq!(split.inside[c].sites + split.outside[c].sites, whole.sites);
        }
        let mut counted = [Tally::default(); 3];
        for (x, y) in (11..52).flat_map(|y| (33..133).map(move |x| (x, y))) {
            let tally = &mut counted[noisy.cfa.colour(x, y)];
            tally.sites += 1;
            tally.clipped += u64::from(noisy.is_clipped(x, y));
        }
        assert_eq!(split.inside, counted);
    }

    #[test]
    fn a_longer_unlit_frame_is_scaled_before_it_is_compared() {
        let black = |x: usize, y: usize| 100 + 2 * (x & 1) as u16 + 4 * (y & 1) as u16;
        let off = mosaic(64, 48, |x, y| black(x, y) + 400);
        let on = mosaic(64, 48, |x, y| black(x, y) + 100 + if x < 32 { 50 } else { 0 });
        let region = Region { x: 40, y: 0, width: 24, height: 20 };
        let found = survey(&off, &on, 0.25, region);
        assert_eq!(found.blocks.len(), 12);
        for (i, block) in found.blocks.iter().enumerate() {
            let rise = if i % 4 < 2 { 50.0 } else { 0.0 };
            assert!((block.rise - rise).abs() < 1e-3 && (block.ambient - 100.0).abs() < 1e-3, "{block:?}");
            assert_eq!(block.inside, i % 4 >= 2 && i / 4 < 2, "block {i}");
        }
    }

    #[test]
    fn cells_are_means_and_large_frames_have_larger_ones() {
        let small = mosaic(37, 35, |x, y| (x + 40 * y) as u16);
        let cells = &survey(&small, &small, 1.0, all(&small)).cells[0];
        assert_eq!((cells.size, cells.means.width(), cells.means.height()), (2, 18, 17));
        assert_eq!(*cells.means.at(3, 16), 6.5 + 40.0 * 32.5);
        let wide = mosaic(9000, 10, |x, _| (x / 4) as u16);
        let cells = &survey(&wide, &wide, 1.0, all(&wide)).cells[1];
        assert_eq!((cells.size, cells.means.width(), cells.means.height()), (4, 2250, 2));
        assert_eq!(*cells.means.at(1777, 1), 1777.0);
    }
}
