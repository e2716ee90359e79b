//! What decoding a 52.7 MP CR2 costs: processor seconds, wall-clock seconds, peak memory; one frame and two at a
//! time, by the first decoder and by the second in its processes.
//!
//!     cargo bench --profile dev --bench decode

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark stops at the first thing that is wrong"
)]

#[path = "../tests/all/processes.rs"]
mod processes;

use processes::{ChildWatch, cpu_seconds, forget_peak, peak_kilobytes};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use std::time::Instant;
use unlit::codec::cr2::{self, Cr2Content};
use unlit::codec::raw;
use unlit::pair::Settings;
use unlit::raster::Image;

/// A lit object before a dark wall with a 5DS's noise: some 5 DN of read noise, and shot noise of 0.2 DN an electron.
fn frame() -> Vec<u8> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let normal = Normal::new(0.0f32, 1.0).unwrap();
    // Drawn once and walked through with a stride: 50 million draws take longer than all that is measured.
    let noise: Vec<f32> = (0..1 << 20).map(|_| normal.sample(&mut random)).collect();
    let (width, height) = cr2::SENSOR;
    let mut at = 0usize;
    let sensor = Image::from_fn(width, height, |x, y| {
        at = (at + 7919) & (noise.len() - 1);
        let masked = x < cr2::BORDER_LEFT || y < cr2::BORDER_TOP;
        let (u, v) = (x as f32 / width as f32 - 0.5, y as f32 / height as f32 - 0.5);
        let texture = 1.0 + 0.1 * (x as f32 * 0.05).sin() * (y as f32 * 0.07).cos();
        let colour = [[0.55, 1.0], [1.0, 0.7]][y & 1][x & 1];
        let light = if masked { 0.0 } else { 9000.0 * colour * texture * (1.0 - 2.0 * (u * u + v * v)) };
        let spread = (25.0 + 0.2 * light).sqrt();
        (2047.0 + light + spread * noise[at]).round().clamp(0.0, 15_283.0) as u16
    });
    let settings = Settings { taken_at: Some("2026-05-04T10:00:04".into()), ..Settings::default() };
    cr2::encode(&Cr2Content { sensor: &sensor, black: 2047, white: 15_283, settings: &settings }).unwrap()
}

fn measure(name: &str, frames: usize, work: impl Fn() + Sync) {
    for _ in 0..2 {
        forget_peak();
        let watch = ChildWatch::start();
        let (cpu, begun) = (cpu_seconds(), Instant::now());
        std::thread::scope(|scope| {
            (1..frames).for_each(|_| drop(scope.spawn(&work)));
            work();
        });
        println!(
            "{name:<44} {:>6.2} CPU-s {:>6.2} s wall {:>6.0} MB here {:>6.0} MB in a child",
            cpu_seconds() - cpu,
            begun.elapsed().as_secs_f64(),
            peak_kilobytes("self").unwrap_or(0) as f64 / 1024.0,
            watch.peak() as f64 / 1024.0,
        );
    }
}

fn main() {
    raw::set_decoder_program(env!("CARGO_BIN_EXE_unlit"));
    let begun = Instant::now();
    let file = frame();
    println!("{} bytes, written in {:.1} s", file.len(), begun.elapsed().as_secs_f64());
    let first = || drop(raw::decode(&file, "bench.cr2").unwrap());
    let second = || drop(raw::decode_with_second(&file, "bench.cr2").unwrap());
    let bare = || drop(rawloader::decode(&mut file.as_slice()).unwrap());
    let size = || drop(rawloader::decode_dummy(&mut file.as_slice()).unwrap());
    measure("rawloader alone, one frame", 1, bare);
    measure("rawloader's question for the size", 1, size);
    measure("first decoder, one frame", 1, first);
    measure("first decoder, a pair at a time", 2, first);
    measure("second decoder in its process, one frame", 1, second);
    measure("second decoder in its processes, a pair", 2, second);
}
