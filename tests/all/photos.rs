//! A session as a folder for photogrammetry.

use crate::samples::shared;
use crate::scene_import::{bare_session, import_birdbath};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use unlit::pair::{Reason, ReasonCode, Settings};
use unlit::pipeline::photos::{self, Light, PhotosError, PhotosExported, PhotosOptions, Picture, Program};
use unlit::progress::Progress;
use unlit::scene::Camera;
use unlit::scene::import::{blocks_exchange, colmap_text};
use unlit::session::{More, NewFrame, NewPair, Session};

/// Stores a pair of the birdbath, under its name.
fn store(session: &Session, name: &str, reasons: Vec<Reason>) {
    let read = |side: &str| std::fs::read(shared(&format!("scenes/birdbath/photos/{side}/000.dng"))).unwrap();
    let (off, on) = (read("off"), read("on"));
    let frame = |bytes| NewFrame {
        bytes,
        original_name: "000.dng",
        settings: Settings {
            make: Some("Maker".into()),
            model: Some("Maker One".into()),
            focal_length_mm: Some(45.5),
            ..unlit::codec::exif::settings(bytes)
        },
        prepared: None,
        jpeg: None,
    };
    session
        .commit_pair(NewPair {
            name: Some(name),
            off: frame(&off),
            on: frame(&on),
            reasons,
            flash: None,
            more: More::default(),
        })
        .unwrap();
}

fn export(session: &Session, to: &Path, program: Program, light: Light, picture: Picture) -> PhotosExported {
    photos::export(session, to, PhotosOptions { program, light, picture }, &Progress::silent()).unwrap()
}

/// What exiftool, which shares nothing with us, says of a file.
fn exif(file: &Path) -> Value {
    let run = Command::new("exiftool").args(["-j", "-n"]).arg(file).output().unwrap();
    serde_json::from_slice::<Value>(&run.stdout).unwrap()[0].take()
}

/// The largest distance in pixels between where two cameras see the object's corners.
fn apart(a: &Camera, b: &Camera) -> f64 {
    let mut worst = 0.0f64;
    for i in 0..8 {
        let corner = |bit: i32| if i >> bit & 1 == 1 { 0.15 } else { -0.15 };
        let point = glam::DVec3::new(corner(0), corner(1), 0.1 + corner(2));
        let (p, q) = (a.project(point).unwrap().0, b.project(point).unwrap().0);
        worst = worst.max((p - q).length());
    }
    worst
}

#[test]
fn photos_bear_the_pairs_names_and_cameras_come_back_the_same() {
    let (folder, session) = bare_session();
    for name in ["000", "001"] {
        store(&session, name, vec![]);
    }
    let reason = Reason { code: ReasonCode::Moved, figure: 2.0, limit: 1.0, sentence: "It moved.".into() };
    store(&session, "002", vec![reason]);
    let ours = import_birdbath(&session, "cameras.xml").cameras;
    let own = |name: &str| ours.iter().find(|camera| camera.name == name).unwrap();

    let colmap = folder.path().join("colmap");
    let exported = export(&session, &colmap, Program::Colmap, Light::Known, Picture::Jpeg);
    assert_eq!(exported.photos, ["000", "001"].map(|name| colmap.join(format!("images/{name}.jpg"))));
    assert!(exported.notes.iter().any(|note| note.contains("rejected: 002")), "{:?}", exported.notes);
    let text = |name: &str| std::fs::read_to_string(colmap.join("sparse/0").join(name)).unwrap();
    let back = colmap_text::parse(&text("cameras.txt"), &text("images.txt")).unwrap().cameras;
    assert_eq!(back.len(), 2);
    back.iter().for_each(|camera| assert!(apart(camera, own(&camera.name)) < 0.01, "{}", camera.name));
    let readme = std::fs::read_to_string(colmap.join("README.txt")).unwrap();
    assert!(readme.contains("not undistorted") && readme.contains("002"), "{readme}");
    let told = exif(&exported.photos[0]);
    assert_eq!((&told["FocalLength"], &told["Model"]), (&45.5.into(), &"Maker One".into()), "{told}");
    assert_eq!((&told["ImageWidth"], &told["Orientation"]), (&own("000").intrinsics.width.into(), &1.into()));

    let metashape = folder.path().join("metashape");
    let exported = export(&session, &metashape, Program::Metashape, Light::Lit, Picture::Tiff);
    let xml = std::fs::read_to_string(metashape.join("cameras.xml")).unwrap();
    let back = blocks_exchange::parse(&xml).unwrap().cameras;
    back.iter().for_each(|camera| assert!(apart(camera, own(&camera.name)) < 0.01, "{}", camera.name));
    assert!(xml.contains("<ImagePath>000.tif</ImagePath>"), "{xml}");
    let told = exif(&exported.photos[1]);
    assert_eq!((&told["FocalLength"], &told["BitsPerSample"]), (&45.5.into(), &"16 16 16".into()), "{told}");
    let lit = unlit::codec::tiff16::read_rgb(&exported.photos[0]).unwrap();
    let mean = lit.pixels().iter().flatten().sum::<f32>() / (3 * lit.pixels().len()) as f32;
    let bright = lit.pixels().iter().filter(|p| p.iter().any(|v| *v > 0.9)).count();
    assert!(mean > 0.1 && bright > 100, "mean {mean}, {bright} bright pixels");

    let realityscan = folder.path().join("realityscan");
    let exported = export(&session, &realityscan, Program::RealityScan, Light::Ambient, Picture::Jpeg);
    let told = exif(&realityscan.join("000.xmp"));
    assert_eq!(told["PosePrior"], "locked", "{told}");
    assert_eq!(exported.files.len(), 2 + 1);

    let again = photos::export(
        &session,
        &colmap,
        PhotosOptions { program: Program::Colmap, light: Light::Lit, picture: Picture::Jpeg },
        &Progress::silent(),
    );
    assert!(matches!(again, Err(PhotosError::NotEmpty(_))));
}

#[test]
fn without_a_scene_there_are_photos_alone_and_without_pairs_nothing() {
    let (folder, session) = bare_session();
    let options = PhotosOptions { program: Program::Colmap, light: Light::Lit, picture: Picture::Jpeg };
    let to = folder.path().join("photos");
    let none = photos::export(&session, &to, options, &Progress::silent());
    assert!(matches!(none, Err(PhotosError::NoPairs(_))) && !to.exists());
    let inside = photos::export(&session, &session.path().join("photos"), options, &Progress::silent());
    assert!(matches!(inside, Err(PhotosError::Folder(_))));
    store(&session, "000", vec![]);
    let path = session.path().to_owned();
    drop(session);
    let run = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args([
            "export-photos",
            path.to_str().unwrap(),
            "--for",
            "metashape",
            "--light",
            "lit",
            "--picture",
            "jpeg",
        ])
        .args(["--to", to.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(run.status.success(), "{run:?}");
    let mut names: Vec<_> =
        std::fs::read_dir(&to).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["000.jpg", "README.txt"]);
}
