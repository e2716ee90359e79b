//! The flat field in the report.

use super::{Told, ends, figure, figures, head, used};
use crate::calibration::Record;
use crate::calibration::flat::FlatCalibration;
use crate::export::calibration_report::{Map, Piece, Row, Table};
use crate::export::chart::{Curve, Plot};
use crate::pipeline::calibrate::flat;
use crate::pipeline::report::fact;
use crate::session::Session;

const COLOURS: [&str; 3] = ["red", "green", "blue"];

/// Residual, percent, at which a part of the map has its full tint.
const FULL: f64 = 0.5;

pub(super) fn tell(_: &Session, record: &Record<FlatCalibration>) -> Told {
    let fit = &record.fit;
    let lens = record.rig.lens.clone().unwrap_or_else(|| "lens not told".into());
    let focal = fit.focal_length_mm.map_or_else(|| "focal length not told".into(), |mm| format!("{mm} mm"));
    let aperture = fit.aperture.map_or_else(|| "aperture not told".into(), |n| n.to_string());
    let from = used(record, |_| true);
    Told {
        valid_for: vec![lens, focal, aperture],
        facts: vec![fact("Curve", curve_in_words(fit))],
        pieces: vec![Piece::Plot(profile(fit)), map(fit), numbers(fit, &from), coefficients(fit, &from)],
        roles: vec![],
    }
}

fn curve_in_words(fit: &FlatCalibration) -> String {
    let order = match fit.order {
        0 => "none".to_owned(),
        n => format!(
            "V = 1 + a1 q{}{}",
            if n > 1 { " + a2 q\u{b2}" } else { "" },
            if n > 2 { " + a3 q\u{b3}" } else { "" }
        ),
    };
    let curves = if fit.per_channel { "one for each colour" } else { "one for all colours" };
    format!("{order}, q = (r / half diagonal)\u{b2}, {curves}")
}

/// Measured light round the centre, and the fitted curve through it.
fn profile(fit: &FlatCalibration) -> Plot {
    let colours: &[usize] = if fit.per_channel { &[0, 1, 2] } else { &[1] };
    let curve = |&colour: &usize| {
        let places = (0..=50).map(|k| f64::from(k) / 50.0);
        Curve {
            name: if fit.per_channel { format!("fit, {}", COLOURS[colour]) } else { "fit".into() },
            points: places.map(|r| (r, fit.vignetting.at_q(r * r, colour))).collect(),
        }
    };
    Plot { curves: colours.iter().map(curve).collect(), ..Plot::from(flat::figure(fit)) }
}

fn map(fit: &FlatCalibration) -> Piece {
    let percent = |value: &Option<f64>| value.map(|v| 100.0 * v);
    Piece::Map(Map {
        caption: format!(
            "Measured over fitted light, less 1, in parts of the frame, %. Noise alone gives a part {:.3} %; full tint at {FULL} %.",
            100.0 * fit.residual_map_standard_error
        ),
        rows: fit.residual_map.iter().map(|row| row.iter().map(percent).collect()).collect(),
        digits: 2,
        full: FULL,
    })
}

fn numbers(fit: &FlatCalibration, from: &[usize]) -> Piece {
    let row = |name: String, value: f64, interval: [f64; 2], digits: usize| {
        let percent = interval.map(|end| 100.0 * end);
        figure(&name, format!("{:.digits$}", 100.0 * value), "%", Some(ends(percent, digits)), from)
    };
    let corner = |c: usize| {
        row(format!("Light in the corner, {}", COLOURS[c]), fit.corner[c], fit.corner_interval_95[c], 2)
    };
    let slope = |(axis, edge): (usize, &str)| {
        let name = format!("Slope of the light, centre to {edge} edge");
        row(name, fit.light_gradient[axis], fit.light_gradient_interval_95[axis], 3)
    };
    let mut rows: Vec<Row> = (0..3).map(corner).collect();
    rows.extend(["right", "lower"].into_iter().enumerate().map(slope));
    rows.extend([
        figure("Residual over the tiles", format!("{:.3}", 100.0 * fit.residual_rms), "%", None, from),
        figure("chi\u{b2} per degree of freedom", format!("{:.2}", fit.chi_squared), "1", None, from),
        figure("Tiles and colours used", format!("{:.1}", 100.0 * fit.used_share), "%", None, from),
    ]);
    figures("Figures", rows)
}

fn coefficients(fit: &FlatCalibration, from: &[usize]) -> Piece {
    let rows = COLOURS.iter().zip(fit.vignetting.coefficients).map(|(colour, coefficients)| Row {
        cells: std::iter::once((*colour).to_owned())
            .chain(coefficients.map(|c| format!("{c:+.5}")))
            .collect(),
        from: from.to_vec(),
    });
    let head = head(&["Colour", "a1", "a2", "a3"]);
    Piece::Table(Table { caption: "Coefficients".into(), head, rows: rows.collect() })
}
