//! `unlit calibrate exposure`: what the steps of ISO, shutter and aperture truly do.

use super::{print_json, print_verdict};
use crate::calibration::exposure::{ExposureFit, Setting, Summary, THESIS};
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::exposure::calibrate;
use std::path::PathBuf;

/// Arguments of `unlit calibrate exposure`.
///
/// Put up a plain grey or white card, light it steadily (daylight lamps, no flicker) and evenly, lock focus, and put the
/// camera on a tripod. Choose the brightest exposure so that nothing of the card is over-exposed. Then turn one dial
/// from dark to bright in thirds of a stop, a shot a step, the other two settings staying; change the light if you like,
/// and do the same with the next dial. Six stops of each are enough.
#[derive(clap::Args)]
pub(in crate::cli) struct ExposureArgs {
    /// Session folder.
    session: PathBuf,
    /// Raw files in the order in which they were taken; up to three ladders at once. Which setting moves is read from
    /// the files.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The record as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ExposureArgs) -> CliResult {
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

fn human(fit: &ExposureFit) -> String {
    let mut text = String::new();
    for ladder in &fit.ladders {
        text += &format!(
            "{:<10}{:>5}{:>10}{:>10}{:>12}{:>12}\n",
            ladder.setting.name(),
            "k",
            "2^(k/3)",
            "factor",
            "deviation",
            "\u{b1} (95 %)"
        );
        for step in &ladder.steps {
            let half = (step.deviation_interval_95[1] - step.deviation_interval_95[0]) / 2.0;
            text += &format!(
                "{:<10}{:>5}{:>10.4}{:>10.4}{:>+10.3} %{:>10.3} %\n",
                ladder.setting.words(step.label),
                step.step_thirds,
                step.factor / (1.0 + step.deviation),
                step.factor,
                100.0 * step.deviation,
                100.0 * half
            );
        }
        text += "\n";
    }
    text += &format!("{:<24}{:>9}{:>9}{:>9}{:>9}\n", "deviations (table 3.2)", "mean", "max", "min", "SD");
    let row = |name: String, s: &Summary| {
        format!("{name:<24}{:>9.4}{:>9.4}{:>9.4}{:>9.4}\n", s.mean, s.max, s.min, s.sd)
    };
    for (setting, thesis) in Setting::ALL.into_iter().zip(&THESIS) {
        for ladder in fit.ladders.iter().filter(|l| l.setting == setting) {
            text += &row(format!("{}, from step 00", setting.name()), &ladder.summary);
            text += &row("  step from step".into(), &ladder.between_steps);
            text += &row(format!("  {} in the thesis", setting.name()), thesis);
        }
    }
    text += "mean with its sign, max and min of the magnitudes; step 00 itself is not counted\n";
    text
}
