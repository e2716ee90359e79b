//! The reflectance of one point from all its observations.
//!
//! Weighted least squares through the origin, `rho = sum w m P / sum w m^2` with w = resolution / variance: a
//! view counts by the light it had (m), by its noise and by how finely it sees the point, so that grazing and
//! far views fade out by themselves. Robust: the start is the weighted median of the ratios, then Tukey's
//! biweight (Beaton and Tukey 1974) takes out the views that disagree (highlights, misregistration), all three
//! channels of a view together. How far views may part is taken from their own spread (the median of their
//! distances): fine texture makes them part more than noise does, and an outlier is what parts more than the others.

/// Tukey's constant: 95 % efficiency on Gaussian errors.
pub(super) const TUKEY: f32 = 4.685;

/// Median of the absolute value of a Gaussian, so that a median of distances becomes a standard deviation.
pub(super) const MEDIAN_OF_NORMAL: f32 = 0.6745;

/// Error of the model beside sensor noise (pose, mesh, lens), relative to the reading.
const MODEL_ERROR: f32 = 0.02;

/// Rounds of reweighting.
const ROUNDS: usize = 4;

/// With fewer readings nobody can tell who is the outlier.
const LEAST_TO_JUDGE: usize = 4;

/// One observation with all its light in `white`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Known light read, DN.
    pub known: [f32; 3],
    /// Its variance, DN^2.
    pub variance: [f32; 3],
    /// What a white surface would have read, bounces included, DN.
    pub white: [f32; 3],
    /// How finely the view sees the point, in any unit.
    pub resolution: f32,
}

/// A point's reflectance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Reflectance, camera RGB. May leave 0..1 by noise; never clamped.
    pub rho: [f32; 3],
    /// Standard deviation of `rho`: noise carried through, widened where the views disagree by more.
    pub sd: [f32; 3],
    /// Views that kept at least half their weight.
    pub views: u16,
}

/// Solves for the reflectance; `None` when no reading has light.
pub fn solve(readings: &[Reading]) -> Option<Estimate> {
    let usable: Vec<&Reading> = readings.iter().filter(|r| r.white.iter().all(|&m| m > 0.0)).collect();
    if usable.is_empty() {
        return None;
    }
    let mut rho = std::array::from_fn(|c| median(&usable, c));
    let mut trust = vec![1.0f32; usable.len()];
    for _ in 0..ROUNDS {
        if usable.len() >= LEAST_TO_JUDGE {
            let distances: Vec<f32> = usable.iter().map(|r| distance(r, &rho)).collect();
            let scale = (middle(&distances) / MEDIAN_OF_NORMAL).max(1.0);
            for (t, d) in trust.iter_mut().zip(&distances) {
                *t = tukey(d / scale);
            }
        }
        let Some(next) = least_squares(&usable, &trust, &rho) else { break };
        rho = next;
    }
    let sd = deviation(&usable, &trust, &rho);
    let views = trust.iter().filter(|&&t| t >= 0.5).count() as u16;
    Some(Estimate { rho, sd, views })
}

/// Variance of a reading about the model: noise, and the model's own error. The noise is that of the light
/// expected, not of the light read: a reading that happens to be dark is no better than its neighbours.
fn spread(r: &Reading, c: usize, rho: &[f32; 3]) -> f32 {
    let expected = (rho[c] * r.white[c]).max(0.0);
    let read = r.known[c].max(0.0);
    let noise = r.variance[c] * (expected + r.white[c]) / (read + r.white[c]);
    noise + (MODEL_ERROR * expected).powi(2)
}

/// The middle one of some distances.
fn middle(distances: &[f32]) -> f32 {
    let mut sorted = distances.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted[sorted.len() / 2]
}

/// Root mean square over the channels of the residual in standard deviations.
fn distance(r: &Reading, rho: &[f32; 3]) -> f32 {
    let squares = (0..3).map(|c| (r.known[c] - rho[c] * r.white[c]).powi(2) / spread(r, c, rho));
    (squares.sum::<f32>() / 3.0).sqrt()
}

/// Tukey's biweight of a residual in standard deviations.
pub(super) fn tukey(distance: f32) -> f32 {
    let x = distance.abs() / TUKEY;
    if x < 1.0 { (1.0 - x * x).powi(2) } else { 0.0 }
}

/// Median of P / m, each weighing by its resolution.
fn median(readings: &[&Reading], c: usize) -> f32 {
    let mut ratios: Vec<(f32, f32)> = readings
        .iter()
        .map(|r| {
            let ratio = r.known[c] / r.white[c];
            (ratio, r.resolution)
        })
        .collect();
    ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half: f32 = ratios.iter().map(|r| r.1).sum::<f32>() / 2.0;
    let mut below = 0.0;
    for &(ratio, weight) in &ratios {
        below += weight;
        if below >= half {
            return ratio;
        }
    }
    ratios.last().map_or(0.0, |r| r.0)
}

fn least_squares(readings: &[&Reading], trust: &[f32], rho: &[f32; 3]) -> Option<[f32; 3]> {
    let mut out = [0.0; 3];
    for (c, out) in out.iter_mut().enumerate() {
        let (mut above, mut below) = (0.0, 0.0);
        for (r, t) in readings.iter().zip(trust) {
            let w = t * r.resolution / spread(r, c, rho);
            above += w * r.white[c] * r.known[c];
            below += w * r.white[c] * r.white[c];
        }
        if below <= 0.0 {
            return None;
        }
        *out = above / below;
    }
    Some(out)
}

/// sqrt(sum w^2 m^2 var) / sum w m^2, widened by the readings' own spread where that exceeds the model's.
fn deviation(readings: &[&Reading], trust: &[f32], rho: &[f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let (mut above, mut below, mut chi, mut count) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for (r, t) in readings.iter().zip(trust) {
            let var = spread(r, c, rho);
            let w = t * r.resolution / var;
            above += w * w * r.white[c].powi(2) * var;
            below += w * r.white[c].powi(2);
            chi += t * (r.known[c] - rho[c] * r.white[c]).powi(2) / var;
            count += t;
        }
        let widen = if count > 1.5 { (chi / (count - 1.0)).max(1.0) } else { 1.0 };
        if below > 0.0 { (widen * above).sqrt() / below } else { f32::INFINITY }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(white: f32, rho: f32, extra: f32) -> Reading {
        Reading {
            known: [white * rho + extra; 3],
            variance: [4.0 + 0.3 * white * rho; 3],
            white: [white; 3],
            resolution: white,
        }
    }

    #[test]
    fn exact_readings_give_the_exact_reflectance() {
        let readings = [reading(4000.0, 0.37, 0.0), reading(900.0, 0.37, 0.0), reading(30.0, 0.37, 0.0)];
        let estimate = solve(&readings).unwrap();
        assert!(estimate.rho.iter().all(|r| (r - 0.37).abs() < 1e-6), "{estimate:?}");
        assert_eq!(estimate.views, 3);
    }

    #[test]
    fn a_highlight_in_one_view_of_five_leaves_no_trace() {
        let mut readings = vec![reading(3000.0, 0.2, 0.0); 4];
        readings.push(reading(5000.0, 0.2, 2500.0));
        let estimate = solve(&readings).unwrap();
        assert!((estimate.rho[0] - 0.2).abs() < 1e-4, "{estimate:?}");
        assert_eq!(estimate.views, 4);
    }

    #[test]
    fn a_grazing_view_hardly_counts() {
        let readings = [reading(4000.0, 0.5, 0.0), reading(20.0, 0.5, 4.0)];
        let estimate = solve(&readings).unwrap();
        assert!((estimate.rho[0] - 0.5).abs() < 0.002, "{estimate:?}");
    }

    #[test]
    fn standard_deviation_shrinks_with_the_root_of_the_views() {
        let one = solve(&[reading(3000.0, 0.4, 0.0)]).unwrap().sd[0];
        let nine = solve(&[reading(3000.0, 0.4, 0.0); 9]).unwrap().sd[0];
        assert!((one / nine - 3.0).abs() < 1e-3, "{one} {nine}");
    }

    #[test]
    fn readings_that_scatter_by_texture_are_averaged_not_sorted_out() {
        // Half the views see a bright grain, half a dark one beside it.
        let readings: Vec<Reading> =
            (0..10).map(|i| reading(3000.0, if i % 2 == 0 { 0.3 } else { 0.7 }, 0.0)).collect();
        let estimate = solve(&readings).unwrap();
        assert!((estimate.rho[0] - 0.5).abs() < 0.02, "{estimate:?}");
        assert!(estimate.sd[0] > 0.04, "{estimate:?}");
    }

    #[test]
    fn noise_alone_moves_the_mean_nowhere() {
        use rand::{RngExt as _, SeedableRng as _};
        use rand_distr::{Distribution as _, Normal};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let (points, views, rho, sigma) = (6000, 12, 0.4f32, 0.03f32);
        let noise = Normal::new(0.0, sigma).unwrap();
        let mut sum = 0.0f64;
        for _ in 0..points {
            let readings: Vec<Reading> = (0..views)
                .map(|_| {
                    let white: f32 = random.random_range(500.0..4000.0);
                    let known = [0, 1, 2].map(|_| white * (rho + noise.sample(&mut random)));
                    Reading {
                        known,
                        variance: [(sigma * white).powi(2); 3],
                        white: [white; 3],
                        resolution: 1.0,
                    }
                })
                .collect();
            let found = solve(&readings).unwrap().rho;
            sum += found.iter().map(|r| f64::from(r - rho)).sum::<f64>() / 3.0;
        }
        let bias = sum / f64::from(points);
        assert!(bias.abs() < 0.1 * f64::from(sigma) / f64::from(views).sqrt(), "{bias}");
    }

    #[test]
    fn without_light_there_is_no_answer() {
        assert_eq!(solve(&[]), None);
        assert_eq!(solve(&[reading(0.0, 0.4, 0.0)]), None);
    }
}
