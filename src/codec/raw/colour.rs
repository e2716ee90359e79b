//! What is known of a camera's colours: the matrix from CIE XYZ to its own RGB.
//!
//! A DNG carries one or two such matrices, each for an illuminant (DNG 1.4, ColorMatrix1 and 2,
//! CalibrationIlluminant1 and 2); of other files the decoder's table knows the model's, for D65. A flash is nearest to
//! daylight, so of two the one for the illuminant nearest to D55 is taken. CameraCalibration and AnalogBalance scale
//! channels (or nearly so), which cancels when white is to stay white, and are left aside.

use super::tiffdir::{self, Directory, tag};
use super::{RawError, boxes};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Colour matrix of a camera under an illuminant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraColour {
    /// Rows R, G, B: camera values of CIE XYZ (1931, Y = 1), up to a factor for each row.
    pub camera_from_xyz: [[f64; 3]; 3],
    /// White of the illuminant, CIE 1931 chromaticity (x, y).
    pub white: [f64; 2],
    /// Where it came from.
    pub source: ColourSource,
}

/// Where a colour matrix came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ColourSource {
    /// The file's own tags.
    FileTag,
    /// The decoder's table of cameras.
    DecoderTable,
}

/// Chromaticity of D65, CIE 15.
const D65: [f64; 2] = [0.3127, 0.3290];

/// EXIF's LightSource numbers with a known white: correlated colour temperature in kelvin, chromaticity.
const ILLUMINANTS: [(u64, f64, [f64; 2]); 9] = [
    (1, 5500.0, [0.3324, 0.3474]),
    (3, 2856.0, [0.4476, 0.4074]),
    (4, 5500.0, [0.3324, 0.3474]),
    (17, 2856.0, [0.4476, 0.4074]),
    (18, 4874.0, [0.3484, 0.3516]),
    (20, 5503.0, [0.3324, 0.3474]),
    (21, 6504.0, D65),
    (22, 7504.0, [0.2990, 0.3149]),
    (23, 5003.0, [0.3457, 0.3585]),
];

/// Colour temperature of a flash, about.
const FLASH: f64 = 5500.0;

/// Reads a file's colour matrix; `None` where neither it nor the decoder's table has one.
pub fn read(path: &Path) -> Result<Option<CameraColour>, RawError> {
    let what = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| RawError::Read { what, source })?;
    Ok(of(&bytes))
}

/// The colour matrix of a file's bytes.
pub fn of(bytes: &[u8]) -> Option<CameraColour> {
    if boxes::is_cr3(bytes) || !tiffdir::is_tiff(bytes) {
        return None;
    }
    let tiff = tiffdir::walk(bytes).ok()?;
    if tiff.directories.iter().any(|d| d.has(tag::DNG_VERSION)) {
        return tiff.directories.iter().find_map(tagged);
    }
    super::table::colour(bytes).and_then(|rows| sane(rows, D65, ColourSource::DecoderTable))
}

fn tagged(directory: &Directory) -> Option<CameraColour> {
    let matrix = |tag: u16, illuminant: u16| {
        let numbers: [f64; 9] = directory.numbers(tag)?.try_into().ok()?;
        let [a, b, c, d, e, f, g, h, i] = numbers;
        // A single matrix may come without its illuminant, which then is not known.
        let number = directory.one(illuminant)?;
        let (_, kelvin, white) = ILLUMINANTS.into_iter().find(|(n, ..)| *n == number)?;
        let colour = sane([[a, b, c], [d, e, f], [g, h, i]], white, ColourSource::FileTag)?;
        Some((colour, (kelvin.ln() - FLASH.ln()).abs()))
    };
    let both = [(tag::COLOR_MATRIX_1, tag::ILLUMINANT_1), (tag::COLOR_MATRIX_2, tag::ILLUMINANT_2)];
    let found = both.into_iter().filter_map(|(m, i)| matrix(m, i));
    found.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(colour, _)| colour)
}

/// Refuses matrices that cannot be turned round or under which white has no colour.
fn sane(rows: [[f64; 3]; 3], white: [f64; 2], source: ColourSource) -> Option<CameraColour> {
    let [a, b, c] = rows;
    let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
    let determinant: f64 = a.iter().zip(cross).map(|(x, y)| x * y).sum();
    let [x, y] = white;
    let xyz = [x / y, 1.0, (1.0 - x - y) / y];
    let neutral = rows.map(|row| row.iter().zip(xyz).map(|(m, v)| m * v).sum::<f64>());
    let fine = determinant.abs() > 1e-6 && neutral.iter().all(|v| *v > 0.0 && v.is_finite());
    fine.then_some(CameraColour { camera_from_xyz: rows, white, source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_that_is_no_colour_matrix_is_none() {
        let good = [[3.2, -1.5, -0.5], [-1.0, 1.9, 0.0], [0.1, -0.2, 1.1]];
        assert!(sane(good, D65, ColourSource::FileTag).is_some());
        assert!(sane([[0.0; 3]; 3], D65, ColourSource::DecoderTable).is_none());
        assert!(sane([good[0], good[0], good[2]], D65, ColourSource::FileTag).is_none());
        assert!(sane([[-3.0, 0.0, 0.0], good[1], good[2]], D65, ColourSource::FileTag).is_none());
        assert_eq!(of(b"II*\0 nothing"), None);
        assert_eq!(of(b""), None);
    }
}
