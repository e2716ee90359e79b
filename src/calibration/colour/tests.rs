use super::cielab::D50;
use super::find::tests::{pose, scene};
use super::fit::tests::camera;
use super::*;
use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::{Image, Rgb};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

const BLACK: f32 = 512.0;

/// A sensor's frame of a scene, one pixel a site, `extra` DN of room light added.
fn frame(image: &Rgb, saturation: f32, extra: f32) -> Mosaic {
    let cfa = Cfa::RGGB;
    let dn = Image::from_fn(image.width(), image.height(), |x, y| {
        (image.at(x, y)[cfa.colour(x, y)] + extra + BLACK).round().clamp(0.0, saturation) as u16
    });
    let levels = Levels {
        black: [[BLACK; 2]; 2],
        saturation: [[saturation; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    Mosaic { dn, cfa, levels }
}

fn truth() -> DMat3 {
    pose(DVec2::new(240.0, 180.0), 44.0, 3.3, DVec2::new(0.0004, -0.0003))
}

/// Finds and fits as the pipeline does.
fn fitted(frame: &ChartFrame) -> ColourFit {
    let found = find(&frame.preview(2), &ChartKind::ALL).unwrap();
    let sites = DMat3::from_scale(DVec2::splat(2.0)) * found.image_from_chart;
    fit_colour(found.kind, &frame.readings(&sites), &sites).unwrap()
}

#[test]
fn a_cameras_matrix_is_found_from_sensor_sites_of_an_upside_down_chart() {
    let mut rng = ChaCha8Rng::seed_from_u64(77);
    let rgb_from_xyz = camera(&mut rng) * 6000.0;
    let image = scene(ChartKind::Colorchecker24, (480, 360), truth(), rgb_from_xyz, 0.003, 1);
    let mosaic = frame(&image, 60000.0, 0.0);
    let fit = fitted(&ChartFrame::new(&mosaic, None).unwrap());
    assert_eq!(fit.chart, ChartKind::Colorchecker24);
    assert!(fit.fit.mean < 0.3 && fit.leave_one_out.mean < 0.5, "{:?} {:?}", fit.fit, fit.leave_one_out);
    assert!(
        fit.half_held_out.is_some_and(|half| half.patches == PATCHES && half.mean < 1.0),
        "{:?}",
        fit.half_held_out
    );
    let white = rgb_from_xyz * D50;
    let found = DVec3::from_array(fit.white_dn);
    assert!((found / white - 1.0).abs().max_element() < 0.01, "{found} {white}");
    assert!((matrix(&fit.xyz_d50_from_camera) * DVec3::ONE).abs_diff_eq(D50, 1e-9));
    assert!(fit.verdict().good && fit.standards.fadgi_2023_stars == 4, "{:?}", fit.verdict());
    assert!(fit.evenness.words().contains("was even"), "{}", fit.evenness.words());
}

#[test]
fn the_rooms_light_is_taken_off_and_clipped_patches_are_left_out() {
    let rgb_from_xyz = DMat3::from_diagonal(DVec3::new(5000.0, 9000.0, 6000.0));
    let image = scene(ChartKind::Colorchecker24, (480, 360), truth(), rgb_from_xyz, 0.002, 2);
    let (on, off) = (frame(&image, 8000.0, 900.0), frame(&image.map(|_| [0.0; 3]), 8000.0, 900.0));
    let fit = fitted(&ChartFrame::new(&on, Some((&off, 1.0))).unwrap());
    let left_out: Vec<&str> =
        fit.patches.iter().filter(|p| p.left_out.is_some()).map(|p| p.name.as_str()).collect();
    assert_eq!(left_out, ["white"], "{:?}", fit.patches);
    assert!(fit.patches[18].left_out.as_ref().is_some_and(|why| why.contains("clipped")));
    assert!(fit.fit.patches == PATCHES - 1 && fit.fit.mean < 0.4, "{:?}", fit.fit);
    assert!(ChartFrame::new(&on, Some((&frame(&image.map(|p| *p), 8000.0, 0.0), 1.0))).is_ok());
    let small = frame(&Image::filled(4, 4, [0.0; 3]), 8000.0, 0.0);
    assert!(ChartFrame::new(&on, Some((&small, 1.0))).is_err());
}

#[test]
fn uneven_light_is_told_and_taken_out() {
    let chart_from_image = truth().inverse();
    let even = scene(ChartKind::Spydercheckr24, (480, 360), truth(), DMat3::IDENTITY * 5000.0, 0.002, 3);
    let image = Image::from_fn(480, 360, |x, y| {
        let at = plane::project(&chart_from_image, DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
        let light = 1.0 + 0.10 * (at.x - 2.5) / 2.5 - 0.06 * (at.y - 1.5) / 1.5;
        even.at(x, y).map(|v| v * light as f32)
    });
    let mosaic = frame(&image, 60000.0, 0.0);
    let fit = fitted(&ChartFrame::new(&mosaic, None).unwrap());
    let Evenness { across, down, taken_out, .. } = fit.evenness;
    assert!(taken_out && (across - 0.10).abs() < 0.01 && (down + 0.06).abs() < 0.01, "{:?}", fit.evenness);
    assert!(fit.fit.mean < 0.4 && fit.fit_even.mean > 1.0, "{:?} {:?}", fit.fit, fit.fit_even);
}

#[test]
fn too_few_patches_are_refused_with_the_reason() {
    let image = scene(ChartKind::Colorchecker24, (480, 360), truth(), DMat3::IDENTITY * 9000.0, 0.0, 4);
    let mosaic = frame(&image, 900.0, 0.0);
    let readings = ChartFrame::new(&mosaic, None).unwrap().readings(&truth());
    let error = fit_colour(ChartKind::Colorchecker24, &readings, &truth()).unwrap_err().to_string();
    assert!(error.contains("needs more than 9") && error.contains("clipped; expose less"), "{error}");
}
