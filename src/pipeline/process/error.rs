//! Why processing stops.

use super::LARGEST_TEXTURE;
use crate::codec::asset::AssetError;
use crate::codec::png::PngError;
use crate::export::glb::GlbError;
use crate::pipeline::certify::CertificateError;
use crate::pipeline::colour::ColoursError;
use crate::pipeline::develop::DevelopError;
use crate::pipeline::energy::EnergyError;
use crate::pipeline::flash::FlashError;
use crate::pipeline::scene::SceneError;
use crate::pipeline::uvs::UvsError;
use crate::progress::Cancelled;
use crate::reflectance::texture::TextureError;
use crate::reflectance::unwrap::UnwrapError;
use crate::session::SessionError;
use std::path::{Path, PathBuf};

/// Why processing stopped.
#[derive(Debug, thiserror::Error)]
pub enum ProcessError {
    /// No pair can be used.
    #[error("no pair can be processed: {0}")]
    NoPairs(String),
    /// A texture size that cannot be.
    #[error("texture size {0} is not possible: give a number of texels from 16 to {LARGEST_TEXTURE}")]
    TextureSize(usize),
    /// More memory than the run may take.
    #[error(
        "a texture of {size} x {size} texels from these photos and this mesh needs {needs:.2} GB or more, but the run may take {may:.2}: give it more with --memory, or a smaller --texture-size or mesh"
    )]
    Memory {
        /// Side asked for.
        size: usize,
        /// GB.
        needs: f64,
        /// GB.
        may: f64,
    },
    /// More memory than there is.
    #[error(
        "the run takes up to {needs:.1} GB, but {free:.1} GB are free: close other programs, or give a smaller --memory or --texture-size"
    )]
    NotFree {
        /// GB.
        needs: f64,
        /// GB.
        free: f64,
    },
    /// Session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Calibration.
    #[error(transparent)]
    Flash(#[from] FlashError),
    /// The flash's energies.
    #[error(transparent)]
    Energy(#[from] EnergyError),
    /// A pair.
    #[error(transparent)]
    Develop(#[from] DevelopError),
    /// Solving.
    #[error(transparent)]
    Texture(TextureError),
    /// Texture coordinates.
    #[error(transparent)]
    Unwrap(UnwrapError),
    /// Writing an image.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// Writing the model.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// A preview in the report.
    #[error(transparent)]
    Preview(#[from] PngError),
    /// The camera's colours.
    #[error(transparent)]
    Colours(#[from] ColoursError),
    /// The model's certificate.
    #[error(transparent)]
    Certificate(#[from] CertificateError),
    /// Made texture coordinates.
    #[error(transparent)]
    Uvs(#[from] UvsError),
    /// A derived file does not fit the scene.
    #[error("{} was made from another scene: delete it and process again", .0.display())]
    Stale(PathBuf),
    /// The file system refused.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<TextureError> for ProcessError {
    fn from(error: TextureError) -> Self {
        match error {
            TextureError::Cancelled(c) => Self::Cancelled(c),
            other => Self::Texture(other),
        }
    }
}

impl From<UnwrapError> for ProcessError {
    fn from(error: UnwrapError) -> Self {
        match error {
            UnwrapError::Cancelled(c) => Self::Cancelled(c),
            other => Self::Unwrap(other),
        }
    }
}

pub(in crate::pipeline) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> ProcessError + '_ {
    move |source| ProcessError::Io { path: path.to_owned(), source }
}
