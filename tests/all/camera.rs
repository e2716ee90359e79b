//! The real libgphoto2, in its child process, against the simulated camera.

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::capture::{FlashKind, RigSource};
use unlit::pair::{Dial, Exposure};
use unlit::rig::camera::{Deadlines, HostedCamera, Launch, Target, list_with};
use unlit::rig::flash::SerialFlash;
use unlit::rig::{Camera, CameraError, LockState};
use unlit::studio::View;
use unlit::studio::camera::{BodyOptions, CameraServer, Drive, Fault, Files, Focus, Mode};
use unlit::units::{FNumber, Iso, Seconds};

/// Gives a different blob for each frame, longer than one download chunk, and remembers the exposures.
#[derive(Default)]
pub(crate) struct Blobs {
    pub(crate) frames: AtomicU32,
    pub(crate) exposures: Mutex<Vec<Exposure>>,
}

pub(crate) fn blob(number: u32) -> Vec<u8> {
    (0..1_300_000 + number)
        .map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(number) >> 13) as u8)
        .collect()
}

/// A JPEG's markers round nothing: libgphoto2 looks at no more.
pub(crate) const PREVIEW: &[u8] = &[0xff, 0xd8, 0xff, 0xe0, 1, 2, 3, 4, 0xff, 0xd9];

impl View for Blobs {
    fn expose(&self, exposure: &Exposure) -> Vec<u8> {
        self.exposures.lock().unwrap().push(*exposure);
        blob(self.frames.fetch_add(1, Ordering::SeqCst))
    }

    fn preview(&self) -> Vec<u8> {
        PREVIEW.to_vec()
    }
}

pub(crate) struct Studio {
    pub(crate) view: Arc<Blobs>,
    pub(crate) server: CameraServer,
}

impl Studio {
    pub(crate) fn new() -> Self {
        let view = Arc::new(Blobs::default());
        Self { server: CameraServer::start(view.clone()).unwrap(), view }
    }

    /// A body that stands otherwise.
    pub(crate) fn with(options: &BodyOptions) -> Self {
        let view = Arc::new(Blobs::default());
        Self { server: CameraServer::start_with(view.clone(), options).unwrap(), view }
    }

    pub(crate) fn camera(&self) -> HostedCamera {
        self.camera_with(Deadlines::default())
    }

    pub(crate) fn camera_with(&self, deadlines: Deadlines) -> HostedCamera {
        open(&self.server.port(), deadlines).unwrap()
    }

    pub(crate) fn frames(&self) -> u32 {
        self.view.frames.load(Ordering::SeqCst)
    }
}

pub(crate) fn launch() -> Launch {
    Launch::new(program())
}

pub(crate) fn open(port: &str, deadlines: Deadlines) -> Result<HostedCamera, CameraError> {
    HostedCamera::open_with(&launch(), Some(port), deadlines, Target::Memory)
}

/// The drivers that a photographer has, on simulated devices: libgphoto2 in its host at `port`, and the flash controller at
/// `device`. The camera has `patience` for each call.
pub(crate) fn rig(port: String, device: &Path, patience: Duration) -> RigSource {
    let deadlines = Deadlines { open: Duration::from_secs(20), shot: patience, other: patience };
    let device = device.to_owned();
    RigSource {
        camera: Box::new(move |_| Ok(Box::new(open(&port, deadlines)?))),
        cameras: Box::new(|| Ok(Vec::new())),
        flash: Box::new(move || Ok(FlashKind::Controller(Box::new(SerialFlash::open(&device)?)))),
    }
}

pub(crate) fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_unlit"))
}

#[test]
fn the_camera_introduces_itself_and_tells_its_settings() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    let info = camera.info().unwrap();
    assert_eq!((info.model.as_str(), info.port), ("Canon EOS 5DS", studio.server.port()));
    assert_eq!(info.serial.as_deref(), Some("000000000042"));
    let settings = camera.settings().unwrap();
    assert_eq!(settings.shutter, Some(Seconds(1.0 / 125.0)));
    assert_eq!(settings.aperture, Some(FNumber(11.0)));
    assert_eq!(settings.iso, Some(Iso(100.0)));
    assert_eq!(settings.exposure_program.as_deref(), Some("Manual"));
    assert_eq!(settings.make.as_deref(), Some("Canon Inc."));
    assert_eq!(studio.frames(), 0, "asking must not release the shutter");
}

#[test]
fn shots_in_a_row_bring_each_frame_once_and_whole() {
    let studio = Studio::new();
    let began = Instant::now();
    let mut camera = studio.camera();
    eprintln!("opened in {:?}", began.elapsed());
    for number in 0..3 {
        let began = Instant::now();
        let shot = camera.shoot().unwrap();
        eprintln!("shot {number}: {} bytes in {:?}: {:?}", shot.raw.bytes.len(), began.elapsed(), shot.times);
        assert!(shot.raw.bytes == blob(number), "frame {number} is not what the sensor gave");
        assert!(shot.raw.name.ends_with(".cr2"), "{}", shot.raw.name);
        assert_eq!(studio.frames(), number + 1);
    }
    let began = Instant::now();
    drop(camera);
    eprintln!("closed in {:?}", began.elapsed());
}

#[test]
fn a_turned_dial_shows_in_the_exposure() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    camera.set(Dial::Shutter(Seconds(1.0 / 60.0))).unwrap();
    camera.set(Dial::Aperture(FNumber(8.0))).unwrap();
    camera.set(Dial::Iso(Iso(400.0))).unwrap();
    camera.shoot().unwrap();
    let wanted = Exposure { shutter: Seconds(1.0 / 60.0), aperture: FNumber(8.0), iso: Iso(400.0) };
    assert_eq!(*studio.view.exposures.lock().unwrap(), [wanted]);
    let settings = camera.settings().unwrap();
    assert_eq!((settings.shutter, settings.iso), (Some(Seconds(1.0 / 60.0)), Some(Iso(400.0))));
}

#[test]
fn a_value_that_is_on_no_dial_is_refused_in_words() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    let error = camera.set(Dial::Iso(Iso(123_456.0))).unwrap_err();
    assert!(matches!(&error, CameraError::Refused { .. }), "{error}");
    assert!(error.to_string().contains("6400"), "the message names what there is: {error}");
    let offered = camera.offered().unwrap();
    assert!(offered.shutters.contains(&Seconds(1.0 / 125.0)) && offered.isos.contains(&Iso(6400.0)));
    assert!(offered.apertures.contains(&FNumber(5.6)));
}

#[test]
fn a_live_picture_comes_and_the_next_shot_is_unharmed() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    assert_eq!(camera.preview().unwrap(), PREVIEW);
    assert_eq!(camera.preview().unwrap(), PREVIEW);
    assert!(camera.shoot().unwrap().raw.bytes == blob(0));
}

#[test]
fn a_stalled_camera_misses_its_deadline_and_works_again_once_mended() {
    let studio = Studio::new();
    let mut camera = studio.camera_with(Deadlines { shot: Duration::from_secs(2), ..Deadlines::default() });
    camera.settings().unwrap();
    studio.server.fault(Fault::Stall);
    let began = Instant::now();
    let error = camera.shoot().unwrap_err();
    assert!(matches!(error, CameraError::Deadline { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(4), "took {:?}", began.elapsed());
    assert_eq!(studio.frames(), 0);
    studio.server.mend();
    assert!(camera.shoot().unwrap().raw.bytes == blob(0));
    assert_eq!(studio.frames(), 1, "the shot that stalled is not made up for");
}

#[test]
fn a_silence_that_the_library_notices_itself_is_a_missed_deadline_too() {
    let studio = Studio::new();
    let mut camera = studio.camera_with(Deadlines { other: Duration::from_secs(60), ..Deadlines::default() });
    studio.server.fault(Fault::Stall);
    let error = camera.settings().unwrap_err();
    let CameraError::Deadline { deadline, .. } = &error else { panic!("{error}") };
    assert!(*deadline < Duration::from_secs(40), "it was the library that gave up: {error}");
    assert_eq!(camera.host_id(), None);
    studio.server.mend();
    assert_eq!(camera.settings().unwrap().iso, Some(Iso(100.0)));
}

#[test]
fn a_host_whose_driver_died_ends_even_inside_a_library_that_spins() {
    use std::io::Write;
    let studio = Studio::new();
    studio.server.fault(Fault::NoRoom);
    let home = tempfile::tempdir().unwrap();
    let (mut ours, theirs) = std::os::unix::net::UnixStream::pair().unwrap();
    let mut host = std::process::Command::new(program())
        .args(["camera-host", "--port", &studio.server.port()])
        .env("HOME", home.path())
        .stdin(std::os::fd::OwnedFd::from(theirs))
        .spawn()
        .unwrap();
    let open = br#""open""#;
    let length = u32::try_from(open.len()).unwrap();
    ours.write_all(&[&length.to_le_bytes()[..], &0_u64.to_le_bytes()[..], open].concat()).unwrap();
    ours.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    let silence = std::io::Read::read(&mut ours, &mut [0]).unwrap_err();
    assert_eq!(silence.kind(), std::io::ErrorKind::WouldBlock, "the library should spin by now");
    drop(ours);
    let deadline = Instant::now() + Duration::from_secs(15);
    while host.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            host.kill().unwrap();
            panic!("the host outlives its driver");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_library_that_spins_for_ever_is_killed_at_the_deadline() {
    let studio = Studio::new();
    studio.server.fault(Fault::NoRoom);
    let deadlines = Deadlines { open: Duration::from_secs(2), ..Deadlines::default() };
    let began = Instant::now();
    let error = open(&studio.server.port(), deadlines).err().unwrap();
    assert!(matches!(error, CameraError::Deadline { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_secs(4), "took {:?}", began.elapsed());
    studio.server.mend();
    assert!(studio.camera().shoot().unwrap().raw.bytes == blob(0));
}

#[test]
fn a_killed_host_is_started_again_by_the_next_shot() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    camera.shoot().unwrap();
    let id = camera.host_id().unwrap();
    assert!(std::process::Command::new("kill").args(["-9", &id.to_string()]).status().unwrap().success());
    assert!(camera.shoot().unwrap().raw.bytes == blob(1));
    assert_ne!(camera.host_id(), Some(id));
}

#[test]
fn a_busy_camera_is_asked_again() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    studio.server.fault(Fault::BusyOnce);
    assert!(camera.shoot().unwrap().raw.bytes == blob(0));
    assert_eq!(studio.frames(), 1);
}

#[test]
fn a_link_lost_in_a_download_fails_that_shot_and_no_other() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    studio.server.fault(Fault::DropInDownload);
    let error = camera.shoot().unwrap_err();
    eprintln!("{error}");
    assert!(matches!(error, CameraError::Lost { .. } | CameraError::Deadline { .. }), "{error}");
    assert!(camera.shoot().unwrap().raw.bytes == blob(1), "never the frame of the shot before");
}

#[test]
fn a_port_where_nobody_listens_is_not_found() {
    let studio = Studio::new();
    let port = studio.server.port();
    drop(studio);
    let error = open(&port, Deadlines::default()).err().unwrap();
    assert!(matches!(&error, CameraError::NotFound { hint } if hint.contains(&port)), "{error}");
}

#[test]
fn cameras_are_listed_by_a_process_that_goes_away() {
    for camera in list_with(&launch()).unwrap() {
        assert!(camera.port.contains(':'), "{camera:?}");
    }
}

#[test]
fn a_host_started_by_hand_says_who_starts_it() {
    let run = std::process::Command::new(program())
        .arg("camera-host")
        .stdin(std::process::Stdio::null())
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&run.stderr).contains("started by unlit itself"));
}

#[test]
fn both_files_of_one_release_stay_together_whichever_comes_first() {
    for jpeg_first in [false, true] {
        let options = BodyOptions { files: Files::RawAndJpeg, jpeg_first, ..BodyOptions::default() };
        let studio = Studio::with(&options);
        let mut camera = studio.camera();
        for number in 0..2 {
            let shot = camera.shoot().unwrap();
            assert!(shot.raw.bytes == blob(number), "jpeg first {jpeg_first}: not the raw of this release");
            let jpeg = shot.jpeg.expect("the companion belongs to the shot");
            assert_eq!(jpeg.bytes, PREVIEW);
            assert_ne!(jpeg.name, shot.raw.name);
            assert_eq!(studio.server.frames_waiting(), 0);
        }
    }
}

#[test]
fn frames_on_the_card_are_fetched_once_and_stay_there() {
    let studio = Studio::with(&BodyOptions { card_room: Some(20), ..BodyOptions::default() });
    let port = studio.server.port();
    let mut camera =
        HostedCamera::open_with(&launch(), Some(&port), Deadlines::default(), Target::Card).unwrap();
    for number in 0..3 {
        let shot = camera.shoot().unwrap();
        eprintln!("card shot {number}: {} {:?}", shot.raw.name, shot.times);
        assert!(shot.raw.bytes == blob(number));
    }
    assert_eq!(studio.server.files_on_card(), 3, "the photographer's own copies");
    studio.server.fault(Fault::CutDownload { missing: 4096 });
    assert!(camera.shoot().unwrap().raw.bytes == blob(3), "what is still on the card is fetched again");
    assert_eq!(studio.frames(), 4);
}

#[test]
fn the_lock_of_a_body_set_up_well_holds_and_asks_what_no_body_tells() {
    let studio = Studio::new();
    let report = studio.camera().lock().unwrap();
    eprintln!("{report:#?}");
    for state in [LockState::Wrong, LockState::Corrected] {
        assert!(report.sentences(state).is_empty(), "{:?}", report.sentences(state));
    }
    for name in
        ["mode", "shutter", "aperture", "iso", "focus", "drive", "bracketing", "file_format", "target"]
    {
        let item = report.items.iter().find(|i| i.name == name).unwrap();
        assert_eq!(item.state, LockState::Locked, "{item:?}");
    }
    assert!(report.sentences(LockState::Unreadable).iter().any(|q| q.contains("Mirror lockup")));
}

#[test]
fn the_lock_sets_what_may_be_set_and_says_what_only_a_hand_can_change() {
    let options = BodyOptions {
        mode: Mode::Aperture,
        focus: Focus::OneShot,
        drive: Drive::Continuous,
        files: Files::Jpeg,
        white_balance: 0,
        auto_power_off: 60,
        noise_reduction: 2,
        bracketing: 8,
        ..BodyOptions::default()
    };
    let studio = Studio::with(&options);
    let mut camera = studio.camera();
    let report = camera.lock().unwrap();
    eprintln!("{report:#?}");
    let state = |name: &str| report.items.iter().find(|i| i.name == name).unwrap().state;
    for name in ["mode", "focus"] {
        assert_eq!(state(name), LockState::Wrong, "{name}");
    }
    for name in
        ["drive", "file_format", "white_balance", "auto_power_off", "high_iso_noise_reduction", "bracketing"]
    {
        assert_eq!(state(name), LockState::Corrected, "{name}");
    }
    studio.server.turn_mode_dial(Mode::Manual);
    studio.server.switch_focus(Focus::Manual);
    let again = camera.lock().unwrap();
    assert!(again.sentences(LockState::Wrong).is_empty(), "{:?}", again.sentences(LockState::Wrong));
    assert!(camera.shoot().unwrap().raw.bytes == blob(0));
}

#[test]
fn a_lens_that_finds_no_focus_is_told_by_its_name() {
    let studio = Studio::with(&BodyOptions { focus: Focus::OneShot, ..BodyOptions::default() });
    let mut camera = studio.camera();
    studio.server.fault(Fault::NoFocus);
    let error = camera.shoot().unwrap_err();
    assert!(matches!(error, CameraError::NoFocus(_)), "{error}");
    assert!(camera.shoot().unwrap().raw.bytes == blob(0), "the camera stays open");
}

/// What the driver adds to each shot beyond what the camera itself takes.
#[test]
fn the_driver_costs_little_beyond_the_cameras_own_time() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    let mut costs: Vec<Duration> = (0..10)
        .map(|_| {
            let times = camera.shoot().unwrap().times;
            times.total - times.exposing - times.transfer - times.until_ready
        })
        .collect();
    costs.sort();
    eprintln!("driver's own cost a shot: median {:.1?}, worst {:.1?}", costs[5], costs[9]);
    assert!(costs[5] < Duration::from_millis(100), "{costs:?}");
}
