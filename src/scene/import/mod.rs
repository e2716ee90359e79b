//! Camera files of other programs, turned into [`Camera`]s: text in, cameras out, no file is opened here.
//!
//! Each parser converts at the door: world_from_camera with x right, y down, z forward; pixel centres at
//! half-integers; OpenCV's distortion. Lengths stay in the file's unit; [`scale_cameras`] brings them to metres.

pub mod blocks_exchange;
pub mod colmap_text;

use super::Camera;
use glam::{DMat3, DQuat, DVec3};
use std::collections::HashMap;

/// Cameras of one file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportedCameras {
    /// Posed cameras in the file's order and unit of length.
    pub cameras: Vec<Camera>,
    /// Image paths of photos that the file lists without a pose; they take no part.
    pub without_pose: Vec<String>,
}

/// Why cameras could not be imported. Messages say what the file holds and what to export instead.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// XML that is broken or carries a document type.
    #[error("the XML cannot be read: {0}; export the cameras again")]
    Xml(#[from] roxmltree::Error),
    /// Another kind of document.
    #[error("expected {expected}, found {found}")]
    Kind {
        /// What the importer reads.
        expected: &'static str,
        /// What the file starts with.
        found: String,
    },
    /// Something that must be there is not.
    #[error("{place}: {what} is missing; export the cameras with it")]
    Missing {
        /// Where: photogroup, photo or line.
        place: String,
        /// The absent thing.
        what: String,
    },
    /// A value that is no number, or out of its range.
    #[error("{place}: {what} is {value:?}, expected {expected}")]
    Value {
        /// Where: photogroup, photo or line.
        place: String,
        /// Name of the value.
        what: String,
        /// Its text.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A feature of the format that is not converted.
    #[error("{place}: {what} is not supported; {advice}")]
    Unsupported {
        /// Where: photogroup, photo or line.
        place: String,
        /// The feature.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// Two photos whose file stems are the same, so that pairs could not be told apart.
    #[error("{first} and {second} are both called {name}; rename the photos so that their stems differ")]
    SameName {
        /// The stem.
        name: String,
        /// Path of the first.
        first: String,
        /// Path of the second.
        second: String,
    },
    /// No photo has a pose.
    #[error("no photo has a pose ({listed} listed); align the photos before exporting")]
    NoCameras {
        /// Photos listed.
        listed: usize,
    },
}

/// Multiplies camera centres by `metres_per_unit`.
pub fn scale_cameras(cameras: &mut [Camera], metres_per_unit: f64) {
    for camera in cameras {
        camera.world_from_camera.translation *= metres_per_unit;
    }
}

/// File name without folders (of either slash) and without its last extension.
fn stem(path: &str) -> &str {
    let name = path.rsplit(['/', '\\']).next().unwrap_or(path);
    match name.rfind('.') {
        Some(dot) if dot > 0 => &name[..dot],
        _ => name,
    }
}

/// Finite number or an error that names it.
fn number(place: &str, what: &str, text: &str) -> Result<f64, ImportError> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(value_error(place, what, text, "a finite number")),
    }
}

fn value_error(place: &str, what: &str, value: &str, expected: &'static str) -> ImportError {
    ImportError::Value { place: place.into(), what: what.into(), value: value.into(), expected }
}

/// Columns and rows; bounded, so that later products cannot overflow.
fn pixels(place: &str, what: &str, text: &str) -> Result<usize, ImportError> {
    match text.trim().parse::<usize>() {
        Ok(n) if (1..=1_000_000).contains(&n) => Ok(n),
        _ => Err(value_error(place, what, text, "a whole number of pixels from 1 to 1000000")),
    }
}

fn positive(place: &str, what: &str, value: f64) -> Result<f64, ImportError> {
    if value > 0.0 { Ok(value) } else { Err(value_error(place, what, &value.to_string(), "more than 0")) }
}

/// The nearest rotation to a matrix that is one up to rounding.
fn rotation(place: &str, m: DMat3) -> Result<DMat3, ImportError> {
    let off = m * m.transpose() - DMat3::IDENTITY;
    let worst = off.to_cols_array().into_iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    if !(worst < 1e-3 && m.determinant() > 0.0) {
        return Err(value_error(place, "rotation", &format!("{m}"), "an orthonormal right-handed matrix"));
    }
    Ok(DMat3::from_quat(DQuat::from_mat3(&m).normalize()))
}

/// The finishing checks of every importer: someone is there, and no two share a name.
fn finish(found: Vec<(String, Camera)>, without_pose: Vec<String>) -> Result<ImportedCameras, ImportError> {
    if found.is_empty() {
        return Err(ImportError::NoCameras { listed: without_pose.len() });
    }
    let mut seen = HashMap::new();
    for (path, camera) in &found {
        if let Some(first) = seen.insert(camera.name.clone(), path) {
            return Err(ImportError::SameName {
                name: camera.name.clone(),
                first: first.clone(),
                second: path.clone(),
            });
        }
    }
    Ok(ImportedCameras { cameras: found.into_iter().map(|(_, camera)| camera).collect(), without_pose })
}

fn finite_centre(place: &str, centre: DVec3) -> Result<DVec3, ImportError> {
    // Ten thousand kilometres in millimetres still has a ten-thousandth of a millimetre in f64.
    if centre.abs().max_element() < 1e10 {
        Ok(centre)
    } else {
        Err(value_error(place, "centre", &centre.to_string(), "a place within 1e10 units of the origin"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stems_drop_folders_of_both_slashes_and_one_extension() {
        assert_eq!(stem("photos/on/000.dng"), "000");
        assert_eq!(stem(r"D:\shoot\IMG_7.part.CR2"), "IMG_7.part");
        assert_eq!(stem(".hidden"), ".hidden");
        assert_eq!(stem(""), "");
    }

    #[test]
    fn a_mirrored_or_stretched_matrix_is_no_rotation() {
        assert!(rotation("photo", DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))).is_err());
        assert!(rotation("photo", DMat3::IDENTITY * 1.01).is_err());
        assert!(rotation("photo", DMat3::from_rotation_x(0.7)).is_ok());
    }
}
