//! Of the shots of a guided calibration: what is wrong with one's exposure, and what is still missing.

use super::{Kind, Role};

/// Light levels of noise and linearity that are wanted.
const LEVELS: usize = 8;
/// Frames of one light level differ by less than this factor, those of two by more: a third of a stop is 1.26.
const SAME_LIGHT: f64 = 1.1;
/// Steps of a dial that make a ladder worth having: three stops.
const STEPS: usize = 10;
/// Distances of the card, and shots at each.
const DISTANCES: usize = 3;
const SHOTS: usize = 3;
/// Distances that differ by less are one, metres.
const SAME_DISTANCE_M: f64 = 0.005;
/// Fewer lit frames say nothing of the flash's repeatability.
const FEWEST_LIT: usize = 8;

/// What counts of a shot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// As what it was shot.
    pub role: Role,
    /// Distance from the lens to the card, metres.
    pub distance_m: Option<f64>,
    /// Exposure time, seconds; relative aperture; sensitivity.
    pub dials: [Option<f64>; 3],
    /// Mean of the brightest colour, 0 at black and 1 at saturation.
    pub mean_share: Option<f64>,
    /// Share of the sites that clip, of the colour that does most.
    pub clipped_share: Option<f64>,
}

impl Kind {
    /// What is wrong with the exposure of a shot, and what to do; `None` if nothing is, or nothing is known.
    pub fn fault(self, shot: &Seen) -> Option<&'static str> {
        let (mean, clipped) = (shot.mean_share?, shot.clipped_share?);
        match (shot.role, self) {
            (Role::Dark, _) if mean > 0.005 => {
                Some("Light fell in: put the lens cap on, cover the viewfinder, and take it again.")
            }
            (Role::Blown, _) if clipped < 0.5 => {
                Some("Not over-exposed: expose it longer by two stops or more.")
            }
            // A series from dark to clipped.
            (Role::Dark | Role::Blown | Role::Room, _) | (Role::Even, Kind::Noise) => None,
            (_, _) if clipped > 0.01 => Some("Over-exposed: parts of it clip. Take it again, darker."),
            (Role::Even, _) if mean < 0.15 => {
                Some("Too dark: the middle should be at about half of saturation.")
            }
            (Role::Step, _) if mean < 0.002 => Some("Too dark to tell a step: begin the ladder brighter."),
            (Role::Card | Role::Lit | Role::Chart, _) if mean < 0.02 => {
                Some("Almost no light: check that the flash fired, or expose it brighter.")
            }
            _ => None,
        }
    }

    /// What is still missing, in sentences; empty when a fit is worth its while. Shots that are of no use are left out
    /// beforehand.
    pub fn lacks(self, shots: &[Seen]) -> Vec<String> {
        let of = |role: Role| shots.iter().filter(move |shot| shot.role == role);
        match self {
            Kind::Levels => levels(shots),
            Kind::Noise => {
                let mut lacks = noise(of(Role::Even));
                let dark = of(Role::Dark).count();
                lacks.extend(more(2, dark, "dark frame of the same ISO", "dark frames of the same ISO"));
                lacks
            }
            Kind::Exposure => exposure(of(Role::Step)),
            Kind::Flat => more(5, of(Role::Even).count(), "even frame", "even frames").into_iter().collect(),
            Kind::Flash => flash(of(Role::Card)),
            Kind::Steadiness => {
                let (lit, wanted) = (of(Role::Lit).count(), self.guide().takes[0].wanted);
                let enough = if lit >= FEWEST_LIT { "; these will do for a rough figure" } else { "" };
                let lacks = more(wanted, lit, "lit frame", "lit frames");
                lacks.map(|lacks| lacks.replace('.', &format!("{enough}."))).into_iter().collect()
            }
            Kind::Colour => more(1, of(Role::Chart).count(), "frame of the chart, lit by the flash", "")
                .into_iter()
                .collect(),
        }
    }
}

fn more(wanted: usize, there: usize, one: &str, many: &str) -> Option<String> {
    let more = if there == 0 { "" } else { "more " };
    match wanted.saturating_sub(there) {
        0 => None,
        1 => Some(format!("1 {more}{one}.")),
        n => Some(format!("{n} {more}{many}.")),
    }
}

/// Two dark frames and a blown one at every ISO that occurs.
fn levels(shots: &[Seen]) -> Vec<String> {
    let mut isos: Vec<Option<f64>> = vec![];
    for shot in shots {
        if !isos.contains(&shot.dials[2]) {
            isos.push(shot.dials[2]);
        }
    }
    if isos.is_empty() {
        isos.push(None);
    }
    let mut lacks = vec![];
    for iso in isos {
        let count = |role| shots.iter().filter(|s| s.role == role && s.dials[2] == iso).count();
        let at = iso.map_or_else(String::new, |iso| format!(" at ISO {iso}"));
        lacks.extend(more(2, count(Role::Dark), &format!("dark frame{at}"), &format!("dark frames{at}")));
        lacks.extend(more(1, count(Role::Blown), &format!("blown frame{at}"), ""));
    }
    lacks
}

/// Eight levels of light, two frames at each, the brightest clipping.
fn noise<'a>(shots: impl Iterator<Item = &'a Seen>) -> Vec<String> {
    let shots: Vec<&Seen> = shots.collect();
    let mut means: Vec<f64> = shots.iter().filter_map(|s| s.mean_share).filter(|m| *m > 0.0).collect();
    means.sort_by(f64::total_cmp);
    let lights: Vec<&[f64]> = means.chunk_by(|a, b| b / a < SAME_LIGHT).collect();
    let mut lacks: Vec<String> =
        more(LEVELS, lights.len(), "level of light, two frames", "levels of light, two frames at each")
            .into_iter()
            .collect();
    for single in lights.iter().filter(|light| light.len() == 1) {
        lacks.push(format!("1 more frame of the light with the mean {:.1} %.", 100.0 * single[0]));
    }
    if !shots.is_empty() && shots.iter().all(|s| s.clipped_share.is_some_and(|clipped| clipped < 0.001)) {
        lacks.push("Brighter levels: none clips yet.".into());
    }
    lacks
}

/// A ladder of each dial.
fn exposure<'a>(shots: impl Iterator<Item = &'a Seen>) -> Vec<String> {
    let shots: Vec<&Seen> = shots.collect();
    let mut lacks = vec![];
    for (dial, name) in ["shutter", "aperture", "ISO"].into_iter().enumerate() {
        let mut labels: Vec<f64> = shots.iter().filter_map(|s| s.dials[dial]).collect();
        labels.sort_by(f64::total_cmp);
        labels.dedup();
        match labels.len() {
            0 | 1 => lacks.push(format!("A ladder of {name}: {STEPS} steps or more.")),
            n => lacks.extend(more(STEPS, n, &format!("step of {name}"), &format!("steps of {name}"))),
        }
    }
    lacks
}

/// Three distances, three shots at each; as many shots where tags tell the distances.
fn flash<'a>(shots: impl Iterator<Item = &'a Seen>) -> Vec<String> {
    let shots: Vec<&Seen> = shots.collect();
    if shots.iter().any(|s| s.distance_m.is_none()) {
        let (one, many) = (
            "shot; the card's tags tell the distances",
            "shots, three at each of three distances, which the card's tags tell",
        );
        return more(DISTANCES * SHOTS, shots.len(), one, many).into_iter().collect();
    }
    let mut placed: Vec<f64> = shots.iter().filter_map(|s| s.distance_m).collect();
    placed.sort_by(f64::total_cmp);
    let places: Vec<&[f64]> = placed.chunk_by(|a, b| b - a < SAME_DISTANCE_M).collect();
    let mut lacks: Vec<String> =
        more(DISTANCES, places.len(), "distance, three shots", "distances, three shots at each")
            .into_iter()
            .collect();
    for place in places {
        let at = format!("with the card at {} m", place[0]);
        lacks.extend(more(SHOTS, place.len(), &format!("shot {at}"), &format!("shots {at}")));
    }
    lacks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(role: Role, mean: f64, clipped: f64) -> Seen {
        let dials = [Some(0.01), Some(8.0), Some(100.0)];
        Seen { role, distance_m: None, dials, mean_share: Some(mean), clipped_share: Some(clipped) }
    }

    #[test]
    fn a_shot_is_judged_by_what_it_is_for() {
        let fault =
            |kind: Kind, role, mean, clipped| kind.fault(&seen(role, mean, clipped)).unwrap_or("good");
        assert_eq!(fault(Kind::Levels, Role::Dark, 0.0003, 0.0), "good");
        assert!(fault(Kind::Noise, Role::Dark, 0.3, 0.0).contains("lens cap"));
        assert_eq!(fault(Kind::Levels, Role::Blown, 0.99, 1.0), "good");
        assert!(fault(Kind::Levels, Role::Blown, 0.6, 0.0).starts_with("Not over-exposed"));
        assert_eq!(fault(Kind::Noise, Role::Even, 0.99, 1.0), "good");
        assert!(fault(Kind::Flat, Role::Even, 0.9, 0.2).starts_with("Over-exposed"));
        assert!(fault(Kind::Flat, Role::Even, 0.05, 0.0).starts_with("Too dark"));
        assert_eq!(fault(Kind::Flat, Role::Even, 0.5, 0.0), "good");
        assert!(fault(Kind::Steadiness, Role::Lit, 0.001, 0.0).contains("fired"));
        assert!(fault(Kind::Colour, Role::Chart, 0.5, 0.03).starts_with("Over-exposed"));
        assert_eq!(fault(Kind::Colour, Role::Room, 0.0, 0.0), "good");
        let unknown = Seen { mean_share: None, ..seen(Role::Card, 0.0, 1.0) };
        assert_eq!(Kind::Flash.fault(&unknown), None);
    }

    #[test]
    fn what_is_missing_is_told_until_nothing_is() {
        for kind in Kind::ALL {
            assert!(!kind.lacks(&[]).is_empty(), "{kind:?}");
        }
        let (dark, blown) = (seen(Role::Dark, 0.0, 0.0), seen(Role::Blown, 1.0, 1.0));
        assert_eq!(Kind::Levels.lacks(&[]), ["2 dark frames.", "1 blown frame."]);
        let at_400 = Seen { dials: [None, None, Some(400.0)], ..blown };
        let lacks = Kind::Levels.lacks(&[dark, dark, blown, at_400]);
        assert_eq!(lacks, ["2 dark frames at ISO 400."]);
        assert!(Kind::Flat.lacks(&[seen(Role::Even, 0.5, 0.0); 5]).is_empty());

        let mut ladder: Vec<Seen> =
            (0..7).map(|k| seen(Role::Even, 0.005 * f64::from(1 << k), 0.0)).collect();
        ladder.extend(ladder.clone());
        assert_eq!(
            Kind::Noise.lacks(&ladder),
            [
                "1 more level of light, two frames.",
                "Brighter levels: none clips yet.",
                "2 dark frames of the same ISO.",
            ]
        );
        ladder.extend([seen(Role::Even, 0.64, 0.4), dark, dark]);
        assert_eq!(Kind::Noise.lacks(&ladder), ["1 more frame of the light with the mean 64.0 %."]);

        let step = |dial: usize, k: u32| {
            let mut shot = seen(Role::Step, 0.3, 0.0);
            shot.dials[dial] = Some(100.0 * 2f64.powf(f64::from(k) / 3.0));
            shot
        };
        let mut steps: Vec<Seen> = (0..9).map(|k| step(0, k)).collect();
        steps.extend((0..10).map(|k| step(2, k)));
        assert_eq!(Kind::Exposure.lacks(&steps), ["A ladder of aperture: 10 steps or more."]);

        let card = |distance: f64| Seen { distance_m: Some(distance), ..seen(Role::Card, 0.5, 0.0) };
        let shots = [0.8, 0.8, 0.8, 1.2, 1.2].map(card);
        assert_eq!(
            Kind::Flash.lacks(&shots),
            ["1 more distance, three shots.", "1 more shot with the card at 1.2 m."]
        );
        let by_tags = [seen(Role::Card, 0.5, 0.0); 9];
        assert_eq!(
            Kind::Flash.lacks(&by_tags[..2]),
            ["7 more shots, three at each of three distances, which the card's tags tell."]
        );
        let mixed = Kind::Flash.lacks(&[&shots[..3], &by_tags[..5]].concat());
        assert_eq!(mixed, ["1 more shot; the card's tags tell the distances."]);
        assert!(Kind::Flash.lacks(&by_tags).is_empty());
        let lit = [seen(Role::Lit, 0.5, 0.0); 40];
        assert_eq!(
            Kind::Steadiness.lacks(&lit[..9]),
            ["31 more lit frames; these will do for a rough figure."]
        );
        assert!(Kind::Steadiness.lacks(&lit).is_empty());
        assert_eq!(Kind::Colour.lacks(&[]), ["1 frame of the chart, lit by the flash."]);
    }
}
