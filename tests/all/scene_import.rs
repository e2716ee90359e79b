//! Camera files of other programs agree with each other in our conventions.

use crate::samples::shared;
use unlit::pipeline::scene::{self, Lengths, SceneError, Unit};
use unlit::progress::Progress;
use unlit::scene::Camera;
use unlit::scene::import::{blocks_exchange, colmap_text};
use unlit::session::Session;

fn text(path: &str) -> String {
    std::fs::read_to_string(shared(path)).unwrap()
}

fn blocks(path: &str) -> Vec<Camera> {
    sorted(blocks_exchange::parse(&text(path)).unwrap().cameras)
}

fn colmap(folder: &str) -> Vec<Camera> {
    let (cameras, images) = (text(&format!("{folder}/cameras.txt")), text(&format!("{folder}/images.txt")));
    sorted(colmap_text::parse(&cameras, &images).unwrap().cameras)
}

fn sorted(mut cameras: Vec<Camera>) -> Vec<Camera> {
    cameras.sort_by(|a, b| a.name.cmp(&b.name));
    cameras
}

/// Largest differences: rotation matrix entries, centres, and lens parameters.
fn differences(a: &[Camera], b: &[Camera]) -> (f64, f64, f64) {
    assert_eq!(a.len(), b.len());
    let mut worst = (0.0_f64, 0.0_f64, 0.0_f64);
    for (a, b) in a.iter().zip(b) {
        assert_eq!(a.name, b.name);
        assert_eq!((a.intrinsics.width, a.intrinsics.height), (b.intrinsics.width, b.intrinsics.height));
        let turn = (a.world_from_camera.matrix3 - b.world_from_camera.matrix3).to_cols_array();
        worst.0 = turn.into_iter().fold(worst.0, |w, d| w.max(d.abs()));
        worst.1 = worst.1.max(a.centre().distance(b.centre()));
        let lens = |c: &Camera| {
            let (i, d) = (c.intrinsics, c.intrinsics.distortion);
            [i.principal.x, i.principal.y, d.k1, d.k2, d.p1, d.p2, d.k3]
        };
        for (p, q) in lens(a).into_iter().zip(lens(b)) {
            worst.2 = worst.2.max((p - q).abs());
        }
    }
    worst
}

#[test]
fn angles_matrices_and_colmap_tell_the_same_flowerpot() {
    let angles = blocks("data/formats/blocksexchange_opk.xml");
    let matrices = blocks("data/formats/blocksexchange_matrix.xml");
    let colmap = colmap("data/formats/colmap_text");
    assert_eq!(angles.len(), 25);
    for other in [&matrices, &colmap] {
        let (turn, centre, lens) = differences(&angles, other);
        println!("rotation {turn:.1e}, centre {centre:.1e}, lens {lens:.1e}");
        assert!(turn < 1e-11 && centre < 1e-10 && lens < 1e-15, "{turn} {centre} {lens}");
    }
    // BlocksExchange has one focal length and no aspect ratio here: the sample's is COLMAP's fx.
    assert!((angles[0].intrinsics.focal.x - colmap[0].intrinsics.focal.x).abs() < 1e-5);
}

#[test]
fn both_descriptions_of_the_birdbath_agree() {
    let xml = blocks("scenes/birdbath/geometry/cameras.xml");
    let colmap = colmap("scenes/birdbath/geometry/colmap");
    assert_eq!(xml.len(), 24);
    let (turn, centre, lens) = differences(&xml, &colmap);
    println!("rotation {turn:.1e}, centre {centre:.1e}, lens {lens:.1e}");
    assert!(turn < 1e-6 && centre < 1e-6 && lens < 1e-12, "{turn} {centre} {lens}");
    for (a, b) in xml.iter().zip(&colmap) {
        assert!((a.intrinsics.focal - b.intrinsics.focal).length() < 1e-9);
    }
}

#[test]
fn an_agisoft_file_is_recognised_as_something_else() {
    let error = blocks_exchange::parse(&text("data/formats/metashape_road.xml")).unwrap_err().to_string();
    assert!(error.contains("BlocksExchange") && error.contains("document"), "{error}");
}

/// A new session in a folder that goes with it.
pub(crate) fn bare_session() -> (tempfile::TempDir, Session) {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("session"), "test").unwrap();
    (folder, session)
}

/// Imports the birdbath, object and floor, true to size.
pub(crate) fn import_birdbath(session: &Session, cameras: &str) -> scene::SceneFile {
    let meshes = ["object", "floor"].map(|m| shared(&format!("scenes/birdbath/geometry/{m}.obj")));
    scene::import(
        session,
        &shared(&format!("scenes/birdbath/geometry/{cameras}")),
        &meshes,
        Lengths::default(),
        &Progress::silent(),
    )
    .unwrap()
}

#[test]
fn the_birdbath_is_imported_checked_and_loaded_again() {
    let (_folder, session) = bare_session();
    let file = import_birdbath(&session, "cameras.xml");
    assert_eq!((file.cameras.len(), file.meshes.len()), (24, 2));
    assert_eq!((file.meshes[0].vertices, file.meshes[0].triangles), (102_418, 122_600));
    assert!(file.meshes[0].textured);
    assert!(file.check.warnings.is_empty(), "{:?}", file.check.warnings);
    assert!(file.check.views.iter().all(|v| v.in_front == 1.0 && v.in_frame > 0.9), "{:?}", file.check.views);
    println!("{} m across, {} m away", file.check.object_size, file.check.distance);

    let loaded = scene::load(&session).unwrap();
    assert_eq!(loaded.cameras, file.cameras);
    assert_eq!([&loaded.meshes[0].name, &loaded.meshes[1].name], ["object", "floor"]);
    assert_eq!(loaded.meshes[1].triangles.len(), 2);

    let kept = session.scene_dir().join(&file.meshes[1].original.file);
    let original = std::fs::read(shared("scenes/birdbath/geometry/floor.obj")).unwrap();
    assert_eq!(std::fs::read(&kept).unwrap(), original);
    std::fs::write(&kept, "v 0 0 0\n").unwrap();
    let error = scene::load(&session).unwrap_err().to_string();
    assert!(error.contains("floor.obj") && error.contains("import the scene again"), "{error}");
}

#[test]
fn unit_and_scale_act_on_cameras_and_meshes_alike() {
    let (_folder, session) = bare_session();
    let floor = [shared("scenes/birdbath/geometry/floor.obj")];
    let cameras = shared("scenes/birdbath/geometry/colmap");
    let lengths = Lengths { unit: Unit::Millimetre, scale: 2.0 };
    scene::import(&session, &cameras, &floor, lengths, &Progress::silent()).unwrap();
    let small = scene::load(&session).unwrap();
    scene::import(&session, &cameras, &floor, Lengths::default(), &Progress::silent()).unwrap();
    let full = scene::load(&session).unwrap();
    for (a, b) in small.cameras.iter().zip(&full.cameras) {
        assert!((a.centre() - b.centre() * 0.002).length() < 1e-12);
        assert_eq!(a.world_from_camera.matrix3, b.world_from_camera.matrix3);
    }
    assert!((small.meshes[0].positions[2] - full.meshes[0].positions[2] * 0.002).length() < 1e-9);
}

#[test]
fn what_is_no_scene_or_no_camera_file_is_said_in_words() {
    let (_folder, session) = bare_session();
    assert!(matches!(scene::load(&session), Err(SceneError::NoScene(_))));
    let mesh = [shared("scenes/birdbath/geometry/floor.obj")];
    let import = |cameras: &str, scale| {
        let lengths = Lengths { unit: Unit::Metre, scale };
        scene::import(&session, &shared(cameras), &mesh, lengths, &Progress::silent()).unwrap_err()
    };
    assert!(matches!(import("data/formats/colmap_bin", 1.0), SceneError::NoCameras(_)));
    assert!(matches!(import("data/formats/realitycapture/parking.csv", 1.0), SceneError::NoCameras(_)));
    assert!(matches!(import("scenes/birdbath/geometry/cameras.xml", -1.0), SceneError::Scale(_)));
    assert!(import("data/formats/metashape_road.xml", 1.0).to_string().contains("metashape_road.xml"));
    assert!(matches!(scene::load(&session), Err(SceneError::NoScene(_))), "a failed import leaves nothing");
}
