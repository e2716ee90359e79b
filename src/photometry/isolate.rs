//! Isolation of the known light: lit frame minus unlit frame, on sensor sites.
//!
//! `P_k = P_on - (S_on / S_off) P_off` with P in DN above black and S proportional to t ISO / N^2 (the thesis's
//! eq. 2.10; its eq. 2.11 is misprinted). Negatives are kept: they are noise, and cutting them off would
//! brighten the dark. A clipped site in either frame carries no value.

use super::{Mosaic, NoiseModel};
use crate::raster::Image;

/// Share of the range between black and saturation above which a site counts as clipped: a site whose noise
/// reaches the limit now and then has a mean that is already too low.
const CLIP: f32 = 0.985;

/// The two frames do not fit together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IsolateError {
    /// Sizes differ.
    #[error(
        "lit frame is {on:?} sites and unlit frame {off:?}: a pair needs two frames of one camera and format"
    )]
    Size {
        /// Width and height of the lit frame.
        on: (usize, usize),
        /// Width and height of the unlit frame.
        off: (usize, usize),
    },
    /// Filter arrays differ.
    #[error("lit and unlit frame have different colour filter arrays: they are not from one camera")]
    Cfa,
}

/// The known light on sensor sites.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownMosaic {
    /// DN of known light; `None` where either frame was clipped.
    pub value: Image<Option<f32>>,
    /// Variance of `value` in DN^2.
    pub variance: Image<f32>,
    /// Filter array.
    pub cfa: super::Cfa,
}

/// Subtracts `scale` times the unlit frame from the lit one; `scale` = S_on / S_off, 1 for equal settings.
pub fn isolate(
    on: &Mosaic,
    off: &Mosaic,
    scale: f32,
    noise: &NoiseModel,
) -> Result<KnownMosaic, IsolateError> {
    let size = |m: &Mosaic| (m.dn.width(), m.dn.height());
    if size(on) != size(off) {
        return Err(IsolateError::Size { on: size(on), off: size(off) });
    }
    if on.cfa != off.cfa {
        return Err(IsolateError::Cfa);
    }
    let (width, height) = size(on);
    let pair = |x: usize, y: usize| Some((linear(on, x, y)?, linear(off, x, y)?));
    Ok(KnownMosaic {
        value: Image::from_fn(width, height, |x, y| pair(x, y).map(|(on, off)| on - scale * off)),
        variance: Image::from_fn(width, height, |x, y| {
            pair(x, y).map_or(0.0, |(on, off)| noise.variance(on) + scale * scale * noise.variance(off))
        }),
        cfa: on.cfa,
    })
}

/// The known light of a frame shot in a dark room, where the flash is all there is.
pub fn isolate_dark(on: &Mosaic, noise: &NoiseModel) -> KnownMosaic {
    let (width, height) = (on.dn.width(), on.dn.height());
    let value = Image::from_fn(width, height, |x, y| linear(on, x, y));
    let variance = value.map(|v| v.map_or(0.0, |v| noise.variance(v)));
    KnownMosaic { value, variance, cfa: on.cfa }
}

/// DN above black; `None` when clipped.
fn linear(frame: &Mosaic, x: usize, y: usize) -> Option<f32> {
    let (black, saturation) = (frame.levels.black[y & 1][x & 1], frame.levels.saturation[y & 1][x & 1]);
    let above = f32::from(*frame.dn.at(x, y)) - black;
    (above < CLIP * (saturation - black)).then_some(above)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};

    pub(in crate::photometry) fn mosaic(
        width: usize,
        height: usize,
        dn: impl FnMut(usize, usize) -> u16,
    ) -> Mosaic {
        Mosaic {
            dn: Image::from_fn(width, height, dn),
            cfa: Cfa::RGGB,
            levels: Levels {
                black: [[2000.0, 2001.0], [2002.0, 2003.0]],
                saturation: [[15000.0; 2]; 2],
                black_source: LevelSource::FileTag,
                saturation_source: LevelSource::FileTag,
            },
        }
    }

    #[test]
    fn the_rooms_light_cancels_and_negatives_stay() {
        let noise = NoiseModel { gain: 0.3, floor: 2.0 };
        let off = mosaic(4, 4, |x, y| 3000 + (x * y) as u16);
        let on = mosaic(4, 4, |x, y| {
            3000 + (x * y) as u16 + if x == 0 { 500 } else { 0 } - if x == 3 { 4 } else { 0 }
        });
        let known = isolate(&on, &off, 1.0, &noise).unwrap();
        assert_eq!(*known.value.at(0, 2), Some(500.0));
        assert_eq!(*known.value.at(1, 1), Some(0.0));
        assert_eq!(*known.value.at(3, 3), Some(-4.0));
        let (a, b) = (noise.variance(1500.0), noise.variance(1000.0));
        assert!((known.variance.at(0, 0) - a - b).abs() < 1e-3);
    }

    #[test]
    fn unequal_exposures_are_scaled_before_subtracting() {
        let off = mosaic(2, 2, |x, y| (2000 + x + 2 * y + 400) as u16);
        let on = mosaic(2, 2, |x, y| (2000 + x + 2 * y + 800 + 123) as u16);
        let known = isolate(&on, &off, 2.0, &NoiseModel { gain: 0.0, floor: 1.0 }).unwrap();
        assert!(known.value.pixels().iter().all(|v| (v.unwrap() - 123.0).abs() < 1e-3));
        assert!(known.variance.pixels().iter().all(|v| (v - 5.0).abs() < 1e-6));
    }

    #[test]
    fn a_site_clipped_in_either_frame_has_no_value() {
        let dark = mosaic(2, 2, |_, _| 2100);
        let blown = mosaic(2, 2, |x, _| if x == 1 { 15000 } else { 2200 });
        let noise = NoiseModel { gain: 0.3, floor: 2.0 };
        for (on, off) in [(&blown, &dark), (&dark, &blown)] {
            let known = isolate(on, off, 1.0, &noise).unwrap();
            assert!(known.value.at(0, 0).is_some() && known.value.at(1, 1).is_none());
        }
        assert!(matches!(
            isolate(&dark, &mosaic(4, 2, |_, _| 0), 1.0, &noise),
            Err(IsolateError::Size { .. })
        ));
    }
}
