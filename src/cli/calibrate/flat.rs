//! `unlit calibrate flat`: vignetting and flat field.

use super::{print_json, print_verdict};
use crate::calibration::flat::FlatCalibration;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::flat::calibrate;
use std::path::PathBuf;

/// Arguments of `unlit calibrate flat`.
///
/// Photograph something evenly lit that fills the frame, out of focus: an overcast sky, a white wall far from its lamps,
/// a light table, or a diffuser before the lens. Aperture and focal length as for the photographs; the middle of the
/// frame at about half of saturation. Five frames or more, the camera turned by 90 and 180 degrees between them, so
/// that what is uneven in the light averages out.
#[derive(clap::Args)]
pub(in crate::cli) struct FlatArgs {
    /// Session folder.
    session: PathBuf,
    /// Raw files of one lens, focal length and aperture; any shutter and ISO.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The record as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &FlatArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let record = calibrate(&session, &args.files, &progress);
    bar.finish_and_clear();
    let record = record.map_err(CliError::new)?;
    if args.json {
        return print_json(&record);
    }
    print_verdict(&record.verdict, &record.shots);
    print!("{}", human(&record.fit));
    Ok(Exit::Success)
}

fn human(fit: &FlatCalibration) -> String {
    let mut text = String::new();
    let half = |[low, high]: [f64; 2]| (high - low) / 2.0;
    text += &format!("{:<8}{:>10}{:>10}{:>10}{:>12}{:>10}\n", "", "a1", "a2", "a3", "corner", "95 %");
    for (colour, name) in ["red", "green", "blue"].into_iter().enumerate() {
        let [a, b, c] = fit.vignetting.coefficients[colour];
        text += &format!(
            "{name:<8}{a:>+10.4}{b:>+10.4}{c:>+10.4}{:>12.5}  \u{b1}{:.5}\n",
            fit.corner[colour],
            half(fit.corner_interval_95[colour])
        );
    }
    text += "vignetting: 1 + a1 q + a2 q^2 + a3 q^3, q = (r / half diagonal)^2\n";
    let [across, down] = fit.light_gradient;
    text += &format!(
        "slope of the light from the centre to the edge: {:+.3} % across, {:+.3} % down (\u{b1}{:.3} %)\n",
        100.0 * across,
        100.0 * down,
        100.0 * fit.light_gradient_interval_95.into_iter().map(half).fold(0.0, f64::max)
    );
    text += &format!(
        "residual {:.3} % over the tiles, chi^2 per degree of freedom {:.2}\n",
        100.0 * fit.residual_rms,
        fit.chi_squared
    );
    text
}
