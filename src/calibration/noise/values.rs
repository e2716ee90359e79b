//! Values that the frames of one ISO have: where dark ones are cut off, and the steps between values.

use crate::calibration::histogram::{Centre, CutOff, Histogram, Steps, WHOLE_STEP};
use crate::photometry::Mosaic;

/// Values that a site can have.
const VALUES: usize = 1 << 16;

/// Counts of the values of all frames of one ISO, by filter position.
pub struct SensorValues {
    lit: [Histogram; 4],
    dark: [Histogram; 4],
}

impl Default for SensorValues {
    fn default() -> Self {
        let four = || std::array::from_fn(|_| Histogram::new(0, VALUES));
        Self { lit: four(), dark: four() }
    }
}

/// Where raws cut off what noise makes of no light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DarkCut {
    /// The lowest value there is, DN.
    pub dn: f64,
    /// Black by filter position, DN: the median of the dark sites, or `dn` if half of them lie there.
    pub black: [[f64; 2]; 2],
}

impl SensorValues {
    /// Adds a frame, lit evenly or dark.
    pub fn add(&mut self, frame: &Mosaic, dark: bool) {
        let sums = if dark { &mut self.dark } else { &mut self.lit };
        for (y, line) in frame.dn.pixels().chunks_exact(frame.dn.width().max(1)).enumerate() {
            for (x, &dn) in line.iter().enumerate() {
                sums[2 * (y & 1) + (x & 1)].add(dn.into());
            }
        }
    }

    /// Where dark frames are cut off at their lower end; `None` if they are not, or if there are none.
    pub fn cut_off(&self) -> Option<DarkCut> {
        let cuts: [Option<CutOff>; 4] = std::array::from_fn(|p| self.dark[p].cut_off());
        let dn = cuts.iter().flatten().map(|cut| cut.dn).reduce(f64::max)?;
        let whole = |p: usize| self.dark[p].centre().map_or(dn, |Centre { mean, .. }| mean);
        let black = |p: usize| cuts[p].map_or_else(|| whole(p), |cut| cut.centre.mean);
        Some(DarkCut { dn, black: [[black(0), black(1)], [black(2), black(3)]] })
    }

    /// Steps between values: root mean square of the positions' where signals are low, the largest where they are high. Of
    /// positions that do not tell theirs, whole DN.
    pub fn steps(&self) -> Steps {
        let steps = |p: usize| self.lit[p].steps().or_else(|| self.dark[p].steps()).unwrap_or(Steps::WHOLE);
        let of: [Steps; 4] = std::array::from_fn(steps);
        let low = (of.iter().map(|s| s.low * s.low).sum::<f64>() / 4.0).sqrt();
        let companded = of.iter().filter(|s| s.companded()).map(|s| s.high).reduce(f64::max);
        let low = if low > WHOLE_STEP { low } else { 1.0 };
        Steps { low, high: companded.unwrap_or(low).max(low) }
    }
}
