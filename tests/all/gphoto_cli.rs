//! gphoto2, the command line of the unmodified libgphoto2, as a client of the simulated camera.

use crate::usb_bench::iolibs;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::pair::Exposure;
use unlit::studio::View;
use unlit::studio::camera::{BodyOptions, CameraServer};

/// Gives a different blob for each frame and remembers the exposures.
pub(crate) struct Blobs {
    size: u32,
    pub(crate) exposures: Mutex<Vec<Exposure>>,
    pub(crate) frames: AtomicU32,
}

pub(crate) const SIZE: u32 = 1_300_000;

impl Blobs {
    pub(crate) fn new(size: u32) -> Arc<Self> {
        Arc::new(Self { size, exposures: Mutex::default(), frames: AtomicU32::new(0) })
    }
}

pub(crate) fn blob(size: u32, number: u32) -> Vec<u8> {
    (0..size).map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(number) >> 13) as u8).collect()
}

/// A JPEG's markers round nothing: libgphoto2 looks at no more.
pub(crate) const JPEG: &[u8] = &[0xff, 0xd8, 0xff, 0xe0, 1, 2, 3, 4, 0xff, 0xd9];

impl View for Blobs {
    fn expose(&self, exposure: &Exposure) -> Vec<u8> {
        self.exposures.lock().unwrap().push(*exposure);
        blob(self.size, self.frames.fetch_add(1, Ordering::SeqCst))
    }

    fn preview(&self) -> Vec<u8> {
        JPEG.to_vec()
    }
}

/// What a run of gphoto2 left.
pub(crate) struct Run {
    pub(crate) code: Option<i32>,
    pub(crate) text: String,
    pub(crate) files: BTreeMap<String, Vec<u8>>,
    pub(crate) took: Duration,
}

impl Run {
    /// The one file that was stored.
    pub(crate) fn file(&self) -> &[u8] {
        assert_eq!(self.files.len(), 1, "{:?}\n{}", self.files.keys(), self.text);
        self.files.values().next().unwrap()
    }
}

/// gphoto2 with a home of its own.
pub(crate) struct Cli {
    home: tempfile::TempDir,
    port: Vec<String>,
    bus: Option<std::path::PathBuf>,
}

impl Cli {
    /// For a camera on the network.
    pub(crate) fn network(server: &CameraServer) -> Self {
        let port = ["--port", &server.port(), "--camera", "PTP/IP Camera"].map(str::to_owned).to_vec();
        Self { home: tempfile::tempdir().unwrap(), port, bus: None }
    }

    /// For whatever is on a bus.
    pub(crate) fn usb(bus: &Path) -> Self {
        Self { home: tempfile::tempdir().unwrap(), port: Vec::new(), bus: Some(bus.to_owned()) }
    }

    /// For the camera at one address of a bus, as `usb:001,004`.
    pub(crate) fn usb_at(bus: &Path, port: &str) -> Self {
        Self { port: vec!["--port".into(), port.into()], ..Self::usb(bus) }
    }

    pub(crate) fn start(&self, arguments: &[&str]) -> Child {
        let mut command = Command::new("gphoto2");
        if let Some(bus) = &self.bus {
            command.env("IOLIBS", iolibs()).env("UNLIT_STUDIO_USB", bus);
        }
        command
            .args(&self.port)
            .args(arguments)
            .current_dir(self.home.path())
            .env("HOME", self.home.path())
            .env("LC_ALL", "C.UTF-8")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("gphoto2 is needed: apt install gphoto2")
    }

    pub(crate) fn run(&self, arguments: &[&str]) -> Run {
        let began = Instant::now();
        let output = self.start(arguments).wait_with_output().unwrap();
        let mut files = BTreeMap::new();
        for entry in std::fs::read_dir(self.home.path()).unwrap().map(Result::unwrap) {
            if entry.file_type().unwrap().is_file() {
                let name = entry.file_name().into_string().unwrap();
                files.insert(name, std::fs::read(entry.path()).unwrap());
                std::fs::remove_file(entry.path()).unwrap();
            }
        }
        let text = [output.stdout, output.stderr].map(|t| String::from_utf8_lossy(&t).into_owned()).concat();
        Run { code: output.status.code(), text, files, took: began.elapsed() }
    }

    /// One shot into memory, downloaded and deleted there.
    pub(crate) fn shoot(&self) -> Run {
        self.run(&["--set-config", "capturetarget=0", "--capture-image-and-download"])
    }

    /// What a setting shows.
    pub(crate) fn setting(&self, name: &str) -> String {
        let run = self.run(&["--get-config", name]);
        let current = run.text.lines().find_map(|line| line.strip_prefix("Current: "));
        current.unwrap_or_else(|| panic!("{name}: {}", run.text)).to_owned()
    }
}

pub(crate) fn start(options: &BodyOptions) -> (Arc<Blobs>, CameraServer) {
    let view = Blobs::new(SIZE);
    (view.clone(), CameraServer::start_with(view, options).unwrap())
}
