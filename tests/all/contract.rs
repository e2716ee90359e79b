//! What scripts may rely on: every refusal a problem with a code, files by id with tags and parts, one job a key,
//! pages, and nothing locked by looking.

use crate::api::{House, agent, answer};
use crate::fake_rig::{Room, Trouble};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Barrier;
use unlit::capture::FlashKind;
use unlit::http;
use unlit::session::{Session, file_id};

type Reply = ureq::http::Response<ureq::Body>;

fn header<'a>(reply: &'a Reply, name: &str) -> &'a str {
    reply.headers().get(name).map_or("", |value| value.to_str().unwrap())
}

fn ask(house: &House, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Reply {
    let mut request = ureq::http::Request::builder().method(method).uri(house.url(path));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    agent().run(request.body(body.to_owned()).unwrap()).unwrap()
}

#[test]
fn every_refusal_is_a_problem_with_a_code() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let json = [("Content-Type", "application/json")];
    let large = format!("{{\"name\":\"{}\"}}", "x".repeat(3 << 20));
    let shots = "/api/v1/sessions/vase/calibration/flash/shots";
    for (method, path, headers, body, status, code) in [
        ("GET", "/api/v1/sessions/%ff", &[] as &[_], "", 400, "path_invalid"),
        ("GET", "/api/v1/sessions/%ff/pairs", &[], "", 400, "path_invalid"),
        ("GET", "/api/v1/jobs/seven", &[], "", 400, "path_invalid"),
        ("GET", "/api/v1/jobs?limit=many", &[], "", 400, "query_invalid"),
        ("GET", "/api/v1/jobs?limit=0", &[], "", 400, "value_invalid"),
        ("POST", "/api/v1/pairs?wait=perhaps", &[], "", 400, "query_invalid"),
        ("POST", "/api/v1/pairs", &[("Idempotency-Key", "")], "", 400, "idempotency_key_invalid"),
        ("POST", "/api/v1/sessions", &json, "{", 400, "body_invalid"),
        ("POST", "/api/v1/sessions", &json, "{\"name\":7}", 422, "body_invalid"),
        ("POST", "/api/v1/sessions", &[], "{\"name\":\"x\"}", 415, "content_type_unsupported"),
        ("POST", "/api/v1/sessions", &json, &large, 413, "body_too_large"),
        ("POST", "/api/v1/pairs", &json, &large, 413, "body_too_large"),
        (
            "POST",
            "/api/v1/sessions/vase/scene",
            &[("Content-Type", "multipart/form-data")],
            "",
            400,
            "body_invalid",
        ),
        ("POST", shots, &json, "{\"distance_m\":0}", 400, "value_invalid"),
        ("GET", "/api/v1/sessions/none/files", &[], "", 404, "session_not_found"),
        ("GET", "/api/v1/sessions/vase/pairs/7", &[], "", 404, "pair_not_found"),
        ("GET", "/api/v1/sessions/vase/files/model.glb", &[], "", 404, "file_not_found"),
        ("GET", "/api/v1/nothing", &[], "", 404, "not_found"),
        ("GET", "/assets/nothing", &[], "", 404, "not_found"),
        ("GET", "/assets/%ff", &[], "", 400, "path_invalid"),
        ("POST", "/api/v1/sessions/%ff/verify", &[], "", 400, "path_invalid"),
        ("POST", "/api/v1/sessions/none/verify", &[], "", 404, "session_not_found"),
        ("GET", "/api/v1/sessions/%ff/sequence", &[], "", 400, "path_invalid"),
        ("POST", "/api/v1/sessions/vase/sequence/dance", &[], "", 400, "path_invalid"),
        ("POST", "/api/v1/sessions/vase/sequence/start", &[], "", 404, "sequence_not_planned"),
        ("GET", "/pairing/%ff", &[], "", 400, "path_invalid"),
        ("GET", "/pairing/nothing", &[], "", 404, "not_found"),
        ("POST", "/api/v1/pairing", &json, "{", 400, "body_invalid"),
        ("POST", "/api/v1/pairing", &json, "{\"code\":7}", 422, "body_invalid"),
        ("POST", "/api/v1/pairing", &json, "{\"code\":\"7\"}", 409, "pairing_not_needed"),
        ("POST", "/api/v1/tickets", &json, "{\"path\":\"//elsewhere/api/v1/jobs\"}", 400, "value_invalid"),
        ("DELETE", "/api/v1/pairs", &[], "", 405, "method_not_allowed"),
    ] {
        let reply = ask(&house, method, path, headers, body);
        let kind = header(&reply, "content-type").to_owned();
        assert_eq!(
            (reply.status().as_u16(), kind.as_str()),
            (status, "application/problem+json"),
            "{method} {path}"
        );
        assert_eq!(answer(reply).1["code"], code, "{method} {path}");
    }
    let reply = ask(&house, "DELETE", "/api/v1/pairs", &[], "");
    assert_eq!(header(&reply, "allow"), "POST");
}

#[test]
fn what_is_to_be_expected_of_a_rig_is_no_fault_of_the_server() {
    let none = House::open(Room::with(Trouble::NoCamera).rig());
    let (status, problem) = none.get("/api/v1/camera");
    assert_eq!((status, &problem["code"]), (409, &json!("camera_not_found")), "{problem}");

    // The first pair waits for the operator, and 64 more may wait for it.
    let house = House::open(Room::default().rig_with(|| FlashKind::Manual));
    let refused = (0..70).map(|_| ask(&house, "POST", "/api/v1/pairs", &[], "")).find(|r| r.status() != 202);
    let refused = refused.expect("the queue never filled");
    assert_eq!((refused.status().as_u16(), header(&refused, "retry-after")), (429, "5"));
    assert_eq!(answer(refused).1["code"], "queue_full");
    assert!(house.desk.close(crate::api::PATIENCE));
    let closing = ask(&house, "POST", "/api/v1/pairs", &[], "");
    assert_eq!((closing.status().as_u16(), header(&closing, "retry-after")), (503, "5"));
}

#[test]
fn the_document_is_served_as_it_is_committed() {
    let house = House::open(Room::default().rig());
    let mut served = agent().get(house.url("/api/v1/openapi.json")).call().unwrap();
    assert_eq!(served.body_mut().read_to_string().unwrap(), http::openapi().unwrap());
}

#[test]
fn files_are_had_by_id_whole_in_parts_or_not_again() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    house.take_pair();
    std::fs::write(house.session("vase").join("model/report.html"), "<p>A report.</p>").unwrap();
    let (_, files) = house.get("/api/v1/sessions/vase/files");
    let files = files.as_array().unwrap();
    let named = |name: &str| files.iter().find(|file| file["name"] == name).unwrap();
    let (_, pair) = house.get("/api/v1/sessions/vase/pairs/1");
    let off = named("pairs/0001/off.dng");
    assert_eq!((&off["kind"], &off["url"]), (&json!("original"), &pair["off"]["url"]));
    assert_eq!((&off["blake3"], &off["bytes"]), (&pair["off"]["blake3"], &pair["off"]["bytes"]));
    assert_eq!(
        (&named("session.json")["kind"], &named("model/report.html")["kind"]),
        (&json!("record"), &json!("result"))
    );

    let bytes = std::fs::read(house.session("vase").join("pairs/0001/off.dng")).unwrap();
    let url = off["url"].as_str().unwrap();
    let get = |headers: &[(&str, &str)]| ask(&house, "GET", url, headers, "");
    let body = |mut reply: Reply| reply.body_mut().read_to_vec().unwrap();
    let whole = get(&[]);
    assert_eq!(whole.status(), 200);
    let tag = header(&whole, "etag").to_owned();
    assert_eq!(tag, format!("\"{}\"", off["blake3"].as_str().unwrap()));
    assert_eq!(header(&whole, "content-disposition"), "inline; filename=\"0001_off.dng\"");
    assert_eq!(header(&whole, "accept-ranges"), "bytes");
    assert_eq!(body(whole), bytes);

    let same = get(&[("If-None-Match", &tag)]);
    assert_eq!((same.status().as_u16(), header(&same, "etag")), (304, tag.as_str()));
    let part = get(&[("Range", "bytes=10-29"), ("If-Range", &tag)]);
    assert_eq!(part.status(), 206);
    assert_eq!(header(&part, "content-range"), format!("bytes 10-29/{}", bytes.len()));
    assert_eq!(body(part), bytes[10..30]);
    assert_eq!(body(get(&[("Range", "bytes=-7")])), bytes[bytes.len() - 7..]);
    assert_eq!(get(&[("Range", "bytes=10-29"), ("If-Range", "\"other\"")]).status(), 200);
    let beyond = get(&[("Range", "bytes=99999999-")]);
    assert_eq!(header(&beyond, "content-range"), format!("bytes */{}", bytes.len()));
    assert_eq!((beyond.status().as_u16(), &answer(beyond).1["code"]), (416, &json!("range_not_satisfiable")));
    assert_eq!(answer(get(&[("If-Match", "\"other\"")])).1["code"], "file_changed");
    let head = ask(&house, "HEAD", url, &[], "");
    assert_eq!(header(&head, "content-length"), bytes.len().to_string());
    assert_eq!((head.status().as_u16(), body(head).len()), (200, 0));

    let pictures = ["off", "on"].map(|frame| pair[frame]["thumbnail"].as_str().unwrap().to_owned());
    let known = pair["known"].as_str().unwrap().to_owned();
    for address in pictures.into_iter().chain([known]) {
        let kept = |path: &str| header(&ask(&house, "GET", path, &[], ""), "cache-control").to_owned();
        assert!(kept(&address).ends_with("immutable"), "{address}");
        let (plain, _) = address.split_once("?of=").unwrap();
        for other in [plain.to_owned(), format!("{plain}?of="), format!("{plain}?of=0123456789abcdef")] {
            assert_eq!(kept(&other), "no-cache", "{other}");
        }
    }

    let report = ask(&house, "GET", named("model/report.html")["url"].as_str().unwrap(), &[], "");
    assert!(header(&report, "content-type").starts_with("text/html") && !header(&report, "etag").is_empty());
    assert!(header(&report, "content-security-policy").contains("sandbox"));
    assert_eq!(body(report), b"<p>A report.</p>");
}

#[test]
fn no_way_leads_out_of_the_session() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    std::fs::write(house.folder.path().join("secret"), "secret").unwrap();
    std::os::unix::fs::symlink(house.folder.path().join("secret"), house.session("vase").join("model/link"))
        .unwrap();
    let files = "/api/v1/sessions/vase/files";
    assert_eq!(house.get(&format!("{files}/{}", file_id("session.json"))).0, 200);
    let named =
        ["session.json", "..%2F..%2Fsecret", "%2e%2e/%2e%2e/secret", ".lock", "model", "pairs/..%2F.lock"];
    let digests = ["model/link", ".lock", "../secret", "/etc/passwd", "model"].map(file_id);
    for id in named.into_iter().map(str::to_owned).chain(digests) {
        let (status, problem) = house.get(&format!("{files}/{id}"));
        assert!(
            status == 404 && problem["code"].as_str().unwrap().ends_with("not_found"),
            "{id}: {status} {problem}"
        );
    }
}

#[test]
fn slow_downloads_hold_no_thread() {
    const THREADS: usize = 4;
    let house = House::open_narrow(Room::default().rig(), None, THREADS);
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let large = std::fs::File::create(house.session("vase").join("model/large.bin")).unwrap();
    // More than the system takes for a client that does not read.
    large.set_len(64 << 20).unwrap();
    let path = format!("/api/v1/sessions/vase/files/{}", file_id("model/large.bin"));
    let slow: Vec<TcpStream> = (0..8 * THREADS)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", house.port)).unwrap();
            write!(stream, "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", house.port).unwrap();
            let mut begun = [0; 15];
            stream.read_exact(&mut begun).unwrap();
            assert_eq!(&begun, b"HTTP/1.1 200 OK");
            stream
        })
        .collect();
    assert_eq!(house.take_pair()["verdict"], "accepted");
    assert_eq!(house.get("/api/v1/sessions/vase").1["pairs"], 1);
    drop(slow);
}

#[test]
fn a_key_stands_for_one_job_however_often_it_is_sent() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    let send = |path: &str, key: &str, body: &str| {
        let headers = [("Content-Type", "application/json"), ("Idempotency-Key", key)];
        let reply = ask(&house, "POST", path, &headers, body);
        let replayed = header(&reply, "idempotency-replayed") == "true";
        let (status, body) = answer(reply);
        (status, replayed, body)
    };
    let (status, replayed, first) = send("/api/v1/pairs?wait=true", "one", "");
    assert_eq!((status, replayed, &first["result"]["number"]), (200, false, &json!(1)));
    let (status, replayed, again) = send("/api/v1/pairs", "one", "{}");
    assert_eq!((status, replayed, &again), (202, true, &first), "no body is no wish");
    assert!(send("/api/v1/pairs?wait=true", "one", "").1);
    let other_body = send("/api/v1/pairs", "one", "{\"session\":\"vase\"}");
    let other_path = send("/api/v1/sessions/vase/find-exposure", "one", "");
    for (status, _, problem) in [other_body, other_path] {
        assert_eq!((status, &problem["code"]), (422, &json!("idempotency_key_reused")), "{problem}");
    }
    let refused = send("/api/v1/sessions/vase/process", "p", "");
    assert_eq!((refused.0, &refused.2["code"]), (409, &json!("inputs_missing")));
    for (path, body) in [
        ("/api/v1/sessions/vase/find-exposure", ""),
        ("/api/v1/sessions/vase/calibration/flash/shots", "{\"distance_m\":1}"),
        ("/api/v1/sessions/vase/repeatability", "{\"shots\":8}"),
    ] {
        let (status, _, job) = send(path, path, body);
        assert_eq!((status, send(path, path, body).2["id"].clone()), (202, job["id"].clone()), "{path}");
    }

    let before = house.get("/api/v1/jobs").1.as_array().unwrap().len();
    let start = Barrier::new(8);
    let ids: Vec<Value> = std::thread::scope(|scope| {
        let once = || {
            start.wait();
            send("/api/v1/pairs", "many", "").2["id"].clone()
        };
        let asking: Vec<_> = (0..8).map(|_| scope.spawn(once)).collect();
        asking.into_iter().map(|one| one.join().unwrap()).collect()
    });
    assert!(ids.iter().all(|id| *id == ids[0]), "{ids:?}");
    assert_eq!(house.get("/api/v1/jobs").1.as_array().unwrap().len(), before + 1);
}

#[test]
fn a_key_stands_for_its_job_after_a_restart_and_is_free_again_after_a_refusal() {
    let killed = tempfile::tempdir().unwrap();
    let send = |house: &House, key: &str, body: &str| {
        let headers = [("Content-Type", "application/json"), ("Idempotency-Key", key)];
        let reply = ask(house, "POST", "/api/v1/pairs", &headers, body);
        let replayed = header(&reply, "idempotency-replayed") == "true";
        let (_, body) = answer(reply);
        (replayed, body)
    };
    let (done, cut) = {
        // The second pair waits for the operator.
        let house = House::open(Room::default().rig_with(|| FlashKind::Manual));
        house.post("/api/v1/sessions", &json!({ "name": "vase" }));
        let (_, refused) = send(&house, "one", "{\"again\":7}");
        assert_eq!(refused["code"], "pair_not_found");
        let (_, done) = send(&house, "one", "");
        assert_eq!(agent().delete(house.url(done["url"].as_str().unwrap())).call().unwrap().status(), 200);
        house.ended(&done);
        let (_, cut) = send(&house, "two", "");
        // What `kill -9` would leave now.
        let sessions = house.folder.path().join("sessions");
        let copied = std::process::Command::new("cp").arg("-a").args([&sessions, killed.path()]).status();
        assert!(copied.unwrap().success());
        house.desk.queue().cancel(cut["id"].as_u64().unwrap()).unwrap();
        (done, cut)
    };
    let house = House::open_in(killed, Room::default().rig(), None, 64);
    for (key, job, state) in [("one", done, "cancelled"), ("two", cut, "interrupted")] {
        let (replayed, again) = send(&house, key, "");
        assert_eq!((replayed, &again["id"], &again["state"]), (true, &job["id"], &json!(state)), "{key}");
        let (_, refused) = send(&house, key, "{\"session\":\"vase\"}");
        assert_eq!(refused["code"], "idempotency_key_reused", "{key}");
    }
    assert_eq!(house.get("/api/v1/jobs").1.as_array().unwrap().len(), 2, "nothing was shot again");
}

#[test]
fn a_retry_that_is_sent_twice_under_a_key_is_one_job() {
    let room = Room::with(Trouble::Refuses(0));
    let house = House::open(room.rig());
    let (_, failed) = house.post_nothing("/api/v1/pairs?wait=true");
    assert_eq!(failed["state"], "failed", "{failed}");
    room.heal();
    let retry = |key: &str| {
        let path = format!("{}/retry", failed["url"].as_str().unwrap());
        let reply = ask(&house, "POST", &path, &[("Idempotency-Key", key)], "");
        let replayed = header(&reply, "idempotency-replayed").to_owned();
        (replayed, answer(reply).1["id"].clone())
    };
    let (first, again, other) = (retry("one"), retry("one"), retry("other"));
    assert_eq!((first.0.as_str(), again.0.as_str(), &first.1), ("", "true", &again.1));
    assert_ne!(other.1, first.1, "another key is another wish");
}

#[test]
fn a_scene_is_taken_for_a_session_that_is_there_and_not_three_at_a_time() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "vase" }));
    // Heads whose bodies do not come: an answer can only be to the head.
    let begin = |session: &str, part: &str| {
        let mut stream = TcpStream::connect(("127.0.0.1", house.port)).unwrap();
        stream.set_read_timeout(Some(crate::api::PATIENCE)).unwrap();
        write!(
            stream,
            "POST /api/v1/sessions/{session}/scene HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Length: 1000000000\r\n\
             Content-Type: multipart/form-data; boundary=cut\r\n\r\n{part}",
            house.port
        )
        .unwrap();
        stream
    };
    let mut nowhere = String::new();
    begin("none", "").read_to_string(&mut nowhere).unwrap();
    assert!(nowhere.starts_with("HTTP/1.1 404") && nowhere.contains("session_not_found"), "{nowhere}");

    let part = "--cut\r\nContent-Disposition: form-data; name=\"unit\"\r\n\r\n";
    let two = [begin("vase", part), begin("vase", part)];
    let end = std::time::Instant::now() + crate::api::PATIENCE;
    let form = [("Content-Type", "multipart/form-data; boundary=cut")];
    let send = || ask(&house, "POST", "/api/v1/sessions/vase/scene", &form, "--cut--\r\n");
    // It takes a moment until both are at it: what comes in has a folder.
    let staged = || {
        let entries = std::fs::read_dir(house.desk.own_folder()).unwrap().flatten();
        entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(".tmp-")).count()
    };
    while staged() < 2 {
        assert!(std::time::Instant::now() < end, "the two are not let in");
        std::thread::yield_now();
    }
    let busy = send();
    assert_eq!(busy.status(), 429, "a third was let in beside two");
    assert_eq!(header(&busy, "retry-after"), "5");
    assert_eq!(answer(busy).1["code"], "uploads_busy");
    drop(two);
    while send().status() != 400 {
        assert!(std::time::Instant::now() < end, "places are not given back");
    }
}

#[test]
fn long_lists_come_in_pages_that_lead_on() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "a vase" }));
    for _ in 0..3 {
        house.take_pair();
    }
    let walk = |first: &str, number: &str| {
        let (mut at, mut seen) = (Some(first.to_owned()), Vec::new());
        while let Some(path) = at {
            let reply = ask(&house, "GET", &path, &[], "");
            let link = header(&reply, "link").to_owned();
            at = link.strip_prefix('<').and_then(|l| l.strip_suffix(">; rel=\"next\"")).map(str::to_owned);
            let (_, page) = answer(reply);
            assert!(page.as_array().unwrap().len() <= 2);
            seen.extend(page.as_array().unwrap().iter().map(|entry| entry[number].as_u64().unwrap()));
        }
        seen
    };
    assert_eq!(walk("/api/v1/sessions/a%20vase/pairs?limit=2", "number"), [1, 2, 3]);
    assert_eq!(walk("/api/v1/jobs?limit=1", "id"), [6, 5, 4, 3, 2, 1], "each pair, and its developing");
    let (_, pair) = house.get("/api/v1/sessions/a%20vase/pairs/2");
    assert_eq!(pair["number"], 2);
    assert_eq!(house.get(pair["url"].as_str().unwrap()).1, pair);
}

#[test]
fn looking_at_a_session_keeps_nobody_from_it() {
    let house = House::open(Room::default().rig());
    house.post("/api/v1/sessions", &json!({ "name": "current" }));
    let folder = house.session("vase");
    let made = Session::create(&folder, "vase").unwrap();
    drop(made);
    for path in ["", "/pairs", "/files", "/flash", &format!("/files/{}", file_id("session.json"))] {
        assert_eq!(house.get(&format!("/api/v1/sessions/vase{path}")).0, 200, "{path}");
    }
    assert_eq!(house.get("/api/v1/sessions/vase/sequence").1["code"], "sequence_not_planned");
    assert_eq!(house.get("/api/v1/sessions/vase/pairs/1/off/thumbnail.jpg").0, 404);
    assert_eq!(house.get("/api/v1/sessions/vase/pairs/1/off/histogram").0, 404);
    // Another program may write to it now.
    let other = Session::open(&folder).unwrap();
    assert_eq!(house.get("/api/v1/sessions/vase/pairs").1["code"], "session_locked");
    drop(other);

    // And this program's own readers do not get in the way of a pair.
    let stop = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                while !stop.load(std::sync::atomic::Ordering::SeqCst) {
                    house.get("/api/v1/sessions/vase/files");
                }
            });
        }
        let (status, job) = house.post("/api/v1/pairs?wait=true", &json!({ "session": "vase" }));
        stop.store(true, std::sync::atomic::Ordering::SeqCst);
        assert_eq!((status, &job["state"]), (200, &json!("done")), "{job}");
    });
}
