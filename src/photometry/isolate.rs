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
    fit(on, (size(off), off.cfa))?;
    Ok(difference(on, |x, y| linear(off, x, y), 1.0, scale, noise))
}

/// The same with the mean of several unlit frames, which has their noise's variance over their number.
pub fn isolate_mean(
    on: &Mosaic,
    room: &RoomLight,
    scale: f32,
    noise: &NoiseModel,
) -> Result<KnownMosaic, IsolateError> {
    fit(on, ((room.sum.width(), room.sum.height()), room.cfa))?;
    Ok(difference(on, |x, y| room.mean(x, y), f32::from(room.frames), scale, noise))
}

/// `off` is the room's light, a mean of `frames` frames.
fn difference(
    on: &Mosaic,
    off: impl Fn(usize, usize) -> Option<f32>,
    frames: f32,
    scale: f32,
    noise: &NoiseModel,
) -> KnownMosaic {
    let (width, height) = size(on);
    let pair = |x: usize, y: usize| Some((linear(on, x, y)?, off(x, y)?));
    KnownMosaic {
        value: Image::from_fn(width, height, |x, y| pair(x, y).map(|(on, off)| on - scale * off)),
        variance: Image::from_fn(width, height, |x, y| {
            pair(x, y)
                .map_or(0.0, |(on, off)| noise.variance(on) + scale * scale * noise.variance(off) / frames)
        }),
        cfa: on.cfa,
    }
}

fn size(mosaic: &Mosaic) -> (usize, usize) {
    (mosaic.dn.width(), mosaic.dn.height())
}

fn fit(on: &Mosaic, off: ((usize, usize), super::Cfa)) -> Result<(), IsolateError> {
    if size(on) != off.0 {
        return Err(IsolateError::Size { on: size(on), off: off.0 });
    }
    if on.cfa != off.1 {
        return Err(IsolateError::Cfa);
    }
    Ok(())
}

/// The room's light on sensor sites as the mean of several unlit frames, in DN above each frame's own black.
///
/// Taken in one by one, so that only one of them need be in memory. A site clipped in any of them carries no value.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomLight {
    sum: Image<Option<f32>>,
    frames: u16,
    cfa: super::Cfa,
}

impl RoomLight {
    /// That of one frame.
    pub fn of(frame: &Mosaic) -> Self {
        let (width, height) = size(frame);
        Self { sum: Image::from_fn(width, height, |x, y| linear(frame, x, y)), frames: 1, cfa: frame.cfa }
    }

    /// Takes in another frame.
    pub fn add(&mut self, frame: &Mosaic) -> Result<(), IsolateError> {
        fit(frame, ((self.sum.width(), self.sum.height()), self.cfa))?;
        let width = self.sum.width().max(1);
        for (i, sum) in self.sum.pixels_mut().iter_mut().enumerate() {
            *sum = sum.zip(linear(frame, i % width, i / width)).map(|(sum, more)| sum + more);
        }
        self.frames = self.frames.saturating_add(1);
        Ok(())
    }

    /// DN above black; `None` where a frame was clipped.
    pub fn mean(&self, x: usize, y: usize) -> Option<f32> {
        self.sum.at(x, y).map(|sum| sum / f32::from(self.frames))
    }

    /// How many frames it is the mean of.
    pub fn frames(&self) -> u16 {
        self.frames
    }
}

/// The known light of a frame shot in a dark room, where the flash is all there is.
pub fn isolate_dark(on: &Mosaic, noise: &NoiseModel) -> KnownMosaic {
    let (width, height) = (on.dn.width(), on.dn.height());
    let value = Image::from_fn(width, height, |x, y| linear(on, x, y));
    let variance = value.map(|v| v.map_or(0.0, |v| noise.variance(v)));
    KnownMosaic { value, variance, cfa: on.cfa }
}

/// DN above black; `None` when clipped.
pub(crate) fn linear(frame: &Mosaic, x: usize, y: usize) -> Option<f32> {
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

    fn noisy(seed: u64, light: impl Fn(usize, usize) -> f64) -> Mosaic {
        use rand::SeedableRng;
        use rand_distr::{Distribution, Normal};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let (gain, floor) = (0.3, 4.0);
        let blacks = [[2000.0, 2001.0], [2002.0, 2003.0]];
        mosaic(128, 128, |x, y| {
            let signal = light(x, y);
            let noise = Normal::new(0.0, (gain * signal + floor).sqrt()).unwrap().sample(&mut random);
            (blacks[y & 1][x & 1] + signal + noise).round() as u16
        })
    }

    /// Mean and variance of the known light's errors, and the mean of the variances that are told.
    fn errors(known: &KnownMosaic, truth: f64) -> [f64; 3] {
        let n = known.value.pixels().len() as f64;
        let errors: Vec<f64> = known.value.pixels().iter().map(|v| f64::from(v.unwrap()) - truth).collect();
        let mean = errors.iter().sum::<f64>() / n;
        let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n;
        [mean, variance, known.variance.pixels().iter().map(|v| f64::from(*v)).sum::<f64>() / n]
    }

    #[test]
    fn the_mean_of_n_frames_has_their_variance_over_n_and_says_so() {
        let noise = NoiseModel { gain: 0.3, floor: 4.0 };
        let (room, flash) = (1500.0, 600.0);
        let on = noisy(1, |_, _| room + flash);
        let lit = 0.3 * (room + flash) + 4.0;
        let dark = 0.3 * room + 4.0;
        for n in [1u64, 2, 4, 16] {
            let mut mean = RoomLight::of(&noisy(100, |_, _| room));
            for k in 1..n {
                mean.add(&noisy(100 + k, |_, _| room)).unwrap();
            }
            assert_eq!(u64::from(mean.frames()), n);
            let known = isolate_mean(&on, &mean, 1.0, &noise).unwrap();
            let [bias, variance, told] = errors(&known, flash);
            // Rounding to whole DN adds a twelfth a frame.
            let expected = lit + 1.0 / 12.0 + (dark + 1.0 / 12.0) / n as f64;
            // 16384 sites: the variance is known to 1.1 %, the mean to a 128th of its standard deviation.
            assert!((variance / expected - 1.0).abs() < 0.045, "{n}: {variance} against {expected}");
            assert!((told / expected - 1.0).abs() < 0.01, "{n}: {told} told, {expected} expected");
            assert!(bias.abs() < 4.0 * expected.sqrt() / 128.0, "{n}: off by {bias}");
        }
    }

    #[test]
    fn dark_frames_on_both_sides_take_a_slope_out_exactly_and_those_on_one_side_do_not() {
        let noise = NoiseModel { gain: 0.0, floor: 1.0 };
        // Frames at times -3 to 3; the room rises by 8 DN from one to the next.
        let black = |x: usize, y: usize| 2000 + (x & 1) as u16 + 2 * (y & 1) as u16;
        let at =
            |time: i32, flash: u16| mosaic(8, 8, move |x, y| black(x, y) + (800 + 8 * time) as u16 + flash);
        let on = at(0, 500);
        let mut before = RoomLight::of(&at(-3, 0));
        before.add(&at(-2, 0)).unwrap();
        before.add(&at(-1, 0)).unwrap();
        let mut both = before.clone();
        for time in 1..=3 {
            both.add(&at(time, 0)).unwrap();
        }
        let known = |room: &RoomLight| isolate_mean(&on, room, 1.0, &noise).unwrap().value;
        assert!(known(&both).pixels().iter().all(|v| *v == Some(500.0)), "every slope cancels");
        // d T (n + 1) / 2 = 8 * 4 / 2.
        assert!(known(&before).pixels().iter().all(|v| *v == Some(516.0)));
    }

    #[test]
    fn one_frame_alone_gives_the_same_bits_by_either_way() {
        let noise = NoiseModel { gain: 0.37, floor: 2.3 };
        let (on, off) = (noisy(1, |x, _| 900.0 + 7.0 * x as f64), noisy(2, |x, _| 300.0 + 3.0 * x as f64));
        let mean = isolate_mean(&on, &RoomLight::of(&off), 0.7, &noise).unwrap();
        assert_eq!(mean, isolate(&on, &off, 0.7, &noise).unwrap());
    }

    #[test]
    fn a_site_clipped_in_any_dark_frame_has_no_value_and_other_sizes_are_refused() {
        let dark = |blown: usize| mosaic(4, 2, move |x, _| if x == blown { 15000 } else { 2100 });
        let mut room = RoomLight::of(&dark(1));
        room.add(&dark(3)).unwrap();
        room.add(&dark(9)).unwrap();
        let known = isolate_mean(&dark(9), &room, 1.0, &NoiseModel { gain: 0.3, floor: 2.0 }).unwrap();
        let there: Vec<bool> = (0..4).map(|x| known.value.at(x, 0).is_some()).collect();
        assert_eq!(there, [true, false, true, false]);
        assert!(matches!(room.add(&mosaic(2, 2, |_, _| 2100)), Err(IsolateError::Size { .. })));
        let other = Mosaic { cfa: Cfa([[1, 0], [2, 1]]), ..dark(9) };
        assert_eq!(room.add(&other), Err(IsolateError::Cfa));
        assert_eq!(room.frames(), 3);
    }
}
