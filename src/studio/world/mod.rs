//! The world before the simulated lens.

mod bowl;
mod cache;
mod glaze;
mod patch;
mod path;
mod render;
mod sampler;
mod stage;

pub use cache::{SOURCE_FOLDER, StoredStop, renew};

use crate::codec::exr_half::PlanesError;
use crate::progress::Cancelled;
use std::path::PathBuf;

/// Why the world could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A stored render is broken.
    #[error("a stored render of the studio cannot be used: {0}; `unlit studio render` renews it")]
    Picture(#[from] PlanesError),
    /// A stored render lacks a channel.
    #[error(
        "the stored render of stop {stop} lacks channel {channel} in the studio's size; `unlit studio render` renews it"
    )]
    Stored {
        /// Name of the stop.
        stop: String,
        /// The channel.
        channel: &'static str,
    },
    /// The folder for renders cannot be used.
    #[error("cannot keep renders in {}: {source}; choose a folder that you may write to", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
