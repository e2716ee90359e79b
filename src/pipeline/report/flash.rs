//! The report's part on the flash: what it gave, pair by pair, and how steady it is.

use super::super::energy::FlashAccount;
use super::{fact, percent};
use crate::export::chart::{Chart, Series};
use crate::export::report::Block;
use crate::pair::energy::{ReferenceSource, Repeatability};
use crate::pipeline::calibrate::report::Z95;

/// The blocks; a sentence if no controller measured anything.
pub(super) fn blocks(account: &FlashAccount) -> Vec<Block> {
    let trend = &account.trend;
    let mut blocks = vec![];
    match account.scale.reference {
        Some(reference) if !trend.pulses.is_empty() => {
            let source = match reference.source {
                ReferenceSource::Calibration => "mean of the calibration's card shots",
                ReferenceSource::Session => {
                    "median of the session's own pairs; what the flash gave beside the calibration is not known"
                }
            };
            let reading = account.scale.reading_deviation / reference.counts;
            let mut facts = vec![
                fact("Reference energy", format!("{:.0} counts: {source}", reference.counts)),
                fact("Standard deviation of a reading", format!("{:.3} %", 100.0 * reading)),
            ];
            if let Some(spread) = trend.spread {
                let words = format!("{:.3} % from pulse to pulse, divided out of the pairs", 100.0 * spread);
                facts.push(fact("Unsteadiness of the flash", words));
            }
            let losses = [
                ("Loss by short rests", trend.recharge_loss),
                ("Loss by heat", trend.heat_loss),
                ("Droop since the first pair", trend.droop),
            ];
            facts.extend(losses.into_iter().filter_map(|(name, loss)| Some(fact(name, percent(-loss?)))));
            blocks.push(Block::Facts(facts));
            let points = trend.pulses.iter().map(|p| (f64::from(p.pair), p.gain, Z95 * p.deviation)).collect();
            blocks.push(Block::Chart(Chart {
                caption: "Energy of each pair's pulse, as the photodiode measured it.".into(),
                across: "pair".into(),
                up: "energy / reference".into(),
                series: vec![Series { name: "energy".into(), points }],
            }));
        }
        _ => blocks.push(Block::Text(
            "No flash controller measured the pulses of these pairs, so that the flash's unsteadiness from pulse to \
             pulse is part of the result."
                .into(),
        )),
    }
    blocks.extend(trend.advice.iter().map(|advice| Block::Text(advice.sentence.clone())));
    if let Some(run) = &account.repeatability {
        blocks.extend(repeatability(run));
    }
    blocks
}

/// A repeatability run: its figures, and its shots in a chart.
pub(in crate::pipeline) fn repeatability(run: &Repeatability) -> [Block; 2] {
    let of =
        |value: f64, error: f64| format!("{:.3} % \u{b1} {:.3} % (95 %)", 100.0 * value, 100.0 * Z95 * error);
    let facts = vec![
        fact("Repeatability run", format!("{} shots of one scene, nothing changed", run.shots.len())),
        fact("Known light, standard deviation", of(run.spread, run.spread_error)),
        fact("Divided by the measured energy", of(run.corrected, run.corrected_error)),
        fact("Of both, the sensor's noise", format!("{:.3} %", 100.0 * run.sensor_noise)),
        fact("Of the latter, the photodiode's reading", format!("{:.3} %", 100.0 * run.reading_noise)),
    ];
    let n = run.shots.len() as f64;
    let mean = run.shots.iter().map(|s| s.light[1]).sum::<f64>() / n;
    let ratio = |s: &crate::pair::energy::RepeatShot| s.light[1] / s.energy_counts;
    let mean_ratio = run.shots.iter().map(ratio).sum::<f64>() / n;
    let at = |value: f64, number: u32| (f64::from(number), 100.0 * (value - 1.0), 0.0);
    let chart = Chart {
        caption: "Known light (green) of each shot of the repeatability run, before and after division by the measured energy.".into(),
        across: "shot".into(),
        up: "deviation from the mean, %".into(),
        series: vec![
            Series {
                name: "as it came".into(),
                points: run.shots.iter().map(|s| at(s.light[1] / mean, s.number)).collect(),
            },
            Series {
                name: "by energy".into(),
                points: run.shots.iter().map(|s| at(ratio(s) / mean_ratio, s.number)).collect(),
            },
        ],
    };
    [Block::Facts(facts), Block::Chart(chart)]
}
