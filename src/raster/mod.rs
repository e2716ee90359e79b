//! Pure image arithmetic: the image type, sampling, filters, statistics. No files, no devices.

pub mod blocks;
pub mod blur;
pub mod sample;
pub mod srgb;

use serde::{Deserialize, Serialize};

/// A row-major image of `width * height` pixels; row 0 is the top. Pixel centres lie at
/// `(i + 0.5, j + 0.5)`, the origin is the top-left corner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Image<P> {
    width: usize,
    height: usize,
    pixels: Vec<P>,
}

/// Linear camera RGB, interleaved.
pub type Rgb = Image<[f32; 3]>;

impl<P: Clone> Image<P> {
    /// An image of one value.
    pub fn filled(width: usize, height: usize, value: P) -> Self {
        Self { width, height, pixels: vec![value; width * height] }
    }
}

impl<P> Image<P> {
    /// Wraps row-major pixels; `None` unless there are exactly `width * height` of them.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<P>) -> Option<Self> {
        (width.checked_mul(height)? == pixels.len()).then_some(Self { width, height, pixels })
    }

    /// Computes every pixel from its column and row.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> P) -> Self {
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                pixels.push(f(x, y));
            }
        }
        Self { width, height, pixels }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row-major.
    pub fn pixels(&self) -> &[P] {
        &self.pixels
    }

    /// All pixels, row-major, to be changed.
    pub fn pixels_mut(&mut self) -> &mut [P] {
        &mut self.pixels
    }

    /// The pixel at column `x`, row `y`; panics outside, like a slice.
    pub fn at(&self, x: usize, y: usize) -> &P {
        debug_assert!(x < self.width);
        &self.pixels[y * self.width + x]
    }

    /// The pixel at column `x`, row `y`, to be changed; panics outside, like a slice.
    pub fn at_mut(&mut self, x: usize, y: usize) -> &mut P {
        debug_assert!(x < self.width);
        &mut self.pixels[y * self.width + x]
    }

    /// The pixel at column `x`, row `y`, or `None` outside the frame.
    pub fn get(&self, x: isize, y: isize) -> Option<&P> {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        (x < self.width && y < self.height).then(|| &self.pixels[y * self.width + x])
    }

    /// One image of another, pixel by pixel.
    pub fn map<Q>(&self, f: impl FnMut(&P) -> Q) -> Image<Q> {
        Image { width: self.width, height: self.height, pixels: self.pixels.iter().map(f).collect() }
    }
}
