//! `unlit calibrate report`.

use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::report;
use std::path::PathBuf;

/// Arguments of `unlit calibrate report`.
#[derive(clap::Args)]
pub(in crate::cli) struct ReportArgs {
    /// Session folder.
    session: PathBuf,
}

pub(super) fn run(args: &ReportArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let written = report::write(&session, &progress);
    bar.finish_and_clear();
    println!("{}", written.map_err(CliError::new)?.display());
    Ok(Exit::Success)
}
