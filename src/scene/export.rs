//! Cameras as other programs read them: cameras in, text out. What the importers of [`super::import`] do on the way in is
//! undone here, so that both give the same camera.

use super::{Camera, Distortion, Intrinsics};
use crate::codec::markup::escape;
use glam::{DMat3, DQuat};
use std::fmt::Write as _;

/// A camera and the path of its photo, as the file is to name it.
pub type Photo<'a> = (&'a Camera, String);

/// The lenses of photos, each once, and which photo has which.
fn lenses(photos: &[Photo]) -> (Vec<Intrinsics>, Vec<usize>) {
    let mut found: Vec<Intrinsics> = vec![];
    let mut which = vec![];
    for (camera, _) in photos {
        let known = found.iter().position(|lens| *lens == camera.intrinsics);
        which.push(known.unwrap_or_else(|| {
            found.push(camera.intrinsics);
            found.len() - 1
        }));
    }
    (found, which)
}

/// BlocksExchange XML 2.1 (Metashape, ContextCapture): angles in degrees, lengths in metres, one photogroup a lens.
pub fn blocks_exchange(block: &str, photos: &[Photo]) -> String {
    let (lenses, which) = lenses(photos);
    let mut groups = String::new();
    for (number, lens) in lenses.iter().enumerate() {
        let name = if lenses.len() == 1 { "camera".to_owned() } else { format!("camera {}", number + 1) };
        let (width, height) = (lens.width, lens.height);
        // The format counts the principal point from the centre of the first pixel.
        let (cx, cy) = (lens.principal.x - 0.5, lens.principal.y - 0.5);
        let focal = lens.focal.x * 36.0 / width.max(height) as f64;
        let ratio = lens.focal.y / lens.focal.x;
        let aspect = if ratio == 1.0 {
            String::new()
        } else {
            format!("\n        <AspectRatio>{ratio}</AspectRatio>")
        };
        // P1 and P2 have the opposite roles of OpenCV's.
        let Distortion { k1, k2, p1, p2, k3 } = lens.distortion;
        // Writing to a string cannot fail.
        let _ = write!(
            groups,
            "      <Photogroup>
        <Name>{name}</Name>
        <ImageDimensions><Width>{width}</Width><Height>{height}</Height></ImageDimensions>
        <CameraModelType>Perspective</CameraModelType>
        <FocalLength>{focal}</FocalLength>
        <SensorSize>36</SensorSize>{aspect}
        <CameraOrientation>XRightYDown</CameraOrientation>
        <PrincipalPoint><x>{cx}</x><y>{cy}</y></PrincipalPoint>
        <Distortion><K1>{k1}</K1><K2>{k2}</K2><K3>{k3}</K3><P1>{p2}</P1><P2>{p1}</P2></Distortion>
"
        );
        for (id, ((camera, path), _)) in
            photos.iter().zip(&which).enumerate().filter(|(_, (_, which))| **which == number)
        {
            let [omega, phi, kappa] = omega_phi_kappa(camera.world_from_camera.matrix3);
            let (c, path) = (camera.centre(), escape(path));
            let _ = writeln!(
                groups,
                "        <Photo><Id>{id}</Id><ImagePath>{path}</ImagePath><Pose><Rotation><Omega>{omega:.12}</Omega>\
                 <Phi>{phi:.12}</Phi><Kappa>{kappa:.12}</Kappa></Rotation><Center><x>{}</x><y>{}</y><z>{}</z></Center>\
                 </Pose></Photo>",
                c.x, c.y, c.z
            );
        }
        groups += "      </Photogroup>\n";
    }
    format!(
        r#"<?xml version="1.0" encoding="utf-8"?>
<BlocksExchange version="2.1">
  <Block>
    <Name>{}</Name>
    <Photogroups>
{groups}    </Photogroups>
  </Block>
</BlocksExchange>
"#,
        escape(block)
    )
}

/// Angles in degrees of a rotation Rx(omega) Ry(phi) Rz(kappa).
fn omega_phi_kappa(rotation: DMat3) -> [f64; 3] {
    let (x, y, z) = (rotation.x_axis, rotation.y_axis, rotation.z_axis);
    [(-z.y).atan2(z.z), z.x.clamp(-1.0, 1.0).asin(), (-y.x).atan2(x.x)].map(f64::to_degrees)
}

/// COLMAP's `cameras.txt`.
pub fn colmap_cameras(photos: &[Photo]) -> String {
    let mut text = "# Camera list: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n".to_owned();
    for (number, lens) in lenses(photos).0.iter().enumerate() {
        let Distortion { k1, k2, p1, p2, k3 } = lens.distortion;
        let (model, more) = match lens.distortion {
            d if d == Distortion::default() => ("PINHOLE", String::new()),
            _ if k3 == 0.0 => ("OPENCV", format!(" {k1} {k2} {p1} {p2}")),
            _ => ("FULL_OPENCV", format!(" {k1} {k2} {p1} {p2} {k3} 0 0 0")),
        };
        let (f, c) = (lens.focal, lens.principal);
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} {model} {} {} {} {} {} {}{more}",
            number + 1,
            lens.width,
            lens.height,
            f.x,
            f.y,
            c.x,
            c.y
        );
    }
    text
}

/// COLMAP's `images.txt`.
pub fn colmap_images(photos: &[Photo]) -> String {
    let mut text =
        "# Image list: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then an empty POINTS2D line\n"
            .to_owned();
    let which = lenses(photos).1;
    for (id, ((camera, path), lens)) in photos.iter().zip(which).enumerate() {
        let camera_from_world = camera.world_from_camera.inverse();
        let q = DQuat::from_mat3(&camera_from_world.matrix3).normalize();
        let t = camera_from_world.translation;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} {} {} {} {} {} {} {} {} {path}\n",
            id + 1,
            q.w,
            q.x,
            q.y,
            q.z,
            t.x,
            t.y,
            t.z,
            lens + 1
        );
    }
    text
}

/// RealityScan's (RealityCapture's) XMP sidecar of one photo: rotation from world to camera row by row, the centre, and
/// the lens in units of the longer side from the picture's middle. The format's tangential terms and aspect ratio are not
/// written: [`reality_scan_lacks`] says whether a camera would need them.
pub fn reality_scan(camera: &Camera) -> String {
    let lens = camera.intrinsics;
    let longer = lens.width.max(lens.height) as f64;
    let focal = lens.focal.x * 36.0 / longer;
    let u = (lens.principal.x - lens.width as f64 / 2.0) / longer;
    let v = (lens.principal.y - lens.height as f64 / 2.0) / longer;
    let rows = camera.world_from_camera.matrix3.to_cols_array().map(|n| n.to_string()).join(" ");
    let c = camera.centre();
    let Distortion { k1, k2, k3, .. } = lens.distortion;
    // Where the lens is not told in full, the program may settle it.
    let prior = if reality_scan_lacks(camera) { "initial" } else { "exact" };
    format!(
        r#"<x:xmpmeta xmlns:x="adobe:ns:meta/">
  <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
    <rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:Version="3" xcr:PosePrior="locked"
       xcr:Coordinates="absolute" xcr:DistortionModel="brown3" xcr:FocalLength35mm="{focal}" xcr:Skew="0"
       xcr:AspectRatio="1" xcr:PrincipalPointU="{u}" xcr:PrincipalPointV="{v}" xcr:CalibrationPrior="{prior}">
      <xcr:Rotation>{rows}</xcr:Rotation>
      <xcr:Position>{} {} {}</xcr:Position>
      <xcr:DistortionCoeficients>{k1} {k2} {k3} 0 0 0</xcr:DistortionCoeficients>
    </rdf:Description>
  </rdf:RDF>
</x:xmpmeta>
"#,
        c.x, c.y, c.z
    )
}

/// Whether a camera's lens is more than [`reality_scan`] writes: tangential terms, or two focal lengths.
pub fn reality_scan_lacks(camera: &Camera) -> bool {
    let Intrinsics { focal, distortion: Distortion { p1, p2, .. }, .. } = camera.intrinsics;
    (p1, p2) != (0.0, 0.0) || (focal.x / focal.y - 1.0).abs() > 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::{blocks_exchange as blocks_in, colmap_text};
    use glam::{DAffine3, DVec2, DVec3};

    /// Three views through two lenses, turned every way.
    fn cameras() -> Vec<Camera> {
        let lens = Intrinsics {
            width: 600,
            height: 400,
            focal: DVec2::new(700.0, 705.0),
            principal: DVec2::new(299.0, 203.5),
            distortion: Distortion { k1: -0.11, k2: 0.03, p1: 0.001, p2: -0.0007, k3: 0.002 },
        };
        let plain = Intrinsics { focal: DVec2::splat(650.0), distortion: Distortion::default(), ..lens };
        let camera = |name: &str, intrinsics, turn: f64| Camera {
            name: name.into(),
            intrinsics,
            world_from_camera: DAffine3::from_mat3_translation(
                DMat3::from_rotation_x(turn)
                    * DMat3::from_rotation_y(-1.1)
                    * DMat3::from_rotation_z(2.0 * turn),
                DVec3::new(0.3 + turn, -0.2, 1.5),
            ),
        };
        vec![camera("a", lens, 0.4), camera("b & c", plain, 2.1), camera("d", lens, -2.9)]
    }

    fn same_pixels(ours: &[Camera], theirs: &[Camera]) {
        let find = |name: &str| theirs.iter().find(|camera| camera.name == name).unwrap();
        for camera in ours {
            for pixel in [DVec2::new(0.5, 0.5), DVec2::new(599.5, 12.25), DVec2::new(310.0, 399.0)] {
                let point = camera.centre() + camera.ray(pixel) * 0.83;
                let (back, _) = find(&camera.name).project(point).unwrap();
                assert!((back - pixel).length() < 1e-6, "{} {back} for {pixel}", camera.name);
            }
        }
        assert_eq!(ours.len(), theirs.len());
    }

    #[test]
    fn what_is_written_is_read_as_the_same_cameras() {
        let ours = cameras();
        let photos: Vec<Photo> = ours.iter().map(|c| (c, format!("images/{}.tif", c.name))).collect();
        let xml = blocks_exchange("<bath>", &photos);
        same_pixels(&ours, &blocks_in::parse(&xml).unwrap().cameras);
        let (lenses, poses) = (colmap_cameras(&photos), colmap_images(&photos));
        same_pixels(&ours, &colmap_text::parse(&lenses, &poses).unwrap().cameras);
        assert!(lenses.contains("1 FULL_OPENCV") && lenses.contains("2 PINHOLE"), "{lenses}");
    }

    /// The format's own words: x = R (X - centre), lengths of the longer side, the middle at 0.
    #[test]
    fn a_sidecar_projects_to_the_same_pixels() {
        for camera in cameras() {
            let mut camera = camera;
            camera.intrinsics.focal.y = camera.intrinsics.focal.x;
            (camera.intrinsics.distortion.p1, camera.intrinsics.distortion.p2) = (0.0, 0.0);
            assert!(!reality_scan_lacks(&camera));
            let text = reality_scan(&camera);
            let document = roxmltree::Document::parse(&text).unwrap();
            let about = document.descendants().find(|n| n.tag_name().name() == "Description").unwrap();
            let xcr = "http://www.capturingreality.com/ns/xcr/1.1#";
            let number = |name| about.attribute((xcr, name)).unwrap().parse::<f64>().unwrap();
            let numbers = |name| -> Vec<f64> {
                let node = about.children().find(|n| n.tag_name().name() == name).unwrap();
                node.text().unwrap().split(' ').map(|n| n.parse().unwrap()).collect()
            };
            let (r, k) = (numbers("Rotation"), numbers("DistortionCoeficients"));
            let centre = DVec3::from_slice(&numbers("Position"));
            for pixel in [DVec2::new(0.5, 0.5), DVec2::new(599.5, 12.25)] {
                let d = camera.centre() + camera.ray(pixel) * 0.83 - centre;
                let x = |row: usize| r[3 * row] * d.x + r[3 * row + 1] * d.y + r[3 * row + 2] * d.z;
                let (x, y) = (x(0) / x(2), x(1) / x(2));
                let r2 = x * x + y * y;
                let radial = 1.0 + k[0] * r2 + k[1] * r2.powi(2) + k[2] * r2.powi(3);
                let focal = number("FocalLength35mm") / 36.0;
                let at = |x: f64, principal, side: f64| {
                    600.0 * (focal * x * radial + number(principal)) + side / 2.0
                };
                let back = DVec2::new(at(x, "PrincipalPointU", 600.0), at(y, "PrincipalPointV", 400.0));
                assert!((back - pixel).length() < 1e-6, "{back} for {pixel}");
            }
        }
    }
}
