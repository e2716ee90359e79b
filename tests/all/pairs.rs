//! Pairs as files: the bird bath's good and bad ones through checks, import and command line.

use crate::samples::shared;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use unlit::codec::raw;
use unlit::pair::{Expected, Judgement, Limits, Reason, ReasonCode, Stop, Verdict};
use unlit::pipeline::pairs::{self, ImportError};
use unlit::pipeline::scale::SessionScale;
use unlit::progress::Progress;
use unlit::session::{Session, SessionError};

fn birdbath(relative: &str) -> PathBuf {
    shared("scenes/birdbath").join(relative)
}

fn judged_against(earlier: &[Stop], off: &str, on: &str) -> Judgement {
    let earlier = earlier.to_vec();
    let expected = Expected { earlier: Some(&earlier), ..Expected::default() };
    let (off, on) = (raw::read(&birdbath(off)), raw::read(&birdbath(on)));
    pairs::judge(&off, &on, &expected, &SessionScale::default(), &Limits::default())
}

fn judged(off: &str, on: &str) -> Vec<Reason> {
    judged_against(&[], off, on).reasons
}

fn codes(reasons: &[Reason]) -> Vec<ReasonCode> {
    reasons.iter().map(|r| r.code).collect()
}

#[test]
fn every_pair_of_the_bird_bath_is_accepted_also_when_held_against_all_others() {
    let names: Vec<[String; 2]> =
        (0..24).map(|i| ["off", "on"].map(|f| format!("photos/{f}/{i:03}.dng"))).collect();
    let mut stops = vec![];
    for [off, on] in &names {
        let judgement = judged_against(&[], off, on);
        assert_eq!(judgement.reasons, [], "{on}");
        stops.push(judgement.stop.unwrap());
    }
    let limits = Limits::default();
    for (i, [off, on]) in names.iter().enumerate() {
        let others: Vec<Stop> =
            stops.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, s)| s.clone()).collect();
        assert!(!others.iter().any(|other| other.is_same_stop(&stops[i], &limits)), "{on}");
        assert_eq!(judged_against(&others, off, on).reasons, [], "{on}");
    }
}

#[test]
fn a_pair_that_went_wrong_is_rejected_for_the_right_reason_alone() {
    for (name, expected) in [
        ("good", vec![]),
        ("misfire", vec![ReasonCode::Misfire]),
        ("overexposed", vec![ReasonCode::Overexposed]),
        ("settings_changed", vec![ReasonCode::SettingsChanged]),
        ("moved", vec![ReasonCode::Moved]),
        ("ambient_changed", vec![ReasonCode::AmbientChanged]),
    ] {
        let reasons = judged(&format!("bad/{name}_off.dng"), &format!("bad/{name}_on.dng"));
        assert_eq!(codes(&reasons), expected, "{name}: {reasons:#?}");
    }
    let cut = judged("bad/good_off.dng", "bad/truncated.dng");
    assert_eq!(codes(&cut), [ReasonCode::Truncated]);
    let alien = judged("bad/not_a_raw.dng", "bad/good_on.dng");
    assert_eq!(codes(&alien), [ReasonCode::Unreadable]);
    assert!(alien[0].sentence.contains("not_a_raw.dng"), "{}", alien[0].sentence);
}

#[test]
fn a_weak_flash_is_told_from_the_same_stop_shot_before() {
    let earlier: Vec<Stop> = (0..24)
        .filter_map(|i| {
            judged_against(&[], &format!("photos/off/{i:03}.dng"), &format!("photos/on/{i:03}.dng")).stop
        })
        .collect();
    for (name, expected) in [
        ("weak", vec![ReasonCode::Weak]),
        ("good", vec![]),
        ("ambient_changed", vec![ReasonCode::AmbientChanged]),
        ("moved", vec![ReasonCode::Moved]),
        ("overexposed", vec![ReasonCode::Overexposed]),
    ] {
        let judgement =
            judged_against(&earlier, &format!("bad/{name}_off.dng"), &format!("bad/{name}_on.dng"));
        assert_eq!(codes(&judgement.reasons), expected, "{name}: {:#?}", judgement.reasons);
        let same = |stop: &Stop| judgement.stop.as_ref().unwrap().is_same_stop(stop, &Limits::default());
        let known: Vec<usize> = (0..24).filter(|&i| same(&earlier[i])).collect();
        let alike = |i: &usize| judgement.stop.as_ref().unwrap().key().may_match(&earlier[*i].key());
        assert!(known.iter().all(alike), "{name}: the gist passes over a match");
        assert!((0..24).filter(alike).count() < 6, "{name}: the gist tells nothing");
        assert_eq!(known, [12], "{name}");
    }
}

fn unlit(arguments: &[&str], home: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).env("HOME", home).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Folders `off` and `on` with three pairs, one of them a misfire, a lonely file and a sidecar.
fn card(home: &Path) -> (String, String) {
    let (off, on) = (home.join("off"), home.join("on"));
    std::fs::create_dir_all(&off).unwrap();
    std::fs::create_dir_all(&on).unwrap();
    let copy = |from: &str, to: PathBuf| std::fs::write(to, std::fs::read(birdbath(from)).unwrap()).unwrap();
    copy("photos/off/003.dng", off.join("003.dng"));
    copy("photos/on/003.dng", on.join("003.DNG"));
    copy("bad/misfire_off.dng", off.join("dud.dng"));
    copy("bad/misfire_on.dng", on.join("dud.dng"));
    copy("bad/good_off.dng", off.join("torn.dng"));
    copy("bad/truncated.dng", on.join("torn.dng"));
    copy("bad/good_off.dng", off.join("lonely.dng"));
    std::fs::write(on.join("003.xmp"), b"<x/>").unwrap();
    (off.display().to_string(), on.display().to_string())
}

#[test]
fn import_stores_all_pairs_says_what_is_wrong_and_ends_with_3() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("bath").display().to_string();
    let (off, on) = card(home.path());
    let made = unlit(&["new", &session], home.path());
    assert!(made.status.success(), "{}", text(&made.stderr));
    let arguments = ["import", "pairs", &session, "--off", &off, "--on", &on];
    let imported = unlit(&arguments, home.path());
    let said = text(&imported.stdout);
    assert_eq!(imported.status.code(), Some(3), "{said}{}", text(&imported.stderr));
    assert!(said.contains("0001 003 accepted\n"), "{said}");
    assert!(said.contains("0002 dud rejected: The light rose in"), "{said}");
    assert!(said.contains("0003 torn rejected: ") && said.contains("is cut short"), "{said}");
    assert!(said.contains("lonely.dng: no partner"), "{said}");

    let opened = Session::open(Path::new(&session)).unwrap();
    let records = opened.pairs().unwrap();
    assert_eq!(records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["003", "dud", "torn"]);
    assert_eq!(records[0].verdict, Verdict::Accepted);
    assert_eq!(records[2].reasons[0].code, ReasonCode::Truncated);
    assert_eq!(records[0].on.file, "on.dng");
    assert_eq!(records[0].on.original_name, "003.DNG");
    assert_eq!(records[2].on.settings.iso.map(|i| i.0), Some(100.0));
    assert!(records.iter().all(|r| opened.verify_pair(r.number).is_empty()));
    drop(opened);

    let again = unlit(&arguments, home.path());
    assert!(
        text(&again.stdout).contains("0 pairs stored, 3 there already, 2 rejected"),
        "{}",
        text(&again.stdout)
    );
}

/// Folders `off` and `on` with one pair of the bird bath under `name`.
fn one_pair(home: &Path, name: &str, from: [&str; 2]) -> [String; 2] {
    let folders = ["off", "on"].map(|frame| home.join(name).join(frame));
    for (folder, from) in folders.iter().zip(from) {
        std::fs::create_dir_all(folder).unwrap();
        std::fs::write(folder.join(format!("{name}.dng")), std::fs::read(birdbath(from)).unwrap()).unwrap();
    }
    folders.map(|f| f.display().to_string())
}

#[test]
fn a_weak_pair_that_comes_after_its_good_twin_ends_the_import_with_3() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("bath").display().to_string();
    assert!(unlit(&["new", &session], home.path()).status.success());
    let import = |[off, on]: [String; 2]| {
        let out = unlit(&["import", "pairs", &session, "--off", &off, "--on", &on], home.path());
        (out.status.code(), text(&out.stdout))
    };
    let (code, said) = import(one_pair(home.path(), "first", ["photos/off/012.dng", "photos/on/012.dng"]));
    assert_eq!(code, Some(0), "{said}");
    let signature = Path::new(&session).join("derived/stops/0001.json");
    let kept = std::fs::read(&signature).unwrap();
    // Whatever lies in `derived` can be made again.
    std::fs::remove_file(&signature).unwrap();
    let (code, said) = import(one_pair(home.path(), "again", ["bad/weak_off.dng", "bad/weak_on.dng"]));
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("of the light that it gave from this stop before"), "{said}");
    assert_eq!(std::fs::read(&signature).unwrap(), kept);
    assert!(!Path::new(&session).join("derived/stops/0002.json").exists());
    let (code, said) = import(one_pair(home.path(), "good", ["bad/good_off.dng", "bad/good_on.dng"]));
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn a_lit_frame_that_is_already_in_the_session_is_repeated_and_a_shared_unlit_one_is_not() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(&home.path().join("bath"), "bath").unwrap();
    let import = |[off, on]: [String; 2]| {
        let (limits, silent) = (Limits::default(), Progress::silent());
        let summary =
            pairs::import(&session, Path::new(&off), Path::new(&on), &limits, &silent, |_| {}).unwrap();
        codes(&summary.imported[0].record.reasons)
    };
    let good = ["bad/good_off.dng", "bad/good_on.dng"];
    assert_eq!(import(one_pair(home.path(), "a", good)), []);
    // The same files under the same name are passed over.
    assert_eq!(import(one_pair(home.path(), "a", good)), []);
    assert_eq!(import(one_pair(home.path(), "b", good)), [ReasonCode::Repeated]);
    assert_eq!(import(one_pair(home.path(), "c", ["bad/good_off.dng"; 2])), [ReasonCode::Repeated]);
    assert_eq!(
        import(one_pair(home.path(), "d", ["bad/misfire_off.dng", "bad/misfire_on.dng"])),
        [ReasonCode::Misfire]
    );
}

#[test]
fn import_accepts_other_limits_and_refuses_what_is_none() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(&home.path().join("bath"), "bath").unwrap();
    let (off, on) = card(home.path());
    let file = home.path().join("limits.json");
    std::fs::write(&file, br#"{"lit_share": 0.0}"#).unwrap();
    let limits = pairs::read_limits(Some(&file)).unwrap();
    let silent = Progress::silent();
    let summary = pairs::import(&session, Path::new(&off), Path::new(&on), &limits, &silent, |_| {}).unwrap();
    assert!(!codes(&summary.imported[1].record.reasons).contains(&ReasonCode::Misfire));
    std::fs::write(&file, br#"{"lit_shore": 0.0}"#).unwrap();
    assert!(matches!(pairs::read_limits(Some(&file)), Err(ImportError::Limits { .. })));
}

#[test]
fn import_of_other_photographs_under_a_stored_name_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(&home.path().join("bath"), "bath").unwrap();
    let (off, on) = card(home.path());
    let (off, on) = (Path::new(&off), Path::new(&on));
    let (limits, silent) = (Limits::default(), Progress::silent());
    pairs::import(&session, off, on, &limits, &silent, |_| {}).unwrap();
    std::fs::copy(on.join("dud.dng"), on.join("003.DNG")).unwrap();
    let refused = pairs::import(&session, off, on, &limits, &silent, |_| {});
    assert!(matches!(refused, Err(ImportError::Session(SessionError::DuplicateName { number: 1, .. }))));
}

#[test]
fn folders_without_a_common_name_are_an_error() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(&home.path().join("bath"), "bath").unwrap();
    let nothing = pairs::import(
        &session,
        &birdbath("photos/off"),
        &birdbath("calibration/dark"),
        &Limits::default(),
        &Progress::silent(),
        |_| {},
    );
    assert!(matches!(nothing, Err(ImportError::NothingMatches { .. })), "{nothing:?}");
}

#[test]
fn inspect_tells_true_sensor_values_as_json() {
    let home = tempfile::tempdir().unwrap();
    let file = shared("data/raw/dng16_perchblack.dng").display().to_string();
    let out = unlit(&["inspect", &file, "--roi", "100,50,301,200", "--json"], home.path());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let told: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let photo = raw::read(Path::new(&file)).unwrap();
    let mut sites = Vec::new();
    for y in 50..250 {
        sites.extend((100..401).map(|x| *photo.mosaic.dn.at(x, y)));
    }
    let mean = sites.iter().map(|&v| f64::from(v)).sum::<f64>() / sites.len() as f64;
    assert_eq!(told["region_maximum"], *sites.iter().max().unwrap());
    assert!((told["region_mean"].as_f64().unwrap() - mean).abs() < 1e-9);
    assert_eq!(told["frame_maximum"], *photo.mosaic.dn.pixels().iter().max().unwrap());
    let channels = told["channels"].as_array().unwrap();
    let counted: u64 = channels
        .iter()
        .map(|c| {
            let bins: u64 = c["histogram"].as_array().unwrap().iter().map(|b| b.as_u64().unwrap()).sum();
            assert_eq!(c["histogram"].as_array().unwrap().len(), 100);
            bins + c["below_black"].as_u64().unwrap() + c["at_saturation"].as_u64().unwrap()
        })
        .sum();
    assert_eq!(counted, sites.len() as u64);
    assert_eq!(told["levels"]["black_source"], "masked_pixels");
    assert_eq!(told["settings"]["iso"], 100.0);
}

#[test]
fn inspect_of_every_sample_gives_values_or_says_what_to_do() {
    let home = tempfile::tempdir().unwrap();
    for (name, expected) in [
        ("small_5DS.cr2", Ok("saturation    14733.00 DN, from published measurements of this body")),
        ("dng16_as5DS.dng", Ok("the frame's masked pixels")),
        ("dng16_perchblack.dng", Ok("red histogram of the region: 100 bins")),
        ("dng14_tiffcrate.dng", Ok("1056 x 736 pixels, filters RG/GB")),
        ("tinydng_colorchart.dng", Ok("black         2056.00 DN, from the file's tag")),
        ("photoprism_canon_eos_6d.dng", Err("has no CFA: already demosaiced")),
        ("nomexif_canon-r6.cr3", Err("is cut short: 336392 bytes are there")),
        ("metaextr_issue247-4.nef", Err("it is a JPEG, whatever its name says")),
        ("mut_rawler_abort_alloc.dng", Err("has no readable BitsPerSample tag")),
    ] {
        let file = shared("data/raw").join(name).display().to_string();
        let out = unlit(&["inspect", &file], home.path());
        let (said, complained) = (text(&out.stdout), text(&out.stderr));
        match expected {
            Ok(words) => {
                assert_eq!(out.status.code(), Some(0), "{name}: {complained}");
                assert!(said.contains(words), "{name}: {said}");
            }
            Err(words) => {
                assert_eq!(out.status.code(), Some(1), "{name}: {said}");
                assert!(complained.contains(words), "{name}: {complained}");
            }
        }
    }
}

#[test]
fn a_session_measures_where_its_sensor_clips_and_judges_by_it() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("bath").display().to_string();
    assert!(unlit(&["new", &session], home.path()).status.success());
    let blown = birdbath("calibration/white/d0500_1.dng").display().to_string();
    let dark = birdbath("calibration/dark/0.dng").display().to_string();
    let lit = birdbath("bad/good_on.dng").display().to_string();
    for (unfit, words) in [(&dark, "too close to black"), (&lit, "sites are not blown")] {
        let out = unlit(&["calibrate", "levels", &session, "--blown", unfit], home.path());
        assert_eq!(out.status.code(), Some(1), "{unfit}: {}", text(&out.stdout));
        assert!(text(&out.stderr).contains(words), "{}", text(&out.stderr));
    }
    // The nearest card is blown in green alone: the others are told as not reached.
    let out = unlit(&["calibrate", "levels", &session, "--blown", &blown], home.path());
    assert!(text(&out.stdout).contains("red and blue never clip "), "{}", text(&out.stdout));
    let blown = home.path().join("blown.dng").display().to_string();
    std::fs::write(&blown, two_stops_brighter(&birdbath("calibration/white/d0500_1.dng"))).unwrap();
    let out = unlit(&["calibrate", "levels", &session, "--blown", &blown], home.path());
    assert!(out.status.success(), "{}{}", text(&out.stdout), text(&out.stderr));
    let measured = measured_levels(&session);
    assert_eq!(measured.isos.len(), 1);
    // The studio's sensor clips at 15380 and the file says so.
    for level in measured.isos[0].saturation.concat() {
        assert!((15_370.0..=15_380.0).contains(&level.unwrap()), "{level:?}");
    }
    let told = unlit(&["inspect", &lit, "--session", &session], home.path());
    assert!(text(&told.stdout).contains("from calibration shots"), "{}", text(&told.stdout));
    let told = unlit(&["inspect", &lit], home.path());
    assert!(
        text(&told.stdout).contains("saturation    15380.00 DN, from the file's tag"),
        "{}",
        text(&told.stdout)
    );
}

/// The same frame with four times the light: 600 x 400 values of 16 bits end the file, black is 2048, and the
/// sensor clips at 15380.
fn two_stops_brighter(file: &Path) -> Vec<u8> {
    let mut bytes = std::fs::read(file).unwrap();
    let from = bytes.len() - 600 * 400 * 2;
    for value in bytes[from..].chunks_exact_mut(2) {
        let dn = u32::from(u16::from_le_bytes([value[0], value[1]]));
        let brighter = (2048 + 4 * dn.saturating_sub(2048)).min(15_380) as u16;
        value.copy_from_slice(&brighter.to_le_bytes());
    }
    bytes
}

fn measured_levels(session: &str) -> unlit::photometry::levels::MeasuredLevels {
    unlit::pipeline::levels::load(&Session::open_shared(Path::new(session)).unwrap()).unwrap()
}

#[test]
fn inspect_refuses_a_region_outside_the_frame() {
    let home = tempfile::tempdir().unwrap();
    let file = birdbath("bad/good_on.dng").display().to_string();
    let out = unlit(&["inspect", &file, "--roi", "590,0,20,10"], home.path());
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("not inside the frame of 600 x 400 pixels"), "{}", text(&out.stderr));
}
