//! Bodies of the routes that let in.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How whoever asks stands with the daemon.
#[derive(Serialize, ToSchema)]
pub(super) struct PairingBody {
    /// A token is in force: requests must show that they are let in.
    pub(super) required: bool,
    /// This request would be let in.
    pub(super) paired: bool,
}

/// A code from the daemon's terminal.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PairingOrder {
    /// Eight digits; spaces and hyphens between them do not matter.
    #[schema(example = "12345678", max_length = 32)]
    pub(super) code: String,
}

/// What a ticket is wanted for.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TicketOrder {
    /// The path that is going to be read, with its query if it has one.
    #[schema(example = "/api/v1/events")]
    pub(super) path: String,
}

/// A ticket for one GET.
#[derive(Serialize, ToSchema)]
pub(super) struct TicketBody {
    /// The secret.
    pub(super) ticket: String,
    /// The path with the ticket in it, ready to be asked for.
    #[schema(example = "/api/v1/events?ticket=0123")]
    pub(super) url: String,
    /// Seconds until it is worth nothing.
    pub(super) expires_in_s: u64,
}
