//! PNG bytes for textures embedded in models and for previews.

use crate::raster::Image;
use image::ImageEncoder as _;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

/// The picture has no pixels, or more than PNG can name.
#[derive(Debug, thiserror::Error)]
#[error("cannot encode a picture of {width} x {height} pixels as PNG: {reason}")]
pub struct PngError {
    width: usize,
    height: usize,
    reason: String,
}

/// Encodes 8-bit RGB as PNG; the values are taken as sRGB-encoded by whoever shows them.
pub fn encode_rgb8(image: &Image<[u8; 3]>) -> Result<Vec<u8>, PngError> {
    let fail = |reason: String| PngError { width: image.width(), height: image.height(), reason };
    let size = |n: usize| u32::try_from(n).map_err(|e| fail(e.to_string()));
    if image.pixels().is_empty() {
        return Err(fail("it is empty".into()));
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(
            image.pixels().as_flattened(),
            size(image.width())?,
            size(image.height())?,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(|e| fail(e.to_string()))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_come_back_from_png() {
        let picture = Image::from_fn(19, 8, |x, y| [x as u8, (y * 30) as u8, (x * y) as u8]);
        let bytes = encode_rgb8(&picture).unwrap();
        let back = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png).unwrap().to_rgb8();
        assert_eq!(back.dimensions(), (19, 8));
        assert_eq!(back.as_raw(), picture.pixels().as_flattened());
        assert!(encode_rgb8(&Image::filled(0, 3, [0; 3])).is_err());
    }
}
