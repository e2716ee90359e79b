//! What dark frames amount to. One of them is held at most, until its partner comes; of the others only counts, and the
//! sites that may be hot.

use super::sums::{Four, VALUES, four};
use crate::calibration::histogram::{Centre, CutOff, Histogram, Steps};
use crate::calibration::rounding;
use crate::calibration::statistics::{Z95, t_975};
use crate::raster::Image;
use std::f64::consts::FRAC_PI_2;

/// Standard deviations above the median from which a site is hot: of pure noise, not one in 10^15 sites.
const HOT: f64 = 8.0;
/// The same for a site of the first frame to be looked at in the others.
const WARM: f64 = 6.0;
/// Most that a median of whole values may miss that of the values before rounding by, times their variance.
const MEDIAN: f64 = 0.1;

/// A figure with its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Known {
    pub(super) value: f64,
    /// Standard error.
    pub(super) error: f64,
    /// Ends of the 95 % interval.
    pub(super) interval: [f64; 2],
}

/// Read noise of one frame, DN.
pub(super) enum ReadNoise {
    Told(Known),
    /// Hidden by rounding, and no more than this.
    Below(f64),
}

/// Sums over dark frames.
pub(super) struct Dark {
    values: Four,
    /// Each frame's own means.
    means: Vec<[f64; 4]>,
    size: (usize, usize),
    /// Sites that may be hot: place, filter position and least value.
    warm: Vec<(usize, usize, u16)>,
    /// A frame that waits for its partner.
    held: Option<Image<u16>>,
    pairs: usize,
    differences: Four,
}

impl Dark {
    /// Nothing yet, for frames of the size of this one.
    pub(super) fn new(frame: &Image<u16>) -> Self {
        Self {
            values: four(0, VALUES),
            means: vec![],
            size: (frame.width(), frame.height()),
            warm: vec![],
            held: None,
            pairs: 0,
            differences: four(-(VALUES as i32), 2 * VALUES),
        }
    }

    pub(super) fn size(&self) -> (usize, usize) {
        self.size
    }

    pub(super) fn frames(&self) -> usize {
        self.means.len()
    }

    pub(super) fn values(&self) -> &[Histogram; 4] {
        &self.values
    }

    /// Where each position's values are cut off at their lower end.
    pub(super) fn cut_offs(&self) -> [Option<CutOff>; 4] {
        std::array::from_fn(|position| self.values[position].cut_off())
    }

    pub(super) fn centres(&self) -> [Option<Centre>; 4] {
        let cuts = self.cut_offs();
        std::array::from_fn(|p| cuts[p].map(|cut| cut.centre).or_else(|| self.values[p].centre()))
    }

    /// Steps between the values of a position.
    pub(super) fn steps(&self, position: usize) -> Steps {
        self.values[position].steps().unwrap_or(Steps::WHOLE)
    }

    /// Lets go of a frame that waits for its partner: no other is expected.
    pub(super) fn let_go(&mut self) {
        self.held = None;
    }

    pub(super) fn add(&mut self, frame: &Image<u16>, values: &Four, means: [f64; 4]) {
        let first = self.means.is_empty();
        self.means.push(means);
        for (sums, values) in self.values.iter_mut().zip(values) {
            sums.merge(values);
        }
        if first {
            let limits = limits(&self.centres(), WARM);
            let width = frame.width().max(1);
            let sites = frame.pixels().iter().enumerate().map(|(at, &dn)| {
                let position = 2 * ((at / width) & 1) + ((at % width) & 1);
                (at, position, dn)
            });
            self.warm = sites.filter(|&(_, position, dn)| f64::from(dn) > limits[position]).collect();
        }
        for (at, _, lowest) in &mut self.warm {
            *lowest = frame.pixels()[*at].min(*lowest);
        }
        let Some(first) = self.held.take() else {
            self.held = Some(frame.clone());
            return;
        };
        self.pairs += 1;
        let width = frame.width().max(1);
        let lines = first.pixels().chunks_exact(width).zip(frame.pixels().chunks_exact(width));
        for (y, (first, second)) in lines.enumerate() {
            for (x, (&a, &b)) in first.iter().zip(second).enumerate() {
                self.differences[2 * (y & 1) + (x & 1)].add(i32::from(a) - i32::from(b));
            }
        }
    }

    /// Black. Sites scatter, and whole frames may scatter beyond that (`excess`), which their few means tell: Student's
    /// quantile is theirs. Rounding may shift the mean where there is little noise. `cut`: the centre is a median, of values
    /// that are cut off below it.
    pub(super) fn black(&self, position: usize, centre: Centre, cut: bool) -> Known {
        let step = self.steps(position).low;
        let of_median = if cut { FRAC_PI_2 } else { 1.0 };
        let of_sites = of_median * centre.variance / centre.count as f64;
        let n = self.frames() as f64;
        let mean = self.means.iter().map(|m| m[position]).sum::<f64>() / n;
        let squares: f64 = self.means.iter().map(|m| (m[position] - mean).powi(2)).sum();
        let (excess, quantile) = match self.frames() {
            0 | 1 => (0.0, 0.0),
            _ => ((squares / (n - 1.0) / n - of_sites).max(0.0), t_975(n - 1.0)),
        };
        let variance = centre.variance / (step * step);
        let shift = step * if cut { (MEDIAN / variance).min(0.5) } else { rounding::shift_of(variance) };
        let reach = (Z95 * Z95 * of_sites + quantile * quantile * excess).sqrt() + shift;
        Known {
            value: centre.mean,
            error: (of_sites + excess + shift * shift).sqrt(),
            interval: [centre.mean - reach, centre.mean + reach],
        }
    }

    /// Read noise of one frame; `None` without a pair of frames, and of values that are cut off: of their noise one half is
    /// left.
    pub(super) fn read_noise(&self, position: usize) -> Option<ReadNoise> {
        if self.pairs == 0 || self.values[position].cut_off().is_some() {
            return None;
        }
        let centre = self.differences[position].centre()?;
        // In steps, for rounding is to whole steps.
        let step = self.steps(position).low;
        let floor = 0.5 * centre.variance / (step * step);
        let square = floor - rounding::VARIANCE;
        let error = floor * (2.0 / (centre.count as f64 - 1.0).max(1.0)).sqrt();
        if floor < rounding::LEAST_FLOOR {
            let bound = (square + Z95 * error).max(rounding::HIDDEN.powi(2)).sqrt();
            return Some(ReadNoise::Below(step * bound));
        }
        let value = square.sqrt();
        let departure = rounding::departure(value);
        let reach = Z95 * error + departure;
        let interval = [square - reach, square + reach].map(|square| step * square.max(0.0).sqrt());
        let error = step * 0.5 * error.hypot(departure) / value;
        Some(ReadNoise::Told(Known { value: step * value, error, interval }))
    }

    /// Sites that are hot in every frame.
    pub(super) fn hot(&self, centres: &[Option<Centre>; 4]) -> u64 {
        let limits = limits(centres, HOT);
        self.warm.iter().filter(|(_, position, lowest)| f64::from(*lowest) > limits[*position]).count() as u64
    }
}

/// What lies so many standard deviations above each position's centre, DN.
fn limits(centres: &[Option<Centre>; 4], deviations: f64) -> [f64; 4] {
    centres.map(|c| c.map_or(f64::INFINITY, |c| c.mean + deviations * c.variance.sqrt().max(0.5)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn black_of_raws_that_are_cut_off_and_have_steps_lies_in_its_interval() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(79);
        for (black, noise) in [(6.0f64, 6.0), (5.0, 6.0), (12.0, 8.0)] {
            let normal = Normal::new(black, noise).unwrap();
            let mut step =
                |_: usize, _: usize| 4 * (normal.sample(&mut random) / 4.0).round().max(0.0) as u16;
            let frame = Image::from_fn(160, 120, &mut step);
            let mut values = four(0, VALUES);
            frame.pixels().iter().for_each(|&dn| values[0].add(dn.into()));
            let mut dark = Dark::new(&frame);
            dark.add(&frame, &values, [black; 4]);
            let known = dark.black(0, dark.centres()[0].unwrap(), dark.cut_offs()[0].is_some());
            let [low, high] = known.interval;
            assert!(dark.cut_offs()[0].is_some() && dark.steps(0).low == 4.0, "{black}, {noise}");
            assert!(low < black && black < high && high - low < 1.0, "{black}, {noise}: {known:?}");
        }
    }
}
