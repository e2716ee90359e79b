//! The simulated studio on the wire.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The simulated studio as it stands.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct StudioBody {
    /// Where the simulated operator stands, in words.
    pub words: String,
    /// The stop, from 1; absent before the card or with the cap on the lens.
    pub stop: Option<usize>,
    /// Stops in all.
    pub stops: usize,
    /// Distance of the card when the card is up, metres.
    pub card_distance_m: Option<f64>,
    /// Whether the cap is on the lens.
    pub lens_cap: bool,
}

/// What the simulated operator is to do: exactly one of the three.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(untagged, deny_unknown_fields)]
pub enum StageOrder {
    /// Go to a stop, counted from 1.
    Stop {
        /// The stop.
        stop: usize,
    },
    /// Put the white card up.
    Card {
        /// Distance from the lens along the axis, metres.
        card_distance_m: f64,
    },
    /// Put the cap on the lens.
    LensCap {
        /// Must be true.
        lens_cap: bool,
    },
}
