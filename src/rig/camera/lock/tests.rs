use super::*;
use std::collections::BTreeMap;

/// A camera's settings, as libgphoto2 lists them for bodies of three makers.
struct Camera {
    settings: BTreeMap<&'static str, Reading>,
    /// Settings whose writes are answered "fine" and not carried out.
    deaf: Vec<&'static str>,
    /// Settings whose writes are refused.
    refusing: Vec<&'static str>,
    written: Vec<(String, String)>,
}

impl Camera {
    /// Each line: name, value, choices; a value alone is read-only.
    fn new(lines: &[(&'static str, &str, &[&str])]) -> Self {
        let reading = |value: &str, choices: &[&str]| Reading {
            value: value.to_owned(),
            choices: choices.iter().map(|&c| c.to_owned()).collect(),
            readonly: choices.is_empty(),
        };
        let settings = lines.iter().map(|(name, value, choices)| (*name, reading(value, choices))).collect();
        Self { settings, deaf: Vec::new(), refusing: Vec::new(), written: Vec::new() }
    }

    fn with(mut self, name: &'static str, value: &str) -> Self {
        self.settings.get_mut(name).unwrap().value = value.to_owned();
        self
    }
}

impl Config for Camera {
    type Error = &'static str;

    fn read(&mut self, name: &str) -> Result<Option<Reading>, &'static str> {
        Ok(self.settings.get(name).cloned())
    }

    fn write(&mut self, name: &str, value: &str) -> Result<(), &'static str> {
        self.written.push((name.to_owned(), value.to_owned()));
        if self.refusing.contains(&name) {
            return Err("not set");
        }
        if !self.deaf.contains(&name) {
            self.settings.get_mut(name).unwrap().value = value.to_owned();
        }
        Ok(())
    }
}

fn canon() -> Camera {
    Camera::new(&[
        ("autoexposuremode", "Manual", &[]),
        ("shutterspeed", "1/125", &["1/60", "1/125", "1/250"]),
        ("aperture", "11", &["2.8", "8", "11"]),
        ("iso", "100", &["Auto", "100", "200"]),
        ("whitebalance", "Daylight", &["Auto", "Daylight", "Flash"]),
        ("focusmode", "Manual", &[]),
        ("drivemode", "Single", &["Single", "Continuous", "Timer 10 sec"]),
        ("aeb", "off", &["off", "+/- 1/3", "+/- 1"]),
        ("highisonr", "Off", &["Off", "Low", "Normal", "High"]),
        ("imageformat", "RAW", &["Large Fine JPEG", "RAW + Large Fine JPEG", "mRAW", "RAW"]),
        ("capturetarget", "Internal RAM", &["Internal RAM", "Memory card"]),
        ("autopoweroff", "0", &["0", "60"]),
        ("batterylevel", "75%", &[]),
    ])
}

fn nikon() -> Camera {
    Camera::new(&[
        ("expprogram", "M", &[]),
        ("shutterspeed", "0.0080s", &["0.0040s", "0.0080s"]),
        ("f-number", "f/8", &["f/8", "f/11"]),
        ("iso", "100", &["100", "200"]),
        ("autoiso", "On", &["On", "Off"]),
        ("whitebalance", "Automatic", &["Automatic", "Daylight", "Flash"]),
        ("focusmode2", "MF (selection)", &[]),
        ("capturemode", "Burst", &["Single Shot", "Burst", "Timer"]),
        ("longexpnr", "On", &["On", "Off"]),
        ("imagequality", "JPEG Fine", &["JPEG Basic", "JPEG Fine", "NEF (Raw)", "NEF+Fine"]),
        ("capturetarget", "Internal RAM", &["Internal RAM", "Memory card"]),
        ("batterylevel", "20%", &[]),
    ])
}

fn sony() -> Camera {
    Camera::new(&[
        ("expprogram", "M", &[]),
        ("shutterspeed", "1/500", &["1/250", "1/500"]),
        ("f-number", "f/2.8", &["f/2.8", "f/8"]),
        ("iso", "Auto ISO", &["Auto ISO", "100"]),
        ("whitebalance", "Daylight", &["Automatic", "Daylight"]),
        ("focusmode", "AF-S", &["Manual", "AF-S"]),
        ("capturemode", "Single Shot", &["Single Shot", "Continuous low speed"]),
        ("imagequality", "RAW+JPEG", &["Fine", "RAW", "RAW+JPEG"]),
        ("batterylevel", "80%", &[]),
    ])
}

fn report(camera: &mut Camera, maker: &str, model: &str) -> LockReport {
    go_through(camera, maker, model).unwrap()
}

#[track_caller]
fn item(report: &LockReport, name: &str) -> (LockState, String) {
    let item =
        report.items.iter().find(|i| i.name == name).unwrap_or_else(|| panic!("no {name}: {report:?}"));
    (item.state, item.sentence.clone())
}

#[test]
fn a_body_set_up_well_is_locked_without_a_touch() {
    let mut camera = canon();
    let report = report(&mut camera, "Canon Inc.", "Canon EOS 5DS");
    assert!(camera.written.is_empty(), "{:?}", camera.written);
    for state in [LockState::Wrong, LockState::Corrected, LockState::Warning] {
        assert!(report.sentences(state).is_empty(), "{report:?}");
    }
    // What no Canon tells is asked of the operator.
    for name in ["highlight_tone_priority", "mirror_lock_up", "long_exposure_noise_reduction"] {
        assert_eq!(item(&report, name).0, LockState::Unreadable);
    }
}

#[test]
fn what_may_be_set_is_set_and_what_may_not_is_told() {
    let mut camera = canon()
        .with("autoexposuremode", "AV")
        .with("focusmode", "One Shot")
        .with("drivemode", "Continuous")
        .with("imageformat", "Large Fine JPEG")
        .with("autopoweroff", "60")
        .with("whitebalance", "Auto");
    let report = report(&mut camera, "Canon Inc.", "Canon EOS 5DS");
    for name in ["drive", "file_format", "auto_power_off", "white_balance"] {
        assert_eq!(item(&report, name).0, LockState::Corrected, "{report:?}");
    }
    for name in ["mode", "focus"] {
        assert_eq!(item(&report, name).0, LockState::Wrong, "only a hand can change that: {report:?}");
    }
    assert!(item(&report, "mode").1.contains("AV") && item(&report, "focus").1.contains("MF"));
    assert_eq!(camera.settings["imageformat"].value, "RAW");
}

#[test]
fn raw_with_jpeg_is_left_as_it_is_and_small_raw_is_not() {
    let both = "RAW + Large Fine JPEG";
    let mut camera = canon().with("imageformat", both);
    assert_eq!(item(&report(&mut camera, "Canon", "x"), "file_format").0, LockState::Locked);
    let mut camera = canon().with("imageformat", "mRAW");
    assert_eq!(item(&report(&mut camera, "Canon", "x"), "file_format").0, LockState::Corrected);
}

#[test]
fn lossy_raw_of_a_canon_is_set_to_raw_or_warned_about() {
    let mut camera = canon().with("imageformat", "cRAW");
    assert_eq!(item(&report(&mut camera, "Canon", "x"), "raw_compression").0, LockState::Corrected);
    assert_eq!(camera.settings["imageformat"].value, "RAW");
    let mut camera = canon().with("imageformat", "cRAW + Large Fine JPEG");
    camera.deaf.push("imageformat");
    let report = report(&mut camera, "Canon", "x");
    let (state, sentence) = item(&report, "raw_compression");
    assert_eq!(state, LockState::Warning);
    assert!(sentence.contains("lossy"), "{sentence}");
    assert!(report.sentences(LockState::Wrong).is_empty(), "pairs can be shot: {report:?}");
}

#[test]
fn a_camera_that_does_not_obey_is_found_out_by_reading_back() {
    let mut camera = canon().with("drivemode", "Continuous");
    camera.deaf.push("drivemode");
    let (state, sentence) = item(&report(&mut camera, "Canon", "Canon EOS 5DS"), "drive");
    assert_eq!(state, LockState::Wrong);
    assert!(sentence.contains("does not take"), "{sentence}");
    let mut camera = canon().with("autoexposuremode", "AV");
    camera.settings.get_mut("autoexposuremode").unwrap().readonly = false;
    camera.refusing.push("autoexposuremode");
    camera.settings.get_mut("autoexposuremode").unwrap().choices = vec!["AV".into(), "Manual".into()];
    assert_eq!(item(&report(&mut camera, "Canon", "Canon EOS 5DS"), "mode").0, LockState::Wrong);
}

#[test]
fn a_nikon_is_read_by_its_own_names() {
    let mut camera = nikon();
    let report = report(&mut camera, "Nikon Corporation", "D810");
    for name in ["auto_iso", "drive", "long_exposure_noise_reduction", "file_format", "white_balance"] {
        assert_eq!(item(&report, name).0, LockState::Corrected, "{name}: {report:?}");
    }
    assert_eq!(camera.settings["imagequality"].value, "NEF (Raw)");
    for name in ["mode", "shutter", "aperture", "focus"] {
        assert_eq!(item(&report, name).0, LockState::Locked, "{name}: {report:?}");
    }
    assert_eq!(item(&report, "battery").0, LockState::Warning);
    assert_eq!(item(&report, "lighting_optimiser").0, LockState::Unreadable);
}

#[test]
fn a_sony_too_and_it_is_warned_about_x_sync_and_asked_about_its_shutter() {
    let mut camera = sony();
    let report = report(&mut camera, "Sony Corporation", "ILCE-7RM4");
    assert_eq!(item(&report, "iso").0, LockState::Wrong, "auto ISO has no obvious value to be set to");
    assert_eq!(item(&report, "focus").0, LockState::Corrected);
    let (state, sentence) = item(&report, "x_sync");
    assert!(state == LockState::Warning && sentence.contains("1/250"), "{sentence}");
    assert_eq!(item(&report, "shutter_type").0, LockState::Unreadable);
    assert!(!report.items.iter().any(|i| i.name == "wide_aperture"), "that is Canon's way");
}

#[test]
fn wide_apertures_of_a_canon_are_warned_about_with_the_reason() {
    let mut camera = canon().with("aperture", "2.8");
    let (state, sentence) = item(&report(&mut camera, "Canon Inc.", "Canon EOS 5DS"), "wide_aperture");
    assert_eq!(state, LockState::Warning);
    assert!(sentence.contains("multiply raw values"), "{sentence}");
}

#[test]
fn a_lens_without_contacts_is_asked_about() {
    let mut camera = canon().with("aperture", "implicit auto");
    assert_eq!(
        item(&report(&mut camera, "Canon Inc.", "Canon EOS 5DS"), "aperture").0,
        LockState::Unreadable
    );
}

#[test]
fn a_body_of_another_maker_is_asked_about_what_it_does_not_tell() {
    let mut camera = Camera::new(&[("iso", "200", &["100", "200"])]);
    let report = report(&mut camera, "FUJIFILM", "X-T4");
    assert_eq!(item(&report, "iso").0, LockState::Locked);
    assert_eq!(item(&report, "mode").0, LockState::Unreadable);
}
