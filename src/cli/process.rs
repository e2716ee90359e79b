//! `unlit process`: a session's pairs to reflectance.

use super::{CliError, CliResult, Exit, progress_bar};
use crate::pipeline::process::{ProcessOptions, process};
use crate::session::Session;
use std::path::PathBuf;

/// Arguments of `unlit process`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder.
    session: PathBuf,
    /// Side of the square texture in texels; by default about one texel a photo pixel.
    #[arg(long, value_name = "N")]
    texture_size: Option<usize>,
    /// Also per-view images: derived/views/NAME/{known,irradiance,reflectance}.exr.
    #[arg(long)]
    views: bool,
}

pub(super) fn run(args: &Args) -> CliResult {
    let session = Session::open(&args.session).map_err(CliError::new)?;
    let options = ProcessOptions { texture_size: args.texture_size, views: args.views };
    let (bar, progress) = progress_bar::watched();
    let summary = process(&session, &options, &progress);
    bar.finish_and_clear();
    let summary = summary.map_err(CliError::new)?;
    for left in &summary.left_out {
        println!("left out {}: {}", left.name, left.why);
    }
    for mesh in &summary.turned {
        println!("{mesh} was seen from behind; its triangles were turned to face the cameras");
    }
    println!(
        "{} views, texture {n} x {n}, {:.1} % of the surface seen, median standard deviation {:.4}",
        summary.used.len(),
        100.0 * summary.seen,
        summary.median_deviation,
        n = summary.texture_size
    );
    for (i, round) in summary.rounds.iter().enumerate() {
        println!("bounces, round {}: reflectance moved by {:.5} on average", i + 1, round.mean_change);
    }
    if args.views {
        let (made, stood) = summary.views;
        println!(
            "per-view images: {made} made, {stood} up to date, in {}/views",
            session.derived_dir().display()
        );
    }
    if summary.up_to_date {
        println!("nothing had changed since the last run");
    }
    println!("model: {}", session.model_dir().join("model.glb").display());
    Ok(Exit::Success)
}
