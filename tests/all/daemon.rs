//! The real daemon in a process of its own, with its simulated studio or without: started, asked, killed, stopped.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// How long anything may take before the test gives it up.
pub(crate) const PATIENCE: Duration = Duration::from_secs(300);

/// A daemon; killed when dropped.
pub(crate) struct Daemon {
    process: Child,
    pub(crate) url: String,
    pub(crate) port: u16,
    /// What it prints after its address.
    pub(crate) says: BufReader<ChildStdout>,
    home: PathBuf,
}

/// A client's way to the daemon; fails where the daemon is gone.
#[derive(Clone)]
pub(crate) struct Client {
    url: String,
    agent: ureq::Agent,
}

pub(crate) type Answer<T> = Result<T, ureq::Error>;

impl Daemon {
    /// With its studio. Serves `home/sessions` on a port of its own; `home` marks all its processes.
    pub(crate) fn start(home: &Path) -> Self {
        Self::start_with(home, &[])
    }

    /// With its studio and these options.
    pub(crate) fn start_with(home: &Path, options: &[&str]) -> Self {
        Self::launch(home, |command| command.arg("--studio").args(options))
    }

    /// With the options and the environment that `set` gives it.
    pub(crate) fn launch(home: &Path, set: impl FnOnce(&mut Command) -> &mut Command) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_unlit"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--sessions"]).arg(home.join("sessions"));
        let mut process = set(&mut command).env("HOME", home).stdout(Stdio::piped()).spawn().unwrap();
        let mut says = BufReader::new(process.stdout.take().unwrap());
        let line = hear(&mut says, "http://");
        let at = line.split_whitespace().find(|word| word.starts_with("http://")).unwrap();
        let url = at.trim_end_matches('/').to_owned();
        let port = url.rsplit(':').next().unwrap().parse().unwrap_or_else(|_| panic!("no port in {line:?}"));
        Self { process, url, port, says, home: home.to_owned() }
    }

    pub(crate) fn client(&self) -> Client {
        let agent = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).build().into();
        Client { url: self.url.clone(), agent }
    }

    /// Descriptors that it has open.
    pub(crate) fn descriptors(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/fd", self.id())).unwrap().count()
    }

    /// `kill -9`; returns when it and all its children are gone.
    pub(crate) fn kill(mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
        self.expect_no_orphans();
    }

    pub(crate) fn signal(&self, name: &str) {
        let sent = Command::new("kill").arg(format!("-{name}")).arg(self.process.id().to_string()).status();
        assert!(sent.unwrap().success());
    }

    pub(crate) fn id(&self) -> u32 {
        self.process.id()
    }

    /// Waits until it and all its children have ended by themselves.
    pub(crate) fn ended(mut self, patience: Duration) -> ExitStatus {
        let status = self.over(patience);
        self.expect_no_orphans();
        status
    }

    /// Waits until it has ended by itself, whatever became of its children.
    pub(crate) fn over(&mut self, patience: Duration) -> ExitStatus {
        let deadline = Instant::now() + patience;
        loop {
            if let Some(status) = self.process.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < deadline, "the daemon has not ended within {patience:?}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Asks it to stop, and expects it to.
    pub(crate) fn stop(self) {
        self.signal("TERM");
        let status = self.ended(Duration::from_secs(30));
        assert_eq!(status.code(), Some(0), "{status}");
    }

    pub(crate) fn expect_no_orphans(&self) {
        let mark = format!("HOME={}\0", self.home.display());
        let ours = || -> Vec<String> {
            std::fs::read_dir("/proc")
                .unwrap()
                .flatten()
                .filter(|entry| {
                    let environment = std::fs::read(entry.path().join("environ")).unwrap_or_default();
                    environment.windows(mark.len()).any(|at| at == mark.as_bytes())
                })
                .map(|entry| {
                    std::fs::read_to_string(entry.path().join("cmdline"))
                        .unwrap_or_default()
                        .replace('\0', " ")
                })
                .collect()
        };
        let deadline = Instant::now() + Duration::from_secs(15);
        while !ours().is_empty() {
            assert!(Instant::now() < deadline, "processes outlive their daemon: {:?}", ours());
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.process.kill().ok();
        self.process.wait().ok();
    }
}

impl Client {
    pub(crate) fn path(&self, path: &str) -> String {
        format!("{}/api/v1{path}", self.url)
    }

    pub(crate) fn get(&self, path: &str) -> Answer<Value> {
        self.agent.get(self.path(path)).call()?.body_mut().read_json()
    }

    pub(crate) fn post(&self, path: &str, body: Value) -> Answer<Value> {
        self.agent.post(self.path(path)).send_json(body)?.body_mut().read_json()
    }

    /// The status and the body of any answer, good or bad.
    pub(crate) fn ask(&self, method: &str, path: &str, body: Option<Value>) -> Answer<(u16, Value)> {
        // An empty body has a type too, or else it could be anybody's.
        let request = ureq::http::Request::builder()
            .method(method)
            .uri(self.path(path))
            .header("Content-Type", "application/json")
            .body(body.map(|body| body.to_string()).unwrap_or_default())?;
        let config = self.agent.configure_request(request).http_status_as_error(false);
        let mut answer = self.agent.run(config.build())?;
        let text = answer.body_mut().read_to_string()?;
        Ok((answer.status().as_u16(), serde_json::from_str(&text).unwrap_or(Value::String(text))))
    }

    pub(crate) fn stage(&self, order: Value) -> Answer<()> {
        self.agent.put(self.path("/studio/stage")).send_json(order).map(drop)
    }

    /// The job once it has ended.
    pub(crate) fn ended(&self, mut job: Value) -> Answer<Value> {
        let path = job["url"].as_str().unwrap().trim_start_matches("/api/v1").to_owned();
        let deadline = Instant::now() + PATIENCE;
        while is_open(&job) {
            assert!(Instant::now() < deadline, "{job}");
            std::thread::sleep(Duration::from_millis(20));
            job = self.get(&path)?;
        }
        Ok(job)
    }

    /// What came out of a job that must end well.
    pub(crate) fn done(&self, job: Value) -> Value {
        let job = self.ended(job).unwrap();
        assert_eq!(job["state"], "done", "{job}");
        job["result"].clone()
    }

    /// Waits until no job waits or runs, and gives all jobs.
    pub(crate) fn at_rest(&self) -> Vec<Value> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let jobs = self.get("/jobs").unwrap();
            let jobs = jobs.as_array().unwrap();
            if !jobs.iter().any(is_open) {
                return jobs.clone();
            }
            assert!(Instant::now() < deadline, "{jobs:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// A session with scene and flash calibration, so that processing starts by itself.
    pub(crate) fn prepare(&self, session: &str, geometry: &Path) {
        self.post("/sessions", json!({ "name": session })).unwrap();
        let form = ureq::unversioned::multipart::Form::new()
            .file("cameras", geometry.join("cameras.xml"))
            .unwrap()
            .file("mesh", geometry.join("object.obj"))
            .unwrap()
            .file("mesh", geometry.join("floor.obj"))
            .unwrap()
            .text("unit", "m");
        let path = self.path(&format!("/sessions/{session}/scene"));
        let scene = self.agent.post(path).send(form).unwrap().body_mut().read_json().unwrap();
        self.done(scene);
        for distance in [0.7, 1.0, 1.4] {
            self.stage(json!({ "card_distance_m": distance })).unwrap();
            let path = format!("/sessions/{session}/calibration/flash/shots");
            let shot = self.post(&path, json!({ "distance_m": distance })).unwrap();
            assert_eq!(self.done(shot)["reasons"], json!([]));
        }
        let fit = json!({ "target_reflectance": 0.94, "ring_radii": [0.035, 0.085] });
        let fit = self.post(&format!("/sessions/{session}/calibration/flash"), fit).unwrap();
        self.done(fit);
    }
}

/// The next line that holds `part`.
pub(crate) fn hear(says: &mut impl BufRead, part: &str) -> String {
    loop {
        let mut line = String::new();
        assert!(says.read_line(&mut line).unwrap() > 0, "it ended before it said {part:?}");
        if line.contains(part) {
            return line;
        }
    }
}

/// Whether a job waits or runs.
pub(crate) fn is_open(job: &Value) -> bool {
    ["queued", "running"].contains(&job["state"].as_str().unwrap())
}
