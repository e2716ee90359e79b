//! Where a card stands, from AprilTags of known size on it.
//!
//! The detector's corners are good to about half a pixel; here the sides of the black square are measured again on the
//! linear picture (module `sides`), and the card's plane is fitted to them (module `pose`): all tags lie in one plane,
//! each where it likes. A tag's black, and the paper around it, are no part of the card ([`CardPose::covers`]).

mod pose;
mod sides;
#[cfg(test)]
mod tests;

use super::Plane;
use crate::codec::apriltag::Tag;
use crate::photometry::{Mosaic, linear};
use crate::raster::Image;
use crate::scene::Intrinsics;
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Shortest side of a tag that is measured, pixels of the frame.
const LEAST_SIDE: f64 = 48.0;

/// Sites per pixel of the grey picture, either way.
const SITES: usize = 2;

/// Share of the range above which a grey value may hold clipped sites.
const NEAR_CLIP: f32 = 0.97;

/// A frame in grey at half its size: its green sites, two of every four, whose mean lies in the middle of the four.
#[derive(Clone, Debug, PartialEq)]
pub struct Grey {
    /// Linear DN above black. Position p of it is position 2 p of the frame.
    pub image: Image<[f32; 1]>,
    /// DN from which values are clipped.
    pub ceiling: f32,
}

/// A tag as it lies on the card.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CardTag {
    /// Its number in the family.
    pub id: usize,
    /// Corners of its black square by the fit, pixels of the frame, clockwise from the upright tag's top left one.
    pub corners_px: [DVec2; 4],
    /// Centre, camera frame, metres.
    pub centre_m: DVec3,
    /// Unit vectors along the upright tag's rows (to the right) and columns (down), camera frame.
    pub axes: [DVec3; 2],
    /// Mean difference of the bits' grey from the threshold, of 255.
    pub decision_margin: f32,
    /// Bits that were read wrong and corrected.
    pub wrong_bits: usize,
}

/// Where a card stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CardPose {
    /// Its plane, camera frame.
    pub plane: Plane,
    /// Distance from the lens's centre of projection along its axis, metres.
    pub distance_m: f64,
    /// Standard error of it, from the picture alone: a wrong tag size or focal length scales the distance and is not in it.
    pub distance_m_standard_error: f64,
    /// Root mean square angle between the normal found and the true one, radians.
    pub normal_rad_standard_error: f64,
    /// Root mean square distance of the sides' points from the fit, pixels of the frame.
    pub rms_px: f64,
    /// Side of the black squares that was given, metres.
    pub tag_size_m: f64,
    /// The tags.
    pub tags: Vec<CardTag>,
    /// Another plane that the picture allows as well; absent if the picture tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub other: Option<Plane>,
}

/// A shot's tags beside what was said of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CardSight {
    /// File name.
    pub label: String,
    /// Distance that was given, and used, in spite of the tags.
    pub given_distance_m: Option<f64>,
    /// What the tags tell.
    #[serde(flatten)]
    pub pose: CardPose,
}

/// Why tags do not tell where the card stands.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TagError {
    /// A size that cannot be.
    #[error("a tag of {0} m is not possible: give the side of its black square in metres, for example 0.05")]
    Size(f64),
    /// None seen.
    #[error(
        "no AprilTag of the family tag36h11 was found: it must be sharp, flat, wholly in the frame, with white paper around its black square"
    )]
    None,
    /// All too small.
    #[error("tag {id} is {side_px:.0} pixels wide, of {} at least: print it larger or go nearer", LEAST_SIDE)]
    Small {
        /// Its number.
        id: usize,
        /// Shortest side, pixels of the frame.
        side_px: f64,
    },
    /// The sides are not there.
    #[error("the sides of tag {0} cannot be measured: they are not sharp, or something covers them")]
    Blurred(usize),
    /// White is clipped.
    #[error(
        "the paper around tag {0} is over-exposed, so that its size cannot be measured: put the card farther away or turn the flash down"
    )]
    Clipped(usize),
    /// Not a plane square.
    #[error(
        "the sides of the tags are {rms_px:.1} pixels off a flat square's: is the card flat, and are focal length and lens distortion those of this lens?"
    )]
    Bent {
        /// Root mean square, pixels of the frame.
        rms_px: f64,
    },
    /// Several planes.
    #[error(
        "the tags do not lie in one plane: together they are {joint_px:.2} pixels off, each by itself {own_px:.2}; leave only the card's tags, all of one size, in the frame"
    )]
    Planes {
        /// Of all tags in one plane, pixels of the frame.
        joint_px: f64,
        /// Of each by itself.
        own_px: f64,
    },
    /// The fit went astray.
    #[error("no plane before the camera explains the tags: is the focal length that of this lens?")]
    Vague,
}

impl Grey {
    /// Of a frame; `None` if its filter array has no green or it is too small.
    pub fn of(frame: &Mosaic) -> Option<Self> {
        let (width, height) = (frame.dn.width() / SITES, frame.dn.height() / SITES);
        let green: Vec<(usize, usize)> = frame.cfa.positions(1).collect();
        let range = |(y, x): &(usize, usize)| frame.levels.saturation[*y][*x] - frame.levels.black[*y][*x];
        let top = green.iter().map(range).fold(f32::INFINITY, f32::min);
        if width * height == 0 || green.is_empty() || !top.is_finite() {
            return None;
        }
        let image = Image::from_fn(width, height, |x, y| {
            let value = |(j, i): &(usize, usize)| linear(frame, SITES * x + i, SITES * y + j).unwrap_or(top);
            [green.iter().map(value).sum::<f32>() / green.len() as f32]
        });
        Some(Self { image, ceiling: NEAR_CLIP * top })
    }

    /// For the detector: square roots, so that noise is about even, of which 255 is the brightest.
    pub fn eight_bits(&self) -> Image<u8> {
        let top = self.image.pixels().iter().map(|[v]| *v).fold(0.0, f32::max).max(1.0);
        self.image.map(|[v]| (255.0 * (v.max(0.0) / top).sqrt()) as u8)
    }
}

/// The card's plane from tags found on [`Grey::eight_bits`]; `size_m` is the side of their black squares.
pub fn card_pose(
    grey: &Grey,
    found: &[Tag],
    intrinsics: &Intrinsics,
    size_m: f64,
) -> Result<CardPose, TagError> {
    if !(size_m.is_finite() && size_m > 0.0) {
        return Err(TagError::Size(size_m));
    }
    let scale = SITES as f64;
    let (mut squares, mut kept, mut why) = (vec![], vec![], TagError::None);
    for tag in found {
        let side = |k: usize| scale * tag.corners[k].distance(tag.corners[(k + 1) % 4]);
        let side_px = (0..4).map(side).fold(f64::INFINITY, f64::min);
        if side_px < LEAST_SIDE {
            why = TagError::Small { id: tag.id, side_px };
            continue;
        }
        match sides::sides(grey, tag) {
            Ok(sides) => {
                let ideal = |p: DVec2| pose::ideal(intrinsics, scale * p);
                squares.push(pose::Square {
                    corners: tag.corners.map(ideal),
                    sides: sides.map(|side| side.into_iter().map(ideal).collect()),
                });
                kept.push(tag);
            }
            Err(error) => why = error,
        }
    }
    // One tag that is half covered or too far is no harm among others.
    if kept.is_empty() {
        return Err(why);
    }
    let fit = pose::fit(&squares, intrinsics.focal, size_m)?;
    let tags = kept.iter().zip(&fit.places).map(|(tag, place)| CardTag {
        id: tag.id,
        corners_px: place.corners.map(|c| pose::pixel(intrinsics, c)),
        centre_m: place.centre,
        axes: place.axes,
        decision_margin: tag.margin,
        wrong_bits: tag.hamming,
    });
    Ok(CardPose {
        plane: fit.plane,
        distance_m: fit.plane.distance(),
        distance_m_standard_error: fit.distance_error,
        normal_rad_standard_error: fit.normal_error,
        rms_px: fit.rms,
        tag_size_m: size_m,
        tags: tags.collect(),
        other: fit.other,
    })
}

impl CardPose {
    /// Whether a square of `edge` pixels about a pixel position shows any of a tag, or of the `outset` metres around its
    /// black square.
    pub fn covers(&self, intrinsics: &Intrinsics, centre: DVec2, edge: f64, outset: f64) -> bool {
        let at = pose::ideal(intrinsics, centre) / intrinsics.focal;
        let Some(point) = self.plane.meets(at.extend(1.0)) else { return false };
        // Half a diagonal of the square, on the card, which may be seen aslant.
        let slant = -self.plane.normal.dot(point) / point.length();
        let reach = edge * 0.5f64.sqrt() * point.z / (intrinsics.focal.min_element() * slant.max(0.1));
        self.tags.iter().any(|tag| {
            let from = point - tag.centre_m;
            let off = tag.axes.map(|axis| axis.dot(from).abs());
            off[0].max(off[1]) < self.tag_size_m / 2.0 + outset + reach
        })
    }
}
