//! `unlit evaluate`: a session's reflectance against a known truth.

use super::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::evaluate::{Errors, Estimate, Evaluation, evaluate};
use crate::pipeline::{process, views};
use crate::progress::Progress;
use crate::session::Session;
use std::path::{Path, PathBuf};

/// Arguments of `unlit evaluate`.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder.
    session: PathBuf,
    /// Folder with albedo/NAME.tif, mask/NAME.tif and scene.json.
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Scores and prints.
pub(super) fn run(args: Args) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let evaluation = score(&session, &args.truth, &progress);
    bar.finish_and_clear();
    let evaluation = evaluation?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&evaluation).map_err(CliError::new)?);
        return Ok(Exit::Success);
    }
    let absent = |what: &str| println!("{what}: the session has none");
    match &evaluation.views {
        Some(estimate) => print("per-view images", estimate),
        None => absent("per-view images"),
    }
    match &evaluation.texture {
        Some(estimate) => print("texture as the cameras see it", estimate),
        None => absent("texture"),
    }
    Ok(Exit::Success)
}

/// Makes the per-view images where the session was processed without them, then scores.
fn score(session: &Session, truth: &Path, progress: &Progress) -> Result<Evaluation, CliError> {
    if process::stored(session).is_some() {
        views::ensure(session, progress).map_err(CliError::new)?;
    }
    evaluate(session, truth, progress).map_err(CliError::new)
}

fn print(title: &str, estimate: &Estimate) {
    println!(
        "{title}: {} views, {:.2} % of the object known",
        estimate.by_view.len(),
        100.0 * estimate.known
    );
    if !estimate.missing.is_empty() {
        println!("  views of the truth that are missing: {}", estimate.missing.join(", "));
    }
    println!("  {:<16}{:>20}{:>20}{:>20}{:>20}", "estimate - truth", "mean", "SD", "mean |e|", "95 % of |e|");
    line("full resolution", &estimate.full);
    match &estimate.blocks {
        Some(blocks) => line("4x4 blocks", blocks),
        None => println!("  4x4 blocks: none lies wholly inside the object"),
    }
    if let Some(covered) = estimate.covered {
        println!(
            "  {:.1} % of the 4x4 blocks lie within 1.96 standard deviations as told (95 % if they are told true)",
            100.0 * covered
        );
    }
    if estimate.bright_spots > 0 {
        println!("  {} values above 1.05 where the truth is below 0.9", estimate.bright_spots);
    }
}

/// Each figure of 1 and of 255.
fn line(title: &str, errors: &Errors) {
    let both = |e: f64| format!("{e:.4} ({:.2}/255)", 255.0 * e);
    println!(
        "  {title:<16}{:>20}{:>20}{:>20}{:>20}",
        both(errors.mean),
        both(errors.standard_deviation),
        both(errors.mean_absolute),
        both(errors.percentile_95)
    );
}
