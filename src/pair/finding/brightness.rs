//! How bright one test shot is where the object is: quantiles, clipping and noise by filter position.

use crate::photometry::Mosaic;
use crate::photometry::inspect::Region;

/// Quantiles taken, ascending, and how far above each the last one lies on ordinary objects: by that much a
/// shot comes down whose brighter sites are clipped.
const QUANTILES: [(f64, f64); 7] =
    [(0.1, 8.0), (0.25, 6.0), (0.5, 4.0), (0.75, 3.0), (0.9, 2.2), (0.97, 1.6), (0.999, 1.0)];
/// What a channel is taken for of which not even the darkest tenth is unclipped, as a multiple of saturation.
pub(super) const ALL_CLIPPED: f64 = 48.0;
/// Share of the range from which on a quantile counts as clipped.
const CLIPS: f64 = 0.98;
/// Standard deviations that noise adds to the brightest thousandth: 3.1 on an even surface, none on a glossy one.
const NOISE_IN_TOP: f64 = 1.5;
/// Standard deviations that a signal must have to be known to some percent.
const KNOWN: f64 = 20.0;
/// Share of the range from which on a signal is known in any case: at high ISO it is no less noisy anywhere.
const BRIGHT: f64 = 0.2;

/// Brightness of one filter position, as shares of the range from black to saturation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Brightness {
    /// The brightest thousandth (99.9 % quantile); where it is clipped, an estimate above 1.
    pub(super) top: f64,
    /// Standard deviation of one site's noise at the top.
    pub(super) noise: f64,
    /// Share of sites that are clipped.
    pub(super) clipped: f64,
    /// Whether `top` was measured rather than estimated, and stands out of the noise.
    pub(super) known: bool,
}

impl Brightness {
    /// The light behind `top`: noise taken off, 0 at least.
    pub(super) fn signal(&self) -> f64 {
        if self.top > CLIPS { self.top } else { (self.top - NOISE_IN_TOP * self.noise).max(0.0) }
    }

    /// The most that the light may be.
    pub(super) fn at_most(&self) -> f64 {
        self.signal().max(2.0 * self.noise)
    }

    /// Whether `top` lies at saturation.
    pub(super) fn is_clipped(&self) -> bool {
        self.top > CLIPS
    }
}

/// Measures the four filter positions inside `region`, which must lie in the frame.
pub(super) fn brightness(mosaic: &Mosaic, region: Region) -> [Brightness; 4] {
    [(0, 0), (0, 1), (1, 0), (1, 1)].map(|position| of_position(mosaic, region, position))
}

fn of_position(mosaic: &Mosaic, region: Region, (row, column): (usize, usize)) -> Brightness {
    let (black, saturation) = (mosaic.levels.black[row][column], mosaic.levels.saturation[row][column]);
    let range = f64::from(saturation - black).max(1.0);
    let mut counts = vec![0u32; 1 << 16];
    let (mut sites, mut clipped) = (0u64, 0u64);
    let mut bends: Vec<i32> = vec![];
    for y in (region.y..region.y + region.height).filter(|y| y & 1 == row) {
        let line = &mosaic.dn.pixels()[y * mosaic.dn.width() + region.x..][..region.width];
        let own = &line[(column + region.x) & 1..];
        for &dn in own.iter().step_by(2) {
            counts[usize::from(dn)] += 1;
            sites += 1;
            clipped += u64::from(f32::from(dn) >= saturation);
        }
        // x0 - 2 x1 + x2 has six times the variance of one site, and no gradient; some thousand are plenty.
        let bend = |w: &[u16]| i32::from(w[0]) - 2 * i32::from(w[2]) + i32::from(w[4]);
        bends.extend(own.windows(5).step_by(16).map(|w| bend(w).abs()));
    }
    let quantile = |share: f64| {
        let wanted = ((sites.saturating_sub(1)) as f64 * share).ceil() as u64;
        let mut below = 0u64;
        let dn = counts.iter().position(|&n| {
            below += u64::from(n);
            below > wanted
        });
        (dn.unwrap_or(0) as f64 - f64::from(black)) / range
    };
    let values = QUANTILES.map(|(share, _)| quantile(share));
    let [_, _, median, .., measured] = values;
    let middle = bends.len() / 2;
    let bend = if bends.is_empty() { 0 } else { *bends.select_nth_unstable(middle).1 };
    let floor = (f64::from(bend) / 0.6745 / 6f64.sqrt()).max(0.5) / range;
    // Shot noise grows with the root of the signal.
    let noise = floor * (measured / median.max(10.0 * floor)).clamp(1.0, 100.0).sqrt();
    let unclipped = values.iter().zip(QUANTILES).rev().find(|(value, _)| **value <= CLIPS);
    let top = match unclipped {
        _ if measured <= CLIPS => measured,
        Some((value, (_, above))) => (value * above).max(1.0),
        None => ALL_CLIPPED,
    };
    let known = measured <= CLIPS && measured > (KNOWN * noise).min(BRIGHT);
    Brightness { top, noise, clipped: clipped as f64 / sites.max(1) as f64, known }
}
