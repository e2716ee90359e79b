//! Sensor levels in the report.

use super::{Told, Z95, ends, head, or_dash, picture, used};
use crate::calibration::Record;
use crate::calibration::levels::{BlackSource, IsoLevels, LevelsFit};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::session::Session;

pub(super) fn tell(session: &Session, record: &Record<LevelsFit>) -> Told {
    let roles = vec![String::new(); record.shots.len()];
    let mut told = Told { roles, ..Told::default() };
    // Its histograms are in no record; the figure was drawn when the frames were read.
    let caption = "Histogram of the dark frames by colour; without dark frames, saturation over ISO.";
    told.pieces.push(picture(session, "levels.svg", "image/svg+xml", caption));
    for levels in &record.fit.levels {
        told.valid_for.push(levels.iso.to_string());
        let (dark, blown) = frames(record, levels);
        dark.iter().for_each(|&shot| told.roles[shot] = "dark frame".into());
        blown.iter().for_each(|&shot| told.roles[shot] = "blown frame".into());
        told.pieces.push(Piece::Table(black(levels, &dark, &[dark.clone(), blown.clone()].concat())));
        told.pieces.push(Piece::Table(saturation(levels, &blown)));
    }
    told
}

/// Numbers of an ISO's dark and blown frames: dark ones are read first, and none of them is ever left out.
fn frames(record: &Record<LevelsFit>, levels: &IsoLevels) -> (Vec<usize>, Vec<usize>) {
    let mut own = used(record, |number| record.shots[number].iso == Some(levels.iso));
    let blown = own.split_off(levels.dark_frames.min(own.len()));
    (own, blown)
}

fn black(levels: &IsoLevels, dark: &[usize], all: &[usize]) -> Table {
    let (from, source) = match levels.black_source {
        Some(BlackSource::DarkFrames) => (dark, "dark frames"),
        Some(BlackSource::MaskedPixels) => (all, "the masked border"),
        None => (&[][..], "nothing: not measured"),
    };
    let within = |interval: Option<[f64; 2]>, error: Option<f64>| match (interval, error) {
        (Some(interval), _) => ends(interval, 3),
        (None, Some(error)) => format!("\u{b1}{:.4}", Z95 * error),
        (None, None) => "-".to_owned(),
    };
    let rows = levels.sites.iter().map(|site| Row {
        cells: vec![
            format!("{} ({}, {})", site.colour, site.row, site.column),
            or_dash(site.black_dn, 3),
            within(site.black_dn_interval_95, site.black_dn_standard_error),
            or_dash(site.masked_black_dn, 3),
            within(None, site.masked_black_dn_standard_error),
            or_dash(site.read_noise_dn, 3),
            within(
                site.read_noise_dn_interval_95.or(site.read_noise_below_dn.map(|below| [0.0, below])),
                site.read_noise_dn_standard_error,
            ),
        ],
        from: from.to_vec(),
    });
    let hot = levels.hot_sites.map_or_else(String::new, |n| format!("; {n} hot sites"));
    Table {
        caption: format!("Black and read noise at {}, from {source}{hot}", levels.iso),
        head: head(&[
            "Filter (row, column)",
            "Black, DN",
            "95 %",
            "Masked border, DN",
            "95 %",
            "Read noise, DN",
            "95 %",
        ]),
        rows: rows.collect(),
    }
}

fn saturation(levels: &IsoLevels, blown: &[usize]) -> Table {
    let rows = levels.sites.iter().map(|site| {
        let note = match (&site.not_reached, site.saturation_dn) {
            (Some(why), _) => format!("not reached: {why}"),
            (None, None) => "not measured: no blown frame".into(),
            (None, Some(_)) => String::new(),
        };
        Row {
            cells: vec![
                format!("{} ({}, {})", site.colour, site.row, site.column),
                or_dash(site.saturation_dn, 0),
                or_dash(site.clipped_from_dn, 0),
                note,
            ],
            from: blown.to_vec(),
        }
    });
    Table {
        caption: format!("Saturation at {}", levels.iso),
        head: head(&["Filter (row, column)", "Saturation, DN", "Taken for clipped from, DN", "Note"]),
        rows: rows.collect(),
    }
}
