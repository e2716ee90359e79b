//! The main job over HTTP: the real daemon, libgphoto2, serial driver, firmware core and path-traced studio.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use unlit::pipeline::evaluate::evaluate;
use unlit::progress::Progress;
use unlit::session::Session;

const PATIENCE: Duration = Duration::from_secs(300);
const PAIRS: usize = 6;

/// The daemon in its own process; killed when dropped.
pub(crate) struct Daemon {
    process: Child,
    pub(crate) url: String,
}

impl Daemon {
    pub(crate) fn start(folder: &Path) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_unlit"))
            .args(["serve", "--studio", "--listen", "127.0.0.1:0", "--sessions"])
            .arg(folder.join("sessions"))
            .env("HOME", folder)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let at = line.find("http://").unwrap_or_else(|| panic!("no address in {line:?}"));
        let url = line[at..].split_whitespace().next().unwrap().trim_end_matches('/').to_owned();
        Self { process, url }
    }

    fn path(&self, path: &str) -> String {
        format!("{}/api/v1{path}", self.url)
    }

    pub(crate) fn get(&self, path: &str) -> Value {
        ureq::get(self.path(path)).call().unwrap().body_mut().read_json().unwrap()
    }

    fn post(&self, path: &str, body: Value) -> Value {
        ureq::post(self.path(path)).send_json(body).unwrap().body_mut().read_json().unwrap()
    }

    /// The bytes of a file of the session, asked for as its listing says.
    fn file(&self, name: &str) -> Vec<u8> {
        let files = self.get("/sessions/job/files");
        let named = files.as_array().unwrap().iter().find(|file| file["name"] == name);
        let url = format!("{}{}", self.url, named.unwrap()["url"].as_str().unwrap());
        ureq::get(url).call().unwrap().into_body().with_config().limit(1 << 28).read_to_vec().unwrap()
    }

    fn stage(&self, order: Value) {
        ureq::put(self.path("/studio/stage")).send_json(order).unwrap();
    }

    /// Waits for a job and gives its result.
    fn finished(&self, mut job: Value) -> Value {
        let path = job["url"].as_str().unwrap().trim_start_matches("/api/v1").to_owned();
        let deadline = Instant::now() + PATIENCE;
        while ["queued", "running"].contains(&job["state"].as_str().unwrap()) {
            assert!(Instant::now() < deadline, "{job}");
            std::thread::sleep(Duration::from_millis(50));
            job = self.get(&path);
        }
        assert_eq!(job["state"], "done", "{job}");
        job["result"].clone()
    }

    fn upload_scene(&self, geometry: &Path) -> Value {
        let form = ureq::unversioned::multipart::Form::new()
            .file("cameras", geometry.join("cameras.xml"))
            .unwrap()
            .file("mesh", geometry.join("object.obj"))
            .unwrap()
            .file("mesh", geometry.join("floor.obj"))
            .unwrap()
            .text("unit", "m");
        ureq::post(self.path("/sessions/job/scene")).send(form).unwrap().body_mut().read_json().unwrap()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.process.kill().ok();
        self.process.wait().ok();
    }
}

#[test]
fn pairs_posted_to_the_api_become_a_model_unaided() {
    let folder = tempfile::tempdir().unwrap();
    let studio = folder.path().join("studio");
    unlit::studio::truth::export(&studio, &Progress::silent()).unwrap();
    let daemon = Daemon::start(folder.path());
    daemon.post("/sessions", json!({ "name": "job" }));
    daemon.finished(daemon.upload_scene(&studio.join("geometry")));
    for distance in [0.7, 1.0, 1.4] {
        daemon.stage(json!({ "card_distance_m": distance }));
        let shot = daemon.post("/sessions/job/calibration/flash/shots", json!({ "distance_m": distance }));
        assert_eq!(daemon.finished(shot)["reasons"], json!([]));
    }
    let fit = json!({ "target_reflectance": 0.94, "ring_radii": [0.035, 0.085] });
    daemon.finished(daemon.post("/sessions/job/calibration/flash", fit));
    daemon.stage(json!({ "stop": 1 }));

    for number in 1..=PAIRS {
        let pair = daemon.finished(daemon.post("/pairs", json!({})));
        assert_eq!((&pair["verdict"], &pair["number"]), (&json!("accepted"), &json!(number)), "{pair}");
    }
    let deadline = Instant::now() + PATIENCE;
    let last = loop {
        let jobs = daemon.get("/jobs");
        let jobs = jobs.as_array().unwrap();
        let busy = |job: &Value| ["queued", "running"].contains(&job["state"].as_str().unwrap());
        if !jobs.iter().any(busy) {
            break jobs
                .iter()
                .find(|j| j["kind"] == "process")
                .cloned()
                .expect("no pair started its processing");
        }
        assert!(Instant::now() < deadline, "{jobs:?}");
        std::thread::sleep(Duration::from_millis(100));
    };
    assert_eq!(last["state"], "done", "{last}");
    assert_eq!(last["result"]["used"].as_array().unwrap().len(), PAIRS, "{last}");

    let glb = daemon.file("model/model.glb");
    let (document, _, images) = gltf::import_slice(&glb).unwrap();
    assert_eq!((document.meshes().count(), images.len()), (1, 1));

    the_flash_is_told(&daemon);

    // What came out is the truth that the studio was made from.
    drop(daemon);
    let session = Session::open(&folder.path().join("sessions/job")).unwrap();
    let score = evaluate(&session, &studio.join("truth"), &Progress::silent()).unwrap().texture.unwrap();
    println!("{:?}", score.full);
    println!("{:?}", score.blocks);
    assert!(score.by_view.len() >= PAIRS);
    let seen_by_the_cameras = score.by_view.iter().take(PAIRS);
    for view in seen_by_the_cameras {
        assert!(view.full.mean.abs() < 0.02 && view.full.standard_deviation < 0.08, "{view:?}");
    }
    a_pulse_of_more_energy_means_less_known_light(&session);
}

/// Proof, energies and repeatability over HTTP, and in the report.
fn the_flash_is_told(daemon: &Daemon) {
    daemon.stage(json!({ "card_distance_m": 1.0 }));
    let run = daemon.finished(daemon.post("/sessions/job/repeatability", json!({ "shots": 10 })));
    let figure = |of: &Value, name: &str| of[name].as_f64().unwrap_or_else(|| panic!("no {name} in {of}"));
    println!("{}", run["words"]);
    assert!(figure(&run, "corrected") < 0.5 * figure(&run, "spread"), "{run}");
    let account = daemon.get("/sessions/job/flash");
    assert_eq!((&account["pairs"], &account["proven"]), (&json!(PAIRS), &json!(PAIRS)), "{account}");
    assert_eq!(account["reference"]["source"], "calibration");
    assert_eq!(account["repeatability"]["shots"], 10);
    for pulse in account["pulses"].as_array().unwrap() {
        assert!((figure(pulse, "gain") - 1.0).abs() < 0.02 && figure(pulse, "deviation") < 0.002, "{pulse}");
    }
    daemon.finished(daemon.post("/sessions/job/process", json!({})));
    let report = String::from_utf8(daemon.file("model/report.html")).unwrap();
    for words in ["Divided by the measured energy", "divided out of the pairs", "Repeatability run"] {
        assert!(report.contains(words), "the report lacks {words:?}");
    }
}

/// Processing divides by the gain, and notices when it changes.
fn a_pulse_of_more_energy_means_less_known_light(session: &Session) {
    let known = |name: &str| {
        let file = session.path().join(format!("derived/views/{name}/known.exr"));
        let image = unlit::codec::exr_image::read(&file).unwrap().rgb().unwrap();
        image.pixels().iter().map(|p| f64::from(p[1])).sum::<f64>()
    };
    let views = || unlit::pipeline::views::ensure(session, &Progress::silent()).unwrap();
    views();
    let gain = |name: &str| unlit::pipeline::process::stored(session).unwrap().gains[name].value;
    let before = ["0001", "0002"].map(|name| (known(name), gain(name)));
    let file = session.pair_dir(1).join("pair.json");
    let mut record: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let energy = &mut record["flash"]["on"][0]["energy_counts"];
    *energy = json!(1.25 * energy.as_f64().unwrap());
    std::fs::write(&file, record.to_string()).unwrap();
    views();
    let after = ["0001", "0002"].map(|name| (known(name), gain(name)));
    for ((before, after), measured) in before.into_iter().zip(after).zip([1.25, 1.0]) {
        let taken = before.0 / after.0;
        assert!((taken / (after.1 / before.1) - 1.0).abs() < 1e-4, "{before:?} {after:?}");
        // The photographs have a small say beside the measurement.
        assert!((taken - measured).abs() < 2e-3, "{before:?} {after:?}");
    }
}

#[test]
fn pairs_shot_from_the_terminal_are_kept_with_what_the_flash_did() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk");
    let output = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(["shoot", "--studio", "--pairs", "2"])
        .arg(&path)
        .env("HOME", folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let session = Session::open(&path).unwrap();
    let pairs = session.pairs().unwrap();
    assert_eq!(pairs.len(), 2);
    for pair in pairs {
        assert_eq!(pair.verdict, unlit::pair::Verdict::Accepted);
        let flash = pair.flash.clone().unwrap();
        assert_eq!((flash.pulses_off(), flash.pulses_on()), (0, 1));
        assert!(session.verify_pair(pair.number).is_empty());
    }
}
