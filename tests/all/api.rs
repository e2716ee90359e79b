//! The API over real HTTP, with a rig without wires and processing that the tests hold in their hands.

use crate::fake_rig::{Room, Trouble};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use unlit::capture::{Desk, Engine, Events, FlashKind, RigSource, Works};
use unlit::http::{self, Door, StageOrder, StudioBody, StudioControl};
use unlit::jobs::WorkError;
use unlit::pair::Limits;
use unlit::pipeline::calibrate::guided;
use unlit::session::Session;

pub(crate) const PATIENCE: Duration = Duration::from_secs(20);

/// A daemon on a port of its own, its folder, and how often its processing ran.
pub(crate) struct House {
    pub(crate) folder: TempDir,
    pub(crate) port: u16,
    pub(crate) desk: Desk,
    processed: Arc<AtomicU32>,
    stop: Option<oneshot::Sender<()>>,
    runtime: Option<tokio::runtime::Runtime>,
    served: Option<tokio::task::JoinHandle<std::io::Result<()>>>,
}

/// Works that leave marks in the session, as the real ones do.
pub(crate) fn marking_works(processed: &Arc<AtomicU32>) -> Works {
    let processed = processed.clone();
    let fail = |e: std::io::Error| WorkError::failed("disk", e);
    Works {
        process: Arc::new(move |session, (), progress| {
            progress.check()?;
            progress.report("solving", 1, 2);
            std::fs::write(session.model_dir().join("model.glb"), b"glTF").map_err(fail)?;
            processed.fetch_add(1, Ordering::SeqCst);
            Ok(json!({}))
        }),
        calibrate_flash: Arc::new(move |session, card, _| {
            std::fs::write(session.calibration_dir().join("flash.json"), b"{}").map_err(fail)?;
            Ok(json!({ "shots": card.shots.len(), "ring_radii": card.order.ring_radii }))
        }),
        calibrate: Arc::new(|session, order, progress| {
            guided::fit(session, &order, progress).map_err(|e| WorkError::failed("calibration_failed", e))
        }),
        import_scene: Arc::new(move |session, files, _| {
            let read = |p: &PathBuf| std::fs::read_to_string(p).map_err(fail);
            std::fs::write(session.scene_dir().join("scene.json"), b"{}").map_err(fail)?;
            let meshes = files.meshes.iter().map(read).collect::<Result<Vec<_>, _>>()?;
            Ok(
                json!({ "cameras": read(&files.cameras)?, "meshes": meshes, "unit": files.unit, "scale": files.scale }),
            )
        }),
        has_scene: Arc::new(|session| session.scene_dir().join("scene.json").is_file()),
        has_flash_calibration: Arc::new(|session| session.calibration_dir().join("flash.json").is_file()),
        needs_processing: Arc::new(|session| !session.model_dir().join("model.glb").is_file()),
    }
}

impl House {
    pub(crate) fn open(rig: RigSource) -> Self {
        Self::open_with(rig, None)
    }

    fn open_with(rig: RigSource, studio: Option<Arc<dyn StudioControl>>) -> Self {
        Self::open_narrow(rig, studio, 64)
    }

    /// So many threads may wait for disk and devices.
    pub(crate) fn open_narrow(
        rig: RigSource,
        studio: Option<Arc<dyn StudioControl>>,
        threads: usize,
    ) -> Self {
        Self::open_in(tempfile::tempdir().unwrap(), rig, studio, threads)
    }

    /// In a folder that may hold what another house left.
    pub(crate) fn open_in(
        folder: TempDir,
        rig: RigSource,
        studio: Option<Arc<dyn StudioControl>>,
        threads: usize,
    ) -> Self {
        let events = Events::default();
        let engine = Arc::new(Engine::new(rig, Limits::default(), events.clone()));
        let processed = Arc::default();
        let works = marking_works(&processed);
        let desk = Desk::open(engine, events, &folder.path().join("sessions"), works, None).unwrap();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .max_blocking_threads(threads)
            .enable_all()
            .build()
            .unwrap();
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
        let port = listener.local_addr().unwrap().port();
        let (stop, stopped) = oneshot::channel::<()>();
        let served =
            runtime.spawn(http::serve(listener, desk.clone(), studio, Door::default(), async move {
                let _dropped = stopped.await;
            }));
        let (stop, runtime, served) = (Some(stop), Some(runtime), Some(served));
        Self { folder, port, desk, processed, stop, runtime, served }
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.port)
    }

    pub(crate) fn session(&self, name: &str) -> PathBuf {
        self.folder.path().join("sessions").join(name)
    }

    pub(crate) fn get(&self, path: &str) -> (u16, Value) {
        answer(agent().get(self.url(path)).call().unwrap())
    }

    pub(crate) fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        answer(agent().post(self.url(path)).send_json(body).unwrap())
    }

    pub(crate) fn put(&self, path: &str, body: &Value) -> (u16, Value) {
        answer(agent().put(self.url(path)).send_json(body).unwrap())
    }

    pub(crate) fn post_nothing(&self, path: &str) -> (u16, Value) {
        answer(agent().post(self.url(path)).send_empty().unwrap())
    }

    /// The job once it has ended.
    pub(crate) fn ended(&self, job: &Value) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            let (_, now) = self.get(job["url"].as_str().unwrap());
            if matches!(now["state"].as_str(), Some("done" | "failed" | "cancelled")) {
                return now;
            }
            assert!(Instant::now() < end, "{now}");
            std::thread::yield_now();
        }
    }

    pub(crate) fn take_pair(&self) -> Value {
        let (status, job) = self.post_nothing("/api/v1/pairs?wait=true");
        assert_eq!((status, job["state"].as_str()), (200, Some("done")), "{job}");
        job["result"].clone()
    }

    fn import_scene(&self, session: &str) -> (u16, Value) {
        let part = |name: &str, file: &str, text: &str| {
            let head = format!("Content-Disposition: form-data; name=\"{name}\"");
            let file = if file.is_empty() { String::new() } else { format!("; filename=\"{file}\"") };
            format!("--cut\r\n{head}{file}\r\n\r\n{text}\r\n")
        };
        let body = [
            part("cameras", "cameras.xml", "<cameras/>"),
            part("mesh", "object.obj", "v 0 0 0"),
            part("mesh", "object.obj", "v 1 1 1"),
            part("unit", "", "cm"),
            part("scale", "", "2.5"),
            "--cut--\r\n".into(),
        ]
        .concat();
        let request = agent()
            .post(self.url(&format!("/api/v1/sessions/{session}/scene")))
            .header("Content-Type", "multipart/form-data; boundary=cut");
        answer(request.send(body).unwrap())
    }
}

impl Drop for House {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let (Some(runtime), Some(served)) = (self.runtime.take(), self.served.take()) {
            let ended = runtime.block_on(async { tokio::time::timeout(PATIENCE, served).await });
            runtime.shutdown_background();
            if !std::thread::panicking() {
                ended.expect("the daemon did not stop").unwrap().unwrap();
            }
        }
    }
}

pub(crate) fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build().into()
}

pub(crate) fn answer(mut response: ureq::http::Response<ureq::Body>) -> (u16, Value) {
    let text = response.body_mut().read_to_string().unwrap();
    (response.status().as_u16(), serde_json::from_str(&text).unwrap_or(Value::String(text)))
}

#[test]
fn an_empty_post_right_after_the_start_takes_a_pair() {
    let house = House::open(Room::default().rig());
    let mut response = agent().post(house.url("/api/v1/pairs")).send_empty().unwrap();
    assert_eq!(response.status(), 202);
    let location = response.headers()["location"].to_str().unwrap().to_owned();
    let job: Value = response.body_mut().read_json().unwrap();
    assert_eq!(job["url"], location);
    let job = house.ended(&job);
    assert_eq!(job["result"]["verdict"], "accepted", "{job}");
    let day = job["session"].as_str().unwrap();
    assert!(day.len() == 10 && day.starts_with("20"), "{day}");

    let (_, pairs) = house.get(&format!("/api/v1/sessions/{day}/pairs"));
    assert_eq!(pairs[0]["number"], 1);
    let mut original = agent().get(house.url(pairs[0]["off"]["url"].as_str().unwrap())).call().unwrap();
    let bytes = original.body_mut().read_to_vec().unwrap();
    assert_eq!(bytes, std::fs::read(house.session(day).join("pairs/0001/off.dng")).unwrap());
    for frame in ["off", "on"] {
        let thumbnail = pairs[0][frame]["thumbnail"].as_str().unwrap();
        let mut jpeg = agent().get(house.url(thumbnail)).call().unwrap();
        assert_eq!(jpeg.headers()["content-type"], "image/jpeg");
        assert!(jpeg.body_mut().read_to_vec().unwrap().starts_with(&[0xff, 0xd8]));
    }
}

#[test]
fn a_rejected_pair_is_shot_again_in_the_order_that_is_wished() {
    let house = House::open(Room::with(Trouble::CutsFile(0)).rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let take = |body: Value| {
        let (status, job) = house.post("/api/v1/pairs?wait=true", &body);
        assert_eq!(status, 200, "{job}");
        job["result"].clone()
    };
    let first = take(json!({ "order": "off_on_off", "off_frames": 2 }));
    assert_eq!(
        (&first["number"], &first["attempt"], &first["verdict"]),
        (&1.into(), &1.into(), &"rejected".into())
    );
    let second = take(json!({ "again": 1 }));
    assert_eq!(
        (&second["number"], &second["attempt"], &second["verdict"]),
        (&1.into(), &2.into(), &"accepted".into())
    );

    let (_, pairs) = house.get("/api/v1/sessions/vase/pairs");
    assert_eq!(pairs.as_array().unwrap().len(), 1);
    let pair = &pairs[0];
    assert_eq!((&pair["order"], &pair["attempt"]), (&"off_on_off".into(), &2.into()));
    assert_eq!(pair["attempts"][0]["verdict"], "rejected");
    assert_eq!(pair["attempts"][0]["reasons"][0]["code"], "truncated");
    assert_eq!((pair["more_off"].as_array().unwrap().len(), pair["after"].as_array().unwrap().len()), (1, 2));
    let drift = pair["drift"]["ambient"][1].as_f64().unwrap();
    assert!((drift - 1.0).abs() < 0.01, "{pair}");
    let after = &pair["after"][1];
    let mut original = agent().get(house.url(after["url"].as_str().unwrap())).call().unwrap();
    let bytes = original.body_mut().read_to_vec().unwrap();
    assert_eq!(bytes, std::fs::read(house.session("vase").join("pairs/0001-2/after-2.dng")).unwrap());
    let thumbnail = agent().get(house.url(after["thumbnail"].as_str().unwrap())).call().unwrap();
    assert_eq!(thumbnail.headers()["content-type"], "image/jpeg");

    for (body, status, code) in [
        (json!({ "again": 1 }), 409, "pair_accepted"),
        (json!({ "again": 7 }), 404, "pair_not_found"),
        (json!({ "off_frames": 0 }), 400, "order_invalid"),
        (json!({ "off_frames": 17 }), 400, "order_invalid"),
        (json!({ "order": "on_on" }), 422, "body_invalid"),
    ] {
        let (found, problem) = house.post("/api/v1/pairs", &body);
        assert_eq!((found, problem["code"].as_str()), (status, Some(code)), "{body}: {problem}");
    }
    let (status, problem) = house.get("/api/v1/sessions/vase/pairs/1/after-3/thumbnail.jpg");
    assert_eq!((status, problem["code"].as_str()), (404, Some("frame_not_found")), "{problem}");
    assert_eq!(house.get("/api/v1/sessions/vase/pairs/1/sideways/thumbnail.jpg").0, 400);
    assert_eq!(house.take_pair()["number"], 2, "what is shot again spends no number");
}

#[test]
fn sessions_are_made_entered_and_listed() {
    let house = House::open(Room::default().rig());
    assert_eq!(house.get("/api/v1/sessions").1, json!([]));
    let (status, vase) = house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    assert_eq!((status, &vase["current"], &vase["pairs"]), (201, &true.into(), &0.into()));
    assert_eq!(house.post("/api/v1/sessions", &json!({ "name": "bowl" })).0, 201);
    assert_eq!(house.take_pair()["session"], "bowl");
    assert_eq!(house.post("/api/v1/sessions", &json!({ "name": "vase" })).0, 200);
    assert_eq!(house.take_pair()["session"], "vase");
    let (_, all) = house.get("/api/v1/sessions");
    let names: Vec<_> = all.as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["bowl", "vase"]);
    let (_, job) = house.post("/api/v1/pairs?wait=true", &json!({ "session": "bowl" }));
    assert_eq!(job["result"], json!({ "session": "bowl", "number": 2, "attempt": 1, "verdict": "accepted" }));
}

#[test]
fn an_interrupted_pair_is_named_and_room_is_told_in_pairs() {
    let house = House::open(Room::default().rig());
    {
        let session = Session::create(&house.session("vase"), "vase").unwrap();
        session.intend_pair().unwrap();
    }
    let stream =
        agent().get(house.url("/api/v1/events")).header("Accept", "text/event-stream").call().unwrap();
    let mut heard = BufReader::new(stream.into_body().into_reader()).lines();
    let (status, vase) = house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    assert_eq!(status, 200);
    let recovered = vase["recovered"][0].as_str().unwrap();
    assert!(recovered.contains("Pair 0001 was interrupted"), "{recovered}");
    assert!(vase["room"]["free_bytes"].as_u64().unwrap() > 0 && vase["room"]["pairs"].is_null(), "{vase}");
    let (told, _) = hear(&mut heard, "recovery");
    assert_eq!((&told["words"], &told["data"]["session"]), (&json!(recovered), &json!("vase")));
    assert_eq!(house.take_pair()["number"], 1);
    let (_, vase) = house.get("/api/v1/sessions/vase");
    assert!(vase["room"]["pairs"].as_u64().unwrap() > 0, "{vase}");
}

#[test]
fn names_that_lead_elsewhere_are_refused() {
    let house = House::open(Room::default().rig());
    for name in ["", ".", "..", "../x", "a/b", "a\\b", ".hidden", " padded", "x\n"] {
        let (status, problem) = house.post("/api/v1/sessions", &json!({ "name": name }));
        assert_eq!((status, problem["code"].as_str()), (400, Some("session_name_invalid")), "{name:?}");
    }
    let made = std::fs::read_dir(house.folder.path().join("sessions")).unwrap().flatten();
    assert_eq!(made.filter(|entry| entry.file_name() != ".unlit").count(), 0);
    for path in ["/api/v1/sessions/..%2F..", "/api/v1/sessions/nobody", "/api/v1/sessions/%2e%2e/pairs"] {
        assert_eq!(house.get(path).0, 404, "{path}");
    }
}

#[test]
fn strangers_are_refused() {
    let house = House::open(Room::default().rig());
    let asked = |host: &str, origin: &str| {
        let mut request = agent().post(house.url("/api/v1/pairs")).header("Host", host);
        if !origin.is_empty() {
            request = request.header("Origin", origin);
        }
        let (status, problem) = answer(request.send_empty().unwrap());
        (status, problem["code"].as_str().unwrap_or("").to_owned())
    };
    let own = format!("127.0.0.1:{}", house.port);
    assert_eq!(asked("evil.example", ""), (421, "host_refused".into()));
    assert_eq!(asked(&own, "http://evil.example"), (403, "origin_refused".into()));
    assert_eq!(asked(&own, "null"), (403, "origin_refused".into()));
    assert_eq!(house.get("/api/v1/jobs").1, json!([]), "nothing was taken");
    assert_eq!(asked(&own, &format!("http://{own}")).0, 202);
}

#[test]
fn a_rejected_pair_says_why_and_a_failed_one_too() {
    let room = Room::with(Trouble::Misfire);
    let house = House::open(room.rig());
    let result = house.take_pair();
    assert_eq!(result["verdict"], "rejected");
    let session = result["session"].as_str().unwrap();
    let (_, pairs) = house.get(&format!("/api/v1/sessions/{session}/pairs"));
    assert_eq!(pairs[0]["reasons"][0]["code"], "misfire", "{pairs}");
    assert!(pairs[0]["reasons"][0]["sentence"].as_str().unwrap().len() > 10);

    room.set(Trouble::Refuses(1));
    let (_, job) = house.post_nothing("/api/v1/pairs?wait=true");
    assert_eq!(
        (job["state"].as_str(), job["problem"]["code"].as_str()),
        (Some("failed"), Some("camera_refused"))
    );
    assert_eq!(house.get(&format!("/api/v1/sessions/{session}/pairs")).1.as_array().unwrap().len(), 1);
}

#[test]
fn missing_devices_are_told_in_words_and_found_later() {
    let room = Room::with(Trouble::NoCamera);
    let house = House::open(room.rig());
    let (_, devices) = house.get("/api/v1/devices");
    assert_eq!((&devices["camera"]["ready"], &devices["flash"]["ready"]), (&false.into(), &true.into()));
    assert!(devices["camera"]["words"].as_str().unwrap().contains("plugged in"));
    room.set(Trouble::None);
    assert_eq!(house.get("/api/v1/devices").1["camera"]["ready"], true);
}

#[test]
fn processing_starts_unaided_once_everything_is_there() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let (status, problem) = house.post_nothing("/api/v1/sessions/vase/process");
    assert_eq!((status, problem["code"].as_str()), (409, Some("inputs_missing")), "{problem}");

    let (_, job) = house.post("/api/v1/sessions/vase/calibration/flash/shots", &json!({ "distance_m": 1.0 }));
    assert_eq!(house.ended(&job)["result"]["name"], "d01000_1");
    house.take_pair();
    let (status, job) = house.import_scene("vase");
    assert_eq!(status, 202, "{job}");
    let scene = house.ended(&job);
    let meshes = json!(["v 0 0 0", "v 1 1 1"]);
    let expected = json!({ "cameras": "<cameras/>", "meshes": meshes, "unit": "cm", "scale": 2.5 });
    assert_eq!(scene["result"], expected);
    assert_eq!(house.processed.load(Ordering::SeqCst), 0, "the flash calibration was still missing");

    let card = json!({ "target_reflectance": 0.94, "ring_radii": [0.035, 0.085] });
    let (status, job) = house.post("/api/v1/sessions/vase/calibration/flash", &card);
    assert_eq!(status, 202, "{job}");
    assert_eq!(house.ended(&job)["result"], json!({ "shots": 1, "ring_radii": [0.035, 0.085] }));
    await_processing(&house, 1);
    house.take_pair();
    await_processing(&house, 2);
    let (_, vase) = house.get("/api/v1/sessions/vase");
    assert_eq!(vase["results"][0]["name"], "model.glb", "{vase}");
    assert_eq!(house.get(vase["results"][0]["url"].as_str().unwrap()), (200, "glTF".into()));
}

fn await_processing(house: &House, times: u32) {
    let end = Instant::now() + PATIENCE;
    let all_done = |jobs: &Value| jobs.as_array().unwrap().iter().all(|j| j["state"] == "done");
    while house.processed.load(Ordering::SeqCst) < times || !all_done(&house.get("/api/v1/jobs").1) {
        assert!(Instant::now() < end, "{}", house.get("/api/v1/jobs").1);
        std::thread::yield_now();
    }
}

#[test]
fn senseless_values_are_refused_with_a_sentence() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    for (path, body, code) in [
        ("calibration/flash/shots", json!({ "distance_m": -1.0 }), "value_invalid"),
        ("calibration/flash/shots", json!({ "distance": 1.0 }), "body_invalid"),
        (
            "calibration/flash",
            json!({ "target_reflectance": 94, "ring_radii": [0.03, 0.08] }),
            "value_invalid",
        ),
        (
            "calibration/flash",
            json!({ "target_reflectance": 0.9, "ring_radii": [0.08, 0.03] }),
            "value_invalid",
        ),
        (
            "calibration/flash",
            json!({ "target_reflectance": 0.9, "ring_radii": [0.03, 0.08] }),
            "inputs_missing",
        ),
        ("scene", json!({}), "content_type_unsupported"),
    ] {
        let (status, problem) = house.post(&format!("/api/v1/sessions/vase/{path}"), &body);
        assert!((400..500).contains(&status), "{path} {body}: {status}");
        assert_eq!(problem["code"], code, "{path} {body}: {problem}");
    }
    assert_eq!(house.post("/api/v1/pairs", &json!({ "sesion": "vase" })).1["code"], "body_invalid");
    assert_eq!(house.get("/api/v1/nothing").1["code"], "not_found");
    assert_eq!(house.get("/api/v1/jobs/99").1["code"], "job_not_found");
    assert_eq!(house.get("/api/v1/confirm").1["code"], "method_not_allowed");
    assert_eq!(house.post_nothing("/api/v1/confirm").1["code"], "nothing_asked");
}

/// Reads server-sent events until one of `topic` came; gives its data and the topics on the way.
fn hear(lines: &mut impl Iterator<Item = std::io::Result<String>>, topic: &str) -> (Value, Vec<String>) {
    let (mut name, mut on_the_way) = (String::new(), Vec::new());
    for line in lines {
        let line = line.unwrap();
        if let Some(event) = line.strip_prefix("event: ") {
            name = event.to_owned();
            on_the_way.push(name.clone());
        } else if let Some(data) = line.strip_prefix("data: ")
            && name == topic
        {
            return (serde_json::from_str(data).unwrap(), on_the_way);
        }
    }
    panic!("the stream ended before {topic}");
}

#[test]
fn events_begin_with_the_state_and_tell_a_pair_from_job_to_verdict() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let stream =
        agent().get(house.url("/api/v1/events")).header("Accept", "text/event-stream").call().unwrap();
    let mut lines = BufReader::new(stream.into_body().into_reader()).lines();
    let (state, before) = hear(&mut lines, "state");
    assert_eq!(before, ["state"]);
    assert_eq!((&state["session"], &state["studio"]), (&"vase".into(), &Value::Null));
    house.post_nothing("/api/v1/pairs");
    let (queued, _) = hear(&mut lines, "job");
    assert_eq!((&queued["data"]["state"], &queued["data"]["session"]), (&"queued".into(), &"vase".into()));
    assert!(queued["data"]["url"].as_str().unwrap().starts_with("/api/v1/jobs/"), "{queued}");
    let (pair, _) = hear(&mut lines, "pair");
    assert_eq!(pair["data"]["verdict"], "accepted");
    assert_eq!(pair["words"], "Pair 1 is good.");
}

#[test]
fn a_pair_that_waits_for_the_operator_is_confirmed_or_cancelled() {
    let room = Room::default();
    let house = House::open(room.rig_with(|| FlashKind::Manual));
    let (_, job) = house.post_nothing("/api/v1/pairs");
    let end = Instant::now() + PATIENCE;
    while house.post_nothing("/api/v1/confirm").0 != 204 {
        assert!(Instant::now() < end, "was never asked");
    }
    let url = house.url(job["url"].as_str().unwrap());
    assert_eq!(agent().delete(&url).call().unwrap().status(), 200);
    assert_eq!(house.ended(&job)["state"], "cancelled");
    assert_eq!(agent().delete(&url).call().unwrap().status(), 409);
    let session = job["session"].as_str().unwrap();
    assert_eq!(house.get(&format!("/api/v1/sessions/{session}/pairs")).1, json!([]));
}

struct Stage(Mutex<usize>);

impl StudioControl for Stage {
    fn describe(&self) -> StudioBody {
        let stop = *self.0.lock().unwrap();
        StudioBody {
            words: format!("stop {stop}"),
            stop: Some(stop),
            stops: 3,
            card_distance_m: None,
            lens_cap: false,
        }
    }

    fn direct(&self, order: StageOrder) -> Result<(), String> {
        match order {
            StageOrder::Stop { stop: stop @ 1..=3 } => *self.0.lock().unwrap() = stop,
            other => return Err(format!("cannot do {other:?}")),
        }
        Ok(())
    }
}

#[test]
fn the_studio_is_there_only_when_it_is_simulated() {
    let real = House::open(Room::default().rig());
    assert_eq!(real.get("/api/v1/studio").1["code"], "no_studio");
    let house = House::open_with(Room::default().rig(), Some(Arc::new(Stage(Mutex::new(1)))));
    assert_eq!(house.get("/api/v1/studio").1["stop"], 1);
    let put = |body: Value| answer(agent().put(house.url("/api/v1/studio/stage")).send_json(body).unwrap());
    assert_eq!(put(json!({ "stop": 2 })).1["words"], "stop 2");
    assert_eq!(put(json!({ "stop": 9 })).0, 400);
    assert_eq!(put(json!({ "card_distance_m": 1.0 })).0, 400);
    assert!((400..500).contains(&put(json!({ "stopp": 1 })).0));
}

#[test]
fn the_page_and_its_assets_are_inside_the_program() {
    let house = House::open(Room::default().rig());
    let mut page = agent().get(house.url("/")).call().unwrap();
    assert!(page.headers()["content-security-policy"].to_str().unwrap().contains("default-src 'self'"));
    let html = page.body_mut().read_to_string().unwrap();
    for asset in ["/assets/page.js", "/assets/page.css", "/assets/icon.svg"] {
        assert!(html.contains(asset), "{html}");
        let first = agent().get(house.url(asset)).call().unwrap();
        assert_eq!(first.status(), 200, "{asset}");
        let tag = first.headers()["etag"].to_str().unwrap().to_owned();
        let again = agent().get(house.url(asset)).header("If-None-Match", &tag).call().unwrap();
        assert_eq!(again.status(), 304, "{asset}");
    }
}

#[test]
fn the_committed_document_is_the_one_that_the_program_prints() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/openapi.json");
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == http::openapi().unwrap(),
        "docs/openapi.json is not what the program says; mend it with: cargo run -- openapi > docs/openapi.json"
    );
}

#[test]
fn the_camera_tells_its_dials_and_its_lock_and_is_set_by_its_labels() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let (status, camera) = house.get("/api/v1/camera");
    assert_eq!(status, 200, "{camera}");
    assert_eq!(camera["exposure"], json!({ "shutter_s": 0.008, "aperture": 11.0, "iso": 100.0 }));
    assert!(camera["offered"]["apertures"].as_array().unwrap().contains(&json!(8.0)));
    let lock = camera["lock"].as_array().unwrap();
    assert_eq!((&lock[0]["name"], &lock[0]["state"]), (&json!("focus"), &json!("locked")));
    assert_eq!(lock[1]["state"], "unreadable");

    let put = |path: &str, body: Value| answer(agent().put(house.url(path)).send_json(body).unwrap());
    let on = json!({ "shutter_s": 0.008, "aperture": 8, "iso": 100 });
    let (status, plan) = put("/api/v1/sessions/vase/exposure", json!({ "on": on }));
    assert_eq!((status, &plan["words"]), (200, &json!("1/125 s, f/8, ISO 100")), "{plan}");
    let off_dial = json!({ "shutter_s": 0.008, "aperture": 1.8, "iso": 100 });
    let (status, problem) = put("/api/v1/sessions/vase/exposure", json!({ "on": off_dial }));
    assert_eq!((status, &problem["code"]), (400, &json!("value_invalid")), "{problem}");
    assert_eq!(put("/api/v1/sessions/none/exposure", json!({ "on": on })).0, 404);

    let (_, job) = house.post_nothing("/api/v1/pairs?wait=true");
    assert_eq!(job["state"], "done", "{job}");
    let (_, pairs) = house.get("/api/v1/sessions/vase/pairs");
    assert!(pairs[0]["on"]["settings"].as_str().unwrap().contains("f/8"), "{pairs}");
}

#[test]
fn region_and_confirmations_stay_with_the_session() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let put =
        |body: Value| answer(agent().put(house.url("/api/v1/sessions/vase/region")).send_json(body).unwrap());
    let region = json!({ "x": 0.25, "y": 0.25, "width": 0.5, "height": 0.5 });
    assert_eq!(put(region.clone()).0, 204);
    assert_eq!(put(json!({ "x": 0.8, "y": 0.0, "width": 0.5, "height": 0.5 })).1["code"], "region_invalid");
    let (_, confirmed) =
        house.post("/api/v1/sessions/vase/confirmed", &json!({ "names": ["mirror_lock_up"] }));
    assert_eq!(confirmed["names"], json!(["mirror_lock_up"]));
    let (_, session) = house.get("/api/v1/sessions/vase");
    assert_eq!((&session["region"], &session["confirmed"]), (&region, &json!(["mirror_lock_up"])));

    house.post_nothing("/api/v1/pairs?wait=true");
    let (status, figures) = house.get("/api/v1/sessions/vase/pairs/1/on/histogram");
    assert_eq!((status, &figures["region"]), (200, &json!([48, 32, 96, 64])), "{figures}");
    let red = &figures["colours"][0];
    let bins: u64 = red["bins"].as_array().unwrap().iter().map(|b| b.as_u64().unwrap()).sum();
    assert_eq!(
        bins + red["below_black"].as_u64().unwrap() + red["at_saturation"].as_u64().unwrap(),
        96 * 64 / 4
    );
    assert_eq!(put(Value::Null).0, 204);
    assert_eq!(house.get("/api/v1/sessions/vase").1["region"], Value::Null);
}

#[test]
fn live_pictures_come_as_a_still_and_as_a_stream() {
    let house = House::open(Room::default().rig());
    let mut still = agent().get(house.url("/api/v1/live.jpg")).call().unwrap();
    assert_eq!(still.headers()["content-type"], "image/jpeg");
    assert_eq!(still.body_mut().read_to_vec().unwrap(), [0xff, 0xd8, 0xff, 0xd9]);
    let stream = agent().get(house.url("/api/v1/live.mjpg")).call().unwrap();
    assert!(stream.headers()["content-type"].to_str().unwrap().starts_with("multipart/x-mixed-replace"));
    let mut lines = BufReader::new(stream.into_body().into_reader()).split(b'\n');
    for _ in 0..2 {
        let boundary = lines.by_ref().map(Result::unwrap).find(|line| line.starts_with(b"--"));
        assert!(boundary.is_some());
    }
    let none = House::open(Room::with(Trouble::NoCamera).rig());
    let (status, problem) = none.get("/api/v1/live.jpg");
    assert_eq!((status, &problem["code"]), (409, &json!("no_live_picture")), "{problem}");
}

#[test]
fn a_session_is_checked_as_a_job_whose_result_names_the_damage() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    house.take_pair();
    let verify = || {
        let (status, job) = house.post_nothing("/api/v1/sessions/vase/verify");
        assert_eq!((status, &job["kind"]), (202, &json!("verify")), "{job}");
        house.ended(&job)["result"].clone()
    };
    let whole = verify();
    assert_eq!((&whole["whole"], &whole["originals"]), (&json!(true), &json!(2)), "{whole}");
    std::fs::write(house.session("vase").join("pairs/0001/on.dng"), b"").unwrap();
    let found = verify();
    let finding = &found["findings"][0];
    assert_eq!((&found["whole"], &finding["path"]), (&json!(false), &json!("pairs/0001/on.dng")), "{found}");
    assert_eq!(finding["damage"], "altered");
    assert_eq!(house.post_nothing("/api/v1/sessions/none/verify").0, 404);
}
