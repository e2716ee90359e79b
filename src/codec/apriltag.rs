//! AprilTags in a picture, by the library of their authors (AprilRobotics' C library, BSD-2-Clause, inside the crate).
//!
//! Olson, "AprilTag: A robust and flexible visual fiducial system", ICRA 2011; Wang and Olson, "AprilTag 2", IROS 2016.

use crate::raster::Image;
use apriltag::{DetectorBuilder, Family};
use glam::DVec2;

/// Wrong bits of the 36 up to which a code is read. Codes of the family differ in 11 or more.
const MOST_WRONG_BITS: usize = 1;

/// Mean difference of the bits' grey from the threshold (of 255) below which a reading is chance.
const LEAST_MARGIN: f32 = 12.0;

/// Shorter side of a picture, pixels, below which nothing can be found in it.
const LEAST_EDGE: usize = 32;

/// A tag of the family tag36h11 as it was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family, 0 to 586.
    pub id: usize,
    /// Corners of the black square in pixels, those of the upright tag from the top left one clockwise. Good to about
    /// half a pixel.
    pub corners: [DVec2; 4],
    /// Mean difference of the bits' grey from the threshold, of 255.
    pub margin: f32,
    /// Bits that were read wrong and corrected.
    pub hamming: usize,
}

/// The detector failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a picture of {width} x {height} pixels cannot be searched for AprilTags: {reason}")]
pub struct FindError {
    width: usize,
    height: usize,
    reason: String,
}

/// Finds the tags of the family tag36h11, by number. Dark is 0.
pub fn find(picture: &Image<u8>) -> Result<Vec<Tag>, FindError> {
    let (width, height) = (picture.width(), picture.height());
    if width.min(height) < LEAST_EDGE {
        return Ok(vec![]);
    }
    let fail = |reason: String| FindError { width, height, reason };
    // The library counts in 16 bits.
    if width.max(height) > 32_000 {
        return Err(fail("a side is longer than 32000".into()));
    }
    let mut image =
        apriltag::Image::zeros_with_alignment(width, height, 96).map_err(|e| fail(e.to_string()))?;
    let stride = image.stride();
    for (to, from) in image.as_slice_mut().chunks_mut(stride).zip(picture.pixels().chunks(width)) {
        to[..width].copy_from_slice(from);
    }
    let mut detector = DetectorBuilder::new()
        .add_family_bits(Family::tag_36h11(), MOST_WRONG_BITS)
        .build()
        .map_err(|e| fail(e.to_string()))?;
    detector.set_decimation(1.0);
    detector.set_thread_number(1);
    let found = detector.detect(&image);
    let mut tags: Vec<Tag> = found
        .iter()
        .map(|tag| {
            // The library goes round counterclockwise from the bottom left.
            let [d, c, b, a] = tag.corners().map(DVec2::from_array);
            Tag { id: tag.id(), corners: [a, b, c, d], margin: tag.decision_margin(), hamming: tag.hamming() }
        })
        .filter(|tag| tag.margin >= LEAST_MARGIN && tag.corners.iter().all(|c| c.is_finite()))
        .collect();
    tags.sort_by_key(|tag| tag.id);
    Ok(tags)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_without_tags_have_none_and_endless_ones_are_refused() {
        assert_eq!(find(&Image::filled(0, 0, 0)), Ok(vec![]));
        assert_eq!(find(&Image::filled(31, 500, 9)), Ok(vec![]));
        assert_eq!(find(&Image::filled(64, 33, 200)), Ok(vec![]));
        let hash = |x: usize, y: usize| (((x * 7919 + y * 104_729) * (x + 3 * y + 1)) >> 3) as u8;
        assert_eq!(find(&Image::from_fn(301, 203, hash)), Ok(vec![]));
        let boxes = Image::from_fn(300, 200, |x, y| if x % 100 < 60 && y % 100 < 60 { 0 } else { 255 });
        assert_eq!(find(&boxes), Ok(vec![]));
        let refused = find(&Image::filled(32_001, 32, 0)).unwrap_err().to_string();
        assert!(refused.contains("32001"), "{refused}");
    }
}
