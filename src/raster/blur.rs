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
    // Along a row every tap is one shift of a row that is continued past its ends; across rows, one row.
    let mut rows = image.clone();
    let mut wide = vec![[0.0; N]; width + 2 * radius];
    for row in rows.pixels_mut().chunks_exact_mut(width) {
        for (i, w) in wide.iter_mut().enumerate() {
            *w = row[mirrored(i as isize - radius as isize, width)];
        }
        let row = row.as_flattened_mut();
        row.fill(0.0);
        for (i, k) in kernel.iter().enumerate() {
            add_times(row, &wide.as_flattened()[i * N..], *k);
        }
    }
    let mut out = Image::filled(width, height, [0.0; N]);
    for (y, row) in out.pixels_mut().chunks_exact_mut(width).enumerate() {
        for (i, k) in kernel.iter().enumerate() {
            let from = mirrored(y as isize + i as isize - radius as isize, height) * width;
            add_times(row.as_flattened_mut(), rows.pixels()[from..from + width].as_flattened(), *k);
        }
    }
    out
}

fn add_times(sum: &mut [f32], values: &[f32], factor: f32) {
    for (s, v) in sum.iter_mut().zip(values) {
        *s += factor * v;
    }
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
