//! The transfer curve of IEC 61966-2-1 (sRGB), exact, piecewise.

/// Encodes a linear value of 0..1 for display; values outside are clamped.
pub fn encode(linear: f32) -> f32 {
    let v = linear.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Decodes a displayed value of 0..1 to linear light.
pub fn decode(encoded: f32) -> f32 {
    let v = encoded.clamp(0.0, 1.0);
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Encodes to the nearest of 256 steps.
pub fn encode_u8(linear: f32) -> u8 {
    (encode(linear) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_points_of_the_curve() {
        assert_eq!([0.0, 1.0, -3.0, 7.0].map(encode_u8), [0, 255, 0, 255]);
        assert_eq!(encode_u8(0.215_860_5), 128);
        assert!((encode(0.18) - 0.461_356).abs() < 1e-5);
    }

    #[test]
    fn every_step_comes_back() {
        for step in 0..=255_u8 {
            assert_eq!(encode_u8(decode(f32::from(step) / 255.0)), step);
        }
    }
}
