//! `unlit calibrate take`.

use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::take::take;
use std::path::PathBuf;

/// Arguments of `unlit calibrate take`.
#[derive(clap::Args)]
pub(in crate::cli) struct TakeArgs {
    /// Session folder.
    session: PathBuf,
    /// The session that has the calibrations; it is only read.
    #[arg(long, value_name = "SESSION")]
    from: PathBuf,
    /// Which: levels, noise, exposure, flat, flash, steadiness, colour. All that there are, if none is named.
    kinds: Vec<String>,
}

pub(super) fn run(args: &TakeArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let taken = take(&session, &args.from, &args.kinds, &progress);
    bar.finish_and_clear();
    for taken in taken.map_err(CliError::new)? {
        println!("{}, measured {}, with {} shots", taken.kind, taken.measured, taken.shots);
    }
    Ok(Exit::Success)
}
