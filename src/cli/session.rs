//! `unlit session`: looks after a session folder.

use super::{CliError, CliResult, Exit, progress_bar};
use crate::session::{Damage, Session};
use std::path::PathBuf;

#[derive(clap::Subcommand)]
pub(super) enum SessionCommand {
    /// Reads every original, calibration result and scene file again, compares it with its checksum, and names what is
    /// missing or altered; exit code 1 if anything is.
    Verify(Verify),
}

#[derive(clap::Args)]
pub(super) struct Verify {
    /// Session folder; others may read it meanwhile.
    session: PathBuf,
    /// Prints the findings as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(command: SessionCommand) -> CliResult {
    let SessionCommand::Verify(args) = command;
    let session = Session::open_shared(&args.session).map_err(CliError::new)?;
    let (bar, progress) = progress_bar::watched();
    let found = session.verify(&progress);
    bar.finish_and_clear();
    let found = found.map_err(CliError::new)?;
    let exit = if found.is_whole() { Exit::Success } else { Exit::Failure };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found).map_err(CliError::new)?);
        return Ok(exit);
    }
    for finding in &found.findings {
        let damage = match finding.damage {
            Damage::Missing => "missing",
            Damage::Altered => "ALTERED",
            Damage::Unreadable => "UNREADABLE",
            Damage::Unknown => "unknown",
        };
        println!("{damage:<10} {}: {}", finding.path.display(), finding.why);
    }
    println!(
        "{} pairs, {} calibration shots, {} originals of {:.1} MB, {} results and scene files read again: {}",
        found.pairs,
        found.calibration_shots,
        found.originals,
        found.bytes as f64 / 1e6,
        found.kept,
        if found.is_whole() {
            "all as they were stored"
        } else {
            "NOT all as they were stored; restore what is named from a copy"
        }
    );
    Ok(exit)
}
