//! Decoders against one another, the second decoder's process, and files that lie.
//!
//! Whoever can read a file must read the same sensor values: rawloader, rawler, dcraw (`-E`: the whole sensor,
//! nothing scaled) and what this program makes of them.

use crate::processes::{ChildWatch, peak_kilobytes};
use crate::raw::{pgm, sample};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};
use unlit::codec::cr2::{self, Cr2Content};
use unlit::codec::dng::{self, DngContent};
use unlit::codec::raw::{self, Photo, RawError};
use unlit::pair::Settings;
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;
use unlit::units::{FNumber, Iso, Seconds};

/// A whole sensor as a decoder gives it.
#[derive(PartialEq)]
struct Plane {
    width: usize,
    height: usize,
    dn: Vec<u16>,
}

fn by_rawloader(bytes: &[u8]) -> Option<Plane> {
    let frame = rawloader::decode(&mut { bytes }).ok()?;
    match frame.data {
        rawloader::RawImageData::Integer(dn) if frame.cpp == 1 => {
            Some(Plane { width: frame.width, height: frame.height, dn })
        }
        _ => None,
    }
}

/// In this process: for files that are known to be harmless.
fn by_rawler(bytes: &[u8]) -> Option<Plane> {
    let source = rawler::rawsource::RawSource::new_from_slice(bytes);
    let frame = rawler::decode(&source, &Default::default()).ok()?;
    match frame.data {
        rawler::RawImageData::Integer(dn) if frame.cpp == 1 => {
            Some(Plane { width: frame.width, height: frame.height, dn })
        }
        _ => None,
    }
}

fn by_dcraw(path: &Path) -> Option<Plane> {
    let out = Command::new("dcraw")
        .args(["-E", "-4", "-t", "0", "-c"])
        .arg(path)
        .output()
        .expect("dcraw is the independent decoder of this test: apt-get install dcraw");
    (out.status.success() && out.stdout.starts_with(b"P5")).then(|| {
        let (width, height, dn) = pgm(&out.stdout);
        Plane { width, height, dn }
    })
}

/// The area of `plane` as large as `photo` that begins at (`left`, `top`).
fn sites_differ(photo: &Photo, plane: &Plane, (left, top): (usize, usize)) -> usize {
    let ours = &photo.mosaic.dn;
    assert!(ours.width() + left <= plane.width && ours.height() + top <= plane.height);
    let rows = ours.pixels().chunks_exact(ours.width()).enumerate();
    rows.map(|(y, row)| {
        let theirs = &plane.dn[(y + top) * plane.width + left..][..row.len()];
        row.iter().zip(theirs).filter(|(a, b)| a != b).count()
    })
    .sum()
}

fn with_second_decoder() {
    raw::set_decoder_program(env!("CARGO_BIN_EXE_unlit"));
}

/// Reads `bytes` with all decoders; those in `readers` must read them, and all that do must agree. `corner` is
/// where this program's active area begins.
fn assert_agreement(name: &str, bytes: &[u8], corner: (usize, usize), readers: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    std::fs::write(&path, bytes).unwrap();
    let planes =
        [("rawloader", by_rawloader(bytes)), ("rawler", by_rawler(bytes)), ("dcraw", by_dcraw(&path))];
    let read: Vec<(&str, Plane)> = planes.into_iter().filter_map(|(who, p)| Some((who, p?))).collect();
    let names: Vec<&str> = read.iter().map(|(who, _)| *who).collect();
    assert_eq!(names, readers, "who reads {name}");
    for pair in read.windows(2) {
        let ((a, one), (b, other)) = (&pair[0], &pair[1]);
        assert_eq!((one.width, one.height), (other.width, other.height), "{name}: {a} and {b}");
        let different = one.dn.iter().zip(&other.dn).filter(|(x, y)| x != y).count();
        assert_eq!(different, 0, "{name}: sites that differ between {a} and {b}");
    }
    let photo = raw::decode(bytes, name).unwrap();
    assert_eq!(sites_differ(&photo, &read[0].1, corner), 0, "{name}: sites that differ from {}", names[0]);
}

const ALL: &[&str] = &["rawloader", "rawler", "dcraw"];
const NOT_RAWLOADER: &[&str] = &["rawler", "dcraw"];

#[test]
fn whoever_reads_a_sample_reads_the_same_values() {
    for (name, corner, readers) in [
        ("dng16_as5DS.dng", (160, 64), ALL),
        ("dng16_perchblack.dng", (160, 64), ALL),
        ("small_5DS.cr2", (160, 64), ALL),
        ("dng14_tiffcrate.dng", (160, 64), NOT_RAWLOADER),
        ("tinydng_colorchart.dng", (152, 26), NOT_RAWLOADER),
    ] {
        assert_agreement(name, &std::fs::read(sample(name)).unwrap(), corner, readers);
    }
}

/// A frame of `seed`: a gradient, noise, and both ends of the 14 bits.
fn mosaic(width: usize, height: usize, seed: u64) -> Mosaic {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let dn = Image::from_fn(width, height, |x, y| match random.random_range(0..200) {
        0 => 0,
        1 => 0x3fff,
        _ => (2048 + x * 6 + y * 9 + random.random_range(0..90)).min(0x3fff) as u16,
    });
    let levels = Levels {
        black: [[2048.0; 2]; 2],
        saturation: [[16_383.0; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    Mosaic { dn, cfa: Cfa::RGGB, levels }
}

fn settings() -> Settings {
    Settings {
        make: Some("Canon".into()),
        model: Some(cr2::MODEL.into()),
        serial: Some("083022000039".into()),
        lens: Some("EF100mm f/2.8L Macro IS USM".into()),
        shutter: Some(Seconds(1.0 / 125.0)),
        aperture: Some(FNumber(11.0)),
        iso: Some(Iso(100.0)),
        focal_length_mm: Some(100.0),
        exposure_program: Some("Manual".into()),
        white_balance: Some("Manual".into()),
        taken_at: Some("2026-05-04T10:00:04".into()),
        focus_mode: Some("Manual Focus (3)".into()),
        drive_mode: Some("Single".into()),
        highlight_tone_priority: Some("Off".into()),
        long_exposure_noise_reduction: Some("Auto".into()),
        high_iso_noise_reduction: Some("Off".into()),
    }
}

fn dng(mosaic: &Mosaic) -> Vec<u8> {
    dng::encode(&DngContent { mosaic, settings: &settings(), masked_left: None }).unwrap()
}

/// Where the entry of `tag` stands in a little-endian TIFF's first directory.
fn entry(file: &[u8], tag: u16) -> usize {
    let directory = u32::from_le_bytes(file[4..8].try_into().unwrap()) as usize;
    let count = u16::from_le_bytes([file[directory], file[directory + 1]]) as usize;
    let mut entries = (0..count).map(|i| directory + 2 + i * 12);
    entries.find(|&at| file[at..at + 2] == tag.to_le_bytes()).unwrap()
}

/// The file with other sensor data: `tags` get new values, the strip is `data`.
fn with_strip(mut file: Vec<u8>, tags: &[(u16, u16)], data: &[u8]) -> Vec<u8> {
    for (tag, value) in tags {
        let at = entry(&file, *tag) + 8;
        file[at..at + 2].copy_from_slice(&value.to_le_bytes());
    }
    let (offset, length) = (entry(&file, 273) + 8, entry(&file, 279) + 8);
    let end = file.len() as u32;
    file[offset..offset + 4].copy_from_slice(&end.to_le_bytes());
    file[length..length + 4].copy_from_slice(&(data.len() as u32).to_le_bytes());
    file.extend_from_slice(data);
    file
}

fn packed_14(mosaic: &Mosaic) -> Vec<u8> {
    let (mut packed, mut waiting, mut have) = (Vec::new(), 0u32, 0);
    for dn in mosaic.dn.pixels() {
        waiting = waiting << 14 | u32::from(*dn);
        have += 14;
        while have >= 8 {
            have -= 8;
            packed.push((waiting >> have) as u8);
        }
    }
    assert_eq!(have, 0, "rows must end at a byte");
    with_strip(dng(mosaic), &[(258, 14)], &packed)
}

/// Lossless JPEG of two components, by rawler's encoder, which is independent of ours.
fn lossless(mosaic: &Mosaic, predictor: u8) -> Vec<u8> {
    let (width, height) = (mosaic.dn.width(), mosaic.dn.height());
    let pixels = mosaic.dn.pixels();
    let encoder =
        rawler::ljpeg92::LjpegCompressor::new(pixels, width / 2, height, 2, 14, predictor, 0, 0).unwrap();
    with_strip(dng(mosaic), &[(259, 7)], &encoder.encode().unwrap())
}

#[test]
fn whoever_reads_a_made_dng_reads_the_same_values() {
    for seed in [1, 2, 3] {
        let mosaic = mosaic(640 + 8 * seed as usize, 402, seed);
        assert_agreement("16-bit DNG", &dng(&mosaic), (0, 0), ALL);
        assert_agreement("14-bit packed DNG", &packed_14(&mosaic), (0, 0), NOT_RAWLOADER);
        assert_agreement("lossless JPEG DNG", &lossless(&mosaic, 1), (0, 0), ALL);
    }
}

fn cr2_of(width: usize, height: usize, seed: u64) -> (Vec<u8>, Image<u16>) {
    let lit = mosaic(width, height, seed).dn;
    let sensor = Image::from_fn(width, height, |x, y| {
        let masked = x < cr2::BORDER_LEFT || y < cr2::BORDER_TOP;
        if masked { 2040 + ((x * 7 + y * 13) % 17) as u16 } else { *lit.at(x, y) }
    });
    let content = Cr2Content { sensor: &sensor, black: 2048, white: 16_383, settings: &settings() };
    (cr2::encode(&content).unwrap(), sensor)
}

#[test]
fn whoever_reads_a_cr2_that_we_write_reads_the_same_values() {
    let (file, _) = cr2_of(640, 402, 4);
    assert_agreement("made CR2", &file, (160, 64), ALL);
    let (width, height) = cr2::SENSOR;
    let (file, sensor) = cr2_of(width, height, 5);
    assert_agreement("made 52.7 MP CR2", &file, (160, 64), ALL);
    let theirs = by_rawler(&file).unwrap();
    assert!(theirs.dn == sensor.pixels(), "what is read is not what was written");
}

#[test]
fn exiftool_finds_the_settings_and_the_exposure_lock_of_a_cr2_that_we_write() {
    let folder = tempfile::tempdir().unwrap();
    for (focus, drive, priority, long, high) in [
        ("Manual Focus (3)", "Single", "Off", "Off", "Off"),
        ("AI Servo AF", "Continuous, High", "On", "Auto", "Standard"),
        ("Manual Focus (6)", "Silent Single", "Off", "On", "Strong"),
    ] {
        let told = Settings {
            focus_mode: Some(focus.into()),
            drive_mode: Some(drive.into()),
            highlight_tone_priority: Some(priority.into()),
            long_exposure_noise_reduction: Some(long.into()),
            high_iso_noise_reduction: Some(high.into()),
            ..settings()
        };
        let sensor = mosaic(320, 200, 6).dn;
        let content = Cr2Content { sensor: &sensor, black: 2048, white: 15_000, settings: &told };
        let path = folder.path().join("made.cr2");
        std::fs::write(&path, cr2::encode(&content).unwrap()).unwrap();
        let out = Command::new("exiftool")
            .args(["-j", "-Make", "-Model", "-SerialNumber", "-LensModel", "-ExposureTime", "-FNumber"])
            .args(["-ISO", "-ExposureProgram", "-FocusMode", "-ContinuousDrive", "-HighlightTonePriority"])
            .args(["-LongExposureNoiseReduction", "-HighISONoiseReduction", "-Warning", "-Error"])
            .arg(&path)
            .output()
            .expect(
                "exiftool is the independent reader of this test: apt-get install libimage-exiftool-perl",
            );
        let read: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let read = &read[0];
        assert_eq!((&read["Error"], &read["Warning"]), (&serde_json::Value::Null, &serde_json::Value::Null));
        assert_eq!(read["Model"], cr2::MODEL);
        assert_eq!((&read["ExposureTime"], &read["ISO"]), (&"1/125".into(), &100.into()));
        assert_eq!(read["ExposureProgram"], "Manual");
        assert_eq!(read["LensModel"], "EF100mm f/2.8L Macro IS USM");
        let ours = raw::read(&path).unwrap().settings;
        assert_eq!(ours, told);
        for (tag, word) in [
            ("FocusMode", ours.focus_mode),
            ("ContinuousDrive", ours.drive_mode),
            ("HighlightTonePriority", ours.highlight_tone_priority),
            ("LongExposureNoiseReduction", ours.long_exposure_noise_reduction),
            ("HighISONoiseReduction", ours.high_iso_noise_reduction),
        ] {
            assert_eq!(read[tag], word.unwrap(), "{tag}");
        }
    }
}

/// What ExifTool prints of a CR3's own blocks.
#[test]
fn a_cr3_tells_its_settings_even_when_its_pixels_are_cut_off() {
    let path = sample("nomexif_canon-r6.cr3");
    let ours = unlit::codec::exif::settings(&std::fs::read(&path).unwrap());
    let out = Command::new("exiftool")
        .args(["-j", "-Model", "-LensModel", "-FocusMode", "-ContinuousDrive", "-HighlightTonePriority"])
        .args(["-LongExposureNoiseReduction", "-HighISONoiseReduction", "-DateTimeOriginal"])
        .args(["-FNumber#", "-ISO#", "-ExposureTime#"])
        .arg(&path)
        .output()
        .expect("exiftool is the independent reader of this test: apt-get install libimage-exiftool-perl");
    let read: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let read = &read[0];
    let word = |text: Option<String>| text.map_or(serde_json::Value::Null, Into::into);
    assert_eq!(read["Model"], word(ours.model));
    assert_eq!(read["LensModel"], word(ours.lens));
    assert_eq!(read["FocusMode"], word(ours.focus_mode));
    assert_eq!(read["ContinuousDrive"], word(ours.drive_mode));
    assert_eq!(read["HighlightTonePriority"], word(ours.highlight_tone_priority));
    assert_eq!(read["LongExposureNoiseReduction"], word(ours.long_exposure_noise_reduction));
    assert_eq!(read["HighISONoiseReduction"], word(ours.high_iso_noise_reduction));
    assert_eq!(read["FNumber"].as_f64(), ours.aperture.map(|n| n.0));
    assert_eq!(read["ISO"].as_f64(), ours.iso.map(|iso| iso.0));
    assert!((read["ExposureTime"].as_f64().unwrap() - ours.shutter.unwrap().0).abs() < 1e-9);
}

#[test]
fn a_cut_cr3_is_told_at_once() {
    let begun = Instant::now();
    let error = raw::read(&sample("nomexif_canon-r6.cr3")).unwrap_err();
    assert!(matches!(error, RawError::Truncated { has: 336_392, needs: 31_239_766, .. }), "{error}");
    assert!(begun.elapsed() < Duration::from_secs(1));
}

#[test]
fn the_second_decoder_in_its_process_gives_what_the_first_gives() {
    with_second_decoder();
    let (made, _) = cr2_of(640, 402, 7);
    let cr2 = std::fs::read(sample("small_5DS.cr2")).unwrap();
    for (name, bytes) in [("made.cr2", made), ("small_5DS.cr2", cr2)] {
        let first = raw::decode(&bytes, name).unwrap();
        let second = raw::decode_with_second(&bytes, name).unwrap();
        let (ours, theirs) = (&first.mosaic.dn, &second.mosaic.dn);
        // rawloader's table leaves out two columns at the right, rawler's does not.
        assert_eq!((ours.width() + 2, ours.height()), (theirs.width(), theirs.height()), "{name}");
        let rows = ours.pixels().chunks_exact(ours.width()).zip(theirs.pixels().chunks_exact(theirs.width()));
        assert!(rows.into_iter().all(|(a, b)| a == &b[..a.len()]), "{name}: sites differ");
        assert_eq!(first.mosaic.cfa, second.mosaic.cfa);
        assert_eq!(second.mosaic.levels.black_source, LevelSource::MaskedPixels);
        assert_eq!(second.mosaic.levels.saturation_source, LevelSource::DecoderTable);
        for (a, b) in first.mosaic.levels.black.concat().iter().zip(second.mosaic.levels.black.concat()) {
            assert!((a - b).abs() < 0.5, "{name}: black {a} and {b}");
        }
        assert_eq!(first.settings, second.settings);
    }
}

#[test]
fn what_rawloader_does_not_know_goes_to_the_second_decoder() {
    with_second_decoder();
    // A predictor of lossless JPEG that rawloader refuses.
    let mosaic = mosaic(648, 402, 8);
    let file = lossless(&mosaic, 6);
    assert!(by_rawloader(&file).is_none());
    let photo = raw::decode(&file, "predictor6.dng").unwrap();
    assert!(photo.mosaic.dn == mosaic.dn);
    assert_eq!(photo.mosaic.levels, mosaic.levels);
    // A body that only rawler knows, and one that nobody knows.
    let (file, _) = cr2_of(640, 402, 9);
    let photo = raw::decode(&with_model(&file, "Canon EOS 2000D"), "2000D.cr2").unwrap();
    assert_eq!(photo.settings.model.as_deref(), Some("Canon EOS 2000D"));
    assert_eq!(photo.mosaic.levels.saturation_source, LevelSource::DecoderTable);
    let error = raw::decode(&with_model(&file, "Canon EOS 99 Nobody"), "nobody.cr2").unwrap_err();
    assert!(matches!(&error, RawError::Unsupported { how, .. } if how.contains("EOS 99 Nobody")), "{error}");
}

/// The file as if another body had written it.
fn with_model(file: &[u8], model: &str) -> Vec<u8> {
    let mut file = file.to_vec();
    let (at, end) = (entry(&file, 272), file.len() as u32);
    file[at + 4..at + 8].copy_from_slice(&(model.len() as u32 + 1).to_le_bytes());
    file[at + 8..at + 12].copy_from_slice(&end.to_le_bytes());
    file.extend_from_slice(model.as_bytes());
    file.push(0);
    file
}

#[test]
fn a_decoder_that_asks_for_four_gigabytes_ends_alone() {
    with_second_decoder();
    let bytes = std::fs::read(sample("mut_rawler_abort_alloc.dng")).unwrap();
    let watch = ChildWatch::start();
    let error = raw::decode_with_second(&bytes, "greedy.dng").unwrap_err();
    assert!(matches!(error, RawError::DecoderProcess { .. }), "{error}");
    assert!(error.to_string().contains("1200 MB"), "{error}");
    assert!(watch.peak() < 1_500_000, "{} kB in a child", watch.peak());
}

/// How many of [`whole_files`], at the end, are for the second decoder.
const FOR_THE_SECOND: usize = 4;

/// All samples and one of each layout; for the second decoder one that rawloader refuses, one of a newer body, a CR3
/// whose boxes are whole, and a RAF that says that its parts are there.
fn whole_files() -> Vec<(String, Vec<u8>)> {
    let names = [
        "small_5DS.cr2",
        "dng16_perchblack.dng",
        "dng14_tiffcrate.dng",
        "mut_rawler_abort_alloc.dng",
        "photoprism_canon_eos_6d.dng",
        "nomexif_canon-r6.cr3",
        "metaextr_issue247-4.nef",
        "tinydng_colorchart.dng",
    ];
    let read = |name: &&str| (name.to_string(), std::fs::read(sample(name)).unwrap());
    let mut files: Vec<(String, Vec<u8>)> = names.iter().map(read).collect();
    files.push(("lossless.dng".into(), lossless(&mosaic(480, 320, 10), 1)));
    files.push(("predictor6.dng".into(), lossless(&mosaic(480, 320, 11), 6)));
    files.push(("newer.cr2".into(), with_model(&cr2_of(480, 320, 12).0, "Canon EOS 2000D")));
    let mut cr3 = std::fs::read(sample("nomexif_canon-r6.cr3")).unwrap();
    let data = cr3.windows(4).rposition(|w| w == b"mdat").unwrap();
    let short = (cr3.len() - data + 4) as u32;
    cr3[data - 4..data].copy_from_slice(&short.to_be_bytes());
    files.push(("whole.cr3".into(), cr3));
    let mut raf = b"FUJIFILMCCD-RAW 0201FF383501X-T1\0".to_vec();
    raf.resize(4096, 0x11);
    for (at, value) in [(84, 160u32), (88, 200), (92, 400), (96, 300), (100, 1000), (104, 3000)] {
        raf[at..at + 4].copy_from_slice(&value.to_be_bytes());
    }
    files.push(("made.raf".into(), raf));
    files
}

/// One mutation, from `random` alone: bytes, bits, extremes in fields, cuts, pieces moved, pieces of other files.
fn mutate(bytes: &mut Vec<u8>, others: &[(String, Vec<u8>)], random: &mut ChaCha8Rng) {
    // Directories stand at the front of these files: most mutations go there.
    let front = |length: usize, random: &mut ChaCha8Rng| {
        let reach = if random.random_bool(0.8) { length.min(4096) } else { length };
        random.random_range(0..reach.max(1))
    };
    match random.random_range(0..6) {
        0 => (0..random.random_range(1..6)).for_each(|_| {
            let at = front(bytes.len(), random);
            bytes[at] = random.random();
        }),
        1 => (0..random.random_range(1..40)).for_each(|_| {
            let at = random.random_range(0..bytes.len());
            bytes[at] ^= 1 << random.random_range(0..8);
        }),
        2 => {
            let extremes = [0u32, 1, 2, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_fffe, u32::MAX];
            (0..random.random_range(1..4)).for_each(|_| {
                let at = front(bytes.len() - 4, random) & !1;
                let value = extremes[random.random_range(0..extremes.len())];
                let wide = if random.random() { 2 } else { 4 };
                let field = if random.random() { value.to_le_bytes() } else { value.to_be_bytes() };
                bytes[at..at + wide].copy_from_slice(&field[..wide]);
            });
        }
        3 => bytes.truncate(random.random_range(0..bytes.len())),
        4 => {
            let (from, to) = (front(bytes.len(), random), front(bytes.len(), random));
            let length = random.random_range(1..2000).min(bytes.len() - from.max(to));
            bytes.copy_within(from..from + length, to);
        }
        _ => {
            let other = &others[random.random_range(0..others.len())].1;
            let (from, to) = (front(other.len(), random), front(bytes.len(), random));
            let length = random.random_range(1..4000).min(other.len() - from).min(bytes.len() - to);
            bytes[to..to + length].copy_from_slice(&other[from..from + length]);
        }
    }
}

/// The longest that one file may take, on a machine that does other things as well.
const PATIENCE: Duration = Duration::from_secs(45);

#[test]
fn mutated_files_never_panic_hang_or_claim_more_than_they_hold() {
    with_second_decoder();
    let soak = std::env::var_os("UNLIT_SOAK").is_some();
    let (files, to_the_host) = if soak { (20_000, 10) } else { (2_000, 20) };
    let watch = ChildWatch::start();
    let whole = Arc::new(whole_files());
    let (report, reports) = mpsc::channel();
    for worker in 0..2 {
        let (whole, report) = (whole.clone(), report.clone());
        std::thread::spawn(move || {
            for number in (worker..files).step_by(2) {
                // Each file comes from its number alone, so that an offender can be made again.
                let mut random = ChaCha8Rng::seed_from_u64(2026 + number as u64);
                // A process a file takes its time: they are fewer.
                let mine = whole.len() - FOR_THE_SECOND;
                let (name, bytes) = match number % 8 {
                    7 => &whole[mine + random.random_range(0..FOR_THE_SECOND)],
                    _ => &whole[random.random_range(0..mine)],
                };
                let (name, mut bytes) = (format!("{number} {name}"), bytes.clone());
                for _ in 0..random.random_range(1..3) {
                    if bytes.len() > 8 {
                        mutate(&mut bytes, &whole, &mut random);
                    }
                }
                let begun = Instant::now();
                let outcome = std::panic::catch_unwind(|| {
                    let decoded = match number % to_the_host {
                        0 => raw::decode_with_second(&bytes, &name),
                        _ => raw::decode(&bytes, &name),
                    };
                    let _ = unlit::codec::exif::settings(&bytes);
                    decoded.map(|photo| photo.mosaic.dn.pixels().len()).map_err(|e| e.to_string())
                });
                let read = matches!(outcome, Ok(Ok(_)));
                let fault = match outcome {
                    Err(_) => Some("panicked"),
                    Ok(Ok(sites)) if sites > bytes.len() * 8 => Some("has more sites than bits"),
                    Ok(_) if begun.elapsed() > PATIENCE => Some("took too long"),
                    Ok(_) => None,
                };
                if report.send((name, read, fault)).is_err() {
                    return;
                }
            }
        });
    }
    drop(report);
    let (mut done, mut read) = (0, 0);
    loop {
        match reports.recv_timeout(2 * PATIENCE) {
            Ok((_, decoded, None)) => {
                done += 1;
                read += usize::from(decoded);
            }
            Ok((name, _, Some(fault))) => panic!("mutant {name} {fault}"),
            Err(mpsc::RecvTimeoutError::Disconnected) => break,
            Err(mpsc::RecvTimeoutError::Timeout) => panic!("after {done} mutants one hangs"),
        }
    }
    assert_eq!(done, files);
    // Mutants that all die at the door would test the door alone.
    assert!(read > files / 20 && read < files / 2, "{read} of {files} mutants were decoded");
    println!("{read} of {files} mutants were decoded");
    let here = peak_kilobytes("self").unwrap();
    assert!(here < 1_500_000, "peak memory {here} kB here");
    assert!(watch.peak() < 1_500_000, "peak memory {} kB in a decode host", watch.peak());
}
