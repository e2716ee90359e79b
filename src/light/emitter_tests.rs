//! Lamps against brute force and plates with known shadows.

use super::super::RayKernel;
use super::*;
use glam::Vec3;

const PLACES: [(DVec3, DVec3); 4] = [
    (DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.1, 0.2, -0.9)),
    (DVec3::new(0.3, -0.2, 0.6), DVec3::new(-0.4, 0.1, -0.7)),
    (DVec3::new(0.05, 0.02, 0.3), DVec3::new(0.0, 0.0, -1.0)),
    (DVec3::new(0.4, 0.3, 0.25), DVec3::new(-0.7, -0.5, -0.4)),
];

/// The pose of a lamp that is off the lens and turned.
fn aslant() -> DAffine3 {
    DAffine3::from_rotation_translation(
        glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.2, -0.3, 0.7),
        DVec3::new(0.06, -0.11, 0.02),
    )
}

fn square(half: f64) -> Vec<[DVec3; 3]> {
    let p = [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| DVec3::new(x, y, 0.0));
    vec![[p[0], p[1], p[2]], [p[0], p[2], p[3]]]
}

/// Very many points of the lamp, each with its distance and cosines.
fn brute(lamp: &Emitter, point: DVec3, normal: DVec3) -> f64 {
    let n = 200_000;
    let (place, facing) = lamp.local(point, normal);
    let total: f64 = (0..n)
        .map(|i| {
            let (at, axis) = lamp.sample(i, n, 0.0);
            let way = (at - place).normalize();
            let (here, there) = (facing.dot(way).max(0.0), (-axis.dot(way)).max(0.0));
            here * there * there.powf(lamp.exponent) / at.distance_squared(place)
        })
        .sum();
    total * lamp.area() / n as f64
}

#[test]
fn every_shape_at_a_slant_agrees_with_the_sum_over_its_points() {
    let shapes = [
        Shape::Disc { radius: 0.05 },
        Shape::Ring(Ring::new(0.035, 0.085).unwrap()),
        Shape::Mesh { triangles: square(0.06) },
    ];
    for shape in shapes {
        for (exponent, tolerance) in [(0.0, 1e-4), (1.5, 5e-3)] {
            let lamp = Emitter::new(shape.clone(), aslant(), exponent).unwrap();
            for (point, normal) in PLACES {
                let normal = normal.normalize();
                let (got, want) = (lamp.irradiance(point, normal), brute(&lamp, point, normal));
                assert!((got / want - 1.0).abs() < tolerance, "{shape:?} {exponent}: {got} for {want}");
            }
        }
    }
}

#[test]
fn a_ring_round_the_lens_is_the_ring() {
    let ring = Ring::new(0.035, 0.085).unwrap();
    let lamp = Emitter::from(ring);
    for (point, normal) in PLACES {
        assert_eq!(lamp.irradiance(point, normal.normalize()), ring.irradiance(point, normal.normalize()));
    }
    assert_eq!(lamp.reach(), 0.085);
    assert!(lamp.is_in_lens_plane());
}

#[test]
fn a_point_obeys_the_inverse_square_and_its_lobe() {
    let lamp = Emitter::new(Shape::Point, DAffine3::IDENTITY, 2.0).unwrap();
    let near = lamp.irradiance(DVec3::new(0.0, 0.0, 1.0), -DVec3::Z);
    assert!((near - 1.0).abs() < 1e-12);
    assert!((lamp.irradiance(DVec3::new(0.0, 0.0, 2.0), -DVec3::Z) - 0.25).abs() < 1e-12);
    // At 45 degrees: twice the square of the distance, a cosine at the surface and two in the lobe.
    let aside = lamp.irradiance(DVec3::new(1.0, 0.0, 1.0), -DVec3::Z);
    assert!((aside - 0.5 * 0.5f64.powf(1.5)).abs() < 1e-12, "{aside}");
    assert_eq!(lamp.irradiance(DVec3::new(0.0, 0.0, -1.0), DVec3::Z), 0.0);
    assert_eq!(lamp.irradiance(DVec3::ZERO, DVec3::Z), 0.0);
}

#[test]
fn the_horizon_clips_a_polygon() {
    // A square overhead seen edge-on by half: a wall's element at its foot, lit by the half in front of it.
    let lamp = Emitter::new(Shape::Mesh { triangles: square(0.5) }, DAffine3::IDENTITY, 0.0).unwrap();
    let (point, normal) = (DVec3::new(0.0, 0.0, 0.7), DVec3::X);
    let half = vec![
        [DVec3::new(0.0, -0.5, 0.0), DVec3::new(0.5, -0.5, 0.0), DVec3::new(0.5, 0.5, 0.0)],
        [DVec3::new(0.0, -0.5, 0.0), DVec3::new(0.5, 0.5, 0.0), DVec3::new(0.0, 0.5, 0.0)],
    ];
    let front = Emitter::new(Shape::Mesh { triangles: half }, DAffine3::IDENTITY, 0.0).unwrap();
    let (got, want) = (lamp.irradiance(point, normal), brute(&front, point, normal));
    assert!((got / want - 1.0).abs() < 1e-3, "{got} for {want}");
    assert_eq!(lamp.irradiance(DVec3::new(0.0, 0.0, -0.7), DVec3::Z), 0.0);
}

#[test]
fn reach_bounds_a_lamp_that_is_off_the_lens() {
    let lamp = Emitter::new(Shape::Mesh { triangles: square(0.06) }, aslant(), 0.0).unwrap();
    for i in 0..100 {
        let (at, _) = lamp.sample(i, 100, 0.3);
        assert!(aslant().transform_point3(at).length() <= lamp.reach());
    }
    assert!(!lamp.is_in_lens_plane());
}

#[test]
fn half_a_lamp_behind_a_plate_gives_half_its_light() {
    let far = 9.0f32;
    let quad = [[0.0, -far], [far, -far], [far, far], [0.0, far]].map(|[x, y]| Vec3::new(x, y, 0.2));
    let kernel = RayKernel::build(vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
    let occluders = Occluders { kernel: &kernel, world_from_camera: &DAffine3::IDENTITY, offset: 1e-4 };
    let (point, normal) = (DVec3::new(0.0, 0.0, 0.8), -DVec3::Z);
    for (shape, exponent) in [
        (Shape::Disc { radius: 0.05 }, 0.0),
        (Shape::Ring(Ring::new(0.035, 0.085).unwrap()), 3.0),
        (Shape::Mesh { triangles: square(0.06) }, 0.0),
    ] {
        let lamp = Emitter::new(shape, DAffine3::IDENTITY, exponent).unwrap();
        let lit = lamp.shadowed_irradiance(&occluders, point, normal);
        let share = lit / lamp.irradiance(point, normal);
        assert!((share - 0.5).abs() < 0.05, "{share} of {:?}", lamp.shape());
    }
    let point_lamp = |x: f64| {
        let pose = DAffine3::from_translation(DVec3::new(x, 0.0, 0.0));
        let lamp = Emitter::new(Shape::Point, pose, 0.0).unwrap();
        lamp.shadowed_irradiance(&occluders, point, normal)
    };
    assert_eq!(point_lamp(0.1), 0.0);
    assert!(point_lamp(-0.1) > 0.0);
}

#[test]
fn what_makes_no_lamp_is_refused() {
    let even = DAffine3::IDENTITY;
    assert!(matches!(Emitter::new(Shape::Disc { radius: 0.0 }, even, 0.0), Err(EmitterError::Disc(_))));
    assert!(Emitter::new(Shape::Mesh { triangles: vec![] }, even, 0.0).is_err());
    assert!(Emitter::new(Shape::Mesh { triangles: vec![[DVec3::X; 3]] }, even, 0.0).is_err());
    assert!(Emitter::new(Shape::Point, even, f64::NAN).is_err());
    assert!(Emitter::new(Shape::Point, DAffine3::from_scale(DVec3::splat(2.0)), 0.0).is_err());
    assert!(
        Emitter::new(Shape::Ring(Ring { inner: 2.0, outer: 1.0, offset: 0.0, lobe: 0.0 }), even, 0.0)
            .is_err()
    );
}

#[test]
fn a_lamp_survives_being_written_down() {
    let lamp = Emitter::new(Shape::Mesh { triangles: square(0.06) }, aslant(), 1.5).unwrap();
    let text = serde_json::to_string(&lamp).unwrap();
    assert_eq!(serde_json::from_str::<Emitter>(&text).unwrap(), lamp);
}
