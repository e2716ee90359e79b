//! The chart's plane in the picture: a homography.
//!
//! Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, section 4.1 (direct linear
//! transformation with the last element set to 1, normalised points as in 4.4.4).

use super::charts::{COLUMNS, ROWS};
use crate::calibration::linear::Normal;
use glam::{DMat3, DVec2};

/// Side of a patch over the distance between the centres of two; 0.81 (Mini) to 0.87 (Classic).
const PATCH_SHARE: f64 = 0.84;

/// Half of what of a patch is measured, over the distance between the centres of two: about half of its width.
pub(super) const MEASURED_HALF: f64 = 0.22;

/// Where a point of one plane is in the other.
pub(super) fn project(homography: &DMat3, point: DVec2) -> DVec2 {
    let p = *homography * point.extend(1.0);
    p.truncate() / p.z
}

/// Column and row of a patch's centre in the chart's plane, from the first patch's centre, in patches.
pub(super) fn patch_centre(patch: usize) -> DVec2 {
    DVec2::new((patch % COLUMNS) as f64, (patch / COLUMNS) as f64)
}

/// Corners of the part of a patch that is measured, in turn.
pub fn measured_corners(image_from_chart: &DMat3, patch: usize) -> [DVec2; 4] {
    let at =
        |x: f64, y: f64| project(image_from_chart, patch_centre(patch) + MEASURED_HALF * DVec2::new(x, y));
    [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]
}

/// Outer corners of the corner patches in the chart's plane: first patch's, then on along the first row.
pub(super) fn chart_corners() -> [DVec2; 4] {
    let (half, right, low) = (0.5 * PATCH_SHARE, (COLUMNS - 1) as f64, (ROWS - 1) as f64);
    [
        DVec2::new(-half, -half),
        DVec2::new(right + half, -half),
        DVec2::new(right + half, low + half),
        DVec2::new(-half, low + half),
    ]
}

/// From the chart's plane to a picture in which the outer corners of its corner patches lie there: the first patch's, then
/// on along the first row and round; `None` where they are no quadrangle.
pub fn image_from_corners(corners: [DVec2; 4]) -> Option<DMat3> {
    let turn = |k: usize| {
        let [a, b, c] = [0, 1, 2].map(|step| corners[(k + step) % 4]);
        (b - a).perp_dot(c - b)
    };
    let turns = [0, 1, 2, 3].map(turn);
    if !(turns.iter().all(|t| *t > 0.0) || turns.iter().all(|t| *t < 0.0)) {
        return None;
    }
    let pairs: Vec<(DVec2, DVec2)> = chart_corners().into_iter().zip(corners).collect();
    homography(&pairs)
}

/// Homography that takes each first point to its second, by least squares; `None` for fewer than four pairs, or where
/// they lie in a line or no plane seen from before it can look so.
pub(super) fn homography(pairs: &[(DVec2, DVec2)]) -> Option<DMat3> {
    if pairs.len() < 4 {
        return None;
    }
    let (from, to) = (normaliser(pairs.iter().map(|p| p.0))?, normaliser(pairs.iter().map(|p| p.1))?);
    let mut normal = Normal::zero(8);
    for &(p, q) in pairs {
        let (p, q) = (from.transform_point2(p), to.transform_point2(q));
        let rows = [
            ([p.x, p.y, 1.0, 0.0, 0.0, 0.0, -p.x * q.x, -p.y * q.x], q.x),
            ([0.0, 0.0, 0.0, p.x, p.y, 1.0, -p.x * q.y, -p.y * q.y], q.y),
        ];
        rows.iter().for_each(|(row, value)| normal.add(row, *value, 1.0));
    }
    let (h, _) = normal.solve()?;
    let unit = DMat3::from_cols_array(&[h[0], h[3], h[6], h[1], h[4], h[7], h[2], h[5], 1.0]);
    let found = to.inverse() * unit * from;
    let before = |p: DVec2| (found * p.extend(1.0)).z / found.z_axis.z > 0.0;
    (found.is_finite() && found.determinant() != 0.0 && pairs.iter().all(|p| before(p.0))).then_some(found)
}

/// Shift and scale after which points lie about the origin at a mean distance of about 1.
fn normaliser(points: impl Iterator<Item = DVec2> + Clone) -> Option<DMat3> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<DVec2>() / n;
    let spread = points.map(|p| p.distance(mean)).sum::<f64>() / n;
    (spread > 0.0 && spread.is_finite())
        .then(|| DMat3::from_scale(DVec2::splat(1.0 / spread)) * DMat3::from_translation(-mean))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_homography_is_found_again_from_four_points_and_from_many() {
        let truth = DMat3::from_cols_array(&[40.0, 12.0, 0.02, -9.0, 44.0, -0.01, 300.0, 200.0, 1.0]);
        for count in [4, 24] {
            let picked = [0, 5, 18, 23].into_iter().chain((0..24).filter(|k| ![0, 5, 18, 23].contains(k)));
            let pairs: Vec<_> =
                picked.take(count).map(|k| (patch_centre(k), project(&truth, patch_centre(k)))).collect();
            let found = homography(&pairs).unwrap();
            let off =
                (0..24).map(|k| project(&found, patch_centre(k)).distance(project(&truth, patch_centre(k))));
            assert!(off.fold(0.0, f64::max) < 1e-6, "{found}");
        }
        let corners = chart_corners().map(|p| project(&truth, p));
        let found = image_from_corners(corners).unwrap();
        let off = measured_corners(&found, 17)[2].distance(measured_corners(&truth, 17)[2]);
        assert!(off < 1e-6 && image_from_corners([DVec2::ONE; 4]).is_none(), "{off}");
        let line: Vec<_> = (0..6).map(|k| (patch_centre(k), project(&truth, patch_centre(k)))).collect();
        assert!(homography(&line).is_none() && homography(&[]).is_none());
    }
}
