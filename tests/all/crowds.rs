//! Who asks for too much, takes his time, or comes a thousand strong: the others go on being answered.

use crate::daemon::{Daemon, hear};
use crate::raw_http::{DEADLINE, ask, connect, listen, read_answer, send, try_answer};
use crate::strangers::{JSON, nothing_was_taken};
use crate::yard::Yard;
use std::io::{Read, Write};
use std::time::{Duration, Instant};
use unlit::http::Patience;

/// A patience that tests can wait for.
fn short() -> Patience {
    let moment = Duration::from_millis(400);
    Patience { head: moment, body: moment, stalled: moment, ..Patience::default() }
}

#[test]
fn a_giant_body_is_refused_before_it_is_read() {
    let yard = Yard::open(Patience::default());
    for (route, kind, length) in [
        ("POST /api/v1/sessions", JSON, "65537"),
        ("POST /api/v1/pairs", JSON, "100000000000"),
        ("POST /api/v1/sessions/vase/scene", "Content-Type: multipart/form-data; boundary=x", "100000000000"),
    ] {
        let answer = ask(yard.port, route, &[kind, &format!("Content-Length: {length}")], "");
        assert_eq!((answer.status, answer.code()), (413, "body_too_large".into()), "{route}");
    }
    // One that does not tell its length, and goes on for ever.
    let mut stream = connect(yard.port);
    send(&stream, yard.port, "POST /api/v1/sessions", &[JSON, "Transfer-Encoding: chunked"], "");
    let chunk = format!("1000\r\n{}\r\n", " ".repeat(4096));
    let sent = (0..4096).take_while(|_| stream.write_all(chunk.as_bytes()).is_ok()).count();
    assert!((16..4096).contains(&sent), "{sent} chunks of 4 kB were taken");
    assert_eq!(try_answer(&stream).map_or(413, |a| a.status), 413);
    // The same in a volume that the answer survives.
    let stream = connect(yard.port);
    send(&stream, yard.port, "POST /api/v1/sessions", &[JSON, "Transfer-Encoding: chunked"], "");
    (0..20).for_each(|_| (&stream).write_all(chunk.as_bytes()).unwrap());
    assert_eq!(read_answer(&stream).status, 413);
    // Who was refused at once and sends on can still hear it: the connection is not broken off under him.
    let mut stream = connect(yard.port);
    send(&stream, yard.port, "POST /api/v1/sessions", &[JSON, "Content-Length: 3000000"], "");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
    (0..20).for_each(|_| stream.write_all(chunk.as_bytes()).unwrap());
    nothing_was_taken(&yard);
}

#[test]
fn a_giant_head_is_refused() {
    let yard = Yard::open(Patience::default());
    let large = format!("X-Large: {}", "x".repeat(40_000));
    assert_eq!(ask(yard.port, "GET /api/v1/jobs", &[&large], "").status, 431);
    let many: Vec<String> = (0..300).map(|n| format!("X-{n}: x")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    assert_eq!(ask(yard.port, "GET /api/v1/jobs", &many, "").status, 431);
    let line = format!("GET /{}", "a".repeat(70_000));
    assert!(matches!(ask(yard.port, &line, &[], "").status, 414 | 431));
    nothing_was_taken(&yard);
}

#[test]
fn who_drips_is_given_up_while_others_are_answered() {
    let yard = Yard::open(short());
    let mut head = connect(yard.port);
    head.write_all(b"GET /api/v1/jobs HTTP/1.1\r\nHost: ").unwrap();
    let mut silent = connect(yard.port);
    let mut body = connect(yard.port);
    send(&body, yard.port, "POST /api/v1/sessions", &[JSON, "Content-Length: 1000"], "");
    let begun = Instant::now();
    // A byte now and then does not help: the time is for the whole.
    for stream in [&mut head, &mut body] {
        stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    }
    let mut late = Vec::new();
    while late.is_empty() {
        assert!(begun.elapsed() < DEADLINE, "the dripping body was not given up");
        nothing_was_taken(&yard);
        let _broken = body.write_all(b" ");
        let mut bytes = [0; 4096];
        if let Ok(read @ 1..) = body.read(&mut bytes) {
            late.extend_from_slice(&bytes[..read]);
        }
    }
    assert!(begun.elapsed() >= short().body, "given up too soon");
    let late = String::from_utf8_lossy(&late).into_owned();
    assert!(late.starts_with("HTTP/1.1 408") && late.contains("body_too_slow"), "{late}");
    loop {
        assert!(begun.elapsed() < DEADLINE, "the dripping head was not given up");
        if head.write_all(b"x").is_err() || matches!(head.read(&mut [0]), Ok(0)) {
            break;
        }
    }
    assert_eq!(silent.read(&mut [0]).unwrap_or(0), 0, "who says nothing is given up, too");
}

#[test]
fn who_takes_nothing_of_his_answers_loses_his_place() {
    let yard = Yard::open(Patience { connections: 1, ..short() });
    let stream = connect(yard.port);
    stream.set_nonblocking(true).unwrap();
    let request = format!("GET /assets/page.js HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", yard.port);
    // Asked for so often that no buffer between us holds it all.
    let asked = (0..10_000).take_while(|_| (&stream).write_all(request.as_bytes()).is_ok()).count();
    assert!(asked > 100, "{asked} requests were sent");
    let begun = Instant::now();
    let mut turned_away = 0;
    loop {
        let answer = ask(yard.port, "GET /api/v1/jobs", &[], "");
        if answer.status == 200 {
            break;
        }
        assert_eq!((answer.status, answer.code()), (503, "too_many_connections".into()));
        turned_away += 1;
        assert!(begun.elapsed() < DEADLINE, "he kept his place through {turned_away} others");
    }
    assert!(turned_away > 0, "he had no place");
}

#[test]
fn one_too_many_is_told_so_and_has_a_place_when_another_leaves() {
    let yard = Yard::open(Patience { connections: 2, ..Patience::default() });
    let first = listen(yard.port, "/api/v1/events", &[]);
    let _second = listen(yard.port, "/api/v1/events", &[]);
    let answer = ask(yard.port, "GET /api/v1/jobs", &[], "");
    assert_eq!((answer.status, answer.code()), (503, "too_many_connections".into()));
    assert!(answer.header("retry-after").is_some());
    drop(first);
    let begun = Instant::now();
    while ask(yard.port, "GET /api/v1/jobs", &[], "").status != 200 {
        assert!(begun.elapsed() < DEADLINE, "the place was not given back");
    }
}

#[test]
fn a_thousand_idle_streams_keep_nobody_from_being_answered() {
    const STREAMS: usize = 1000;
    assert!(
        unlit::http::connections_that_fit(2 * STREAMS) == 2 * STREAMS,
        "`ulimit -Hn` must be 2300 at least"
    );
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::launch(folder.path(), |serve| serve.args(["--flash", "none"]));
    let port = daemon.port;
    listen(port, "/api/v1/events", &[]);
    let before = daemon.descriptors();
    let begun = Instant::now();
    let streams: Vec<_> = (0..STREAMS).map(|_| listen(port, "/api/v1/events", &[])).collect();
    let opened = begun.elapsed();
    let during = daemon.descriptors();
    assert!(during > STREAMS, "{before} descriptors, then {during}");
    let mut times: Vec<_> = (0..100)
        .map(|_| {
            let begun = Instant::now();
            assert_eq!(ask(port, "GET /api/v1/jobs", &[], "").status, 200);
            begun.elapsed()
        })
        .collect();
    times.sort();
    println!(
        "{STREAMS} streams opened in {opened:.1?}; with them a request took {:.1?} (median), {:.1?} (longest); \
         {before} descriptors, then {during}",
        times[50], times[99]
    );
    assert!(times[99] < Duration::from_secs(2), "{times:?}");
    // An event reaches all of them.
    assert_eq!(ask(port, "POST /api/v1/sessions", &[JSON], r#"{"name":"vase"}"#).status, 201);
    for stream in &streams {
        hear(&mut std::io::BufReader::new(stream), "event: session");
    }
    drop(streams);
    let left = Instant::now();
    while daemon.descriptors() > before + 8 {
        assert!(left.elapsed() < DEADLINE, "{} descriptors are still open", daemon.descriptors());
        assert_eq!(ask(port, "GET /api/v1/jobs", &[], "").status, 200);
    }
    println!("descriptors were back {:.1?} after they left: {}", left.elapsed(), daemon.descriptors());
    let _some: Vec<_> = (0..50).map(|_| listen(port, "/api/v1/events", &[])).collect();
    // It ends well with streams open.
    daemon.stop();
}
