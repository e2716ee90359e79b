//! Vignetting and flat field, from frames of something evenly lit.
//!
//! Over an even field a lens's image darkens with the squared distance from its centre. Model of a tile of colour c:
//!
//! ```text
//! x_c = s_c V(q) (light),    V(q) = 1 + a1 q + a2 q^2 + a3 q^3,    q = (r / half diagonal)^2
//! ```
//!
//! which is 1 at the frame's centre. Even powers of r are those that a rotationally symmetric lens has (DNG's
//! FixVignetteRadial has the same). The light itself may slope across the frame: a plane through the centre is fitted with
//! the curve, as `x_c = s_c (V(q) + g_x X + g_y Y)`, X and Y from -1 to 1 over the frame. Light that is brighter or
//! darker in the middle cannot be told from vignetting: turn the camera by 90 and 180 degrees between frames, or take
//! a lit surface much larger than the frame.
//!
//! Frames are added up, tile by tile ([`tiles`](super::tiles)), over the tiles that none of them over-exposes or cuts off
//! at 0 DN. Weighted least squares by each tile's noise (Gauss and Newton; the model is linear but for the products with
//! s). The order is the least that the data want: the highest coefficient goes while leaving it out raises chi^2 by
//! less than F(1) allows ([`KEEP`]); then curves of each colour are tried against a common one. Standard errors are
//! those of the fit, raised by the root of chi^2 per degree of freedom where the residuals are more than noise. The
//! corner's interval holds the choice of the order too: its variance is that of the fit plus the squares of what each
//! higher order would change.

mod fit;
#[cfg(test)]
mod tests;
mod words;

pub use fit::fit_flat;

use crate::calibration::{OtherRig, Rig};
use crate::pair::Settings;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::units::FNumber;
use glam::DVec2;
use serde::{Deserialize, Serialize};

/// F value from which on a coefficient is kept.
pub const KEEP: f64 = 4.0;

/// Vignetting over the frame, 1 at its centre, by colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlatField {
    /// Coefficients of q, q^2, q^3 by colour (R, G, B), where q = (r / half diagonal)^2.
    pub coefficients: [[f64; 3]; 3],
}

/// Light around the frame's centre.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProfilePoint {
    /// Distance from the centre over half the diagonal.
    pub radius: f64,
    /// Light over that at the centre.
    pub light: f64,
    /// Its standard error.
    pub light_standard_error: f64,
}

/// The flat field of one lens at one focal length and aperture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlatCalibration {
    /// Focal length of the frames, mm, as their files tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<f64>,
    /// Their f-number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aperture: Option<FNumber>,
    /// Vignetting.
    pub vignetting: FlatField,
    /// Highest power of q that the data want: 0 (none) to 3.
    pub order: usize,
    /// Whether each colour has a curve of its own.
    pub per_channel: bool,
    /// F values of the highest coefficient tried at each order from 3 down to that kept, and of a curve by colour.
    pub f_values: FValues,
    /// Vignetting in the frame's corner, by colour (R, G, B).
    pub corner: [f64; 3],
    /// Its 95 % interval, by colour.
    pub corner_interval_95: [[f64; 2]; 3],
    /// Slope of the light, relative, from the centre to the right and to the lower edge.
    pub light_gradient: [f64; 2],
    /// Its 95 % interval, for both.
    pub light_gradient_interval_95: [[f64; 2]; 2],
    /// chi^2 per degree of freedom: 1 where nothing but noise is left.
    pub chi_squared: f64,
    /// Root mean square of measured / model - 1 over the tiles.
    pub residual_rms: f64,
    /// measured / model - 1 in parts of the frame, row by row from the top; null where over-exposed or cut off at 0 DN.
    pub residual_map: Vec<Vec<Option<f64>>>,
    /// Standard error that noise gives a part of the map.
    pub residual_map_standard_error: f64,
    /// Measured relative light around the centre, by colour.
    pub profile: [Vec<ProfilePoint>; 3],
    /// Frames that entered.
    pub frames: usize,
    /// Share of tiles and colours that entered, 0 to 1.
    pub used_share: f64,
}

/// What the choice of a model rests on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FValues {
    /// Of a3 in order 3, then of a2 in order 2 if a3 went, and so on.
    pub highest_coefficient: Vec<f64>,
    /// Of a curve for each colour against a common one; absent without any curve or with one colour alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub per_channel: Option<f64>,
}

/// Why no flat field came out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FlatFitError {
    /// None was given, or all were left out.
    #[error("no evenly lit frame can be used: {0}")]
    Nothing(String),
    /// Frames of different sizes.
    #[error("the frames have different sizes ({} x {} and {} x {} pixels); give full frames of one camera", .0.0, .0.1, .1.0, .1.1)]
    Sizes((usize, usize), (usize, usize)),
    /// Another focal length or aperture.
    #[error(
        "frame {frame}: {source}; a flat field is of one focal length and aperture, give the frames of one at a time"
    )]
    Other {
        /// Which, from 1.
        frame: usize,
        /// What differs.
        source: OtherRig,
    },
    /// The tiles left do not tell the curve.
    #[error("too little of the frame is left ({left:.0} %) beside what is {lost}")]
    Little {
        /// Share of tiles and colours, %.
        left: f64,
        /// What the others are, and what to do about it.
        lost: &'static str,
    },
    /// The light was not that of something even.
    #[error(
        "the light falls to {0:.2} of that at the centre: this is no even surface, or it does not fill the frame"
    )]
    Uneven(f64),
}

impl FlatField {
    /// Vignetting of a colour (0 = R, 1 = G, 2 = B) at q.
    pub fn at_q(&self, q: f64, colour: usize) -> f64 {
        let [a, b, c] = self.coefficients[colour];
        1.0 + q * (a + q * (b + q * c))
    }

    /// Vignetting of a colour at a pixel position of a frame of this size (columns and rows), also a smaller copy of
    /// the same frame. Pixel centres at (i + 0.5, j + 0.5).
    pub fn at(&self, size: (usize, usize), pixel: DVec2, colour: usize) -> f64 {
        let half = DVec2::new(size.0 as f64, size.1 as f64) / 2.0;
        self.at_q((pixel - half).length_squared() / half.length_squared(), colour)
    }

    /// The mean of the colours' vignettings at q.
    pub fn mean_at_q(&self, q: f64) -> f64 {
        (0..3).map(|colour| self.at_q(q, colour)).sum::<f64>() / 3.0
    }

    /// Vignetting of a colour over the mean of all, at a pixel position of a frame of this size.
    pub fn over_mean(&self, size: (usize, usize), pixel: DVec2, colour: usize) -> f64 {
        let half = DVec2::new(size.0 as f64, size.1 as f64) / 2.0;
        let q = (pixel - half).length_squared() / half.length_squared();
        self.at_q(q, colour) / self.mean_at_q(q)
    }
}

impl FlatCalibration {
    /// Refuses a frame of another body, lens, focal length or aperture. `rig` is that of the calibration's record.
    pub fn fits(&self, rig: &Rig, settings: &Settings) -> Result<(), OtherRig> {
        rig.same_lens(settings, "the flat field")?;
        same_optics((self.focal_length_mm, self.aperture), settings, "the flat field")
    }
}

/// One focal length and aperture; what either does not tell is not held against it.
fn same_optics(
    (focal, aperture): (Option<f64>, Option<FNumber>),
    settings: &Settings,
    of: &'static str,
) -> Result<(), OtherRig> {
    if let (Some(expected), Some(found)) = (focal, settings.focal_length_mm)
        && (found / expected - 1.0).abs() > 0.01
    {
        let (found, expected) = (format!("{found} mm").into(), format!("{expected} mm").into());
        return Err(OtherRig { what: "focal length", found, expected, of });
    }
    if let (Some(expected), Some(found)) = (aperture, settings.aperture)
        && (Nominal.aperture(found) / Nominal.aperture(expected) - 1.0).abs() > 0.01
    {
        let (found, expected) = (found.to_string().into(), expected.to_string().into());
        return Err(OtherRig { what: "aperture", found, expected, of });
    }
    Ok(())
}
