//! What cannot be fitted, and what of a series is of no use.

use super::card::{CardShot, Target};
use super::{FEWEST_CELLS, FlashFitError, MOST_CLIPPED};
use crate::scene::Intrinsics;

/// Refuses a target that cannot be.
pub(super) fn check_target(target: &Target) -> Result<(), FlashFitError> {
    if !(target.reflectance > 0.0 && target.reflectance <= 1.0) {
        return Err(FlashFitError::Reflectance(target.reflectance));
    }
    let rising = target.curve.windows(2).all(|w| w[0][0] < w[1][0]);
    let sound = |[angle, factor]: &[f64; 2]| (0.0..1.57).contains(angle) && *factor > 0.0 && *factor < 10.0;
    if rising && target.curve.iter().all(sound) { Ok(()) } else { Err(FlashFitError::Curve) }
}

/// Refuses a shot whose card cannot be where it is said to be, or that is not of the camera.
pub(super) fn check(shot: &CardShot, intrinsics: &Intrinsics) -> Result<(), FlashFitError> {
    let label = || shot.label.clone();
    let normal = shot.plane.normal;
    if !((normal.length() - 1.0).abs() < 1e-6 && normal.z < -0.17 && shot.plane.point.is_finite()) {
        return Err(FlashFitError::Plane { label: label() });
    }
    let distance = shot.plane.distance();
    if !(distance > 0.0 && distance < 1e3) {
        return Err(FlashFitError::Distance { label: label(), distance });
    }
    let expected = (intrinsics.width, intrinsics.height);
    if shot.size != expected {
        return Err(FlashFitError::Size { label: label(), got: shot.size, expected });
    }
    Ok(())
}

/// Why a shot cannot be measured, in words.
pub(super) fn unfit(shot: &CardShot) -> Option<String> {
    if shot.clipped > MOST_CLIPPED {
        return Some(format!(
            "over-exposed: clipped sites in {:.0} % of the frame; put the card farther away, close the aperture or turn the flash down",
            100.0 * shot.clipped
        ));
    }
    if shot.cells.len() < FEWEST_CELLS {
        return Some("its frame is too small to measure".into());
    }
    let n = shot.cells.len() as f64;
    let mean = |c: usize| shot.cells.iter().map(|cell| cell.value[c]).sum::<f64>() / n;
    let dark = (0..3).any(|c| mean(c).is_nan() || mean(c) <= 1.0);
    dark.then(|| "dark: the flash did not fire, or its light did not reach the card".into())
}
