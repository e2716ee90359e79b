//! BlocksExchange XML (ContextCapture, iTwin Capture; versions 2.1 and 3.2), as Bentley's user guide defines
//! it in "Perspective camera model".
//!
//! Rotation maps the world to the camera's axes, which `CameraOrientation` names by where x and y point in
//! the image; from angles it is (Rx(omega) Ry(phi) Rz(kappa)) transposed. Focal length in pixels is
//! `FocalLength` * longer side / `SensorSize`. The principal point counts from the centre of the top-left
//! pixel. P1 and P2 have the opposite roles of OpenCV's. `Pose/Metadata` may hold a second, measured pose,
//! so only direct children are read.

use super::{ImportError, ImportedCameras};
use crate::scene::{Camera, Distortion, Intrinsics};
use glam::{DAffine3, DMat3, DVec2, DVec3};
use roxmltree::{Document, Node};

/// Parses a whole file. Lengths stay in the unit of the file's coordinate system.
pub fn parse(text: &str) -> Result<ImportedCameras, ImportError> {
    // A document type could pull in other files; the parser refuses it by default.
    let document = Document::parse(text)?;
    let root = document.root_element();
    if root.tag_name().name() != "BlocksExchange" {
        return Err(ImportError::Kind {
            expected: "a BlocksExchange XML file",
            found: format!("an XML file that starts with <{}>", root.tag_name().name()),
        });
    }
    let mut found = Vec::new();
    let mut without_pose = Vec::new();
    for block in root.children().filter(|n| n.has_tag_name("Block")) {
        refuse_degrees(root, block)?;
        let groups = block.children().filter(|n| n.has_tag_name("Photogroups"));
        for (i, group) in
            groups.flat_map(|g| g.children().filter(|n| n.has_tag_name("Photogroup"))).enumerate()
        {
            let place = match text_of(group, "Name") {
                Some(name) => format!("photogroup {name:?}"),
                None => format!("photogroup {}", i + 1),
            };
            // Groups whose photos have no pose may lack a calibration, and need none.
            let mut lens = None;
            for photo in group.children().filter(|n| n.has_tag_name("Photo")) {
                let path = required(photo, "ImagePath", &place)?;
                let place_of_photo = format!("photo {path}");
                let Some(pose) = pose(photo, &place_of_photo)? else {
                    without_pose.push(path.to_owned());
                    continue;
                };
                let (intrinsics, axes) = match lens {
                    Some(lens) => lens,
                    None => *lens.insert((intrinsics(group, &place)?, axes(group, &place)?)),
                };
                let (camera_from_world, centre) = pose;
                let rotation = super::rotation(&place_of_photo, axes * camera_from_world)?.transpose();
                let camera = Camera {
                    name: super::stem(path).to_owned(),
                    intrinsics,
                    world_from_camera: DAffine3::from_mat3_translation(rotation, centre),
                };
                found.push((path.to_owned(), camera));
            }
        }
    }
    super::finish(found, without_pose)
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|n| n.is_element() && n.tag_name().name() == name)
}

fn text_of<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    child(node, name)?.text().map(str::trim).filter(|t| !t.is_empty())
}

fn required<'a>(node: Node<'a, '_>, name: &str, place: &str) -> Result<&'a str, ImportError> {
    text_of(node, name).ok_or_else(|| ImportError::Missing { place: place.into(), what: name.into() })
}

fn number(node: Node<'_, '_>, name: &str, place: &str) -> Result<Option<f64>, ImportError> {
    text_of(node, name).map(|text| super::number(place, name, text)).transpose()
}

/// Coordinates in degrees are no lengths; metric systems pass.
fn refuse_degrees(root: Node<'_, '_>, block: Node<'_, '_>) -> Result<(), ImportError> {
    let Some(id) = text_of(block, "SRSId") else { return Ok(()) };
    let definition = child(root, "SpatialReferenceSystems")
        .into_iter()
        .flat_map(|list| list.children().filter(|n| n.has_tag_name("SRS")))
        .find(|srs| text_of(*srs, "Id") == Some(id))
        .and_then(|srs| text_of(srs, "Definition"));
    let Some(definition) = definition else { return Ok(()) };
    let upper = definition.to_ascii_uppercase();
    let geographic = ["WGS84", "EPSG:4326", "EPSG:4979"].contains(&upper.as_str())
        || upper.contains("PROJ=LONGLAT")
        || (upper.starts_with("GEOGCS") || upper.starts_with("GEOGCRS"));
    if geographic {
        return Err(ImportError::Unsupported {
            place: "spatial reference system".into(),
            what: format!("{definition:?}, whose unit is degrees,"),
            advice: "export in a local or projected coordinate system in metres",
        });
    }
    Ok(())
}

/// World-to-camera rotation in the camera's own axes, and the centre; `None` for a photo without either.
fn pose(photo: Node<'_, '_>, place: &str) -> Result<Option<(DMat3, DVec3)>, ImportError> {
    let Some(pose) = child(photo, "Pose") else { return Ok(None) };
    let (Some(rotation), Some(centre)) = (child(pose, "Rotation"), child(pose, "Center")) else {
        return Ok(None);
    };
    let coordinate = |name| super::number(place, name, required(centre, name, place)?);
    let centre =
        super::finite_centre(place, DVec3::new(coordinate("x")?, coordinate("y")?, coordinate("z")?))?;
    let angle = |name| -> Result<f64, ImportError> {
        Ok(super::number(place, name, required(rotation, name, place)?)?.to_radians())
    };
    let matrix = if child(rotation, "M_00").is_some() {
        let mut rows = [0.0; 9];
        for (i, value) in rows.iter_mut().enumerate() {
            let name = format!("M_{}{}", i / 3, i % 3);
            *value = super::number(place, &name, required(rotation, &name, place)?)?;
        }
        DMat3::from_cols_array(&rows).transpose()
    } else if child(rotation, "Omega").is_some() {
        let world_from_camera = DMat3::from_rotation_x(angle("Omega")?)
            * DMat3::from_rotation_y(angle("Phi")?)
            * DMat3::from_rotation_z(angle("Kappa")?);
        world_from_camera.transpose()
    } else {
        let names: Vec<_> =
            rotation.children().filter(Node::is_element).map(|n| n.tag_name().name()).collect();
        return Err(ImportError::Unsupported {
            place: place.into(),
            what: format!("a rotation given as {}", names.join("/")),
            advice: "export rotations as omega/phi/kappa or as a matrix",
        });
    };
    Ok(Some((matrix, centre)))
}

/// Rotation from the group's camera axes to ours (x right, y down, z forward).
fn axes(group: Node<'_, '_>, place: &str) -> Result<DMat3, ImportError> {
    let name = text_of(group, "CameraOrientation").unwrap_or("XRightYDown");
    let direction = |word: &str| match word {
        "Right" => Some(DVec3::X),
        "Left" => Some(DVec3::NEG_X),
        "Down" => Some(DVec3::Y),
        "Up" => Some(DVec3::NEG_Y),
        _ => None,
    };
    let parts = name.strip_prefix('X').and_then(|rest| rest.split_once('Y'));
    if let Some((Some(x), Some(y))) = parts.map(|(x, y)| (direction(x), direction(y)))
        && x.dot(y) == 0.0
    {
        return Ok(DMat3::from_cols(x, y, x.cross(y)));
    }
    Err(super::value_error(place, "CameraOrientation", name, "XRightYDown or one of its seven turns"))
}

fn intrinsics(group: Node<'_, '_>, place: &str) -> Result<Intrinsics, ImportError> {
    let unsupported = |what: String, advice| ImportError::Unsupported { place: place.into(), what, advice };
    if let Some(model) = text_of(group, "CameraModelType")
        && model != "Perspective"
    {
        return Err(unsupported(
            format!("camera model {model}"),
            "undistort the photos and export perspective cameras",
        ));
    }
    let missing = |what: &str| ImportError::Missing { place: place.into(), what: what.into() };
    let size = child(group, "ImageDimensions").ok_or_else(|| missing("ImageDimensions"))?;
    let width = super::pixels(place, "Width", required(size, "Width", place)?)?;
    let height = super::pixels(place, "Height", required(size, "Height", place)?)?;
    let millimetres = number(group, "FocalLength", place)?;
    let focal = match (number(group, "FocalLengthPixels", place)?, millimetres) {
        (Some(pixels), _) => pixels,
        (None, None) => return Err(missing("FocalLength or FocalLengthPixels")),
        (None, Some(focal)) => {
            match (number(group, "SensorSize", place)?, number(group, "PixelSize", place)?) {
                (Some(sensor), _) => {
                    focal * width.max(height) as f64 / super::positive(place, "SensorSize", sensor)?
                }
                (None, Some(pixel)) => focal / super::positive(place, "PixelSize", pixel)?,
                (None, None) => return Err(missing("SensorSize or PixelSize, beside FocalLength,")),
            }
        }
    };
    let focal = super::positive(place, "focal length", focal)?;
    let ratio = super::positive(place, "AspectRatio", number(group, "AspectRatio", place)?.unwrap_or(1.0))?;
    if number(group, "Skew", place)?.is_some_and(|skew| skew.abs() > 1e-9) {
        return Err(unsupported("Skew other than 0".into(), "align again with skew fixed at 0"));
    }
    let centre = DVec2::new(width as f64, height as f64) / 2.0;
    let principal = match child(group, "PrincipalPoint") {
        None => centre,
        Some(point) => match (number(point, "x", place)?, number(point, "y", place)?) {
            (Some(x), Some(y)) => DVec2::new(x, y) + 0.5,
            _ => {
                return Err(unsupported(
                    "a PrincipalPoint that is not given as x and y in pixels".into(),
                    "export it in pixels",
                ));
            }
        },
    };
    let distortion = match child(group, "Distortion") {
        None => Distortion::default(),
        Some(d) => {
            let k = |name| Ok::<_, ImportError>(number(d, name, place)?.unwrap_or(0.0));
            Distortion { k1: k("K1")?, k2: k("K2")?, k3: k("K3")?, p1: k("P2")?, p2: k("P1")? }
        }
    };
    Ok(Intrinsics { width, height, focal: DVec2::new(focal, focal * ratio), principal, distortion })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(lens: &str, photos: &str) -> String {
        format!(
            "<BlocksExchange version='2.1'><Block><Photogroups><Photogroup>\
             <ImageDimensions><Width>600</Width><Height>400</Height></ImageDimensions>{lens}{photos}\
             </Photogroup></Photogroups></Block></BlocksExchange>"
        )
    }

    fn photo(path: &str, rotation: &str) -> String {
        format!(
            "<Photo><ImagePath>{path}</ImagePath><Pose><Rotation>{rotation}</Rotation>\
             <Center><x>1</x><y>2</y><z>3</z></Center></Pose></Photo>"
        )
    }

    const LENS: &str = "<FocalLength>45.5</FocalLength><SensorSize>36</SensorSize>";
    const FLAT: &str = "<Omega>0</Omega><Phi>0</Phi><Kappa>0</Kappa>";

    fn one(lens: &str) -> Camera {
        parse(&file(lens, &photo("a.jpg", FLAT))).unwrap().cameras.remove(0)
    }

    #[test]
    fn focal_length_has_three_spellings() {
        for lens in [
            LENS,
            "<FocalLengthPixels>758.3333333333334</FocalLengthPixels>",
            "<FocalLength>45.5</FocalLength><PixelSize>0.06</PixelSize>",
        ] {
            let focal = one(lens).intrinsics.focal;
            assert!((focal - DVec2::splat(45.5 * 600.0 / 36.0)).length() < 1e-9, "{focal}");
        }
        let tall = one(&format!("{LENS}<AspectRatio>1.01</AspectRatio>")).intrinsics.focal;
        assert!((tall.y / tall.x - 1.01).abs() < 1e-12);
    }

    #[test]
    fn principal_point_moves_by_half_a_pixel_and_tangential_terms_swap() {
        let lens = format!(
            "{LENS}<PrincipalPoint><x>299.5</x><y>190</y></PrincipalPoint>\
             <Distortion><K1>0.1</K1><P1>0.01</P1><P2>-0.02</P2></Distortion>"
        );
        let intrinsics = one(&lens).intrinsics;
        assert_eq!(intrinsics.principal, DVec2::new(300.0, 190.5));
        assert_eq!(intrinsics.distortion, Distortion { k1: 0.1, p1: -0.02, p2: 0.01, ..Default::default() });
        assert_eq!(one(LENS).intrinsics.principal, DVec2::new(300.0, 200.0));
    }

    #[test]
    fn all_eight_camera_orientations_are_turned_to_ours() {
        // With no rotation the camera's own x and y are the world's: their images must point as named.
        for (name, x, y) in [
            ("XRightYDown", DVec2::X, DVec2::Y),
            ("XLeftYDown", DVec2::NEG_X, DVec2::Y),
            ("XLeftYUp", DVec2::NEG_X, DVec2::NEG_Y),
            ("XRightYUp", DVec2::X, DVec2::NEG_Y),
            ("XDownYRight", DVec2::Y, DVec2::X),
            ("XDownYLeft", DVec2::Y, DVec2::NEG_X),
            ("XUpYLeft", DVec2::NEG_Y, DVec2::NEG_X),
            ("XUpYRight", DVec2::NEG_Y, DVec2::X),
        ] {
            let camera = one(&format!("{LENS}<CameraOrientation>{name}</CameraOrientation>"));
            let ahead = camera.centre() + camera.ray(camera.intrinsics.principal);
            let (origin, _) = camera.project(ahead).unwrap();
            let (along_x, _) = camera.project(ahead + DVec3::X * 0.1).unwrap();
            let (along_y, _) = camera.project(ahead + DVec3::Y * 0.1).unwrap();
            assert!(((along_x - origin).normalize() - x).length() < 1e-9, "{name}");
            assert!(((along_y - origin).normalize() - y).length() < 1e-9, "{name}");
        }
    }

    #[test]
    fn photos_without_a_centre_are_counted_not_placed() {
        let photos = format!(
            "{}<Photo><ImagePath>b.jpg</ImagePath><Pose><Rotation>{FLAT}</Rotation></Pose></Photo>\
             <Photo><ImagePath>c.jpg</ImagePath></Photo>",
            photo("a.jpg", FLAT)
        );
        let imported = parse(&file(LENS, &photos)).unwrap();
        assert_eq!(imported.cameras.len(), 1);
        assert_eq!(imported.without_pose, ["b.jpg", "c.jpg"]);
    }

    #[test]
    fn what_cannot_be_converted_says_what_to_export_instead() {
        let ypr = "<Yaw>0</Yaw><Pitch>0</Pitch><Roll>0</Roll>";
        let a = photo("a.jpg", FLAT);
        for (text, word) in [
            (file(LENS, &photo("a.jpg", ypr)), "Yaw/Pitch/Roll"),
            (file(&format!("{LENS}<CameraModelType>Fisheye</CameraModelType>"), &a), "Fisheye"),
            (file(&format!("{LENS}<CameraOrientation>XUpYDown</CameraOrientation>"), &a), "XUpYDown"),
            (file(&format!("{LENS}<Skew>0.1</Skew>"), &a), "Skew"),
            (file("<FocalLength>50</FocalLength>", &a), "SensorSize"),
            (file("<FocalLengthPixels>0</FocalLengthPixels>", &a), "more than 0"),
            (file("<FocalLengthPixels>NaN</FocalLengthPixels>", &a), "finite"),
            (file(LENS, &(a.clone() + &photo("x/a.png", FLAT))), "x/a.png"),
            (file(LENS, ""), "align"),
            ("<!DOCTYPE x [<!ENTITY e SYSTEM 'file:///etc/passwd'>]><x>&e;</x>".into(), "XML"),
            ("<document/>".into(), "<document>"),
            (file(LENS, &a).replace("<Block>", "<SpatialReferenceSystems><SRS><Id>0</Id><Definition>WGS84</Definition></SRS></SpatialReferenceSystems><Block><SRSId>0</SRSId>"), "degrees"),
        ] {
            let error = parse(&text).expect_err(word).to_string();
            assert!(error.contains(word), "{error:?} lacks {word:?}");
        }
    }
}
