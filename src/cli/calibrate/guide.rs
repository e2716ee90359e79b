//! `unlit calibrate guide`.

use crate::calibration::guide::Kind;
use crate::cli::{CliResult, Exit};

/// Arguments of `unlit calibrate guide`.
#[derive(clap::Args)]
pub(in crate::cli) struct GuideArgs {
    /// Which calibration: levels, noise, exposure, flat, flash, repeatability or colour; without it all of them, in the order in which
    /// they are best made.
    kind: Option<Kind>,
}

pub(super) fn run(args: &GuideArgs) -> CliResult {
    let texts: Vec<String> = match args.kind {
        Some(kind) => vec![kind.guide().text()],
        None => Kind::ALL.iter().map(|kind| kind.guide().text()).collect(),
    };
    print!("{}", texts.join("\n\n"));
    Ok(Exit::Success)
}
