//! Least squares of a few unknowns by their normal equations.

use nalgebra::{DMatrix, DVector, DVectorView};

/// Squares of a factor's diagonal, of 1, that are no more than rounding.
const ROUNDING: f64 = 1e-12;

/// Normal equations: sums of `weight row row^T` and of `weight value row`.
#[derive(Clone, Debug)]
pub(super) struct Normal {
    pub(super) matrix: DMatrix<f64>,
    pub(super) right: DVector<f64>,
}

impl Normal {
    pub(super) fn zero(unknowns: usize) -> Self {
        Self { matrix: DMatrix::zeros(unknowns, unknowns), right: DVector::zeros(unknowns) }
    }

    /// Of residuals and their derivatives, a column each unknown: the solution taken off the unknowns is the step of
    /// Gauss and Newton.
    pub(super) fn of(derivatives: &DMatrix<f64>, residuals: &DVector<f64>) -> Self {
        Self { matrix: derivatives.tr_mul(derivatives), right: derivatives.tr_mul(residuals) }
    }

    /// Adds `row x = value`.
    pub(super) fn add(&mut self, row: &[f64], value: f64, weight: f64) {
        let row = DVectorView::from_slice(row, row.len());
        self.matrix.ger(weight, &row, &row, 1.0);
        self.right.axpy(weight * value, &row, 1.0);
    }

    /// With a diagonal that is larger by a part of itself, as Levenberg and Marquardt have it.
    pub(super) fn damped(&self, part: f64) -> Self {
        let mut damped = self.clone();
        (0..damped.right.len()).for_each(|i| damped.matrix[(i, i)] *= 1.0 + part);
        damped
    }

    /// The unknowns, and the matrix's inverse, which is their covariance where the weights are inverse variances. `None`
    /// if the rows do not tell all unknowns.
    pub(super) fn solve(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let inverse = inverse(&self.matrix)?;
        Some((&inverse * &self.right, inverse))
    }
}

/// Inverse of a symmetric matrix; `None` if it is not positive definite by more than rounding.
pub(super) fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Unknowns of very different size: each is measured by its own diagonal.
    let scale = matrix.diagonal().map(|d| d.sqrt().recip());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let scales = &scale * scale.transpose();
    let factors = matrix.component_mul(&scales).cholesky()?;
    let told = factors.l_dirty().diagonal().iter().all(|d| d * d > ROUNDING);
    told.then(|| factors.inverse().component_mul(&scales))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknowns_of_any_size_are_found_and_poor_rows_refused() {
        let wanted = [1.0, -3e6, 0.5];
        let mut normal = Normal::zero(3);
        for (row, weight) in [([1e3, 2e-4, 0.0], 1.0), ([0.0, 1e-4, 4e2], 2.0), ([5e2, 0.0, 1e2], 0.5)] {
            assert!(normal.solve().is_none());
            normal.add(&row, row.iter().zip(wanted).map(|(a, x)| a * x).sum(), weight);
        }
        let (x, inverse) = normal.solve().unwrap();
        assert!(x.iter().zip(wanted).all(|(x, w)| (x / w - 1.0).abs() < 1e-9), "{x}");
        let one = &normal.matrix * &inverse;
        assert!((one[(1, 1)] - 1.0).abs() < 1e-9 && (one[(2, 2)] - 1.0).abs() < 1e-9, "{one}");
        assert!(super::inverse(&DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 4.0])).is_none());
        assert!(super::inverse(&DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 0.0])).is_none());
        assert!(super::inverse(&DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, f64::NAN])).is_none());
    }

    #[test]
    fn damping_shortens_the_step_of_gauss_and_newton() {
        let derivatives = DMatrix::from_row_slice(3, 2, &[1.0, 0.0, 0.0, 2.0, 1.0, 1.0]);
        let residuals = &derivatives * DVector::from_column_slice(&[3.0, -1.0]);
        let normal = Normal::of(&derivatives, &residuals);
        let (step, _) = normal.solve().unwrap();
        assert!((&step - DVector::from_column_slice(&[3.0, -1.0])).norm() < 1e-12, "{step}");
        assert!(normal.damped(0.5).solve().unwrap().0.norm() < 0.8 * step.norm());
    }
}
