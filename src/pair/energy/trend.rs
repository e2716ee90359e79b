//! The flash over a session: how its energy went, what that hangs on, and what the photographer should do.
//!
//! Three causes are looked for in the gains `g_i` of the pulses, each with its own signature in time:
//!
//! ```text
//! recharge   exp(-r_i / tau)                         r_i: rest since the pulse before; the capacitor is not full
//! heat       sum over j < i of exp(-(t_i - t_j) / T)  the tube warms with each pulse and cools with T
//! droop      i                                        the battery falls with each pulse
//! ```
//!
//! tau and T are tried on grids; a cause counts only if it explains the series significantly better than without
//! ([`super::fit`]). Advice is given where an effect is large enough to matter. The measured gain takes all of it out
//! of the pairs; advice keeps it small, since a flash that fades also changes its colour.

use super::fit::{Candidate, Fit, explain};
use super::{EnergyScale, mean_and_deviation, median};
use crate::pair::{FlashRecord, FlashSync, PairRecord, ReasonCode, Verdict, proof};
use crate::photometry::FlashGain;
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;

/// Fewer pulses have no trend.
const FEWEST_PULSES: usize = 10;
/// Least F value of a cause: below 1 % by chance for each of some ten candidates.
const LEAST_F: f64 = 14.0;
/// Time constants tried, seconds.
const RECHARGES: [f64; 6] = [0.3, 0.6, 1.2, 2.5, 5.0, 10.0];
const COOLINGS: [f64; 4] = [45.0, 120.0, 300.0, 900.0];
/// Loss of light that a longer rest should stay below.
const RECHARGED: f64 = 0.003;
/// Losses from which on advice is given.
const WORTH_WAITING: f64 = 0.005;
const WORTH_COOLING: f64 = 0.01;
/// Spread without a cause from which on the flash is called unsteady.
const UNSTEADY: f64 = 0.01;
/// Share of pairs without a proper flash from which on advice is given, and least number of them.
const MANY_MISFIRES: f64 = 0.1;
/// Relative deviation of a reading from which on something disturbs it: twice what the controller's tests bound.
const NOISY: f64 = 0.0015;
/// Median gain so far from 1 that photodiode or power have likely been changed since the calibration.
const CHANGED: f64 = 0.05;

/// One pulse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrendPulse {
    /// Number of the pair.
    pub pair: u32,
    /// When, UTC seconds since 1970.
    pub at: Option<f64>,
    /// Seconds since the pulse before; absent for the first and where a time is not known.
    pub rest: Option<f64>,
    /// Energy, the controller's counts.
    pub energy_counts: f64,
    /// Gain against the reference.
    pub gain: f64,
    /// Standard deviation of `gain`.
    pub deviation: f64,
}

/// What should be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AdviceCode {
    /// Longer rests between the pairs.
    WaitLonger,
    /// Less power, or a pause.
    LowerPower,
    /// A fresh battery.
    ChargeBattery,
    /// The flash varies without a cause that was found.
    Unsteady,
    /// Pairs without a proper flash.
    Misfires,
    /// The photodiode gets too much light.
    PhotodiodeClips,
    /// The photodiode sees nothing.
    PhotodiodeBlind,
    /// Readings are noisy: the room's light flickers into them.
    RoomFlickers,
    /// The energy is far from the calibration's.
    CalibrateAgain,
}

/// One piece of advice.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Advice {
    /// Stable name.
    pub code: AdviceCode,
    /// What was found and what to do.
    pub sentence: String,
}

/// The flash over a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trend {
    /// Measured pulses of accepted pairs, in the order of the pairs.
    pub pulses: Vec<TrendPulse>,
    /// Relative standard deviation of their energy; absent with fewer than two.
    pub spread: Option<f64>,
    /// Relative change of energy from rests that were too short, at the median rest; negative is a loss.
    pub recharge_loss: Option<f64>,
    /// Relative change by heat at the last pulse.
    pub heat_loss: Option<f64>,
    /// Relative change from the first pulse to the last, otherwise unexplained.
    pub droop: Option<f64>,
    /// Pairs with a flash controller.
    pub pairs: usize,
    /// Those whose unlit frame is proven dark and whose lit frame had its own pulse, seen by the photodiode.
    pub proven: usize,
    /// Those that were rejected for their lighting.
    pub misfires: usize,
    /// What to do; empty when all is well.
    pub advice: Vec<Advice>,
}

impl Trend {
    /// The flash in one sentence.
    pub fn words(&self) -> String {
        if self.pairs == 0 {
            return "No flash controller has watched a pair of this session yet.".into();
        }
        let proof = format!("{} of {} pairs are proven dark and lit", self.proven, self.pairs);
        match (self.spread, self.pulses.last()) {
            (Some(spread), Some(last)) => format!(
                "{proof}; the flash varies by {:.2} %, measured to {:.2} % and divided out.",
                100.0 * spread,
                100.0 * last.deviation / last.gain
            ),
            (None, Some(_)) => format!("{proof}; one pulse is measured."),
            (_, None) => format!("{proof}; no pulse's energy is measured."),
        }
    }
}

fn advice(code: AdviceCode, sentence: String) -> Advice {
    Advice { code, sentence }
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share.abs())
}

fn seconds(s: f64) -> String {
    if s < 90.0 { format!("{:.0} s", s.ceil()) } else { format!("{:.0} minutes", (s / 60.0).ceil()) }
}

/// What the session's pairs tell of the flash. `pairs` in the order in which they were shot, rejected ones included.
pub fn trend<R: Borrow<PairRecord>>(pairs: &[R], scale: &EnergyScale) -> Trend {
    let pairs: Vec<&PairRecord> = pairs.iter().map(Borrow::borrow).collect();
    let triggers = triggers(&pairs);
    let pulses = pulses(&pairs, &triggers, scale);
    let seen: Vec<_> = pairs.iter().filter_map(|p| Some((*p, p.flash.as_ref()?))).collect();
    let misfired = |p: &&(&PairRecord, _)| {
        p.0.reasons.iter().any(|r| matches!(r.code, ReasonCode::Misfire | ReasonCode::NotDark))
    };
    let misfires = seen.iter().filter(misfired).count();
    let gains: Vec<f64> = pulses.iter().map(|p| p.gain).collect();
    let spread = mean_and_deviation(&gains).map(|(mean, sd)| sd / mean);
    let proves = |flash: &FlashRecord| {
        let lit = |pulse: &FlashSync| proof::lit_frame(&flash.on, pulse.tag, true).is_none();
        proof::dark_frame(&flash.off).is_none() && flash.pulse().is_some_and(lit)
    };
    let proven = seen.iter().filter(|(_, flash)| proves(flash)).count();
    let mut trend = Trend { spread, pairs: seen.len(), proven, misfires, ..Trend::default() };

    if misfires >= 2 && misfires as f64 >= MANY_MISFIRES * seen.len() as f64 {
        let sentence = format!(
            "{misfires} of {} pairs had no proper flash: check sync cable, battery and the flash's power saving, and wait until it is recharged.",
            seen.len()
        );
        trend.advice.push(advice(AdviceCode::Misfires, sentence));
    }
    trend.advice.extend(photodiode(&seen.iter().map(|(p, f)| (*p, *f)).collect::<Vec<_>>()));
    if let (Some(reference), Some(usual)) = (scale.reference, median(&gains))
        && reference.source == super::ReferenceSource::Calibration
        && (usual - 1.0).abs() > CHANGED
    {
        let sentence = format!(
            "The photodiode measures {} {} light than at the flash calibration. If the flash's power was changed, that is taken into account; if the photodiode was moved, calibrate the flash again.",
            percent(usual - 1.0),
            if usual > 1.0 { "more" } else { "less" }
        );
        trend.advice.push(advice(AdviceCode::CalibrateAgain, sentence));
    }
    if let Some(reference) = scale.reference
        && scale.reading_deviation > NOISY * reference.counts
    {
        let sentence = format!(
            "The photodiode's readings scatter by {:.2} %: the room's lamps flicker into them. Tell the mains frequency (`--mains 50` or `--mains 60`), shield the photodiode from the room, or bring it nearer to the tube.",
            100.0 * scale.reading_deviation / reference.counts
        );
        trend.advice.push(advice(AdviceCode::RoomFlickers, sentence));
    }
    if pulses.len() >= FEWEST_PULSES {
        explain_trend(&mut trend, &pulses, &triggers);
    }
    trend.pulses = pulses;
    trend
}

/// When the flash was triggered, rejected pairs included: those pulses drain and heat it as well.
fn triggers(pairs: &[&PairRecord]) -> Vec<f64> {
    let records = pairs.iter().filter_map(|pair| pair.flash.as_ref());
    let syncs = records.flat_map(|flash| flash.off.iter().chain(&flash.on)).filter(|sync| sync.triggered);
    let mut times: Vec<f64> = syncs.filter_map(|sync| sync.at).collect();
    times.sort_by(f64::total_cmp);
    times
}

fn pulses(pairs: &[&PairRecord], triggers: &[f64], scale: &EnergyScale) -> Vec<TrendPulse> {
    let accepted = pairs.iter().filter(|pair| pair.verdict == Verdict::Accepted);
    accepted
        .filter_map(|pair| {
            let flash = pair.flash.as_ref()?;
            let energy_counts = flash.energy_counts()?;
            let FlashGain { value, deviation } = scale.measured(energy_counts)?;
            let at = flash.pulse().and_then(|sync| sync.at);
            let rest = at.and_then(|at| {
                let before = triggers.partition_point(|t| *t < at).checked_sub(1)?;
                Some(at - triggers[before])
            });
            Some(TrendPulse { pair: pair.number, at, rest, energy_counts, gain: value, deviation })
        })
        .collect()
}

fn photodiode(seen: &[(&PairRecord, &FlashRecord)]) -> Option<Advice> {
    let lit: Vec<_> = seen.iter().filter_map(|(_, flash)| flash.pulse()).collect();
    let clipped = lit.iter().filter(|sync| sync.clipped_samples > 0).count();
    if clipped > 0 {
        let sentence = format!(
            "The photodiode was blinded in {clipped} of {} pulses, so that their energy is not known: move it away from the tube or give it a smaller resistor.",
            lit.len()
        );
        return Some(advice(AdviceCode::PhotodiodeClips, sentence));
    }
    (!lit.is_empty() && lit.iter().all(|sync| sync.light().is_none())).then(|| {
        let sentence = "The photodiode has seen no pulse yet, so that the flash's unsteadiness stays in the pairs: point it at the flash tube (`unlit flash test` shows what it sees).";
        advice(AdviceCode::PhotodiodeBlind, sentence.into())
    })
}

/// What a candidate stands for.
#[derive(Clone, Copy)]
enum Cause {
    Recharge(f64),
    Heat(f64),
    Droop,
}

impl Cause {
    fn group(self) -> usize {
        match self {
            Cause::Recharge(_) => 0,
            Cause::Heat(_) => 1,
            Cause::Droop => 2,
        }
    }
}

/// The causes that can be told from these times.
fn causes(pulses: &[TrendPulse], triggers: &[f64]) -> Vec<(Cause, Candidate)> {
    let candidate = |cause: Cause, values: Vec<f64>| (cause, Candidate { group: cause.group(), values });
    let n = pulses.len();
    let mut out = vec![candidate(Cause::Droop, (0..n).map(|i| i as f64).collect())];
    let times: Option<Vec<f64>> = pulses.iter().map(|p| p.at).collect();
    let Some(times) = times else { return out };
    // The first pulse's rest is not known, but long.
    let rest = |p: &TrendPulse| p.rest.unwrap_or(f64::INFINITY);
    for tau in RECHARGES {
        out.push(candidate(Cause::Recharge(tau), pulses.iter().map(|p| (-rest(p) / tau).exp()).collect()));
    }
    let lasted = times.last().copied().unwrap_or(0.0) - times.first().copied().unwrap_or(0.0);
    // A tube that cools more slowly than the series lasts loses light along a line, as with a battery that runs down: the
    // two cannot be told apart.
    for cooling in COOLINGS.into_iter().filter(|cooling| *cooling <= lasted) {
        let heat = |at: f64| {
            let before = triggers.iter().take_while(|t| **t < at);
            before.map(|t| (-(at - t) / cooling).exp()).sum::<f64>()
        };
        out.push(candidate(Cause::Heat(cooling), times.iter().map(|at| heat(*at)).collect()));
    }
    out
}

fn explain_trend(trend: &mut Trend, pulses: &[TrendPulse], triggers: &[f64]) {
    let gains: Vec<f64> = pulses.iter().map(|p| p.gain).collect();
    let (causes, candidates): (Vec<Cause>, Vec<Candidate>) = causes(pulses, triggers).into_iter().unzip();
    let Fit { constant, chosen } = explain(&gains, &candidates, LEAST_F);
    let rests: Vec<f64> = pulses.iter().filter_map(|p| p.rest).collect();
    let mut explained = vec![constant; gains.len()];
    for chosen in &chosen {
        let values = &candidates[chosen.candidate].values;
        explained.iter_mut().zip(values).for_each(|(e, v)| *e += chosen.coefficient * v);
        let relative = chosen.coefficient / constant;
        let last = values.last().copied().unwrap_or(0.0);
        match causes[chosen.candidate] {
            Cause::Recharge(tau) => {
                let usual = median(&rests).unwrap_or(0.0);
                let loss = relative * (-usual / tau).exp();
                trend.recharge_loss = Some(loss);
                let shortest = rests.iter().copied().fold(f64::INFINITY, f64::min);
                let worst = relative * (-shortest / tau).exp();
                if worst < -WORTH_WAITING {
                    let wait = tau * (-relative / RECHARGED).ln();
                    let longer = (wait - shortest).max(0.5);
                    trend.advice.push(advice(AdviceCode::WaitLonger, format!(
                        "After short rests the flash gives up to {} less light: wait {} longer, {} from pulse to pulse (the shortest was {shortest:.1} s).",
                        percent(worst), seconds(longer), seconds(wait)
                    )));
                }
            }
            Cause::Heat(cooling) => {
                let loss = relative * last;
                trend.heat_loss = Some(loss);
                if loss < -WORTH_COOLING {
                    let pause = cooling * (loss.abs() / (0.5 * WORTH_COOLING)).ln();
                    trend.advice.push(advice(AdviceCode::LowerPower, format!(
                        "The flash is hot and gives {} less light than when it was cold: lower its power before the next session, or let it rest for {} now.",
                        percent(loss), seconds(pause)
                    )));
                }
            }
            Cause::Droop => {
                let loss = relative * last;
                trend.droop = Some(loss);
                if loss < -WORTH_COOLING {
                    trend.advice.push(advice(AdviceCode::ChargeBattery, format!(
                        "The flash has lost {} of its light since the first pair: charge or change its battery, or let it cool if it is hot.",
                        percent(loss)
                    )));
                }
            }
        }
    }
    let rest: Vec<f64> = gains.iter().zip(&explained).map(|(g, e)| g / e).collect();
    if let Some((_, unexplained)) = mean_and_deviation(&rest)
        && unexplained > UNSTEADY
    {
        trend.advice.push(advice(AdviceCode::Unsteady, format!(
            "The flash varies by {} from pulse to pulse without a pattern: use a power at which it is steadier, and check the sync contact and the photodiode's mount.",
            percent(unexplained)
        )));
    }
}

#[cfg(test)]
mod tests;
