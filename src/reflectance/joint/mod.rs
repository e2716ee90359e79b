//! The texture that explains all photographs at once.
//!
//! Minimises, over the texels' reflectance rho and the pulses' energies g,
//!
//! ```text
//! sum over views v and sites s of  w_s (P_s - g_v (A_v rho)_s)^2  +  sum over texels of (rho - rho_0)^2 / prior^2
//!                                                          +  sum over views of (g_v - m_v)^2 / sigma_v^2
//! ```
//!
//! with A the linear view of [`super::project`], m and sigma the energies as measured (or 1 and a strobe's own
//! spread), and rho_0 the patches' robust estimate. w = trust / variance; the variance is the sensor's at the light
//! *expected* (weights that follow the noise of what was read would pull the result down) and the model's own error:
//! a share of the reading, what a small misplacement of the picture changes, and what other surfaces add through the
//! lens's blur. Trust is Tukey's biweight of the residual, taken anew every round.
//!
//! rho by preconditioned conjugate gradients on the normal equations (Hestenes and Stiefel 1952), the preconditioner
//! being the row sums of A'WA, which bound its eigenvalues because A has no negative entry; g and the trusts between
//! the runs. The prior's precision also keeps texels that hardly any site speaks of near the patches' estimate.

mod conjugate;
mod state;
#[cfg(test)]
mod tests;

pub(super) use state::{MISPLACED, MODEL_ERROR, OTHER_ERROR, State, Weights};

use super::projection::{Ground, Projection, WIDEST_BLUR};
use super::uncertainty::{self, Cell};
use crate::photometry::FlashGain;
use crate::progress::{Cancelled, Progress};
use conjugate::System;

/// Standard deviation of a texel about the patches' estimate, of 1: weak, for it pulls detail down (0.2 took a
/// third of what the photographs tell; from 0.6 on nothing changes).
pub(super) const PRIOR: f32 = 1.0;

/// Runs of conjugate gradients: steps in each, and whether the lens's blur is found along.
const RUNS: [(usize, bool); 5] = [(6, false), (5, false), (7, true), (5, true), (5, true)];

/// Standard deviation of the lens's blur before anything is known, pixels, and its bounds.
const FIRST_BLUR: f32 = 0.8;
const BLUR_BOUNDS: (f32, f32) = (0.3, WIDEST_BLUR);

/// Reflectance by texel, as a [`Ground`] numbers them.
pub(super) type Texels = Vec<[f32; 3]>;

/// What the joint solve found.
pub struct Joint {
    /// Reflectance by texel.
    pub texels: Texels,
    /// Energy of each view's pulse.
    pub gains: Vec<FlashGain>,
    /// Standard deviation of the lens's blur by channel, pixels.
    pub blur: [f32; 3],
    /// What each run did.
    pub runs: Vec<Run>,
    /// What is known of each cell of texels, by the cell's place in the texture.
    pub(super) cells: Vec<(u32, Cell)>,
    /// Texels that any site speaks of.
    pub(super) spoken: Vec<bool>,
    /// Relative standard deviation of all reflectance together, by the pulses' energies.
    pub scale_error: f32,
}

/// One run of the solve.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Run {
    /// Weighted sum of squared residuals over the number of sites, before it.
    pub misfit: f64,
    /// Root mean square change of the texels' reflectance by it.
    pub change: f64,
    /// Standard deviation of the lens's blur after it, by channel, pixels.
    pub blur: [f32; 3],
}

/// What is needed of every view beside the projection.
pub struct Photo {
    /// The view.
    pub projection: Projection,
    /// Its pulse's energy as measured, or a strobe's own spread.
    pub gain: FlashGain,
    /// The energy as another part of the texture told it already: it stays so.
    pub found: Option<FlashGain>,
}

/// Solves; `start` is the patches' estimate at every texel of `ground`, which numbers the photos' texels, `blur` what
/// another part of the texture told of the lens already, `shot_noise` the sensor's variance by DN of light.
pub(super) fn solve_jointly(
    photos: &[Photo],
    ground: &Ground,
    start: Texels,
    known_blur: Option<[f32; 3]>,
    shot_noise: f32,
    progress: &Progress,
) -> Result<Joint, Cancelled> {
    let mut gains: Vec<FlashGain> = photos.iter().map(|p| p.found.unwrap_or(p.gain)).collect();
    let mut texels = start.clone();
    let mut blur = known_blur.unwrap_or([FIRST_BLUR; 3]);
    let (mut runs, mut done) = (vec![], 0);
    for (steps, lens) in RUNS {
        let lens = lens && known_blur.is_none();
        let state = State { photos, ground, gains: &gains, blur, shot_noise };
        let weights = state.weights(&texels, progress)?;
        let before = texels.clone();
        let mut system = System::new(&state, &weights, &start, &texels, lens, progress)?;
        let misfit = system.misfit;
        for step in 0..steps {
            progress.report("solving texels", done + step, RUNS.iter().map(|r| r.0).sum());
            system.step(&mut texels, progress)?;
        }
        done += steps;
        let wider = system.blur;
        gains = state.energies(&weights, &mut texels);
        let (least, most) = BLUR_BOUNDS;
        for (b, wider) in blur.iter_mut().zip(wider).filter(|_| lens) {
            *b = (*b * *b + wider as f32).max(least * least).sqrt().min(most);
        }
        let n = texels.len().max(1) as f64;
        let moved: f64 = texels
            .iter()
            .zip(&before)
            .map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>() / 3.0)
            .sum();
        runs.push(Run { misfit, change: (moved / n).sqrt(), blur });
    }
    progress.report("telling the error", 0, 1);
    let state = State { photos, ground, gains: &gains, blur, shot_noise };
    let weights = state.weights(&texels, progress)?;
    let cells = uncertainty::cells(&state, &weights, &texels, progress)?;
    let sums = state.sums(&weights, progress)?;
    let spoken = sums.iter().map(|s| s.iter().all(|s| *s > 0.0)).collect();
    let told: f64 = photos.iter().zip(&gains).map(|(p, g)| precision(p) * g.value * g.value).sum();
    let scale_error = if told > 0.0 { told.sqrt().recip() as f32 } else { 0.0 };
    Ok(Joint { texels, gains, blur, runs, cells, spoken, scale_error })
}

/// Precision of a pulse's measured energy.
pub(super) fn precision(photo: &Photo) -> f64 {
    photo.gain.deviation.max(1e-5).powi(-2)
}
