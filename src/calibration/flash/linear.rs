//! Small symmetric matrices: normal equations of a dozen unknowns at the most.

/// A symmetric matrix, rows one after the other.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Symmetric {
    n: usize,
    cells: Vec<f64>,
}

impl Symmetric {
    /// Of zeros.
    pub(super) fn zero(n: usize) -> Self {
        Self { n, cells: vec![0.0; n * n] }
    }

    pub(super) fn at(&self, i: usize, j: usize) -> f64 {
        self.cells[i * self.n + j]
    }

    /// Adds `factor v v'`.
    pub(super) fn add_outer(&mut self, v: &[f64], factor: f64) {
        for (row, a) in self.cells.chunks_exact_mut(self.n.max(1)).zip(v) {
            let scaled = factor * a;
            row.iter_mut().zip(v).for_each(|(cell, b)| *cell += scaled * b);
        }
    }

    /// Adds `factor` times another of the same size.
    pub(super) fn add(&mut self, other: &Self, factor: f64) {
        self.cells.iter_mut().zip(&other.cells).for_each(|(a, b)| *a += factor * b);
    }

    pub(super) fn size(&self) -> usize {
        self.n
    }

    /// Adds a small matrix whose first diagonal cell comes to `first`.
    pub(super) fn add_block<const N: usize>(&mut self, first: usize, block: &[[f64; N]; N]) {
        for (i, row) in block.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                self.cells[(first + i) * self.n + first + j] += value;
            }
        }
    }

    pub(super) fn add_diagonal(&mut self, i: usize, value: f64) {
        self.cells[i * self.n + i] += value;
    }

    pub(super) fn times(&self, v: &[f64]) -> Vec<f64> {
        let dot = |row: &[f64]| row.iter().zip(v).map(|(a, b)| a * b).sum();
        self.cells.chunks_exact(self.n.max(1)).map(dot).collect()
    }

    /// v' M v.
    pub(super) fn form(&self, v: &[f64]) -> f64 {
        self.times(v).iter().zip(v).map(|(a, b)| a * b).sum()
    }

    /// Its inverse by Cholesky's factors after scaling to a unit diagonal; `None` if the scaled matrix is not positive
    /// definite by more than rounding.
    pub(super) fn inverse(&self) -> Option<Self> {
        let n = self.n;
        let scale: Vec<f64> = (0..n).map(|i| self.at(i, i).sqrt().recip()).collect();
        if scale.iter().any(|s| !s.is_finite()) {
            return None;
        }
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
                let rest = self.at(i, j) * scale[i] * scale[j] - known;
                l[i * n + j] = match i == j {
                    true if rest > 1e-11 => rest.sqrt(),
                    true => return None,
                    false => rest / l[j * n + j],
                };
            }
        }
        // Columns of the inverse of L, then L^-T L^-1.
        let mut m = vec![0.0; n * n];
        for j in 0..n {
            for i in j..n {
                let known: f64 = (j..i).map(|k| l[i * n + k] * m[k * n + j]).sum();
                m[i * n + j] = (f64::from(u8::from(i == j)) - known) / l[i * n + i];
            }
        }
        let mut out = Self::zero(n);
        for i in 0..n {
            for j in 0..n {
                let sum: f64 = (i.max(j)..n).map(|k| m[k * n + i] * m[k * n + j]).sum();
                out.cells[i * n + j] = sum * scale[i] * scale[j];
            }
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_times_its_inverse_is_one_and_a_singular_one_has_none() {
        let mut m = Symmetric::zero(3);
        for (v, f) in [([1e3, 2.0, 0.0], 1.0), ([0.0, 1.0, 4.0], 2.0), ([5e2, 0.0, 1.0], 0.5)] {
            assert!(m.inverse().is_none());
            m.add_outer(&v, f);
        }
        let inverse = m.inverse().unwrap();
        for j in 0..3 {
            let column: Vec<f64> = (0..3).map(|i| inverse.at(i, j)).collect();
            for (i, x) in m.times(&column).into_iter().enumerate() {
                assert!((x - f64::from(u8::from(i == j))).abs() < 1e-9);
            }
        }
    }
}
