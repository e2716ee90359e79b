//! The report's part on the flash: what it gave, pair by pair, and how steady it is.

use super::super::energy::FlashAccount;
use super::{fact, percent};
use crate::calibration::Steadiness;
use crate::calibration::statistics::Z95;
use crate::export::chart::{Chart, Series};
use crate::export::report::Block;
use crate::pair::energy::ReferenceSource;
use crate::pipeline::steadiness::picture;

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
pub(in crate::pipeline) fn repeatability(run: &Steadiness) -> [Block; 2] {
    let percent = |value: f64| format!("{:.3} %", 100.0 * value);
    let own = |value: f64, [low, high]: [f64; 2]| {
        let (value, low, high) = (percent(value), percent(low), percent(high));
        format!("without the sensor's noise {value} (95 %: {low} to {high})")
    };
    let light = own(run.jitter_deviation, run.jitter_deviation_interval_95);
    let mut facts = vec![
        fact("Repeatability run", format!("{} shots of one scene, nothing changed", run.frames.len())),
        fact("Known light, standard deviation", format!("{}; {light}", percent(run.light_deviation))),
        fact("The sensor's noise", percent(run.sensor_deviation)),
    ];
    if let (Some(whole), Some(value), Some(interval)) =
        (run.light_by_energy_deviation, run.corrected_deviation, run.corrected_deviation_interval_95)
    {
        let words = format!("{}; {}", percent(whole), own(value, interval));
        facts.push(fact("Divided by the measured energy", words));
    }
    facts.extend(run.reading_deviation.map(|part| fact("Of that, the photodiode's reading", percent(part))));
    [Block::Facts(facts), Block::Chart(picture(run))]
}
