//! Calibrations over HTTP: every kind from files sent in and from frames shot, waiting shots that survive, refusals.

use crate::api::{House, agent, answer};
use crate::calibrate_levels::{file, truth};
use crate::daemon::Daemon;
use crate::fake_rig::{Room, Trouble};
use crate::raw::sample;
use serde_json::{Value, json};
use unlit::capture::FlashKind;
use unlit::session::Session;

/// A form of texts and files.
fn form(texts: &[(&str, &str)], files: &[(&str, String)]) -> Vec<u8> {
    let mut body = vec![];
    for (name, text) in texts {
        let head = format!("--cut\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{text}\r\n");
        body.extend(head.as_bytes());
    }
    for (name, path) in files {
        let plain = path.rsplit('/').next().unwrap();
        let head = format!("form-data; name=\"{name}\"; filename=\"{plain}\"");
        body.extend(format!("--cut\r\nContent-Disposition: {head}\r\n\r\n").as_bytes());
        body.extend(std::fs::read(path).unwrap());
        body.extend(b"\r\n");
    }
    body.extend(b"--cut--\r\n");
    body
}

fn send(url: &str, texts: &[(&str, &str)], files: &[(&str, String)]) -> (u16, Value) {
    let request = agent().post(url).header("Content-Type", "multipart/form-data; boundary=cut");
    answer(request.send(&form(texts, files)[..]).unwrap())
}

fn lit(paths: impl IntoIterator<Item = String>) -> Vec<(&'static str, String)> {
    paths.into_iter().map(|path| ("file", file(&path))).collect()
}

/// A house with a session.
fn house() -> House {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "bath" }));
    house
}

const AT: &str = "/api/v1/sessions/bath/calibration";

impl House {
    fn calibration(&self, kind: &str) -> Value {
        let (status, all) = self.get(AT);
        assert_eq!(status, 200, "{all}");
        all.as_array().unwrap().iter().find(|one| one["kind"] == kind).unwrap().clone()
    }

    fn fit(&self, kind: &str, order: &Value) -> Value {
        let (status, job) = self.post(&format!("{AT}/{kind}"), order);
        assert_eq!(status, 202, "{job}");
        let ended = self.ended(&job);
        assert_eq!(
            (&ended["state"], &ended["kind"]),
            (&json!("done"), &json!(format!("calibrate_{kind}"))),
            "{ended}"
        );
        ended["result"].clone()
    }

    fn remove(&self, path: &str) -> u16 {
        agent().delete(self.url(path)).call().unwrap().status().as_u16()
    }
}

#[test]
fn levels_from_files_sent_in_wait_are_fitted_and_become_the_records() {
    let house = house();
    let shots = house.url(&format!("{AT}/levels/shots"));
    let before = house.calibration("levels");
    assert!(
        before["measured"].is_null() && before["guide"]["steps"][1].as_str().unwrap().contains("lens cap")
    );
    assert_eq!(house.get(&format!("{AT}/levels")).1["code"], "calibration_not_measured");
    assert_eq!(house.post_nothing(&format!("{AT}/levels")).1["code"], "inputs_missing");

    let dark = lit((0..2).map(|i| format!("calibration/dark/{i}.dng")));
    let (status, kept) = send(&shots, &[("role", "dark")], &dark);
    assert_eq!(
        (status, kept[1]["id"].as_str(), kept[1]["role"].as_str()),
        (201, Some("2"), Some("dark")),
        "{kept}"
    );
    assert!(kept[0]["mean_share"].as_f64().unwrap().abs() < 1e-3, "{kept}");
    // The same again is the one that is there; as something else it is refused.
    assert_eq!(send(&shots, &[("role", "dark")], &dark).1, kept);
    assert_eq!(send(&shots, &[("role", "blown")], &dark).1["code"], "shot_twice");
    send(&shots, &[("role", "dark")], &lit(["calibration/dark/2.dng".into()]));
    let blown = lit((0..2).map(|i| format!("calibration/linearity/13_{i}.dng")));
    send(&shots, &[("role", "blown")], &blown);
    let waiting = house.calibration("levels")["shots"].clone();
    assert_eq!(waiting.as_array().unwrap().len(), 5);
    assert!(waiting[4]["clipped_share"].as_f64().unwrap() > 0.9, "{waiting}");
    let raw =
        agent().get(house.url(waiting[0]["url"].as_str().unwrap())).call().unwrap().body_mut().read_to_vec();
    assert_eq!(raw.unwrap(), std::fs::read(&dark[0].1).unwrap());
    assert_eq!(house.remove(&format!("{AT}/levels/shots/3")), 204);
    assert_eq!(house.remove(&format!("{AT}/levels/shots/3")), 404);

    let record = house.fit("levels", &json!({}));
    let black = record["levels"][0]["sites"][0]["black_dn"].as_f64().unwrap();
    assert!((black - truth()["sensor"]["black_dn"].as_f64().unwrap()).abs() < 0.05, "{black}");
    assert_eq!(house.get(&format!("{AT}/levels")), (200, record.clone()));
    let after = house.calibration("levels");
    assert_eq!(after["shots"], json!([]), "they are the record's now");
    let measured = &after["measured"];
    assert_eq!((&measured["good"], &measured["shots"]), (&json!(true), &json!(4)));
    assert_eq!(
        (&measured["validity"]["isos"], &measured["validity"]["lens"]),
        (&json!([100.0]), &Value::Null)
    );
    for shot in record["shots"].as_array().unwrap() {
        let path = shot["file"].as_str().unwrap();
        assert!(
            path.starts_with("calibration/levels/") && house.session("bath").join(path).is_file(),
            "{path}"
        );
    }
    let figure = measured["files"].as_array().unwrap().iter().find(|f| f["name"] == "levels.svg").unwrap();
    let svg =
        agent().get(house.url(figure["url"].as_str().unwrap())).call().unwrap().body_mut().read_to_string();
    assert!(svg.unwrap().contains("<svg"));
}

#[test]
fn shots_wait_over_a_restart_and_a_shot_that_was_not_finished_does_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let house = House::open_in(folder, Room::default().rig(), None, 8);
    house.post("/api/v1/sessions", &json!({ "name": "bath" }));
    send(&house.url(&format!("{AT}/flat/shots")), &[], &lit(["calibration/linearity/05_0.dng".into()]));
    let flat = house.session("bath").join("calibration/waiting/flat");
    std::fs::create_dir(flat.join("0002")).unwrap();
    std::fs::create_dir(flat.join(".tmp-9")).unwrap();
    let before = house.calibration("flat");
    assert_eq!(before["shots"][0]["exposure"], "1/60 s, f/16, ISO 100");
    let copy = tempfile::tempdir().unwrap();
    let copied = std::process::Command::new("cp")
        .arg("-a")
        .args([&house.folder.path().join("sessions"), copy.path()])
        .status();
    assert!(copied.unwrap().success());
    drop(house);
    let house = House::open_in(copy, Room::default().rig(), None, 8);
    assert_eq!(house.calibration("flat"), before);
    let (_, next) =
        send(&house.url(&format!("{AT}/flat/shots")), &[], &lit(["calibration/linearity/05_1.dng".into()]));
    assert_eq!(next[0]["id"], "2", "{next}");
    // Opening it for writing has tidied up.
    assert!(!house.session("bath").join("calibration/waiting/flat/.tmp-9").exists());
}

#[test]
fn exposure_flat_noise_and_colour_are_fitted_from_files_sent_in() {
    let house = house();
    let shots = |kind: &str| house.url(&format!("{AT}/{kind}/shots"));
    for dial in ["iso", "shutter", "aperture"] {
        let ladder = lit((0..19).map(|k| format!("calibration/exposure/{dial}_{k:02}.dng")));
        assert_eq!(send(&shots("exposure"), &[("role", "step")], &ladder).0, 201);
    }
    let record = house.fit("exposure", &json!({}));
    assert_eq!(record["ladders"].as_array().unwrap().len(), 3);
    assert!(
        house.calibration("exposure")["measured"]["validity"]["words"].as_str().unwrap().contains("Bayer")
    );

    let even = |levels: std::ops::Range<usize>| {
        lit(levels.flat_map(|k| [0, 1].map(|i| format!("calibration/linearity/{k:02}_{i}.dng"))))
    };
    send(&shots("flat"), &[], &even(4..8));
    assert!(house.fit("flat", &json!({}))["vignetting"].is_object());
    send(&shots("noise"), &[("role", "even")], &even(0..14));
    send(&shots("noise"), &[("role", "dark")], &lit((0..2).map(|i| format!("calibration/dark/{i}.dng"))));
    let gain =
        house.fit("noise", &json!({ "stops": null }))["noise"][0]["electrons_per_dn"].as_f64().unwrap();
    assert!((gain / truth()["sensor"]["electrons_per_dn"].as_f64().unwrap() - 1.0).abs() < 0.02, "{gain}");

    let chart = ("file", sample("tinydng_colorchart.dng").display().to_string());
    send(&shots("colour"), &[("role", "chart")], &[chart]);
    let record = house.fit("colour", &json!({ "chart": "colorchecker24_before2014" }));
    assert!(record["fit"]["mean"].as_f64().unwrap() <= 3.0, "{}", record["fit"]);
    let files = house.calibration("colour")["measured"]["files"].clone();
    let names: Vec<&str> = files.as_array().unwrap().iter().map(|f| f["name"].as_str().unwrap()).collect();
    assert_eq!(names[..3], ["colour.json", "colour.svg", "colour.png"]);
}

#[test]
fn frames_are_shot_without_flash_and_the_chart_with_it() {
    let room = Room::default();
    let house = House::open(room.rig());
    house.post("/api/v1/sessions", &json!({ "name": "bath" }));
    let shoot = |kind: &str, order: Value| {
        let (status, job) = house.post(&format!("{AT}/{kind}/shots"), &order);
        assert_eq!(status, 202, "{job}");
        let ended = house.ended(&job);
        assert_eq!(ended["state"], "done", "{ended}");
        ended["result"].clone()
    };
    let frame = shoot("levels", json!({ "role": "dark" }));
    assert_eq!((&frame["shot"], &frame["kind"]), (&json!("1"), &json!("levels")));
    assert!(!room.log().contains(&"arm"), "{:?}", room.log());
    let order = json!({ "role": "even", "exposure": { "shutter_s": 0.0333, "aperture": 8, "iso": 100 } });
    shoot("noise", order);
    let told = &house.calibration("noise")["shots"][0];
    assert_eq!(told["exposure"], "1/30 s, f/8, ISO 100", "{told}");
    assert_eq!(house.get("/api/v1/camera").1["exposure"]["aperture"], 11.0, "the dials are back");
    shoot("colour", json!({ "role": "chart" }));
    assert!(room.log().contains(&"arm") && !room.is_armed(), "{:?}", room.log());
    shoot("flash", json!({ "distance_m": 1.25 }));
    let card = house.calibration("flash")["shots"][0].clone();
    assert_eq!((&card["id"], &card["role"]), (&json!("d01250_1"), &json!("card")));
    assert_eq!(house.remove(&format!("{AT}/flash/shots/d01250_1")), 204);
    assert_eq!(house.calibration("flash")["shots"], json!([]));
    let path = house.session("bath");
    assert!(house.desk.close(crate::api::PATIENCE));
    let folder = tempfile::tempdir().unwrap();
    let copied = std::process::Command::new("cp").arg("-a").args([&path, folder.path()]).status();
    assert!(copied.unwrap().success());
    let whole = Session::open(&folder.path().join("bath")).unwrap();
    let found = whole.verify(&unlit::progress::Progress::silent()).unwrap();
    assert!(found.is_whole(), "a card shot that was removed on request is not missing: {found:?}");

    // Without any flash, frames in steady light are taken all the same; a flash by hand asks for nothing.
    for rig in [Room::default().rig_with(|| FlashKind::None), Room::default().rig_with(|| FlashKind::Manual)]
    {
        let house = House::open(rig);
        house.post("/api/v1/sessions", &json!({ "name": "bath" }));
        let (_, job) = house.post(&format!("{AT}/exposure/shots"), &json!({}));
        assert_eq!(house.ended(&job)["state"], "done");
    }
    let house = House::open(Room::with(Trouble::NoContact).rig());
    house.post("/api/v1/sessions", &json!({ "name": "bath" }));
    let (_, job) = house.post(&format!("{AT}/colour/shots"), &json!({ "role": "chart" }));
    assert_eq!(house.ended(&job)["problem"]["code"], "flash_misfired");
}

#[test]
fn what_is_missing_and_what_is_wrong_with_a_shot_is_told() {
    let house = house();
    let [flat, levels] = ["flat", "levels"].map(|kind| house.url(&format!("{AT}/{kind}/shots")));
    assert_eq!(house.calibration("flat")["lacks"], json!(["5 even frames."]));
    send(
        &flat,
        &[],
        &lit(["calibration/linearity/10_0.dng".into(), "calibration/linearity/13_0.dng".into()]),
    );
    let state = house.calibration("flat");
    let faults: Vec<&Value> = state["shots"].as_array().unwrap().iter().map(|shot| &shot["fault"]).collect();
    assert!(faults[0].is_null() && faults[1].as_str().unwrap().starts_with("Over-exposed"), "{state}");
    let take = &state["guide"]["takes"][0];
    assert_eq!((&take["wanted"], &take["taken"]), (&json!(5), &json!(1)), "{take}");
    assert_eq!(state["lacks"], json!(["4 more even frames."]));
    // What is thrown away is no fault any more.
    assert_eq!(house.remove(&format!("{AT}/flat/shots/2")), 204);
    assert_eq!(house.calibration("flat")["shots"].as_array().unwrap().len(), 1);
    send(&levels, &[("role", "dark")], &lit(["calibration/linearity/05_0.dng".into()]));
    let shot = house.calibration("levels")["shots"][0].clone();
    assert!(shot["fault"].as_str().unwrap().contains("lens cap"), "{shot}");
}

#[test]
fn the_flashs_repeatability_is_shot_in_one_go_and_fitted() {
    let house = house();
    let shoot = |order: Value| {
        let (status, job) = house.post(&format!("{AT}/steadiness/shots"), &order);
        assert_eq!(status, 202, "{job}");
        let ended = house.ended(&job);
        assert_eq!(ended["state"], "done", "{ended}");
    };
    shoot(json!({ "count": 3 }));
    let state = house.calibration("steadiness");
    assert_eq!(state["shots"].as_array().unwrap().len(), 3, "{state}");
    assert!(state["shots"].as_array().unwrap().iter().all(|shot| shot["role"] == "lit"), "{state}");
    assert_eq!(state["guide"]["takes"][0]["wanted"], 40);
    for n in ["1", "2", "3"] {
        assert_eq!(house.remove(&format!("{AT}/steadiness/shots/{n}")), 204);
    }
    let frames = lit((0..10).map(|i| format!("calibration/repeat/{i:02}.dng")));
    assert_eq!(send(&house.url(&format!("{AT}/steadiness/shots")), &[], &frames).0, 201);
    let record = house.fit("steadiness", &json!({}));
    assert_eq!(record["frames"].as_array().unwrap().len(), 10, "{}", record["verdict"]);
    assert_eq!(house.get(&format!("{AT}/steadiness")).1, record);
    assert!(house.session("bath").join("calibration/steadiness.json").is_file());
}

#[test]
fn shots_keep_the_polariser_and_the_power_of_their_time() {
    let house = house();
    let tell = |lighting: Value| {
        let (status, problem) = house.put("/api/v1/sessions/bath/lighting", &lighting);
        assert_eq!(status, 204, "{problem}");
    };
    let send_flat = |range: std::ops::Range<usize>| {
        let frames = lit(range.map(|k| format!("calibration/linearity/{k:02}_0.dng")));
        assert_eq!(send(&house.url(&format!("{AT}/flat/shots")), &[], &frames).0, 201);
    };
    let wrong = house.put("/api/v1/sessions/bath/lighting", &json!({ "flash_power": 3 }));
    assert_eq!((wrong.0, wrong.1["code"].as_str()), (400, Some("value_invalid")));
    tell(json!({ "polariser": { "angle_degrees": 30 }, "flash_power": 0.25 }));
    assert_eq!(house.get("/api/v1/sessions/bath").1["lighting"]["flash_power"], 0.25);
    send_flat(4..6);
    tell(json!({}));
    assert!(house.fit("flat", &json!({}))["rig"]["lighting"]["polariser"]["angle_degrees"] == 30.0);
    let validity = house.calibration("flat")["measured"]["validity"].clone();
    assert!(validity["words"].as_str().unwrap().contains("polariser at 30 degrees"), "{validity}");
    assert_eq!(validity["lighting"]["polariser"]["angle_degrees"], 30.0);

    // Shots with and without it make no series.
    send_flat(4..5);
    tell(json!({ "polariser": {} }));
    send_flat(5..6);
    let (_, job) = house.post(&format!("{AT}/flat"), &json!({}));
    let ended = house.ended(&job);
    let words = ended["problem"]["words"].as_str().unwrap();
    assert!(words.contains("polariser") && words.contains("none"), "{ended}");
}

#[test]
fn what_makes_no_sense_is_refused_with_a_sentence() {
    let house = house();
    for (path, order, status, code) in [
        ("levels/shots", json!({}), 400, "value_invalid"),
        ("levels/shots", json!({ "role": "chart" }), 400, "value_invalid"),
        ("levels/shots", json!({ "role": "bright" }), 422, "body_invalid"),
        ("levels/shots", json!({ "role": "dark", "distance_m": 1 }), 400, "value_invalid"),
        ("flash/shots", json!({}), 400, "value_invalid"),
        (
            "flash/shots",
            json!({ "distance_m": 1, "exposure": { "shutter_s": 1, "aperture": 8, "iso": 100 } }),
            400,
            "value_invalid",
        ),
        ("saturation/shots", json!({}), 400, "path_invalid"),
        ("flat", json!({ "stops": 1 }), 400, "value_invalid"),
        ("flat", json!({ "frames": 3 }), 422, "body_invalid"),
        ("noise", json!({ "stops": -1 }), 400, "value_invalid"),
        ("flash", json!({ "target_reflectance": 0.9 }), 400, "value_invalid"),
        ("flash", json!({ "ring_radii": [0.035, 0.085], "tag_size_m": -1 }), 400, "value_invalid"),
        ("flash", json!({ "one_shot": "d01000_1" }), 400, "value_invalid"),
        ("flat", json!({ "lighting": { "flash_power": 0.5 } }), 400, "value_invalid"),
        ("steadiness/shots", json!({ "count": 0 }), 400, "value_invalid"),
        ("steadiness/shots", json!({ "count": 1000 }), 400, "value_invalid"),
        ("steadiness", json!({}), 409, "inputs_missing"),
        ("colour", json!({ "chart": "rainbow" }), 422, "body_invalid"),
        ("colour", json!({}), 409, "inputs_missing"),
    ] {
        let (now, problem) = house.post(&format!("{AT}/{path}"), &order);
        assert_eq!((now, problem["code"].as_str()), (status, Some(code)), "{path} {order}: {problem}");
    }
    let card = lit(["calibration/white/d0800_0.dng".into()]);
    let text = || vec![("file", format!("{}/Cargo.toml", env!("CARGO_MANIFEST_DIR")))];
    for (kind, texts, files, status, code) in [
        ("flash", vec![("distance_m", "-1")], card.clone(), 400, "value_invalid"),
        ("flash", vec![("distance_m", "near")], card.clone(), 400, "value_invalid"),
        ("flat", vec![("distance_m", "1")], card.clone(), 400, "value_invalid"),
        ("flat", vec![("role", "bright")], card.clone(), 400, "value_invalid"),
        ("flat", vec![("colour", "red")], card, 400, "body_invalid"),
        ("flat", vec![], vec![], 400, "body_invalid"),
        ("flat", vec![], text(), 422, "frame_unreadable"),
    ] {
        let (now, problem) = send(&house.url(&format!("{AT}/{kind}/shots")), &texts, &files);
        assert_eq!((now, problem["code"].as_str()), (status, Some(code)), "{kind} {texts:?}: {problem}");
    }
    assert_eq!(house.remove(&format!("{AT}/flash/shots/d01000_1")), 404);
    assert_eq!(house.get("/api/v1/sessions/none/calibration").1["code"], "session_not_found");
}

#[test]
fn the_daemon_fits_levels_from_its_studio_and_the_flash_from_files() {
    let home = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(home.path());
    let client = daemon.client();
    client.post("/sessions", json!({ "name": "bath" })).unwrap();
    client.stage(json!({ "lens_cap": true })).unwrap();
    let at = "/sessions/bath/calibration";
    for _ in 0..2 {
        client.done(client.post(&format!("{at}/levels/shots"), json!({ "role": "dark" })).unwrap());
    }
    let record = client.done(client.post(&format!("{at}/levels"), json!({})).unwrap());
    let black = record["levels"][0]["sites"][0]["black_dn"].as_f64().unwrap();
    assert!((black - 2048.0).abs() < 0.1, "{record}");

    // Raws of another body have a session of their own: levels of the studio's are refused for them.
    let at = at.replace("bath", "bird");
    client.post("/sessions", json!({ "name": "bird" })).unwrap();
    let shots = format!("{}/api/v1{at}/flash/shots", daemon.url);
    for (distance, stem) in [("0.8", "d0800"), ("1.0", "d1000"), ("1.3", "d1300"), ("1.7", "d1700")] {
        for i in 0..3 {
            let card = lit([format!("calibration/white/{stem}_{i}.dng")]);
            assert_eq!(send(&shots, &[("distance_m", distance)], &card).0, 201);
        }
    }
    let focal = truth()["intrinsics"]["fx"].as_f64().unwrap();
    let order = json!({ "target_reflectance": 0.94, "ring_radii": [0.035, 0.085], "focal_px": focal, "held_out": ["2"] });
    let record = client.done(client.post(&format!("{at}/flash"), order).unwrap());
    let cards = record["cards"].as_array().unwrap();
    assert_eq!((cards.len(), &cards[1]["held_out"]), (12, &json!(true)));
    assert_eq!(cards[0]["label"], "d0800_0.dng");
    daemon.stop();
}

#[test]
fn the_guide_is_the_same_in_the_terminal() {
    let run = |arguments: &[&str]| {
        let output =
            std::process::Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
        (output.status.success(), String::from_utf8(output.stdout).unwrap())
    };
    let house = house();
    let (good, all) = run(&["calibrate", "guide"]);
    assert!(good);
    for one in house.get(AT).1.as_array().unwrap() {
        let guide = &one["guide"];
        for step in guide["steps"].as_array().unwrap() {
            assert!(all.contains(step.as_str().unwrap()), "{step}");
        }
        let (good, text) = run(&["calibrate", "guide", one["kind"].as_str().unwrap()]);
        assert!(good && text.starts_with(guide["title"].as_str().unwrap()) && all.contains(&text), "{text}");
    }
    assert!(!run(&["calibrate", "guide", "saturation"]).0);
}
