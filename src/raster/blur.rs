//! Gaussian blur.

use super::Image;

/// Reach of [`gaussian`] in pixels: the kernel is cut off beyond four standard deviations.
pub fn gaussian_radius(sigma: f32) -> usize {
    (4.0 * sigma.max(0.0)).ceil() as usize
}

/// Convolves with a Gaussian of standard deviation `sigma` pixels, normalised, in two passes; the image is
/// mirrored at its border. A `sigma` of 0 gives the image back.
pub fn gaussian<const N: usize>(image: &Image<[f32; N]>, sigma: f32) -> Image<[f32; N]> {
    gaussian_each(image, [sigma; N])
}

/// The same with a `sigma` for every channel.
pub fn gaussian_each<const N: usize>(image: &Image<[f32; N]>, sigma: [f32; N]) -> Image<[f32; N]> {
    let radius = sigma.iter().map(|s| gaussian_radius(*s)).max().unwrap_or(0);
    if radius == 0 || image.pixels().is_empty() {
        return image.clone();
    }
    let kernel = kernel(sigma, radius);
    let (width, height) = (image.width(), image.height());
    // Along a row every tap is one shift of a row that is continued past its ends; across rows, one row. Where all is
    // zero nothing is summed: an object fills little of the window round it.
    let mut rows = Image::filled(width, height, [0.0; N]);
    let mut wide = vec![[0.0; N]; width + 2 * radius];
    let mut spans = vec![(width, 0); height];
    for (y, out) in rows.pixels_mut().chunks_exact_mut(width).enumerate() {
        let row = &image.pixels()[y * width..(y + 1) * width];
        let Some(first) = row.iter().position(|p| *p != [0.0; N]) else { continue };
        let last = row.iter().rposition(|p| *p != [0.0; N]).unwrap_or(first);
        let (low, high) = (first.saturating_sub(radius), (last + radius + 1).min(width));
        for (i, w) in wide.iter_mut().enumerate().take(high + 2 * radius).skip(low) {
            *w = row[mirrored(i as isize - radius as isize, width)];
        }
        let taps: Vec<&[[f32; N]]> = (0..kernel.len()).map(|i| &wide[low + i..high + i]).collect();
        weigh(&mut out[low..high], &taps, &kernel);
        spans[y] = (low, high);
    }
    let mut out = Image::filled(width, height, [0.0; N]);
    for (y, row) in out.pixels_mut().chunks_exact_mut(width).enumerate() {
        let from = |i: usize| mirrored(y as isize + i as isize - radius as isize, height);
        let span = (0..kernel.len()).map(|i| spans[from(i)]);
        let (low, high) = span.fold((width, 0), |(a, b), (low, high)| (a.min(low), b.max(high)));
        if low < high {
            let of = |i: usize| &rows.pixels()[from(i) * width + low..from(i) * width + high];
            let taps: Vec<&[[f32; N]]> = (0..kernel.len()).map(of).collect();
            weigh(&mut row[low..high], &taps, &kernel);
        }
    }
    out
}

/// Taps from `-radius` to `radius`, each channel's normalised.
fn kernel<const N: usize>(sigma: [f32; N], radius: usize) -> Vec<[f32; N]> {
    let tap = |i: usize, s: f32| {
        let x = i as f32 - radius as f32;
        if s > 0.0 { (-0.5 * (x / s).powi(2)).exp() } else { f32::from(u8::from(x == 0.0)) }
    };
    let mut kernel: Vec<[f32; N]> = (0..=2 * radius).map(|i| sigma.map(|s| tap(i, s))).collect();
    let sums: [f32; N] = std::array::from_fn(|c| kernel.iter().map(|k| k[c]).sum());
    for k in kernel.iter_mut() {
        (0..N).for_each(|c| k[c] /= sums[c]);
    }
    kernel
}

/// Numbers that are summed side by side: whole pixels of 1, 2, 3, 4, 6 or 12 channels, and whole vectors of the processor.
const LANES: usize = 12;

/// Sum of the taps, each times its factors; they are as long as `out`.
fn weigh<const N: usize>(out: &mut [[f32; N]], taps: &[&[[f32; N]]], factors: &[[f32; N]]) {
    let flat: Vec<&[f32]> = taps.iter().map(|tap| tap.as_flattened()).collect();
    let lanes: Vec<[f32; LANES]> = factors.iter().map(|f| std::array::from_fn(|l| f[l % N])).collect();
    let whole = if LANES.is_multiple_of(N) { (out.len() * N) / LANES * LANES } else { 0 };
    let out = out.as_flattened_mut();
    for (k, chunk) in out[..whole].chunks_exact_mut(LANES).enumerate() {
        let mut sum = [0.0f32; LANES];
        for (tap, factor) in flat.iter().zip(&lanes) {
            if let Some(values) = tap[k * LANES..].first_chunk::<LANES>() {
                for l in 0..LANES {
                    sum[l] += factor[l] * values[l];
                }
            }
        }
        chunk.copy_from_slice(&sum);
    }
    for (i, out) in out.iter_mut().enumerate().skip(whole) {
        *out = flat.iter().zip(factors).map(|(tap, factor)| factor[i % N] * tap[i]).sum();
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
    fn every_channel_has_its_own_spread() {
        let mut point = Image::filled(31, 31, [0.0_f32; 3]);
        *point.at_mut(15, 15) = [1.0; 3];
        let together = gaussian_each(&point, [0.0, 0.8, 1.6]);
        for (c, sigma) in [0.0, 0.8, 1.6].into_iter().enumerate() {
            let alone = gaussian(&point, sigma);
            for (a, b) in together.pixels().iter().zip(alone.pixels()) {
                assert!((a[c] - b[c]).abs() < 1e-4, "{} {} at {sigma}", a[c], b[c]);
            }
        }
    }

    #[test]
    fn whatever_the_number_of_channels_each_is_blurred_as_if_alone() {
        fn agrees<const N: usize>() {
            let image = Image::from_fn(23, 9, |x, y| {
                std::array::from_fn::<f32, N, _>(|c| ((x * 7 + y * 5 + c * 3) % 11) as f32)
            });
            let together = gaussian(&image, 1.1);
            for c in 0..N {
                let alone = gaussian(&image.map(|p| [p[c]]), 1.1);
                for (a, b) in together.pixels().iter().zip(alone.pixels()) {
                    assert!((a[c] - b[0]).abs() < 1e-5, "{} {} of {N}", a[c], b[0]);
                }
            }
        }
        agrees::<3>();
        agrees::<5>();
        agrees::<6>();
    }

    #[test]
    fn what_is_zero_all_round_changes_nothing() {
        let spot = |x: usize, y: usize| {
            if (18..25).contains(&x) && (30..33).contains(&y) { [x as f32, 1.0, 2.0] } else { [0.0; 3] }
        };
        let small = gaussian(&Image::from_fn(43, 40, spot), 1.3);
        let lifted = gaussian(&Image::from_fn(43, 40, |x, y| spot(x, y).map(|v| v + 1.0)), 1.3);
        for (a, b) in small.pixels().iter().flatten().zip(lifted.pixels().iter().flatten()) {
            assert!((a + 1.0 - b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn spots_at_borders_and_corners_come_out_as_by_definition() {
        // Empty rows and columns lie between spots at every border: sums are left out there, mirrored ends are not.
        let (width, height, sigma) = (27usize, 24usize, 1.2f32);
        let spots = [(0, 0), (26, 1), (0, 13), (13, 23), (26, 23), (12, 0)];
        let image = Image::from_fn(width, height, |x, y| {
            [spots.iter().position(|s| *s == (x, y)).map_or(0.0, |i| 1.0 + i as f32)]
        });
        let blurred = gaussian(&image, sigma);
        let radius = gaussian_radius(sigma) as isize;
        let tap = |i: isize| (-0.5 * (i as f64 / f64::from(sigma)).powi(2)).exp();
        let all: f64 = (-radius..=radius).map(tap).sum();
        // Half-sample symmetry: ... 1 0 | 0 1 2 ...
        let inside = |i: isize, n: usize| if i < 0 { -1 - i } else { i.min(2 * n as isize - 1 - i) } as usize;
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let mut want = 0.0;
            for v in -radius..=radius {
                for u in -radius..=radius {
                    let at = image.at(inside(x as isize + u, width), inside(y as isize + v, height));
                    want += tap(u) * tap(v) / (all * all) * f64::from(at[0]);
                }
            }
            let got = f64::from(blurred.at(x, y)[0]);
            assert!((got - want).abs() < 1e-5, "{got} for {want} at {x}, {y}");
        }
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
