//! `unlit export-photos`: a session as a folder for photogrammetry.

use super::{CliError, CliResult, Exit, progress_bar};
use crate::pipeline::photos::{self, PhotosOptions};
use crate::session::Session;
use std::path::PathBuf;

/// Arguments of `unlit export-photos`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder; others may read it meanwhile.
    session: PathBuf,
    /// Folder to write into, outside the session, new or empty.
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
    /// The program that is to read it.
    #[arg(long = "for", value_enum, value_name = "PROGRAM")]
    program: Program,
    /// Which light the photos show.
    #[arg(long, value_enum, default_value = "known")]
    light: Light,
    /// File format of the photos: 16-bit TIFF or 8-bit JPEG.
    #[arg(long, value_enum, default_value = "tiff")]
    picture: Picture,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Program {
    Metashape,
    Realityscan,
    Colmap,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Light {
    /// The flash's own: lit frame less unlit frame.
    Known,
    /// Flash and room: the lit frame.
    Lit,
    /// The room's: the unlit frame.
    Ambient,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Picture {
    Tiff,
    Jpeg,
}

/// Writes and prints what was written.
pub(super) fn run(args: Args) -> CliResult {
    let session = Session::open_shared(&args.session).map_err(CliError::new)?;
    let options = PhotosOptions {
        program: match args.program {
            Program::Metashape => photos::Program::Metashape,
            Program::Realityscan => photos::Program::RealityScan,
            Program::Colmap => photos::Program::Colmap,
        },
        light: match args.light {
            Light::Known => photos::Light::Known,
            Light::Lit => photos::Light::Lit,
            Light::Ambient => photos::Light::Ambient,
        },
        picture: match args.picture {
            Picture::Tiff => photos::Picture::Tiff,
            Picture::Jpeg => photos::Picture::Jpeg,
        },
    };
    let (bar, progress) = progress_bar::watched();
    let exported = photos::export(&session, &args.to, options, &progress);
    bar.finish_and_clear();
    let exported = exported.map_err(CliError::new)?;
    for file in exported.photos.iter().chain(&exported.files) {
        println!("{}", file.display());
    }
    for note in &exported.notes {
        println!("note: {note}");
    }
    Ok(Exit::Success)
}
