//! The curve, its order and its errors.

use super::{FValues, FlatCalibration, FlatField, FlatFitError, KEEP, ProfilePoint, same_optics};
use crate::calibration::linear::Normal;
use crate::calibration::statistics::Z95;
use crate::calibration::tiles::{EvenFrame, Tile, Tiles};
use nalgebra::DMatrix;

/// Largest relative standard error of a frame's mean light that is a measurement.
const DARKEST: f64 = 0.02;
/// Largest share of a frame's tiles and colours that may be over-exposed, or cut off at 0 DN: what one frame lacks, none can
/// give.
const MOST_LOST: f64 = 0.02;
/// Least tiles of a colour.
const FEWEST: usize = 24;
/// Least light at q = 1 against the centre that a lens gives.
const DARKEST_CORNER: f64 = 0.05;
/// 1 % points of F(2 n, many) for n coefficients: below, one curve for all colours will do.
const COLOURS_KEEP: [f64; 3] = [4.61, 3.32, 2.80];
/// Most parts of the residual map along a side.
const MAP: usize = 12;
/// Points of the profile.
const RINGS: usize = 12;
/// Rounds of Gauss and Newton; three are enough for a double's digits.
const ROUNDS: usize = 6;

/// One colour of one tile, all frames together.
struct Point {
    tile: usize,
    colour: usize,
    /// Means of q, q^2, q^3 over the tile.
    powers: [f64; 3],
    /// Place from -1 to 1 across and down.
    place: [f64; 2],
    value: f64,
    variance: f64,
}

struct Fit {
    order: usize,
    per_channel: bool,
    /// Light at the centre by colour.
    strength: [f64; 3],
    field: FlatField,
    gradient: [f64; 2],
    covariance: DMatrix<f64>,
    chi2: f64,
    freedom: f64,
    /// What each of the higher orders would change at the corner, root of the sum of squares.
    selection: f64,
}

/// Fits the flat field to frames in any number. Gives it, and for each frame left out its place and why.
pub fn fit_flat(frames: &[EvenFrame]) -> Result<(FlatCalibration, Vec<(usize, String)>), FlatFitError> {
    let Some(first) = frames.first() else {
        return Err(FlatFitError::Nothing("none was given".into()));
    };
    let told = |f: &EvenFrame| (f.settings.focal_length_mm, f.settings.aperture);
    let mut optics = told(first);
    for (i, frame) in frames.iter().enumerate() {
        if frame.tiles.size != first.tiles.size {
            return Err(FlatFitError::Sizes(first.tiles.size, frame.tiles.size));
        }
        same_optics(optics, &frame.settings, "the first frame")
            .map_err(|source| FlatFitError::Other { frame: i + 1, source })?;
        optics = (optics.0.or(told(frame).0), optics.1.or(told(frame).1));
    }
    let judged: Vec<Option<String>> = frames.iter().map(|f| unfit(&f.tiles)).collect();
    let used: Vec<&Tiles> =
        frames.iter().zip(&judged).filter(|(_, why)| why.is_none()).map(|(f, _)| &f.tiles).collect();
    let left_out: Vec<(usize, String)> =
        judged.iter().enumerate().filter_map(|(i, why)| Some((i, why.clone()?))).collect();
    if used.is_empty() {
        return Err(FlatFitError::Nothing(left_out.into_iter().map(|l| l.1).next().unwrap_or_default()));
    }
    let points = points(&used);
    let colours: Vec<usize> = (0..3).filter(|&c| points.iter().any(|p| p.colour == c)).collect();
    let all = used.first().map_or(0, |t| t.tiles.len());
    let share = points.len() as f64 / (all * colours.len().max(1)) as f64;
    let enough = |&c: &usize| points.iter().filter(|p| p.colour == c).count() >= FEWEST;
    let cut: f64 = used.iter().map(|tiles| tiles.cut_off - tiles.over_exposed).sum();
    let lost = if cut > 0.0 { "cut off at 0 DN; take more light" } else { "over-exposed; take less light" };
    let little = || FlatFitError::Little { left: 100.0 * share, lost };
    if colours.is_empty() || !colours.iter().all(enough) {
        return Err(little());
    }
    let (fit, f_values) = choose(&points, &colours).ok_or_else(little)?;
    let lowest = colours.iter().map(|&c| fit.field.at_q(1.0, c)).fold(f64::INFINITY, f64::min);
    if lowest.is_nan() || lowest < DARKEST_CORNER {
        return Err(FlatFitError::Uneven(lowest));
    }
    let calibration = told_by(&points, &fit, f_values, &used, share, optics, &colours);
    Ok((calibration, left_out))
}

/// Why a frame tells no vignetting.
fn unfit(tiles: &Tiles) -> Option<String> {
    if tiles.over_exposed > MOST_LOST {
        return Some(format!(
            "over-exposed in {:.0} % of the frame; take less light",
            100.0 * tiles.over_exposed
        ));
    }
    if tiles.cut_off > MOST_LOST {
        return Some(format!(
            "too dark: {:.0} % of the frame is cut off at 0 DN; take more light",
            100.0 * tiles.cut_off
        ));
    }
    let all = || tiles.tiles.iter().flatten().flatten();
    let light: f64 = all().map(|t| t.sites * t.mean).sum();
    let error = all().map(|t| t.sites * t.sites * t.variance).sum::<f64>().sqrt();
    (error.is_nan() || light <= 0.0 || error > DARKEST * light)
        .then(|| "too dark to measure; take more light".to_owned())
}

/// Frames added up.
fn points(frames: &[&Tiles]) -> Vec<Point> {
    let Some(first) = frames.first() else { return vec![] };
    let mut out = vec![];
    for tile in 0..first.tiles.len() {
        for colour in 0..3 {
            let all: Option<Vec<Tile>> =
                frames.iter().map(|f| f.tiles.get(tile).and_then(|t| t[colour])).collect();
            let Some(all) = all else { continue };
            let value = all.iter().map(|t| t.mean).sum();
            let variance: f64 = all.iter().map(|t| t.variance).sum();
            if variance > 0.0 {
                let (powers, place) = geometry(first, tile, colour);
                out.push(Point { tile, colour, powers, place, value, variance });
            }
        }
    }
    out
}

/// Means of q, q^2, q^3 over a colour's sites of a tile (three Gauss points a side) and the tile's centre.
fn geometry(tiles: &Tiles, tile: usize, colour: usize) -> ([f64; 3], [f64; 2]) {
    const POINTS: [(f64, f64); 3] =
        [(-0.774_596_669_241_483_4, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.774_596_669_241_483_4, 5.0 / 18.0)];
    let half = [tiles.size.0 as f64 / 2.0, tiles.size.1 as f64 / 2.0];
    let diagonal = half[0] * half[0] + half[1] * half[1];
    let reach = tiles.reach(tile);
    let middle: [f64; 2] = [0, 1].map(|a| (reach[a].0 + reach[a].1) as f64 / 2.0 - half[a]);
    let extent: [f64; 2] = [0, 1].map(|a| (reach[a].1 - reach[a].0) as f64 / 2.0);
    let aside = tiles.cfa.aside(colour);
    let mut powers = [0.0; 3];
    for (u, wu) in POINTS {
        for (v, wv) in POINTS {
            let x = middle[0] + aside[0] + u * extent[0];
            let y = middle[1] + aside[1] + v * extent[1];
            let q = (x * x + y * y) / diagonal;
            powers.iter_mut().enumerate().for_each(|(n, p)| *p += wu * wv * q.powi(n as i32 + 1));
        }
    }
    (powers, [0, 1].map(|a| middle[a] / half[a]))
}

/// The least model that the data want.
fn choose(points: &[Point], colours: &[usize]) -> Option<(Fit, FValues)> {
    let mut fit = solve_model(points, colours, 3, false)?;
    let mut values = FValues { highest_coefficient: vec![], per_channel: None };
    while fit.order > 0 {
        let lesser = solve_model(points, colours, fit.order - 1, false)?;
        let f = (lesser.chi2 - fit.chi2) / excess(&fit);
        values.highest_coefficient.push(f);
        if f > KEEP {
            break;
        }
        let change = fit.field.at_q(1.0, 0) - lesser.field.at_q(1.0, 0);
        fit = Fit { selection: fit.selection.hypot(change), ..lesser };
    }
    if fit.order > 0
        && colours.len() > 1
        && let Some(own) = solve_model(points, colours, fit.order, true)
    {
        let more = (fit.order * (colours.len() - 1)) as f64;
        let f = (fit.chi2 - own.chi2) / more / excess(&own);
        values.per_channel = Some(f);
        if COLOURS_KEEP.get(fit.order - 1).is_some_and(|limit| f > *limit) {
            fit = Fit { selection: fit.selection, ..own };
        }
    }
    Some((fit, values))
}

/// Place of a coefficient among the unknowns: strengths first, then coefficients, then the gradient.
fn place(order: usize, colours: &[usize], per_channel: bool, colour: usize, power: usize) -> usize {
    let own = if per_channel { colours.iter().position(|&c| c == colour).unwrap_or(0) * order } else { 0 };
    colours.len() + own + power
}

fn solve_model(points: &[Point], colours: &[usize], order: usize, per_channel: bool) -> Option<Fit> {
    let curves = if per_channel { colours.len() } else { 1 };
    let gradient_at = colours.len() + curves * order;
    let unknowns = gradient_at + 2;
    let mut x = vec![0.0; unknowns];
    for (i, &c) in colours.iter().enumerate() {
        let own = || points.iter().filter(|p| p.colour == c);
        x[i] = own().map(|p| p.value).sum::<f64>() / own().count().max(1) as f64;
    }
    let (mut covariance, mut chi2) = (DMatrix::zeros(0, 0), 0.0);
    let mut row = vec![0.0; unknowns];
    for round in 0..=ROUNDS {
        let mut normal = Normal::zero(unknowns);
        chi2 = 0.0;
        for p in points {
            let at = colours.iter().position(|&c| c == p.colour)?;
            let (s, first) = (x[at], place(order, colours, per_channel, p.colour, 0));
            let curve: f64 = (0..order).map(|n| x[first + n] * p.powers[n]).sum();
            let shape = 1.0 + curve + x[gradient_at] * p.place[0] + x[gradient_at + 1] * p.place[1];
            row.fill(0.0);
            row[at] = shape;
            (0..order).for_each(|n| row[first + n] = s * p.powers[n]);
            row[gradient_at] = s * p.place[0];
            row[gradient_at + 1] = s * p.place[1];
            let rest = p.value - s * shape;
            chi2 += rest * rest / p.variance;
            normal.add(&row, rest, p.variance.recip());
        }
        let (step, inverse) = normal.solve()?;
        covariance = inverse;
        let moved = x.iter().zip(&step).any(|(x, d)| d.abs() > 1e-10 * (x.abs() + 1e-3));
        if round == ROUNDS || !moved {
            break;
        }
        x.iter_mut().zip(&step).for_each(|(x, d)| *x += d);
    }
    let freedom = points.len() as f64 - unknowns as f64;
    if freedom <= 0.0 || x.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let mut fit = Fit {
        order,
        per_channel,
        strength: [0.0; 3],
        field: FlatField { coefficients: [[0.0; 3]; 3] },
        gradient: [x[gradient_at], x[gradient_at + 1]],
        covariance,
        chi2: chi2.max(f64::MIN_POSITIVE),
        freedom,
        selection: 0.0,
    };
    for colour in 0..3 {
        for n in 0..order {
            fit.field.coefficients[colour][n] = x[place(order, colours, per_channel, colour, n)];
        }
    }
    for (i, &c) in colours.iter().enumerate() {
        fit.strength[c] = x[i];
    }
    Some(fit)
}

/// chi^2 per degree of freedom, but no less than noise makes it: the tiles' variances are known.
fn excess(fit: &Fit) -> f64 {
    (fit.chi2 / fit.freedom).max(1.0)
}

fn told_by(
    points: &[Point],
    fit: &Fit,
    f_values: FValues,
    used: &[&Tiles],
    share: f64,
    (focal_length_mm, aperture): (Option<f64>, Option<crate::units::FNumber>),
    colours: &[usize],
) -> FlatCalibration {
    let excess = excess(fit);
    let interval = |value: f64, variance: f64, more: f64| {
        let half = Z95 * (variance.max(0.0) * excess + more * more).sqrt();
        [value - half, value + half]
    };
    let corner: [f64; 3] = std::array::from_fn(|c| fit.field.at_q(1.0, c));
    let corner_interval_95 = std::array::from_fn(|c| {
        let first = place(fit.order, colours, fit.per_channel, c, 0);
        let own = first..first + fit.order;
        let variance = own.clone().flat_map(|i| own.clone().map(move |j| (i, j)));
        let variance = variance.map(|(i, j)| fit.covariance[(i, j)]).sum();
        interval(corner[c], variance, fit.selection)
    });
    let gradient_at = fit.covariance.nrows() - 2;
    let light_gradient_interval_95 =
        [0, 1].map(|a| interval(fit.gradient[a], fit.covariance[(gradient_at + a, gradient_at + a)], 0.0));
    let model = |p: &Point| {
        let [a, b, c] = fit.field.coefficients[p.colour];
        let curve = a * p.powers[0] + b * p.powers[1] + c * p.powers[2];
        fit.strength[p.colour] * (1.0 + curve + fit.gradient[0] * p.place[0] + fit.gradient[1] * p.place[1])
    };
    let squares: f64 = points.iter().map(|p| (p.value / model(p) - 1.0).powi(2)).sum();
    let grid = used.first().map_or((1, 1), |t| t.grid);
    let (residual_map, residual_map_standard_error) = map(points, model, grid);
    let slope = |p: &Point| fit.gradient[0] * p.place[0] + fit.gradient[1] * p.place[1];
    let profile = std::array::from_fn(|c| {
        let light = |p: &Point| (p.value / fit.strength[c] - slope(p), p.variance / fit.strength[c].powi(2));
        let own: Vec<(f64, f64, f64)> = points
            .iter()
            .filter(|p| p.colour == c)
            .map(|p| (p.powers[0].sqrt(), light(p).0, light(p).1))
            .collect();
        (0..RINGS).filter_map(|ring| ring_mean(&own, ring)).collect()
    });
    FlatCalibration {
        focal_length_mm,
        aperture,
        vignetting: fit.field,
        order: fit.order,
        per_channel: fit.per_channel,
        f_values,
        corner,
        corner_interval_95,
        light_gradient: fit.gradient,
        light_gradient_interval_95,
        chi_squared: fit.chi2 / fit.freedom,
        residual_rms: (squares / points.len().max(1) as f64).sqrt(),
        residual_map,
        residual_map_standard_error,
        profile,
        frames: used.len(),
        used_share: share,
    }
}

/// Mean distance, light and its standard error of the points in one ring.
fn ring_mean(points: &[(f64, f64, f64)], ring: usize) -> Option<ProfilePoint> {
    let inside = || points.iter().filter(|p| ((p.0 * RINGS as f64) as usize).min(RINGS - 1) == ring);
    let n = inside().count() as f64;
    let sum = inside().fold([0.0; 3], |[r, v, e], p| [r + p.0, v + p.1, e + p.2]);
    let [radius, light, light_standard_error] = [sum[0] / n, sum[1] / n, sum[2].sqrt() / n];
    (n > 0.0).then_some(ProfilePoint { radius, light, light_standard_error })
}

/// Weighted means of the relative residuals in parts of the frame, and the median of their standard errors.
fn map(
    points: &[Point],
    model: impl Fn(&Point) -> f64,
    grid: (usize, usize),
) -> (Vec<Vec<Option<f64>>>, f64) {
    let (columns, rows) = (grid.0.min(MAP), grid.1.min(MAP * 2 / 3));
    let mut sums = vec![vec![(0.0, 0.0); columns]; rows];
    for p in points {
        let (row, column) = (p.tile / grid.0 * rows / grid.1, p.tile % grid.0 * columns / grid.0);
        let m = model(p);
        let weight = m * m / p.variance;
        sums[row][column].0 += weight * (p.value / m - 1.0);
        sums[row][column].1 += weight;
    }
    let mut errors: Vec<f64> =
        sums.iter().flatten().filter(|s| s.1 > 0.0).map(|s| (1.0 / s.1).sqrt()).collect();
    errors.sort_by(f64::total_cmp);
    let parts = sums.into_iter().map(|row| row.into_iter().map(|(v, w)| (w > 0.0).then(|| v / w)).collect());
    (parts.collect(), errors.get(errors.len() / 2).copied().unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pair::Settings;
    use crate::photometry::Cfa;

    #[test]
    fn a_frame_that_is_cut_off_at_nought_wants_more_light_and_not_less() {
        let tile = Tile { mean: 5000.0, variance: 100.0, sites: 16.0 };
        let whole = Tiles {
            size: (120, 80),
            cfa: Cfa::RGGB,
            grid: (15, 10),
            tiles: vec![[Some(tile); 3]; 150],
            over_exposed: 0.0,
            cut_off: 0.0,
        };
        let told = |tiles: Tiles| {
            fit_flat(&[EvenFrame { settings: Settings::default(), tiles }]).unwrap_err().to_string()
        };
        let dark = told(Tiles { cut_off: 0.4, ..whole.clone() });
        assert!(
            dark.contains("too dark: 40 % of the frame is cut off") && dark.contains("more light"),
            "{dark}"
        );
        // Of a small frame even less is too much.
        let mut small = whole;
        small.tiles[20..].fill([None; 3]);
        let little = told(Tiles { cut_off: 0.02, ..small.clone() });
        assert!(little.contains("too little") && little.contains("more light"), "{little}");
        let bright = told(Tiles { over_exposed: 0.02, ..small });
        assert!(bright.contains("too little") && bright.contains("less light"), "{bright}");
    }
}
