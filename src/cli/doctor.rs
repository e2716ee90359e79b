//! `unlit doctor`: what keeps camera and flash from working on this machine, and what to do.

use super::{CliError, CliResult, Exit};
use crate::rig::doctor::{self, Level};

/// Arguments.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Prints the findings as JSON.
    #[arg(long)]
    json: bool,
}

/// Prints the findings.
pub(super) fn run(args: &Args) -> CliResult {
    let findings = doctor::examine();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&findings).map_err(CliError::new)?);
    } else {
        for finding in &findings {
            let mark = match finding.level {
                Level::Ok => "ok     ",
                Level::Warning => "warning",
                Level::Problem => "PROBLEM",
            };
            println!("{mark}  {}", finding.sentence);
            if !finding.advice.is_empty() {
                println!("         {}", finding.advice);
            }
        }
    }
    let problems = findings.iter().filter(|f| f.level == Level::Problem).count();
    if problems == 0 {
        return Ok(Exit::Success);
    }
    eprintln!("unlit: {problems} of {} findings keep the rig from working", findings.len());
    Ok(Exit::Failure)
}
