//! Tags drawn by a renderer of its own: a plane, bits, a lens with distortion, blur, noise.

use super::*;
use crate::calibration::colour::fit::tests::{even, normal};
use crate::codec::apriltag;
use crate::raster::blur::gaussian;
use crate::scene::{Camera, Distortion};
use glam::{DAffine3, DMat3};
use rand::SeedableRng as _;
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
            let seen = |pixel: DVec2| {
                back.transform_point3(plane.meets(camera.ray(pixel)).unwrap()).truncate()
            };
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

#[test]
fn one_tag_tells_distance_and_tilt_within_its_own_errors() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut held, mut worst, mut turned) = (0, 0.0f64, vec![]);
    let (mut zs, mut ns) = (vec![], vec![]);
    const RUNS: usize = 60;
    for run in 0..RUNS {
        let scene = scene(&mut rng, 100.0 + 60.0 * even_of(run), 0.6, vec![(run % 4, DVec2::ZERO, 0.0)]);
        let pose = found(&scene, &mut rng).unwrap_or_else(|e| panic!("run {run}: {e}"));
        assert_eq!((pose.tags.len(), pose.tags[0].id), (1, run % 4));
        let truth = scene.truth();
        let off = pose.distance_m / truth.distance() - 1.0;
        let mut angle = between(pose.plane.normal, truth.normal);
        if let Some(other) = pose.other {
            angle = angle.min(between(other.normal, truth.normal));
        }
        println!(
            "run {run}: {:+.4} % (error {:.4} %), {:.3} deg (error {:.3}), rms {:.3} other {}",
            100.0 * off, 100.0 * pose.distance_error_m / pose.distance_m, angle.to_degrees(),
            pose.normal_error_rad.to_degrees(), pose.rms_px, pose.other.is_some()
        );
        zs.push(off * pose.distance_m / pose.distance_error_m);
        ns.push(angle / pose.normal_error_rad);
        worst = worst.max(off.abs());
        turned.push(angle.to_degrees());
        held += usize::from((pose.distance_m - truth.distance()).abs() < 1.96 * pose.distance_error_m);
        // The upright tag's rows and columns, as it was turned.
        let right = pose.tags[0].axes[0];
        assert!(between(right, scene.pose.matrix3.x_axis) < 0.1, "run {run}: {right}");
    }
    let sd = |z: &[f64]| (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
    turned.sort_by(f64::total_cmp);
    println!("held {held} of {RUNS}; worst {worst}; median tilt {}; worst {}; z {} n {}", turned[RUNS / 2], turned[RUNS - 1], sd(&zs), sd(&ns));
}

fn even_of(run: usize) -> f64 {
    (run as f64 * 0.618_034).fract()
}
