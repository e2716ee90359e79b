//! The jitter's variance by restricted maximum likelihood.
//!
//! With `damp = 1 / (phi + v W)`, `N` the marginal normal matrix and
//! `P_ij = delta_ij W_i damp_i - damp_i damp_j c_i' N^-1 c_j`, twice the score of the variance v is
//! `S = sum (H damp)^2 - sum P_ii` and twice its expected information `I = sum P_ij^2`. Fisher's scoring `v += S / I` is
//! done in the logarithm of v, where it can neither leave the positive numbers nor creep, between bounds that every score
//! narrows; it begins at the variance of the round before, so that two or three scores a round are enough.

use super::mixed::ShotSums;
use crate::calibration::linear::inverse;
use nalgebra::DMatrix;

/// Degrees of freedom that the shots must leave for the jitter to be found from them.
const LEAST_FREEDOM: f64 = 1.5;

/// Logarithms of the least and the largest variance that is looked for.
const BOUNDS: (f64, f64) = (-32.0, 0.0);

/// Error of the variance's logarithm that ends the search.
const CLOSE: f64 = 1e-4;

/// Longest step of the logarithm.
const STRIDE: f64 = 5.0;

/// Most scores of a search.
const MOST_STEPS: usize = 60;

/// Scores at any variance, from sums at one place.
struct Restricted<'a> {
    sums: &'a [ShotSums],
    /// The normal matrix without jitter.
    plain: DMatrix<f64>,
    phi: f64,
}

impl<'a> Restricted<'a> {
    fn new(sums: &'a [ShotSums], prior: &DMatrix<f64>, phi: f64) -> Self {
        let mut plain = prior.clone();
        sums.iter().for_each(|s| plain += &s.cells.matrix / phi);
        Self { sums, plain, phi }
    }

    /// S and I.
    fn at(&self, variance: f64) -> Option<(f64, f64)> {
        let damps: Vec<f64> = self.sums.iter().map(|s| 1.0 / (self.phi + variance * s.w)).collect();
        let mut normal = self.plain.clone();
        for (s, damp) in self.sums.iter().zip(&damps) {
            normal.ger(-variance * damp / self.phi, &s.c, &s.c, 1.0);
        }
        let inverse = inverse(&normal)?;
        let (mut score, mut information) = (0.0, 0.0);
        for (i, (s, damp)) in self.sums.iter().zip(&damps).enumerate() {
            let spread = &inverse * &s.c;
            let between = |j: usize| damp * damps[j] * spread.dot(&self.sums[j].c);
            let own = s.w * damp - between(i);
            score += (s.h * damp).powi(2) - own;
            information += own * own + 2.0 * (0..i).map(|j| between(j).powi(2)).sum::<f64>();
        }
        Some((score, information))
    }
}

/// The jitter's variance and the degrees of freedom by which it is known; `usual` squared and none where the shots leave
/// too few. `before`: the variance of an earlier round.
pub(super) fn jitter(
    sums: &[ShotSums],
    prior: &DMatrix<f64>,
    usual: f64,
    phi: f64,
    before: Option<f64>,
) -> Option<(f64, Option<f64>)> {
    let restricted = Restricted::new(sums, prior, phi);
    let otherwise = usual * usual;
    let (_, information) = restricted.at(otherwise)?;
    let usual_freedom = otherwise * otherwise * information;
    if usual_freedom < LEAST_FREEDOM {
        return Some((otherwise, None));
    }
    let (mut low, mut high) = BOUNDS;
    let mut low_seen = false;
    let mut at = before.unwrap_or(otherwise).ln().clamp(low, high);
    for _ in 0..MOST_STEPS {
        let variance = at.exp();
        let (score, information) = restricted.at(variance)?;
        let found = Some((variance, Some(variance * variance * information)));
        if score > 0.0 {
            (low, low_seen) = (at, true);
            if at >= BOUNDS.1 {
                return found;
            }
        } else {
            high = at;
            if at <= BOUNDS.0 {
                // No jitter is seen beside the sensor's noise.
                return Some((0.0, Some(usual_freedom)));
            }
        }
        let step = score / (information * variance);
        let next = at + step.clamp(-STRIDE, STRIDE);
        if step.abs() < CLOSE || high - low < CLOSE {
            return found;
        }
        at = if step <= -1.0 && !low_seen {
            // By this score there is none left: the bottom decides.
            BOUNDS.0
        } else if next > low && next < high {
            next
        } else {
            0.5 * (low + high)
        };
    }
    restricted.at(at.exp()).map(|(_, information)| (at.exp(), Some((2.0 * at).exp() * information)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shots of many exact cells that show one level: sums about its mean.
    fn sums(means: &[f64]) -> Vec<ShotSums> {
        let level = means.iter().sum::<f64>() / means.len() as f64;
        let of = |mean: &f64| {
            let mut s = ShotSums::zero(1);
            (0..50).for_each(|_| s.add(1e8, mean / level - 1.0, &[1.0]));
            s
        };
        means.iter().map(of).collect()
    }

    #[test]
    fn it_is_the_sample_variance_wherever_the_search_begins() {
        let shots = sums(&[0.98, 1.01, 1.03, 0.995, 1.002]);
        let wanted = shots.iter().map(|s| s.own().powi(2)).sum::<f64>() / 4.0;
        for before in [None, Some(0.0), Some(1e-12), Some(wanted), Some(0.5), Some(1.0)] {
            let (found, freedom) = jitter(&shots, &DMatrix::zeros(1, 1), 0.003, 1.0, before).unwrap();
            assert!((found / wanted - 1.0).abs() < 1e-3, "{before:?}: {found} of {wanted}");
            assert!((freedom.unwrap() - 4.0).abs() < 1e-3);
        }
    }

    #[test]
    fn alike_shots_have_none_and_a_single_one_tells_none() {
        let alike = sums(&[1.0; 6]);
        for before in [None, Some(0.0), Some(0.1)] {
            let (found, freedom) = jitter(&alike, &DMatrix::zeros(1, 1), 0.003, 1.0, before).unwrap();
            assert!(found == 0.0 && freedom.is_some_and(|f| (f - 5.0).abs() < 0.1), "{found} {freedom:?}");
        }
        assert_eq!(jitter(&alike[..1], &DMatrix::zeros(1, 1), 0.003, 1.0, None), Some((0.003 * 0.003, None)));
    }
}
