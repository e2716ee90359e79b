//! What the checks of one pair of 50 MP cost after its files are decoded: `cargo bench --profile dev --bench checks`.
//!
//! CPU seconds (all threads) from `/proc/self/stat`, peak memory from `/proc/self/status`. The frames are
//! synthetic, 8688 x 5792 sites with structure and noise; decoding is measured elsewhere.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::Instant;
use unlit::pair::{Expected, Files, FrameView, Limits, Settings, judge_expecting, parts};
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;

const WIDTH: usize = 8688;
const HEIGHT: usize = 5792;
/// Rounds of each measurement: the clock of `/proc` ticks every 10 ms.
const ROUNDS: u32 = 5;

/// One frame; `gain` is how much brighter it is than the room.
fn frame(seed: u32, gain: f32) -> Mosaic {
    let mut state = seed;
    let mut random = move || {
        // A linear congruence is noise enough here.
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) as f32 / 65_536.0 - 0.5
    };
    let dn = Image::from_fn(WIDTH, HEIGHT, |x, y| {
        let (fx, fy) = (x as f32, y as f32);
        let structure = (fx / 37.0).sin() * (fy / 29.0).cos() + (fx * fy / 700_000.0).sin();
        let light = gain * (1000.0 + 300.0 * structure);
        (2048.0 + light + light.sqrt() * (random() + random() + random())).round() as u16
    });
    let levels = Levels {
        black: [[2048.0; 2]; 2],
        saturation: [[15_383.0; 2]; 2],
        black_source: LevelSource::MaskedPixels,
        saturation_source: LevelSource::BodyTable,
    };
    Mosaic { dn, cfa: Cfa::RGGB, levels }
}

/// CPU seconds of this process so far, user and system.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<f64> =
        stat.rsplit(')').next().unwrap_or("").split_whitespace().map(|f| f.parse().unwrap_or(0.0)).collect();
    // Fields 14 and 15 of the whole line, in hundredths of a second on every Linux in use.
    fields.get(11..13).map_or(0.0, |ticks| ticks.iter().sum::<f64>() / 100.0)
}

fn peak_megabytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).unwrap_or("");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

fn measured<T>(what: &str, mut work: impl FnMut() -> T) {
    let (cpu, clock) = (cpu_seconds(), Instant::now());
    for _ in 0..ROUNDS {
        black_box(work());
    }
    let rounds = f64::from(ROUNDS);
    let (cpu, clock) = ((cpu_seconds() - cpu) / rounds, clock.elapsed().as_secs_f64() / rounds);
    println!("{what:<44} {cpu:>7.3} CPU-s {clock:>7.3} s");
}

fn main() {
    let (off, on) = (frame(1, 1.0), frame(2, 3.0));
    println!("one pair of {WIDTH} x {HEIGHT} sites; both frames together");
    println!("{:<44} {:>7.0} MB peak", "frames alone", peak_megabytes());
    let survey = parts::survey(&off, &on);
    measured("walk over the pixels: clipping, rise, cells", || parts::survey(&off, &on));
    measured("movement", || survey.movement());
    measured("stop signature", || survey.stop());
    // A file of 55 MB a frame, as a 5DS writes it.
    let file: Vec<u8> = off.dn.pixels().iter().take(55 << 20).map(|v| *v as u8).collect();
    measured("BLAKE3 of both files, once", || [blake3::hash(&file), blake3::hash(&file)]);
    let settings = Settings::default();
    let earlier = BTreeMap::new();
    let stops: Vec<_> = survey.stop().into_iter().cycle().take(200).collect();
    let view = |mosaic| FrameView { mosaic, settings: &settings };
    let files = Some(Files { off: "a", on: "b", more: &[], earlier: &earlier, may_share_unlit: false });
    let expected = Expected { earlier: Some(&stops), files, ..Expected::default() };
    let mut reasons = 0;
    measured("all checks, against 200 earlier stops", || {
        reasons = judge_expecting(view(&off), view(&on), &expected, &Limits::default()).reasons.len();
    });
    println!("{:<44} {:>7.0} MB peak, {reasons} reasons to reject", "", peak_megabytes());
}
