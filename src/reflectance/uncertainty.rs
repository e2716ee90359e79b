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
//! as [`PRIOR_FREEDOM`] views more. Views that agree do not vouch for what the model itself does to each of them: its
//! relative error, its error in the light of other surfaces and a misplaced picture hang together over a patch, so they
//! are carried through the patch's mean with their signs and count view by view. To it come the energies' errors; what
//! all views share (the calibration's scale) is added by the caller.

use super::joint::{MISPLACED, MODEL_ERROR, OTHER_ERROR, PRIOR, Photo, State, Weights};
use super::projection::{Ground, Projection};
use crate::progress::{Cancelled, Progress};
use crate::raster::Image;
use crate::raster::blur::gaussian;

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
    model: [f32; 3],
    residual: f32,
    energy: [f32; 3],
    views: u16,
}

/// One view's share of one cell.
#[derive(Clone, Copy, Default)]
struct Share {
    residual: [f32; 3],
    model: [f32; 3],
    info: [f32; 3],
    rays: f32,
}

/// The patch round a pixel as one view tells it, by channel.
#[derive(Clone, Copy, Default)]
struct Patch {
    /// Mean residual, of reflectance.
    residual: [f32; 3],
    /// Variance of that by errors of the model that hang together.
    model: [f32; 3],
    /// Information on the patch's reflectance.
    info: [f32; 3],
}

/// The cells that the texels lie in.
struct Cells {
    /// Their places in the texture, ascending.
    places: Vec<u32>,
    /// Of each texel, the number of its cell.
    of: Vec<u32>,
    /// Cells along the texture's side.
    side: usize,
}

impl Cells {
    fn of(ground: &Ground) -> Self {
        let side = ground.size.div_ceil(CELL);
        let place = |i: usize| {
            let (x, y) = ground.place(i);
            ((y / CELL) * side + x / CELL) as u32
        };
        let mut places: Vec<u32> = (0..ground.len()).map(place).collect();
        let by_texel = places.clone();
        places.sort_unstable();
        places.dedup();
        let of = by_texel.iter().map(|p| places.partition_point(|q| q < p) as u32).collect();
        Self { places, of, side }
    }

    /// Numbers of the cells round one, itself among them.
    fn round(&self, number: usize) -> impl Iterator<Item = usize> {
        let place = self.places[number] as usize;
        let (x, y) = ((place % self.side) as isize, (place / self.side) as isize);
        (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| (x + dx, y + dy))).filter_map(|(x, y)| {
            let inside = x >= 0 && y >= 0 && x < self.side as isize;
            let place = (y * self.side as isize + x) as u32;
            if inside { self.places.binary_search(&place).ok() } else { None }
        })
    }
}

/// Cells with any texel of the ground, by their places in the texture; those that no view sees have 0 views.
pub(super) fn cells(
    state: &State,
    weights: &[Weights],
    texels: &[[f32; 3]],
    progress: &Progress,
) -> Result<Vec<(u32, Cell)>, Cancelled> {
    let cells = Cells::of(state.ground);
    let mut sums = vec![Sums::default(); cells.places.len()];
    let mut shares = vec![Share::default(); cells.places.len()];
    state.each_view(
        |v, photo| {
            progress.check()?;
            Ok(patches(state, v, photo, &weights[v], texels))
        },
        |v, patches| {
            shares.fill(Share::default());
            gather(&state.photos[v].projection, &patches, &cells, &mut shares);
            let energy = (state.gains[v].deviation / state.gains[v].value) as f32;
            for (sum, share) in sums.iter_mut().zip(&shares).filter(|(_, s)| s.rays > 0.0) {
                fold(sum, share, energy);
            }
        },
    )?;
    Ok(finish(&sums, texels, &cells))
}

/// What a view tells of the patch round every pixel.
fn patches(state: &State, v: usize, photo: &Photo, weights: &Weights, texels: &[[f32; 3]]) -> Image<Patch> {
    let view = &photo.projection;
    let g = state.gains[v].value as f32;
    let (width, height) = (view.window.width, view.window.height);
    // By channel: weighted residual and information; and of the model's errors the relative one and both slopes.
    let mut told = Image::filled(width, height, [0.0f32; 6]);
    let (mut relative, mut slopes) = (Image::filled(width, height, [0.0f32; 3]), told.clone());
    {
        let (predicted, white) = (view.predict(texels, true, state.blur), view.white(state.blur));
        let others = view.others(state.blur);
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let (site, w) = (&view.sites.pixels()[i], weights.sites[i]);
                if w <= 0.0 {
                    continue;
                }
                let c = usize::from(site.colour);
                let a = g * white.pixels()[i][c];
                let expected = g * predicted.pixels()[i][c];
                let told = &mut told.pixels_mut()[i];
                (told[c], told[3 + c]) = (w * a * (site.known - expected), w * a * a);
                let near = |dx: isize, dy: isize| {
                    predicted.get(x as isize + dx, y as isize + dy).map_or(expected, |p| g * p[c])
                };
                relative.pixels_mut()[i][c] =
                    w * a * (MODEL_ERROR * expected).hypot(OTHER_ERROR * g * others.pixels()[i][c]);
                let slopes = &mut slopes.pixels_mut()[i];
                slopes[c] = w * a * (near(1, 0) - near(-1, 0)) / 2.0;
                slopes[3 + c] = w * a * (near(0, 1) - near(0, -1)) / 2.0;
            }
        }
    }
    told = gaussian(&told, PATCH_SIGMA);
    relative = gaussian(&relative, PATCH_SIGMA);
    slopes = gaussian(&slopes, PATCH_SIGMA);
    Image::from_fn(width, height, |x, y| {
        let (told, relative, slopes) = (told.at(x, y), relative.at(x, y), slopes.at(x, y));
        let mut patch = Patch::default();
        for c in (0..3).filter(|c| told[3 + c] > 0.0) {
            let info = told[3 + c];
            patch.residual[c] = told[c] / info;
            let misplaced = MISPLACED * (slopes[c] / info).hypot(slopes[3 + c] / info);
            patch.model[c] = (relative[c] / info).powi(2) + misplaced.powi(2);
            patch.info[c] = info * PATCH_AREA;
        }
        patch
    })
}

/// Averages a view's patches over each cell that its rays meet.
fn gather(view: &Projection, patches: &Image<Patch>, cells: &Cells, shares: &mut [Share]) {
    for ray in &view.rays {
        let patch = &patches.pixels()[ray.pixel as usize];
        let share = &mut shares[cells.of[ray.top as usize] as usize];
        share.rays += 1.0;
        for c in 0..3 {
            share.residual[c] += patch.info[c] * patch.residual[c];
            share.model[c] += patch.info[c] * patch.model[c];
            share.info[c] += patch.info[c];
        }
    }
}

fn fold(sum: &mut Sums, share: &Share, energy: f32) {
    let mut own = 0.0;
    for c in 0..3 {
        if share.info[c] <= 0.0 {
            continue;
        }
        let (r, info) = (share.residual[c] / share.info[c], share.info[c] / share.rays);
        sum.info[c] += info;
        sum.info2[c] += info * info;
        sum.spread[c] += (info * r).powi(2);
        sum.model[c] += info * info * share.model[c] / share.info[c];
        own += info;
        sum.residual += info * r * r;
        sum.energy[c] += (info * energy).powi(2);
    }
    sum.views += u16::from(own / 3.0 > COUNTS.powi(-2));
}

fn finish(sums: &[Sums], texels: &[[f32; 3]], cells: &Cells) -> Vec<(u32, Cell)> {
    let rho = means(texels, cells);
    // Variance by spread and degrees of freedom, pooled over the cells round each.
    let own = |s: &Sums, c: usize| {
        let n = if s.info2[c] > 0.0 { s.info[c] * s.info[c] / s.info2[c] } else { 0.0 };
        let freedom = (n - 1.0).max(0.0);
        let variance = if freedom > 0.2 { s.spread[c] / (s.info[c] * s.info[c]) * n / freedom } else { 0.0 };
        let model = if s.info[c] > 0.0 { s.model[c] / (s.info[c] * s.info[c]) } else { 0.0 };
        let promised = 1.0 / (s.info[c] + PRIOR.powi(-2)) + model;
        (variance, promised, if freedom > 0.2 { freedom } else { 0.0 })
    };
    let mut ratios: Vec<f32> = vec![];
    for s in sums.iter().filter(|s| s.views > 3) {
        ratios.extend((0..3).map(|c| own(s, c)).filter(|o| o.2 > 1.0).map(|(v, p, _)| v / p));
    }
    // The mean, not the median: squared spreads of few views are skewed.
    let typical = if ratios.is_empty() { 1.0 } else { ratios.iter().sum::<f32>() / ratios.len() as f32 };
    let cell = |(number, s): (usize, &Sums)| {
        if s.views == 0 {
            return Cell::default();
        }
        let sd = std::array::from_fn(|c| {
            let (mut above, mut below) = (0.0, 0.0);
            for near in cells.round(number) {
                let (variance, promised, freedom) = own(&sums[near], c);
                if freedom > 0.0 {
                    above += freedom * variance / promised;
                    below += freedom;
                }
            }
            let (_, promised, _) = own(s, c);
            // The nine cells' residuals hang together: they count as the middle one's views.
            let cells = 9.0f32;
            let ratio = (above / cells + PRIOR_FREEDOM * typical) / (below / cells + PRIOR_FREEDOM);
            // Views that agree better than noise and model error let them agree by chance.
            let ratio = ratio.max(1.0);
            let energy = if s.info[c] > 0.0 { s.energy[c] / (s.info[c] * s.info[c]) } else { 0.0 };
            (promised * ratio + energy * rho[number][c] * rho[number][c]).sqrt()
        });
        let all: f32 = s.info.iter().sum();
        Cell { sd, residual: (s.residual / all.max(f32::MIN_POSITIVE)).sqrt(), views: s.views }
    };
    cells.places.iter().copied().zip(sums.iter().enumerate().map(cell)).collect()
}

/// Mean reflectance of each cell.
fn means(texels: &[[f32; 3]], cells: &Cells) -> Vec<[f32; 3]> {
    let mut sums = vec![([0.0f32; 3], 0.0f32); cells.places.len()];
    for (rho, &cell) in texels.iter().zip(&cells.of) {
        let (sum, count) = &mut sums[cell as usize];
        (0..3).for_each(|c| sum[c] += rho[c]);
        *count += 1.0;
    }
    sums.into_iter().map(|(sum, count)| sum.map(|s| s / count.max(1.0))).collect()
}
