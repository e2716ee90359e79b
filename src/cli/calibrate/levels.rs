//! `unlit calibrate levels`.

use super::{print_json, print_verdict};
use crate::calibration::levels::SiteLevels;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::levels::calibrate;
use std::path::PathBuf;

/// Arguments of `unlit calibrate levels`.
#[derive(clap::Args)]
pub(in crate::cli) struct LevelsArgs {
    /// Session folder.
    session: PathBuf,
    /// Raw files shot with the lens cap on: black, read noise, hot sites.
    #[arg(long, value_name = "FILE", num_args = 1.., required_unless_present = "blown")]
    dark: Vec<PathBuf>,
    /// Raw files of a bright, even surface, over-exposed by three stops or more: saturation.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    blown: Vec<PathBuf>,
    /// The record as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &LevelsArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let record = calibrate(&session, &args.dark, &args.blown, &progress);
    bar.finish_and_clear();
    let record = record.map_err(CliError::new)?;
    if args.json {
        return print_json(&record);
    }
    print_verdict(&record.verdict, &record.shots);
    println!(
        "{:<10}{:<10}{:>22}{:>20}{:>14}{:>14}",
        "ISO", "site", "black", "read noise", "saturation", "clipped from"
    );
    let within = |value: Option<f64>, interval: Option<[f64; 2]>| match (value, interval) {
        (Some(value), Some([low, high])) => format!("{value:.3} \u{b1}{:.3}", (high - low) / 2.0),
        (Some(value), None) => format!("{value:.3}"),
        _ => "-".to_owned(),
    };
    let whole = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.0}"));
    for levels in &record.fit.levels {
        for site in &levels.sites {
            let SiteLevels { colour, row, column, .. } = site;
            println!(
                "{:<10}{:<10}{:>22}{:>20}{:>14}{:>14}",
                levels.iso.0,
                format!("{colour} {row}{column}"),
                within(site.black_dn, site.black_dn_interval_95),
                within(site.read_noise_dn, site.read_noise_dn_interval_95),
                whole(site.saturation_dn),
                whole(site.clipped_from_dn),
            );
        }
        if let Some(hot) = levels.hot_sites {
            println!("{:<10}{hot} hot sites", "");
        }
    }
    println!("All in DN; \u{b1} is half of the 95 % interval.");
    Ok(Exit::Success)
}
