//! Differences of many patches in a few numbers.

use super::cielab::{Lab, delta_e_2000, delta_e_2000_plain};
use serde::{Deserialize, Serialize};

/// CIEDE2000 over patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Differences {
    /// Patches.
    pub patches: usize,
    /// Mean.
    pub mean: f64,
    /// Value that nine tenths of the patches do not exceed.
    pub percentile_90: f64,
    /// Largest.
    pub max: f64,
    /// Mean with S_L = 1, as archiving standards have it.
    pub mean_sl1: f64,
    /// 90th percentile with S_L = 1.
    pub percentile_90_sl1: f64,
    /// Largest with S_L = 1.
    pub max_sl1: f64,
}

/// Summarises pairs of reference and measured values; zeros without any.
pub(super) fn summary(pairs: &[(Lab, Lab)]) -> Differences {
    let sorted = |difference: fn(Lab, Lab) -> f64| {
        let mut values: Vec<f64> = pairs.iter().map(|(a, b)| difference(*a, *b)).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let n = pairs.len();
    // Nearest rank: the smallest value with nine tenths at or below it.
    let rank = (9 * n).div_ceil(10).saturating_sub(1);
    let three = |values: Vec<f64>| {
        let at = |k: usize| values.get(k).copied().unwrap_or_default();
        [values.iter().sum::<f64>() / n.max(1) as f64, at(rank), at(n.saturating_sub(1))]
    };
    let [mean, percentile_90, max] = three(sorted(delta_e_2000));
    let [mean_sl1, percentile_90_sl1, max_sl1] = three(sorted(delta_e_2000_plain));
    Differences { patches: n, mean, percentile_90, max, mean_sl1, percentile_90_sl1, max_sl1 }
}
