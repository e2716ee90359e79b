//! What decoding a 52.7 MP CR2 costs: processor seconds, wall-clock seconds, peak memory; one frame and two at a
//! time, by the first decoder and by the second in its processes.
//!
//!     cargo bench --profile dev --bench decode

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark stops at the first thing that is wrong"
)]

#[path = "shared/frames.rs"]
mod frames;
#[path = "../tests/all/processes.rs"]
mod processes;

use processes::{ChildWatch, cpu_seconds, forget_peak, peak_kilobytes};
use std::time::Instant;
use unlit::codec::raw;

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
    let file = frames::frame(1.0);
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
