//! Gives a frame the best black and saturation that are known.
//!
//! Saturation, the first source that has one: the session's own measurement, by filter position ([`MeasuredLevels`]),
//! the file's tag, published measurements of the body ([`SaturationTable::built_in`]), the decoder's value less a
//! margin. Black: the session's own, else what the decoder found (masked border, tag, table). A measurement counts for
//! the body that it was made with, at its ISO; a position that it does not tell keeps the next source. Why a measurement
//! does not count is told ([`Unmeasured`]): whoever reads frames refuses those of another body.

use super::saturation::{SaturationTable, same_model};
use super::{LevelSource, Mosaic};
use crate::units::Iso;

/// Share of the range from black by which a decoder's saturation is lowered. Measured bodies clip up to 12 % below
/// the decoder's table (Canon 6D at third-stop ISOs: 13225 against 15000); a limit too low costs highlights, one
/// too high takes clipped sites for measurements.
const DECODER_MARGIN: f32 = 0.15;

/// Largest relative difference between two ISO labels that mean the same.
const SAME_ISO: f64 = 0.01;

/// What a frame tells of body and sensitivity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Origin<'a> {
    /// Camera model.
    pub model: Option<&'a str>,
    /// Body serial number.
    pub serial: Option<&'a str>,
    /// Sensitivity.
    pub iso: Option<Iso>,
}

/// Levels of one ISO, DN, by filter position from the active area's first site; absent where nothing was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelsAt {
    /// ISO label.
    pub iso: Iso,
    /// DN of no light.
    pub black: [[Option<f32>; 2]; 2],
    /// DN from which a site is clipped.
    pub saturation: [[Option<f32>; 2]; 2],
}

/// Levels as they were measured on one body; empty without a measurement.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredLevels {
    /// Camera model.
    pub model: Option<String>,
    /// Body serial number; absent if the shots did not tell it.
    pub serial: Option<String>,
    /// One entry an ISO.
    pub isos: Vec<LevelsAt>,
}

/// Why a session's measured levels do not count for a frame.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unmeasured {
    /// They are another body's.
    #[error(
        "the session's sensor levels were measured on {measured}, this frame is of {frame}; run `unlit calibrate levels` with the body that took the photos, or begin another session for it"
    )]
    OtherBody {
        /// Model and serial number that were measured.
        measured: String,
        /// Model and serial number of the frame.
        frame: String,
    },
    /// They are of other ISOs.
    #[error(
        "sensor levels were measured at {}, not at {}, where the next best source counts; run `unlit calibrate levels` with frames of every ISO in use",
        words(measured),
        words(isos)
    )]
    OtherIso {
        /// The frame's; of several frames those of all.
        isos: Vec<Iso>,
        /// Those measured.
        measured: Vec<Iso>,
    },
    /// The frame does not tell what it takes.
    #[error("the session's sensor levels are not used for a frame that does not tell its {0}")]
    Untold(&'static str),
}

impl MeasuredLevels {
    /// Levels for a frame: of the same model, of no other serial number, at the same ISO; `None` if nothing was measured.
    pub fn find(&self, frame: Origin<'_>) -> Result<Option<&LevelsAt>, Unmeasured> {
        let Some(own) = self.model.as_deref() else { return Ok(None) };
        let model = frame.model.ok_or(Unmeasured::Untold("camera model"))?;
        let other_serial = matches!((&self.serial, frame.serial), (Some(a), Some(b)) if a.trim() != b.trim());
        if other_serial || !same_model(own, model) {
            return Err(Unmeasured::OtherBody {
                measured: body(own, self.serial.as_deref()),
                frame: body(model, frame.serial),
            });
        }
        let iso = frame.iso.ok_or(Unmeasured::Untold("ISO"))?;
        let found = self.isos.iter().find(|at| (at.iso.0 / iso.0 - 1.0).abs() < SAME_ISO);
        let measured = || self.isos.iter().map(|at| at.iso).collect();
        found.map(Some).ok_or_else(|| Unmeasured::OtherIso { isos: vec![iso], measured: measured() })
    }
}

fn words(isos: &[Iso]) -> String {
    isos.iter().map(Iso::to_string).collect::<Vec<_>>().join(", ")
}

fn body(model: &str, serial: Option<&str>) -> String {
    serial.map_or_else(
        || model.trim().to_owned(),
        |serial| format!("{} (serial {})", model.trim(), serial.trim()),
    )
}

/// Gives the frame the best levels known. A source is named [`LevelSource::Measured`] only where all four positions
/// were measured. An error says why the measured levels do not count; the frame then has the next best.
pub fn settle(mosaic: &mut Mosaic, frame: Origin<'_>, measured: &MeasuredLevels) -> Result<(), Unmeasured> {
    let levels = &mut mosaic.levels;
    if levels.saturation_source == LevelSource::DecoderTable {
        let published = frame.model.and_then(|model| SaturationTable::built_in().find(model, frame.iso));
        if let Some(saturation) = published.map(|e| e.saturation).filter(|s| sane(&levels.black, s)) {
            (levels.saturation, levels.saturation_source) = (saturation, LevelSource::BodyTable);
        } else {
            for (saturation, black) in
                levels.saturation.as_flattened_mut().iter_mut().zip(levels.black.as_flattened())
            {
                *saturation -= DECODER_MARGIN * (*saturation - black);
            }
            levels.saturation_source = LevelSource::DecoderMargin;
        }
    }
    let Some(own) = measured.find(frame)? else { return Ok(()) };
    let (black, saturation) =
        (overlaid(levels.black, &own.black), overlaid(levels.saturation, &own.saturation));
    if !sane(&black, &saturation) {
        tracing::warn!(
            "the session's measured levels (black {black:?}, saturation {saturation:?} DN) do not fit this frame and are not used; run `unlit calibrate levels` again"
        );
        return Ok(());
    }
    (levels.black, levels.saturation) = (black, saturation);
    let all = |values: &[[Option<f32>; 2]; 2]| values.as_flattened().iter().all(Option::is_some);
    if all(&own.black) {
        levels.black_source = LevelSource::Measured;
    }
    if all(&own.saturation) {
        levels.saturation_source = LevelSource::Measured;
    }
    Ok(())
}

fn overlaid(mut values: [[f32; 2]; 2], measured: &[[Option<f32>; 2]; 2]) -> [[f32; 2]; 2] {
    for (value, own) in values.as_flattened_mut().iter_mut().zip(measured.as_flattened()) {
        *value = own.unwrap_or(*value);
    }
    values
}

fn sane(black: &[[f32; 2]; 2], saturation: &[[f32; 2]; 2]) -> bool {
    black.as_flattened().iter().zip(saturation.as_flattened()).all(|(b, s)| *s > b + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, Levels};
    use crate::raster::Image;

    fn frame(source: LevelSource) -> Mosaic {
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[14466.0; 2]; 2],
            black_source: LevelSource::MaskedPixels,
            saturation_source: source,
        };
        Mosaic { dn: Image::filled(4, 4, 3000), cfa: Cfa::RGGB, levels }
    }

    fn of(model: &str, iso: f64) -> Origin<'_> {
        Origin { model: Some(model), serial: Some("17"), iso: Some(Iso(iso)) }
    }

    fn measured() -> MeasuredLevels {
        MeasuredLevels {
            model: Some("Canon EOS 5DS".into()),
            serial: Some("17".into()),
            isos: vec![LevelsAt {
                iso: Iso(100.0),
                black: [[Some(2047.5); 2]; 2],
                saturation: [[Some(14700.0); 2]; 2],
            }],
        }
    }

    #[test]
    fn the_sessions_own_levels_beat_the_file_and_the_file_beats_the_built_in_table() {
        let own = measured();
        let settled = |source, frame_of: Origin, measured: &MeasuredLevels| {
            let mut mosaic = frame(source);
            let told = settle(&mut mosaic, frame_of, measured);
            (mosaic.levels.saturation[0][0], mosaic.levels.saturation_source, told)
        };
        let none = MeasuredLevels::default();
        let (decoder, file) = (LevelSource::DecoderTable, LevelSource::FileTag);
        let body = |iso| of("Canon EOS 5DS", iso);
        assert_eq!(settled(file, body(100.0), &own), (14700.0, LevelSource::Measured, Ok(())));
        // What does not count is said, and the next best source stands.
        let not_used = |frame_of: Origin| {
            let (saturation, source, told) = settled(file, frame_of, &own);
            assert_eq!((saturation, source), (14466.0, file));
            told.unwrap_err()
        };
        let iso = not_used(body(200.0)).to_string();
        assert!(iso.contains("measured at ISO 100, not at ISO 200"), "{iso}");
        let serial = not_used(Origin { serial: Some("18"), ..body(100.0) });
        assert!(matches!(serial, Unmeasured::OtherBody { .. }));
        assert!(
            serial.to_string().contains("(serial 17), this frame is of Canon EOS 5DS (serial 18)"),
            "{serial}"
        );
        let model = not_used(of("Canon EOS 6D", 100.0));
        assert!(matches!(model, Unmeasured::OtherBody { .. }));
        assert_eq!(not_used(Origin { model: None, ..body(100.0) }), Unmeasured::Untold("camera model"));
        assert_eq!(settled(decoder, body(100.0), &none), (14733.0, LevelSource::BodyTable, Ok(())));
        let (margin, source, _) = settled(decoder, body(200.0), &none);
        assert_eq!(source, LevelSource::DecoderMargin);
        assert!((margin - (14466.0 - 0.15 * 12418.0)).abs() < 0.5);
        // Settled once more, nothing changes.
        let mut mosaic = frame(decoder);
        settle(&mut mosaic, Origin::default(), &none).unwrap();
        let once = mosaic.clone();
        settle(&mut mosaic, Origin::default(), &none).unwrap();
        assert_eq!(mosaic, once);
    }

    #[test]
    fn black_is_replaced_and_a_colour_not_reached_keeps_the_next_best_source() {
        let mut own = measured();
        own.isos[0].saturation[0][0] = None;
        let mut mosaic = frame(LevelSource::FileTag);
        settle(&mut mosaic, of("EOS 5DS", 100.0), &own).unwrap();
        let levels = mosaic.levels;
        assert_eq!((levels.black, levels.black_source), ([[2047.5; 2]; 2], LevelSource::Measured));
        assert_eq!(levels.saturation, [[14466.0, 14700.0], [14700.0; 2]]);
        assert_eq!(levels.saturation_source, LevelSource::FileTag);
    }
}
