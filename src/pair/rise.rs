//! How much light came in from the unlit to the lit frame, block by block, against its own noise.

use crate::photometry::Mosaic;
use rayon::prelude::*;

/// Blocks are this many sites wide and high: 256 sites bring the noise of a mean down sixteenfold.
const BLOCK: usize = 16;

/// One block's mean change between the frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    /// Mean of lit minus unlit, DN.
    pub(super) rise: f64,
    /// Standard error of that mean, DN, from the spread inside the block: noise and the light's own
    /// structure, so never too small.
    pub(super) error: f64,
    /// Mean of the unlit frame above black, DN.
    pub(super) ambient: f64,
}

/// Rises of all whole blocks, row by row; frames smaller than one block give none.
pub(super) fn blocks(off: &Mosaic, on: &Mosaic) -> Vec<Block> {
    let (width, height) = (off.dn.width(), off.dn.height());
    let black = off.levels.black.concat().into_iter().map(f64::from).sum::<f64>() / 4.0;
    let row_of_blocks = |by: usize| {
        (0..width / BLOCK).map(move |bx| {
            let (mut sum, mut squares, mut ambient) = (0i64, 0i64, 0i64);
            for y in by * BLOCK..(by + 1) * BLOCK {
                let row = y * width + bx * BLOCK;
                let pairs = off.dn.pixels()[row..][..BLOCK].iter().zip(&on.dn.pixels()[row..][..BLOCK]);
                for (&off, &on) in pairs {
                    let rise = i64::from(on) - i64::from(off);
                    sum += rise;
                    squares += rise * rise;
                    ambient += i64::from(off);
                }
            }
            let n = (BLOCK * BLOCK) as f64;
            let rise = sum as f64 / n;
            // Rounding to whole DN alone has a variance of 1/12 a frame.
            let variance = (squares as f64 / n - rise * rise).max(1.0 / 6.0);
            Block { rise, error: (variance / (n - 1.0)).sqrt(), ambient: ambient as f64 / n - black }
        })
    };
    (0..height / BLOCK).into_par_iter().flat_map_iter(row_of_blocks).collect()
}

/// Share of the blocks for which `holds`; 0 without blocks.
pub(super) fn share(blocks: &[Block], holds: impl Fn(&Block) -> bool) -> f64 {
    if blocks.is_empty() {
        return 0.0;
    }
    blocks.iter().filter(|b| holds(b)).count() as f64 / blocks.len() as f64
}

/// The rise that a hundredth of the blocks reach or pass, DN.
pub(super) fn best_hundredth(blocks: &[Block]) -> f64 {
    let mut rises: Vec<f64> = blocks.iter().map(|b| b.rise).collect();
    if rises.is_empty() {
        return 0.0;
    }
    let at = (rises.len() - 1) * 99 / 100;
    *rises.select_nth_unstable_by(at, f64::total_cmp).1
}
