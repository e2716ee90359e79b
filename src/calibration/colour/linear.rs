//! Small dense systems, and the homography of matched points.

use glam::{DMat3, DVec2, DVec3};

/// Solves `a x = b` by elimination with pivots; `None` if `a` cannot be turned round.
pub(super) fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    let scale = a.as_flattened().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    for column in 0..N {
        let pivot = (column..N).max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs()))?;
        let value = a[pivot][column].abs();
        if value.is_nan() || value <= 1e-14 * scale {
            return None;
        }
        a.swap(column, pivot);
        b.swap(column, pivot);
        for row in column + 1..N {
            let factor = a[row][column] / a[column][column];
            for k in column..N {
                a[row][k] -= factor * a[column][k];
            }
            b[row] -= factor * b[column];
        }
    }
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N).map(|k| a[row][k] * b[k]).sum();
        b[row] = (b[row] - known) / a[row][row];
    }
    b.iter().all(|v| v.is_finite()).then_some(b)
}

/// A plane's projective image in another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(DMat3);

impl Homography {
    /// Least squares over matches `(from, to)`, four or more (Hartley and Zisserman, "Multiple View Geometry", 2nd
    /// edition, algorithm 4.2, with the last element 1, which the origin's finite image allows).
    pub fn fit(matches: &[(DVec2, DVec2)]) -> Option<Self> {
        let (from, to) = (normaliser(matches.iter().map(|m| m.0))?, normaliser(matches.iter().map(|m| m.1))?);
        if matches.len() < 4 {
            return None;
        }
        let (mut a, mut b) = ([[0.0; 8]; 8], [0.0; 8]);
        for (p, q) in matches {
            let (p, q) = (apply(from, *p), apply(to, *q));
            let rows = [
                ([p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y], q.x),
                ([0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y], q.y),
            ];
            for (row, value) in rows {
                for i in 0..8 {
                    for j in 0..8 {
                        a[i][j] += row[i] * row[j];
                    }
                    b[i] += row[i] * value;
                }
            }
        }
        let [c, d, e, f, g, h, i, j] = solve(a, b)?;
        let rows = DMat3::from_cols(DVec3::new(c, d, e), DVec3::new(f, g, h), DVec3::new(i, j, 1.0));
        let matrix = to.inverse() * rows.transpose() * from;
        matrix.is_finite().then_some(Self(matrix))
    }

    /// Image of a point; not finite on the horizon.
    pub fn at(&self, point: DVec2) -> DVec2 {
        apply(self.0, point)
    }

    /// The way back; `None` if the image is a line.
    pub fn inverse(&self) -> Option<Self> {
        let inverse = self.0.inverse();
        inverse.is_finite().then_some(Self(inverse))
    }

    /// The same after the image was enlarged by a factor.
    pub fn scaled(&self, factor: f64) -> Self {
        Self(DMat3::from_diagonal(DVec3::new(factor, factor, 1.0)) * self.0)
    }

    /// Whether a point lies on the seen side of the horizon, judged beside one that does.
    pub fn sees(&self, point: DVec2, seen: DVec2) -> bool {
        let depth = |p: DVec2| self.0.row(2).dot(p.extend(1.0));
        depth(point) * depth(seen) > 0.0
    }
}

fn apply(matrix: DMat3, point: DVec2) -> DVec2 {
    let p = matrix * point.extend(1.0);
    DVec2::new(p.x / p.z, p.y / p.z)
}

/// Moves points to their mean and scales them to a mean distance of the square root of two.
fn normaliser(points: impl Iterator<Item = DVec2> + Clone) -> Option<DMat3> {
    let count = points.clone().count();
    if count == 0 {
        return None;
    }
    let mean = points.clone().sum::<DVec2>() / count as f64;
    let reach = points.map(|p| p.distance(mean)).sum::<f64>() / count as f64;
    let scale = std::f64::consts::SQRT_2 / reach;
    let matrix = DMat3::from_scale(DVec2::splat(scale)) * DMat3::from_translation(-mean);
    (reach > 0.0 && matrix.is_finite()).then_some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_homography_is_found_again_from_its_own_points() {
        let rows = [DVec3::new(40.0, 9.0, 300.0), DVec3::new(-7.0, 35.0, 200.0), DVec3::new(0.02, -0.01, 1.0)];
        let truth = Homography(DMat3::from_cols(rows[0], rows[1], rows[2]).transpose());
        let grid = (0..24).map(|i| DVec2::new(f64::from(i % 6), f64::from(i / 6)));
        let matches: Vec<_> = grid.map(|p| (p, truth.at(p))).collect();
        for some in [&matches[..], &[matches[0], matches[5], matches[18], matches[23]]] {
            let found = Homography::fit(some).unwrap();
            let back = found.inverse().unwrap();
            for (from, to) in &matches {
                assert!(found.at(*from).distance(*to) < 1e-8);
                assert!(back.at(*to).distance(*from) < 1e-8);
                assert!(found.scaled(2.0).at(*from).distance(2.0 * *to) < 1e-8);
                assert!(found.sees(*from, DVec2::ZERO));
            }
        }
        assert!(!truth.sees(DVec2::new(-60.0, 0.0), DVec2::ZERO));
    }

    #[test]
    fn points_that_tell_no_homography_are_none() {
        let line = |n: i32| -> Vec<_> {
            (0..n).map(|i| (DVec2::new(f64::from(i), 2.0 * f64::from(i)), DVec2::splat(f64::from(i)))).collect()
        };
        assert_eq!(Homography::fit(&line(9)), None);
        assert_eq!(Homography::fit(&line(3)), None);
        assert_eq!(Homography::fit(&[]), None);
        assert_eq!(solve([[1.0, 2.0], [2.0, 4.0]], [1.0, 1.0]), None);
    }
}
