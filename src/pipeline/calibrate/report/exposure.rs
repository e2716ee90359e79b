//! The exposure table in the report, with the thesis's table 3.2 beside ours.

use super::{Told, ends, head};
use crate::calibration::Record;
use crate::calibration::exposure::{ExposureFit, Ladder, Setting, Summary, THESIS};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::export::chart::Plot;
use crate::pipeline::calibrate::exposure::figure;
use crate::session::Session;

pub(super) fn tell(_: &Session, record: &Record<ExposureFit>) -> Told {
    let roles = vec![String::new(); record.shots.len()];
    let mut told = Told { roles, ..Told::default() };
    let apertures = record.fit.ladders.iter().any(|ladder| ladder.setting == Setting::Aperture);
    if apertures && let Some(lens) = &record.rig.lens {
        told.valid_for.push(format!("apertures of {lens}"));
    }
    told.pieces.push(Piece::Plot(Plot { joined: true, ..Plot::from(figure(&record.fit)) }));
    told.pieces.push(table_3_2(&record.fit));
    for ladder in &record.fit.ladders {
        for (number, step) in ladder.steps.iter().enumerate() {
            for &shot in &step.shot_numbers {
                if let Some(role) = told.roles.get_mut(shot) {
                    let own = format!("{} ladder, step {number:02}", ladder.setting.name());
                    *role = if role.is_empty() { own } else { format!("{role}; {own}") };
                }
            }
        }
        told.pieces.push(steps(ladder));
    }
    told
}

/// The three rows of the thesis's table 3.2, ours and its own side by side.
fn table_3_2(fit: &ExposureFit) -> Piece {
    let mut rows = vec![];
    for (setting, thesis) in Setting::ALL.into_iter().zip(&THESIS) {
        let own: Vec<&Ladder> = fit.ladders.iter().filter(|ladder| ladder.setting == setting).collect();
        if own.is_empty() {
            rows.push(beside(format!("{}: no ladder", setting.name()), None, thesis, &[]));
        }
        for ladder in own {
            let shots: Vec<usize> = shots(ladder);
            let name = |how: &str| format!("{}, {how}", setting.name());
            rows.push(beside(name("step from step"), Some(&ladder.between_steps), thesis, &shots));
            rows.push(beside(name("from step 00"), Some(&ladder.summary), thesis, &shots));
        }
    }
    Piece::Table(Table {
        caption: "Deviation from the ideal factor by setting, beside the thesis's table 3.2 (its camera). 0.01 is 1 %; the mean with its \
                  sign, max and min of the magnitudes; the thesis goes step from step."
            .into(),
        head: head(&["Setting", "Mean", "Thesis", "Max", "Thesis", "Min", "Thesis", "SD", "Thesis"]),
        rows,
    })
}

fn beside(name: String, own: Option<&Summary>, thesis: &Summary, from: &[usize]) -> Row {
    let four = |s: &Summary| [s.mean, s.max, s.min, s.sd].map(|v| format!("{v:.4}"));
    let own = own.map_or_else(|| std::array::from_fn(|_| "-".to_owned()), four);
    let pairs = own.into_iter().zip(four(thesis)).flat_map(|(own, thesis)| [own, thesis]);
    Row { cells: std::iter::once(name).chain(pairs).collect(), from: from.to_vec() }
}

/// All shots of a ladder.
fn shots(ladder: &Ladder) -> Vec<usize> {
    let mut all: Vec<usize> =
        ladder.steps.iter().flat_map(|step| step.shot_numbers.iter().copied()).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn steps(ladder: &Ladder) -> Piece {
    let base = ladder.steps.first().map_or(&[][..], |step| &step.shot_numbers);
    let rows = ladder.steps.iter().map(|step| {
        let percent = |part: f64| format!("{:.1}", 100.0 * part);
        let mut from = [base, &step.shot_numbers].concat();
        from.sort_unstable();
        from.dedup();
        Row {
            cells: vec![
                ladder.setting.words(step.label),
                format!("{}", step.step_thirds),
                format!("{:.4}", step.factor / (1.0 + step.deviation)),
                format!("{:.4}", step.factor),
                format!("{:+.3}", 100.0 * step.deviation),
                ends(step.deviation_interval_95.map(|d| 100.0 * d), 3),
                percent(step.frame_share),
                format!("{:.2}", 100.0 * step.pattern_sd),
            ],
            from,
        }
    });
    let shared: Vec<String> = ladder.shared.iter().map(|(setting, label)| setting.words(*label)).collect();
    let repeat = match ladder.repeat_sd {
        Some(sd) => format!("shots of one label scatter by {:.3} % beyond noise", 100.0 * sd),
        None => "no label was shot twice, so that the intervals hold the sensor's noise alone".into(),
    };
    Piece::Table(Table {
        caption: format!("{} at {}; {repeat}", ladder.setting.name(), shared.join(", ")),
        head: head(&[
            "Label",
            "k",
            "2^(k/3)",
            "Factor",
            "Deviation, %",
            "95 % interval, %",
            "Frame compared, %",
            "Pattern moved, %",
        ]),
        rows: rows.collect(),
    })
}
