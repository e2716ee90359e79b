//! Masks shrunk and grown, and averages over square blocks.

use super::Image;

/// Pixels whose whole square neighbourhood of `radius` (Chebyshev distance) is set; beyond the border
/// nothing is set.
pub fn erode(mask: &Image<bool>, radius: usize) -> Image<bool> {
    square(mask, radius, false)
}

/// Pixels with any set pixel within `radius` (Chebyshev distance).
pub fn dilate(mask: &Image<bool>, radius: usize) -> Image<bool> {
    square(mask, radius, true)
}

/// Rows, then columns: `wanted` anywhere in the window decides the pixel.
fn square(mask: &Image<bool>, radius: usize, wanted: bool) -> Image<bool> {
    let (width, height) = (mask.width(), mask.height());
    let pass = |at: usize, n: usize, get: &dyn Fn(usize) -> bool| {
        let (low, high) = (at.saturating_sub(radius), (at + radius).min(n - 1));
        let beyond = at < radius || at + radius > n - 1;
        let found = (low..=high).any(|i| get(i) == wanted) || (beyond && !wanted);
        found == wanted
    };
    let rows = Image::from_fn(width, height, |x, y| pass(x, width, &|i| *mask.at(i, y)));
    Image::from_fn(width, height, |x, y| pass(y, height, &|i| *rows.at(x, i)))
}

/// Means of the `size` x `size` blocks, counted from the top-left corner, that lie wholly inside the mask.
/// The mask must be as large as the image.
pub fn block_means<const N: usize>(
    image: &Image<[f32; N]>,
    mask: &Image<bool>,
    size: usize,
) -> Vec<[f32; N]> {
    let mut means = Vec::new();
    for top in (0..(image.height() + 1).saturating_sub(size)).step_by(size.max(1)) {
        for left in (0..(image.width() + 1).saturating_sub(size)).step_by(size.max(1)) {
            let inside = || (0..size * size).map(|i| (left + i % size, top + i / size));
            if !inside().all(|(x, y)| *mask.at(x, y)) {
                continue;
            }
            let mut sum = [0.0_f64; N];
            for (x, y) in inside() {
                for (s, v) in sum.iter_mut().zip(image.at(x, y)) {
                    *s += f64::from(*v);
                }
            }
            means.push(sum.map(|s| (s / (size * size) as f64) as f32));
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn erosion_counts_the_corner_and_the_border() {
        let mut mask = Image::filled(12, 9, true);
        *mask.at_mut(11, 0) = false;
        let eroded = erode(&mask, 3);
        let set: Vec<_> =
            (0..9).flat_map(|y| (0..12).map(move |x| (x, y))).filter(|&(x, y)| *eroded.at(x, y)).collect();
        let expected: Vec<_> =
            (3..6).flat_map(|y| (3..9).map(move |x| (x, y))).filter(|&(x, y)| !(x >= 8 && y <= 3)).collect();
        assert_eq!(set, expected);
    }

    #[test]
    fn dilation_grows_a_point_to_a_square() {
        let mut mask = Image::filled(7, 7, false);
        *mask.at_mut(1, 3) = true;
        let grown = dilate(&mask, 2);
        for y in 0..7 {
            for x in 0..7 {
                assert_eq!(*grown.at(x, y), x <= 3 && (1..=5).contains(&y), "{x} {y}");
            }
        }
    }

    #[test]
    fn only_whole_blocks_inside_the_mask_are_averaged() {
        let image = Image::from_fn(5, 4, |x, y| [(x + 10 * y) as f32]);
        let mut mask = Image::filled(5, 4, true);
        assert_eq!(block_means(&image, &mask, 2), [[5.5], [7.5], [25.5], [27.5]]);
        *mask.at_mut(3, 0) = false;
        assert_eq!(block_means(&image, &mask, 2), [[5.5], [25.5], [27.5]]);
        assert!(block_means(&image, &mask, 9).is_empty());
    }
}
