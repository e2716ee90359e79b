//! Tags drawn by a renderer of its own: a plane, bits, a lens with distortion, blur, noise.

use super::*;
use crate::codec::apriltag;
use crate::raster::blur::gaussian;
use crate::scene::{Camera, Distortion};
use glam::{DAffine3, DMat3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Codes of the first tags of the family (AprilRobotics, BSD-2-Clause).
const CODES: [u64; 4] = [0xd_7e00_984b, 0xd_da66_4ca7, 0xd_c4a1_c821, 0xe_17b4_70e9];

/// Whether the bit in this column and row of the black square is white; 0 and 7 are its border.
fn white(id: usize, column: usize, row: usize) -> bool {
    let quarter = [(1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (2, 2), (3, 2), (4, 2), (3, 3)];
    let mut places = quarter.to_vec();
    for i in 0..27 {
        let (x, y): (usize, usize) = places[i];
        places.push((7 - y, x));
    }
    places.iter().position(|p| *p == (column, row)).is_some_and(|i| CODES[id] >> (35 - i) & 1 == 1)
}

fn even(rng: &mut ChaCha8Rng) -> f64 {
    rng.random()
}

/// Normal with standard deviation 1, near enough: twelve even ones.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| even(rng)).sum::<f64>() - 6.0
}

/// A tag on a card: number, and the centre on the card, turned by an angle.
type Put = (usize, DVec2, f64);

struct Scene {
    intrinsics: Intrinsics,
    /// Camera frame from card: x right, y down, z behind.
    pose: DAffine3,
    size: f64,
    tags: Vec<Put>,
    blur: f32,
    noise: f64,
}

impl Scene {
    fn truth(&self) -> Plane {
        Plane { point: self.pose.translation, normal: -self.pose.matrix3.z_axis }
    }

    fn light(&self, at: DVec2) -> f64 {
        for (id, centre, turn) in &self.tags {
            let bit = DVec2::from_angle(-turn).rotate(at - *centre) / self.size * 8.0 + 4.0;
            if bit.min_element() >= 0.0 && bit.max_element() < 8.0 {
                return if white(*id, bit.x as usize, bit.y as usize) { 0.9 } else { 0.05 };
            }
        }
        0.9
    }

    /// The grey picture: white is 4000 DN or so.
    fn draw(&self, rng: &mut ChaCha8Rng) -> Grey {
        const FINE: usize = 4;
        let camera = Camera {
            name: String::new(),
            intrinsics: self.intrinsics,
            world_from_camera: DAffine3::IDENTITY,
        };
        let (plane, back) = (self.truth(), self.pose.inverse());
        let image = Image::from_fn(self.intrinsics.width / 2, self.intrinsics.height / 2, |x, y| {
            let mut sum = 0.0;
            let seen =
                |pixel: DVec2| back.transform_point3(plane.meets(camera.ray(pixel)).unwrap()).truncate();
            let middle = seen(2.0 * DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let near = |(_, centre, _): &Put| middle.distance(*centre) < 0.75 * self.size;
            if !self.tags.iter().any(near) {
                return [(4500.0 * 0.9) as f32];
            }
            for i in 0..FINE * FINE {
                let inside = DVec2::new((i % FINE) as f64 + 0.5, (i / FINE) as f64 + 0.5) / FINE as f64;
                let pixel = 2.0 * (DVec2::new(x as f64, y as f64) + inside);
                sum += self.light(seen(pixel));
            }
            [(4500.0 * sum / (FINE * FINE) as f64) as f32]
        });
        let blurred = gaussian(&image, self.blur);
        let noisy = blurred.map(|[v]| [*v + (self.noise * normal(rng)) as f32]);
        Grey { image: noisy, ceiling: 15_000.0 }
    }
}

fn lens(rng: &mut ChaCha8Rng, width: usize, height: usize, focal: f64) -> Intrinsics {
    let mut some = |size: f64| size * (2.0 * even(rng) - 1.0);
    Intrinsics {
        width,
        height,
        focal: DVec2::new(focal, focal * (1.0 + some(0.002))),
        principal: DVec2::new(width as f64, height as f64) / 2.0 + DVec2::new(some(6.0), some(6.0)),
        distortion: Distortion { k1: some(0.1), k2: some(0.03), p1: some(1e-3), p2: some(1e-3), k3: 0.0 },
    }
}

/// A card at a distance, tilted by up to an angle, with tags of one size.
fn scene(rng: &mut ChaCha8Rng, side_px: f64, most_tilt: f64, tags: Vec<Put>) -> Scene {
    let intrinsics = lens(rng, 640, 480, 1000.0);
    let (size, turn) = (0.06, std::f64::consts::TAU * even(rng));
    let (tilt, about) = (most_tilt * even(rng), std::f64::consts::TAU * even(rng));
    let axis = DVec3::new(about.cos(), about.sin(), 0.0);
    let matrix = DMat3::from_axis_angle(axis, tilt) * DMat3::from_rotation_z(turn);
    let distance = 1000.0 * size / side_px;
    let aside = DVec2::new(even(rng) - 0.5, even(rng) - 0.5) * 0.16 * distance;
    let pose = DAffine3::from_mat3_translation(matrix, aside.extend(distance));
    Scene { intrinsics, pose, size, tags, blur: (0.5 + 0.5 * even(rng)) as f32, noise: 15.0 }
}

fn found(scene: &Scene, rng: &mut ChaCha8Rng) -> Result<CardPose, TagError> {
    let grey = scene.draw(rng);
    let tags = apriltag::find(&grey.eight_bits()).unwrap();
    card_pose(&grey, &tags, &scene.intrinsics, scene.size)
}

fn between(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// Of runs over random poses, lenses and blurs: distances off the truth in standard errors, and normals in degrees.
fn one_tag_runs(seed: u64, runs: usize) -> (Vec<f64>, Vec<f64>) {
    let mut turned = vec![];
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let one = |run: usize| {
        let side = 100.0 + 60.0 * even(&mut rng);
        let scene = scene(&mut rng, side, 0.6, vec![(run % 4, DVec2::ZERO, 0.0)]);
        let pose = found(&scene, &mut rng).unwrap_or_else(|e| panic!("run {run}: {e}"));
        let truth = scene.truth();
        let angle = between(pose.plane.normal, truth.normal);
        assert_eq!((pose.tags.len(), pose.tags[0].id), (1, run % 4));
        assert_eq!(pose.other, None, "run {run}");
        assert!((pose.distance_m / truth.distance() - 1.0).abs() < 0.002, "run {run}: {pose:?}");
        turned.push(angle.to_degrees());
        assert!(
            angle < 4.5 * pose.normal_rad_standard_error,
            "run {run}: {angle} {}",
            pose.normal_rad_standard_error
        );
        // The upright tag's rows, as it was turned.
        assert!(between(pose.tags[0].axes[0], scene.pose.matrix3.x_axis) < 0.02, "run {run}");
        (pose.distance_m - truth.distance()) / pose.distance_m_standard_error
    };
    let off = (0..runs).map(one).collect();
    (off, turned)
}

#[test]
fn one_tag_of_100_pixels_tells_distance_and_tilt_and_how_well() {
    let (off, turned) = one_tag_runs(11, 40);
    let held = off.iter().filter(|z| z.abs() < 1.96).count();
    assert!(held >= 36 && off.iter().all(|z| z.abs() < 4.0), "{held}: {off:?}");
    // A tag that faces the lens tells its tilt worst.
    let near = turned.iter().filter(|degrees| **degrees < 0.3).count();
    assert!(near >= 38, "{near}: {turned:?}");
}

#[test]
fn errors_hold_the_truth_as_often_as_they_should() {
    let mut rng = ChaCha8Rng::seed_from_u64(18);
    let focal = DVec2::splat(1000.0);
    let (mut held, mut turned) = (0, vec![]);
    const RUNS: usize = 400;
    for run in 0..RUNS {
        let drawn = scene(&mut rng, 100.0, 0.7, vec![]);
        let project = |x: f64, y: f64| {
            let p = drawn.pose.transform_point3(drawn.size * DVec3::new(x, y, 0.0));
            p.truncate() / p.z * focal
        };
        let corners = [project(-0.5, -0.5), project(0.5, -0.5), project(0.5, 0.5), project(-0.5, 0.5)];
        let sides = std::array::from_fn(|k| {
            let (from, to) = (corners[k], corners[(k + 1) % 4]);
            let outward = -(to - from).perp().normalize();
            let point = |i: usize| {
                let noise = 0.1 * normal(&mut rng);
                from.lerp(to, (f64::from(i as u32) + 0.5) / 20.0) + noise * outward
            };
            (0..20).map(point).collect()
        });
        let square = pose::Square { corners: corners.map(|c| c + 0.4), sides };
        let fit = pose::fit(&[square], focal, drawn.size).unwrap();
        let truth = drawn.truth();
        let off = (fit.plane.distance() - truth.distance()) / fit.distance_error;
        held += usize::from(off.abs() < 1.96);
        // The wrong one of two planes that the noise leaves open.
        let wrong = fit
            .other
            .is_some_and(|o| between(o.normal, truth.normal) < between(fit.plane.normal, truth.normal));
        if !wrong {
            turned.push(between(fit.plane.normal, truth.normal) / fit.normal_error);
        }
        assert!(off.abs() < 6.0, "run {run}: {off}");
    }
    let spread = (turned.iter().map(|z| z * z).sum::<f64>() / turned.len() as f64).sqrt();
    println!("{held} of {RUNS}; normal {spread:.2} of its error");
    assert!((0.90..0.98).contains(&(held as f64 / RUNS as f64)), "{held}");
    assert!((0.7..1.3).contains(&spread), "{spread}");
}

#[test]
fn tags_in_the_corners_tell_the_tilt_better_and_one_that_is_half_hidden_does_no_harm() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let corners = [(-0.09, -0.06), (0.09, -0.06), (0.09, 0.06), (-0.09, 0.06)];
    let tags: Vec<Put> =
        corners.into_iter().enumerate().map(|(i, c)| (i, DVec2::from(c), 0.7 * i as f64)).collect();
    for run in 0..4 {
        let mut scene = scene(&mut rng, 100.0, 0.5, tags.clone());
        scene.pose.translation = DVec3::new(0.0, 0.0, 0.6);
        scene.size = 0.05;
        let pose = found(&scene, &mut rng).unwrap_or_else(|e| panic!("run {run}: {e}"));
        let truth = scene.truth();
        let angle = between(pose.plane.normal, truth.normal).to_degrees();
        assert!(pose.tags.len() >= 3, "run {run}: {}", pose.tags.len());
        assert!(angle < 0.15, "run {run}: {angle} degrees");
        assert!((pose.distance_m / truth.distance() - 1.0).abs() < 0.001, "run {run}: {pose:?}");
        for tag in &pose.tags {
            let centre = scene.pose.transform_point3(tags[tag.id].1.extend(0.0));
            assert!(tag.centre_m.distance(centre) < 0.001, "run {run}: {tag:?} {centre}");
        }
    }
}

#[test]
fn a_small_tag_seen_aslant_from_afar_has_two_planes_and_both_are_told() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let mut told = 0;
    for _ in 0..8 {
        let mut scene = scene(&mut rng, 100.0, 0.0, vec![(0, DVec2::ZERO, 0.0)]);
        // A long lens from afar: next to no perspective within the tag.
        scene.intrinsics.focal *= 10.0;
        scene.intrinsics.distortion = Distortion::default();
        scene.noise = 60.0;
        scene.pose = DAffine3::from_mat3_translation(DMat3::from_rotation_y(0.4), DVec3::Z * 10.0);
        let pose = found(&scene, &mut rng).unwrap();
        let truth = scene.truth().normal;
        let off = |plane: Plane| between(plane.normal, truth).to_degrees();
        let best = pose.other.map_or(f64::INFINITY, off).min(off(pose.plane));
        assert!(best < 3.0, "{pose:?}");
        told += usize::from(pose.other.is_some());
    }
    assert!(told >= 6, "{told}");
}

#[test]
fn what_cannot_be_measured_is_refused_with_the_reason() {
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    let plain = scene(&mut rng, 100.0, 0.2, vec![]);
    assert_eq!(found(&plain, &mut rng), Err(TagError::None));
    let tagged = scene(&mut rng, 100.0, 0.2, vec![(1, DVec2::ZERO, 0.0)]);
    let mut grey = tagged.draw(&mut rng);
    let tags = apriltag::find(&grey.eight_bits()).unwrap();
    assert_eq!(card_pose(&grey, &tags, &tagged.intrinsics, 0.0), Err(TagError::Size(0.0)));
    let far = tags[0].corners.map(|c| tags[0].corners[0] + 0.1 * (c - tags[0].corners[0]));
    let far = card_pose(&grey, &[apriltag::Tag { corners: far, ..tags[0] }], &tagged.intrinsics, 0.06);
    assert!(matches!(far, Err(TagError::Small { id: 1, side_px }) if side_px < 20.0), "{far:?}");
    let aside = tags[0].corners.map(|c| c + 20.0);
    let aside = card_pose(&grey, &[apriltag::Tag { corners: aside, ..tags[0] }], &tagged.intrinsics, 0.06);
    assert_eq!(aside, Err(TagError::Blurred(1)));
    grey.ceiling = 3900.0;
    assert_eq!(card_pose(&grey, &tags, &tagged.intrinsics, 0.06), Err(TagError::Clipped(1)));
}

#[test]
fn tags_in_two_planes_are_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(16);
    let mut left = scene(&mut rng, 100.0, 0.0, vec![(0, DVec2::new(-0.05, 0.0), 0.0)]);
    left.pose = DAffine3::from_translation(DVec3::Z * 0.6);
    let a = left.draw(&mut rng);
    // The right half of the picture shows another card, nearer and turned.
    left.tags = vec![(1, DVec2::new(0.06, 0.0), 0.0)];
    left.pose = DAffine3::from_mat3_translation(DMat3::from_rotation_x(0.3), DVec3::Z * 0.55);
    let b = left.draw(&mut rng);
    let middle = a.image.width() / 2;
    let image = Image::from_fn(a.image.width(), a.image.height(), |x, y| {
        *if x < middle { &a.image } else { &b.image }.at(x, y)
    });
    let grey = Grey { image, ceiling: a.ceiling };
    let tags = apriltag::find(&grey.eight_bits()).unwrap();
    assert_eq!(tags.len(), 2);
    let refused = card_pose(&grey, &tags, &left.intrinsics, left.size);
    assert!(matches!(refused, Err(TagError::Planes { .. })), "{refused:?}");
}

#[test]
fn cells_on_a_tag_and_its_border_are_not_of_the_card() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let scene = scene(&mut rng, 120.0, 0.3, vec![(2, DVec2::ZERO, 0.0)]);
    let pose = found(&scene, &mut rng).unwrap();
    let camera =
        Camera { name: String::new(), intrinsics: scene.intrinsics, world_from_camera: DAffine3::IDENTITY };
    let seen = |x: f64, y: f64| {
        let at = scene.size * DVec2::new(x, y);
        camera.project(scene.pose.transform_point3(at.extend(0.0))).unwrap().0
    };
    let covers = |x: f64, y: f64| pose.covers(&scene.intrinsics, seen(x, y), 8.0, 0.125 * scene.size);
    assert!(covers(0.0, 0.0) && covers(0.5, -0.5) && covers(-0.61, 0.0) && covers(0.0, 0.61));
    assert!(!covers(0.8, 0.0) && !covers(0.0, -0.8) && !covers(1.0, 1.0));
}

#[test]
fn the_grey_of_a_frame_is_its_green() {
    use crate::photometry::{Cfa, LevelSource, Levels};
    let frame = Mosaic {
        dn: Image::from_fn(6, 5, |x, y| match Cfa::RGGB.colour(x, y) {
            1 if y < 2 => 4090,
            1 => 100 + 10 * (x / 2) as u16 + (y & 1) as u16 * 2,
            _ => 3000,
        }),
        cfa: Cfa::RGGB,
        levels: Levels {
            black: [[100.0; 2]; 2],
            saturation: [[4095.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        },
    };
    let grey = Grey::of(&frame).unwrap();
    assert_eq!((grey.image.width(), grey.image.height()), (3, 2));
    assert_eq!(grey.image.at(2, 1), &[21.0]);
    assert!(grey.image.at(0, 0)[0] >= grey.ceiling);
    assert_eq!(Grey::of(&Mosaic { cfa: Cfa([[0, 0], [2, 2]]), ..frame }), None);
}
