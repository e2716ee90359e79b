//! Raw files: values against dcraw, errors that say what to do, and files that lie.

use crate::samples::shared;
use std::path::{Path, PathBuf};
use std::process::Command;
use unlit::codec::dng::{self, DngContent};
use unlit::codec::raw::{self, Photo, RawError};
use unlit::pair::Settings;
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;
use unlit::units::{FNumber, Iso, Seconds};

pub(crate) fn sample(name: &str) -> PathBuf {
    shared("data/raw").join(name)
}

fn error_of(name: &str) -> RawError {
    raw::read(&sample(name)).expect_err(name)
}

/// Sensor values as dcraw gives them: totally raw, 16 bits, no scaling.
fn dcraw(path: &Path) -> (usize, usize, Vec<u16>) {
    let out = Command::new("dcraw")
        .args(["-D", "-4", "-t", "0", "-c"])
        .arg(path)
        .output()
        .expect("dcraw is the independent decoder of this test: apt-get install dcraw");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    pgm(&out.stdout)
}

/// A binary 16-bit PGM: width, height, values.
pub(crate) fn pgm(bytes: &[u8]) -> (usize, usize, Vec<u16>) {
    let header_end = bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').nth(2).unwrap().0 + 1;
    let header = String::from_utf8_lossy(&bytes[..header_end]).into_owned();
    let words: Vec<&str> = header.split_whitespace().collect();
    assert_eq!((words[0], words[3]), ("P5", "65535"), "{header}");
    let pixels = &bytes[header_end..];
    let dn = pixels.chunks_exact(2).map(|c| u16::from_be_bytes([c[0], c[1]])).collect();
    (words[1].parse().unwrap(), words[2].parse().unwrap(), dn)
}

/// Asserts that every site of `photo` is dcraw's, its first site lying at (`left`, `top`) of dcraw's frame.
fn assert_sites_equal(photo: &Photo, path: &Path, left: usize, top: usize) {
    let (width, height, dn) = dcraw(path);
    let ours = &photo.mosaic.dn;
    assert!(ours.width() + left <= width && ours.height() + top <= height);
    let mut different = 0;
    for y in 0..ours.height() {
        let row = &dn[(y + top) * width + left..][..ours.width()];
        different += row.iter().enumerate().filter(|&(x, v)| ours.at(x, y) != v).count();
    }
    assert_eq!(different, 0, "{} of {} sites differ", different, ours.pixels().len());
}

#[test]
fn dng_sites_equal_dcraws_bit_for_bit() {
    for (name, size) in [
        ("dng16_as5DS.dng", (1056, 736)),
        ("dng16_perchblack.dng", (1056, 736)),
        ("dng14_tiffcrate.dng", (1056, 736)),
        ("tinydng_colorchart.dng", (1734, 1156)),
    ] {
        let path = sample(name);
        let photo = raw::read(&path).unwrap();
        assert_eq!((photo.mosaic.dn.width(), photo.mosaic.dn.height()), size, "{name}");
        assert_sites_equal(&photo, &path, 0, 0);
    }
}

#[test]
fn cr2_sites_equal_dcraws_bit_for_bit() {
    let path = sample("small_5DS.cr2");
    let photo = raw::read(&path).unwrap();
    // dcraw knows no border for a frame of this size and gives the whole sensor.
    assert_eq!((photo.mosaic.dn.width(), photo.mosaic.dn.height()), (1216 - 160 - 2, 800 - 64));
    assert_sites_equal(&photo, &path, 160, 64);
}

#[test]
fn black_comes_from_the_masked_border_where_there_is_one() {
    for name in ["dng16_as5DS.dng", "dng16_perchblack.dng", "dng14_tiffcrate.dng", "small_5DS.cr2"] {
        let photo = raw::read(&sample(name)).unwrap();
        assert_eq!(photo.mosaic.levels.black_source, LevelSource::MaskedPixels, "{name}");
        for black in photo.mosaic.levels.black.concat() {
            assert!((black - 2047.0).abs() < 2.0, "{name}: black {black}");
        }
    }
    let photo = raw::read(&sample("tinydng_colorchart.dng")).unwrap();
    assert_eq!(photo.mosaic.levels.black_source, LevelSource::FileTag);
    assert_eq!(photo.mosaic.levels.black, [[2056.0; 2]; 2]);
    assert_eq!(photo.mosaic.levels.saturation, [[15000.0; 2]; 2]);
}

#[test]
fn a_level_from_the_decoders_table_says_so() {
    let photo = raw::read(&sample("small_5DS.cr2")).unwrap();
    assert_eq!(photo.mosaic.levels.saturation_source, LevelSource::DecoderTable);
    assert_eq!(photo.mosaic.levels.saturation, [[14466.0; 2]; 2]);
}

#[test]
fn settings_are_read_and_what_is_zero_or_blank_is_absent() {
    let settings = raw::read(&sample("small_5DS.cr2")).unwrap().settings;
    assert_eq!(settings.make.as_deref(), Some("Canon"));
    assert_eq!(settings.model.as_deref(), Some("Canon EOS 5DS"));
    assert_eq!(settings.serial.as_deref(), Some("083022000039"));
    assert_eq!(settings.lens.as_deref(), Some("EF100mm f/2.8L Macro IS USM"));
    assert_eq!(settings.shutter.map(|t| t.0), Some(1.0 / 125.0));
    assert_eq!(settings.aperture.map(|n| n.0), Some(11.0));
    assert_eq!(settings.iso.map(|i| i.0), Some(100.0));
    assert_eq!(settings.focal_length_mm, Some(100.0));
    assert_eq!(settings.taken_at.as_deref(), Some("2026-01-02T03:04:05"));
    let settings = raw::read(&sample("tinydng_colorchart.dng")).unwrap().settings;
    assert_eq!((settings.shutter, settings.aperture, settings.iso), (None, None, None));
    assert_eq!((settings.taken_at, settings.focal_length_mm), (None, None));
}

#[test]
fn what_cannot_be_read_is_refused_with_its_own_reason() {
    assert!(matches!(error_of("photoprism_canon_eos_6d.dng"), RawError::Demosaiced { .. }));
    let cr3 = error_of("nomexif_canon-r6.cr3");
    assert!(matches!(cr3, RawError::Truncated { has: 336_392, needs: 31_239_766, .. }), "{cr3}");
    assert!(matches!(error_of("metaextr_issue247-4.nef"), RawError::NotRaw { .. }));
    assert!(matches!(error_of("mut_rawler_abort_alloc.dng"), RawError::Damaged { .. }));
    assert!(matches!(error_of("README.md"), RawError::NotRaw { .. }));
    assert!(matches!(raw::read(&shared("scenes/birdbath/bad/not_a_raw.dng")), Err(RawError::NotRaw { .. })));
    let cut = raw::read(&shared("scenes/birdbath/bad/truncated.dng"));
    assert!(matches!(cut, Err(RawError::Truncated { has: 241_878, needs: 483_756, .. })), "{cut:?}");
}

#[test]
fn a_cr2_cut_anywhere_is_cut_short_or_not_a_raw() {
    let whole = std::fs::read(sample("small_5DS.cr2")).unwrap();
    for length in [0, 1, 7, 8, 100, 2000, 3844, 5000, whole.len() / 2, whole.len() - 1] {
        let error = raw::decode(&whole[..length], "cut.cr2").unwrap_err();
        let expected = matches!(error, RawError::Truncated { .. } | RawError::NotRaw { .. });
        assert!(expected, "cut at {length}: {error}");
    }
    let mut zeroed = whole.clone();
    let half = whole.len() / 2;
    zeroed[half..].fill(0);
    assert!(matches!(raw::decode(&zeroed, "zeroed.cr2"), Err(RawError::NoEndMarker { .. })));
}

/// A frame of distinct values with a masked border, written as a DNG into `folder`.
fn written_dng(folder: &Path) -> (PathBuf, Mosaic, Image<u16>) {
    let mosaic = Mosaic {
        dn: Image::from_fn(640, 400, |x, y| (2100 + (x * 37 + y * 101) % 13_000) as u16),
        cfa: Cfa::RGGB,
        levels: Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[15380.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        },
    };
    let masked = Image::from_fn(32, 400, |x, y| (2040 + (x + y) % 16) as u16);
    let settings = Settings {
        make: Some("Canon".into()),
        model: Some("Canon EOS 5DS".into()),
        serial: Some("083022000039".into()),
        lens: Some("EF100mm f/2.8L Macro IS USM".into()),
        shutter: Some(Seconds(1.0 / 125.0)),
        aperture: Some(FNumber(6.3)),
        iso: Some(Iso(400.0)),
        focal_length_mm: Some(100.0),
        exposure_program: Some("Manual".into()),
        white_balance: Some("Manual".into()),
        taken_at: Some("2026-05-04T10:00:04".into()),
        ..Settings::default()
    };
    let content = DngContent { mosaic: &mosaic, settings: &settings, masked_left: Some(&masked) };
    let path = folder.join("written.dng");
    std::fs::write(&path, dng::encode(&content).unwrap()).unwrap();
    (path, mosaic, masked)
}

#[test]
fn a_dng_that_we_write_is_read_alike_by_dcraw_and_rawloader() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mosaic, masked) = written_dng(folder.path());
    let photo = raw::read(&path).unwrap();
    assert_eq!(photo.mosaic.dn, mosaic.dn);
    assert_sites_equal(&photo, &path, 0, 0);
    let other = rawloader::decode_file(&path).unwrap();
    let rawloader::RawImageData::Integer(whole) = other.data else { panic!("floating point") };
    assert_eq!((other.width, other.height, other.crops), (672, 400, [0, 0, 0, 32]));
    for y in 0..400 {
        assert_eq!(&whole[y * 672..][..32], &masked.pixels()[y * 32..][..32], "row {y}");
        assert_eq!(&whole[y * 672 + 32..][..640], &mosaic.dn.pixels()[y * 640..][..640], "row {y}");
    }
}

#[test]
fn a_dng_that_we_write_is_read_by_libraw() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mosaic, _) = written_dng(folder.path());
    let out = Command::new("unprocessed_raw")
        .arg("-q")
        .arg(&path)
        .output()
        .expect("unprocessed_raw is LibRaw's own tool: apt-get install libraw-bin");
    let stored = std::fs::read(folder.path().join("written.dng.pgm"));
    let stored =
        stored.unwrap_or_else(|_| panic!("LibRaw refuses: {}", String::from_utf8_lossy(&out.stderr)));
    // The whole sensor, the 32 masked columns first.
    let (width, height, dn) = pgm(&stored);
    assert_eq!((width, height), (672, 400));
    for (row, ours) in dn.chunks_exact(672).zip(mosaic.dn.pixels().chunks_exact(640)) {
        assert_eq!(&row[32..], ours);
    }
}

#[test]
fn exiftool_finds_the_settings_of_a_dng_that_we_write_and_nothing_to_complain_of() {
    let folder = tempfile::tempdir().unwrap();
    let (path, ..) = written_dng(folder.path());
    let out = Command::new("exiftool")
        .args(["-j", "-n", "-validate", "-warning", "-error", "-a"])
        .args(["-Make", "-Model", "-SerialNumber", "-LensModel", "-ExposureTime", "-FNumber", "-ISO"])
        .args(["-FocalLength", "-ExposureProgram", "-WhiteBalance", "-DateTimeOriginal", "-WhiteLevel"])
        .args(["-BlackLevel", "-ActiveArea", "-MaskedAreas", "-ExifVersion"])
        .arg(&path)
        .output()
        .expect("exiftool is the independent reader of this test: apt-get install libimage-exiftool-perl");
    let told: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let told = &told[0];
    assert_eq!(told["Error"], serde_json::Value::Null, "{told}");
    assert_eq!(told["Make"], "Canon");
    assert_eq!(told["LensModel"], "EF100mm f/2.8L Macro IS USM");
    assert_eq!(told["ExposureTime"], 0.008);
    assert_eq!(told["FNumber"], 6.3);
    assert_eq!(told["ISO"], 400);
    assert_eq!(told["ExposureProgram"], 1);
    assert_eq!(told["WhiteBalance"], 1);
    assert_eq!(told["DateTimeOriginal"], "2026:05:04 10:00:04");
    assert_eq!((&told["WhiteLevel"], &told["BlackLevel"]), (&15380.into(), &2048.into()));
    assert_eq!(told["ActiveArea"], "0 32 400 672");
    assert_eq!(told["MaskedAreas"], "0 0 400 32");
}
