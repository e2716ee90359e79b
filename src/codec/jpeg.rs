//! JPEG files, written for the eye.

use super::exif_block;
use crate::pair::Settings;
use crate::raster::Image;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;

/// Why an image could not be encoded.
#[derive(Debug, thiserror::Error)]
#[error("an image of {width} x {height} pixels cannot be a JPEG: {reason}")]
pub struct JpegError {
    width: usize,
    height: usize,
    reason: String,
}

/// Encodes 8-bit sRGB pixels; `quality` 1..100.
pub fn encode(picture: &Image<[u8; 3]>, quality: u8) -> Result<Vec<u8>, JpegError> {
    let (width, height) = (picture.width(), picture.height());
    let fail = |reason: String| JpegError { width, height, reason };
    let side = |n: usize| u32::try_from(n).map_err(|e| fail(e.to_string()));
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(picture.pixels().as_flattened(), side(width)?, side(height)?, ExtendedColorType::Rgb8)
        .map_err(|e| fail(e.to_string()))?;
    Ok(bytes)
}

/// As [`encode`], with EXIF that tells with what the picture was taken.
pub fn encode_taken(
    picture: &Image<[u8; 3]>,
    quality: u8,
    settings: &Settings,
) -> Result<Vec<u8>, JpegError> {
    let fail = |reason: String| JpegError { width: picture.width(), height: picture.height(), reason };
    let block = exif_block::encode(settings).map_err(|e| fail(e.to_string()))?;
    let bytes = encode(picture, quality)?;
    let mut segment = b"Exif\0\0".to_vec();
    segment.extend(block);
    let length = u16::try_from(segment.len() + 2).map_err(|e| fail(e.to_string()))?;
    // EXIF stands right behind the start of the image.
    let (start, rest) = bytes.split_at(2);
    Ok([start, &[0xff, 0xe1], &length.to_be_bytes(), &segment, rest].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jpeg_reads_back_in_size_and_colour() {
        let bytes = encode(&Image::filled(16, 8, [200, 100, 50]), 95).unwrap();
        let read = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (16, 8));
        let pixel = read.get_pixel(8, 4).0;
        assert!(pixel.iter().zip([200i32, 100, 50]).all(|(a, b)| (i32::from(*a) - b).abs() < 6), "{pixel:?}");
    }

    #[test]
    fn an_image_that_is_too_large_is_refused_with_its_size() {
        let error = encode(&Image::filled(70_000, 1, [0; 3]), 90).unwrap_err().to_string();
        assert!(error.contains("70000"), "{error}");
    }
}
