//! What rounding to whole DN does to means and variances.
//!
//! A value of normal noise s about m is rounded. The rounding error is a sawtooth of the value; by its Fourier series
//! (B. Widrow, I. Kollar, Quantization Noise, 2008, chapter 4), of which the first term tells nearly all,
//!
//! ```text
//! mean      = m - sin(2 pi m) exp(-2 pi^2 s^2) / pi
//! variance  = s^2 + 1/12 - cos(2 pi m) (4 s^2 + 1 / pi^2) exp(-2 pi^2 s^2)
//! ```
//!
//! so that from half a DN of noise up rounding is as good as independent noise of 1/12 DN^2.

use std::f64::consts::PI;

/// Variance that rounding adds to noise it does not know of, DN^2.
pub(super) const VARIANCE: f64 = 1.0 / 12.0;
/// Variance without light below which read noise is not told, DN^2 (EMVA 1288).
pub(super) const LEAST_FLOOR: f64 = 0.24;
/// Read noise that rounding can hide, DN: its bound where it is not told (EMVA 1288).
pub(super) const HIDDEN: f64 = 0.40;
/// Read noise below which rounding may shift it by more than some percent, DN.
pub(super) const COARSE: f64 = 0.5;

/// By how much, at most, rounding shifts the mean of values of this noise, DN.
pub(super) fn shift(noise: f64) -> f64 {
    (-2.0 * (PI * noise).powi(2)).exp() / PI
}

/// The same by the variance of the rounded values, rounding included, DN^2. Where that is mostly rounding, it does not tell
/// the noise, and all of half a DN is possible.
pub(super) fn shift_of(variance: f64) -> f64 {
    if variance < LEAST_FLOOR {
        return 0.5;
    }
    let square = variance - VARIANCE;
    shift((square - departure(square.sqrt())).max(0.0).sqrt())
}

/// By how much, at most, the variance of rounded values of this noise parts from `noise^2 + 1/12`, DN^2.
pub(super) fn departure(noise: f64) -> f64 {
    (4.0 * noise * noise + 1.0 / (PI * PI)) * (-2.0 * (PI * noise).powi(2)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and variance of rounded values, by the normal distribution's mass in fine slices.
    fn rounded(mean: f64, noise: f64) -> (f64, f64) {
        let (mut mass, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for slice in -16_000..16_000 {
            let z = (f64::from(slice) + 0.5) / 2000.0;
            let (weight, value) = ((-0.5 * z * z).exp(), (mean + noise * z).round());
            mass += weight;
            sum += weight * value;
            squares += weight * value * value;
        }
        (sum / mass, squares / mass - (sum / mass).powi(2))
    }

    #[test]
    fn no_phase_of_the_mean_parts_further_and_the_worst_comes_near() {
        for noise in [0.4, 0.5] {
            let (mut shifted, mut parted) = (0.0f64, 0.0f64);
            for phase in 0..40 {
                let mean = 2048.0 + f64::from(phase) / 40.0;
                let (found, variance) = rounded(mean, noise);
                shifted = shifted.max((found - mean).abs());
                assert!((found - mean).abs() <= shift_of(variance) + 2e-4, "{noise}: {found} for {mean}");
                parted = parted.max((variance - noise * noise - VARIANCE).abs());
            }
            let near = |found: f64, bound: f64| found <= 1.02 * bound + 2e-4 && found >= 0.9 * bound - 2e-4;
            assert!(near(shifted, shift(noise)), "{noise}: {shifted} against {}", shift(noise));
            assert!(near(parted, departure(noise)), "{noise}: {parted} against {}", departure(noise));
        }
        let (found, variance) = rounded(2048.45, 0.1);
        assert!((found - 2048.45).abs() <= shift_of(variance));
    }
}
