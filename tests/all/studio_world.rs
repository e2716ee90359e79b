//! The simulated world through its raw files: what a photographer's program would find in them.

use crate::scene_import::bare_session;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use unlit::codec::exr_image::{self, Meta};
use unlit::codec::raw::{self, Photo};
use unlit::codec::tiff16;
use unlit::pair::Exposure;
use unlit::pair::{FrameView, Limits, judge};
use unlit::photometry::LevelSource;
use unlit::pipeline::evaluate::evaluate;
use unlit::pipeline::scene::{self, Lengths};
use unlit::progress::Progress;
use unlit::scene::{import, read_obj};
use unlit::studio::world::{Stage, StageError, World};
use unlit::studio::{SyncContact, View, truth};
use unlit::units::{FNumber, Iso, Seconds};

/// A contact whose answer the test chooses; it counts its closings.
#[derive(Default)]
struct Contact(Mutex<(f64, usize)>);

impl SyncContact for Contact {
    fn close(&self) -> f64 {
        let mut state = self.0.lock().unwrap();
        state.1 += 1;
        state.0
    }
}

/// One world for all tests, since setting it up takes a second; whoever uses it has it alone.
struct Studio {
    contact: Arc<Contact>,
    world: World,
}

impl Studio {
    fn shoot(&self, energy: f64, exposure: &Exposure) -> Photo {
        self.contact.0.lock().unwrap().0 = energy;
        raw::decode(&self.world.expose(exposure), "a frame of the studio").unwrap()
    }
}

fn studio() -> std::sync::MutexGuard<'static, Studio> {
    static STUDIO: OnceLock<Mutex<Studio>> = OnceLock::new();
    STUDIO
        .get_or_init(|| {
            let contact = Arc::new(Contact::default());
            let world = World::new(contact.clone(), &Progress::silent()).unwrap();
            Mutex::new(Studio { contact, world })
        })
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
}

fn usual() -> Exposure {
    Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) }
}

/// Mean DN above black of the green sites about the middle of the frame.
fn middle(photo: &Photo) -> f64 {
    let dn = &photo.mosaic.dn;
    let (w, h) = (dn.width(), dn.height());
    let (mut sum, mut count) = (0.0, 0.0);
    for y in h / 2 - 20..h / 2 + 20 {
        for x in w / 2 - 20..w / 2 + 20 {
            if photo.mosaic.cfa.colour(x, y) == 1 {
                sum += f64::from(*dn.at(x, y)) - 2048.0;
                count += 1.0;
            }
        }
    }
    sum / count
}

#[test]
fn every_stop_gives_a_pair_that_passes_and_uses_the_sensor_well() {
    let studio = studio();
    assert!(studio.world.stops() >= 12);
    for stop in 1..=studio.world.stops() {
        studio.world.set_stage(Stage::Stop(stop)).unwrap();
        let (off, on) = (studio.shoot(0.0, &usual()), studio.shoot(1.0, &usual()));
        let reasons = judge(
            FrameView { mosaic: &off.mosaic, settings: &off.settings },
            FrameView { mosaic: &on.mosaic, settings: &on.settings },
            &Limits::default(),
        );
        assert!(reasons.is_empty(), "stop {stop}: {reasons:?}");
        let mut greens: Vec<u16> = (0..on.mosaic.dn.pixels().len())
            .filter(|i| on.mosaic.cfa.colour(i % on.mosaic.dn.width(), i / on.mosaic.dn.width()) == 1)
            .map(|i| on.mosaic.dn.pixels()[i])
            .collect();
        greens.sort_unstable();
        let bright = f64::from(greens[greens.len() * 999 / 1000] - 2048) / (15300.0 - 2048.0);
        assert!((0.50..0.90).contains(&bright), "stop {stop}: brightest at {bright} of the range");
    }
}

#[test]
fn raw_files_tell_their_settings_and_levels() {
    let studio = studio();
    studio.world.set_stage(Stage::Stop(2)).unwrap();
    let exposure = Exposure { shutter: Seconds(1.0 / 60.0), aperture: FNumber(8.0), iso: Iso(200.0) };
    let photo = studio.shoot(0.0, &exposure);
    assert_eq!(photo.settings.make.as_deref(), Some("Canon"));
    assert_eq!(photo.settings.model.as_deref(), Some("Canon EOS 5DS"));
    assert!((photo.settings.shutter.unwrap().0 - 1.0 / 60.0).abs() < 1e-6);
    assert_eq!(photo.settings.aperture, Some(FNumber(8.0)));
    assert_eq!(photo.settings.iso, Some(Iso(200.0)));
    assert!(photo.settings.taken_at.is_some());
    let levels = photo.mosaic.levels;
    assert_eq!(levels.black_source, LevelSource::MaskedPixels);
    assert!(levels.black.iter().flatten().all(|b| (b - 2048.0).abs() < 1.0), "{levels:?}");
    assert!(levels.saturation.iter().flatten().all(|s| *s == 15300.0), "{levels:?}");
}

#[test]
fn each_release_closes_the_contact_once_and_the_cap_stays_dark_without_a_flash() {
    let studio = studio();
    studio.world.set_stage(Stage::Cap).unwrap();
    let before = studio.contact.0.lock().unwrap().1;
    let dark = studio.shoot(0.0, &usual());
    assert_eq!(studio.contact.0.lock().unwrap().1, before + 1);
    assert!(middle(&dark).abs() < 0.5, "{}", middle(&dark));
}

#[test]
fn the_shutter_scales_the_room_and_not_the_flash() {
    let studio = studio();
    studio.world.set_stage(Stage::Stop(1)).unwrap();
    let slow = Exposure { shutter: Seconds(1.0 / 60.0), ..usual() };
    let room = middle(&studio.shoot(0.0, &usual()));
    let room_slow = middle(&studio.shoot(0.0, &slow));
    // 1/60 stands for 2^-6 s, 1/125 for 2^-7 s.
    assert!((room_slow / room - 2.0).abs() < 0.02, "{room_slow} / {room}");
    let flash = middle(&studio.shoot(1.0, &usual())) - room;
    let flash_slow = middle(&studio.shoot(1.0, &slow)) - room_slow;
    assert!((flash_slow / flash - 1.0).abs() < 0.02, "{flash_slow} / {flash}");
    let half = middle(&studio.shoot(0.5, &usual())) - room;
    assert!((half / flash - 0.5).abs() < 0.01, "{half} / {flash}");
}

#[test]
fn aperture_and_sensitivity_scale_both_by_their_true_values() {
    let studio = studio();
    studio.world.set_stage(Stage::Card { distance_m: 1.2 }).unwrap();
    let base = middle(&studio.shoot(1.0, &usual()));
    let closed = middle(&studio.shoot(1.0, &Exposure { aperture: FNumber(13.0), ..usual() }));
    assert!((closed / base - 2_f64.powf(-1.0 / 3.0)).abs() < 0.01, "{}", closed / base);
    let faster = middle(&studio.shoot(1.0, &Exposure { iso: Iso(160.0), ..usual() }));
    assert!((faster / base - 2_f64.powf(2.0 / 3.0)).abs() < 0.02, "{}", faster / base);
}

#[test]
fn the_card_is_lit_by_the_flash_alone_and_falls_off_with_distance() {
    let studio = studio();
    let mut last = f64::INFINITY;
    for distance_m in [0.7, 1.0, 1.4, 2.0] {
        studio.world.set_stage(Stage::Card { distance_m }).unwrap();
        assert!(middle(&studio.shoot(0.0, &usual())).abs() < 0.5);
        let lit = middle(&studio.shoot(1.0, &usual()));
        // On the axis: L rho (o^2 / (o^2 + d^2) - i^2 / (i^2 + d^2)), full green well at radiance 1.08.
        let part = |r: f64| r * r / (r * r + distance_m * distance_m);
        let radiance = 57.0 * 0.94 * (part(0.085) - part(0.035));
        let expected = radiance / 1.08 * (15300.0 - 2048.0);
        assert!((lit / expected - 1.0).abs() < 0.03, "{lit} for {expected} at {distance_m} m");
        assert!(lit < last);
        last = lit;
    }
}

#[test]
fn the_operator_walks_round_and_cannot_leave_the_walk() {
    let studio = studio();
    studio.world.set_stage(Stage::Cap).unwrap();
    for stop in (1..=studio.world.stops()).chain([1]) {
        studio.world.walk_on();
        assert_eq!(studio.world.stage(), Stage::Stop(stop));
    }
    let stops = studio.world.stops();
    for asked in [0, stops + 1] {
        assert_eq!(studio.world.set_stage(Stage::Stop(asked)), Err(StageError::Stop { asked, stops }));
    }
    for distance_m in [0.0, -1.0, f64::NAN] {
        assert!(studio.world.set_stage(Stage::Card { distance_m }).is_err());
    }
    assert_eq!(studio.world.stage(), Stage::Stop(1));
}

#[test]
fn exported_geometry_reads_back_as_the_cameras_and_the_surface_that_were_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let exported = truth::export(folder.path(), &Progress::silent()).unwrap();
    assert_eq!(exported.views, studio().world.stops());
    let text = |path: &str| std::fs::read_to_string(folder.path().join(path)).unwrap();
    let facts: serde_json::Value = serde_json::from_str(&text("truth/scene.json")).unwrap();
    assert_eq!(facts["sensor"]["lens_psf_sigma_px"], 0.7);
    assert_eq!(facts["flash"]["outer_radius"], 0.085);

    let blocks = import::blocks_exchange::parse(&text("geometry/cameras.xml")).unwrap().cameras;
    let colmap =
        import::colmap_text::parse(&text("geometry/colmap/cameras.txt"), &text("geometry/colmap/images.txt"));
    let colmap = colmap.unwrap().cameras;
    assert_eq!(blocks.len(), exported.views);
    assert_eq!(colmap.len(), exported.views);
    for (i, frame) in facts["frames"].as_array().unwrap().iter().enumerate() {
        for camera in [&blocks[i], &colmap[i]] {
            assert_eq!(frame["name"], camera.name.as_str());
            assert_eq!(camera.name, format!("{:04}", i + 1));
            for row in 0..3 {
                for column in 0..4 {
                    let value = frame["world_from_camera"][row][column].as_f64().unwrap();
                    let pose = camera.world_from_camera;
                    let found =
                        if column < 3 { pose.matrix3.col(column)[row] } else { pose.translation[row] };
                    assert!((found - value).abs() < 1e-9, "{} of {}", found - value, camera.name);
                }
            }
            assert!((camera.intrinsics.focal.x - facts["intrinsics"]["fx"].as_f64().unwrap()).abs() < 1e-9);
            assert!((camera.intrinsics.principal.y - 112.0).abs() < 1e-9);
        }
    }

    let object = read_obj(&folder.path().join("geometry/object.obj"), 1.0).unwrap();
    assert_eq!(object.triangles.len(), exported.triangles);
    assert_eq!(object.uv_triangles.len(), exported.triangles);
    assert!(read_obj(&folder.path().join("geometry/floor.obj"), 1.0).unwrap().triangles.len() == 2);

    // The true texture on the exported object, seen by the exported cameras, is the exported truth: meshes, texture
    // coordinates, poses and pictures fit each other.
    let (_home, session) = bare_session();
    let geometry = folder.path().join("geometry");
    let meshes = [geometry.join("object.obj"), geometry.join("floor.obj")];
    let silent = Progress::silent();
    scene::import(&session, &geometry.join("cameras.xml"), &meshes, Lengths::default(), &silent).unwrap();
    let texture = tiff16::read_rgb(&folder.path().join("truth/texture.tif")).unwrap();
    let model = session.model_dir();
    std::fs::create_dir_all(&model).unwrap();
    exr_image::write_rgb(&model.join("reflectance.exr"), &texture, &Meta::default()).unwrap();
    let score = evaluate(&session, &folder.path().join("truth"), &silent).unwrap().texture.unwrap();
    println!("{:?}", score.full);
    assert!(score.missing.is_empty() && score.by_view.len() == exported.views);
    assert!(score.full.mean.abs() < 1e-3, "{:?}", score.full);
    assert!(score.full.standard_deviation < 0.01, "{:?}", score.full);
}
