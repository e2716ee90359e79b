//! `unlit calibrate noise`.

use super::{print_json, print_verdict};
use crate::calibration::noise::{IsoNoise, Linearity};
use crate::calibration::statistics::Z95;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::noise::{NoiseFrames, calibrate};
use std::path::PathBuf;

/// Arguments of `unlit calibrate noise`.
#[derive(clap::Args)]
pub(in crate::cli) struct NoiseArgs {
    /// Session folder.
    session: PathBuf,
    /// Raw files of the evenly lit surface, two at every light level.
    #[arg(required = true, value_name = "FILE")]
    frames: Vec<PathBuf>,
    /// Raw files of the same ISO with the lens cap on, two or more: read noise and black.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    dark: Vec<PathBuf>,
    /// Stops of light between one level and the next brighter one, where the light was changed at one shutter time;
    /// without it only a series of shutter times tells linearity.
    #[arg(long, value_name = "STOPS")]
    stops: Option<f64>,
    /// The record as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &NoiseArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let frames = NoiseFrames { lit: &args.frames, dark: &args.dark, stops: args.stops };
    let record = calibrate(&session, frames, &progress);
    bar.finish_and_clear();
    let record = record.map_err(CliError::new)?;
    if args.json {
        return print_json(&record);
    }
    print_verdict(&record.verdict, &record.shots);
    record.fit.noise.iter().for_each(print);
    Ok(Exit::Success)
}

fn print(noise: &IsoNoise) {
    let interval =
        |[low, high]: [f64; 2], digits: usize| format!("(95 %: {low:.digits$} to {high:.digits$})");
    println!("{}: {} pairs of frames, {} of dark ones", noise.iso, noise.pairs, noise.dark_pairs);
    println!(
        "  electrons per DN  {:.4} {}",
        noise.electrons_per_dn,
        interval(noise.electrons_per_dn_interval_95, 4)
    );
    if let (Some(value), Some(range)) = (noise.read_noise_e, noise.read_noise_e_interval_95) {
        println!("  read noise        {value:.2} e {}", interval(range, 2));
    }
    if let (Some(value), Some(range)) = (noise.fixed_pattern, noise.fixed_pattern_interval_95) {
        println!("  fixed pattern     {:.3} % {}", 100.0 * value, interval(range.map(|v| 100.0 * v), 3));
    }
    println!("  {:<8}{:>18}{:>16}", "", "electrons per DN", "full well, e");
    for colour in &noise.colours {
        let gain = colour.electrons_per_dn.map_or("-".into(), |v| format!("{v:.4}"));
        let well = colour.full_well_e.map_or("-".into(), |v| format!("{v:.0}"));
        println!("  {:<8}{gain:>18}{well:>16}", colour.colour);
    }
    if let Some(linearity) = &noise.linearity {
        print_linearity(linearity);
    }
}

/// A row a light, each colour's deviation from its line beside the others'.
fn print_linearity(linearity: &Linearity) {
    let mut lights: Vec<f64> = linearity.steps.iter().map(|step| step.light).collect();
    lights.sort_by(f64::total_cmp);
    lights.dedup();
    println!("  {:>12}{:>22}{:>22}{:>22}", "light", "red", "green", "blue");
    for light in lights {
        let of = |colour: &str| {
            let step = linearity.steps.iter().find(|step| step.light == light && step.colour == colour);
            step.map_or("-".to_owned(), |step| {
                let (off, error) = (100.0 * step.deviation, 100.0 * Z95 * step.deviation_standard_error);
                format!("{off:+.3} % \u{b1}{error:.3} %")
            })
        };
        println!("  {light:>12.3}{:>22}{:>22}{:>22}", of("red"), of("green"), of("blue"));
    }
    println!("  deviations from the line through black, with 95 %");
}
