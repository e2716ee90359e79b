//! Noise and linearity by the program itself, on files of a simulated camera whose truth is known.

use crate::calibrate_levels::{file, json, session, truth};

#[test]
fn gain_read_noise_and_linearity_of_the_bird_baths_camera_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let mut arguments: Vec<String> = ["calibrate", "noise", &session].map(String::from).into();
    // In any order.
    for k in (0..14).rev() {
        arguments.extend((0..2).map(|r| file(&format!("calibration/linearity/{k:02}_{r}.dng"))));
    }
    arguments.extend(["--stops", "0.75", "--json", "--dark"].map(String::from));
    arguments.extend((0..4).map(|i| file(&format!("calibration/dark/{i}.dng"))));
    let record = json(&arguments);
    let sensor = &truth()["sensor"];
    let noise = &record["noise"][0];
    println!("{}", record["verdict"]);
    let off = |name: &str| noise[name].as_f64().unwrap() / sensor[name].as_f64().unwrap() - 1.0;
    println!("electrons per DN off by {}, read noise by {}", off("electrons_per_dn"), off("read_noise_e"));
    assert!(off("electrons_per_dn").abs() < 0.02);
    assert!(off("read_noise_e").abs() < 0.08);
    assert_eq!((noise["pairs"].as_u64(), noise["dark_pairs"].as_u64()), (Some(14), Some(2)));
    let linearity = &noise["linearity"];
    assert!(linearity["linearity_error"].as_f64().unwrap() < 0.005, "{linearity}");
    assert!(linearity.get("knee_dn").is_none(), "{linearity}");
    assert_eq!(record["verdict"]["good"], true);
}
