//! The photon transfer line: variance = gain * signal + floor.
//!
//! A variance estimated with nu degrees of freedom spreads by sqrt(2 / nu) of itself, and sensors keep to a straight line
//! to some 2 % only, which counts where tiles are large; so each point weighs by 1 / ((2 / nu + 0.02^2) m^2), m being the
//! line's own value there (not the measured one: that would favour low values). Solved anew
//! until it stands; points further than six standard deviations from the line (something moved, a lamp flickered) drop
//! out and are counted.

use crate::calibration::linear::Normal;

/// Standard deviations from the line beyond which a point is left out.
const REJECT: f64 = 6.0;
/// How far, of the variance, a sensor may depart from the line and still be told by it.
const MISFIT: f64 = 0.02;
/// Least variance that the line is given, DN^2: half of what rounding alone makes.
const LEAST: f64 = 1.0 / 24.0;
/// Points of about the same signal from whose median the first line starts.
const BINS: usize = 12;

/// A measured variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    /// DN above black.
    pub(super) signal: f64,
    /// DN^2.
    pub(super) variance: f64,
    /// Degrees of freedom of `variance`.
    pub(super) freedom: f64,
}

/// The fitted line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    /// DN^2 per DN.
    pub(super) gain: f64,
    /// DN^2, rounding included.
    pub(super) floor: f64,
    /// Variances of gain and floor, and their covariance; widened where the points scatter more than they should.
    pub(super) of_gain: f64,
    pub(super) of_floor: f64,
    pub(super) covariance: f64,
    /// Sum of squared residuals in standard deviations, per degree of freedom: 1 if the model holds.
    pub(super) chi_squared: f64,
    /// Share of the points that were left out.
    pub(super) rejected: f64,
}

impl Line {
    pub(super) fn at(&self, signal: f64) -> f64 {
        (self.gain * signal + self.floor).max(LEAST)
    }
}

/// Fits the line; `None` unless there are eight points, at more than one signal, and gain comes out positive.
pub(super) fn fit(points: &[Point]) -> Option<Line> {
    if points.len() < 8 {
        return None;
    }
    let spread = |p: &Point| 2.0 / p.freedom + MISFIT * MISFIT;
    let points: &[Point] =
        &points.iter().map(|p| Point { freedom: 2.0 / spread(p), ..*p }).collect::<Vec<_>>();
    let mut model = medians(points);
    let mut line = None;
    for _ in 0..15 {
        let solved = solve(points, &model)?;
        model = points.iter().map(|p| solved.at(p.signal)).collect();
        line = Some(solved);
    }
    let mut line = line?;
    let (mut sum, mut kept) = (0.0, 0.0);
    for (p, &m) in points.iter().zip(&model).filter(|(p, m)| fits(p, **m)) {
        sum += ((p.variance - m) / m).powi(2) * p.freedom / 2.0;
        kept += 1.0;
    }
    line.chi_squared = sum / (kept - 2.0f64).max(1.0);
    line.rejected = 1.0 - kept / points.len() as f64;
    let wider = line.chi_squared.max(1.0);
    line.of_gain *= wider;
    line.of_floor *= wider;
    line.covariance *= wider;
    (line.gain > 0.0 && line.gain.is_finite() && line.floor.is_finite()).then_some(line)
}

fn fits(point: &Point, model: f64) -> bool {
    (point.variance / model - 1.0).abs() <= REJECT * (2.0 / point.freedom).sqrt()
}

/// For each point the median variance of points of about its signal.
fn medians(points: &[Point]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a].signal.total_cmp(&points[b].signal));
    let mut model = vec![0.0; points.len()];
    for bin in order.chunks(points.len().div_ceil(BINS)) {
        let mut variances: Vec<f64> = bin.iter().map(|&i| points[i].variance).collect();
        variances.sort_by(f64::total_cmp);
        let median = variances[variances.len() / 2].max(LEAST);
        bin.iter().for_each(|&i| model[i] = median);
    }
    model
}

/// Weighted least squares with the weights of a model.
fn solve(points: &[Point], model: &[f64]) -> Option<Line> {
    let mut normal = Normal::zero(2);
    for (p, &m) in points.iter().zip(model).filter(|(p, m)| fits(p, **m)) {
        normal.add(&[p.signal, 1.0], p.variance, p.freedom / (2.0 * m * m));
    }
    let (solution, covariance) = normal.solve()?;
    Some(Line {
        gain: solution[0],
        floor: solution[1],
        of_gain: covariance[(0, 0)],
        of_floor: covariance[(1, 1)],
        covariance: covariance[(0, 1)],
        chi_squared: 0.0,
        rejected: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_give_that_line_and_one_signal_gives_none() {
        let on = |signal: f64| Point { signal, variance: 0.3 * signal + 2.3, freedom: 61.0 };
        let mut points: Vec<Point> = (0..40).map(|i| on(f64::from(i * i))).collect();
        points.push(Point { variance: 900.0, ..on(800.0) });
        let line = fit(&points).unwrap();
        assert!((line.gain - 0.3).abs() < 1e-9 && (line.floor - 2.3).abs() < 1e-6, "{line:?}");
        assert!((line.rejected - 1.0 / 41.0).abs() < 1e-9 && line.chi_squared < 1e-9);
        assert_eq!(fit(&vec![on(500.0); 40]), None);
        assert_eq!(fit(&points[..7]), None);
    }

    #[test]
    fn large_tiles_ask_no_more_of_a_sensor_than_a_sensor_gives() {
        // A variance that bends by 3 % over the range, from tiles of 96 x 96 sites a colour.
        let bent = |signal: f64| (0.3 * signal + 2.3) * (1.0 + 0.03 * (signal / 1600.0 - 0.5));
        let point = |i: i32| f64::from(i * i);
        let points: Vec<Point> =
            (0..40).map(|i| Point { signal: point(i), variance: bent(point(i)), freedom: 9000.0 }).collect();
        let line = fit(&points).unwrap();
        assert!(line.rejected == 0.0 && line.chi_squared < 1.0, "{line:?}");
        assert!((line.gain / 0.3 - 1.0).abs() < 0.03, "{line:?}");
    }
}
