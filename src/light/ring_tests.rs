//! The ring against brute force and plates with known shadows.

use super::*;
use crate::light::RayKernel;

/// In the camera's own frame.
fn occluders(kernel: &RayKernel) -> Occluders<'_> {
    Occluders { kernel, world_from_camera: &glam::DAffine3::IDENTITY, offset: 1e-4 }
}

/// Brute force over many ring points, horizon included.
fn summed(ring: &Ring, point: DVec3, normal: DVec3) -> f64 {
    let n = 400_000;
    let area = PI * (ring.outer.powi(2) - ring.inner.powi(2));
    let lamps = (0..n).map(|i| ring.at(&Place::spread(i, n), DVec2::X));
    lamps.map(|lamp| form(lamp, point, normal) * ring.lobe_towards(lamp, point)).sum::<f64>() * area
        / n as f64
}

#[test]
fn white_square_at_one_metre_has_the_known_radiance() {
    let ring = Ring::new(0.010, 0.100).unwrap();
    let e = 60.0 * ring.irradiance(DVec3::new(0.0, 0.0, 1.0), -DVec3::Z);
    assert!((0.94 * e / PI - 0.5528).abs() < 5e-5, "{}", 0.94 * e / PI);
}

#[test]
fn closed_form_agrees_with_the_sum_over_the_ring() {
    let ring = Ring::new(0.035, 0.085).unwrap();
    for (point, normal) in [
        (DVec3::new(0.0, 0.0, 0.8), DVec3::new(0.1, 0.2, -0.9)),
        (DVec3::new(0.3, -0.2, 0.6), DVec3::new(-0.4, 0.1, -0.7)),
        (DVec3::new(1e-7, 0.0, 0.3), DVec3::new(0.5, 0.0, -0.5)),
        (DVec3::new(0.05, 0.02, 0.1), DVec3::new(0.0, 0.0, -1.0)),
        (DVec3::new(-0.8, 0.9, 0.2), DVec3::new(0.7, -0.7, -0.1)),
    ] {
        let normal = normal.normalize();
        let (closed, brute) = (ring.irradiance(point, normal), summed(&ring, point, normal));
        assert!((closed / brute - 1.0).abs() < 2e-5, "{closed} {brute} at {point}");
    }
}

#[test]
fn where_the_horizon_cuts_the_ring_the_sum_takes_over() {
    let ring = Ring::new(0.035, 0.085).unwrap();
    let (point, normal) = (DVec3::new(0.0, 0.02, 0.5), DVec3::new(1.0, 0.05, -0.02).normalize());
    let (got, brute) = (ring.irradiance(point, normal), summed(&ring, point, normal));
    assert!((got / brute - 1.0).abs() < 0.02, "{got} {brute}");
    assert_eq!(ring.irradiance(point, DVec3::Z), 0.0);
    assert_eq!(ring.irradiance(DVec3::new(0.0, 0.0, -0.5), DVec3::Z), 0.0);
}

#[test]
fn a_half_plane_before_half_the_ring_takes_half_the_light_from_whatever_side() {
    let ring = Ring::new(0.035, 0.085).unwrap();
    let far = 9.0;
    for side in 0..16 {
        let turn = glam::Quat::from_rotation_z(side as f32 * 0.4);
        let quad =
            [[0.0, -far], [far, -far], [far, far], [0.0, far]].map(|[x, y]| turn * Vec3::new(x, y, 0.2));
        let kernel = RayKernel::build(vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        let (point, normal) = (DVec3::new(0.0, 0.0, 0.8), -DVec3::Z);
        let occluders = occluders(&kernel);
        let lit = ring.shadowed_irradiance(&occluders, point, normal);
        let share = lit / ring.irradiance(point, normal);
        assert!((share - 0.5).abs() < 0.05, "{share} from side {side}");
    }
}

#[test]
fn the_sliver_above_the_horizon_is_shadowed_like_the_rest() {
    let ring = Ring::new(0.035, 0.085).unwrap();
    let point = DVec3::new(0.0, 0.0, 0.5);
    // The horizon leaves some 1e-5 of the ring's radius at its rightmost point.
    let normal = DVec3::new(1.0, 0.0, 0.085 * 0.99999 / 0.5).normalize();
    let wall = |x: f32| {
        let quad = [[x, -9.0], [9.0, -9.0], [9.0, 9.0], [x, 9.0]].map(|[x, y]| Vec3::new(x, y, 0.2));
        RayKernel::build(vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]])
    };
    for (kernel, lit) in [(wall(0.0), 0.0), (wall(8.0), 1.0)] {
        let occluders = occluders(&kernel);
        let element = Element::new(&occluders, point, normal);
        let hidden = std::iter::once(DVec3::new(-0.05, 0.0, 0.0));
        assert_eq!(element.lit(hidden, &ring), lit);
    }
}

#[test]
fn the_draws_of_one_pixel_together_tell_the_share_of_a_half_shadow() {
    let ring = Ring::new(0.035, 0.085).unwrap();
    let wall = [[0.0, -9.0], [9.0, -9.0], [9.0, 9.0], [0.0, 9.0]].map(|[x, y]| Vec3::new(x, y, 0.2));
    let kernel = RayKernel::build(vec![[wall[0], wall[1], wall[2]], [wall[0], wall[2], wall[3]]]);
    let occluders = occluders(&kernel);
    let mut mean = 0.0;
    for pixel in (0..100).map(|i| (i % 10, i / 10)) {
        let share = |k: u32| {
            let draw = Draw::of_pixel(pixel, 8 * k, 8);
            ring.drawn_share(&occluders, DVec3::new(0.0, 0.0, 0.8), -DVec3::Z, draw)
        };
        let whole = (0..4).map(share).sum::<f64>() / 4.0;
        assert!((whole - 0.5).abs() < 0.08, "{whole} in {pixel:?}");
        mean += whole / 100.0;
    }
    assert!((mean - 0.5).abs() < 0.005, "{mean}");
}

#[test]
fn radii_out_of_order_are_refused() {
    assert!(Ring::new(0.085, 0.035).is_err());
    assert!(Ring::new(-0.1, 0.035).is_err());
    assert!(Ring::new(f64::NAN, 0.035).is_err());
}

#[test]
fn a_ring_off_the_lens_with_a_lobe_is_the_sum_over_its_points() {
    let even = Ring::new(0.035, 0.085).unwrap();
    let (point, normal) = (DVec3::new(0.3, -0.2, 0.6), DVec3::new(-0.4, 0.1, -0.7).normalize());
    let nearer = even.irradiance(point - 0.02 * DVec3::Z, normal);
    assert!((even.placed(0.02, 0.0).irradiance(point, normal) / nearer - 1.0).abs() < 1e-12);
    for (offset, lobe, within) in [(0.02, 0.0, 2e-5), (-0.03, 1.5, 2e-5), (0.01, 0.2, 2e-5)] {
        let ring = even.placed(offset, lobe);
        let (got, brute) = (ring.irradiance(point, normal), summed(&ring, point, normal));
        assert!((got / brute - 1.0).abs() < within, "{got} {brute} at {offset}, {lobe}");
    }
}

#[test]
fn the_sum_over_points_is_the_closed_form_as_near_as_cards_are_shot() {
    for (offset, distance, tilt) in [(0.0, 0.3, 0.0), (0.02, 0.5, 0.3), (-0.03, 1.0, -0.4), (0.01, 2.5, 0.0)]
    {
        let ring = Ring::new(0.035, 0.085).unwrap().placed(offset, 0.0);
        let (point, normal) =
            (distance * DVec3::new(0.4, -0.2, 1.0), DVec3::new(tilt, 0.1, -1.0).normalize());
        let (closed, summed) = (ring.irradiance(point, normal), ring.summed_irradiance(point, normal));
        assert!((summed / closed - 1.0).abs() < 1e-6, "{summed} {closed} at {distance}");
        let lobed = ring.placed(offset, 0.7);
        let (closed, summed) = (lobed.irradiance(point, normal), lobed.summed_irradiance(point, normal));
        assert!((summed / closed - 1.0).abs() < 1e-6, "{summed} {closed} at {distance} with a lobe");
    }
}

#[test]
fn shadows_of_a_ring_off_the_lens_fall_from_where_it_is() {
    let ring = Ring::new(0.035, 0.085).unwrap().placed(0.05, 0.5);
    let point = DVec3::new(0.0, 0.0, 0.8);
    // A plate between the lens and the ring hides nothing of it; one before the ring hides it all.
    for (z, lit) in [(0.03, 1.0), (0.07, 0.0)] {
        let quad = [[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]].map(|[x, y]| Vec3::new(x, y, z));
        let kernel = RayKernel::build(vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        let got = ring.shadowed_irradiance(&occluders(&kernel), point, -DVec3::Z);
        assert!((got / ring.irradiance(point, -DVec3::Z) - lit).abs() < 1e-9, "{got} at {z}");
    }
}
