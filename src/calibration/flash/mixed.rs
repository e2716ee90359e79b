//! Least squares where every shot has a factor of its own that all its cells share.
//!
//! Cell i of shot s reads `y = m(theta) (1 + u_s) + e`, `u_s ~ N(0, sigma^2)` the flash's jitter, `e ~ N(0, phi v)`
//! with v the sensor's variance. Cells of one shot are therefore not independent: with relative residuals
//! `r = y / m - 1`, weights `w = m^2 / (phi v)` and `d = dlog m / dtheta`, the sums of a shot
//!
//! ```text
//! A = sum w d d',  c = sum w d,  g = sum w d r,  W = sum w,  H = sum w r
//! ```
//!
//! give the marginal normal equations `sum_s (A - c c' k) step = sum_s (g - c H k)`, `k = sigma^2 / (1 + sigma^2 W)`
//! (Woodbury's identity; Searle, Casella, McCulloch, "Variance Components", 1992, ch. 6), solved by
//! Levenberg-Marquardt. sigma is found by restricted maximum likelihood (module `variance`); phi is the mean square of
//! the residuals within the shots. Intervals
//! are Student's with Satterthwaite's degrees of freedom, which count shots and not cells where the jitter decides
//! (Giesbrecht and Burns, Biometrics 41, 1985).

use super::variance::jitter;
use crate::calibration::linear::{Normal, inverse};
use crate::calibration::statistics::{Z95, t_975};
use nalgebra::{DMatrix, DVector, DVectorView};

/// Most evaluations of the model.
const MOST_ROUNDS: usize = 60;

/// By how much a step may raise the objective (twice a logarithm of likelihood): its weights go with the model, so that
/// it is lowest a little beside the place where the equations hold.
const SLACK: f64 = 0.02;

/// Steps below this part of the standard errors end the search.
const CLOSE: f64 = 1e-3;

/// What the fit needs of one shot at some parameters; residuals and derivatives are relative to the model, weights by
/// the sensor's variance alone.
#[derive(Clone, Debug)]
pub(super) struct ShotSums {
    /// A and g.
    pub(super) cells: Normal,
    pub(super) c: DVector<f64>,
    pub(super) w: f64,
    pub(super) h: f64,
    /// Sum of w r^2.
    pub(super) chi: f64,
    /// Cells, and unweighted sums of r, r^2 and the sensor's variance 1 / w.
    pub(super) count: f64,
    pub(super) plain: f64,
    pub(super) squares: f64,
    pub(super) noise: f64,
}

impl ShotSums {
    pub(super) fn zero(n: usize) -> Self {
        let (cells, c) = (Normal::zero(n), DVector::zeros(n));
        Self { cells, c, w: 0.0, h: 0.0, chi: 0.0, count: 0.0, plain: 0.0, squares: 0.0, noise: 0.0 }
    }

    /// One cell.
    pub(super) fn add(&mut self, weight: f64, residual: f64, derivative: &[f64]) {
        self.cells.add(derivative, residual, weight);
        self.c.iter_mut().zip(derivative).for_each(|(c, d)| *c += weight * d);
        self.w += weight;
        self.h += weight * residual;
        self.chi += weight * residual * residual;
        self.count += 1.0;
        self.plain += residual;
        self.squares += residual * residual;
        self.noise += weight.recip();
    }

    /// The shot's own factor less 1.
    pub(super) fn own(&self) -> f64 {
        self.h / self.w
    }

    /// Root mean square of the residuals about the shot's own factor.
    pub(super) fn rms(&self) -> f64 {
        let n = self.count.max(1.0);
        (self.squares / n - (self.plain / n).powi(2)).max(0.0).sqrt()
    }
}

/// What is fitted.
pub(super) trait Model {
    /// Sums of every shot; `None` where the parameters make no sense.
    fn sums(&self, theta: &[f64]) -> Option<Vec<ShotSums>>;
    /// Information beforehand about the parameters, which are 0 by it.
    fn prior(&self) -> &DMatrix<f64>;
}

/// What came out.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub(super) theta: Vec<f64>,
    /// Covariance of `theta`.
    pub(super) covariance: DMatrix<f64>,
    /// Sums at `theta`.
    pub(super) sums: Vec<ShotSums>,
    /// Variance of the jitter, relative.
    pub(super) variance: f64,
    /// Degrees of freedom by which it was found; `None` if it was given.
    pub(super) freedom: Option<f64>,
    /// phi.
    pub(super) dispersion: f64,
    normal: DMatrix<f64>,
}

/// Weight of the jitter in a shot: k.
fn kernel(s: &ShotSums, variance: f64, phi: f64) -> f64 {
    variance / (phi + variance * s.w)
}

/// Marginal normal equations of a shot.
fn marginal(s: &ShotSums, variance: f64, phi: f64) -> Normal {
    let mut own = s.cells.clone();
    own.add(s.c.as_slice(), s.h, -kernel(s, variance, phi));
    Normal { matrix: own.matrix / phi, right: own.right / phi }
}

/// v' M v.
fn form(m: &DMatrix<f64>, v: &DVector<f64>) -> f64 {
    v.dot(&(m * v))
}

fn objective(sums: &[ShotSums], theta: &DVector<f64>, prior: &DMatrix<f64>, variance: f64, phi: f64) -> f64 {
    let of = |s: &ShotSums| (s.chi - s.h * s.h * kernel(s, variance, phi)) / phi;
    sums.iter().map(of).sum::<f64>() + form(prior, theta)
}

/// Mean square of the residuals within the shots, 1 at least: the sensor's noise is not less than it is.
fn dispersion(sums: &[ShotSums], unknowns: usize) -> f64 {
    let within: f64 = sums.iter().map(|s| s.chi - s.h * s.h / s.w).sum();
    let count: f64 = sums.iter().map(|s| s.count).sum();
    let freedom = count - (sums.len() + unknowns) as f64;
    if freedom > 0.0 { (within / freedom).max(1.0) } else { 1.0 }
}

/// Fits from a start; `usual` is the jitter (relative standard deviation) that is taken where the shots are too few to tell
/// it. `None` if the shots cannot tell all parameters apart.
pub(super) fn solve(model: &impl Model, start: Vec<f64>, usual: f64) -> Option<Solution> {
    let prior = model.prior();
    let unknowns = start.len();
    let (mut theta, mut damping) = (DVector::from_vec(start), 0.0f64);
    let mut sums = model.sums(theta.as_slice())?;
    let (mut settled, mut before) = (0, None);
    for _ in 0..MOST_ROUNDS {
        let phi = dispersion(&sums, unknowns);
        let (variance, freedom) = jitter(&sums, prior, usual, phi, before)?;
        before = freedom.map(|_| variance);
        let mut all = Normal { matrix: prior.clone(), right: -(prior * &theta) };
        for s in &sums {
            let own = marginal(s, variance, phi);
            all.matrix += own.matrix;
            all.right += own.right;
        }
        let covariance = inverse(&all.matrix)?;
        if settled == 2 {
            let (theta, normal) = (theta.as_slice().to_vec(), all.matrix);
            return Some(Solution { theta, covariance, sums, variance, freedom, dispersion: phi, normal });
        }
        let (step, _) = all.damped(damping).solve()?;
        let next = &theta + &step;
        let before = objective(&sums, &theta, prior, variance, phi);
        let close = (0..unknowns).all(|i| step[i].abs() <= CLOSE * covariance[(i, i)].sqrt());
        let tried = model.sums(next.as_slice()).filter(|tried| {
            let after = objective(tried, &next, prior, variance, phi);
            after.is_finite() && (after <= before + SLACK || close)
        });
        match tried {
            Some(tried) => {
                (theta, sums) = (next, tried);
                damping = if damping < 1e-6 { 0.0 } else { damping / 10.0 };
                settled = if close { settled + 1 } else { 0 };
            }
            None if damping > 1e8 => return None,
            None => damping = (10.0 * damping).max(1e-3),
        }
    }
    None
}

impl Solution {
    /// Standard error of a parameter.
    pub(super) fn error(&self, place: usize) -> f64 {
        self.covariance[(place, place)].max(0.0).sqrt()
    }

    /// Half of the 95 % interval of a parameter.
    pub(super) fn half_interval(&self, place: usize) -> f64 {
        // Satterthwaite's degrees of freedom.
        let part =
            self.slope(self.covariance.column(place)) * self.variance / self.covariance[(place, place)];
        self.error(place) * self.freedom_of_part(part).map_or(Z95, t_975)
    }

    /// Degrees of freedom of a variance of which the jitter's own is this part, in logarithms.
    fn freedom_of_part(&self, part: f64) -> Option<f64> {
        // The variance of the estimated variance is 2 variance^2 / freedom.
        self.freedom.filter(|_| part > 1e-6).map(|freedom| (freedom / (part * part)).max(1.0))
    }

    /// By how much a linear form's variance grows with the jitter's; `spread`: the covariance times the form.
    fn slope(&self, spread: DVectorView<f64>) -> f64 {
        let of = |s: &ShotSums| (s.c.dot(&spread) / (self.dispersion + self.variance * s.w)).powi(2);
        self.sums.iter().map(of).sum()
    }

    /// Half of the 95 % interval within which the light of a shot outside of the fit is off its prediction, relative.
    pub(super) fn half_prediction(&self, shot: &ShotSums) -> f64 {
        let own = &shot.c / shot.w;
        let all = self.variance + self.dispersion / shot.w + form(&self.covariance, &own);
        let spread = &self.covariance * own;
        let part = self.variance * (1.0 + self.slope(spread.as_view())) / all;
        all.sqrt() * self.freedom_of_part(part).map_or(Z95, t_975)
    }

    /// What a shot would have been off a fit made without it (one step from the optimum), relative.
    pub(super) fn left_out(&self, shot: usize) -> Option<f64> {
        let s = &self.sums[shot];
        let own = marginal(s, self.variance, self.dispersion);
        let (step, _) = Normal { matrix: &self.normal - own.matrix, right: -own.right }.solve()?;
        Some((s.h - s.c.dot(&step)) / s.w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One unknown, the logarithm of a level that every shot shows with its factor.
    struct Level {
        shots: Vec<Vec<f64>>,
        deviation: f64,
        prior: DMatrix<f64>,
    }

    impl Model for Level {
        fn sums(&self, theta: &[f64]) -> Option<Vec<ShotSums>> {
            let m = theta[0].exp();
            let of = |cells: &Vec<f64>| {
                let mut s = ShotSums::zero(1);
                cells.iter().for_each(|y| s.add((m / self.deviation).powi(2), y / m - 1.0, &[1.0]));
                s
            };
            Some(self.shots.iter().map(of).collect())
        }

        fn prior(&self) -> &DMatrix<f64> {
            &self.prior
        }
    }

    #[test]
    fn with_one_level_it_is_the_mean_of_the_shots_with_students_interval() {
        let means = [98.0, 101.0, 103.0, 99.5, 100.2];
        let shots = means.iter().map(|m| vec![m - 1e-3, *m, m + 1e-3]).collect();
        let fit = solve(&Level { shots, deviation: 1e-3, prior: DMatrix::zeros(1, 1) }, vec![4.0], 0.003);
        let fit = fit.unwrap();
        let mean = means.iter().sum::<f64>() / 5.0;
        let sd = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / 4.0).sqrt();
        assert!((fit.theta[0].exp() / mean - 1.0).abs() < 1e-6, "{fit:?}");
        assert!((fit.variance.sqrt() / (sd / mean) - 1.0).abs() < 1e-3, "{fit:?}");
        let wanted = 2.7764 * sd / mean / 5f64.sqrt();
        assert!((fit.half_interval(0) / wanted - 1.0).abs() < 1e-3);
        let others = (means.iter().sum::<f64>() - 98.0) / 4.0;
        assert!((fit.left_out(0).unwrap() - (98.0 - others) / mean).abs() < 1e-4);
    }

    #[test]
    fn a_single_shot_takes_the_jitter_that_is_given() {
        let fit = solve(
            &Level { shots: vec![vec![50.0; 9]], deviation: 0.1, prior: DMatrix::zeros(1, 1) },
            vec![3.0],
            0.004,
        );
        let fit = fit.unwrap();
        assert_eq!(fit.freedom, None);
        assert!((fit.error(0) / 0.004 - 1.0).abs() < 0.05);
        assert!(fit.left_out(0).is_none());
    }
}
