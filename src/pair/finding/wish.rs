//! What goes into the search for an exposure and what comes out of it.

use super::MOST_SHOTS;
use crate::pair::plan::{Exposure, Plan, Window};
use crate::units::Seconds;
use serde::{Deserialize, Serialize};

/// Settings that must stay where they stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Keep {
    /// Exposure time.
    pub shutter: bool,
    /// Aperture, for the depth of field.
    pub aperture: bool,
    /// Sensitivity.
    pub iso: bool,
}

/// What the operator wishes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// Where the object is; the whole frame if absent.
    pub region: Option<Window>,
    /// Share of saturation at which the brightest channel of the lit frame shall end, 0 to 1.
    pub target_share: f64,
    /// Largest share of a channel's sites in the region that may be clipped.
    pub clipped_share: f64,
    /// Whether the room is dark, so that no test shot without flash is needed.
    pub flash_only: bool,
    /// What must stay.
    pub keep: Keep,
    /// Whether the unlit frame may be exposed longer, for less noise.
    pub separate_off: bool,
    /// Fastest shutter at which the whole frame sees the flash.
    pub x_sync: Seconds,
}

impl Wish {
    /// The usual wish for a region: 85 % of saturation, 1 % clipped at most, everything free, X-sync at 1/200 s.
    pub fn of(region: Option<Window>) -> Self {
        Self {
            region,
            target_share: 0.85,
            clipped_share: 0.01,
            flash_only: false,
            keep: Keep::default(),
            separate_off: false,
            x_sync: Seconds(1.0 / 200.0),
        }
    }
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// Take a test shot and show it to [`super::Finding::observe`].
    Shoot {
        /// Settings of the shot.
        exposure: Exposure,
        /// Whether the flash shall fire.
        flash: bool,
    },
    /// The plan is found.
    Done(Found),
}

/// The exposures found, and what they give.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Exposures of both frames.
    pub plan: Plan,
    /// Share of saturation of the lit frame's brightest channel.
    pub predicted_share: f64,
    /// Of that, the room's light.
    pub ambient_share: f64,
    /// Of that, the flash's light.
    pub flash_share: f64,
    /// Test shots taken.
    pub shots: usize,
    /// What the operator should know, in sentences.
    pub warnings: Vec<String>,
}

/// Why no exposure can be found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FindingError {
    /// A wish that cannot be.
    #[error("{0}")]
    Wish(String),
    /// Nothing offered is dark enough.
    #[error(
        "even at {exposure} the brightest channel ends at {:.0} % of saturation instead of {:.0} %; {advice}, and try again",
        100.0 * share, 100.0 * target
    )]
    TooBright {
        /// The darkest settings offered.
        exposure: Exposure,
        /// Where they end, a share of saturation.
        share: f64,
        /// Where they should.
        target: f64,
        /// What to change.
        advice: &'static str,
    },
    /// Nothing offered is bright enough.
    #[error(
        "even at {exposure} the brightest channel reaches {:.1} % of saturation only, not {:.0} %; raise the flash's power, bring it nearer, or free aperture and ISO, and try again",
        100.0 * share, 100.0 * target
    )]
    TooDark {
        /// The brightest settings offered.
        exposure: Exposure,
        /// Where they end, a share of saturation.
        share: f64,
        /// Where they should.
        target: f64,
    },
    /// The offered steps are too coarse.
    #[error(
        "the nearest settings offered, {exposure}, end at {:.0} % of saturation instead of {:.0} %; set the camera to third stops, or free one more setting",
        100.0 * share, 100.0 * target
    )]
    TooCoarse {
        /// The nearest settings.
        exposure: Exposure,
        /// Where they end, a share of saturation.
        share: f64,
        /// Where they should.
        target: f64,
    },
    /// No shots are left and the last was clipped or too dark to tell.
    #[error(
        "{MOST_SHOTS} test shots did not settle the exposure: set {next} on the camera and try again from there; if that does not settle it either, the light changes from shot to shot: let the flash recharge, keep lamps and windows steady"
    )]
    Unsettled {
        /// Where to begin again.
        next: Exposure,
    },
}
