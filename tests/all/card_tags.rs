//! A flash calibration from card shots whose places AprilTags tell, against the same by given planes.

use crate::wall::settings;
use glam::{DAffine3, DMat3, DVec2, DVec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use unlit::codec::dng::{self, DngContent};
use unlit::light::Ring;
use unlit::pair::Exposure;
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;
use unlit::units::{FNumber, Iso, Seconds};

const SIZE: (usize, usize) = (660, 440);
const FOCAL: f64 = 700.0;
const TAG: f64 = 0.07;
const RADIANCE: [f64; 3] = [5.0e5, 6.5e5, 4.0e5];

/// Codes of the family's first tags (AprilRobotics, BSD-2-Clause).
const CODES: [u64; 4] = [0xd_7e00_984b, 0xd_da66_4ca7, 0xd_c4a1_c821, 0xe_17b4_70e9];

/// Which of the 8 x 8 bits are white, by columns in rows.
fn bits(id: usize) -> [[bool; 8]; 8] {
    let mut places = vec![(1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (2, 2), (3, 2), (4, 2), (3usize, 3usize)];
    for i in 0..27 {
        places.push((7 - places[i].1, places[i].0));
    }
    let mut out = [[false; 8]; 8];
    for (i, (x, y)) in places.into_iter().enumerate() {
        out[y][x] = CODES[id] >> (35 - i) & 1 == 1;
    }
    out
}

/// A card with four tags: where it stands, and its shot.
struct Card {
    /// Camera frame from card.
    pose: DAffine3,
    file: PathBuf,
}

impl Card {
    fn shoot(folder: &Path, number: usize, distance: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(number as u64 + 1);
        let mut even = || rng.random::<f64>();
        let about = std::f64::consts::TAU * even();
        let tilt = DMat3::from_axis_angle(DVec3::new(about.cos(), about.sin(), 0.0), 0.06 + 0.15 * even());
        let aside = 0.03 * DVec2::new(even() - 0.5, even() - 0.5);
        let pose = DAffine3::from_mat3_translation(tilt, aside.extend(distance));
        let normal = -tilt.z_axis;
        let corners = [(-0.15, -0.085), (0.15, -0.085), (0.15, 0.085), (-0.15, 0.085)];
        let tags: Vec<_> = corners
            .into_iter()
            .enumerate()
            .map(|(id, at)| (bits(id), DVec2::from(at), std::f64::consts::TAU * even()))
            .collect();
        let ray =
            |pixel: DVec2| ((pixel - DVec2::new(SIZE.0 as f64, SIZE.1 as f64) / 2.0) / FOCAL).extend(1.0);
        let meets = |pixel: DVec2| {
            let ray = ray(pixel);
            ray * (pose.translation.dot(normal) / ray.dot(normal))
        };
        let back = pose.inverse();
        let on_card = |pixel: DVec2| back.transform_point3(meets(pixel)).truncate();
        let reflectance = |at: DVec2| {
            for (bits, centre, turn) in &tags {
                let bit = DVec2::from_angle(-turn).rotate(at - *centre) / TAG * 8.0 + 4.0;
                if bit.min_element() >= 0.0 && bit.max_element() < 8.0 {
                    return if bits[bit.y as usize][bit.x as usize] { 0.8 } else { 0.04 };
                }
            }
            0.9
        };
        let ring = Ring::new(0.035, 0.085).unwrap();
        // Light is smooth: once for every block of four sites.
        let light = Image::from_fn(SIZE.0 / 2, SIZE.1 / 2, |x, y| {
            let point = meets(2.0 * DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            ring.irradiance(point, normal) / std::f64::consts::PI
        });
        let mut noise = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let dn = Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            let site = DVec2::new(x as f64, y as f64) + 0.5;
            let at = on_card(site);
            let mut rho = 0.9;
            if tags.iter().any(|(_, centre, _)| at.distance(*centre) < 0.8 * TAG) {
                rho = 0.0;
                // The lens's blur: a square of 1.6 sites.
                for i in 0..25 {
                    let off = DVec2::new((i % 5) as f64 - 2.0, (i / 5) as f64 - 2.0) * 0.32;
                    rho += reflectance(on_card(site + off)) / 25.0;
                }
            }
            let signal = RADIANCE[Cfa::RGGB.colour(x, y)] * rho * light.at(x / 2, y / 2);
            (2048.0 + signal + (0.5 * signal + 25.0).sqrt() * noise()).round().clamp(0.0, 15300.0) as u16
        });
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[15300.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        let dials = Exposure { shutter: Seconds(0.008), aperture: FNumber(11.0), iso: Iso(100.0) };
        let mosaic = Mosaic { dn, cfa: Cfa::RGGB, levels };
        let content = DngContent { mosaic: &mosaic, settings: &settings(dials), masked_left: None };
        let file = folder.join(format!("card{number}.dng"));
        std::fs::write(&file, dng::encode(&content).unwrap()).unwrap();
        Self { pose, file }
    }

    /// Distance along the axis, and the normal towards the camera.
    fn place(&self) -> (f64, DVec3) {
        let normal = -self.pose.matrix3.z_axis;
        (self.pose.translation.dot(normal) / normal.z, normal)
    }

    fn given(&self, factor: f64) -> String {
        let (distance, n) = self.place();
        format!("{}@{},{},{}={}", factor * distance, n.x, n.y, n.z, self.file.display())
    }
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

fn calibrate(folder: &Path, name: &str, shots: &[String], more: &[&str]) -> Output {
    let session = folder.join(name).display().to_string();
    assert!(run(&["new", &session]).status.success());
    let mut arguments = vec!["calibrate", "flash", &session, "--json", "--ring-radii", "0.035,0.085"];
    arguments.extend(["--focal-px", "700", "--target-reflectance", "0.9"]);
    arguments.extend(more);
    arguments.push("--shots");
    arguments.extend(shots.iter().map(String::as_str));
    run(&arguments)
}

fn record(output: Output) -> Value {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn tags_in_place_of_distances_give_the_same_flash_and_wrong_distances_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let cards: Vec<Card> = [0.55, 0.55, 0.7, 0.7, 0.85, 0.85]
        .into_iter()
        .enumerate()
        .map(|(i, distance)| Card::shoot(folder.path(), i, distance))
        .collect();
    let size = ["--tag-size", "0.07"];
    let given: Vec<String> = cards.iter().map(|card| card.given(1.0)).collect();
    let files: Vec<String> = cards.iter().map(|card| card.file.display().to_string()).collect();
    let by_ruler = record(calibrate(folder.path(), "ruler", &given, &size));
    let by_tags = record(calibrate(folder.path(), "tags", &files, &size));
    println!("{by_tags:#}");
    for c in 0..3 {
        let [ruler, tags] = [&by_ruler, &by_tags].map(|r| r["radiance_dn"][c].as_f64().unwrap());
        println!("radiance {tags} by tags, {ruler} by planes, truth {}", RADIANCE[c]);
        assert!((tags / ruler - 1.0).abs() < 0.002);
        assert!((ruler / RADIANCE[c] - 1.0).abs() < 0.002, "black of the tags is in the cells");
    }
    for (card, sight) in cards.iter().zip(by_tags["findings"]["card_tags"].as_array().unwrap()) {
        let (distance, normal) = card.place();
        let found = sight["distance_m"].as_f64().unwrap();
        assert!((found / distance - 1.0).abs() < 0.001, "{found} for {distance}");
        let n: Vec<f64> = serde_json::from_value(sight["plane"]["normal"].clone()).unwrap();
        assert!(normal.angle_between(DVec3::new(n[0], n[1], n[2])).to_degrees() < 0.2, "{n:?} for {normal}");
        assert_eq!(sight["tags"].as_array().unwrap().len(), 4);
        assert!(sight["given_distance_m"].is_null());
    }
    let said = |record: &Value| record["verdict"]["sentences"].to_string();
    assert!(said(&by_tags).contains("AprilTags of 70.0 mm") && !said(&by_ruler).contains("tag"));

    let mut wrong = given.clone();
    wrong[4] = cards[4].given(1.05);
    let told = said(&record(calibrate(folder.path(), "wrong", &wrong, &size)));
    assert!(told.contains("but the tags tell") && told.matches("card4.dng").count() == 1, "{told}");
}

#[test]
fn a_shot_without_distance_or_tags_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let card = Card::shoot(folder.path(), 1, 0.8);
    let shots = [card.file.display().to_string()];
    let said = |more: &[&str], name: &str| {
        let output = calibrate(folder.path(), name, &shots, more);
        assert!(!output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(said(&[], "none").contains("--tag-size"));
    let bare = folder.path().join("bare.dng");
    let dials = Exposure { shutter: Seconds(0.008), aperture: FNumber(11.0), iso: Iso(100.0) };
    std::fs::write(&bare, crate::wall::photo(1.0, 1, dials)).unwrap();
    let shots = [bare.display().to_string()];
    let output = calibrate(folder.path(), "bare", &shots, &["--tag-size", "0.07"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("bare.dng: no AprilTag"), "{said}");
}
