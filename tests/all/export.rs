//! A mesh without texture coordinates through the whole job, and its model in every format, read by others.

use crate::samples::shared;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tiff::decoder::Decoder;
use tiff::tags::Tag;
use unlit::codec::raw::colour::{self, ColourSource};
use unlit::codec::{exr_image, tiff16};
use unlit::raster::srgb;

fn file(path: &str) -> String {
    shared(&format!("scenes/birdbath/{path}")).display().to_string()
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

/// Runs the program; gives what it printed.
fn unlit(arguments: &[&str]) -> String {
    let output = run(arguments);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?} ended with {}: {said}{complained}", output.status);
    said
}

/// What the program complains of when it must fail.
fn refused(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(1), "unlit {arguments:?} did not fail");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The object as a program exports it that unwraps nothing.
fn bare_object(folder: &Path) -> PathBuf {
    let text = std::fs::read_to_string(file("geometry/object.obj")).unwrap();
    let bare: String = text
        .lines()
        .filter(|line| !line.starts_with("vt "))
        .map(|line| {
            let corner = |word: &str| word.split('/').next().unwrap_or_default().to_owned();
            let words: Vec<String> = line.split(' ').map(corner).collect();
            if line.starts_with("f ") { words.join(" ") + "\n" } else { format!("{line}\n") }
        })
        .collect();
    let path = folder.join("object.obj");
    std::fs::write(&path, bare).unwrap();
    path
}

/// A session of four views whose object has no texture coordinates, up to its calibration.
fn prepared(folder: &Path) -> String {
    let object = bare_object(folder);
    let (off, on) = (folder.join("off"), folder.join("on"));
    for (side, to) in [("off", &off), ("on", &on)] {
        std::fs::create_dir(to).unwrap();
        for stem in ["000", "006", "012", "018"] {
            let name = format!("{stem}.dng");
            std::fs::copy(file(&format!("photos/{side}/{name}")), to.join(&name)).unwrap();
        }
    }
    let path = |p: &Path| p.to_str().unwrap().to_owned();
    let session = path(&folder.join("session"));
    unlit(&["new", &session]);
    unlit(&["import", "pairs", &session, "--off", &path(&off), "--on", &path(&on)]);
    let (cameras, floor) = (file("geometry/cameras.xml"), file("geometry/floor.obj"));
    let said = unlit(&[
        "import",
        "scene",
        &session,
        "--cameras",
        &cameras,
        "--mesh",
        &path(&object),
        "--mesh",
        &floor,
    ]);
    assert!(said.contains("without UVs"), "{said}");
    let shots = ["0.5=d0500", "0.8=d0800", "1.3=d1300"].map(|shot| {
        let (metres, stem) = shot.split_once('=').unwrap();
        format!("{metres}={}", file(&format!("calibration/white/{stem}_0.dng")))
    });
    let mut calibrate = vec!["calibrate", "flash", &session, "--target-reflectance", "0.94"];
    calibrate.extend(["--ring-radii", "0.035,0.085", "--shots"]);
    calibrate.extend(shots.iter().map(String::as_str));
    unlit(&calibrate);
    session
}

#[test]
fn a_mesh_without_coordinates_gets_some_and_its_model_is_read_by_others() {
    let folder = tempfile::tempdir().unwrap();
    let session = prepared(folder.path());
    let out = folder.path().join("out");
    let to = out.to_str().unwrap();
    assert!(refused(&["export", &session, "--to", to]).contains("unlit process"));
    assert!(refused(&["process", &session, "--uvs", "own"]).contains("no texture coordinates"));

    let said = unlit(&["process", &session, "--texture-size", "512"]);
    assert!(said.contains("texture coordinates were made"), "{said}");
    let model = Path::new(&session).join("model");
    let summary: Value = serde_json::from_slice(&std::fs::read(model.join("summary.json")).unwrap()).unwrap();
    assert_eq!(summary["uvs"]["from"], "made");
    assert!(summary["uvs"]["charts"].as_u64().unwrap() > 5);
    let again = unlit(&["process", &session, "--texture-size", "512"]);
    assert!(again.contains("nothing had changed"), "{again}");

    flags_tell_seen_from_filled(&model);
    the_truth_is_met(&session);

    assert!(refused(&["export", &session, "--to", model.to_str().unwrap()]).contains("inside the session"));
    let all = "glb,exr,tiff,obj,usd,views,views-exr";
    let said = unlit(&["export", &session, "--to", to, "--format", all, "--colour", "srgb"]);
    for name in
        ["model.glb", "reflectance.tif", "model.usda", "views/006.tif", "masks/006.tif", "export.json"]
    {
        assert!(said.contains(name) && out.join(name).is_file(), "no {name}: {said}");
    }
    assert!(
        std::fs::read_dir(&out)
            .unwrap()
            .flatten()
            .all(|e| { !e.file_name().to_string_lossy().starts_with(".tmp") })
    );
    let texture = exr_image::read(&out.join("reflectance.exr")).unwrap();
    assert!(texture.meta.colour_space.as_deref().unwrap().contains("linear sRGB"));
    colours_are_those_of_the_files_matrix(&model, &out);
    sixteen_bits_hold_the_same_values_and_a_profile(&out);
    the_glb_is_read(&out);
    the_obj_is_read(&out);
    the_usd_names_what_is_there(&out);
    views_are_named_like_the_photos(&session, &out);

    let aces = folder.path().join("aces");
    unlit(&["export", &session, "--to", aces.to_str().unwrap(), "--format", "exr", "--colour", "acescg"]);
    let other = exr_image::read(&aces.join("reflectance.exr")).unwrap();
    assert!(other.meta.colour_space.as_deref().unwrap().contains("ACEScg"));
    assert_ne!(other.rgb(), texture.rgb());

    // Another mesh under the same texture is found out.
    let square = folder.path().join("square.obj");
    std::fs::write(&square, "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nf 1 2 3\n").unwrap();
    let cameras = file("geometry/cameras.xml");
    unlit(&["import", "scene", &session, "--cameras", &cameras, "--mesh", square.to_str().unwrap()]);
    assert!(refused(&["export", &session, "--to", to]).contains("not the one"));
}

fn flags_tell_seen_from_filled(model: &Path) {
    let counts = exr_image::read(&model.join("views.exr")).unwrap();
    let (views, surface) = (counts.channel("Y").unwrap(), counts.channel("surface").unwrap());
    let kinds = views.iter().zip(surface).fold([0; 3], |mut kinds, (&y, &s)| {
        assert!(s == 1.0 || (s == 0.0 && y == 0.0), "a view saw a gutter");
        kinds[if s == 0.0 {
            0
        } else if y == 0.0 {
            1
        } else {
            2
        }] += 1;
        kinds
    });
    assert!(kinds.iter().all(|n| *n > 1000), "gutter, filled, seen: {kinds:?}");
    // Gutters bleed the charts' colours: none is left black.
    let texture = exr_image::read(&model.join("reflectance.exr")).unwrap().rgb().unwrap();
    assert!(texture.pixels().iter().all(|p| p.iter().all(|v| v.is_finite()) && *p != [0.0; 3]));
}

fn the_truth_is_met(session: &str) {
    let said = unlit(&["evaluate", session, "--truth", &file("truth"), "--json"]);
    let evaluated: Value = serde_json::from_str(&said).unwrap();
    let views = evaluated["texture"]["by_view"].as_array().unwrap();
    // What the four photos saw, on a coarse texture: asked is only that the texture lies where its coordinates say.
    for view in views.iter().filter(|v| ["000", "006", "012", "018"].contains(&v["name"].as_str().unwrap())) {
        let figure = |name: &str| view[name].as_f64().unwrap();
        assert!(figure("mean").abs() < 0.03 && figure("standard_deviation") < 0.15, "{view}");
    }
}

/// The files' matrix says that the sensor is linear sRGB's but for a gain for each channel, which the card took out.
fn colours_are_those_of_the_files_matrix(model: &Path, out: &Path) {
    let rgb = |path: &Path| exr_image::read(path).unwrap().rgb().unwrap();
    let (camera, srgb) = (rgb(&model.join("reflectance.exr")), rgb(&out.join("reflectance.exr")));
    let apart = camera.pixels().iter().flatten().zip(srgb.pixels().iter().flatten());
    let most = apart.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(most > 0.0 && most < 0.02, "{most}");
}

fn sixteen_bits_hold_the_same_values_and_a_profile(out: &Path) {
    let path = out.join("reflectance.tif");
    let (tiff, exr) =
        (tiff16::read_rgb(&path).unwrap(), exr_image::read(&out.join("reflectance.exr")).unwrap());
    for (a, b) in tiff.pixels().iter().flatten().zip(exr.rgb().unwrap().pixels().iter().flatten()) {
        assert!((a - b.clamp(0.0, 1.0)).abs() < 1e-5);
    }
    let mut decoder = Decoder::new(std::fs::File::open(&path).unwrap()).unwrap();
    assert!(decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap().contains("linear sRGB"));
    let profile = decoder.get_tag_u8_vec(Tag::IccProfile).unwrap();
    assert_eq!(&profile[36..40], b"acsp");
    assert_eq!(u32::from_be_bytes(profile[..4].try_into().unwrap()) as usize, profile.len());
}

fn the_glb_is_read(out: &Path) {
    let (document, _, images) = gltf::import(out.join("model.glb")).unwrap();
    let extras: Value =
        serde_json::from_str(document.as_json().asset.extras.as_ref().unwrap().get()).unwrap();
    assert_eq!(extras["reflectance"], "linear sRGB");
    assert_eq!(extras["provenance"]["colour"]["basis"]["camera"]["source"], "file_tag");
    assert_eq!(extras["provenance"]["pairs"], serde_json::json!(["000", "006", "012", "018"]));
    assert_eq!(extras["provenance"]["calibration"].as_str().unwrap().len(), 64);
    let texture = exr_image::read(&out.join("reflectance.exr")).unwrap().rgb().unwrap();
    for (shown, value) in images[0].pixels.iter().zip(texture.pixels().iter().flatten()) {
        assert!(shown.abs_diff(srgb::encode_u8(*value)) <= 1);
    }
}

fn the_obj_is_read(out: &Path) {
    let (models, materials) = tobj::load_obj(out.join("model.obj"), &tobj::LoadOptions::default()).unwrap();
    let material = &materials.unwrap()[models[0].mesh.material_id.unwrap()];
    assert_eq!(material.diffuse_texture.as_deref(), Some("model.png"));
    assert_eq!(image::open(out.join("model.png")).unwrap().to_rgb8().dimensions(), (512, 512));
    assert_eq!(models[0].mesh.texcoord_indices.len(), models[0].mesh.indices.len());
}

fn the_usd_names_what_is_there(out: &Path) {
    let text = std::fs::read_to_string(out.join("model.usda")).unwrap();
    assert!(text.contains("upAxis = \"Z\"") && text.contains("metersPerUnit = 1"));
    let picture = text.split('@').nth(1).unwrap();
    assert!(out.join(picture).is_file(), "{picture}");
    let count = |name: &str| {
        let line = text.lines().find(|l| l.contains(&format!("{name} = ["))).unwrap();
        line.split(',').count()
    };
    assert_eq!(count("faceVertexIndices"), 3 * count("faceVertexCounts"));
    assert_eq!(count("faceVertexIndices"), count("primvars:st:indices"));
}

fn views_are_named_like_the_photos(session: &str, out: &Path) {
    let mut names: Vec<String> = std::fs::read_dir(out.join("views"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let wanted = ["000", "006", "012", "018"].iter().flat_map(|n| [format!("{n}.exr"), format!("{n}.tif")]);
    assert_eq!(names, wanted.collect::<Vec<_>>());
    let view = tiff16::read_rgb(&out.join("views/012.tif")).unwrap();
    let mask = tiff16::read_grey8(&out.join("masks/012.tif")).unwrap();
    assert_eq!((view.width(), view.height()), (mask.width(), mask.height()));
    let exr = exr_image::read(&out.join("views/012.exr")).unwrap().rgba().unwrap();
    let kept = Path::new(session).join("derived/views/012/reflectance.exr");
    let known = exr_image::read(&kept).unwrap().rgba().unwrap();
    for ((mask, exr), known) in mask.pixels().iter().zip(exr.pixels()).zip(known.pixels()) {
        assert_eq!((*mask == 255, exr[3] == 1.0), (known[3] == 1.0, known[3] == 1.0));
    }
}

#[test]
fn a_cameras_colours_come_from_its_dng_or_from_the_decoders_table() {
    let of = |name: &str| colour::read(&shared(&format!("data/raw/{name}"))).unwrap();
    let canon = of("small_5DS.cr2").expect("the table knows the EOS 5DS");
    assert_eq!(canon.source, ColourSource::DecoderTable);
    // Adobe's matrix of the EOS 5DS, which every decoder has, up to its scale.
    let scale = canon.camera_from_xyz[0][0] / 0.6250;
    for (got, want) in canon.camera_from_xyz[0].iter().zip([0.6250, -0.0711, -0.0808]) {
        assert!((got / scale - want).abs() < 1e-6, "{canon:?}");
    }
    let scene = colour::read(&shared("scenes/birdbath/photos/on/000.dng")).unwrap().unwrap();
    assert_eq!((scene.source, scene.white), (ColourSource::FileTag, [0.3127, 0.3290]));
    assert_eq!(scene.camera_from_xyz[1], [-0.9693, 1.8760, 0.0416]);
    // Of one for tungsten and one for daylight, the one for daylight is nearer to a flash.
    let two = of("photoprism_canon_eos_6d.dng").unwrap();
    assert_eq!((two.white, two.camera_from_xyz[0][0]), ([0.3127, 0.3290], 0.7034));
    assert_eq!(of("nomexif_canon-r6.cr3"), None);
}
