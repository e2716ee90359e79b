//! `unlit process`: a session's pairs to reflectance.

use super::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::memory::MEMORY;
use crate::pipeline::process::{ProcessOptions, process};
use crate::reflectance::unwrap::{UvChoice, UvSource};
use std::path::PathBuf;

/// Arguments of `unlit process`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder.
    session: PathBuf,
    /// Side of the square texture in texels; by default about one texel a photo pixel.
    #[arg(long, value_name = "N")]
    texture_size: Option<usize>,
    /// The object's texture coordinates: its own where they can be used, else new ones; its own or none; new ones.
    #[arg(long, value_enum, default_value = "auto")]
    uvs: Uvs,
    /// Threads to compute on; all cores by default. Results are the same for any number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Memory that solving the texture may take, GB; what needs more is solved in pieces, the larger the faster, and a
    /// run that was stopped goes on at the first piece that is missing.
    #[arg(long, value_name = "GB", default_value_t = MEMORY, value_parser = gigabytes)]
    memory: f64,
    /// Also per-view images: derived/views/NAME/{known,irradiance,reflectance}.exr.
    #[arg(long)]
    views: bool,
}

/// Where texture coordinates come from.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Uvs {
    Auto,
    Own,
    New,
}

impl From<Uvs> for UvChoice {
    fn from(uvs: Uvs) -> Self {
        match uvs {
            Uvs::Auto => Self::Auto,
            Uvs::Own => Self::Own,
            Uvs::New => Self::New,
        }
    }
}

fn gigabytes(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number of gigabytes, as 6 or 0.5".to_owned())?;
    if (0.001..=1e6).contains(&value) { Ok(value) } else { Err("expected 0.001 to 1000000 gigabytes".into()) }
}

pub(super) fn run(args: &Args) -> CliResult {
    let session = open_session(&args.session)?;
    let options = ProcessOptions {
        texture_size: args.texture_size,
        views: args.views,
        uvs: args.uvs.into(),
        memory: Some(args.memory),
        piece: None,
    };
    let (bar, progress) = progress_bar::watched();
    let threads = usize::from(args.threads.unwrap_or(0));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(CliError::new)?;
    let summary = pool.install(|| process(&session, &options, &progress));
    bar.finish_and_clear();
    let summary = summary.map_err(CliError::new)?;
    for left in &summary.left_out {
        println!("left out {}: {}", left.name, left.why);
    }
    summary.remarks.iter().for_each(|remark| println!("{remark}"));
    for mesh in &summary.turned {
        println!("{mesh} was seen from behind; its triangles were turned to face the cameras");
    }
    if let UvSource::Made(made) = &summary.uvs {
        println!(
            "texture coordinates were made, because {}: {} charts over {:.0} % of the texture, lengths shortened {:.2} times at most",
            made.why,
            made.charts,
            100.0 * made.coverage,
            made.stretch[0]
        );
    }
    println!(
        "{} views, texture {n} x {n}, {:.1} % of the surface seen, median standard deviation {:.4}",
        summary.used.len(),
        100.0 * summary.seen,
        summary.median_deviation,
        n = summary.texture_size
    );
    if summary.pieces > 1 {
        println!(
            "the texture was solved in {} pieces to stay within {} GB (--memory)",
            summary.pieces, args.memory
        );
    }
    let [r, g, b] = summary.blur;
    println!("the lens blurs by {r:.2}, {g:.2}, {b:.2} pixels (standard deviation; red, green, blue)");
    for (mesh, lobe) in summary.gloss.iter().enumerate() {
        if let Some(lobe) = lobe {
            println!(
                "mesh {} is glossy: {:.1} % of the light, GGX width {:.2}; taken off",
                mesh + 1,
                100.0 * lobe.weight,
                lobe.alpha
            );
        }
    }
    for cost in summary.costs.iter().filter(|_| !summary.up_to_date) {
        println!("{:<32} {:>7.1} s {:>7.1} CPU-s", cost.stage, cost.wall, cost.cpu);
    }
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
    for warning in summary.out_of_range.warnings() {
        println!("note: {warning}");
    }
    if summary.up_to_date {
        println!("nothing had changed since the last run");
    }
    println!("model: {}", session.model_dir().join("model.glb").display());
    Ok(Exit::Success)
}
