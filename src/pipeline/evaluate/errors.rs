//! Figures of a pool of errors.

use serde::{Deserialize, Serialize};

/// Errors of reflectance (unit-free, 1 is a perfect white), channels pooled.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Values pooled: pixels or blocks times three channels.
    pub count: usize,
    /// Mean of estimate - truth.
    pub mean: f64,
    /// Standard deviation about that mean.
    pub standard_deviation: f64,
    /// Mean of |estimate - truth|.
    pub mean_absolute: f64,
    /// 95 of 100 values of |estimate - truth| are no larger (nearest rank).
    pub percentile_95: f64,
}

/// Collects errors.
#[derive(Default)]
pub(super) struct Pool(Vec<f32>);

impl Pool {
    pub(super) fn extend(&mut self, errors: impl IntoIterator<Item = [f32; 3]>) {
        self.0.extend(errors.into_iter().flatten());
    }

    pub(super) fn merge(&mut self, other: Pool) {
        self.0.extend(other.0);
    }

    /// The figures; `None` of an empty pool.
    pub(super) fn errors(&self) -> Option<Errors> {
        let count = self.0.len();
        if count == 0 {
            return None;
        }
        let n = count as f64;
        let mean = self.0.iter().map(|&e| f64::from(e)).sum::<f64>() / n;
        let variance = self.0.iter().map(|&e| (f64::from(e) - mean).powi(2)).sum::<f64>() / n;
        let mut sizes: Vec<f32> = self.0.iter().map(|e| e.abs()).collect();
        let mean_absolute = sizes.iter().map(|&e| f64::from(e)).sum::<f64>() / n;
        let rank = (0.95 * n).ceil() as usize;
        let (_, percentile, _) = sizes.select_nth_unstable_by(rank.clamp(1, count) - 1, f32::total_cmp);
        Some(Errors {
            count,
            mean,
            standard_deviation: variance.sqrt(),
            mean_absolute,
            percentile_95: f64::from(*percentile),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_pool() {
        let mut pool = Pool::default();
        assert!(pool.errors().is_none());
        pool.extend((1..=33).map(|i| [i as f32, -(i as f32), 0.0]));
        pool.extend([[34.0, 34.0, 34.0]]);
        let errors = pool.errors().unwrap();
        assert_eq!(errors.count, 102);
        assert!((errors.mean - 1.0).abs() < 1e-12);
        let squares = 2.0 * (1..=33).map(|i| f64::from(i * i)).sum::<f64>() + 3.0 * 34.0 * 34.0;
        assert!((errors.standard_deviation - (squares / 102.0 - 1.0).sqrt()).abs() < 1e-9);
        assert!((errors.mean_absolute - (2.0 * 561.0 + 102.0) / 102.0).abs() < 1e-9);
        // The 97th of 102: 33 zeros, then the ones, twos, ... in pairs.
        assert_eq!(errors.percentile_95, 32.0);
    }
}
