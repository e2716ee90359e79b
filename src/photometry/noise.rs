//! Sensor noise: variance = gain * signal + floor, in DN (shot noise and read noise; EMVA 1288).

use crate::photometry::{Cfa, Mosaic};
use crate::units::Iso;
use serde::{Deserialize, Serialize};

/// Sites per tile edge when measuring; even, so that every tile holds whole filter cells.
const TILE: usize = 16;

/// Variance of one sensor value as a function of its signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseModel {
    /// Variance per DN of signal (the inverse of electrons per DN), DN.
    #[serde(rename = "gain_dn")]
    pub gain: f32,
    /// Variance without light, DN^2.
    #[serde(rename = "floor_dn2")]
    pub floor: f32,
}

/// Too little to measure noise from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "noise could not be measured: no evenly lit, unclipped part in the frames; shoot a plain card in focus or slightly out of it"
)]
pub struct NoNoise;

impl NoiseModel {
    /// Variance in DN^2 of a site at `signal` DN above black.
    pub fn variance(&self, signal: f32) -> f32 {
        self.gain * signal.max(0.0) + self.floor
    }

    /// The model at another ISO of the same body, for want of a measurement: shot noise in DN goes with the ISO; read
    /// noise made before the amplifier does too, that made behind it stays. Which is which one ISO does not tell, so that
    /// the larger counts: variances are too large rather than too small.
    pub fn at_iso(self, measured: Iso, wanted: Iso) -> Self {
        let ratio = (wanted.0 / measured.0) as f32;
        Self { gain: self.gain * ratio, floor: self.floor * ratio.max(1.0).powi(2) }
    }

    /// Measures the model on frames of something plain (a card): in every small tile, same-colour neighbours
    /// differ by noise alone once the tile's gradient is taken out by second differences
    /// (x0 - 2 x1 + x2 has six times the variance of one site). Weighted straight line over all tiles.
    pub fn measure(frames: &[Mosaic]) -> Result<Self, NoNoise> {
        let mut points: Vec<(f64, f64)> = vec![];
        for frame in frames {
            for y in (0..frame.dn.height().saturating_sub(TILE)).step_by(TILE) {
                for x in (0..frame.dn.width().saturating_sub(TILE)).step_by(TILE) {
                    points.extend(tile(frame, x, y));
                }
            }
        }
        fit(&points).ok_or(NoNoise)
    }
}

/// Most tiles of one frame that a gauge takes.
const MOST_TILES: usize = 8192;

/// The same measurement from frames that come one by one, of which only figures are kept.
#[derive(Clone, Debug, Default)]
pub struct NoiseGauge {
    points: Vec<(f64, f64)>,
}

impl NoiseGauge {
    /// Takes in a frame of something plain; of large frames tiles that are spread over it.
    pub fn add(&mut self, frame: &Mosaic) {
        let (columns, rows) = (frame.dn.width() / TILE, frame.dn.height() / TILE);
        let every = (columns * rows).div_ceil(MOST_TILES).max(1);
        for place in (0..columns * rows).step_by(every) {
            self.points.extend(tile(frame, place % columns * TILE, place / columns * TILE));
        }
    }

    /// The model of all frames together.
    pub fn fit(&self) -> Result<NoiseModel, NoNoise> {
        fit(&self.points).ok_or(NoNoise)
    }
}

/// Mean signal and variance of each of the four filter positions of one tile.
fn tile(frame: &Mosaic, x0: usize, y0: usize) -> Vec<(f64, f64)> {
    let mut out = vec![];
    for (py, px) in Cfa::POSITIONS {
        let black = f64::from(frame.levels.black[py][px]);
        let top = black + 0.9 * (f64::from(frame.levels.saturation[py][px]) - black);
        let (mut sum, mut squares, mut n, mut count) = (0.0, 0.0, 0, 0);
        let mut clipped = false;
        for y in (y0 + py..y0 + TILE).step_by(2) {
            let row: Vec<f64> =
                (x0 + px..x0 + TILE).step_by(2).map(|x| f64::from(*frame.dn.at(x, y))).collect();
            clipped |= row.iter().any(|&v| v > top);
            sum += row.iter().map(|v| v - black).sum::<f64>();
            n += row.len();
            for w in row.windows(3) {
                squares += (w[0] - 2.0 * w[1] + w[2]).powi(2) / 6.0;
                count += 1;
            }
        }
        if !clipped && count > 0 {
            out.push((sum / n as f64, squares / f64::from(count)));
        }
    }
    out
}

/// Line variance = gain * signal + floor. The spread of a measured variance grows with itself, so each point
/// weighs by the inverse square of the present model; tiles with texture (far above the line) drop out.
fn fit(points: &[(f64, f64)]) -> Option<NoiseModel> {
    if points.len() < 8 {
        return None;
    }
    let mut variances: Vec<f64> = points.iter().map(|p| p.1).collect();
    variances.sort_by(f64::total_cmp);
    let (mut gain, mut floor) = (0.0, variances[variances.len() / 2].max(1e-3));
    for round in 0..12 {
        let (mut s, mut sx, mut sxx, mut sy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for &(x, y) in points {
            let model: f64 = gain * x + floor;
            if round > 3 && y > 2.0 * model {
                continue;
            }
            let w = 1.0 / (model * model);
            s += w;
            sx += w * x;
            sxx += w * x * x;
            sy += w * y;
            sxy += w * x * y;
        }
        let determinant = s * sxx - sx * sx;
        if determinant.is_nan() || determinant <= 1e-12 * s * sxx {
            // One signal level only: all of it is shot noise, as far as can be told.
            let mean = sx / s;
            return (mean > 0.0).then(|| NoiseModel { gain: (sy / s / mean) as f32, floor: 0.25 });
        }
        gain = ((s * sxy - sx * sy) / determinant).max(0.0);
        // A quarter DN^2 is the least: rounding to whole DN alone leaves a twelfth.
        floor = ((sxx * sy - sx * sxy) / determinant).max(0.25);
        if gain == 0.0 {
            floor = (sy / s).max(0.25);
        }
    }
    (gain.is_finite() && floor.is_finite()).then_some(NoiseModel { gain: gain as f32, floor: floor as f32 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::isolate::tests::mosaic;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn gain_and_floor_of_a_simulated_sensor_come_back() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let (gain, floor) = (0.3, 2.4);
        let frames: Vec<Mosaic> = [0.0, 300.0, 1500.0, 6000.0]
            .into_iter()
            .map(|level| {
                mosaic(256, 192, |x, _| {
                    let signal: f64 = level * (1.0 + x as f64 / 256.0);
                    let sd = (gain * signal + floor).sqrt();
                    (2001.5 + Normal::new(signal, sd).unwrap().sample(&mut rng)).round() as u16
                })
            })
            .collect();
        let model = NoiseModel::measure(&frames).unwrap();
        assert!((model.gain - 0.3).abs() < 0.01, "{model:?}");
        assert!((model.floor - 2.4).abs() < 0.5, "{model:?}");
        let mut gauge = NoiseGauge::default();
        frames.iter().for_each(|frame| gauge.add(frame));
        let gauged = gauge.fit().unwrap();
        assert!((gauged.gain - 0.3).abs() < 0.01 && (gauged.floor - 2.4).abs() < 0.5, "{gauged:?}");
    }

    #[test]
    fn at_another_iso_variances_are_never_too_small() {
        // 2 electrons before the amplifier, 3 DN behind it; 5 electrons per DN at ISO 100.
        let truth = |iso: f32| {
            let gain = iso / 500.0;
            NoiseModel { gain, floor: (2.0 * gain).powi(2) + 9.0 }
        };
        for iso in [50.0f32, 100.0, 125.0, 1600.0] {
            let (scaled, wanted) = (truth(100.0).at_iso(Iso(100.0), Iso(iso.into())), truth(iso));
            assert!((scaled.gain / wanted.gain - 1.0).abs() < 1e-6);
            assert!(scaled.floor >= wanted.floor * 0.9999, "{iso}: {scaled:?} for {wanted:?}");
        }
        assert_eq!(truth(100.0).at_iso(Iso(100.0), Iso(100.0)), truth(100.0));
    }

    #[test]
    fn a_blown_frame_says_that_nothing_can_be_measured() {
        assert_eq!(NoiseModel::measure(&[mosaic(64, 64, |_, _| 15000)]), Err(NoNoise));
    }
}
