//! Colour in the report.

use super::{Told, head, picture, used};
use crate::calibration::Record;
use crate::calibration::colour::{self, ColourFit, Differences, Lab};
use crate::export::calibration_report::{Patch, Piece, Row, Swatches, Table};
use crate::export::chart::Plot;
use crate::export::colour::{LINEAR_SRGB, PCS_WHITE, adapt};
use crate::pipeline::calibrate::colour::{SessionColour, figure};
use crate::pipeline::report::fact;
use crate::raster::srgb::encode_u8;
use crate::session::Session;

pub(super) fn tell(session: &Session, record: &Record<SessionColour>) -> Told {
    let (kept, fit) = (&record.fit, &record.fit.fit);
    let from = used(record, |_| true);
    let light = match kept.room_light_taken_off {
        true => "the flash's light, the room's taken off",
        false => "the light of the chart's frame",
    };
    let found = match kept.found_without_help {
        true => format!("found without help, {} patches seen", kept.patches_seen),
        false => "corners given by hand".into(),
    };
    let iso = fit.standards.iso_19264_1_level.as_deref().unwrap_or("none met");
    let caption = "Where the patches were found; red outlines: left out.";
    Told {
        valid_for: vec![light.into()],
        facts: vec![
            fact("Chart", format!("{}; values of {}; {found}", fit.chart.name(), fit.chart_source)),
            fact("ISO 19264-1, colour alone", iso.to_owned()),
            fact("FADGI 2023, colour alone", format!("{} of 4 stars", fit.standards.fadgi_2023_stars)),
            fact(
                "Light over the chart",
                format!(
                    "{:+.2} % across, {:+.2} % down from its middle (standard errors {:.2} %, {:.2} %); {}",
                    100.0 * fit.evenness.across,
                    100.0 * fit.evenness.down,
                    100.0 * fit.evenness.across_standard_error,
                    100.0 * fit.evenness.down_standard_error,
                    if fit.evenness.taken_out { "taken out" } else { "left as it was" }
                ),
            ),
        ],
        pieces: vec![
            Piece::Swatches(swatches(fit)),
            Piece::Plot(Plot::from(figure(fit))),
            picture(session, "colour.png", "image/png", caption),
            differences(fit, &from),
            matrices(kept, &from),
            patches(fit, &from),
        ],
        roles: vec!["chart".into(), "room without flash".into()],
    }
}

/// A colour as a screen shows it; what a screen cannot show is clamped.
fn on_screen(lab: Lab) -> [u8; 3] {
    let white = adapt(PCS_WHITE, LINEAR_SRGB.white_xyz());
    let rgb = LINEAR_SRGB.xyz_from_rgb().inverse() * white * colour::xyz(lab);
    rgb.to_array().map(|v| encode_u8(v as f32))
}

fn swatches(fit: &ColourFit) -> Swatches {
    let patches = fit.patches.iter().enumerate().map(|(k, patch)| Patch {
        name: format!("{} {}", k + 1, patch.name),
        measured: on_screen(patch.lab),
        meant: on_screen(patch.reference_lab),
        words: match patch.left_out {
            Some(_) => "left out".into(),
            None => format!("{:.2}", patch.delta_e_2000),
        },
    });
    Swatches {
        caption: "The chart's patches: left as measured, right as published (sRGB; what a screen cannot show is clamped), with \
                  CIEDE2000 between the two."
            .into(),
        columns: colour::COLUMNS,
        patches: patches.collect(),
    }
}

fn differences(fit: &ColourFit, from: &[usize]) -> Piece {
    let row = |name: &str, d: &Differences| Row {
        cells: std::iter::once(name.to_owned())
            .chain(
                [d.mean, d.percentile_90, d.max, d.mean_sl1, d.percentile_90_sl1, d.max_sl1]
                    .map(|v| format!("{v:.2}")),
            )
            .chain([d.patches.to_string()])
            .collect(),
        from: from.to_vec(),
    };
    Piece::Table(Table {
        caption: "Differences, CIEDE2000; the last three with S_L = 1, as the standards have it".into(),
        head: head(&[
            "Patches",
            "Mean",
            "90 %",
            "Max",
            "Mean, S_L = 1",
            "90 %, S_L = 1",
            "Max, S_L = 1",
            "Number",
        ]),
        rows: [
            Some(row("fitted", &fit.fit)),
            Some(row("each by a fit without it", &fit.leave_one_out)),
            fit.half_held_out.as_ref().map(|half| row("each half by a fit to the other", half)),
            Some(row("fitted, light taken to be even", &fit.fit_even)),
        ]
        .into_iter()
        .flatten()
        .collect(),
    })
}

fn matrices(kept: &SessionColour, from: &[usize]) -> Piece {
    let mut rows = vec![];
    for (name, matrix, outs) in [
        ("XYZ (D50)", &kept.fit.xyz_d50_from_camera, ["X", "Y", "Z"]),
        ("linear sRGB", &kept.linear_srgb_from_camera, ["R", "G", "B"]),
        ("ACEScg", &kept.acescg_from_camera, ["R", "G", "B"]),
    ] {
        for (out, row) in outs.into_iter().zip(matrix) {
            let cells = std::iter::once(format!("{name}, {out}")).chain(row.map(|v| format!("{v:.5}")));
            rows.push(Row { cells: cells.collect(), from: from.to_vec() });
        }
    }
    let head = head(&["To", "Camera R", "Camera G", "Camera B"]);
    let [r, g, b] = kept.fit.white_dn;
    let caption = format!(
        "Matrices from camera RGB in which white is (1, 1, 1); a perfect white in the chart's light reads {r:.0} {g:.0} {b:.0} DN"
    );
    Piece::Table(Table { caption, head, rows })
}

fn patches(fit: &ColourFit, from: &[usize]) -> Piece {
    let three =
        |values: [f64; 3], digits: usize| values.map(|v| format!("{v:.digits$}")).join("\u{a0}\u{a0}");
    let rows = fit.patches.iter().enumerate().map(|(k, patch)| Row {
        cells: vec![
            (k + 1).to_string(),
            patch.name.clone(),
            three(patch.rgb_dn, 0),
            three(patch.rgb_dn_standard_error, 1),
            three(patch.reference_lab, 1),
            three(patch.lab, 1),
            format!("{:.2}", patch.delta_e_2000),
            super::or_dash(patch.leave_one_out_delta_e_2000, 2),
            patch.left_out.clone().unwrap_or_default(),
        ],
        from: from.to_vec(),
    });
    Piece::Table(Table {
        caption: "Patches".into(),
        head: head(&[
            "",
            "Patch",
            "Camera RGB, DN",
            "Standard error, DN",
            "L* a* b* published",
            "L* a* b* fitted",
            "CIEDE2000",
            "Without it",
            "Left out",
        ]),
        rows: rows.collect(),
    })
}
