//! COLMAP's text model: `cameras.txt` and `images.txt`, as its documentation's "Output Format" page defines
//! them. Version 4 adds `rigs.txt` and `frames.txt`; every image still carries its own pose, so they are not
//! needed. Poses map the world to the camera (quaternion w x y z, then translation); the top-left pixel's
//! centre is (0.5, 0.5), as ours.

use super::{ImportError, ImportedCameras};
use crate::scene::{Camera, Distortion, Intrinsics};
use glam::{DAffine3, DQuat, DVec2, DVec3};
use std::collections::HashMap;

/// Parses the texts of `cameras.txt` and `images.txt`. Lengths stay in the model's unit.
pub fn parse(cameras: &str, images: &str) -> Result<ImportedCameras, ImportError> {
    let lenses = lenses(cameras)?;
    let mut found = Vec::new();
    let mut lines = images.lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with('#'));
    while let Some((index, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let (path, camera) = image(&lenses, index + 1, line)?;
        found.push((path, camera));
        // Each image owns a second line, its points in the picture, which may be empty.
        lines.next();
    }
    super::finish(found, Vec::new())
}

fn lenses(text: &str) -> Result<HashMap<u64, Intrinsics>, ImportError> {
    let mut lenses = HashMap::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let place = format!("cameras.txt line {}", index + 1);
        let words: Vec<_> = line.split_whitespace().collect();
        let [id, model, width, height, parameters @ ..] = words.as_slice() else {
            return Err(ImportError::Missing { place, what: "id, model, width or height".into() });
        };
        let parameters = parameters
            .iter()
            .map(|word| super::number(&place, "parameter", word))
            .collect::<Result<Vec<_>, _>>()?;
        let size = (super::pixels(&place, "width", width)?, super::pixels(&place, "height", height)?);
        lenses.insert(id_number(&place, "camera id", id)?, lens(&place, model, size, &parameters)?);
    }
    Ok(lenses)
}

fn id_number(place: &str, what: &str, text: &str) -> Result<u64, ImportError> {
    text.parse().map_err(|_| super::value_error(place, what, text, "a whole number"))
}

fn lens(
    place: &str,
    model: &str,
    (width, height): (usize, usize),
    parameters: &[f64],
) -> Result<Intrinsics, ImportError> {
    let radial = |k1, k2| Distortion { k1, k2, ..Default::default() };
    let (fx, fy, cx, cy, distortion) = match (model, parameters) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => (f, f, cx, cy, radial(0.0, 0.0)),
        ("PINHOLE", &[fx, fy, cx, cy]) => (fx, fy, cx, cy, radial(0.0, 0.0)),
        ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => (f, f, cx, cy, radial(k1, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => (f, f, cx, cy, radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            (fx, fy, cx, cy, Distortion { p1, p2, ..radial(k1, k2) })
        }
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            if [k4, k5, k6] != [0.0; 3] {
                return Err(ImportError::Unsupported {
                    place: place.into(),
                    what: "FULL_OPENCV with k4, k5, k6 other than 0".into(),
                    advice: "align again with the OPENCV model",
                });
            }
            (fx, fy, cx, cy, Distortion { p1, p2, k3, ..radial(k1, k2) })
        }
        ("SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "FULL_OPENCV", _) => {
            return Err(super::value_error(
                place,
                "number of parameters",
                &parameters.len().to_string(),
                "as many as the camera model has",
            ));
        }
        _ => {
            return Err(ImportError::Unsupported {
                place: place.into(),
                what: format!("camera model {model}"),
                advice: "align again with the OPENCV model, or undistort the photos",
            });
        }
    };
    super::positive(place, "focal length", fx.min(fy))?;
    Ok(Intrinsics { width, height, focal: DVec2::new(fx, fy), principal: DVec2::new(cx, cy), distortion })
}

fn image(
    lenses: &HashMap<u64, Intrinsics>,
    line_number: usize,
    line: &str,
) -> Result<(String, Camera), ImportError> {
    let place = format!("images.txt line {line_number}");
    let mut rest = line.trim();
    let mut word = || -> Result<&str, ImportError> {
        let (first, after) = rest
            .split_once(char::is_whitespace)
            .ok_or_else(|| ImportError::Missing { place: place.clone(), what: "pose or name".into() })?;
        rest = after.trim_start();
        Ok(first)
    };
    word()?;
    let mut pose = [0.0; 7];
    for value in &mut pose {
        *value = super::number(&place, "pose", word()?)?;
    }
    let camera_id = id_number(&place, "camera id", word()?)?;
    let path = rest;
    let [w, x, y, z, tx, ty, tz] = pose;
    let quaternion = DQuat::from_xyzw(x, y, z, w);
    if (quaternion.length() - 1.0).abs() > 1e-3 {
        return Err(super::value_error(&place, "quaternion", &quaternion.to_string(), "one of length 1"));
    }
    let camera_from_world =
        DAffine3::from_rotation_translation(quaternion.normalize(), DVec3::new(tx, ty, tz));
    let world_from_camera = camera_from_world.inverse();
    super::finite_centre(&place, world_from_camera.translation)?;
    let intrinsics = *lenses.get(&camera_id).ok_or_else(|| ImportError::Missing {
        place: place.clone(),
        what: format!("camera {camera_id} in cameras.txt"),
    })?;
    Ok((path.to_owned(), Camera { name: super::stem(path).to_owned(), intrinsics, world_from_camera }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: &str = "1 1 0 0 0 0.1 0.2 0.3 7 shoot one/a b.jpg\n\n";

    fn with_model(model: &str) -> Result<Camera, String> {
        parse(&format!("# cameras\n7 {model}\n"), IMAGE)
            .map(|mut i| i.cameras.remove(0))
            .map_err(|e| e.to_string())
    }

    #[test]
    fn camera_models_keep_their_order_of_parameters() {
        let d = |model| with_model(model).unwrap().intrinsics.distortion;
        assert_eq!(with_model("PINHOLE 6 4 5 6 3 2").unwrap().intrinsics.focal, DVec2::new(5.0, 6.0));
        assert_eq!(with_model("SIMPLE_PINHOLE 6 4 5 3 2").unwrap().intrinsics.focal, DVec2::splat(5.0));
        assert_eq!(d("SIMPLE_RADIAL 6 4 5 3 2 0.1").k1, 0.1);
        assert_eq!(d("RADIAL 6 4 5 3 2 0.1 0.2").k2, 0.2);
        let opencv = Distortion { k1: 0.1, k2: 0.2, p1: 0.3, p2: 0.4, k3: 0.0 };
        assert_eq!(d("OPENCV 6 4 5 6 3 2 0.1 0.2 0.3 0.4"), opencv);
        assert_eq!(d("FULL_OPENCV 6 4 5 6 3 2 0.1 0.2 0.3 0.4 0.5 0 0 0"), Distortion { k3: 0.5, ..opencv });
    }

    #[test]
    fn names_may_hold_spaces_and_empty_point_lines_are_no_images() {
        let camera = with_model("PINHOLE 6 4 5 6 3 2").unwrap();
        assert_eq!(camera.name, "a b");
        assert!((camera.centre() + DVec3::new(0.1, 0.2, 0.3)).length() < 1e-15);
    }

    #[test]
    fn a_second_line_of_points_is_never_taken_for_an_image() {
        let images = "1 1 0 0 0 0 0 0 7 a.jpg\n10 20 -1 30 40 5 1 2 3 4 5 6\n2 1 0 0 0 0 0 0 7 b.jpg\n";
        let imported = parse("7 PINHOLE 6 4 5 6 3 2\n", images).unwrap();
        assert_eq!(imported.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
    }

    #[test]
    fn broken_models_are_refused_with_line_and_reason() {
        for (model, word) in [
            ("FULL_OPENCV 6 4 5 6 3 2 0 0 0 0 0 0.1 0 0", "k4"),
            ("OPENCV_FISHEYE 6 4 5 6 3 2 0 0 0 0", "OPENCV_FISHEYE"),
            ("PINHOLE 6 4 5 6 3", "parameters"),
            ("PINHOLE 6 4 -5 6 3 2", "more than 0"),
            ("PINHOLE 6 4 nan 6 3 2", "finite"),
            ("PINHOLE 0 4 5 6 3 2", "width"),
            ("PINHOLE", "cameras.txt line 2"),
        ] {
            let error = with_model(model).expect_err(model);
            assert!(error.contains(word), "{model}: {error}");
        }
        for (images, word) in [
            ("", "align"),
            ("1 1 0 0 0 0 0 0 8 a.jpg\n\n", "camera 8"),
            ("1 2 0 0 0 0 0 0 7 a.jpg\n\n", "length 1"),
            ("1 1 0 0\n\n", "line 1"),
            ("1 1 0 0 0 0 0 0 7 a.jpg\n\n2 1 0 0 0 0 0 0 7 x/a.png\n\n", "x/a.png"),
        ] {
            let error = parse("7 PINHOLE 6 4 5 6 3 2\n", images).expect_err(images).to_string();
            assert!(error.contains(word), "{images:?}: {error}");
        }
    }
}
