//! The energy of one pulse against the reference energy, and the known light freed of it.

use super::Known;
use serde::{Deserialize, Serialize};

/// Energy of a pair's pulse, relative to the energy at which the flash was calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashGain {
    /// Energy over reference energy, above 0.
    pub value: f64,
    /// Its standard deviation; one and the same error for all pixels of the pair.
    pub deviation: f64,
}

impl FlashGain {
    /// Of a pair of which nothing was measured: strobes repeat to some 0.3 % (thesis, section 3.4: 0.0029).
    pub const UNMEASURED: Self = Self { value: 1.0, deviation: 0.003 };
}

impl Known {
    /// What a pulse of the reference energy would have given: `P / g`, with variance
    /// `(var P + (P sigma_g / g)^2) / g^2`. The gain's part is common to all pixels of the pair; it enters each
    /// variance so that pairs with a doubtful gain weigh less.
    pub fn at_reference(mut self, gain: FlashGain) -> Self {
        let (inverse, relative) = (gain.value.recip() as f32, (gain.deviation / gain.value) as f32);
        let variances = self.variance.pixels_mut().iter_mut();
        for (value, variance) in self.rgb.pixels_mut().iter_mut().zip(variances) {
            for (p, var) in value.iter_mut().zip(variance) {
                *var = (*var + (*p * relative).powi(2)) * inverse * inverse;
                *p *= inverse;
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;

    #[test]
    fn light_and_error_are_scaled_and_the_gains_own_error_is_added() {
        let known = Known {
            rgb: Image::filled(2, 2, [100.0, -4.0, 0.0]),
            variance: Image::filled(2, 2, [9.0, 9.0, 9.0]),
            valid: Image::filled(2, 2, true),
        };
        let exact = FlashGain { value: 1.0, deviation: 0.0 };
        assert_eq!(known.clone().at_reference(exact), known);
        let gain = FlashGain { value: 1.25, deviation: 0.025 };
        let freed = known.at_reference(gain);
        let (value, variance) = (freed.rgb.at(1, 1), freed.variance.at(1, 1));
        assert!((value[0] - 80.0).abs() < 1e-4 && (value[1] + 3.2).abs() < 1e-5 && value[2] == 0.0);
        // sigma_g / g = 2 %: 2 DN beside the noise's 3.
        assert!((variance[0] - 13.0 / 1.5625).abs() < 1e-4, "{variance:?}");
        assert!((variance[2] - 9.0 / 1.5625).abs() < 1e-4, "{variance:?}");
    }
}
