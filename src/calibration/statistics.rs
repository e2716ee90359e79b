//! Points of distributions to which intervals of 95 % reach.

use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// 97.5 % point of the normal distribution: half of an interval in standard errors.
pub(crate) const Z95: f64 = 1.959_963_984_540_054;

/// From here on Student's distribution is told by the normal one and the first term of Cornish and Fisher's expansion
/// (Abramowitz and Stegun 26.7.5): the closed form loses digits.
const MANY: f64 = 1e4;

/// 97.5 % point of Student's distribution: half of an interval in standard errors that were themselves estimated.
pub(super) fn t_975(freedom: f64) -> f64 {
    if freedom > MANY {
        return Z95 + Z95 * (Z95 * Z95 + 1.0) / (4.0 * freedom);
    }
    StudentsT::new(0.0, 1.0, freedom).map_or(f64::INFINITY, |t| t.inverse_cdf(0.975))
}

/// 2.5 % and 97.5 % points of chi-square; all of it without a degree of freedom.
pub(super) fn chi_square_95(freedom: f64) -> [f64; 2] {
    ChiSquared::new(freedom).map_or([0.0, f64::INFINITY], |c| [0.025, 0.975].map(|p| c.inverse_cdf(p)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_those_of_the_tables_and_of_closed_forms() {
        let known =
            [(3.0, 3.182_446), (4.5, 2.658_912), (10.0, 2.228_139), (60.0, 2.000_298), (1e3, 1.962_339)];
        let one = (0.475 * std::f64::consts::PI).tan();
        let two = 0.95 * (2.0f64 / (1.0 - 0.95 * 0.95)).sqrt();
        for (freedom, point) in known.into_iter().chain([(1.0, one), (2.0, two), (1e15, Z95)]) {
            assert!((t_975(freedom) / point - 1.0).abs() < 1e-6, "{freedom}: {}", t_975(freedom));
        }
        assert!((t_975(MANY) / t_975(1.000_001 * MANY) - 1.0).abs() < 1e-7);
        assert_eq!(t_975(0.0), f64::INFINITY);
        for (freedom, points) in [(2.0, [0.050_635_6, 7.377_759]), (39.0, [23.654_325, 58.120_060])] {
            let found = chi_square_95(freedom);
            assert!((0..2).all(|i| (found[i] / points[i] - 1.0).abs() < 1e-6), "{freedom}: {found:?}");
        }
    }
}
