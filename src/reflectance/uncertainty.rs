//! How far the texture may be off, from the views' disagreement.
//!
//! Errors that matter hang together: a pulse, a pose, a demosaiced edge, a bounce that was simulated too weak move a
//! whole patch of one view. Noise per texel says nothing of them. So every view is asked for its own mean residual over
//! patches of about 4x4 pixels, and the spread of these means *between views* gives the error of their weighted mean:
//! the cluster-robust variance of weighted least squares with views as clusters (Liang and Zeger, "Longitudinal data
//! analysis using generalized linear models", 1986),
//!
//! ```text
//! r_v = sum over the patch of w A e / sum of w A^2,   I_v = sum over the patch of w A^2,
//! var = n / (n - 1) * sum over v of I_v^2 r_v^2 / (sum of I_v)^2,   n = (sum of I_v)^2 / sum of I_v^2
//! ```
//!
//! Few views make a poor estimate of their own spread: it is pooled over neighbouring cells, and shrunk towards the
//! variance that the weights promise (1 / sum of I_v) times the ratio of the two over the whole object, which counts
//! as [`PRIOR_FREEDOM`] views more. To it come the energies' errors; what all views share (the calibration's scale) is
//! added by the caller.

use super::joint::{PRIOR, Photo, State, Weights};
use super::project::Projection;
use crate::progress::{Cancelled, Progress};
use crate::raster::blur::gaussian;
use crate::raster::{Image, Rgb};

/// Texels along each side of a cell.
pub(super) const CELL: usize = 4;

/// Gaussian with the spread of a 4x4 box, and the area in pixels that it averages over (4 pi sigma^2).
const PATCH_SIGMA: f32 = 1.155;
const PATCH_AREA: f32 = 16.8;

/// Weight of the model's own promise against the views' spread, in views.
const PRIOR_FREEDOM: f32 = 3.0;

/// A view counts in a cell when it alone would tell the patch's reflectance to this standard deviation.
const COUNTS: f32 = 0.2;

/// What is known of one cell of texels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    /// Standard deviation of the reflectance over a patch of 4x4 pixels.
    pub(super) sd: [f32; 3],
    /// Root mean square of the views' mean residuals, of 1.
    pub(super) residual: f32,
    /// Views that see it.
    pub(super) views: u16,
}

/// Sums over views.
#[derive(Clone, Default)]
struct Sums {
    info: [f32; 3],
    info2: [f32; 3],
    spread: [f32; 3],
    residual: f32,
    energy: [f32; 3],
    views: u16,
}

/// One view's share of one cell.
#[derive(Clone, Copy, Default)]
struct Share {
    residual: [f32; 3],
    info: [f32; 3],
    samples: f32,
}

/// Cells of a texture of `size` x `size`, row-major; those that no view sees have 0 views.
pub(super) fn cells(
    state: &State,
    weights: &[Weights],
    texels: &[[f32; 3]],
    size: usize,
    progress: &Progress,
) -> Result<Image<Cell>, Cancelled> {
    let side = size.div_ceil(CELL);
    let mut sums = vec![Sums::default(); side * side];
    let mut shares = vec![Share::default(); side * side];
    state.each_view(
        |v, photo| {
            progress.check()?;
            Ok(residuals(state, v, photo, &weights[v], texels))
        },
        |v, (residual, info)| {
            shares.fill(Share::default());
            let view = &state.photos[v].projection;
            gather(view, &residual, &info, size, &mut shares);
            let energy = (state.gains[v].deviation / state.gains[v].value) as f32;
            for (sum, share) in sums.iter_mut().zip(&shares).filter(|(_, s)| s.samples > 0.0) {
                fold(sum, share, energy);
            }
        },
    )?;
    Ok(finish(&sums, texels, size))
}

/// A view's mean residual (of reflectance) over the patch round every pixel, and the information in the patch.
fn residuals(state: &State, v: usize, photo: &Photo, weights: &Weights, texels: &[[f32; 3]]) -> (Rgb, Rgb) {
    let view = &photo.projection;
    let g = state.gains[v].value as f32;
    let (predicted, white) = (view.predict(texels, true, state.blur), view.white(state.blur));
    let mut both = Image::filled(view.window.width, view.window.height, [0.0f32; 6]);
    for (i, (site, w)) in view.sites.pixels().iter().zip(&weights.sites).enumerate() {
        let c = usize::from(site.colour);
        let a = g * white.pixels()[i][c];
        let e = site.known - g * predicted.pixels()[i][c];
        let out = &mut both.pixels_mut()[i];
        if *w > 0.0 {
            (out[c], out[3 + c]) = (w * a * e, w * a * a);
        }
    }
    let both = gaussian(&both, PATCH_SIGMA);
    let residual = both.map(|b| std::array::from_fn(|c| if b[3 + c] > 0.0 { b[c] / b[3 + c] } else { 0.0 }));
    let info = both.map(|b| std::array::from_fn(|c| b[3 + c] * PATCH_AREA));
    (residual, info)
}

/// Averages a view's patches over each cell that its rays meet.
fn gather(view: &Projection, residual: &Rgb, info: &Rgb, size: usize, shares: &mut [Share]) {
    let side = size.div_ceil(CELL);
    for s in &view.samples {
        let (x, y) = (s.texel as usize % size, s.texel as usize / size);
        let (r, i) = (&residual.pixels()[s.pixel as usize], &info.pixels()[s.pixel as usize]);
        let share = &mut shares[(y / CELL) * side + x / CELL];
        share.samples += 1.0;
        for c in 0..3 {
            share.residual[c] += i[c] * r[c];
            share.info[c] += i[c];
        }
    }
}

fn fold(sum: &mut Sums, share: &Share, energy: f32) {
    let mut own = 0.0;
    for c in 0..3 {
        if share.info[c] <= 0.0 {
            continue;
        }
        let (r, info) = (share.residual[c] / share.info[c], share.info[c] / share.samples);
        sum.info[c] += info;
        sum.info2[c] += info * info;
        sum.spread[c] += (info * r).powi(2);
        own += info;
        sum.residual += info * r * r;
        sum.energy[c] += (info * energy).powi(2);
    }
    sum.views += u16::from(own / 3.0 > COUNTS.powi(-2));
}

fn finish(sums: &[Sums], texels: &[[f32; 3]], size: usize) -> Image<Cell> {
    let side = size.div_ceil(CELL);
    // Variance by spread and degrees of freedom, pooled over the cells round each.
    let own = |s: &Sums, c: usize| {
        let n = if s.info2[c] > 0.0 { s.info[c] * s.info[c] / s.info2[c] } else { 0.0 };
        let freedom = (n - 1.0).max(0.0);
        let variance = if freedom > 0.2 { s.spread[c] / (s.info[c] * s.info[c]) * n / freedom } else { 0.0 };
        let promised = 1.0 / (s.info[c] + PRIOR.powi(-2));
        (variance, promised, if freedom > 0.2 { freedom } else { 0.0 })
    };
    let mut ratios: Vec<f32> = vec![];
    for s in sums.iter().filter(|s| s.views > 3) {
        ratios.extend((0..3).map(|c| own(s, c)).filter(|o| o.2 > 1.0).map(|(v, p, _)| v / p));
    }
    // The mean, not the median: squared spreads of few views are skewed.
    let typical = if ratios.is_empty() { 1.0 } else { ratios.iter().sum::<f32>() / ratios.len() as f32 };
    Image::from_fn(side, side, |x, y| {
        let s = &sums[y * side + x];
        if s.views == 0 {
            return Cell::default();
        }
        let rho = mean(texels, size, x, y);
        let sd = std::array::from_fn(|c| {
            let (mut above, mut below) = (0.0, 0.0);
            for v in y.saturating_sub(1)..(y + 2).min(side) {
                for u in x.saturating_sub(1)..(x + 2).min(side) {
                    let (variance, promised, freedom) = own(&sums[v * side + u], c);
                    if freedom > 0.0 {
                        above += freedom * variance / promised;
                        below += freedom;
                    }
                }
            }
            let (_, promised, _) = own(s, c);
            // The nine cells' residuals hang together: they count as the middle one's views.
            let cells = 9.0f32;
            let ratio = (above / cells + PRIOR_FREEDOM * typical) / (below / cells + PRIOR_FREEDOM);
            // Views that agree better than noise and model error let them agree by chance.
            let ratio = ratio.max(1.0);
            let energy = if s.info[c] > 0.0 { s.energy[c] / (s.info[c] * s.info[c]) } else { 0.0 };
            (promised * ratio + energy * rho[c] * rho[c]).sqrt()
        });
        let all: f32 = s.info.iter().sum();
        Cell { sd, residual: (s.residual / all.max(f32::MIN_POSITIVE)).sqrt(), views: s.views }
    })
}

/// Mean reflectance of a cell.
fn mean(texels: &[[f32; 3]], size: usize, x: usize, y: usize) -> [f32; 3] {
    let (mut sum, mut count) = ([0.0f32; 3], 0.0);
    for v in y * CELL..((y + 1) * CELL).min(size) {
        for t in &texels[v * size + x * CELL..v * size + ((x + 1) * CELL).min(size)] {
            count += 1.0;
            (0..3).for_each(|c| sum[c] += t[c]);
        }
    }
    sum.map(|s| s / f32::max(count, 1.0))
}
