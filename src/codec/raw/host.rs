//! The decode host: a process that decodes one raw file with `rawler` and ends.
//!
//! `rawler` knows more cameras than `rawloader`, and was seen to ask for 4 GiB because a file said so, which ends
//! a process. So it runs in one of its own, under limits that the system enforces: `MEMORY` over and above the
//! file, `CPU_SECONDS` of processor time. Takes the file on standard input, gives the answer on standard output
//! (see `wire`); whatever goes wrong there is words in the parent.
//!
//! Levels, as the library has them: `blacklevel` is by position from the sensor's first site and repeats,
//! `whitelevel` is one value for all sites of a filter array, the filter array counts from the sensor's first site,
//! masked areas are by origin and size.

use super::sensor::Rect;
use super::wire::{self, Answer, Frame, Refusal};
use crate::pair::Settings;
use crate::photometry::Cfa;
use crate::units::{FNumber, Iso, Seconds};
use rawler::decoders::{RawDecodeParams, RawMetadata};
use rawler::rawimage::RawPhotometricInterpretation;
use rawler::rawsource::RawSource;
use rawler::{RawImage, RawImageData, RawlerError};
use rustix::process::{Resource, Rlimit, setrlimit};
use std::io::{self, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// Address space that decoding may take, not counting the file: two planes of 100 MP, the program, its threads.
pub(super) const MEMORY: u64 = 1200 << 20;
/// Processor time that a file may take.
pub(super) const CPU_SECONDS: u64 = 20;
/// No camera writes longer files.
const MAX_FILE: u64 = 1 << 30;

/// Decodes the one file that comes on standard input, answers on standard output, and returns.
///
/// Meant for a process of its own: it lowers the process's limits for good.
pub fn run() -> io::Result<()> {
    limit(Resource::Core, 0)?;
    // The signal of the lower limit says why; the higher one ends it should that not.
    setrlimit(Resource::Cpu, Rlimit { current: Some(CPU_SECONDS), maximum: Some(CPU_SECONDS + 5) })?;
    // The parent words every failure; a backtrace on a terminal that somebody works at helps nobody.
    std::panic::set_hook(Box::new(|_| {}));
    let mut input = io::stdin().lock();
    let length = wire::read_length(&mut input)?;
    let mut out = io::stdout().lock();
    if length > MAX_FILE {
        let message = format!("{length} bytes are more than any camera writes");
        return wire::answer(&mut out, &Answer::Refused(Refusal::Failed { message }), &[]);
    }
    limit(Resource::As, MEMORY + length)?;
    let mut bytes = vec![0; length as usize];
    input.read_exact(&mut bytes)?;
    let decoded = catch_unwind(AssertUnwindSafe(|| decode(bytes)));
    match decoded.unwrap_or_else(|_| Err(failed("the decoder panicked"))) {
        Ok((frame, plane)) => wire::answer(&mut out, &Answer::Frame(Box::new(frame)), &plane),
        Err(refusal) => wire::answer(&mut out, &Answer::Refused(refusal), &[]),
    }
}

fn limit(resource: Resource, most: u64) -> io::Result<()> {
    Ok(setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) })?)
}

fn failed(message: impl Into<String>) -> Refusal {
    Refusal::Failed { message: message.into() }
}

fn refusal(error: RawlerError) -> Refusal {
    match error {
        RawlerError::Unsupported { what, model, make, mode } => {
            let mode = if mode.is_empty() { String::new() } else { format!(", mode {mode}") };
            Refusal::Unknown { how: format!("{what}: {make} {model}{mode}") }
        }
        RawlerError::DecoderFailed(message) => {
            let first = message.lines().next().unwrap_or_default();
            if first.contains("Unsupported compression") {
                Refusal::Unknown { how: first.to_owned() }
            } else {
                failed(first)
            }
        }
    }
}

fn decode(bytes: Vec<u8>) -> Result<(Frame, Vec<u16>), Refusal> {
    let source = RawSource::new_from_shared_vec(Arc::new(bytes));
    let decoder = rawler::get_decoder(&source).map_err(refusal)?;
    let first = RawDecodeParams::default();
    let image = decoder.raw_image(&source, &first, false).map_err(refusal)?;
    // Metadata is extra: a frame whose metadata the library cannot read is still a frame.
    let metadata = catch_unwind(AssertUnwindSafe(|| decoder.raw_metadata(&source, &first)));
    let settings = match metadata {
        Ok(Ok(metadata)) => settings(&image, &metadata),
        _ => Settings::default(),
    };
    frame(image, settings)
}

fn frame(image: RawImage, settings: Settings) -> Result<(Frame, Vec<u16>), Refusal> {
    let RawPhotometricInterpretation::Cfa(config) = &image.photometric else {
        return Err(Refusal::Demosaiced);
    };
    if image.cpp != 1 {
        return Err(Refusal::Demosaiced);
    }
    let cfa = &config.cfa;
    if (cfa.width, cfa.height) != (2, 2) || !cfa.is_rgb() {
        return Err(Refusal::Pattern { pattern: cfa.name.clone() });
    }
    if image.fuji_rotation_width.is_some() {
        return Err(Refusal::Pattern { pattern: format!("{} turned by 45 degrees", cfa.name) });
    }
    let (width, height) = (image.width, image.height);
    let whole = Rect { top: 0, left: 0, bottom: height, right: width };
    let active = image.active_area.map_or(whole, rect);
    let positions = [[(0, 0), (0, 1)], [(1, 0), (1, 1)]]
        .map(|row| row.map(|(y, x): (usize, usize)| (y + active.top, x + active.left)));
    let black = &image.blacklevel;
    let by_position = black.levels.len() == black.width * black.height && !black.levels.is_empty();
    if !by_position || image.whitelevel.0.is_empty() {
        return Err(failed("its levels are not one a site of the filter array"));
    }
    let black_at =
        |(y, x): (usize, usize)| black.levels[(y % black.height) * black.width + x % black.width].as_f32();
    let white = image.whitelevel.0[0] as f32;
    let answer = Frame {
        width,
        height,
        active,
        cfa: Cfa(positions.map(|row| row.map(|(y, x)| cfa.color_at(y, x) as u8))),
        masked: image.blackareas.iter().copied().map(rect).filter_map(|r| inside(r, width, height)).collect(),
        black: positions.map(|row| row.map(black_at)),
        saturation: [[white; 2]; 2],
        settings,
    };
    match image.data {
        RawImageData::Integer(plane) if plane.len() == width * height => Ok((answer, plane)),
        RawImageData::Integer(plane) => {
            Err(failed(format!("{} values for {width} x {height} sites", plane.len())))
        }
        RawImageData::Float(_) => Err(Refusal::Unknown { how: "floating-point sensor data".to_owned() }),
    }
}

fn rect(r: rawler::imgop::Rect) -> Rect {
    Rect { top: r.p.y, left: r.p.x, bottom: r.p.y + r.d.h, right: r.p.x + r.d.w }
}

/// The part of `r` inside a plane of `width` x `height`; `None` if there is none.
fn inside(r: Rect, width: usize, height: usize) -> Option<Rect> {
    let r = Rect { bottom: r.bottom.min(height), right: r.right.min(width), ..r };
    (r.top < r.bottom && r.left < r.right).then_some(r)
}

/// Settings as far as the library tells them; the file's own directories tell more where they can be read.
fn settings(image: &RawImage, metadata: &RawMetadata) -> Settings {
    let exif = &metadata.exif;
    let told = |text: &str| (!text.trim().is_empty()).then(|| text.trim().to_owned());
    let ratio = |r: &rawler::formats::tiff::Rational| f64::from(r.n) / f64::from(r.d);
    let positive = |v: f64| (v.is_finite() && v > 0.0).then_some(v);
    let short_iso = exif.iso_speed_ratings.filter(|v| (1..u16::MAX).contains(v)).map(u32::from);
    let iso = short_iso.or(exif.recommended_exposure_index).or(exif.iso_speed).filter(|v| *v > 0);
    let words = crate::codec::exif::program_word;
    Settings {
        make: told(&image.make),
        model: told(&image.model),
        serial: exif.serial_number.as_deref().and_then(told),
        lens: exif.lens_model.as_deref().and_then(told),
        shutter: exif.exposure_time.as_ref().map(ratio).and_then(positive).map(Seconds),
        aperture: exif.fnumber.as_ref().map(ratio).and_then(positive).map(FNumber),
        iso: iso.map(|v| Iso(f64::from(v))),
        focal_length_mm: exif.focal_length.as_ref().map(ratio).and_then(positive),
        exposure_program: exif.exposure_program.map(f64::from).and_then(words),
        white_balance: exif.white_balance.map(f64::from).and_then(crate::codec::exif::white_balance_word),
        taken_at: exif.date_time_original.as_deref().and_then(crate::codec::exif::date),
        ..Settings::default()
    }
}
