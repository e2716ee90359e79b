//! CIELAB under D50, and colour differences.
//!
//! CIE 15:2018 for L*a*b*, with ICC's D50 as white; CIE 142-2001 (ISO/CIE 11664-6) for the difference, as Sharma, Wu
//! and Dalal write it ("The CIEDE2000 color-difference formula: implementation notes, supplementary test data, and
//! mathematical observations", Color Research and Application 30(1), 2005).

use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// White of ICC's profile connection space, D50, XYZ with Y = 1.
pub(super) const D50: DVec3 = DVec3::new(0.9642, 1.0, 0.8249);

/// L*, a*, b*.
pub type Lab = [f64; 3];

const EPSILON: f64 = 216.0 / 24389.0;
const KAPPA: f64 = 24389.0 / 27.0;

/// CIELAB of XYZ (Y = 1 for white) under D50; negative values go on along the straight part.
pub fn lab(xyz: DVec3) -> Lab {
    let f = |t: f64| if t > EPSILON { t.cbrt() } else { (KAPPA * t + 16.0) / 116.0 };
    let [x, y, z] = (xyz / D50).to_array().map(f);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// XYZ (Y = 1 for white) of CIELAB under D50.
pub fn xyz([l, a, b]: Lab) -> DVec3 {
    let inverse = |f: f64| if f.powi(3) > EPSILON { f.powi(3) } else { (116.0 * f - 16.0) / KAPPA };
    let y = (l + 16.0) / 116.0;
    DVec3::new(inverse(y + a / 500.0), inverse(y), inverse(y - b / 200.0)) * D50
}

/// How lightness counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lightness {
    /// CIEDE2000 as it is: dark and light differences count less than those in the middle.
    Weighted,
    /// With S_L = 1, as archiving standards want it: never less than [`Lightness::Weighted`].
    Plain,
}

/// CIEDE2000 colour difference with unit parametric factors.
pub fn delta_e_2000(reference: Lab, sample: Lab) -> f64 {
    difference(reference, sample, Lightness::Weighted).length()
}

/// CIEDE2000 with the lightness of `Lightness::Plain`.
pub fn delta_e_2000_plain(reference: Lab, sample: Lab) -> f64 {
    difference(reference, sample, Lightness::Plain).length()
}

/// The difference as a vector whose length is CIEDE2000: lightness, then chroma and hue with the rotation term's
/// quadratic form `c^2 + R c h + h^2` taken apart as `(c + R h / 2)^2 + (1 - R^2 / 4) h^2`.
pub(super) fn difference([l1, a1, b1]: Lab, [l2, a2, b2]: Lab, lightness: Lightness) -> DVec3 {
    let far = 25f64.powi(7);
    let part = |c: f64| (c.powi(7) / (c.powi(7) + far)).sqrt();
    let g = 0.5 * (1.0 - part(0.5 * (a1.hypot(b1) + a2.hypot(b2))));
    let (a1, a2) = ((1.0 + g) * a1, (1.0 + g) * a2);
    let (c1, c2) = (a1.hypot(b1), a2.hypot(b2));
    let angle = |a: f64, b: f64| if a == 0.0 && b == 0.0 { 0.0 } else { b.atan2(a).rem_euclid(TAU) };
    let (h1, h2) = (angle(a1, b1), angle(a2, b2));
    let grey = c1 * c2 == 0.0;
    let turn = match h2 - h1 {
        _ if grey => 0.0,
        d if d > PI => d - TAU,
        d if d < -PI => d + TAU,
        d => d,
    };
    let hue = 2.0 * (c1 * c2).sqrt() * (0.5 * turn).sin();
    let mean_hue = match h1 + h2 {
        sum if grey => sum,
        sum if (h1 - h2).abs() <= PI => 0.5 * sum,
        sum if sum < TAU => 0.5 * (sum + TAU),
        sum => 0.5 * (sum - TAU),
    };
    let (mean_l, mean_c) = (0.5 * (l1 + l2), 0.5 * (c1 + c2));
    let degrees = |d: f64| d.to_radians();
    let t = 1.0 - 0.17 * (mean_hue - degrees(30.0)).cos()
        + 0.24 * (2.0 * mean_hue).cos()
        + 0.32 * (3.0 * mean_hue + degrees(6.0)).cos()
        - 0.20 * (4.0 * mean_hue - degrees(63.0)).cos();
    let middle = (mean_l - 50.0).powi(2);
    let s_l = match lightness {
        Lightness::Weighted => 1.0 + 0.015 * middle / (20.0 + middle).sqrt(),
        Lightness::Plain => 1.0,
    };
    let (s_c, s_h) = (1.0 + 0.045 * mean_c, 1.0 + 0.015 * mean_c * t);
    let blue = (mean_hue.to_degrees() - 275.0) / 25.0;
    let rotation = -(degrees(60.0) * (-blue * blue).exp()).sin() * 2.0 * part(mean_c);
    let (l, c, h) = ((l2 - l1) / s_l, (c2 - c1) / s_c, hue / s_h);
    DVec3::new(l, c + 0.5 * rotation * h, (1.0 - 0.25 * rotation * rotation).max(0.0).sqrt() * h)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table 1 of Sharma, Wu and Dalal.
    const PAIRS: [[f64; 7]; 34] = [
        [50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425],
        [50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615],
        [50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412],
        [50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669],
        [50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461],
        [50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065],
        [50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492],
        [50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977],
        [50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030],
        [50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
        [61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731],
        [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146],
        [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
        [90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381],
        [6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ];

    #[test]
    fn all_pairs_of_sharma_come_out() {
        for (k, [l1, a1, b1, l2, a2, b2, expected]) in PAIRS.into_iter().enumerate() {
            let there = delta_e_2000([l1, a1, b1], [l2, a2, b2]);
            let back = delta_e_2000([l2, a2, b2], [l1, a1, b1]);
            assert!((there - expected).abs() < 5.1e-5, "pair {}: {there} for {expected}", k + 1);
            assert!((there - back).abs() < 1e-9, "pair {}", k + 1);
        }
    }

    #[test]
    fn plain_lightness_never_counts_less_and_is_the_same_in_the_middle() {
        for [l1, a1, b1, l2, a2, b2, expected] in PAIRS {
            assert!(delta_e_2000_plain([l1, a1, b1], [l2, a2, b2]) > expected - 1e-3);
        }
        assert!((delta_e_2000_plain([49.0, 0.0, 0.0], [51.0, 0.0, 0.0]) - 2.0).abs() < 1e-12);
        assert!((delta_e_2000_plain([90.0, 0.0, 0.0], [92.0, 0.0, 0.0]) - 2.0).abs() < 1e-12);
        assert!(delta_e_2000([90.0, 0.0, 0.0], [92.0, 0.0, 0.0]) < 1.3);
    }

    #[test]
    fn lab_and_xyz_are_inverse_and_white_and_grey_are_where_they_belong() {
        assert!(lab(D50).iter().zip([100.0, 0.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-12));
        // CIE's own number for a grey of 18 %.
        assert!((lab(0.184_186_52 * D50)[0] - 50.0).abs() < 1e-5);
        for colour in
            [[20.0, 3.0, -9.0], [95.0, -1.0, 3.0], [28.4, 15.4, -49.8], [81.8, 2.7, 80.4], [4.0, 0.2, 0.1]]
        {
            let back = lab(xyz(colour));
            assert!(back.iter().zip(colour).all(|(a, b)| (a - b).abs() < 1e-9), "{back:?} for {colour:?}");
        }
    }
}
