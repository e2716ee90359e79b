//! Noise and linearity in the report.

use super::{Told, Z95, ends, figure, figures, head, or_dash, used};
use crate::calibration::Record;
use crate::calibration::noise::{IsoNoise, Linearity, LinearityStep, NoiseFit, PairResidual};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::export::chart::{Chart, Curve, Plot, Series};
use crate::session::Session;
use std::collections::BTreeSet;

const COLOURS: [&str; 3] = ["red", "green", "blue"];

pub(super) fn tell(_: &Session, record: &Record<NoiseFit>) -> Told {
    let roles = vec![String::new(); record.shots.len()];
    let mut told = Told { roles, ..Told::default() };
    for noise in &record.fit.noise {
        told.valid_for.push(noise.iso.to_string());
        // Lit frames are read first; what makes no pair is left out.
        let all = used(record, |number| record.shots[number].iso == Some(noise.iso));
        let (lit, dark) = all.split_at((2 * noise.pairs).min(all.len()));
        lit.iter().for_each(|&shot| told.roles[shot] = "evenly lit frame".into());
        dark.iter().for_each(|&shot| told.roles[shot] = "dark frame".into());
        told.pieces.push(Piece::Plot(transfer(noise)));
        told.pieces.push(numbers(noise, &all, lit));
        if let Some(linearity) = &noise.linearity {
            told.pieces.push(Piece::Plot(straightness(noise, linearity)));
            told.pieces.push(steps(noise, linearity));
        }
        told.pieces.push(residuals(noise));
    }
    told
}

/// Photon transfer, both axes logarithmic.
fn transfer(noise: &IsoNoise) -> Plot {
    let series = COLOURS.map(|colour| {
        let own = noise.residuals.iter().filter(|r| r.colour == colour);
        let points = own.map(|r| (r.signal_dn, r.variance_dn2, Z95 * r.variance_dn2_standard_error));
        Series { name: colour.into(), points: points.collect() }
    });
    let lit = || noise.residuals.iter().map(|r| r.signal_dn).filter(|s| *s >= 1.0);
    let (low, high) = lit().fold((f64::INFINITY, 0.0f64), |(l, h), s| (l.min(s), h.max(s)));
    let (gain, floor) = (f64::from(noise.model.gain), f64::from(noise.model.floor));
    let along = |law: &dyn Fn(f64) -> f64| -> Vec<(f64, f64)> {
        let places = (0..=40).map(|k| low * (high / low).powf(f64::from(k) / 40.0));
        places.filter(|s| s.is_finite()).map(|s| (s, law(s))).collect()
    };
    let curves = vec![
        Curve { name: "fit".into(), points: along(&|s| gain * s + floor) },
        Curve { name: "shot noise alone".into(), points: along(&|s| gain * s) },
    ];
    Plot {
        logarithmic: [true, true],
        curves,
        ..Plot::from(Chart {
            caption: format!(
                "Photon transfer at {}: variance of one frame over its signal, pair by pair. Dark pairs have no place on this axis.",
                noise.iso
            ),
            across: "signal above black, DN".into(),
            up: "variance, DN\u{b2}".into(),
            series: series
                .into_iter()
                .map(|s| Series { points: s.points.into_iter().filter(|p| p.0 >= 1.0).collect(), ..s })
                .collect(),
        })
    }
}

fn straightness(noise: &IsoNoise, linearity: &Linearity) -> Plot {
    let series = COLOURS.map(|colour| {
        let own = linearity.steps.iter().filter(|step| step.colour == colour);
        let points =
            own.map(|s| (s.signal_dn, 100.0 * s.deviation, 100.0 * Z95 * s.deviation_standard_error));
        Series { name: colour.into(), points: points.collect() }
    });
    Plot {
        logarithmic: [true, false],
        joined: true,
        ..Plot::from(Chart {
            caption: format!(
                "Linearity at {}: signal over what a straight line through black says, less 1.",
                noise.iso
            ),
            across: "signal above black, DN".into(),
            up: "deviation, %".into(),
            series: series.into(),
        })
    }
}

fn numbers(noise: &IsoNoise, all: &[usize], lit: &[usize]) -> Piece {
    let percent = |interval: [f64; 2]| ends(interval.map(|v| 100.0 * v), 3);
    let mut rows = vec![
        figure(
            "Gain, all colours",
            format!("{:.4}", noise.electrons_per_dn),
            "electrons / DN",
            Some(ends(noise.electrons_per_dn_interval_95, 4)),
            all,
        ),
        figure(
            "Read noise",
            or_dash(noise.read_noise_e, 2),
            "electrons",
            noise
                .read_noise_e_interval_95
                .or(noise.read_noise_below_e.map(|below| [0.0, below]))
                .map(|i| ends(i, 2)),
            all,
        ),
        figure("Read noise", or_dash(noise.read_noise_dn, 3), "DN", None, all),
    ];
    for colour in &noise.colours {
        rows.push(figure(
            &format!("Gain, {}", colour.colour),
            or_dash(colour.electrons_per_dn, 4),
            "electrons / DN",
            colour.electrons_per_dn_interval_95.map(|i| ends(i, 4)),
            all,
        ));
        rows.push(figure(
            &format!("Full well, {}", colour.colour),
            or_dash(colour.full_well_e, 0),
            "electrons",
            colour.full_well_e_interval_95.map(|i| ends(i, 0)),
            all,
        ));
    }
    rows.extend([
        figure(
            "Fixed pattern, at most",
            or_dash(noise.fixed_pattern.map(|p| 100.0 * p), 3),
            "%",
            noise.fixed_pattern_interval_95.map(percent),
            lit,
        ),
        figure(
            "Scatter over what is expected (chi\u{b2})",
            format!("{:.2}", noise.chi_squared),
            "1",
            None,
            all,
        ),
        figure(
            "Tiles far from the line, left out",
            format!("{:.2}", 100.0 * noise.rejected_share),
            "%",
            None,
            all,
        ),
    ]);
    if let Some(linearity) = &noise.linearity {
        let [from, to] = linearity.range_dn;
        let shots = |wanted: &dyn Fn(&LinearityStep) -> bool| -> Vec<usize> {
            let own = linearity.steps.iter().filter(|step| wanted(step));
            let shots: BTreeSet<usize> = own.flat_map(|step| step.shot_numbers.iter().copied()).collect();
            shots.into_iter().collect()
        };
        rows.push(figure(
            &format!("Linearity error from {from:.0} to {to:.0} DN"),
            format!("{:.3}", 100.0 * linearity.linearity_error),
            "%",
            None,
            &shots(&|step| step.counts),
        ));
        rows.push(figure(
            "Largest deviation",
            format!("{:+.3}", 100.0 * linearity.largest_deviation),
            "%",
            None,
            &shots(&|step| step.deviation == linearity.largest_deviation),
        ));
        rows.push(figure(
            "Knee (deviation above 1 %)",
            or_dash(linearity.knee_dn, 0),
            "DN",
            None,
            &shots(&|_| true),
        ));
    }
    figures(&format!("Figures at {}", noise.iso), rows)
}

/// Levels of light, the colours of each beside each other.
fn steps(noise: &IsoNoise, linearity: &Linearity) -> Piece {
    let mut lights: Vec<f64> = linearity.steps.iter().map(|step| step.light).collect();
    lights.sort_by(f64::total_cmp);
    lights.dedup();
    let rows = lights.into_iter().map(|light| {
        let own =
            COLOURS.map(|c| linearity.steps.iter().find(|step| step.light == light && step.colour == c));
        let signals = own.map(|step| or_dash(step.map(|s| s.signal_dn), 1));
        let deviations = own.map(|step| match step {
            Some(s) => {
                format!("{:+.3} \u{b1}{:.3}", 100.0 * s.deviation, 100.0 * Z95 * s.deviation_standard_error)
            }
            None => "-".into(),
        });
        let cells = std::iter::once(format!("{light:.3}")).chain(signals).chain(deviations);
        let from = own.into_iter().flatten().next().map_or_else(Vec::new, |step| step.shot_numbers.clone());
        Row { cells: cells.collect(), from }
    });
    Piece::Table(Table {
        caption: format!(
            "Linearity at {}: signal in DN above black, and its deviation from the line in %",
            noise.iso
        ),
        head: head(&["Light, 1 at the dimmest", "Red", "Green", "Blue", "Red, %", "Green, %", "Blue, %"]),
        rows: rows.collect(),
    })
}

/// Pairs of frames, the colours of each beside each other.
fn residuals(noise: &IsoNoise) -> Piece {
    // A pair's colours stand in their order, and a colour of which it has no tile is absent.
    let mut pairs: Vec<[Option<&PairResidual>; 3]> = vec![];
    for residual in &noise.residuals {
        let Some(own) = COLOURS.iter().position(|colour| *colour == residual.colour) else { continue };
        match pairs.last_mut() {
            Some(last) if last[own..].iter().all(Option::is_none) => last[own] = Some(residual),
            _ => {
                let mut pair = [None; 3];
                pair[own] = Some(residual);
                pairs.push(pair);
            }
        }
    }
    let off = |r: &PairResidual| {
        (r.variance_dn2 - r.model_dn2) / r.variance_dn2_standard_error.max(f64::MIN_POSITIVE)
    };
    let rows = pairs.into_iter().enumerate().map(|(number, pair)| {
        let signals = pair.map(|r| or_dash(r.map(|r| r.signal_dn), 1));
        let variances = pair.map(|r| or_dash(r.map(|r| r.variance_dn2), 2));
        let errors = pair.map(|r| r.map_or_else(|| "-".into(), |r| format!("{:+.2}", off(r))));
        let cells = std::iter::once((number + 1).to_string()).chain(signals).chain(variances).chain(errors);
        let from = pair.into_iter().flatten().next().map_or_else(Vec::new, |r| r.shot_numbers.clone());
        Row { cells: cells.collect(), from }
    });
    Piece::Table(Table {
        caption: format!(
            "Residuals of the photon transfer at {}, pair by pair: signal in DN, variance in DN\u{b2}, and how far it is off the line, \
             in standard errors",
            noise.iso
        ),
        head: head(&[
            "Pair",
            "Signal R",
            "Signal G",
            "Signal B",
            "Variance R",
            "Variance G",
            "Variance B",
            "Off R",
            "Off G",
            "Off B",
        ]),
        rows: rows.collect(),
    })
}
