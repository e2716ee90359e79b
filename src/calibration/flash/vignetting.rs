//! The lens's vignetting as it is known before the flash is fitted.

use super::FieldFactor;
use crate::calibration::flat::ProfilePoint;
use crate::calibration::linear::Normal;

/// A curve and how well it is known.
///
/// A flat field is known with an error, and a lobe `cos^n` looks much like vignetting: the card shots tell their product
/// far better than a flat field tells one of the two. So its curve is not taken as it is, but enters the fit as what it
/// is, further measurements of the field's coefficients. The lobe is then told by what both say of one shape, and its
/// interval holds the flat field's noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vignetting {
    /// Its curve.
    pub field: FieldFactor,
    /// What the measurements know of the three coefficients: the inverse of their covariance. Absent if the curve is taken as
    /// it is.
    pub information: Option<[[f64; 3]; 3]>,
}

impl Vignetting {
    /// A curve that is taken as it is.
    pub fn exact(field: FieldFactor) -> Self {
        Self { field, information: None }
    }

    /// Out of relative light around the frame's centre by colour, as a flat field has it: one curve for all colours by least squares, `y = n_c V(q)` with a level n_c of each colour's
    /// own, and its information without those levels. `near` is a curve near it. Residuals that are more than noise,
    /// also what the colours differ by, lower the information. `None` if the profile does not tell a curve.
    pub fn of_profile(near: FieldFactor, profile: &[Vec<ProfilePoint>; 3]) -> Option<Self> {
        let mut normal = Normal::zero(3);
        let (mut squares, mut freedom) = (0.0, -3.0);
        for rings in profile.iter().filter(|rings| !rings.is_empty()) {
            // Sums for the level, the curve's changes, and both.
            let (mut level, mut level_pull, mut across) = (0.0, 0.0, [0.0; 3]);
            for ProfilePoint { radius, light, light_standard_error } in rings {
                let (q, weight) = (radius * radius, light_standard_error.powi(-2));
                let (curve, powers) = (near.at_q(q), [q, q * q, q * q * q]);
                let off = light - curve;
                normal.add(&powers, off, weight);
                level += weight * curve * curve;
                level_pull += weight * curve * off;
                (0..3).for_each(|i| across[i] += weight * curve * powers[i]);
                squares += weight * off * off;
            }
            normal.add(&across, level_pull, -1.0 / level);
            squares -= level_pull * level_pull / level;
            freedom += rings.len() as f64 - 1.0;
        }
        let (change, _) = normal.solve()?;
        squares -= change.dot(&normal.right);
        let excess = if freedom > 0.0 { (squares / freedom).max(1.0) } else { 1.0 };
        let mut field = near;
        field.coefficients.iter_mut().zip(&change).for_each(|(a, c)| *a += c);
        let information = std::array::from_fn(|i| std::array::from_fn(|j| normal.matrix[(i, j)] / excess));
        Some(Self { field, information: Some(information) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_gives_its_curve_whatever_the_colours_levels_and_a_poor_one_none() {
        let wanted = FieldFactor { coefficients: [-0.11, -0.02, 0.005] };
        let rings = |level: f64| -> Vec<ProfilePoint> {
            let at = |radius: f64| {
                let light = level * wanted.at_q(radius * radius);
                ProfilePoint { radius, light, light_standard_error: 1e-3 }
            };
            (0..12).map(|i| at((f64::from(i) + 0.5) / 12.0)).collect()
        };
        let near = FieldFactor { coefficients: [-0.13, 0.0, 0.0] };
        let found = Vignetting::of_profile(near, &[rings(1.0), rings(1.0001), rings(0.9998)]).unwrap();
        for q in [0.2, 0.5, 1.0] {
            assert!((found.field.at_q(q) - wanted.at_q(q)).abs() < 1e-4, "{found:?}");
        }
        assert!(found.information.unwrap()[0][0] > 1e4);
        assert_eq!(Vignetting::of_profile(near, &[vec![], vec![], vec![]]), None);
        assert_eq!(Vignetting::of_profile(near, &[rings(1.0)[..3].to_vec(), vec![], vec![]]), None);
    }
}
