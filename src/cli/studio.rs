//! `unlit studio`: the simulated studio's own housekeeping.

use super::{CliError, CliResult, Exit};
use crate::progress::Progress;
use crate::studio::{truth, world};
use clap::Subcommand;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};

/// Commands about the simulated studio.
#[derive(Subcommand)]
pub(super) enum StudioCommand {
    /// Renders the studio's noise-free images again where they do not fit the program (minutes).
    Render {
        /// Folder of the renders.
        #[arg(long, default_value = world::SOURCE_FOLDER)]
        into: PathBuf,
        /// Only this stop; may be given several times.
        #[arg(long = "stop", value_name = "N")]
        stops: Vec<usize>,
    },
    /// Writes the studio's geometry (for `unlit import scene`) and its truth (for `unlit evaluate`).
    Export {
        /// Folder to write to; made if need be.
        folder: PathBuf,
    },
}

/// Runs one of them.
pub(super) fn run(command: StudioCommand) -> CliResult {
    match command {
        StudioCommand::Render { into, stops } => render(&into, &stops),
        StudioCommand::Export { folder } => export(&folder),
    }
}

fn render(into: &Path, stops: &[usize]) -> CliResult {
    let (bar, progress) = shown_progress()?;
    let stops = world::renew(into, stops, &progress).map_err(CliError::new)?;
    bar.finish_and_clear();
    for stop in &stops {
        println!(
            "stop {}: {}, noise {:.2} %, {} kB",
            stop.name,
            if stop.rendered { "rendered" } else { "still fits" },
            100.0 * stop.noise,
            stop.bytes / 1000
        );
    }
    println!("{} stops, {} kB", stops.len(), stops.iter().map(|s| s.bytes).sum::<usize>() / 1000);
    Ok(Exit::Success)
}

fn export(folder: &Path) -> CliResult {
    let (bar, progress) = shown_progress()?;
    let exported = truth::export(folder, &progress).map_err(CliError::new)?;
    bar.finish_and_clear();
    println!(
        "{}: geometry ({} triangles) and truth of {} views, texture of {} texels a side",
        folder.display(),
        exported.triangles,
        exported.views,
        exported.texture_size
    );
    Ok(Exit::Success)
}

/// A bar, and a progress that moves it.
fn shown_progress() -> Result<(ProgressBar, Progress), CliError> {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").map_err(CliError::new)?;
    let bar = ProgressBar::new(0).with_style(style);
    let shown = bar.clone();
    let progress = Progress::new(move |report| {
        shown.set_length(report.total);
        shown.set_position(report.done);
        shown.set_message(report.stage.clone());
    });
    Ok((bar, progress))
}
