//! Small dense systems of equations.

/// Inverse of a square matrix by Gauss and Jordan's elimination with partial pivoting; `None` if it is singular.
pub(super) fn inverse(matrix: &[Vec<f64>]) -> Option<Vec<Vec<f64>>> {
    let n = matrix.len();
    let largest = matrix.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
    let unit = |i: usize| (0..n).map(move |j| if i == j { 1.0 } else { 0.0 });
    let mut rows: Vec<Vec<f64>> =
        matrix.iter().enumerate().map(|(i, row)| row.iter().copied().chain(unit(i)).collect()).collect();
    for k in 0..n {
        let pivot = (k..n).max_by(|&a, &b| rows[a][k].abs().total_cmp(&rows[b][k].abs()))?;
        rows.swap(k, pivot);
        let head = rows[k][k];
        if !head.is_finite() || head.abs() <= 1e-14 * largest {
            return None;
        }
        rows[k].iter_mut().for_each(|v| *v /= head);
        let row = rows[k].clone();
        for other in (0..n).filter(|&i| i != k) {
            let factor = rows[other][k];
            rows[other].iter_mut().zip(&row).for_each(|(v, r)| *v -= factor * r);
        }
    }
    Some(rows.into_iter().map(|row| row[n..].to_vec()).collect())
}

/// Matrix times vector.
pub(super) fn times(matrix: &[Vec<f64>], vector: &[f64]) -> Vec<f64> {
    matrix.iter().map(|row| dot(row, vector)).collect()
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_undoes_and_what_has_none_is_none() {
        let m = vec![vec![0.0, 2.0, 1.0], vec![1.0, -1.0, 0.5], vec![3.0, 0.0, -2.0]];
        let x = vec![0.3, -1.2, 2.5];
        let back = times(&inverse(&m).unwrap(), &times(&m, &x));
        assert!(back.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-12), "{back:?}");
        assert!(inverse(&[vec![1.0, 2.0], vec![2.0, 4.0]]).is_none());
    }
}
