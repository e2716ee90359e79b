//! Least squares with few columns, chosen one after the other: which of several possible causes explain a series.
//!
//! Forward selection by orthogonal projection (Draper and Smith, "Applied regression analysis", ch. 15): of all
//! candidate columns, orthogonalised against those already in, the one that takes most off the sum of squares
//! comes in, as long as its F value is high enough.

/// A column that came in.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Chosen {
    /// Index among the candidates.
    pub(super) candidate: usize,
    /// Its coefficient, everything chosen fitted together.
    pub(super) coefficient: f64,
}

/// What was chosen.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fit {
    /// The constant.
    pub(super) constant: f64,
    /// In the order in which they came in.
    pub(super) chosen: Vec<Chosen>,
}

/// A candidate: its group (at most one of each group comes in) and its values.
pub(super) struct Candidate {
    pub(super) group: usize,
    pub(super) values: Vec<f64>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `values` less its projections on the orthogonal `basis`; the projections' coefficients too.
fn orthogonal(values: &[f64], basis: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
    let (mut rest, mut shares) = (values.to_vec(), Vec::with_capacity(basis.len()));
    for b in basis {
        let share = dot(&rest, b) / dot(b, b);
        rest.iter_mut().zip(b).for_each(|(r, b)| *r -= share * b);
        shares.push(share);
    }
    (rest, shares)
}

/// Explains `series` by a constant and those candidates whose F value exceeds `least_f`.
pub(super) fn explain(series: &[f64], candidates: &[Candidate], least_f: f64) -> Fit {
    let n = series.len();
    let mut basis = vec![vec![1.0; n]];
    // Rows of the triangle by which a chosen column is made of the basis.
    let mut triangle: Vec<Vec<f64>> = vec![];
    let mut chosen: Vec<usize> = vec![];
    let (mut rest, mut projections) = orthogonal(series, &basis);
    loop {
        let sum = dot(&rest, &rest);
        let free = n as f64 - basis.len() as f64 - 1.0;
        let taken = |i: &usize| chosen.iter().any(|c| candidates[*c].group == candidates[*i].group);
        let best = (0..candidates.len())
            .filter(|i| !taken(i))
            .filter_map(|i| {
                let (column, shares) = orthogonal(&candidates[i].values, &basis);
                let length = dot(&column, &column);
                // A column that the others already make up says nothing.
                (length > 1e-9 * dot(&candidates[i].values, &candidates[i].values))
                    .then(|| (i, dot(&rest, &column).powi(2) / length, column, shares))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((i, gain, column, shares)) = best else { break };
        let left = (sum - gain).max(0.0);
        if free < 1.0 || gain * free <= least_f * left {
            break;
        }
        projections.push(dot(&rest, &column) / dot(&column, &column));
        rest = orthogonal(&rest, std::slice::from_ref(&column)).0;
        basis.push(column);
        triangle.push(shares);
        chosen.push(i);
    }
    // Back substitution: column k = basis k+1 + sum of shares of the basis before.
    let mut coefficients = projections;
    for k in (0..chosen.len()).rev() {
        for (j, share) in triangle[k].iter().enumerate() {
            coefficients[j] -= share * coefficients[k + 1];
        }
    }
    let constant = coefficients[0];
    let chosen = chosen.into_iter().zip(&coefficients[1..]);
    let chosen = chosen.map(|(candidate, &coefficient)| Chosen { candidate, coefficient }).collect();
    Fit { constant, chosen }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_causes_of_a_series_are_found_with_their_coefficients_and_nothing_else() {
        let n = 40;
        let series_of = |f: fn(f64) -> f64| (0..n).map(|i| f(i as f64)).collect::<Vec<f64>>();
        let (a, b, c) = (series_of(|i| i), series_of(|i| (-i / 5.0).exp()), series_of(|i| (1.7 * i).sin()));
        let noise = series_of(|i| 1e-3 * (7.3 * i * i).sin());
        let series: Vec<f64> = (0..n).map(|i| 5.0 + 0.2 * a[i] - 3.0 * b[i] + noise[i]).collect();
        let candidates = [a, b, c]
            .into_iter()
            .enumerate()
            .map(|(group, values)| Candidate { group, values })
            .collect::<Vec<_>>();
        let fit = explain(&series, &candidates, 12.0);
        assert!((fit.constant - 5.0).abs() < 2e-3, "{fit:?}");
        let mut found = fit.chosen.clone();
        found.sort_by_key(|c| c.candidate);
        assert_eq!(found.iter().map(|c| c.candidate).collect::<Vec<_>>(), [0, 1]);
        assert!((found[0].coefficient - 0.2).abs() < 1e-3 && (found[1].coefficient + 3.0).abs() < 3e-3);
    }

    #[test]
    fn noise_alone_has_no_cause_and_short_series_do_not_break_it() {
        let noise: Vec<f64> = (0..30).map(|i| (12.9898 * f64::from(i * i)).sin()).collect();
        let line = |n: u32| (0..n).map(f64::from).collect::<Vec<f64>>();
        let one = |n| [Candidate { group: 0, values: line(n) }];
        assert_eq!(explain(&noise, &one(30), 12.0).chosen, []);
        for n in 0..4u32 {
            assert_eq!(explain(&line(n), &one(n), 12.0).chosen.len(), usize::from(n >= 3), "{n}");
        }
    }
}
