//! AprilTags on a card, from frames: where it stands, in place of a distance that somebody measured.

use crate::calibration::Plane;
use crate::calibration::tags::{CardPose, CardSight, Grey, TagError, card_pose};
use crate::codec::apriltag::{self, FindError};
use crate::photometry::Mosaic;
use crate::scene::Intrinsics;

/// Relative difference of a given distance from the tags' that is told.
const DIFFERENT: f64 = 0.02;

/// Error of the normal that is told, radians: 2 degrees.
const VAGUE_NORMAL: f64 = 0.035;

/// What is known of the tags on a card.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagFacts {
    /// Side of the black squares, metres; one for all.
    pub size_m: f64,
    /// How far the paper that a tag is printed on reaches beyond its black square, metres; it is not of the card's
    /// reflectance. Absent: an eighth of the square, which is the tag's own white border.
    pub outset_m: Option<f64>,
}

/// Why tags did not tell where a card stands.
#[derive(Debug, thiserror::Error)]
pub enum CardTagError {
    /// The detector failed.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The tags do not tell.
    #[error(transparent)]
    Tag(#[from] TagError),
}

impl TagFacts {
    /// Outset in metres.
    pub(super) fn outset(&self) -> f64 {
        self.outset_m.unwrap_or(self.size_m / 8.0)
    }
}

/// Where the card stands by the tags in the first of its frames that shows them well.
pub(super) fn look(
    frames: &[&Mosaic],
    intrinsics: &Intrinsics,
    facts: &TagFacts,
) -> Result<CardPose, CardTagError> {
    let mut first = None;
    for frame in frames {
        match of_frame(frame, intrinsics, facts) {
            Ok(pose) => return Ok(pose),
            // What is wrong with the lit frame tells more.
            Err(error) => first = first.or(Some(error)),
        }
    }
    Err(first.unwrap_or(TagError::None.into()))
}

fn of_frame(frame: &Mosaic, intrinsics: &Intrinsics, facts: &TagFacts) -> Result<CardPose, CardTagError> {
    let grey = Grey::of(frame).ok_or(TagError::None)?;
    let tags = apriltag::find(&grey.eight_bits())?;
    Ok(card_pose(&grey, &tags, intrinsics, facts.size_m)?)
}

/// What people are told of the tags beside the fit.
pub(super) fn sentences(sights: &[CardSight]) -> Vec<String> {
    let mut out = vec![];
    let placed: Vec<&CardSight> = sights.iter().filter(|s| s.given_distance_m.is_none()).collect();
    if let Some(first) = placed.first() {
        let worst =
            placed.iter().map(|s| s.pose.distance_m_standard_error / s.pose.distance_m).fold(0.0, f64::max);
        out.push(format!(
            "AprilTags of {:.1} mm told where the card stood in {} shots, distances to {:.2} % (standard error); a tag size or focal length that is 1 % wrong makes them 1 % wrong too.",
            1e3 * first.pose.tag_size_m,
            placed.len(),
            100.0 * worst
        ));
    }
    for sight in sights {
        let (label, pose) = (&sight.label, &sight.pose);
        if let Some(given) = sight.given_distance_m
            && (pose.distance_m / given - 1.0).abs() > DIFFERENT
        {
            out.push(format!(
                "{label}: {given:.3} m was given and used, but the tags tell {:.3} m ({:+.1} %); check the ruler, the side of the black square and the focal length.",
                pose.distance_m,
                100.0 * (pose.distance_m / given - 1.0)
            ));
        }
        if sight.given_distance_m.is_some() {
            continue;
        }
        if let Some(Plane { normal, .. }) = pose.other {
            out.push(format!(
                "{label}: the tags allow another tilt as well, {:.1} degrees off the one that was used; larger tags, or one in each corner of the card, tell.",
                normal.angle_between(pose.plane.normal).to_degrees()
            ));
        } else if pose.normal_rad_standard_error > VAGUE_NORMAL {
            out.push(format!(
                "{label}: the tags tell the card's tilt to {:.1} degrees only; larger tags, or one in each corner of the card, tell it better.",
                pose.normal_rad_standard_error.to_degrees()
            ));
        }
    }
    out
}
