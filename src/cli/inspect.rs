//! `unlit inspect`: the true sensor values of a raw file.

use super::{CliError, CliResult, Exit};
use crate::codec::raw::Photo;
use crate::pair::Settings;
use crate::photometry::LevelSource;
use crate::photometry::inspect::{self, ChannelFigures, Inspection, Region};
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::levels;
use crate::session::Session;
use clap::Args;
use serde::Serialize;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::str::FromStr;

#[derive(Args)]
pub(super) struct Inspect {
    /// Raw file of a sensor with a 2x2 Bayer array: CR2, NEF, ARW, DNG, and by the second decoder CR3, RAF, ORF,
    /// RW2.
    file: PathBuf,
    /// Region to measure, X,Y,W,H in pixels of the active area from its top left corner; all of it if absent.
    #[arg(long, value_name = "X,Y,W,H")]
    roi: Option<Roi>,
    /// Session whose own levels are used, as measured by `unlit calibrate levels`.
    #[arg(long)]
    session: Option<PathBuf>,
    /// Everything as JSON.
    #[arg(long)]
    json: bool,
}

/// A region as the command line gives it.
#[derive(Clone, Copy)]
struct Roi(Region);

impl FromStr for Roi {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[x, y, width, height]) => Ok(Roi(Region { x, y, width, height })),
            _ => Err("expected four whole numbers X,Y,W,H, such as 100,200,640,480".to_owned()),
        }
    }
}

#[derive(Serialize)]
struct Output<'a> {
    file: &'a Path,
    #[serde(flatten)]
    inspection: &'a Inspection,
    cfa: [[u8; 2]; 2],
    masked_standard_deviation: Option<[[f32; 2]; 2]>,
    /// Why the session's own levels do not count; absent if they do, or if none were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    levels_not_used: Option<String>,
    settings: &'a Settings,
}

pub(super) fn run(arguments: &Inspect) -> CliResult {
    let measured = match &arguments.session {
        Some(path) => {
            let session = Session::open_shared(path).map_err(CliError::new)?;
            levels::load(&session).map_err(CliError::new)?
        }
        None => MeasuredLevels::default(),
    };
    let photo = levels::read(&arguments.file, &measured).map_err(CliError::new)?;
    let inspection =
        inspect::inspect(&photo.mosaic, arguments.roi.map(|roi| roi.0)).map_err(CliError::new)?;
    let not_used = levels::remark(&measured, &photo.settings);
    if arguments.json {
        let output = Output {
            file: &arguments.file,
            inspection: &inspection,
            cfa: photo.mosaic.cfa.0,
            masked_standard_deviation: photo.masked.map(|m| m.standard_deviation),
            levels_not_used: not_used,
            settings: &photo.settings,
        };
        println!("{}", serde_json::to_string_pretty(&output).map_err(CliError::new)?);
    } else {
        print!("{}", human(&arguments.file, &photo, &inspection, not_used.as_deref()));
    }
    Ok(Exit::Success)
}

fn human(file: &Path, photo: &Photo, found: &Inspection, not_used: Option<&str>) -> String {
    let levels = &found.levels;
    let region = found.region;
    let mut text = format!("{}\n{}\n\n", file.display(), settings_line(&photo.settings));
    text += &format!("active area   {} x {} pixels, {}\n", found.width, found.height, filters(photo));
    text += &format!("black         {} DN, from {}\n", four(levels.black), source(levels.black_source));
    text +=
        &format!("saturation    {} DN, from {}\n", four(levels.saturation), source(levels.saturation_source));
    if let Some(why) = not_used {
        text += &format!("              {why}\n");
    }
    if let Some(masked) = &photo.masked {
        text += &format!("read noise    {} DN, in the masked border\n", four(masked.standard_deviation));
    }
    text += &format!(
        "region        {} x {} pixels at {},{}\n\n",
        region.width, region.height, region.x, region.y
    );
    text += "               region max   region mean    frame max   clipped: region      frame\n";
    for channel in &found.channels {
        text += &row(
            channel.colour,
            channel.region_maximum,
            channel.region_mean,
            channel.frame_maximum,
            Some((channel.region_clipped_share, channel.frame_clipped_share)),
        );
    }
    text += &row("all", Some(found.region_maximum), Some(found.region_mean), found.frame_maximum, None);
    for channel in &found.channels {
        text += &histogram(channel);
    }
    text
}

fn row(
    name: &str,
    region_maximum: Option<u16>,
    region_mean: Option<f64>,
    frame_maximum: u16,
    clipped: Option<(f64, f64)>,
) -> String {
    let maximum = region_maximum.map_or("-".to_owned(), |v| v.to_string());
    let mean = region_mean.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let clipped = clipped.map_or(String::new(), |(region, frame)| {
        format!("{:>16.3} % {:>8.3} %", 100.0 * region, 100.0 * frame)
    });
    format!("{name:<12} {maximum:>12} {mean:>13} {frame_maximum:>12}{clipped}\n")
}

/// Rows of the text histogram.
const ROWS: usize = 6;

/// One column a bin; heights by the square root of the count, so that a few bright sites still show.
fn histogram(channel: &ChannelFigures) -> String {
    let most = channel.histogram.iter().copied().max().unwrap_or(0).max(1) as f64;
    let mut text = format!(
        "\n{} histogram of the region: {} bins of {:.1} DN from {:.1} to {:.1} DN, highest {most:.0} pixels (heights by square root)\n",
        channel.colour,
        channel.histogram.len(),
        (channel.histogram_to - channel.histogram_from) / channel.histogram.len() as f64,
        channel.histogram_from,
        channel.histogram_to,
    );
    for row in (0..ROWS).rev() {
        let cell = |&count: &u64| {
            let height = (count as f64 / most).sqrt() * ROWS as f64 - row as f64;
            match count {
                0 => ' ',
                _ if row == 0 && height < 0.5 => '.',
                _ if height <= 0.0 => ' ',
                _ if height < 0.5 => '.',
                _ if height < 1.0 => ':',
                _ => '|',
            }
        };
        let line: String = channel.histogram.iter().map(cell).collect();
        text += &format!("  {}\n", line.trim_end());
    }
    text += &format!("  {}\n", "-".repeat(channel.histogram.len()));
    text += &format!(
        "  below black {}, at saturation {}, of {} pixels\n",
        channel.below_black, channel.at_saturation, channel.sites
    );
    text
}

fn filters(photo: &Photo) -> String {
    let letter = |c: u8| ["R", "G", "B"].get(usize::from(c)).copied().unwrap_or("?");
    let [top, bottom] = photo.mosaic.cfa.0.map(|row| row.map(letter).concat());
    format!("filters {top}/{bottom}")
}

/// Four levels of the 2x2 array, or one if they are all the same.
fn four(levels: [[f32; 2]; 2]) -> String {
    let [[a, b], [c, d]] = levels;
    if [b, c, d].iter().all(|v| *v == a) {
        format!("{a:.2}")
    } else {
        format!("{a:.2} {b:.2} / {c:.2} {d:.2}")
    }
}

fn source(source: LevelSource) -> &'static str {
    match source {
        LevelSource::Measured => "calibration shots",
        LevelSource::MaskedPixels => "the frame's masked pixels",
        LevelSource::FileTag => "the file's tag",
        LevelSource::BodyTable => "published measurements of this body",
        LevelSource::DecoderTable => "the decoder's table (a fallback)",
        LevelSource::DecoderMargin => {
            "the decoder's table less 15 % (a fallback: measure it with `unlit calibrate levels`)"
        }
    }
}

fn settings_line(settings: &Settings) -> String {
    fn told(value: Option<impl Display>) -> Option<String> {
        value.map(|v| v.to_string())
    }
    // Makers like to repeat their name in the model.
    let make = settings.make.as_ref().filter(|make| {
        settings.model.as_ref().is_none_or(|model| !model.to_lowercase().starts_with(&make.to_lowercase()))
    });
    let camera = [make.cloned(), settings.model.clone()].into_iter().flatten().collect::<Vec<_>>().join(" ");
    let parts = [
        (!camera.is_empty()).then_some(camera),
        settings.serial.as_ref().map(|s| format!("serial {s}")),
        settings.lens.clone(),
        told(settings.shutter),
        told(settings.aperture),
        told(settings.iso),
        settings.focal_length_mm.map(|f| format!("{f} mm")),
        settings.exposure_program.as_ref().map(|p| format!("program {p}")),
        settings.white_balance.as_ref().map(|w| format!("white balance {w}")),
        settings.taken_at.clone(),
    ];
    let line = parts.into_iter().flatten().collect::<Vec<_>>().join(", ");
    if line.is_empty() { "no settings in the file".to_owned() } else { line }
}
