//! Normal equations of a few unknowns.

/// Half width of a 95 % interval of a normal distribution in standard deviations.
pub(super) const Z95: f64 = 1.959_964;

/// Solves `matrix x = right` for a symmetric positive matrix by Gauss and Jordan with pivots: x and the inverse, which
/// is the covariance where the matrix is the sum of `row row^T / variance`. `None` if the rows do not tell all unknowns.
pub(super) fn solve(matrix: &[Vec<f64>], right: &[f64]) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
    let n = right.len();
    // Unknowns of very different size: each is measured by its own diagonal.
    let scale: Vec<f64> = (0..n).map(|i| matrix[i][i].sqrt()).collect();
    if scale.iter().any(|s| !s.is_finite() || *s <= 0.0) {
        return None;
    }
    let mut rows: Vec<Vec<f64>> = (0..n)
        .map(|i| {
            let left = (0..n).map(|j| matrix[i][j] / (scale[i] * scale[j]));
            left.chain((0..n).map(|j| f64::from(u8::from(i == j)))).collect()
        })
        .collect();
    for column in 0..n {
        let best = (column..n).max_by(|&a, &b| rows[a][column].abs().total_cmp(&rows[b][column].abs()))?;
        if rows[best][column].abs() < 1e-12 {
            return None;
        }
        rows.swap(column, best);
        let pivot = rows[column][column];
        rows[column].iter_mut().for_each(|v| *v /= pivot);
        let own = rows[column].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(i, _)| *i != column) {
            let factor = row[column];
            row.iter_mut().zip(&own).for_each(|(v, o)| *v -= factor * o);
        }
    }
    let inverse: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| rows[i][n + j] / (scale[i] * scale[j])).collect()).collect();
    let solution = inverse.iter().map(|row| row.iter().zip(right).map(|(a, b)| a * b).sum()).collect();
    Some((solution, inverse))
}

/// 97.5 % quantile of Student's t with `freedom` degrees of freedom (Cornish and Fisher's expansion from 3 up;
/// Abramowitz and Stegun 26.7.5): half width of a 95 % interval in standard errors.
pub(super) fn t_975(freedom: usize) -> f64 {
    match freedom {
        0 => f64::INFINITY,
        1 => 12.706_2,
        2 => 4.302_65,
        _ => {
            let (n, z2) = (freedom as f64, Z95 * Z95);
            let first = Z95 * (z2 + 1.0) / 4.0;
            let second = Z95 * ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0;
            let third = Z95 * (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0;
            let fourth = Z95 * ((((79.0 * z2 + 776.0) * z2 + 1482.0) * z2 - 1920.0) * z2 - 945.0) / 92_160.0;
            Z95 + (first + (second + (third + fourth / n) / n) / n) / n
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_system_is_solved_and_a_poor_one_refused() {
        let matrix = vec![vec![4.0, 1.0, 0.0], vec![1.0, 3e6, 2.0], vec![0.0, 2.0, 1.0]];
        let wanted = [1.0, -2.0, 0.5];
        let right: Vec<f64> =
            matrix.iter().map(|row| row.iter().zip(wanted).map(|(a, b)| a * b).sum()).collect();
        let (x, inverse) = solve(&matrix, &right).unwrap();
        assert!(x.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{x:?}");
        let product: f64 = matrix[1].iter().zip(&inverse).map(|(a, row)| a * row[1]).sum();
        assert!((product - 1.0).abs() < 1e-9);
        assert!(solve(&[vec![1.0, 2.0], vec![2.0, 4.0]], &[1.0, 2.0]).is_none());
        assert!(solve(&[vec![1.0, 0.0], vec![0.0, 0.0]], &[1.0, 2.0]).is_none());
    }

    #[test]
    fn students_quantiles_are_those_of_the_tables() {
        for (freedom, quantile) in [(3, 3.182), (5, 2.571), (10, 2.228), (30, 2.042), (1000, 1.962)] {
            assert!((t_975(freedom) / quantile - 1.0).abs() < 3e-3, "{freedom}: {}", t_975(freedom));
        }
    }
}
