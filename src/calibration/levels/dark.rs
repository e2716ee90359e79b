//! What dark frames amount to, never more than two of them held.

use super::histogram::{Centre, Histogram};
use super::sums::{Four, VALUES, four};
use crate::calibration::rounding;
use crate::calibration::statistics::{Z95, t_975};
use crate::raster::Image;

/// Standard deviations above the median from which a site is hot: of pure noise, not one in 10^15 sites.
const HOT: f64 = 8.0;

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
    /// Least value of every site.
    lowest: Image<u16>,
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
            lowest: frame.clone(),
            held: None,
            pairs: 0,
            differences: four(-(VALUES as i32), 2 * VALUES),
        }
    }

    pub(super) fn size(&self) -> (usize, usize) {
        (self.lowest.width(), self.lowest.height())
    }

    pub(super) fn frames(&self) -> usize {
        self.means.len()
    }

    pub(super) fn values(&self) -> &[Histogram; 4] {
        &self.values
    }

    pub(super) fn centres(&self) -> [Option<Centre>; 4] {
        std::array::from_fn(|position| self.values[position].centre())
    }

    pub(super) fn add(&mut self, frame: &Image<u16>, values: &Four, means: [f64; 4]) {
        self.means.push(means);
        for (sums, values) in self.values.iter_mut().zip(values) {
            sums.merge(values);
        }
        for (lowest, &dn) in self.lowest.pixels_mut().iter_mut().zip(frame.pixels()) {
            *lowest = dn.min(*lowest);
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
    /// quantile is theirs. Rounding may shift the mean where there is little noise.
    pub(super) fn black(&self, position: usize, centre: Centre) -> Known {
        let of_sites = centre.variance / centre.count as f64;
        let n = self.frames() as f64;
        let mean = self.means.iter().map(|m| m[position]).sum::<f64>() / n;
        let squares: f64 = self.means.iter().map(|m| (m[position] - mean).powi(2)).sum();
        let (excess, quantile) = match self.frames() {
            0 | 1 => (0.0, 0.0),
            _ => ((squares / (n - 1.0) / n - of_sites).max(0.0), t_975(n - 1.0)),
        };
        let shift = rounding::shift_of(centre.variance);
        let reach = (Z95 * Z95 * of_sites + quantile * quantile * excess).sqrt() + shift;
        Known {
            value: centre.mean,
            error: (of_sites + excess + shift * shift).sqrt(),
            interval: [centre.mean - reach, centre.mean + reach],
        }
    }

    /// Read noise of one frame; `None` without a pair of frames.
    pub(super) fn read_noise(&self, position: usize) -> Option<ReadNoise> {
        if self.pairs == 0 {
            return None;
        }
        let centre = self.differences[position].centre()?;
        let floor = 0.5 * centre.variance;
        let square = floor - rounding::VARIANCE;
        let error = floor * (2.0 / (centre.count as f64 - 1.0).max(1.0)).sqrt();
        if floor < rounding::LEAST_FLOOR {
            let bound = (square + Z95 * error).max(rounding::HIDDEN.powi(2)).sqrt();
            return Some(ReadNoise::Below(bound));
        }
        let value = square.sqrt();
        let departure = rounding::departure(value);
        let reach = Z95 * error + departure;
        let interval = [square - reach, square + reach].map(|square| square.max(0.0).sqrt());
        Some(ReadNoise::Told(Known { value, error: 0.5 * error.hypot(departure) / value, interval }))
    }

    /// Sites that are hot in every frame.
    pub(super) fn hot(&self, centres: &[Option<Centre>; 4]) -> u64 {
        let limits = centres.map(|c| c.map_or(f64::INFINITY, |c| c.mean + HOT * c.variance.sqrt().max(0.5)));
        let mut hot = 0;
        for (y, line) in self.lowest.pixels().chunks_exact(self.lowest.width().max(1)).enumerate() {
            for (x, &dn) in line.iter().enumerate() {
                hot += u64::from(f64::from(dn) > limits[2 * (y & 1) + (x & 1)]);
            }
        }
        hot
    }
}
