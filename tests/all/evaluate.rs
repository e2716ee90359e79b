//! The yardstick: what is exactly right scores 0, and a known error is found.

use crate::samples::shared;
use crate::scene_import::{bare_session, import_birdbath};
use unlit::codec::exr_image::{self, Meta};
use unlit::codec::tiff16;
use unlit::pipeline::evaluate::{EvaluateError, evaluate};
use unlit::progress::Progress;
use unlit::raster::Image;
use unlit::session::Session;

const VIEWS: [&str; 3] = ["000", "009", "021"];

/// Writes the true albedo plus `offset` as the per-view images, the lower half unknown when asked.
fn write_views(session: &Session, offset: f32, half: bool) {
    for name in VIEWS {
        let truth = tiff16::read_rgb(&shared(&format!("scenes/birdbath/truth/albedo/{name}.tif"))).unwrap();
        let image = Image::from_fn(truth.width(), truth.height(), |x, y| {
            let [r, g, b] = *truth.at(x, y);
            if half && y >= 200 { [9.0, 9.0, 9.0, 0.0] } else { [r + offset, g + offset, b + offset, 1.0] }
        });
        let folder = session.derived_dir().join("views").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        exr_image::write_rgba(&folder.join("reflectance.exr"), &image, &Meta::default()).unwrap();
    }
}

/// A truth folder with a few of the views, so that tests stay quick.
fn small_truth(views: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let copy = |file: &str| {
        std::fs::copy(shared(&format!("scenes/birdbath/truth/{file}")), folder.path().join(file)).unwrap();
    };
    for kind in ["albedo", "mask"] {
        std::fs::create_dir(folder.path().join(kind)).unwrap();
        views.iter().for_each(|view| copy(&format!("{kind}/{view}.tif")));
    }
    copy("scene.json");
    folder
}

fn score(session: &Session) -> unlit::pipeline::evaluate::Evaluation {
    evaluate(session, &shared("scenes/birdbath/truth"), &Progress::silent()).unwrap()
}

#[test]
fn the_truth_itself_scores_zero_and_an_offset_is_found() {
    let (_folder, session) = bare_session();
    import_birdbath(&session, "cameras.xml");
    write_views(&session, 0.0, false);
    let views = score(&session).views.unwrap();
    assert!(views.full.percentile_95 < 1e-5 && views.full.mean.abs() < 1e-6, "{:?}", views.full);
    assert_eq!((views.by_view.len(), views.missing.len(), views.known), (3, 21, 1.0));
    assert!(views.missing.contains(&"001".to_owned()));

    write_views(&session, 0.02, true);
    let views = score(&session).views.unwrap();
    assert!((views.full.mean - 0.02).abs() < 1e-5, "{:?}", views.full);
    assert!(views.full.standard_deviation < 1e-5, "{:?}", views.full);
    let blocks = views.blocks.unwrap();
    assert!((blocks.mean_absolute - 0.02).abs() < 1e-5, "{blocks:?}");
    assert!(views.known > 0.2 && views.known < 0.9, "{}", views.known);
}

#[test]
fn the_true_texture_through_the_cameras_scores_next_to_nothing() {
    let (_folder, session) = bare_session();
    import_birdbath(&session, "cameras.xml");
    let texture = tiff16::read_rgb(&shared("scenes/birdbath/truth/texture.tif")).unwrap();
    exr_image::write_rgb(&session.model_dir().join("reflectance.exr"), &texture, &Meta::default()).unwrap();
    let start = std::time::Instant::now();
    let truth = small_truth(&VIEWS);
    let estimate = evaluate(&session, truth.path(), &Progress::silent()).unwrap().texture.unwrap();
    let blocks = estimate.blocks.unwrap();
    println!("{:?}\n{:?}\nknown {}, {:?}", estimate.full, blocks, estimate.known, start.elapsed());
    assert!(estimate.missing.is_empty() && estimate.by_view.len() == 3);
    assert!(estimate.full.mean.abs() < 1e-3 && blocks.mean.abs() < 1e-3);
    assert!(estimate.full.standard_deviation < 0.01, "{:?}", estimate.full);
    assert!(blocks.standard_deviation < 0.003, "{blocks:?}");
    assert!(estimate.known > 0.9999, "{}", estimate.known);
}

#[test]
fn nothing_to_score_and_no_truth_are_said_in_words() {
    let (_folder, session) = bare_session();
    import_birdbath(&session, "colmap");
    let truth = shared("scenes/birdbath/truth");
    let error = evaluate(&session, &truth, &Progress::silent()).unwrap_err();
    assert!(matches!(error, EvaluateError::NothingToScore(_)), "{error}");
    assert!(error.to_string().contains("unlit process"));
    let error = evaluate(&session, session.path(), &Progress::silent()).unwrap_err();
    assert!(error.to_string().contains("albedo"), "{error}");
}
