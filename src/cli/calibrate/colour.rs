//! `unlit calibrate colour`: camera RGB to sRGB and ACEScg from a frame of a colour chart.

use crate::calibration::Record;
use crate::calibration::colour::ChartKind;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::calibrate::colour::{ChartShot, SessionColour, calibrate};
use std::path::PathBuf;

/// Arguments of `unlit calibrate colour`.
#[derive(clap::Args)]
pub(in crate::cli) struct ColourArgs {
    /// Session folder.
    session: PathBuf,
    /// Raw file of the chart, lit as the object will be: by the flash in a dark room, or with --off. The chart lies
    /// flat and whole in the frame, at any angle, in focus, free of reflections; expose so that its white does not
    /// clip.
    file: PathBuf,
    /// The same without flash, where the room was not dark: the flash's light alone is then measured.
    #[arg(long, value_name = "FILE")]
    off: Option<PathBuf>,
    /// Which chart it is: colorchecker24, colorchecker24-before-2014 or spydercheckr24; without it whichever fits
    /// best.
    #[arg(long, value_name = "CHART")]
    chart: Option<ChartKind>,
    /// Outer corners of the four corner patches, in any order, in pixels from the frame's top left corner, where the
    /// chart is not found without help.
    #[arg(long, value_name = "X,Y", num_args = 4, value_parser = corner)]
    corners: Option<Vec<[f64; 2]>>,
    /// The whole result as JSON, the same as calibration/colour.json.
    #[arg(long)]
    json: bool,
}

fn corner(text: &str) -> Result<[f64; 2], String> {
    let parts: Option<Vec<f64>> = text.split(',').map(|p| p.trim().parse().ok()).collect();
    <[f64; 2]>::try_from(parts.unwrap_or_default())
        .ok()
        .filter(|p| p.iter().all(|v| v.is_finite()))
        .ok_or_else(|| format!("{text:?} is not X,Y in pixels, for example 812,1034"))
}

pub(super) fn run(args: &ColourArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let shot = ChartShot {
        on: args.file.clone(),
        off: args.off.clone(),
        chart: args.chart,
        corners: args.corners.as_deref().and_then(|corners| corners.try_into().ok()),
    };
    let (bar, progress) = progress_bar::watched();
    let record = calibrate(&session, &shot, &progress);
    bar.finish_and_clear();
    let record = record.map_err(CliError::new)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&record).map_err(CliError::new)?);
    } else {
        print!("{}", words(&record));
    }
    Ok(Exit::Success)
}

fn words(record: &Record<SessionColour>) -> String {
    let fit = &record.fit.fit;
    let mut text = record.verdict.sentences.join("\n") + "\n\n";
    text += &format!("chart: {}, values of {}\n\n", fit.chart.name(), fit.chart_source);
    text += &format!("{:<22}{:>10}{:>16}   {}\n", "patch", "CIEDE2000", "without it", "");
    for patch in &fit.patches {
        let out = patch.leave_one_out_delta_e_2000.map_or("-".into(), |v| format!("{v:.2}"));
        let why = patch.left_out.as_deref().unwrap_or_default();
        text += &format!("{:<22}{:>10.2}{out:>16}   {why}\n", patch.name, patch.delta_e_2000);
    }
    text += &format!("\n{:<34}{:>8}{:>8}{:>8}\n", "CIEDE2000", "mean", "90 %", "max");
    for (name, d) in [
        ("patches that were fitted", Some(&fit.fit)),
        ("each patch by the others", Some(&fit.leave_one_out)),
        ("each half by the other", fit.half_held_out.as_ref()),
    ] {
        let Some(d) = d else { continue };
        text += &format!("{name:<34}{:>8.2}{:>8.2}{:>8.2}\n", d.mean, d.percentile_90, d.max);
    }
    text += "\nlinear sRGB from camera RGB, white being 1 in both:\n";
    for [r, g, b] in record.fit.linear_srgb_from_camera {
        text += &format!("{r:>10.4}{g:>10.4}{b:>10.4}\n");
    }
    let [r, g, b] = fit.white_dn;
    text += &format!("a perfect white reads {r:.0} {g:.0} {b:.0} DN in the chart's light\n");
    text
}
