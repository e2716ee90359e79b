//! Frames as large as the field's, for benchmarks.

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use unlit::codec::cr2::{self, Cr2Content};
use unlit::pair::Settings;
use unlit::raster::Image;
use unlit::units::{FNumber, Iso, Seconds};

/// A lit object before a dark wall as a 5DS's 52.7 MP CR2; `light` is a share of the usual light. A 5DS's noise: some 5 DN of read noise, and shot noise of 0.2 DN an electron.
pub(crate) fn frame(light: f32) -> Vec<u8> {
    let brightness = light;
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
        let light =
            if masked { 0.0 } else { 9000.0 * brightness * colour * texture * (1.0 - 2.0 * (u * u + v * v)) };
        let spread = (25.0 + 0.2 * light).sqrt();
        (2047.0 + light + spread * noise[at]).round().clamp(0.0, 15_283.0) as u16
    });
    let settings = Settings {
        shutter: Some(Seconds(1.0 / 125.0)),
        aperture: Some(FNumber(11.0)),
        iso: Some(Iso(100.0)),
        taken_at: Some("2026-05-04T10:00:04".into()),
        ..Settings::default()
    };
    cr2::encode(&Cr2Content { sensor: &sensor, black: 2047, white: 15_283, settings: &settings }).unwrap()
}
