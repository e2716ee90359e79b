//! The flash in the report.

use super::{Told, ends, figure, figures, head, or_dash};
use crate::calibration::{CardResidual, FlashCalibration, Record, Shot};
use crate::export::calibration_report::{Piece, Row, Table};
use crate::export::chart::{Chart, Curve, Plot, Series};
use crate::pipeline::flash::picture;
use crate::pipeline::report::{fact, moment};
use crate::session::Session;
use glam::DVec3;

const COLOURS: [&str; 3] = ["red", "green", "blue"];

pub(super) fn tell(_: &Session, record: &Record<FlashCalibration>) -> Told {
    let fit = &record.fit;
    let shots = lit_frames(&fit.cards, &record.shots);
    let mut roles = vec!["room without flash".to_owned(); record.shots.len()];
    for (card, shot) in fit.cards.iter().zip(&shots) {
        if let Some(role) = shot.and_then(|shot| roles.get_mut(shot)) {
            *role = format!("card at {:.3} m", card.distance_m);
        }
    }
    let used = fit.cards.iter().zip(&shots).filter(|(card, _)| card.used);
    let from: Vec<usize> = used.filter_map(|(_, shot)| *shot).collect();
    let told = |value: Option<String>, what: &str| value.unwrap_or_else(|| format!("{what} not told"));
    let valid_for = vec![
        told(record.rig.lens.clone(), "lens"),
        told(fit.aperture.map(|n| format!("f/{n}")), "aperture"),
        told(fit.iso.map(|iso| format!("ISO {iso} (others scaled)")), "ISO"),
        match fit.energy_counts {
            Some(counts) => format!("energy measured, {counts:.0} counts"),
            None => "the flash at the power of these shots".into(),
        },
    ];
    Told {
        valid_for,
        facts: facts(fit),
        pieces: vec![
            Piece::Plot(Plot::from(picture(fit))),
            Piece::Plot(law(fit)),
            Piece::Plot(field(fit)),
            numbers(fit, &from),
            cards(fit, &shots),
        ],
        roles,
    }
}

/// The number of each card's lit frame among the shots. Cards and shots are in one order; between them lie unlit frames.
fn lit_frames(cards: &[CardResidual], shots: &[Shot]) -> Vec<Option<usize>> {
    let mut next = 0;
    let of = |card: &CardResidual| {
        let found = next + shots.get(next..)?.iter().position(|shot| is_of(&shot.file, &card.label))?;
        next = found + 1;
        Some(found)
    };
    cards.iter().map(of).collect()
}

/// Whether a shot's place in the session is that of a file with this label: where it always was, or as a copy, whose
/// name begins with eight digits of its digest.
fn is_of(file: &str, label: &str) -> bool {
    let name = label.rsplit('/').next().unwrap_or(label);
    let own = file.rsplit('/').next().unwrap_or(file);
    own == name || own.get(8..).and_then(|rest| rest.strip_prefix('_')) == Some(name)
}

fn facts(fit: &FlashCalibration) -> Vec<(String, String)> {
    let found = &fit.findings;
    let [a1, a2, a3] = fit.field.coefficients;
    let field = match found.vignetting_given {
        true => "vignetting, from the flat field",
        false => "vignetting times lobe: card shots alone tell no more than the product",
    };
    let ring = if found.radii_fitted { "Ring by the shots" } else { "Ring by the ruler" };
    let noise =
        format!("variance = {:.4} DN \u{d7} signal + {:.2} DN\u{b2}", fit.noise.gain, fit.noise.floor);
    let mut facts = vec![
        fact(ring, format!("{} to {} m", fit.ring.inner, fit.ring.outer)),
        fact("Card", format!("reflectance {}", fit.target_reflectance)),
        fact("Over the field", format!("1 {a1:+.4} q {a2:+.4} q\u{b2} {a3:+.4} q\u{b3}: {field}")),
        fact("Noise", noise),
    ];
    if let Some(flat) = &found.flat_field {
        facts.push(fact(
            "Flat field",
            format!("measured {} UTC, BLAKE3 {}", moment(&flat.measured), flat.blake3),
        ));
    }
    if let Some(correction) = &found.correction {
        let factor = correction.factor.map(|f| format!("{f:.5}")).join(", ");
        let base = format!("{} (BLAKE3 {})", correction.base_file, correction.base_blake3);
        facts.push(fact("Corrected by one shot", format!("factor {factor} (R G B) on {base}")));
    }
    facts
}

/// The test of the inverse-square law: light on the card's middle over its distance, both logarithmic.
fn law(fit: &FlashCalibration) -> Plot {
    let on_axis = |d: f64| fit.ring.irradiance(DVec3::new(0.0, 0.0, d), DVec3::NEG_Z);
    let shown: Vec<(&CardResidual, f64)> =
        fit.cards.iter().filter(|c| c.distance_m > 0.0).filter_map(|c| Some((c, c.gain?))).collect();
    let far = shown.iter().map(|(c, _)| c.distance_m).fold(0.0, f64::max);
    let near = shown.iter().map(|(c, _)| c.distance_m).fold(far, f64::min);
    let unit = on_axis(far).max(f64::MIN_POSITIVE);
    let series = [("used for the fit", true), ("not used for the fit", false)].into_iter().filter_map(
        |(name, used)| {
            let own = shown.iter().filter(|(card, _)| card.used == used);
            let points: Vec<(f64, f64, f64)> = own
                .map(|(c, gain)| {
                    let light = gain / c.measured_gain.unwrap_or(1.0) * on_axis(c.distance_m) / unit;
                    (c.distance_m, light, 0.0)
                })
                .collect();
            (!points.is_empty()).then(|| Series { name: name.into(), points })
        },
    );
    let places =
        || (0..=40).map(move |k| near * (far / near).powf(f64::from(k) / 40.0)).filter(|d| d.is_finite());
    let curves = vec![
        Curve {
            name: "the ring as fitted".into(),
            points: places().map(|d| (d, on_axis(d) / unit)).collect(),
        },
        Curve {
            name: "1 / distance\u{b2}".into(),
            points: places().map(|d| (d, (far / d).powi(2))).collect(),
        },
    ];
    let found = fit.findings.distance_exponent.zip(fit.findings.distance_exponent_interval_95);
    let exponent = found.map_or_else(
        || "The shots do not tell the exponent.".to_owned(),
        |(p, interval)| format!("Exponent found: {p:.4} ({}), 2 by the law.", ends(interval, 4)),
    );
    Plot {
        logarithmic: [true, true],
        curves,
        ..Plot::from(Chart {
            caption: format!(
                "Test of the inverse-square law: light on the card's middle, 1 at the farthest shot. A ring is no point, so near shots lie off 1 / distance\u{b2}. {exponent}"
            ),
            across: "distance, m".into(),
            up: "relative light".into(),
            series: series.collect(),
        })
    }
}

/// The product of vignetting and lobe, or the vignetting.
fn field(fit: &FlashCalibration) -> Plot {
    let [a, b, c] = fit.field.coefficients;
    let at = |r: f64| {
        let q = r * r;
        (r, 1.0 + q * (a + q * (b + q * c)))
    };
    let (name, caption) = match fit.findings.vignetting_given {
        true => ("vignetting", "Vignetting over the frame, as the flat field gives it."),
        false => (
            "vignetting times lobe",
            "Vignetting times the flash's lobe over the frame, as the card shots tell it.",
        ),
    };
    Plot {
        curves: vec![Curve {
            name: name.into(),
            points: (0..=50).map(|k| at(f64::from(k) / 50.0)).collect(),
        }],
        ..Plot::from(Chart {
            caption: caption.into(),
            across: "distance from the centre / half diagonal".into(),
            up: "light / light at the centre".into(),
            series: vec![],
        })
    }
}

fn numbers(fit: &FlashCalibration, from: &[usize]) -> Piece {
    let found = &fit.findings;
    let mut rows: Vec<Row> = vec![];
    for (c, colour) in COLOURS.into_iter().enumerate() {
        let interval = fit.radiance_dn_interval_95.map(|i| ends(i[c], 0));
        rows.push(figure(
            &format!("Radiance of the ring, {colour}"),
            format!("{:.0}", fit.radiance_dn[c]),
            "DN",
            interval,
            from,
        ));
    }
    type Told<'a> = (&'a str, Option<f64>, Option<[f64; 2]>);
    let fitted = |(name, value, interval): Told<'_>, (scale, digits): (f64, usize), unit: &str| {
        let interval = interval.map(|ends_of| ends(ends_of.map(|end| scale * end), digits));
        figure(name, or_dash(value.map(|v| scale * v), digits), unit, interval, from)
    };
    let offset = ("Offset of the ring along the axis", found.offset_m, found.offset_m_interval_95);
    let lobe = ("Exponent n of the lobe cos^n", found.lobe_exponent, found.lobe_exponent_interval_95);
    let law =
        ("Exponent of the law of distance", found.distance_exponent, found.distance_exponent_interval_95);
    let inner = ("Inner radius by the shots", found.inner_radius_m, found.inner_radius_m_interval_95);
    let outer = ("Outer radius by the shots", found.outer_radius_m, found.outer_radius_m_interval_95);
    rows.extend([
        fitted(offset, (1e3, 2), "mm"),
        fitted(lobe, (1.0, 3), "1"),
        fitted(law, (1.0, 4), "1"),
        fitted(inner, (1e3, 2), "mm"),
        fitted(outer, (1e3, 2), "mm"),
    ]);
    let percent = |name: &str, part: Option<f64>, digits: usize| {
        figure(name, or_dash(part.map(|p| 100.0 * p), digits), "%", None, from)
    };
    let jitter = match found.jitter_assumed {
        true => "Flash's jitter between shots, assumed",
        false => "Flash's jitter between shots",
    };
    let second = found.second_render_ratio.map(|r| (r - 1.0).abs()).into_iter().fold(0.0, f64::max);
    rows.extend([
        percent(jitter, Some(found.jitter_deviation), 3),
        percent("Residual over all cells", Some(fit.residual_rms), 3),
        percent("Of it not the sensor's noise", Some(fit.misfit_rms), 3),
        percent("Shots predicted without themselves, mean error", found.left_one_out_error, 3),
        percent("Shots kept from the fit, mean error", found.held_out_error, 3),
        percent("Second render against the shots, worst colour", Some(second), 4),
        figure("Residuals' variance over the sensor's", format!("{:.2}", found.dispersion), "1", None, from),
    ]);
    figures("Figures", rows)
}

fn cards(fit: &FlashCalibration, shots: &[Option<usize>]) -> Piece {
    let rows = fit.cards.iter().zip(shots).map(|(card, shot)| {
        let percent =
            |part: Option<f64>| part.map_or_else(|| "-".to_owned(), |p| format!("{:+.3}", 100.0 * p));
        Row {
            cells: vec![
                format!("{:.3}", card.distance_m),
                or_dash(card.gain, 5),
                or_dash(card.measured_gain, 5),
                or_dash(card.residual_rms.map(|rms| 100.0 * rms), 3),
                percent(card.prediction_error),
                format!("{:.1}", 100.0 * card.clipped_share),
                match (card.used, card.held_out) {
                    (true, _) => "used",
                    (false, true) => "held out",
                    (false, false) => "left out",
                }
                .to_owned(),
            ],
            from: shot.iter().copied().collect(),
        }
    });
    Piece::Table(Table {
        caption: "Card shots and their residuals".into(),
        head: head(&[
            "Distance, m",
            "Energy as fitted, 1 = mean",
            "Energy as measured",
            "Residual in the frame, %",
            "Error of prediction, %",
            "Clipped, %",
            "Use",
        ]),
        rows: rows.collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::is_of;

    #[test]
    fn a_shot_is_known_by_its_name_in_place_and_as_a_copy() {
        assert!(is_of("calibration/flash/0a1b2c3d_d0800_0.dng", "d0800_0.dng"));
        assert!(is_of("calibration/shots/d00700_1/on.cr2", "d00700_1/on.cr2"));
        assert!(!is_of("calibration/flash/0a1b2c3d_d0800_1.dng", "d0800_0.dng"));
        assert!(!is_of("calibration/flash/xd0800_0.dng", "d0800_0.dng"));
        assert!(!is_of("\u{e4}\u{e4}\u{e4}\u{e4}\u{e4}", "a"));
    }
}
