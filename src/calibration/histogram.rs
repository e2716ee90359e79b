//! Counts of whole values: a centre and spread of them that outliers do not move, where they are cut off, and their steps.
//!
//! Some bodies take black off themselves and cut what falls below 0 DN: of a dark frame's noise one half is left. Its mean
//! is then above black and its variance too small. The upper half still tells black (the median, as long as fewer than half
//! of the sites are cut off) and the spread (from there to the 84 % quantile), by which it is known how much would lie
//! below the lowest value: where that is not there, it was cut off.

use std::ops::Range;

/// Steps between values up to which they are whole DN.
pub(super) const WHOLE_STEP: f64 = 1.02;

/// Sites that lie further from the median than this many standard deviations do not count.
const OUTLIER: f64 = 5.0;

/// Share of values up to which the lowest ones are strays: dead sites read 0 DN on any body. Neighbours of which one occurs
/// so much more rarely than the other tell no step.
const STRAY: f64 = 1e-3;
/// Standard deviations from black to 0 DN within which more than 0.5 % of the sites would lie below 0 DN.
const NEAR: f64 = 2.575_8;
/// Least count in a pile above 0 DN, and how many standard errors it stands above its neighbour.
const PILE: u64 = 30;
const SURE: f64 = 4.0;
/// Least share beyond a pile's neighbour, hot sites aside: with less noise than that, rounding piles values up, too.
const BEYOND: f64 = 0.005;
/// Least count of two neighbouring values between which nothing else can occur.
const DENSE: u64 = 16;
/// A gap this many times wider than the middle one lies between two levels of light, or before the clipped sites.
const HOLE: i32 = 3;
/// Steps that grow by this factor with the signal are companded.
const GROWS: f64 = 1.5;
/// Gaps from which their growth can be told.
const MANY: usize = 8;

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

/// Values that are cut off at their lower end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CutOff {
    /// Where.
    pub(super) dn: f64,
    /// Share of all values that lie there.
    pub(super) share: f64,
    /// The median, and the spread above it; the value of the cut and the spread above that, if half of all values lie there.
    pub(super) centre: Centre,
}

impl CutOff {
    /// Whether half of all values lie there, so that black is that value, or below it.
    pub(super) fn hides_black(self) -> bool {
        self.share >= 0.5
    }
}

/// Distances between values that occur, DN: 1 unless the raws were scaled up or companded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Where signals are low; everywhere, if the steps are uniform.
    pub low: f64,
    /// Where they are high.
    pub high: f64,
}

impl Steps {
    /// Every whole value occurs.
    pub const WHOLE: Self = Self { low: 1.0, high: 1.0 };

    /// Whether steps grow with the signal.
    pub fn companded(self) -> bool {
        self.high > self.low
    }
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

    /// Distance between values where signals are low, DN; 1 if nothing tells another.
    fn step(&self) -> f64 {
        self.steps().map(|steps| steps.low).filter(|low| *low > WHOLE_STEP).unwrap_or(1.0)
    }

    /// The value below which a share of all lies, values taken as spread evenly over one step.
    fn quantile(&self, share: f64) -> Option<f64> {
        let wanted = share * self.occurring().map(|(_, n)| n).sum::<u64>() as f64;
        let (mut below, step) = (0.0, self.step());
        for (value, n) in self.occurring() {
            let n = n as f64;
            if below + n >= wanted {
                return Some(value + step * ((wanted - below) / n - 0.5));
            }
            below += n;
        }
        None
    }

    /// Where the values of a dark frame are cut off at their lower end; `None` if they are not.
    pub(super) fn cut_off(&self) -> Option<CutOff> {
        let total = self.occurring().map(|(_, n)| n).sum::<u64>() as f64;
        let (mut below, mut values) = (0.0, self.occurring());
        let (dn, count) = values.find(|(_, n)| {
            below += *n as f64;
            below >= STRAY * total
        })?;
        let share = below / total;
        let (median, high) = (self.quantile(0.5)?, self.quantile(0.841_345)?);
        let middle = if share >= 0.5 { dn } else { median };
        let spread = high - middle;
        let cut = if dn == 0.0 {
            share >= 0.5 || median + 0.5 * self.step() < NEAR * spread
        } else {
            let next = values.next().map_or(0, |(_, n)| n);
            let reach = middle + OUTLIER * spread;
            let beyond: u64 = values.take_while(|(v, _)| *v <= reach).map(|(_, n)| n).sum();
            let sure = (count as f64 - next as f64) > SURE * ((count + next) as f64).sqrt();
            count >= PILE && sure && beyond as f64 >= BEYOND * total
        };
        let centre = Centre { mean: middle, variance: spread * spread, count: total as u64 };
        cut.then_some(CutOff { dn, share, centre })
    }

    /// The steps between values; `None` if too few occur often enough to tell.
    pub(super) fn steps(&self) -> Option<Steps> {
        let values: Vec<(f64, u64)> = self.occurring().collect();
        let dense = values.windows(2).filter(|two| {
            let (few, many) = (two[0].1.min(two[1].1), two[0].1.max(two[1].1));
            few >= DENSE && few as f64 >= STRAY * many as f64
        });
        let gaps: Vec<i32> = dense.map(|two| (two[1].0 - two[0].0) as i32).collect();
        let mean = |gaps: &[i32]| {
            let mut sorted = gaps.to_vec();
            sorted.sort_unstable();
            let limit = HOLE * sorted.get(sorted.len().saturating_sub(1) / 2)?;
            let kept: Vec<i32> = sorted.into_iter().filter(|gap| *gap <= limit).collect();
            Some(f64::from(kept.iter().sum::<i32>()) / kept.len() as f64)
        };
        let all = mean(&gaps)?;
        let quarter = gaps.len() / 4;
        if gaps.len() >= MANY {
            let (low, high) = (mean(&gaps[..quarter])?, mean(&gaps[gaps.len() - quarter..])?);
            if high >= GROWS * low {
                return Some(Steps { low, high });
            }
        }
        Some(Steps { low: all, high: all })
    }

    /// Mean and variance of what lies within five standard deviations of the median; the first standard deviation is
    /// half the distance between the 16 % and the 84 % quantile. `None` of fewer than two values.
    pub(super) fn centre(&self) -> Option<Centre> {
        let (median, step) = (self.quantile(0.5)?, self.step());
        let (low, high) = (self.quantile(0.158_655)?, self.quantile(0.841_345)?);
        let mut centre = Centre { mean: median, variance: (0.5 * (high - low)).powi(2), count: 0 };
        for _ in 0..3 {
            // Rounding alone spreads by half a step.
            let (middle, reach) = (centre.mean, OUTLIER * centre.variance.sqrt().max(0.5 * step));
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
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

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

    fn of(values: impl Iterator<Item = f64>) -> Histogram {
        let mut histogram = Histogram::new(0, 20_000);
        values.for_each(|value| histogram.add(value as i32));
        histogram
    }

    fn normal(seed: u64, mean: f64, noise: f64) -> impl Iterator<Item = f64> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(mean, noise).unwrap();
        std::iter::repeat_with(move || normal.sample(&mut random)).take(40_000)
    }

    #[test]
    fn half_a_normal_is_told_from_a_whole_one() {
        for (seed, noise) in [0.6, 1.0, 3.0, 10.0].into_iter().enumerate() {
            for floor in [0.0, 512.0] {
                let name = format!("noise {noise}, floor {floor}");
                let half = of(normal(seed as u64, floor, noise).map(|v| v.round().max(floor))).cut_off();
                let half = half.unwrap_or_else(|| panic!("{name}"));
                assert!(half.dn == floor && half.hides_black(), "{name}: {half:?}");
                // Rounding leaves little to tell the smallest by.
                let spread = half.centre.variance.sqrt();
                assert!((spread / noise - 1.0).abs() < 0.03 || noise < 2.0, "{name}: {spread}");
            }
            let above = of(normal(seed as u64, noise, noise).map(|v| v.round().max(0.0))).cut_off();
            let above = above.unwrap_or_else(|| panic!("noise {noise}"));
            assert!(!above.hides_black() && above.dn == 0.0, "{above:?}");
            let whole = of(normal(seed as u64, 6.0 * noise, noise).map(f64::round));
            assert_eq!(whole.cut_off(), None, "noise {noise}");
        }
        // Rounding piles up what has hardly any noise, and dead sites read 0 DN.
        for (seed, (mean, noise)) in
            [(512.3, 0.2), (512.45, 0.3), (512.0, 0.05), (512.2, 0.4)].into_iter().enumerate()
        {
            let dead = std::iter::repeat_n(0.0, 20);
            let quiet = of(normal(seed as u64, mean, noise).map(f64::round).chain(dead));
            assert_eq!(quiet.cut_off(), None, "{mean}, {noise}");
            assert!(quiet.steps().is_none_or(|steps| steps == Steps::WHOLE), "{mean}, {noise}");
        }
    }

    #[test]
    fn warm_sites_are_no_noise_beyond_a_pile() {
        // 0.6 % of the sites, on average 30 DN above the others.
        let warm = |mean: f64| (0..240).map(move |k| mean - 30.0 * ((f64::from(k) + 0.5) / 240.0).ln());
        for (seed, (mean, noise)) in [(512.45, 0.3), (512.3, 0.2), (512.0, 0.05)].into_iter().enumerate() {
            let quiet = of(normal(seed as u64, mean, noise).chain(warm(mean)).map(f64::round));
            assert_eq!(quiet.cut_off(), None, "{mean}, {noise}");
        }
        for noise in [1.0, 3.0, 10.0] {
            let half = normal(7, 512.0, noise).map(|v| v.round().max(512.0)).chain(warm(512.0));
            let half = of(half).cut_off().unwrap_or_else(|| panic!("noise {noise}"));
            assert!(half.dn == 512.0 && half.hides_black(), "{half:?}");
        }
    }

    #[test]
    fn black_of_values_that_are_cut_off_and_have_steps_is_told() {
        let raws = [
            (0.0, 6.0, 6.0),
            (0.0, 5.0, 6.0),
            (0.0, 7.0, 6.0),
            (0.0, 12.0, 8.0),
            (512.0, 8.0, 10.0),
            (512.0, 3.5, 9.0),
        ];
        for (seed, (floor, black, noise)) in raws.into_iter().enumerate() {
            let stepped = |v: f64| floor + 4.0 * (v / 4.0).round().max(0.0);
            let cut = of(normal(seed as u64, black, noise).map(stepped)).cut_off();
            let CutOff { dn, centre, .. } = cut.unwrap_or_else(|| panic!("{floor}, {black}, {noise}"));
            let spread = centre.variance.sqrt();
            assert!(
                dn == floor && (centre.mean - floor - black).abs() < 0.25,
                "{black}, {noise}: {centre:?}"
            );
            assert!((spread / noise - 1.0).abs() < 0.1, "{black}, {noise}: {spread}");
        }
    }

    #[test]
    fn steps_are_told_and_companding_from_scaling() {
        assert_eq!(of(normal(1, 900.0, 20.0).map(f64::round)).steps(), Some(Steps::WHOLE));
        let by_four = of(normal(2, 900.0, 6.0).map(|v| 4.0 * (v / 4.0).round()));
        assert_eq!(by_four.steps(), Some(Steps { low: 4.0, high: 4.0 }));
        let stretched =
            of(normal(3, 900.0, 60.0).map(|v| (1.37 * (v / 1.37).round()).round())).steps().unwrap();
        assert!((stretched.low - 1.37).abs() < 0.03 && !stretched.companded(), "{stretched:?}");
        // A square root beyond 100 DN, from dark to bright.
        let root =
            |v: f64| if v < 100.0 { v.round() } else { ((v.sqrt() * 20.0).round() / 20.0).powi(2).round() };
        let bright = (0..400_000).map(|k| f64::from(k) / 40.0);
        let companded = of(bright.map(root)).steps().unwrap();
        assert!(companded.companded() && companded.low < 4.0 && companded.high > 7.0, "{companded:?}");
        assert_eq!(of([5.0, 9.0].into_iter()).steps(), None);
    }

    #[test]
    fn one_value_has_no_spread() {
        let mut histogram = Histogram::new(0, 100);
        (0..50).for_each(|_| histogram.add(7));
        assert_eq!(histogram.centre(), Some(Centre { mean: 7.0, variance: 0.0, count: 50 }));
    }
}
