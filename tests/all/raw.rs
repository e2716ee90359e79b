//! Raw files: values against dcraw, errors that say what to do, and files that lie.

use rand::{RngExt, SeedableRng};
use std::path::{Path, PathBuf};
use std::process::Command;
use unlit::codec::raw::{self, Photo, RawError};
use unlit::photometry::LevelSource;

/// A file or folder of the shared test data, which lies beside the checkout or where UNLIT_SHARED says.
pub(crate) fn shared(relative: &str) -> PathBuf {
    let beside = || {
        let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().skip(1).map(|a| a.join("shared"));
        above.into_iter().find(|p| p.exists()).unwrap_or_default()
    };
    let path = std::env::var_os("UNLIT_SHARED").map_or_else(beside, PathBuf::from).join(relative);
    assert!(path.exists(), "{} is missing: set UNLIT_SHARED to the folder of shared files", path.display());
    path
}

fn sample(name: &str) -> PathBuf {
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
    let header_end = out.stdout.iter().enumerate().filter(|(_, b)| **b == b'\n').nth(2).unwrap().0 + 1;
    let header = String::from_utf8_lossy(&out.stdout[..header_end]).into_owned();
    let words: Vec<&str> = header.split_whitespace().collect();
    assert_eq!((words[0], words[3]), ("P5", "65535"), "{header}");
    let pixels = &out.stdout[header_end..];
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
    assert!(matches!(error_of("nomexif_canon-r6.cr3"), RawError::Cr3 { .. }));
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

#[test]
fn mutated_files_never_panic_and_never_claim_more_than_they_hold() {
    let names = [
        "small_5DS.cr2",
        "dng16_perchblack.dng",
        "dng14_tiffcrate.dng",
        "mut_rawler_abort_alloc.dng",
        "photoprism_canon_eos_6d.dng",
        "nomexif_canon-r6.cr3",
        "metaextr_issue247-4.nef",
    ];
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(2026);
    for name in names {
        let whole = std::fs::read(sample(name)).unwrap();
        for _ in 0..2000 / names.len() + 1 {
            let mut bytes = whole.clone();
            // Directories stand at the front of these files: most mutations go there.
            for _ in 0..random.random_range(1..6) {
                let reach = if random.random_bool(0.8) { 4096 } else { bytes.len() };
                let at = random.random_range(0..reach);
                bytes[at] = random.random();
            }
            if random.random_bool(0.2) {
                bytes.truncate(random.random_range(0..whole.len()));
            }
            if let Ok(photo) = raw::decode(&bytes, name) {
                assert!(photo.mosaic.dn.pixels().len() <= bytes.len() * 8);
            }
        }
    }
}
