//! What a cell of a card shot reads, by the unknowns of the fit, and its derivatives.

use super::card::SeenShot;
use super::mixed::{Model, ShotSums};
use super::{FieldFactor, Vignetting};
use crate::light::Ring;
use nalgebra::{DMatrix, Matrix3};
use rayon::prelude::*;

/// A figure of the flash that may be fitted beside radiance and field; each counts from its value by the ruler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Figure {
    /// The ring's place along the axis, metres.
    Offset,
    /// Exponent of its lobe.
    Lobe,
    /// Inner radius, metres.
    Inner,
    /// Outer radius, metres.
    Outer,
    /// p - 2 of a law 1 / d^p.
    Exponent,
}

impl Figure {
    /// Standard deviation of what is known of it beforehand: ruler and common sense, so wide that any shots which tell
    /// it at all tell it better.
    pub(super) fn beforehand(self) -> f64 {
        match self {
            Figure::Offset => 0.1,
            Figure::Lobe => 10.0,
            Figure::Inner | Figure::Outer => 0.002,
            Figure::Exponent => 2.0,
        }
    }

    /// Half of the widest 95 % interval of which is said that the shots tell it.
    pub(super) fn widest(self) -> f64 {
        match self {
            Figure::Offset => 0.010,
            Figure::Lobe => 0.5,
            Figure::Inner | Figure::Outer => 0.001,
            Figure::Exponent => 0.2,
        }
    }

    /// Step of the difference quotient.
    fn step(self) -> f64 {
        match self {
            Figure::Offset | Figure::Inner | Figure::Outer => 1e-5,
            Figure::Lobe | Figure::Exponent => 1e-4,
        }
    }
}

/// Coefficients of the field that are fitted where it is not given.
const FIELD: usize = 3;

/// Standard deviation of the field's coefficients beforehand, for frames too small to bend.
const FIELD_BEFOREHAND: f64 = 10.0;

/// The card shots of one flash. Unknowns: logarithms of the radiances over `radiance`; the field's coefficients, unless
/// given without error; the figures in their order.
pub(super) struct Cards<'a> {
    shots: &'a [SeenShot],
    ring: Ring,
    radiance: [f64; 3],
    /// What the field's free coefficients count from.
    field: FieldFactor,
    /// How many of them are free: all or none.
    bends: usize,
    figures: Vec<Figure>,
    /// What is known beforehand, as an information matrix.
    prior: DMatrix<f64>,
    /// Geometric mean of the distances.
    middle: f64,
}

/// The flash at some values of the unknowns.
pub(super) struct Flash {
    pub(super) ring: Ring,
    pub(super) radiance: [f64; 3],
    pub(super) field: FieldFactor,
    excess: f64,
}

impl<'a> Cards<'a> {
    pub(super) fn new(
        shots: &'a [SeenShot],
        ring: Ring,
        radiance: [f64; 3],
        vignetting: Option<Vignetting>,
        figures: Vec<Figure>,
    ) -> Self {
        let bends = if vignetting.is_some_and(|v| v.information.is_none()) { 0 } else { FIELD };
        let unknowns = 3 + bends + figures.len();
        let mut prior = DMatrix::zeros(unknowns, unknowns);
        match vignetting {
            None => (3..3 + FIELD).for_each(|i| prior[(i, i)] = FIELD_BEFOREHAND.powi(-2)),
            Some(Vignetting { information: Some(information), .. }) => {
                prior.fixed_view_mut::<FIELD, FIELD>(3, 3).copy_from(&Matrix3::from(information));
            }
            Some(_) => {}
        }
        for (i, figure) in (3 + bends..).zip(&figures) {
            prior[(i, i)] = figure.beforehand().powi(-2);
        }
        let field = vignetting.map_or(FieldFactor { coefficients: [0.0; 3] }, |v| v.field);
        let logs: f64 = shots.iter().map(|s| s.distance.ln()).sum();
        let middle = (logs / shots.len().max(1) as f64).exp();
        Self { shots, ring, radiance, field, bends, figures, prior, middle }
    }

    /// What is fitted beside radiance and field.
    pub(super) fn figures(&self) -> &[Figure] {
        &self.figures
    }

    /// Where the search begins.
    pub(super) fn start(&self) -> Vec<f64> {
        vec![0.0; self.prior.nrows()]
    }

    /// The number of an unknown.
    pub(super) fn place(&self, figure: Figure) -> Option<usize> {
        let first = 3 + self.bends;
        Some(first + self.figures.iter().position(|f| *f == figure)?)
    }

    /// The flash at these values; `None` if there is none such.
    pub(super) fn flash(&self, theta: &[f64]) -> Option<Flash> {
        let of = |figure| self.place(figure).map_or(0.0, |i| theta[i]);
        let ring = Ring {
            inner: self.ring.inner + of(Figure::Inner),
            outer: self.ring.outer + of(Figure::Outer),
            offset: self.ring.offset + of(Figure::Offset),
            lobe: self.ring.lobe + of(Figure::Lobe),
        };
        let mut field = self.field;
        field.coefficients.iter_mut().zip(&theta[3..3 + self.bends]).for_each(|(a, t)| *a += t);
        let nearest = self.shots.iter().map(|s| s.distance).fold(f64::INFINITY, f64::min);
        let sound = Ring::new(ring.inner, ring.outer).is_ok()
            && ring.offset.abs() < 0.5 * nearest
            && (-0.9..100.0).contains(&ring.lobe)
            && theta[..3].iter().all(|t| t.abs() < 50.0);
        let radiance = std::array::from_fn(|c| self.radiance[c] * theta[c].exp());
        sound.then(|| Flash { ring, radiance, field, excess: of(Figure::Exponent) })
    }

    /// The ring with one of its figures moved.
    fn moved(ring: Ring, figure: Figure, by: f64) -> Ring {
        match figure {
            Figure::Offset => Ring { offset: ring.offset + by, ..ring },
            Figure::Lobe => Ring { lobe: ring.lobe + by, ..ring },
            Figure::Inner => Ring { inner: ring.inner + by, ..ring },
            Figure::Outer => Ring { outer: ring.outer + by, ..ring },
            Figure::Exponent => ring,
        }
    }

    /// Sums of one shot, of those that are fitted or another.
    pub(super) fn sums_of(&self, shot: &SeenShot, flash: &Flash) -> Option<ShotSums> {
        let n = self.prior.nrows();
        let first = 3 + self.bends;
        let mut sums = ShotSums::zero(n);
        let mut derivative = vec![0.0; n];
        let far = (shot.distance / self.middle).ln();
        for cell in &shot.cells {
            let light = |ring: Ring| ring.irradiance(cell.point, shot.normal);
            let field = flash.field.at_q(cell.q);
            let here = light(flash.ring);
            let unit = here * cell.target * field * (-flash.excess * far).exp() * shot.energy;
            if !(unit > 0.0 && field > 0.0) {
                return None;
            }
            for i in 0..self.bends {
                derivative[3 + i] = cell.q.powi(i as i32 + 1) / field;
            }
            for (i, figure) in self.figures.iter().enumerate() {
                derivative[first + i] = match figure {
                    Figure::Exponent => -far,
                    _ => {
                        let step = figure.step();
                        (light(Self::moved(flash.ring, *figure, step)) / here).ln() / step
                    }
                };
            }
            if !derivative.iter().all(|d| d.is_finite()) {
                return None;
            }
            for c in 0..3 {
                let model = flash.radiance[c] * unit;
                derivative[..3].fill(0.0);
                derivative[c] = 1.0;
                sums.add(model * model / cell.variance[c], cell.value[c] / model - 1.0, &derivative);
            }
        }
        Some(sums)
    }
}

impl Model for Cards<'_> {
    fn sums(&self, theta: &[f64]) -> Option<Vec<ShotSums>> {
        let flash = self.flash(theta)?;
        self.shots.par_iter().map(|shot| self.sums_of(shot, &flash)).collect()
    }

    fn prior(&self) -> &DMatrix<f64> {
        &self.prior
    }
}

/// Radiances by which a first render has the light of all shots; `None` for a channel without light.
pub(super) fn first_guess(
    shots: &[SeenShot],
    ring: Ring,
    vignetting: Option<Vignetting>,
) -> Option<[f64; 3]> {
    let (mut measured, mut rendered) = ([0.0; 3], [0.0; 3]);
    for shot in shots {
        for cell in &shot.cells {
            let field = vignetting.map_or(1.0, |v| v.field.at_q(cell.q));
            let unit = ring.irradiance(cell.point, shot.normal) * cell.target * field * shot.energy;
            for c in 0..3 {
                let weight = unit / cell.variance[c];
                measured[c] += weight * cell.value[c];
                rendered[c] += weight * unit;
            }
        }
    }
    let guess: [f64; 3] = std::array::from_fn(|c| measured[c] / rendered[c]);
    guess.iter().all(|g| g.is_finite() && *g > 0.0).then_some(guess)
}
