//! Points of distributions.

/// Half width of a 95 % interval of a normal distribution in standard deviations.
pub(super) const Z95: f64 = 1.959_964;

/// 97.5 % quantile of Student's t with `freedom` degrees of freedom (Cornish and Fisher's expansion from 3 up;
/// Abramowitz and Stegun 26.7.5): half width of a 95 % interval in standard errors.
pub(super) fn t_975(freedom: usize) -> f64 {
    match freedom {
        0 => f64::INFINITY,
        1 => 12.706_2,
        2 => 4.302_65,
        _ => {
            let (n, z2) = (freedom as f64, Z95 * Z95);
            let first = Z95 * (z2 + 1.0) / 4.0;
            let second = Z95 * ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0;
            let third = Z95 * (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0;
            let fourth = Z95 * ((((79.0 * z2 + 776.0) * z2 + 1482.0) * z2 - 1920.0) * z2 - 945.0) / 92_160.0;
            Z95 + (first + (second + (third + fourth / n) / n) / n) / n
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn students_quantiles_are_those_of_the_tables() {
        for (freedom, quantile) in [(3, 3.182), (5, 2.571), (10, 2.228), (30, 2.042), (1000, 1.962)] {
            assert!((t_975(freedom) / quantile - 1.0).abs() < 3e-3, "{freedom}: {}", t_975(freedom));
        }
    }
}
