//! A client that writes bytes as they come, which no decent HTTP library would.

use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Long enough for a loaded machine.
pub(crate) const DEADLINE: Duration = Duration::from_secs(30);

/// An answer, as it came.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    /// The stable code of a problem, or nothing.
    pub(crate) fn code(&self) -> String {
        let problem: Value = serde_json::from_str(&self.body).unwrap_or_default();
        problem["code"].as_str().unwrap_or("").to_owned()
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let lines = self.head.lines().filter_map(|line| line.split_once(':'));
        lines.into_iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|(_, value)| value.trim())
    }
}

pub(crate) fn connect(port: u16) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    stream.set_write_timeout(Some(DEADLINE)).unwrap();
    stream
}

/// Reads the head of an answer, and its body as far as its length is told.
pub(crate) fn read_answer(stream: &TcpStream) -> Answer {
    try_answer(stream).unwrap_or_else(|error| panic!("no answer: {error}"))
}

pub(crate) fn try_answer(stream: &TcpStream) -> std::io::Result<Answer> {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if reader.read_line(&mut head)? == 0 {
            return Err(std::io::Error::other(format!("it ended in {head:?}")));
        }
    }
    let status = head.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or_else(|| panic!("{head:?}"));
    let mut answer = Answer { status, head, body: String::new() };
    let mut body = Vec::new();
    match answer.header("content-length").map(|l| l.parse().unwrap()) {
        Some(length) => reader.take(length).read_to_end(&mut body)?,
        None if answer.header("transfer-encoding").is_some() || status == 204 => 0,
        None => reader.read_to_end(&mut body)?,
    };
    answer.body = String::from_utf8_lossy(&body).into_owned();
    Ok(answer)
}

/// Sends a request of this first line and these header lines; `Host` and `Connection: close` come by themselves
/// unless they are among them. The body, if any, comes with its length.
pub(crate) fn ask(port: u16, line: &str, headers: &[&str], body: &str) -> Answer {
    let stream = connect(port);
    send(&stream, port, line, headers, body);
    read_answer(&stream)
}

pub(crate) fn send(mut stream: &TcpStream, port: u16, line: &str, headers: &[&str], body: &str) {
    let given = |name: &str| headers.iter().any(|h| h.to_ascii_lowercase().starts_with(name));
    let mut text = format!("{line} HTTP/1.1\r\n");
    if !given("host:") {
        text += &format!("Host: 127.0.0.1:{port}\r\n");
    }
    if !given("connection:") {
        text += "Connection: close\r\n";
    }
    if !body.is_empty() {
        text += &format!("Content-Length: {}\r\n", body.len());
    }
    headers.iter().for_each(|header| text += &format!("{header}\r\n"));
    text += "\r\n";
    text += body;
    stream.write_all(text.as_bytes()).unwrap();
}

/// Opens a stream of events and reads its first one.
pub(crate) fn listen(port: u16, path: &str, headers: &[&str]) -> TcpStream {
    let stream = connect(port);
    send(&stream, port, &format!("GET {path}"), headers, "");
    let mut reader = BufReader::with_capacity(1, &stream);
    let mut line = String::new();
    while !line.starts_with("event: state") {
        line.clear();
        assert!(reader.read_line(&mut line).unwrap() > 0, "the stream ended");
        assert!(!line.starts_with("HTTP/") || line.contains(" 200 "), "{line}");
    }
    stream
}
