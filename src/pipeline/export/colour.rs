//! From camera RGB to the colours asked for.

use super::{Colour, ExportError};
use crate::export::colour::{ACESCG, LINEAR_SRGB, Space};
use crate::pair::PairRecord;
use crate::pipeline::colour::{SessionColours, SessionMatrix};
use crate::pipeline::process::ProcessSummary;
use crate::raster::Rgb;
use crate::session::Session;
use glam::{DMat3, DVec3};

/// What is known of the colours of the model's pairs, and what is to be told of it.
pub(super) fn camera_colour(
    session: &Session,
    summary: &ProcessSummary,
) -> Result<(SessionMatrix, Option<String>), ExportError> {
    let pairs = session.pairs()?;
    let used: Vec<&PairRecord> =
        pairs.iter().map(|pair| &**pair).filter(|pair| summary.used.contains(&pair.name)).collect();
    let SessionColours { matrix, note } = SessionColours::known(session, &used)?;
    Ok((matrix.ok_or(ExportError::NoColour)?, note))
}

pub(super) fn space(colour: Colour) -> Option<Space> {
    match colour {
        Colour::Camera => None,
        Colour::Srgb => Some(LINEAR_SRGB),
        Colour::AcesCg => Some(ACESCG),
    }
}

pub(super) fn name(colour: Colour) -> &'static str {
    space(colour).map_or("camera RGB, uncalibrated", |s| s.name)
}

pub(super) fn transformed(image: &Rgb, matrix: DMat3) -> Rgb {
    image.map(|p| (matrix * DVec3::from(p.map(f64::from))).to_array().map(|v| v as f32))
}

/// Standard deviations after the transformation, the channels' errors taken as independent.
pub(super) fn spread(deviation: &Rgb, matrix: DMat3) -> Rgb {
    let squares = DMat3::from_cols_array(&matrix.to_cols_array().map(|m| m * m));
    deviation.map(|p| {
        let variance = squares * DVec3::from(p.map(|s| f64::from(s).powi(2)));
        variance.to_array().map(|v| v.sqrt() as f32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;

    #[test]
    fn deviations_follow_the_colours() {
        let sd = Image::filled(1, 1, [0.03, 0.04, 0.0]);
        let mixed = DMat3::from_cols_array(&[1.0, 0.0, 2.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let spread = *spread(&sd, mixed).at(0, 0);
        for (got, want) in spread.into_iter().zip([0.05, 0.04, 0.06]) {
            assert!((got - want).abs() < 1e-6, "{spread:?}");
        }
    }
}
