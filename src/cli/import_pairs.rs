//! `unlit import pairs`: flash-off/flash-on pairs from two folders.

use super::lighting::LightingArgs;
use super::{CliError, CliResult, Exit, open_session};
use crate::pair::Verdict;
use crate::pipeline::pairs::{self, Imported};
use crate::progress::Progress;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct Pairs {
    /// The session, made with `unlit new`.
    session: PathBuf,
    /// Folder of the frames without flash.
    #[arg(long)]
    off: PathBuf,
    /// Folder of the frames with flash, under the same file names.
    #[arg(long)]
    on: PathBuf,
    /// JSON file with limits of the checks; what it does not name keeps its default.
    #[arg(long)]
    limits: Option<PathBuf>,
    #[command(flatten)]
    lighting: LightingArgs,
}

pub(super) fn run(arguments: &Pairs) -> CliResult {
    let limits = pairs::read_limits(arguments.limits.as_deref()).map_err(CliError::new)?;
    let session = open_session(&arguments.session)?;
    arguments.lighting.tell(&session)?;
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}") {
        bar.set_style(style);
    }
    let shown = bar.clone();
    let progress = Progress::new(move |report| {
        shown.set_message(report.stage.clone());
        shown.set_length(report.total);
        shown.set_position(report.done);
    });
    let each = |imported: &Imported| bar.suspend(|| print_pair(imported));
    let summary = pairs::import(&session, &arguments.off, &arguments.on, &limits, &progress, each);
    bar.finish_and_clear();
    let summary = summary.map_err(CliError::new)?;
    for file in summary.unmatched_off.iter().chain(&summary.unmatched_on) {
        println!("{}: no partner of that name in the other folder, left out", file.display());
    }
    let stored = summary.imported.iter().filter(|i| !i.already_there).count();
    let rejected = summary.imported.iter().filter(|i| i.record.verdict == Verdict::Rejected).count();
    println!("{stored} pairs stored, {} there already, {rejected} rejected", summary.imported.len() - stored);
    Ok(if rejected > 0 { Exit::Rejected } else { Exit::Success })
}

fn print_pair(imported: &Imported) {
    let record = &imported.record;
    let verdict = match record.verdict {
        Verdict::Accepted => "accepted",
        Verdict::Rejected => "rejected",
    };
    let known = if imported.already_there { " (there already)" } else { "" };
    let why: Vec<&str> = record.reasons.iter().map(|r| r.sentence.as_str()).collect();
    let colon = if why.is_empty() { "" } else { ": " };
    println!("{:04} {} {verdict}{known}{colon}{}", record.number, record.name, why.join(" "));
}
