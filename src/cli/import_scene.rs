//! `unlit import scene`: cameras and meshes from a reconstruction program.

use super::{CliError, CliResult, Exit, open_session};
use crate::pipeline::scene::{self, Lengths, Unit};
use crate::progress::Progress;
use std::path::PathBuf;

/// Arguments of `unlit import scene`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder.
    session: PathBuf,
    /// BlocksExchange XML file, or folder with COLMAP's cameras.txt and images.txt.
    #[arg(long, value_name = "FILE|DIR")]
    cameras: PathBuf,
    /// OBJ file; the object first, then what else catches light (a floor, a stage).
    #[arg(long = "mesh", value_name = "FILE", required = true)]
    meshes: Vec<PathBuf>,
    /// Unit of length in these files.
    #[arg(long, value_enum, default_value = "m")]
    unit: LengthUnit,
    /// Multiplies all lengths, after the unit.
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum LengthUnit {
    M,
    Cm,
    Mm,
}

/// Imports and prints what was found.
pub(super) fn run(args: Args) -> CliResult {
    let unit = match args.unit {
        LengthUnit::M => Unit::Metre,
        LengthUnit::Cm => Unit::Centimetre,
        LengthUnit::Mm => Unit::Millimetre,
    };
    let lengths = Lengths { unit, scale: args.scale };
    let session = open_session(&args.session)?;
    let file = scene::import(&session, &args.cameras, &args.meshes, lengths, &Progress::silent())
        .map_err(CliError::new)?;
    println!("{} cameras", file.cameras.len());
    if !file.without_pose.is_empty() {
        println!(
            "{} photos without a pose left out: {}",
            file.without_pose.len(),
            file.without_pose.join(", ")
        );
    }
    for mesh in &file.meshes {
        let uv = if mesh.textured { "with" } else { "without" };
        println!("{}: {} vertices, {} triangles, {uv} UVs", mesh.name, mesh.vertices, mesh.triangles);
    }
    let check = &file.check;
    let least = check.views.iter().map(|v| v.in_frame).fold(1.0, f64::min);
    println!(
        "the object measures {:.3} m across, {:.3} m from the cameras; at least {:.0} % of it in every frame",
        check.object_size,
        check.distance,
        100.0 * least
    );
    for warning in &check.warnings {
        eprintln!("warning: {warning}");
    }
    Ok(Exit::Success)
}
