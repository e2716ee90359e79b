//! Values between pixel centres.

use super::Image;

/// Bilinear value at pixel position (x, y), pixel centres at half-integers, clamped at the border; `None` for
/// an empty image or a position that is not a number.
pub fn bilinear<const N: usize>(image: &Image<[f32; N]>, x: f32, y: f32) -> Option<[f32; N]> {
    if image.pixels().is_empty() || x.is_nan() || y.is_nan() {
        return None;
    }
    let cell = |p: f32, n: usize| {
        let p = (p - 0.5).clamp(0.0, (n - 1) as f32);
        let low = (p as usize).min(n - 1);
        (low, (low + 1).min(n - 1), p - low as f32)
    };
    let (x0, x1, fx) = cell(x, image.width());
    let (y0, y1, fy) = cell(y, image.height());
    let (a, b, c, d) = (image.at(x0, y0), image.at(x1, y0), image.at(x0, y1), image.at(x1, y1));
    Some(std::array::from_fn(|i| {
        let top = a[i] + (b[i] - a[i]) * fx;
        let bottom = c[i] + (d[i] - c[i]) * fx;
        top + (bottom - top) * fy
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_met_exactly_between_centres_and_held_at_the_border() {
        let ramp = Image::from_fn(5, 4, |x, y| [x as f32 + 10.0 * y as f32]);
        assert_eq!(bilinear(&ramp, 2.5, 1.5), Some([12.0]));
        assert_eq!(bilinear(&ramp, 2.75, 1.75), Some([14.75]));
        assert_eq!(bilinear(&ramp, -3.0, 99.0), Some([30.0]));
        assert_eq!(bilinear(&ramp, f32::NAN, 0.0), None);
        assert_eq!(bilinear(&Image::<[f32; 1]>::filled(0, 0, [0.0]), 0.0, 0.0), None);
    }
}
