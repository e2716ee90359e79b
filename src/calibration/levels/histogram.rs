//! Counts of whole values, and a centre and spread of them that outliers do not move.

use std::ops::Range;

/// Sites that lie further from the median than this many standard deviations do not count.
const OUTLIER: f64 = 5.0;

/// How often each whole value occurs.
#[derive(Clone, Debug)]
pub(super) struct Histogram {
    /// Value of the first count.
    base: i32,
    counts: Vec<u64>,
    /// First and one past the last count that is not 0: a sensor's values fill a small part of what they could be.
    filled: Range<usize>,
}

/// Robust figures of a [`Histogram`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Centre {
    pub(super) mean: f64,
    pub(super) variance: f64,
    /// Values that count.
    pub(super) count: u64,
}

impl Histogram {
    /// Empty, for values from `base` to `base + values - 1`.
    pub(super) fn new(base: i32, values: usize) -> Self {
        Self { base, counts: vec![0; values], filled: values..0 }
    }

    /// Counts a value; one outside the range is not counted.
    pub(super) fn add(&mut self, value: i32) {
        let at = usize::try_from(value - self.base).ok();
        if let Some(at) = at.filter(|at| *at < self.counts.len()) {
            self.counts[at] += 1;
            self.filled = self.filled.start.min(at)..self.filled.end.max(at + 1);
        }
    }

    /// Adds the counts of another of the same range.
    pub(super) fn merge(&mut self, other: &Histogram) {
        for at in other.filled.clone() {
            self.counts[at] += other.counts[at];
        }
        self.filled = self.filled.start.min(other.filled.start)..self.filled.end.max(other.filled.end);
    }

    /// Values with their counts, those that occur.
    pub(super) fn occurring(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let base = f64::from(self.base);
        self.filled
            .clone()
            .map(|i| (i, self.counts[i]))
            .filter(|(_, n)| *n > 0)
            .map(move |(i, n)| (base + i as f64, n))
    }

    /// The value below which a share of all lies, values taken as spread evenly over one unit.
    fn quantile(&self, share: f64) -> Option<f64> {
        let wanted = share * self.occurring().map(|(_, n)| n).sum::<u64>() as f64;
        let mut below = 0.0;
        for (value, n) in self.occurring() {
            let n = n as f64;
            if below + n >= wanted {
                return Some(value - 0.5 + (wanted - below) / n);
            }
            below += n;
        }
        None
    }

    /// Mean and variance of what lies within five standard deviations of the median; the first standard deviation is
    /// half the distance between the 16 % and the 84 % quantile. `None` of fewer than two values.
    pub(super) fn centre(&self) -> Option<Centre> {
        let median = self.quantile(0.5)?;
        let (low, high) = (self.quantile(0.158_655)?, self.quantile(0.841_345)?);
        let mut centre = Centre { mean: median, variance: (0.5 * (high - low)).powi(2), count: 0 };
        for _ in 0..3 {
            // Rounding alone spreads by half a unit.
            let (middle, reach) = (centre.mean, OUTLIER * centre.variance.sqrt().max(0.5));
            let within = || self.occurring().filter(move |(v, _)| (v - middle).abs() <= reach);
            let count: u64 = within().map(|(_, n)| n).sum();
            if count < 2 {
                return None;
            }
            let mean = within().map(|(v, n)| v * n as f64).sum::<f64>() / count as f64;
            let squares: f64 = within().map(|(v, n)| (v - mean).powi(2) * n as f64).sum();
            centre = Centre { mean, variance: squares / (count - 1) as f64, count };
        }
        Some(centre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_move_neither_mean_nor_variance() {
        let mut histogram = Histogram::new(-4, 20_000);
        // A binomial of 8 over the values 96 to 104: variance 2.
        for (value, n) in [1, 8, 28, 56, 70, 56, 28, 8, 1].into_iter().enumerate() {
            for _ in 0..n {
                histogram.add(96 + value as i32);
            }
        }
        let clean = histogram.centre().unwrap();
        assert!((clean.mean - 100.0).abs() < 1e-12 && (clean.variance - 2.0 * 256.0 / 255.0).abs() < 1e-9);
        histogram.add(15_000);
        histogram.add(15_001);
        histogram.add(-3);
        histogram.add(i32::from(u16::MAX));
        assert_eq!(histogram.centre(), Some(clean));
        assert_eq!(Histogram::new(0, 9).centre(), None);
    }

    #[test]
    fn one_value_has_no_spread() {
        let mut histogram = Histogram::new(0, 100);
        (0..50).for_each(|_| histogram.add(7));
        assert_eq!(histogram.centre(), Some(Centre { mean: 7.0, variance: 0.0, count: 50 }));
    }
}
