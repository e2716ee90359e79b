//! `unlit export`: a finished model in other programs' formats.

use super::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::export::{self, ExportOptions, export};
use std::path::PathBuf;

/// Arguments of `unlit export`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder.
    session: PathBuf,
    /// Folder to write into, outside the session; made if it is not there.
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
    /// What to write; several with commas.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["glb", "exr"])]
    format: Vec<Format>,
    /// Colours of what is written: the camera's own, or linear ones by what its files tell of it.
    #[arg(long, value_enum, default_value = "camera")]
    colour: Colour,
}

/// What can be written.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Format {
    /// One file with 8-bit sRGB colour.
    Glb,
    /// Float texture, deviations, view counts.
    Exr,
    /// 16-bit linear texture.
    Tiff,
    /// OBJ, MTL and PNG.
    Obj,
    /// USD text with a float texture.
    Usd,
    /// Reflectance of each photo, named like it, 16-bit linear, with masks.
    Views,
    /// The same in float.
    ViewsExr,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Colour {
    Camera,
    Srgb,
    Acescg,
}

impl From<Format> for export::Format {
    fn from(format: Format) -> Self {
        match format {
            Format::Glb => Self::Glb,
            Format::Exr => Self::Exr,
            Format::Tiff => Self::Tiff,
            Format::Obj => Self::Obj,
            Format::Usd => Self::Usd,
            Format::Views => Self::Views,
            Format::ViewsExr => Self::ViewsExr,
        }
    }
}

impl From<Colour> for export::Colour {
    fn from(colour: Colour) -> Self {
        match colour {
            Colour::Camera => Self::Camera,
            Colour::Srgb => Self::Srgb,
            Colour::Acescg => Self::AcesCg,
        }
    }
}

/// Writes and prints what was written.
pub(super) fn run(args: Args) -> CliResult {
    let session = open_session(&args.session)?;
    let formats = args.format.into_iter().map(Into::into).collect();
    let options = ExportOptions { formats, colour: args.colour.into() };
    let (bar, progress) = progress_bar::watched();
    let exported = export(&session, &args.to, &options, &progress);
    bar.finish_and_clear();
    let exported = exported.map_err(CliError::new)?;
    for file in &exported.files {
        println!("{}", file.display());
    }
    for note in &exported.notes {
        println!("note: {note}");
    }
    Ok(Exit::Success)
}
