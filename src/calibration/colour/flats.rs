//! Flat parallelograms in a picture: what may be a chart's patches.
//!
//! Connected regions whose gradient is below a limit, at a ladder of limits as in MSER (Matas et al., BMVC 2002), so
//! that weak edges and noisy patches both have one that suits them. A region is kept if it is shaped like a
//! parallelogram: a parallelogram of area A has second moments of determinant (A / 12)^2, whatever its sides and angle;
//! an ellipse's is 4.7 % short of that and what is not convex far longer.

use crate::raster::{Image, Rgb};
use glam::{DMat2, DVec2};

/// Gradient limits, natural logarithm of the signal a pixel.
const LIMITS: [f32; 7] = [0.02, 0.032, 0.05, 0.08, 0.13, 0.2, 0.32];
/// Least area of a region, pixels.
const LEAST_AREA: usize = 16;
/// Largest share of the picture that a patch can have: twenty-four of them and the gaps fill less than all.
const LARGEST_SHARE: f64 = 1.0 / 24.0;
/// Area over twelve roots of the moments' determinant: 1 for parallelograms.
const SHAPE: std::ops::RangeInclusive<f64> = 0.87..=1.06;
/// Longest side over shortest.
const MOST_ASPECT: f64 = 4.0;
/// Regions kept, the largest first.
const MOST: usize = 1500;

/// A flat region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Flat {
    /// Centroid, pixels.
    pub(super) centre: DVec2,
    /// Area, pixels.
    pub(super) area: f64,
    /// Maps pixel differences to units of the region's side, up to a rotation: in them it is the unit square.
    pub(super) whiten: DMat2,
}

/// All flat regions of a picture, each once.
pub(super) fn find(picture: &Rgb) -> Vec<Flat> {
    let (width, height) = (picture.width(), picture.height());
    if width < 16 || height < 16 {
        return vec![];
    }
    let gradient = gradient(picture);
    let mut found: Vec<Flat> = LIMITS.iter().flat_map(|&limit| regions(&gradient, limit)).collect();
    found.sort_by(|a, b| b.area.total_cmp(&a.area));
    let mut kept: Vec<Flat> = vec![];
    // Regions of one patch at several limits: the largest, which comes first, is the nearest to its true outline.
    let cell = 16.0;
    let columns = (width as f64 / cell) as usize + 1;
    let mut grid: Vec<Vec<usize>> = vec![vec![]; columns * ((height as f64 / cell) as usize + 1)];
    for flat in found {
        let reach = 0.35 * flat.area.sqrt();
        let low = ((flat.centre - reach) / cell).max(DVec2::ZERO);
        let high = (flat.centre + reach) / cell;
        let near = (low.y as usize..=high.y as usize).flat_map(|y| {
            (low.x as usize..=high.x as usize).filter_map(move |x| (x < columns).then_some(y * columns + x))
        });
        let same = |other: &Flat| {
            let scale = other.area.sqrt();
            other.centre.distance(flat.centre) < 0.35 * scale && flat.area > 0.25 * other.area
        };
        if near.filter_map(|i| grid.get(i)).flatten().any(|&k| same(&kept[k])) {
            continue;
        }
        let at = (flat.centre.y / cell) as usize * columns + (flat.centre.x / cell) as usize;
        if let Some(here) = grid.get_mut(at) {
            here.push(kept.len());
        }
        kept.push(flat);
        if kept.len() == MOST {
            break;
        }
    }
    kept
}

/// Length of the logarithm's gradient, root mean square of the channels. What is added to the signal keeps noise in
/// the dark from being taken for edges.
fn gradient(picture: &Rgb) -> Image<f32> {
    let (width, height) = (picture.width(), picture.height());
    let floor: [f32; 3] = std::array::from_fn(|c| {
        let mut steps: Vec<f32> = picture
            .pixels()
            .chunks_exact(width)
            .flat_map(|row| row.windows(2).step_by(3).map(|two| (two[1][c] - two[0][c]).abs()))
            .collect();
        let middle = steps.len() / 2;
        let noise = *steps.select_nth_unstable_by(middle, f32::total_cmp).1;
        let mut values: Vec<f32> = picture.pixels().iter().step_by(7).map(|p| p[c]).collect();
        let middle = values.len() / 2;
        let typical = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
        (4.0 * noise).max(0.005 * typical).max(1e-6)
    });
    let log = picture.map(|p| std::array::from_fn::<f32, 3, _>(|c| (p[c].max(0.0) + floor[c]).ln()));
    Image::from_fn(width, height, |x, y| {
        if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
            return f32::INFINITY;
        }
        // Sobel's kernel: a derivative across, a little smoothing along.
        let at = |dx: usize, dy: usize| log.at(x + dx - 1, y + dy - 1);
        let mut sum = 0.0;
        for c in 0..3 {
            let across = |j: usize| at(2, j)[c] - at(0, j)[c];
            let down = |i: usize| at(i, 2)[c] - at(i, 0)[c];
            let dx = (across(0) + 2.0 * across(1) + across(2)) / 8.0;
            let dy = (down(0) + 2.0 * down(1) + down(2)) / 8.0;
            sum += dx * dx + dy * dy;
        }
        (sum / 3.0).sqrt()
    })
}

/// Parallelograms among the regions below a limit, by filling each once.
fn regions(gradient: &Image<f32>, limit: f32) -> Vec<Flat> {
    let (width, height) = (gradient.width(), gradient.height());
    let largest = (LARGEST_SHARE * (width * height) as f64) as usize;
    let values = gradient.pixels();
    let mut open: Vec<bool> = values.iter().map(|g| *g < limit).collect();
    let (mut found, mut stack) = (vec![], vec![]);
    for start in 0..open.len() {
        if !open[start] {
            continue;
        }
        open[start] = false;
        stack.push(start);
        let (mut area, mut first, mut second) = (0usize, DVec2::ZERO, [0.0f64; 3]);
        while let Some(i) = stack.pop() {
            let p = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            area += 1;
            first += p;
            second[0] += p.x * p.x;
            second[1] += p.x * p.y;
            second[2] += p.y * p.y;
            // The frame's border is never below the limit, so that no neighbour lies outside.
            for next in [i - 1, i + 1, i - width, i + width] {
                if open[next] {
                    open[next] = false;
                    stack.push(next);
                }
            }
        }
        if (LEAST_AREA..=largest).contains(&area) {
            found.extend(parallelogram(area as f64, first, second));
        }
    }
    found
}

fn parallelogram(area: f64, first: DVec2, [xx, xy, yy]: [f64; 3]) -> Option<Flat> {
    let centre = first / area;
    // A pixel is a square with moments of its own.
    let a = xx / area - centre.x * centre.x + 1.0 / 12.0;
    let b = xy / area - centre.x * centre.y;
    let c = yy / area - centre.y * centre.y + 1.0 / 12.0;
    let determinant = a * c - b * b;
    let (half, apart) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
    let (long, short) = (half + apart, half - apart);
    if determinant <= 0.0 || !SHAPE.contains(&(area / (12.0 * determinant.sqrt()))) {
        return None;
    }
    if long > MOST_ASPECT * MOST_ASPECT * short {
        return None;
    }
    // Root of the inverse of 12 times the covariance, by Cayley and Hamilton: sqrt(M) = (M + sqrt(det) I) / t.
    let root = determinant.sqrt();
    let t = (a + c + 2.0 * root).sqrt();
    let sqrt = DMat2::from_cols(DVec2::new(a + root, b), DVec2::new(b, c + root)) * (1.0 / t);
    let whiten = sqrt.inverse() * (1.0 / 12f64.sqrt());
    whiten.is_finite().then_some(Flat { centre, area, whiten })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slanted_patch_is_found_once_and_its_shape_with_it() {
        // Sides (20, 6) and (-5, 15) round (60.5, 40.5), on a darker ground; a disc and an L are no patches.
        let (u, v) = (DVec2::new(24.0, 6.0), DVec2::new(-5.0, 19.0));
        let to_sides = DMat2::from_cols(u, v).inverse();
        let picture = Image::from_fn(160, 120, |x, y| {
            let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let s = to_sides * (p - DVec2::new(60.5, 40.5));
            let patch = s.x.abs() < 0.5 && s.y.abs() < 0.5;
            let l = (100..140).contains(&x) && (70..110).contains(&y) && !((112..140).contains(&x) && y < 98);
            let value = if patch { 500.0 } else if l { 300.0 } else { 100.0 };
            [value, 0.5 * value, 0.7 * value + 3.0]
        });
        let found = find(&picture);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].centre.distance(DVec2::new(60.5, 40.5)) < 0.3, "{found:?}");
        for side in [u, v] {
            let seen = (found[0].whiten * side).length();
            assert!((1.0..1.25).contains(&seen), "{seen}");
        }
        let cosine = (found[0].whiten * u).normalize().dot((found[0].whiten * v).normalize());
        assert!(cosine.abs() < 0.1, "{cosine}");
    }

    #[test]
    fn nothing_is_found_in_a_tiny_or_an_empty_picture() {
        assert!(find(&Image::filled(3, 3, [1.0; 3])).is_empty());
        assert!(find(&Image::filled(64, 64, [0.0; 3])).is_empty());
        assert!(find(&Image::filled(64, 64, [f32::NAN; 3])).is_empty());
    }
}
