//! A gloss found among the readings of a whole surface, so that it does not count as paint.
//!
//! With a lamp round the lens the half vector between light and view is the view direction itself: how much a
//! varnish adds to a reading hangs on `facing` alone, the cosine between normal and view. So the excess is one
//! curve for the whole surface, while the reflectance is a number for each point: of the readings
//!
//! ```text
//! (known - bounced) / direct white = rho_i + weight (g(facing; alpha) + mirrored)
//! ```
//!
//! of many points, `weight` and `alpha` are fitted together with every `rho_i` (their scatter about it tells the
//! gloss from the paint). g is a microfacet lobe after Walter et al. (EGSR 2007), GGX with Smith's masking, seen
//! along its own half vector, in units of what white sends back: `g = pi D G / (4 cos^2)`; `mirrored` is the light of
//! other surfaces along the lobe, in the same units (`super::mirror`). Robust by Tukey's
//! biweight; a lobe is believed only where it explains a good part of the scatter, so that matt surfaces are left as
//! they are to the last bit.

use super::observe::Observation;
use super::solve::{MEDIAN_OF_NORMAL, TUKEY, tukey};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f32::consts::{PI, TAU};

/// Widths that are tried.
const ALPHAS: [f32; 16] =
    [0.03, 0.04, 0.05, 0.065, 0.08, 0.1, 0.125, 0.15, 0.18, 0.21, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6];

/// Rounds of reweighting a width.
const ROUNDS: usize = 16;

/// Highlights count in full at first and are doubted more and more: the scale begins so many times as wide and is
/// halved every round (graduated non-convexity: Blake and Zisserman, "Visual Reconstruction", 1987).
const FIRST_SCALE: f32 = 64.0;

/// Points with fewer readings tell no excess.
const LEAST_READINGS: usize = 5;

/// Fewer points tell nothing about a surface, and more tell no more.
const LEAST_POINTS: usize = 50;
const MOST_POINTS: usize = 6000;

/// Share of the misfit that a lobe must explain, and the least weight, to be believed.
const BELIEVED: f64 = 0.04;
const LEAST_WEIGHT: f32 = 0.004;

/// Standard deviation of the lobe's own shape, relative to its excess.
const SHAPE_ERROR: f32 = 0.2;

/// Directions that the light which a lobe sends on is summed over.
const SENDING: u32 = 1024;

/// One reading of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glint {
    /// Known light less bounced light over the direct light of white: reflectance, and gloss on top.
    pub ratio: f32,
    /// Inverse variance of `ratio`.
    pub weight: f32,
    /// Cosine between normal and view.
    pub facing: f32,
    /// What a lobe of weight 1 adds to `ratio` by mirroring other lit surfaces.
    pub mirrored: f32,
}

/// A gloss over a whole surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lobe {
    /// Share of the light that it sends back.
    pub weight: f32,
    /// GGX width.
    pub alpha: f32,
}

impl Lobe {
    /// What the lobe adds to a reading, relative to what the direct light on white would have read.
    pub fn excess(&self, facing: f32) -> f32 {
        self.weight * shape(self.alpha, facing)
    }

    /// What the lobe sends to the camera where white would send `direct` by the flash, and `mirrored` is what the lobe
    /// mirrors of other surfaces.
    pub fn sent(&self, facing: f32, direct: f32, mirrored: f32) -> f32 {
        self.excess(facing) * direct + self.weight * mirrored
    }

    /// Share of light from all sides that it sends on: its weight, less what microfacets hide from each other. The mean
    /// over directions of what `super::mirror` sums for one.
    pub fn sends_on(&self) -> f32 {
        let (mut sum, mut all) = (0.0, 0.0);
        for i in 0..SENDING {
            // Eyes by the cosine; microfacets by density D cos.
            let spread = |step: f64| ((f64::from(i) + 0.5) * step).fract() as f32;
            let [look, u, turn] = [0.819_172_513_4, 0.671_043_606_7, 0.549_700_477_9].map(spread);
            let eye = look.sqrt();
            let tilt = ((1.0 - u) / (1.0 + (self.alpha * self.alpha - 1.0) * u)).max(0.0).sqrt();
            let across = ((1.0 - eye * eye) * (1.0 - tilt * tilt)).max(0.0).sqrt();
            let seen = eye * tilt + across * (TAU * turn).cos();
            let leaving = 2.0 * seen * tilt - eye;
            all += 1.0;
            if seen > 0.0 && leaving > 0.0 {
                sum += passed(self.alpha, eye) * passed(self.alpha, leaving) * seen / (eye * tilt);
            }
        }
        self.weight * sum / all
    }

    /// The reading without the gloss in the flash's direct light; what the gloss mirrors of other surfaces is
    /// noted in [`Observation::gloss`]. The lobe's own uncertainty joins the variance, so that readings in the
    /// midst of a highlight count for little.
    pub fn take_off(&self, o: &mut Observation) {
        let excess = self.excess(o.facing);
        for c in 0..3 {
            let gloss = excess * o.white[c];
            o.known[c] -= gloss;
            o.variance[c] += (SHAPE_ERROR * gloss).powi(2);
        }
        o.gloss = self.weight;
    }

    /// Undoes [`Self::take_off`].
    pub fn put_back(&self, o: &mut Observation) {
        let excess = self.excess(o.facing);
        for c in 0..3 {
            let gloss = excess * o.white[c];
            o.known[c] += gloss;
            o.variance[c] -= (SHAPE_ERROR * gloss).powi(2);
        }
        o.gloss = 0.0;
    }

    /// Finds the gloss that many points share; `None` where they do not speak of one.
    pub fn fit(points: &[Vec<Glint>]) -> Option<Self> {
        let points: Vec<&[Glint]> =
            points.iter().map(Vec::as_slice).filter(|p| p.len() >= LEAST_READINGS).collect();
        if points.len() < LEAST_POINTS {
            return None;
        }
        let step = points.len().div_ceil(MOST_POINTS);
        let points: Vec<&[Glint]> = points.into_iter().step_by(step).collect();
        let scale = ALPHAS
            .par_iter()
            .map(|&alpha| Trial::settle(&points, alpha, None).scale)
            .reduce(|| f32::INFINITY, f32::min);
        let none = Trial { alpha: 1.0, weight: 0.0, scale }.misfit(&points);
        let (best, misfit) = ALPHAS
            .par_iter()
            .map(|&alpha| {
                let trial = Trial::settle(&points, alpha, Some(scale));
                (trial, trial.misfit(&points))
            })
            .reduce_with(|a, b| if b.1 < a.1 { b } else { a })?;
        let believed = best.weight > LEAST_WEIGHT && misfit < (1.0 - BELIEVED) * none;
        believed.then_some(Self { weight: best.weight.min(1.0), alpha: best.alpha })
    }
}

/// GGX lobe along its own half vector, relative to a white Lambertian surface.
fn shape(alpha: f32, facing: f32) -> f32 {
    let (c, square) = (facing.clamp(0.05, 1.0), alpha * alpha);
    let d = c * c * (square - 1.0) + 1.0;
    let passed = passed(alpha, c);
    PI * (square / (PI * d * d)) * passed * passed / (4.0 * c * c)
}

/// Smith's masking of GGX in a direction at this cosine.
pub(super) fn passed(alpha: f32, cos: f32) -> f32 {
    let square = alpha * alpha;
    2.0 * cos / (cos + (square + (1.0 - square) * cos * cos).sqrt())
}

/// A lobe of one width on the way to its weight.
#[derive(Clone, Copy)]
struct Trial {
    alpha: f32,
    weight: f32,
    /// Robust standard deviation of the residuals over their own.
    scale: f32,
}

impl Trial {
    /// Weight and scale in turn; a scale that is given is kept.
    fn settle(points: &[&[Glint]], alpha: f32, given: Option<f32>) -> Self {
        let mut trial = Self { alpha, weight: 0.0, scale: f32::INFINITY };
        let mut wide = FIRST_SCALE;
        for _ in 0..ROUNDS {
            let scale = given.unwrap_or_else(|| trial.spread(points));
            trial.scale = scale * wide;
            trial.weight = trial.next_weight(points).max(0.0);
            trial.scale = scale;
            wide = (wide / 2.0).max(1.0);
        }
        trial
    }

    fn excess(&self, g: &Glint) -> f32 {
        self.weight * (shape(self.alpha, g.facing) + g.mirrored)
    }

    /// The point's reflectance under the present lobe: weighted mean, after Tukey from the weighted median on.
    fn rho(&self, point: &[Glint]) -> f32 {
        let mut left: Vec<(f32, f32)> = point.iter().map(|g| (g.ratio - self.excess(g), g.weight)).collect();
        left.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = left.iter().map(|l| l.1).sum::<f32>() / 2.0;
        let mut below = 0.0;
        let median = left.iter().find(|l| {
            below += l.1;
            below >= half
        });
        let mut rho = median.map_or(0.0, |l| l.0);
        if self.scale.is_finite() {
            for _ in 0..2 {
                let (mut sum, mut all) = (0.0, 0.0);
                for (value, weight) in &left {
                    let w = weight * self.trust((value - rho) * weight.sqrt());
                    sum += w * value;
                    all += w;
                }
                if all > 0.0 {
                    rho = sum / all;
                }
            }
        }
        rho
    }

    fn trust(&self, deviations: f32) -> f32 {
        tukey(deviations / self.scale)
    }

    fn residuals(&self, point: &[Glint]) -> Vec<f32> {
        let rho = self.rho(point);
        point.iter().map(|g| (g.ratio - self.excess(g) - rho) * g.weight.sqrt()).collect()
    }

    fn spread(&self, points: &[&[Glint]]) -> f32 {
        let mut sizes: Vec<f32> =
            points.iter().flat_map(|p| self.residuals(p)).map(f32::abs).filter(|r| r.is_finite()).collect();
        let middle = sizes.len() / 2;
        if sizes.is_empty() {
            return 1.0;
        }
        let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
        (*median / MEDIAN_OF_NORMAL).max(1e-3)
    }

    /// Weighted regression of the readings' departures from their point's mean on the lobe's.
    fn next_weight(&self, points: &[&[Glint]]) -> f32 {
        let (mut above, mut below) = (0.0f64, 0.0f64);
        for point in points {
            let residuals = self.residuals(point);
            let weights: Vec<f32> =
                point.iter().zip(&residuals).map(|(g, r)| g.weight * self.trust(*r)).collect();
            let all: f32 = weights.iter().sum();
            if all <= 0.0 {
                continue;
            }
            let mean = |of: &dyn Fn(&Glint) -> f32| {
                point.iter().zip(&weights).map(|(g, w)| w * of(g)).sum::<f32>() / all
            };
            let lobe = |g: &Glint| shape(self.alpha, g.facing) + g.mirrored;
            let (ratio, shade) = (mean(&|g| g.ratio), mean(&lobe));
            for (g, w) in point.iter().zip(&weights) {
                let x = lobe(g) - shade;
                above += f64::from(w * x * (g.ratio - ratio));
                below += f64::from(w * x * x);
            }
        }
        if below > 0.0 { (above / below) as f32 } else { 0.0 }
    }

    /// Sum of Tukey's loss.
    fn misfit(&self, points: &[&[Glint]]) -> f64 {
        let loss = |r: f32| {
            let x = (r / (TUKEY * self.scale)).abs().min(1.0);
            f64::from(1.0 - (1.0 - x * x).powi(3))
        };
        points.iter().flat_map(|p| self.residuals(p)).map(loss).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_distr::{Distribution as _, Normal};

    const NOISE: f32 = 0.02;

    fn points(lobe: Option<Lobe>) -> (Vec<Vec<Glint>>, Vec<f32>) {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let noise = Normal::new(0.0f32, NOISE).unwrap();
        let mut paint = vec![];
        let points = (0..600)
            .map(|_| {
                let rho: f32 = random.random_range(0.05..0.8);
                paint.push(rho);
                (0..12)
                    .map(|_| {
                        let facing = random.random_range(0.25f32..1.0);
                        let mirrored = random.random_range(0.0..0.3);
                        let gloss = lobe.map_or(0.0, |l| l.excess(facing) + l.weight * mirrored);
                        let ratio = rho + gloss + noise.sample(&mut random);
                        Glint { ratio, weight: 1.0 / (NOISE * NOISE), facing, mirrored }
                    })
                    .collect()
            })
            .collect();
        (points, paint)
    }

    #[test]
    fn a_gloss_is_found_again_with_its_weight_and_width() {
        for (weight, alpha) in [(0.05, 0.15), (0.1, 0.3), (0.2, 0.4), (0.2, 0.05)] {
            let lobe = Lobe::fit(&points(Some(Lobe { weight, alpha })).0).unwrap();
            assert!((lobe.weight / weight - 1.0).abs() < 0.12, "{lobe:?} for {weight} {alpha}");
            assert!((lobe.alpha / alpha - 1.0).abs() < 0.1, "{lobe:?} for {weight} {alpha}");
        }
    }

    #[test]
    fn noise_alone_is_no_gloss() {
        assert_eq!(Lobe::fit(&points(None).0), None);
    }

    #[test]
    fn a_lobe_sends_on_its_weight_less_what_microfacets_hide() {
        // Cosine-weighted means over the eye of the single-scattering albedo, by an integration outside of this program.
        for (alpha, share) in [(0.05, 0.990), (0.15, 0.945), (0.25, 0.880), (0.4, 0.766), (0.6, 0.615)] {
            let found = Lobe { weight: 0.2, alpha }.sends_on() / 0.2;
            assert!((found - share).abs() < 0.01, "{found} at {alpha}");
        }
    }

    #[test]
    fn taken_off_a_gloss_leaves_the_paint() {
        let lobe = Lobe { weight: 0.1, alpha: 0.3 };
        let mut o = Observation {
            known: [0.4 + lobe.excess(0.9); 3].map(|r| 1000.0 * r),
            variance: [100.0; 3],
            white: [1000.0; 3],
            resolution: 1.0,
            response: 0.3,
            facing: 0.9,
            gloss: 0.0,
        };
        lobe.take_off(&mut o);
        assert!((o.known[1] - 400.0).abs() < 1e-2, "{o:?}");
        assert!(o.variance[1] > 100.0 && o.gloss == lobe.weight);
    }
}
