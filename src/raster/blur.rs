//! Gaussian blur.

use super::Image;

/// Reach of [`gaussian`] in pixels: the kernel is cut off beyond four standard deviations.
pub fn gaussian_radius(sigma: f32) -> usize {
    (4.0 * sigma.max(0.0)).ceil() as usize
}

/// Convolves with a Gaussian of standard deviation `sigma` pixels, normalised, in two passes; the image is
/// mirrored at its border. A `sigma` of 0 gives the image back.
pub fn gaussian<const N: usize>(image: &Image<[f32; N]>, sigma: f32) -> Image<[f32; N]> {
    let radius = gaussian_radius(sigma);
    if radius == 0 || image.pixels().is_empty() {
        return image.clone();
    }
    let mut kernel: Vec<f32> =
        (0..=2 * radius).map(|i| (-0.5 * ((i as f32 - radius as f32) / sigma).powi(2)).exp()).collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let (width, height) = (image.width(), image.height());
    let convolve = |get: &dyn Fn(usize) -> [f32; N], at: usize, n: usize| {
        let mut out = [0.0; N];
        for (i, k) in kernel.iter().enumerate() {
            let value = get(mirrored(at as isize + i as isize - radius as isize, n));
            for (o, v) in out.iter_mut().zip(value) {
                *o += k * v;
            }
        }
        out
    };
    let rows = Image::from_fn(width, height, |x, y| convolve(&|i| *image.at(i, y), x, width));
    Image::from_fn(width, height, |x, y| convolve(&|i| *rows.at(x, i), y, height))
}

/// Index reflected about the edges of the first and last pixel until it lies in `0..n`.
fn mirrored(i: isize, n: usize) -> usize {
    let n = n as isize;
    let i = i.rem_euclid(2 * n);
    (if i < n { i } else { 2 * n - 1 - i }) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_a_point_is_sigma_and_nothing_is_lost() {
        let mut point = Image::filled(41, 41, [0.0_f32; 1]);
        point.at_mut(20, 20)[0] = 1.0;
        let blurred = gaussian(&point, 1.5);
        let (mut sum, mut second) = (0.0, 0.0);
        for y in 0..41 {
            for x in 0..41 {
                let v = f64::from(blurred.at(x, y)[0]);
                sum += v;
                second += v * (x as f64 - 20.0).powi(2);
            }
        }
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
        assert!((second - 2.25).abs() < 0.01, "{second}");
    }

    #[test]
    fn a_flat_image_stays_flat_even_when_smaller_than_the_kernel() {
        let flat = Image::filled(3, 2, [0.25_f32, 0.5]);
        for (a, b) in gaussian(&flat, 2.0).pixels().iter().flatten().zip(flat.pixels().iter().flatten()) {
            assert!((a - b).abs() < 1e-6);
        }
        assert_eq!(gaussian(&flat, 0.0), flat);
    }
}
