//! A 3x3 matrix from camera RGB to CIE XYZ under D50, over the patches of a chart.
//!
//! Starting from linear least squares, the sum of the squares of CIEDE2000 is made smallest by Levenberg's and
//! Marquardt's method: a difference of XYZ is no measure of what is seen, and a fit in XYZ gives the dark patches away
//! (Finlayson, Mackiewicz and Hurlbert, "Color correction using root-polynomial regression", IEEE Transactions on Image
//! Processing 24(5), 2015, give both and the reasons). White stays white without a constraint as Finlayson and Drew
//! have it ("Constrained least-squares regression in color spaces", Journal of Electronic Imaging 6(4), 1997), for the
//! camera's white is defined as what the matrix takes to D50.
//!
//! Light that falls off over the chart is told by two more unknowns, its relative change from the chart's middle to the
//! outermost patches across and down: `XYZ = M rgb / (1 + across u + down v)` with u and v from -1 to 1. The grey
//! patches alone lie in one row and tell half of it; all patches tell both, as their colours do not follow their
//! places.

use super::cielab::{D50, Lab, Lightness, difference, lab, xyz};
use crate::calibration::linear::{Normal, inverse};
use glam::{DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, DVector};

/// Numbers of the matrix.
const MATRIX: usize = 9;

/// Fewest patches that a matrix is fitted to: two thirds of the numbers must be over.
pub(super) const LEAST_PATCHES: usize = 9;

/// One patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Linear camera RGB, any one unit.
    pub rgb: DVec3,
    /// What it should be.
    pub reference: Lab,
    /// Place on the chart, -1 to 1 across and down.
    pub place: DVec2,
}

/// Result of a fit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solution {
    /// XYZ, white Y = 1, of camera RGB in the samples' unit.
    pub xyz_from_rgb: DMat3,
    /// Relative change of the light from the middle to the outermost patches, across and down; 0 if it was not asked.
    pub gradient: DVec2,
    /// Its standard errors from the residuals.
    pub gradient_error: DVec2,
}

impl Solution {
    /// CIELAB of a sample.
    pub(super) fn lab(&self, sample: &Sample) -> Lab {
        lab(self.xyz_from_rgb * sample.rgb / (1.0 + self.gradient.dot(sample.place)))
    }
}

/// Linear least squares of XYZ with about the weights of lightness; `None` where the colours do not span three
/// dimensions.
pub(super) fn linear(pairs: impl Iterator<Item = (DVec3, DVec3)>) -> Option<DMat3> {
    let (mut square, mut cross, mut size) = (DMat3::ZERO, DMat3::ZERO, DVec3::ZERO);
    for (rgb, xyz) in pairs {
        let weight = (xyz.y + 0.03).powf(-4.0 / 3.0);
        square += outer(rgb, rgb) * weight;
        cross += outer(xyz, rgb) * weight;
        size += rgb * rgb * weight;
    }
    // A colour cast must not count as nearly singular.
    let even = square.determinant() / (size.x * size.y * size.z);
    (even.is_finite() && even > 1e-9).then(|| cross * square.inverse())
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Fits the matrix, and if `uneven` the light's gradient too; `None` with too few patches or no three dimensions.
pub(super) fn solve(samples: &[Sample], uneven: bool) -> Option<Solution> {
    if samples.len() < LEAST_PATCHES {
        return None;
    }
    // Numbers of one size make one step good for all.
    let unit = samples.iter().map(|s| s.rgb.abs()).sum::<DVec3>() / samples.len() as f64;
    let scaled: Vec<Sample> = samples.iter().map(|s| Sample { rgb: s.rgb / unit, ..*s }).collect();
    let start = linear(scaled.iter().map(|s| (s.rgb, xyz(s.reference))))?;
    let count = if uneven { MATRIX + 2 } else { MATRIX };
    let mut state: Vec<f64> = start.to_cols_array().into_iter().chain([0.0; 2]).collect();
    let mut residual = residuals(&scaled, &state);
    let mut damping = 1e-3f64;
    for _ in 0..60 {
        let normal = Normal::of(&jacobian(&scaled, &state, &residual, count), &residual);
        let before = residual.norm_squared();
        let mut gained = 0.0;
        for _ in 0..12 {
            let Some((step, _)) = normal.damped(damping).solve() else { break };
            let mut next = state.clone();
            next.iter_mut().zip(&step).for_each(|(v, s)| *v -= s);
            let there = residuals(&scaled, &next);
            let cost = there.norm_squared();
            if cost < before {
                (state, residual, gained) = (next, there, before - cost);
                damping = (0.2 * damping).max(1e-12);
                break;
            }
            damping *= 5.0;
        }
        // Differences of a millionth are none.
        if gained <= 1e-10 * before || before - gained < 1e-12 {
            break;
        }
    }
    let errors = errors(&jacobian(&scaled, &state, &residual, count), &residual);
    let error = |k: usize| errors.as_ref().and_then(|e| e.get(k)).copied().unwrap_or_default();
    let (matrix, gradient) = parts(&state);
    let xyz_from_rgb = matrix * DMat3::from_diagonal(1.0 / unit);
    xyz_from_rgb.is_finite().then_some(Solution {
        xyz_from_rgb,
        gradient,
        gradient_error: DVec2::new(error(MATRIX), error(MATRIX + 1)),
    })
}

/// Standard errors of all numbers. Colours scatter more than lightness and patches differ, so that the residuals'
/// common variance would tell the errors wrong; each patch's own three residuals stand for theirs (White,
/// "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48(4), 1980, by patches), with
/// patches over spare patches for the numbers that were fitted.
fn errors(jacobian: &DMatrix<f64>, residual: &DVector<f64>) -> Option<DVector<f64>> {
    let (count, patches) = (jacobian.ncols(), residual.len() / 3);
    let inverse = inverse(&jacobian.tr_mul(jacobian))?;
    let mut squares = DVector::zeros(count);
    for patch in 0..patches {
        let share = &inverse * jacobian.rows(3 * patch, 3).tr_mul(&residual.rows(3 * patch, 3));
        squares += share.component_mul(&share);
    }
    let n = patches as f64;
    let scale = n / (n - count as f64 / 3.0);
    Some(squares.map(|s| (s * scale).sqrt()))
}

fn parts(state: &[f64]) -> (DMat3, DVec2) {
    (DMat3::from_cols_slice(&state[..MATRIX]), DVec2::from_slice(&state[MATRIX..]))
}

/// Three a patch, whose squares add up to that of CIEDE2000.
fn residuals(samples: &[Sample], state: &[f64]) -> DVector<f64> {
    let (xyz_from_rgb, gradient) = parts(state);
    let solution = Solution { xyz_from_rgb, gradient, gradient_error: DVec2::ZERO };
    let one = |s: &Sample| difference(s.reference, solution.lab(s), Lightness::Weighted).to_array();
    DVector::from_iterator(3 * samples.len(), samples.iter().flat_map(one))
}

/// One column a number: how all residuals change with it. XYZ is linear in the matrix, so that three steps a patch, one
/// along each axis of XYZ, tell all.
fn jacobian(samples: &[Sample], state: &[f64], residual: &DVector<f64>, count: usize) -> DMatrix<f64> {
    const STEP: f64 = 1e-6;
    let (matrix, gradient) = parts(state);
    let mut columns = DMatrix::zeros(residual.len(), count);
    for (k, s) in samples.iter().enumerate() {
        let light = 1.0 + gradient.dot(s.place);
        let (rgb, at) = (s.rgb / light, matrix * s.rgb / light);
        let here = DVec3::from_slice(&residual.as_slice()[3 * k..]);
        let there = |axis: DVec3| difference(s.reference, lab(at + STEP * axis), Lightness::Weighted);
        let by_xyz = DMat3::from_cols(
            (there(DVec3::X) - here) / STEP,
            (there(DVec3::Y) - here) / STEP,
            (there(DVec3::Z) - here) / STEP,
        );
        // Columns of the matrix one after the other, then the light's change across and down.
        let change = |number: usize| match number.checked_sub(MATRIX) {
            None => by_xyz.col(number % 3) * rgb[number / 3],
            Some(axis) => by_xyz * at * (-s.place[axis] / light),
        };
        for (number, mut column) in columns.column_iter_mut().enumerate() {
            column.rows_mut(3 * k, 3).copy_from_slice(&change(number).to_array());
        }
    }
    columns
}

/// Camera RGB of a perfect white under the chart's light, in the samples' unit; `None` unless it is light in all
/// channels.
pub(super) fn white(solution: &Solution) -> Option<DVec3> {
    let white = solution.xyz_from_rgb.inverse() * D50;
    (white.is_finite() && white.cmpgt(DVec3::ZERO).all()).then_some(white)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::calibration::colour::charts::{ChartKind, PATCHES};
    use crate::calibration::colour::cielab::delta_e_2000;
    use crate::calibration::colour::plane::patch_centre;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    /// Even over 0 to 1.
    pub(in super::super) fn even(rng: &mut ChaCha8Rng) -> f64 {
        rng.random()
    }

    /// Normal with standard deviation 1, near enough: twelve even ones.
    pub(in super::super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| even(rng)).sum::<f64>() - 6.0
    }

    /// A camera's matrix, XYZ to RGB: broad overlapping channels of any sensitivity.
    pub(in super::super) fn camera(rng: &mut ChaCha8Rng) -> DMat3 {
        let rows = [[0.70, -0.08, -0.10], [-0.44, 1.26, 0.20], [-0.08, 0.20, 0.58]];
        let rows = rows.map(|row| {
            let gain = 0.4 + 1.6 * even(rng);
            DVec3::from(row.map(|v| gain * (v + 0.06 * (even(rng) - 0.5))))
        });
        DMat3::from_cols(rows[0], rows[1], rows[2]).transpose()
    }

    fn samples(kind: ChartKind, rgb_from_xyz: DMat3, gradient: DVec2) -> Vec<Sample> {
        (0..PATCHES)
            .map(|k| {
                let place = (patch_centre(k) - DVec2::new(2.5, 1.5)) / DVec2::new(2.5, 1.5);
                let reference = kind.patches()[k].1;
                let light = 1.0 + gradient.dot(place);
                Sample { rgb: rgb_from_xyz * xyz(reference) * light, reference, place }
            })
            .collect()
    }

    #[test]
    fn any_cameras_matrix_and_the_lights_gradient_are_found_again() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..1000 {
            let rgb_from_xyz = camera(&mut rng) * 3000.0;
            let gradient = DVec2::new(0.3 * (even(&mut rng) - 0.5), 0.3 * (even(&mut rng) - 0.5));
            let samples = samples(ChartKind::Colorchecker24, rgb_from_xyz, gradient);
            let found = solve(&samples, true).unwrap();
            assert!(found.gradient.distance(gradient) < 1e-4, "{found:?} for {gradient}");
            let product = found.xyz_from_rgb * rgb_from_xyz;
            assert!(product.abs_diff_eq(DMat3::IDENTITY, 1e-3), "{product}");
            let worst = samples.iter().map(|s| delta_e_2000(s.reference, found.lab(s))).fold(0.0, f64::max);
            assert!(worst < 0.01, "{worst}");
        }
    }

    #[test]
    fn intervals_of_the_gradient_hold_it_as_often_as_they_say_over_a_thousand_cameras() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let (mut inside, mut all) = (0, 0);
        for _ in 0..1000 {
            let gradient = DVec2::new(0.2 * (even(&mut rng) - 0.5), 0.2 * (even(&mut rng) - 0.5));
            let mut samples = samples(ChartKind::Colorchecker24, camera(&mut rng), gradient);
            for s in &mut samples {
                s.rgb *= DVec3::from_array([0; 3].map(|_| 1.0 + 0.02 * normal(&mut rng)));
            }
            let found = solve(&samples, true).unwrap();
            for axis in 0..2 {
                // Student's t for 20 degrees of freedom.
                inside +=
                    usize::from((found.gradient - gradient)[axis].abs() < 2.09 * found.gradient_error[axis]);
                all += 1;
            }
        }
        let coverage = inside as f64 / all as f64;
        assert!((0.90..=0.98).contains(&coverage), "{coverage}");
    }

    #[test]
    fn derivatives_are_those_of_the_residuals() {
        let mut rng = ChaCha8Rng::seed_from_u64(10);
        let samples = samples(ChartKind::Colorchecker24, camera(&mut rng), DVec2::new(0.05, -0.1));
        let (matrix, gradient) = (camera(&mut rng).inverse(), DVec2::new(0.02, 0.03));
        let state: Vec<f64> = matrix.to_cols_array().into_iter().chain(gradient.to_array()).collect();
        let here = residuals(&samples, &state);
        for (number, column) in jacobian(&samples, &state, &here, state.len()).column_iter().enumerate() {
            let mut moved = state.clone();
            moved[number] += 1e-6;
            let there = residuals(&samples, &moved);
            let size = column.amax();
            for (k, told) in column.iter().enumerate() {
                let found = (there[k] - here[k]) / 1e-6;
                assert!((told - found).abs() < 1e-3 * size, "{number} {k}: {told} for {found}");
            }
        }
    }

    #[test]
    fn squares_of_ciede2000_are_smaller_than_a_linear_fit_leaves_them() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let mut samples = samples(ChartKind::Spydercheckr24, camera(&mut rng), DVec2::ZERO);
        for s in &mut samples {
            s.rgb = (s.rgb * DVec3::from_array([0; 3].map(|_| 1.0 + 0.1 * normal(&mut rng)))).abs();
        }
        let linear = linear(samples.iter().map(|s| (s.rgb, xyz(s.reference)))).unwrap();
        let linear = Solution { xyz_from_rgb: linear, gradient: DVec2::ZERO, gradient_error: DVec2::ZERO };
        let sum =
            |x: &Solution| samples.iter().map(|s| delta_e_2000(s.reference, x.lab(s)).powi(2)).sum::<f64>();
        assert!(sum(&solve(&samples, false).unwrap()) < 0.95 * sum(&linear));
        assert!(sum(&solve(&samples, true).unwrap()) <= sum(&solve(&samples, false).unwrap()) + 1e-9);
    }

    #[test]
    fn greys_alone_and_too_few_patches_give_no_matrix() {
        let all = samples(ChartKind::Colorchecker24, DMat3::IDENTITY, DVec2::ZERO);
        assert!(solve(&all[..8], false).is_none());
        let grey: Vec<Sample> = all.iter().map(|s| Sample { rgb: DVec3::splat(s.rgb.y), ..*s }).collect();
        assert!(solve(&grey, false).is_none());
    }
}
