//! The daemon as a process: where its settings come from, how it says that it stands, and what its log tells.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(30);

/// The program in an environment of its own, nothing set.
fn unlit(home: &Path, environment: &[(&str, &str)], words: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_unlit"));
    let ours =
        std::env::vars_os().map(|(name, _)| name).filter(|n| n.to_string_lossy().starts_with("UNLIT_"));
    for name in ours {
        command.env_remove(name);
    }
    command.args(words).env("XDG_CONFIG_HOME", home).envs(environment.iter().copied()).current_dir(home);
    command
}

fn ended(home: &Path, environment: &[(&str, &str)], words: &[&str]) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } = unlit(home, environment, words).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (status.code(), text(stdout), text(stderr))
}

/// A home with a config file.
fn home(settings: &str) -> TempDir {
    let home = tempfile::tempdir().unwrap();
    std::fs::create_dir(home.path().join("unlit")).unwrap();
    std::fs::write(home.path().join("unlit/config.toml"), settings).unwrap();
    home
}

struct Daemon {
    child: Child,
    url: String,
    started_in: Duration,
}

impl Daemon {
    fn start(home: &Path, environment: &[(&str, &str)], words: &[&str]) -> Self {
        let began = Instant::now();
        let mut command = unlit(home, environment, &[&["serve"], words].concat());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.split(' ').find(|word| word.starts_with("http://")).unwrap_or_default();
        let url = url.trim_end_matches('/').to_owned();
        let mut daemon = Self { child, url, started_in: Duration::ZERO };
        assert!(!daemon.url.is_empty(), "{line}{}", daemon.end());
        let page = agent().get(&daemon.url).call().unwrap();
        assert_eq!(page.status(), 200);
        daemon.started_in = began.elapsed();
        daemon
    }

    /// Stops it; gives its log.
    fn end(&mut self) -> String {
        // SIGTERM, as systemd sends it.
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").arg(&pid).status().unwrap().success());
        let mut log = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        assert!(self.child.wait().unwrap().success() || std::thread::panicking(), "{log}");
        log
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // Gone already where the test came to its end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build().into()
}

fn get(url: &str) -> Value {
    agent().get(url).call().unwrap().body_mut().read_json().unwrap()
}

#[test]
fn file_environment_and_flags_are_layered_and_the_page_is_there_in_time() {
    let home = home("listen = '127.0.0.1:0'\nsessions = 'from-file'\nflash = 'none'\nrecycle = 61\n");
    let (code, out, complaint) = ended(home.path(), &[], &["serve", "--print-config"]);
    assert_eq!((code, out.as_str()), (Some(2), ""), "{complaint}");
    assert!(complaint.contains("unlit/config.toml, line 4: `recycle`: invalid value '61'"), "{complaint}");

    let environment = [("UNLIT_SESSIONS", "from-environment"), ("UNLIT_RECYCLE", "3")];
    let words = ["serve", "--print-config", "--recycle", "4"];
    std::fs::write(
        home.path().join("unlit/config.toml"),
        "listen = '127.0.0.1:0'\nsessions = 'a'\nflash = 'none'\n",
    )
    .unwrap();
    let (code, out, complaint) = ended(home.path(), &environment, &words);
    assert_eq!(code, Some(0), "{complaint}");
    for line in [
        "recycle = \"4\"  # flag\n",
        "sessions = \"from-environment\"  # UNLIT_SESSIONS in the environment\n",
        "unlit/config.toml, line 3\n",
        "studio = false  # default\n",
        "# camera is not set\n",
    ] {
        assert!(out.contains(line), "{out}");
    }

    let mut daemon = Daemon::start(home.path(), &environment, &["--recycle=4"]);
    assert!(daemon.started_in < PATIENCE, "{:?}", daemon.started_in);
    assert!(home.path().join("from-environment").is_dir() && !home.path().join("a").exists());
    assert!(!daemon.url.ends_with(":8710"), "{}", daemon.url);
    daemon.end();
}

#[test]
fn a_setting_that_is_none_and_a_file_that_is_missing_end_the_program_with_2() {
    let home = home("listn = '127.0.0.1:0'\n");
    let (code, _, complaint) = ended(home.path(), &[], &["serve"]);
    assert_eq!(code, Some(2), "{complaint}");
    assert!(
        complaint.contains("line 1: there is no setting `listn` (did you mean `listen`?)"),
        "{complaint}"
    );
    assert!(complaint.contains("log-format"), "{complaint}");
    let (code, _, complaint) = ended(home.path(), &[], &["serve", "--config", "nowhere.toml"]);
    assert_eq!(code, Some(2), "{complaint}");
    assert!(complaint.contains("nowhere.toml cannot be read"), "{complaint}");
    let (code, _, complaint) = ended(home.path(), &[("UNLIT_CONFIG", "elsewhere.toml")], &["serve"]);
    assert!(code == Some(2) && complaint.contains("elsewhere.toml cannot be read"), "{complaint}");
    let (code, help, _) = ended(home.path(), &[], &["serve", "--help"]);
    assert!(code == Some(0) && help.contains("--listen"), "help must come whatever the file says");
    let (code, ..) = ended(home.path(), &[("UNLIT_CONFIG", "/dev/null")], &["serve", "--print-config"]);
    assert_eq!(code, Some(0), "an empty file in place of the usual one");
}

#[test]
fn the_status_tells_how_the_daemon_stands() {
    let home = home("listen = '127.0.0.1:0'\nflash = 'none'\n");
    let mut daemon = Daemon::start(home.path(), &[], &[]);
    let status = || get(&format!("{}/api/v1/status", daemon.url));
    let now = status();
    assert_eq!((&now["version"], &now["log"]), (&json!(env!("CARGO_PKG_VERSION")), &json!("warn")));
    assert_eq!(now["devices"], json!({ "camera": false, "flash": false }));
    assert_eq!((&now["session"], &now["event_streams"]), (&Value::Null, &json!(0)));
    let idle = json!({ "running": 0, "waiting": 0 });
    assert_eq!(now["jobs"], json!({ "rig": idle, "develop": idle, "processing": idle }));
    assert!(now["started"].as_str().unwrap().ends_with('Z'), "{now}");
    assert!(now["room"]["free_bytes"].as_u64().unwrap() > 0 && now["room"]["pairs"].is_null(), "{now}");
    assert!(status()["uptime_s"].as_f64() > now["uptime_s"].as_f64());

    let url = format!("{}/api/v1/sessions", daemon.url);
    assert_eq!(agent().post(url).send_json(json!({ "name": "vase" })).unwrap().status(), 201);
    assert_eq!(status()["session"], "vase");
    let events = format!("{}/api/v1/events", daemon.url);
    let listener = agent().get(&events).header("Accept", "text/event-stream").call().unwrap();
    let mut lines = BufReader::new(listener.into_body().into_reader());
    lines.read_line(&mut String::new()).unwrap();
    assert_eq!(status()["event_streams"], 1);
    drop(lines);
    let end = Instant::now() + PATIENCE;
    while status()["event_streams"] != 0 {
        assert!(Instant::now() < end, "a stream whose client is gone is still counted");
        std::thread::sleep(Duration::from_millis(20));
    }
    daemon.end();
}

#[test]
fn a_request_is_known_by_its_id_in_answer_problem_and_log() {
    let home = home("listen = '127.0.0.1:0'\nflash = 'none'\nlog-format = 'json'\n");
    let mut daemon = Daemon::start(home.path(), &[("UNLIT_LOG", "debug"), ("UNLIT_LISTN", "x")], &[]);
    let id_of = |response: &ureq::http::Response<ureq::Body>| {
        response.headers()["x-request-id"].to_str().unwrap().to_owned()
    };
    let ask = |id: &str| {
        agent()
            .get(format!("{}/api/v1/jobs/99?ticket=secret", daemon.url))
            .header("X-Request-Id", id)
            .call()
            .unwrap()
    };
    let mut kept = ask("shoot-7");
    assert_eq!(id_of(&kept), "shoot-7");
    let problem: Value = kept.body_mut().read_json().unwrap();
    assert_eq!((&problem["code"], &problem["request_id"]), (&json!("job_not_found"), &json!("shoot-7")));
    let replaced = id_of(&ask("not a sane id"));
    assert!(replaced.len() == 16 && replaced != id_of(&ask("")), "{replaced}");
    let unknown = agent().get(format!("{}/nothing/here", daemon.url)).call().unwrap();
    assert_eq!(id_of(&unknown).len(), 16);

    let pairs =
        agent().post(format!("{}/api/v1/pairs?wait=true", daemon.url)).header("X-Request-Id", "pair-order");
    let job: Value = pairs.send_empty().unwrap().body_mut().read_json().unwrap();
    assert_eq!(job["state"], "failed", "{job}");
    let log = daemon.end();
    assert!(!log.contains("secret"), "{log}");
    let lines: Vec<Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}")))
        .collect();
    let answered =
        lines.iter().find(|line| line["span"]["id"] == "shoot-7" && line["fields"]["status"] == 404);
    let answered = answered.unwrap_or_else(|| panic!("{log}"));
    assert_eq!(
        (&answered["span"]["method"], &answered["span"]["path"]),
        (&json!("GET"), &json!("/api/v1/jobs/{id}"))
    );
    assert!(answered["fields"]["ms"].as_f64().unwrap() > 0.0, "{answered}");
    // Written on the rig's own thread, long after the request had been handed on.
    let shot = lines.iter().find(|line| line["span"]["name"] == "pair").unwrap_or_else(|| panic!("{log}"));
    let (number, spans) = (&shot["span"]["number"], shot["spans"].as_array().unwrap());
    let names: Vec<_> = spans.iter().map(|span| span["name"].as_str().unwrap()).collect();
    assert_eq!((number, names.as_slice()), (&json!(1), ["request", "job", "pair"].as_slice()), "{shot}");
    assert_eq!((&spans[0]["id"], &spans[1]["id"]), (&json!("pair-order"), &job["id"]), "{shot}");
    assert_eq!((&spans[1]["kind"], &spans[1]["session"]), (&json!("pair"), &job["session"]), "{shot}");
    let doubt = lines
        .iter()
        .find(|line| line["fields"]["message"].as_str().is_some_and(|m| m.contains("UNLIT_LISTN")));
    assert_eq!(doubt.unwrap_or_else(|| panic!("{log}"))["level"], "WARN");
}
