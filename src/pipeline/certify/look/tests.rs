use super::*;
use crate::scene::{Distortion, Intrinsics};
use glam::{DAffine3, DMat3, Vec2};

const SIDE: usize = 64;

/// A square of 20 cm at the height `z`, its texture all of the unit square.
fn square(name: &str, half: f32, z: f32) -> Mesh {
    let uvs = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(Vec2::from);
    let positions = uvs.map(|uv| ((uv * 2.0 - 1.0) * half).extend(z)).to_vec();
    let triangles = vec![[0, 1, 2], [0, 2, 3]];
    Mesh { name: name.into(), positions, uv_triangles: triangles.clone(), triangles, uvs: uvs.to_vec() }
}

/// A card on a table, and a camera a metre above it that looks down.
fn scene() -> Scene {
    let down = DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z);
    let camera = |name: &str, x: f64| Camera {
        name: name.into(),
        intrinsics: Intrinsics {
            width: 100,
            height: 100,
            focal: DVec2::splat(150.0),
            principal: DVec2::splat(50.0),
            distortion: Distortion::default(),
        },
        world_from_camera: DAffine3::from_mat3_translation(down, DVec3::new(x, 0.0, 1.0)),
    };
    let cameras = vec![camera("a", 0.0), camera("b", 0.05)];
    Scene { cameras, meshes: vec![square("card", 0.1, 0.0), square("table", 1.0, -0.01)] }
}

/// Reflectance rises from left to right; the upper half of the texture was seen.
fn surface(scene: &Scene) -> Surface<'_> {
    let triangles = scene.meshes.iter().flat_map(|m| (0..m.triangles.len()).map(|t| m.corners(t))).collect();
    let ramp = |x: usize, _: usize| [(x as f32 + 0.5) / SIDE as f32, 0.5, 0.25];
    let mut surface = Surface {
        scene,
        object: &scene.meshes[0],
        kernel: RayKernel::build(triangles),
        reflectance: Image::from_fn(SIDE, SIDE, ramp),
        deviation: Image::filled(SIDE, SIDE, [0.01, 0.02, 0.03]),
        seen: (0..SIDE * SIDE).map(|t| if t / SIDE < SIDE / 2 { 3.0 } else { 0.0 }).collect(),
        surface: vec![1.0; SIDE * SIDE],
        points: vec![],
    };
    surface.lay_out().unwrap();
    surface
}

fn read(looked: Looked) -> Found {
    match looked {
        Looked::Found(found) => found,
        Looked::Beside => panic!("beside"),
        Looked::Unseen(why) => panic!("{why}"),
    }
}

fn unseen(looked: Looked) -> String {
    match looked {
        Looked::Unseen(why) => why,
        Looked::Beside => panic!("beside"),
        Looked::Found(found) => panic!("{found:?}"),
    }
}

#[test]
fn a_place_is_the_same_by_point_quadrangle_texture_and_view() {
    let scene = scene();
    let surface = surface(&scene);
    // x = 5 cm of -10 to 10 is u = 0.75; y above 0 is the texture's upper half, which was seen.
    let places = [
        Place::Point { at_m: [0.05, 0.05, 0.001], radius_m: 0.02 },
        Place::Quad {
            corners_m: [[0.03, 0.03, 0.0], [0.07, 0.03, 0.0], [0.07, 0.07, 0.0], [0.03, 0.07, 0.0]],
        },
        Place::Texture { from_uv: [0.65, 0.85], to_uv: [0.85, 0.65] },
        // From 1 m at 150 pixels a unit, y upwards: 5 cm are 7.5 pixels.
        Place::View {
            name: "a".into(),
            polygon_px: vec![[54.0, 39.0], [61.0, 39.0], [61.0, 46.0], [54.0, 46.0]],
        },
    ];
    for place in &places {
        let found = read(surface.look(place));
        assert!((found.mean[0] - 0.75).abs() < 0.006, "{place:?} {found:?}");
        assert!((found.mean[1] - 0.5).abs() < 1e-6 && (found.mean[2] - 0.25).abs() < 1e-6, "{found:?}");
        assert!(found.deviation.is_some_and(|d| (d[2] - 0.03).abs() < 1e-6), "{found:?}");
        assert!(matches!(found.source, Source::Texture { seen_share: 1.0, .. }), "{found:?}");
    }
}

#[test]
fn what_no_view_saw_is_not_seen_whatever_fills_it() {
    let scene = scene();
    let surface = surface(&scene);
    for place in [
        Place::Point { at_m: [0.05, -0.05, 0.0], radius_m: 0.02 },
        Place::Texture { from_uv: [0.1, 0.1], to_uv: [0.9, 0.4] },
        Place::View { name: "a".into(), polygon_px: vec![[54.0, 55.0], [60.0, 55.0], [60.0, 61.0]] },
    ] {
        assert!(unseen(surface.look(&place)).contains("filled, not measured"), "{place:?}");
    }
    let small = Place::Point { at_m: [0.05, 0.05, 0.0], radius_m: 0.003 };
    assert!(unseen(surface.look(&small)).contains("larger part"));
    let outside =
        Place::View { name: "a".into(), polygon_px: vec![[-9.0, -9.0], [-1.0, -9.0], [-1.0, -1.0]] };
    assert!(unseen(surface.look(&outside)).contains("no pixel"));
    let nowhere = Place::View { name: "z".into(), polygon_px: vec![] };
    assert!(unseen(surface.look(&nowhere)).contains("no camera"));
}

#[test]
fn a_patch_beside_the_object_is_read_from_the_views_and_their_scatter_told() {
    let scene = scene();
    let surface = surface(&scene);
    let quad = Place::Quad {
        corners_m: [[0.15, -0.04, -0.01], [0.23, -0.04, -0.01], [0.23, 0.04, -0.01], [0.15, 0.04, -0.01]],
    };
    let view = Place::View {
        name: "b".into(),
        polygon_px: vec![[70.0, 45.0], [78.0, 45.0], [78.0, 55.0], [70.0, 55.0]],
    };
    let air = Place::Point { at_m: [0.0, 0.0, 0.5], radius_m: 0.05 };
    for place in [&quad, &view, &air] {
        assert!(matches!(surface.look(place), Looked::Beside), "{place:?}");
    }
    // View b knows nothing at its right.
    let image = |name: &str| -> Result<Image<[f32; 4]>, Cancelled> {
        let value = if name == "a" { 0.40 } else { 0.44 };
        Ok(Image::from_fn(100, 100, |x, _| [value, 0.3, 0.2, if name == "b" && x > 90 { 0.0 } else { 1.0 }]))
    };
    let places = [&quad, &view, &air];
    let mut looked =
        surface.look_beside(&places, &["a", "b", "c"], image, &Progress::silent()).unwrap().into_iter();
    let both = read(looked.next().unwrap());
    assert!((both.mean[0] - 0.42).abs() < 1e-6, "{both:?}");
    let scatter = 0.02 * std::f64::consts::SQRT_2;
    assert!(both.deviation.is_some_and(|d| (d[0] - scatter).abs() < 1e-6 && d[1] < 1e-9), "{both:?}");
    let one = read(looked.next().unwrap());
    assert!((one.mean[0] - 0.44).abs() < 1e-6 && one.deviation.is_none(), "{one:?}");
    assert!(matches!(&one.source, Source::Views { names, .. } if names == &["b"]), "{one:?}");
    assert!(unseen(looked.next().unwrap()).contains("neither the model nor any view"));
}

#[test]
fn the_back_of_a_thin_card_is_not_its_front() {
    let mut scene = scene();
    let back = square("back", 0.1, -0.001);
    let card = &mut scene.meshes[0];
    // The back faces down and has the texture's lower half to itself; the front the upper.
    card.uvs.iter_mut().for_each(|uv| uv.y = 0.5 + 0.5 * uv.y);
    let (positions, uvs) = (card.positions.len() as u32, card.uvs.len() as u32);
    card.positions.extend(&back.positions);
    card.uvs.extend(back.uvs.iter().map(|uv| Vec2::new(uv.x, 0.49 * uv.y)));
    card.triangles
        .extend(back.triangles.iter().map(|[a, b, c]| [a + positions, c + positions, b + positions]));
    card.uv_triangles.extend(back.uv_triangles.iter().map(|[a, b, c]| [a + uvs, c + uvs, b + uvs]));
    let surface = surface(&scene);
    let found = read(surface.look(&Place::Point { at_m: [0.0, 0.0, -0.001], radius_m: 0.03 }));
    assert!(matches!(found.source, Source::Texture { seen_share: 1.0, .. }), "{found:?}");
}
