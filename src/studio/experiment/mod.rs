//! The thesis's tables, run again in the simulated studio.
//!
//! [`Kind::Poc`] is its table 2.2, [`Kind::Precision`] 2.3, [`Kind::Gi`] 2.4, [`Kind::Synthetic`] 12.1 and 12.2;
//! [`Kind::Varnish`] asks what a glossy coat does, which the thesis did not. Each photographs a scene of known
//! reflectance with the path tracer, hands the photographs to the program's own isolation, light and solve, and
//! gives mean and standard deviation of estimate less truth beside the thesis's figures. Same seed, same figures.
//!
//! The scene is the studio's, since the thesis's is not to be had; docs/experiments.md says what else differs.

mod bounced;
mod glossy;
mod photo;
mod quantised;
mod synthetic;
mod table;
mod walk;

pub use table::{Figures, Row, Table};

use super::world::WorldError;
use crate::codec::asset::AssetError;
use crate::codec::dng::DngError;
use crate::photometry::IsolateError;
use crate::pipeline::evaluate::EvaluateError;
use crate::pipeline::flash::FlashError;
use crate::pipeline::process::ProcessError;
use crate::pipeline::scene::SceneError;
use crate::progress::{Cancelled, Progress};
use crate::reflectance::texture::TextureError;
use crate::session::SessionError;
use serde::Serialize;

/// Which experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Table 2.2: does isolating and dividing work at all.
    Poc,
    /// Table 2.3: bits, exposures and the flash's share of the light.
    Precision,
    /// Table 2.4: bounced light.
    Gi,
    /// Tables 12.1 and 12.2: 45 views on three circles, raw files to texture.
    Synthetic,
    /// A varnish on the object.
    Varnish,
}

/// How an experiment is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Fewer views, pixels and rays: seconds instead of minutes, figures to match.
    pub quick: bool,
    /// Of the renders and of the sensor's noise.
    pub seed: u32,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// One line on what was done.
    pub about: String,
    /// The tables.
    pub tables: Vec<Table>,
    /// What a reader should know beside.
    pub notes: Vec<String>,
}

/// Why an experiment stopped.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The studio.
    #[error(transparent)]
    World(#[from] WorldError),
    /// A raw file.
    #[error(transparent)]
    Dng(#[from] DngError),
    /// The simulated frames.
    #[error(transparent)]
    Isolate(#[from] IsolateError),
    /// The solve.
    #[error(transparent)]
    Texture(#[from] TextureError),
    /// The temporary session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Its scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Its flash calibration.
    #[error(transparent)]
    Flash(#[from] FlashError),
    /// Its processing.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// The yardstick.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// An image or mesh.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// The temporary folder.
    #[error(
        "the experiment's temporary folder cannot be used: {0}; set TMPDIR to one with a gigabyte to spare"
    )]
    Folder(#[from] std::io::Error),
    /// An estimate that covers nothing.
    #[error("{0} gave no value to compare: a fault of the program; please report it with the command line")]
    Nothing(&'static str),
}

/// Runs an experiment.
pub fn run(kind: Kind, options: Options, progress: &Progress) -> Result<Outcome, ExperimentError> {
    match kind {
        Kind::Poc => quantised::poc(options, progress),
        Kind::Precision => quantised::precision(options, progress),
        Kind::Gi => bounced::gi(options, progress),
        Kind::Synthetic => synthetic::synthetic(options, progress),
        Kind::Varnish => glossy::varnish(options, progress),
    }
}
