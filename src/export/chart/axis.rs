//! A chart's axis: where a value stands, and the round values that are written beside it.

/// An axis from one end of a picture to the other.
pub(super) struct Axis {
    low: f64,
    high: f64,
    logarithmic: bool,
    /// Places of `low` and `high` in the picture.
    ends: [f64; 2],
}

impl Axis {
    /// An axis over all these values, with a little air. On a logarithmic one, what is not above 0 does not count.
    pub(super) fn over(values: impl Iterator<Item = f64>, logarithmic: bool, ends: [f64; 2]) -> Self {
        let (low, high) = match logarithmic {
            true => range(values.filter(|v| *v > 0.0).map(f64::log10)),
            false => range(values),
        };
        Self { low, high, logarithmic, ends }
    }

    /// Where a value stands; `None` if the axis has no place for it.
    pub(super) fn at(&self, value: f64) -> Option<f64> {
        let value = match self.logarithmic {
            true if value > 0.0 => value.log10(),
            true => return None,
            false => value,
        };
        let share = (value - self.low) / (self.high - self.low);
        let [from, to] = self.ends;
        share.is_finite().then_some(from + share * (to - from))
    }

    /// The same, or the axis's lower end for what lies below it.
    pub(super) fn at_or_low(&self, value: f64) -> Option<f64> {
        let place = if self.logarithmic { value.max(0.0).log10() } else { value };
        if place <= self.low { Some(self.ends[0]) } else { self.at(value) }
    }

    /// Round values along the axis, as they are written.
    pub(super) fn ticks(&self) -> Vec<(f64, String)> {
        if self.logarithmic && self.high - self.low > 1.2 {
            return decades(self.low, self.high);
        }
        // A logarithmic axis of about a decade has the round values of a straight one.
        let ends = [self.low, self.high];
        let [low, high] = if self.logarithmic { ends.map(|end| 10f64.powf(end)) } else { ends };
        let (values, decimals) = ticks(low, high);
        values.into_iter().map(|v| (v, format!("{v:.decimals$}"))).collect()
    }
}

/// Lowest and highest of some values, a little apart even if they are equal.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let air = (0.06 * (high - low)).max(1e-9 * high.abs()).max(1e-12);
    (low - air, high + air)
}

/// Round values across a range, four to eight of them, with their decimals.
fn ticks(low: f64, high: f64) -> (Vec<f64>, usize) {
    let span = (high - low).max(1e-12);
    let power = 10f64.powf((span / 5.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| span / s <= 7.0);
    let step = step.unwrap_or(10.0 * power);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    // Adding 0 makes of -0 a 0.
    ((first..=last).map(|k| k as f64 * step + 0.0).collect(), decimals)
}

/// Powers of ten between two of their logarithms, and twice and five times those where they are few.
fn decades(low: f64, high: f64) -> Vec<(f64, String)> {
    let factors: &[f64] = if high - low < 3.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let powers = low.floor() as i32..=high.ceil() as i32;
    let values = powers.flat_map(|p| factors.iter().map(move |f| (f * 10f64.powi(p), p)));
    values
        .filter(|(v, _)| (low..=high).contains(&v.log10()))
        .map(|(v, p)| (v, format!("{v:.*}", (-p).max(0) as usize)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(ticks(0.0, 10.0), (vec![0.0, 2.0, 4.0, 6.0, 8.0, 10.0], 0));
        let (values, decimals) = ticks(0.9941, 1.0062);
        assert_eq!(decimals, 3);
        assert!((4..=8).contains(&values.len()), "{values:?}");
        assert!(values.iter().all(|v| (v * 500.0 - (v * 500.0).round()).abs() < 1e-6), "{values:?}");
    }

    #[test]
    fn a_logarithmic_axis_has_decades_and_no_place_for_zero() {
        let axis = Axis::over([2.0, 0.0, -5.0, 9000.0].into_iter(), true, [0.0, 100.0]);
        let words: Vec<String> = axis.ticks().into_iter().map(|(_, word)| word).collect();
        assert_eq!(words, ["10", "100", "1000", "10000"]);
        assert_eq!((axis.at(0.0), axis.at_or_low(0.0)), (None, Some(0.0)));
        let (ten, hundred, thousand) = (axis.at(10.0), axis.at(100.0), axis.at(1000.0));
        let step = |a: Option<f64>, b: Option<f64>| b.unwrap() - a.unwrap();
        assert!((step(ten, hundred) - step(hundred, thousand)).abs() < 1e-9);
        let short = Axis::over([0.2, 0.9].into_iter(), true, [0.0, 100.0]);
        assert!(short.ticks().len() >= 3, "{:?}", short.ticks());
        let two = Axis::over([0.3, 60.0].into_iter(), true, [0.0, 1.0]);
        let words: Vec<String> = two.ticks().into_iter().map(|(_, word)| word).collect();
        assert_eq!(words, ["0.5", "1", "2", "5", "10", "20", "50"]);
    }
}
