//! `unlit studio`: the simulated studio's own housekeeping.

use super::{CliError, CliResult, Exit};
use crate::progress::Progress;
use crate::studio::world;
use clap::Subcommand;
use std::path::PathBuf;

/// Commands about the simulated studio.
#[derive(Subcommand)]
pub(super) enum StudioCommand {
    /// Renders the studio's noise-free images again where they do not fit the program (minutes).
    Render {
        /// Folder of the renders.
        #[arg(long, default_value = world::SOURCE_FOLDER)]
        into: PathBuf,
    },
}

/// Runs one of them.
pub(super) fn run(command: StudioCommand) -> CliResult {
    match command {
        StudioCommand::Render { into } => render(into),
    }
}

fn render(into: PathBuf) -> CliResult {
    let bar = indicatif::ProgressBar::new(0).with_style(style()?);
    let shown = bar.clone();
    let progress = Progress::new(move |report| {
        shown.set_length(report.total);
        shown.set_position(report.done);
        shown.set_message(report.stage.clone());
    });
    let stops = world::renew(&into, &progress).map_err(CliError::new)?;
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

fn style() -> Result<indicatif::ProgressStyle, CliError> {
    indicatif::ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").map_err(CliError::new)
}
