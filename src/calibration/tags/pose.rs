//! The plane of one or more squares of known size, by least squares on the distances of the sides' points.
//!
//! A plane that does not hold the lens's centre of projection is `u . X = 1`; its distance along the axis is 1 / u_z. On
//! it each square has the place where its centre is seen and an angle: 3 + 3 n unknowns for n squares. Residuals are the
//! distances of points from the projected sides, in pixels of a camera without distortion; Levenberg-Marquardt.
//!
//! A square seen small has two such planes, mirror images about the line of sight (Schweighofer and Pinz, "Robust pose
//! estimation from a planar target", IEEE PAMI 28, 2006): the search starts from five tilts, and the second minimum is
//! told where the picture does not decide against it.

use super::TagError;
use crate::calibration::Plane;
use crate::calibration::linear::{Normal, inverse};
use crate::scene::Intrinsics;
use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Vector3};

/// Standard error of a whole side by what is not noise: sampling, light that falls off across it. Pixels of the frame.
const SIDE_ERROR: f64 = 0.005;

/// Standard error by which all sides together may seem too far outside: ends of a profile that blur reaches.
const GROWTH_ERROR: f64 = 0.006;

/// Residuals beyond this many standard deviations are left out.
const OUTLIER: f64 = 4.0;

/// By how much chi-square of a plane must be above that of the best one to rule it out.
const DECIDED: f64 = 12.0;

/// Planes nearer than this are one, radians.
const SAME: f64 = 0.005;

/// Most steps of a search.
const MOST_STEPS: usize = 60;

/// A square as it was seen, in pixels of a camera without distortion, from its principal point.
#[derive(Clone, Debug)]
pub(super) struct Square {
    pub(super) corners: [DVec2; 4],
    /// Points on the sides from corner k to the next.
    pub(super) sides: [Vec<DVec2>; 4],
}

/// A square as it lies.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) centre: DVec3,
    pub(super) axes: [DVec3; 2],
    /// As [`Square::corners`].
    pub(super) corners: [DVec2; 4],
}

#[derive(Clone, Debug)]
pub(super) struct PoseFit {
    pub(super) plane: Plane,
    pub(super) distance_error: f64,
    pub(super) normal_error: f64,
    pub(super) rms: f64,
    pub(super) places: Vec<Place>,
    pub(super) other: Option<Plane>,
}

/// Where a pixel would be in a camera without distortion, from its principal point.
pub(super) fn ideal(intrinsics: &Intrinsics, pixel: DVec2) -> DVec2 {
    let seen = (pixel - intrinsics.principal) / intrinsics.focal;
    intrinsics.distortion.undistort(seen) * intrinsics.focal
}

/// Its inverse.
pub(super) fn pixel(intrinsics: &Intrinsics, ideal: DVec2) -> DVec2 {
    intrinsics.distortion.distort(ideal / intrinsics.focal) * intrinsics.focal + intrinsics.principal
}

/// Fits one plane to all squares.
pub(super) fn fit(squares: &[Square], focal: DVec2, size: f64) -> Result<PoseFit, TagError> {
    let own: Vec<Vec<Minimum>> = squares
        .iter()
        .map(|square| Search { squares: std::slice::from_ref(square), focal, size }.minima())
        .collect();
    let best: Option<Vec<&Minimum>> = own.iter().map(|minima| minima.first()).collect();
    let best = best.ok_or(TagError::Vague)?;
    let joint = Search { squares, focal, size };
    let minima = match squares.len() {
        1 => own[0].clone(),
        _ => joint.joint_minima(&own),
    };
    let first = minima.first().ok_or(TagError::Vague)?;
    let (rms, sigma) = (first.rms(), first.sigma());
    let count: f64 = best.iter().map(|m| m.count()).sum();
    let own_rms = (best.iter().map(|m| m.squares).sum::<f64>() / count).sqrt();
    if rms > (3.0 * own_rms).max(0.2) && squares.len() > 1 {
        return Err(TagError::Planes { joint_px: rms, own_px: own_rms });
    }
    let corners = squares.iter().flat_map(|s| (0..4).map(|k| s.corners[k].distance(s.corners[(k + 1) % 4])));
    let longest = corners.fold(0.0, f64::max);
    if rms > 0.6 + 0.01 * longest {
        return Err(TagError::Bent { rms_px: rms });
    }
    let (distance_error, normal_error) = joint.errors(first, sigma).ok_or(TagError::Vague)?;
    let other = minima.get(1).filter(|second| {
        // Of a point, with its part of what a side's points have in common.
        let along = first.count() / (4 * squares.len()) as f64;
        let common = SIDE_ERROR.powi(2) + GROWTH_ERROR.powi(2);
        let variance = sigma * sigma + along * common;
        // By the points that count for the best one.
        let sum = joint.sum(&second.theta, &first.used).unwrap_or(f64::INFINITY);
        sum - first.squares < DECIDED * variance
            && angle(first.u(), second.u()) > (2.0 * normal_error).max(SAME)
    });
    Ok(PoseFit {
        plane: plane(first.u()),
        distance_error,
        normal_error,
        rms,
        places: (0..squares.len()).map(|t| joint.place(&first.theta, t)).collect(),
        other: other.map(|second| plane(second.u())),
    })
}

fn plane(u: DVec3) -> Plane {
    Plane { point: DVec3::Z / u.z, normal: -u.normalize() }
}

fn angle(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// A minimum of the sum of squares.
#[derive(Clone, Debug)]
struct Minimum {
    theta: Vec<f64>,
    squares: f64,
    /// Which points count.
    used: Vec<bool>,
}

impl Minimum {
    fn u(&self) -> DVec3 {
        DVec3::new(self.theta[0], self.theta[1], self.theta[2])
    }

    fn count(&self) -> f64 {
        self.used.iter().filter(|u| **u).count() as f64
    }

    fn rms(&self) -> f64 {
        (self.squares / self.count().max(1.0)).sqrt()
    }

    /// Standard deviation of a point.
    fn sigma(&self) -> f64 {
        (self.squares / (self.count() - self.theta.len() as f64).max(1.0)).sqrt()
    }
}

struct Search<'a> {
    squares: &'a [Square],
    focal: DVec2,
    size: f64,
}

impl Search<'_> {
    /// Minima of one square, the best first.
    fn minima(&self) -> Vec<Minimum> {
        let square = &self.squares[0];
        let corners: [Vec<DVec2>; 4] =
            std::array::from_fn(|k| vec![square.corners[k], square.corners[(k + 1) % 4]]);
        let rough = [Square { corners: square.corners, sides: corners }];
        let search = Search { squares: &rough, ..*self };
        let centre = square.corners.iter().sum::<DVec2>() / 4.0 / self.focal;
        let across = square.corners[1] - square.corners[0];
        let longest = (0..4)
            .map(|k| ((square.corners[k] - square.corners[(k + 1) % 4]) / self.focal).length())
            .fold(0.0, f64::max);
        let starts = [(0.0, 0.0), (0.7, 0.0), (-0.7, 0.0), (0.0, 0.7), (0.0, -0.7)];
        let found = starts.into_iter().filter_map(|(x, y)| {
            let away = DVec3::new(centre.x + x, centre.y + y, 1.0);
            let u = away / away.dot(centre.extend(1.0)) * longest / self.size;
            let theta = vec![u.x, u.y, u.z, centre.x, centre.y, across.to_angle()];
            let theta = search.descend(theta, &[true; 8])?;
            let squares = search.sum(&theta, &[true; 8])?;
            Some(Minimum { theta, squares, used: vec![true; 8] })
        });
        let rough = distinct(found.collect());
        distinct(rough.into_iter().filter_map(|m| self.refine(m.theta)).collect())
    }

    /// Minima of all squares in one plane, from the squares' own.
    fn joint_minima(&self, own: &[Vec<Minimum>]) -> Vec<Minimum> {
        let found = [true, false].into_iter().filter_map(|best| {
            let choose = |minima: &[Minimum]| if best { 0 } else { minima.len().saturating_sub(1) };
            let picked: Vec<&Minimum> = own.iter().map(|m| m.get(choose(m))).collect::<Option<_>>()?;
            // The plane through their corners.
            let mut plane = Normal::zero(3);
            for (t, minimum) in picked.iter().enumerate() {
                let alone = Search { squares: &self.squares[t..=t], ..*self };
                let place = alone.place(&minimum.theta, 0);
                for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                    let p = place.centre + self.size * (x * place.axes[0] + y * place.axes[1]);
                    plane.add(&p.to_array(), 1.0, 1.0);
                }
            }
            let (plane, _) = plane.solve()?;
            let mut theta = plane.as_slice().to_vec();
            picked.iter().for_each(|m| theta.extend(&m.theta[3..]));
            self.refine(theta)
        });
        distinct(found.collect())
    }

    /// All points, then without those that lie far off.
    fn refine(&self, theta: Vec<f64>) -> Option<Minimum> {
        let all = vec![true; self.residuals(&theta)?.len()];
        let theta = self.descend(theta, &all)?;
        let sizes: Vec<f64> = self.residuals(&theta)?.iter().map(|r| r.abs()).collect();
        let mut sorted = sizes.clone();
        sorted.sort_by(f64::total_cmp);
        // Of a normal distribution half lies within 0.6745 standard deviations.
        let most = OUTLIER * (sorted.get(sorted.len() / 2)? / 0.6745).max(SIDE_ERROR);
        let used: Vec<bool> = sizes.iter().map(|size| *size <= most).collect();
        let theta = self.descend(theta, &used)?;
        let squares = self.sum(&theta, &used)?;
        Some(Minimum { theta, squares, used })
    }

    fn place(&self, theta: &[f64], t: usize) -> Place {
        let u = DVec3::new(theta[0], theta[1], theta[2]);
        let [x, y, turn] = std::array::from_fn(|i| theta[3 + 3 * t + i]);
        let away = u.normalize();
        let right = (DVec3::X - away.x * away).normalize_or(DVec3::Y);
        let down = away.cross(right);
        let ray = DVec3::new(x, y, 1.0);
        let centre = ray / u.dot(ray);
        let (sin, cos) = turn.sin_cos();
        let axes = [cos * right + sin * down, cos * down - sin * right];
        let corner = |x: f64, y: f64| {
            let p = centre + self.size * (x * axes[0] + y * axes[1]);
            p.truncate() / p.z * self.focal
        };
        let corners = [corner(-0.5, -0.5), corner(0.5, -0.5), corner(0.5, 0.5), corner(-0.5, 0.5)];
        Place { centre, axes, corners }
    }

    /// Distances of all points from their sides, outside positive; `None` if any of it is not before the camera.
    fn residuals(&self, theta: &[f64]) -> Option<Vec<f64>> {
        let mut out = vec![];
        for (t, square) in self.squares.iter().enumerate() {
            let place = self.place(theta, t);
            let near = place.centre.z - self.size * (place.axes[0].z.abs() + place.axes[1].z.abs()) / 2.0;
            if near.is_nan() || near <= 0.0 {
                return None;
            }
            for (k, points) in square.sides.iter().enumerate() {
                let (from, to) = (place.corners[k], place.corners[(k + 1) % 4]);
                let along = (to - from).try_normalize()?;
                out.extend(points.iter().map(|p| (*p - from).perp_dot(along)));
            }
        }
        Some(out)
    }

    fn sum(&self, theta: &[f64], used: &[bool]) -> Option<f64> {
        let residuals = self.residuals(theta)?;
        Some(residuals.iter().zip(used).filter(|(_, u)| **u).map(|(r, _)| r * r).sum())
    }

    /// Derivatives of the residuals by differences, a column each unknown; 0 of points that do not count.
    fn slopes(&self, theta: &[f64], used: &[bool]) -> Option<DMatrix<f64>> {
        let scale = DVec3::new(theta[0], theta[1], theta[2]).length();
        let mut slopes = DMatrix::zeros(used.len(), theta.len());
        for (i, mut column) in slopes.column_iter_mut().enumerate() {
            let step = 1e-6 * if i < 3 { scale } else { 1.0 };
            let shifted = |by: f64| {
                let mut theta = theta.to_vec();
                theta[i] += by;
                self.residuals(&theta)
            };
            let (high, low) = (shifted(step)?, shifted(-step)?);
            for (k, slope) in column.iter_mut().enumerate().filter(|(k, _)| used[*k]) {
                *slope = (high[k] - low[k]) / (2.0 * step);
            }
        }
        Some(slopes)
    }

    fn normal(&self, theta: &[f64], used: &[bool]) -> Option<Normal> {
        Some(Normal::of(&self.slopes(theta, used)?, &DVector::from_vec(self.residuals(theta)?)))
    }

    fn descend(&self, mut theta: Vec<f64>, used: &[bool]) -> Option<Vec<f64>> {
        let (mut damping, mut best) = (1e-3, self.sum(&theta, used)?);
        for _ in 0..MOST_STEPS {
            let normal = self.normal(&theta, used)?;
            let mut moved = false;
            while damping < 1e8 {
                let step = normal.damped(damping).solve().map(|(step, _)| step);
                let next = step.map(|s| theta.iter().zip(&s).map(|(t, s)| t - s).collect::<Vec<_>>());
                let after = next.as_ref().and_then(|next| self.sum(next, used));
                if let (Some(next), Some(after)) = (next, after)
                    && after <= best
                {
                    moved = best - after > 1e-10 * best;
                    (theta, best, damping) = (next, after, damping * 0.1);
                    break;
                }
                damping *= 10.0;
            }
            if !moved {
                break;
            }
        }
        Some(theta)
    }

    /// Standard error of the distance, and root mean square angle of the normal.
    fn errors(&self, minimum: &Minimum, sigma: f64) -> Option<(f64, f64)> {
        let slopes = self.slopes(&minimum.theta, &minimum.used)?;
        let inverse = inverse(&slopes.tr_mul(&slopes))?;
        let mut covariance = &inverse * (sigma * sigma);
        let mut add = |points: std::ops::Range<usize>, error: f64| {
            let shift = &inverse * slopes.rows_range(points).row_sum_tr();
            covariance.ger(error * error, &shift, &shift, 1.0);
        };
        // What the points of a side have in common, and what all have.
        let mut first = 0;
        for points in self.squares.iter().flat_map(|s| &s.sides) {
            add(first..first + points.len(), SIDE_ERROR);
            first += points.len();
        }
        add(0..first, GROWTH_ERROR);
        let u = minimum.u();
        let distance = covariance[(2, 2)].max(0.0).sqrt() / (u.z * u.z);
        // The part of u across itself turns the normal.
        let (away, of_u) = (Vector3::from(u.normalize().to_array()), covariance.fixed_view::<3, 3>(0, 0));
        let along = away.dot(&(of_u * away));
        let normal = (of_u.trace() - along).max(0.0).sqrt() / u.length();
        (distance.is_finite() && normal.is_finite()).then_some((distance, normal))
    }
}

/// The best of each place, the best first.
fn distinct(mut found: Vec<Minimum>) -> Vec<Minimum> {
    found.retain(|m| m.u().z > 0.0 && m.squares.is_finite());
    found.sort_by(|a, b| a.squares.total_cmp(&b.squares));
    let mut kept: Vec<Minimum> = vec![];
    for minimum in found {
        if kept.iter().all(|k| angle(k.u(), minimum.u()) > SAME) {
            kept.push(minimum);
        }
    }
    kept.truncate(2);
    kept
}
