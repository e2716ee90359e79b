//! Which setting moves: ladders found in a heap of shots by their labels alone.

use crate::pair::Settings;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Fewest labels that make a ladder.
const FEWEST: usize = 3;

/// A setting of the exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Setting {
    /// Sensitivity; labels are ISO numbers.
    Iso,
    /// Exposure time; labels are seconds.
    Shutter,
    /// Relative aperture; labels are f-numbers.
    Aperture,
}

impl Setting {
    /// In the order of the thesis's tables.
    pub const ALL: [Self; 3] = [Self::Iso, Self::Shutter, Self::Aperture];

    /// Its label in a file; `None` if it does not tell.
    pub fn label(self, settings: &Settings) -> Option<f64> {
        match self {
            Self::Iso => settings.iso.map(|v| v.0),
            Self::Shutter => settings.shutter.map(|v| v.0),
            Self::Aperture => settings.aperture.map(|v| v.0),
        }
    }

    /// Stops of light that a label stands for; more is brighter.
    pub fn stops(self, label: f64) -> f64 {
        match self {
            Self::Iso => Nominal.gain(Iso(label)).log2(),
            Self::Shutter => Nominal.time(Seconds(label)).log2(),
            Self::Aperture => Nominal.aperture(FNumber(label)).log2(),
        }
    }

    /// A label as people write it.
    pub fn words(self, label: f64) -> String {
        match self {
            Self::Iso => Iso(label).to_string(),
            Self::Shutter => Seconds(label).to_string(),
            Self::Aperture => FNumber(label).to_string(),
        }
    }

    /// Its name as people write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Iso => "ISO",
            Self::Shutter => "shutter",
            Self::Aperture => "aperture",
        }
    }
}

/// Labels of one step are the same, however they are rounded: stops to the millionth.
pub(super) fn key(setting: Setting, label: f64) -> i64 {
    (setting.stops(label) * 1e6).round() as i64
}

/// A ladder: the setting that moves, and the shots' numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Found {
    pub(super) setting: Setting,
    pub(super) shots: Vec<usize>,
}

type Labels = [Option<i64>; 3];

/// The ladders among shots given in the order in which they were taken. A ladder is three labels or more of one setting
/// that share the other two. Where ladders cross, a shot fits several by its labels, but light may have been set anew
/// between them: it belongs to the ladder of its neighbours in the order; between two ladders, to the one that lacks
/// its step otherwise, else to both; without neighbours that tell, to all.
pub(super) fn find(shots: &[Settings]) -> Vec<Found> {
    let labels: Vec<Labels> =
        shots.iter().map(|s| Setting::ALL.map(|setting| setting.label(s).map(|l| key(setting, l)))).collect();
    let mut groups: BTreeMap<(usize, Labels), Vec<usize>> = BTreeMap::new();
    for (shot, own) in labels.iter().enumerate() {
        for moving in (0..3).filter(|&m| own[m].is_some()) {
            let mut shared = *own;
            shared[moving] = None;
            groups.entry((moving, shared)).or_default().push(shot);
        }
    }
    let steps = |moving: usize, shots: &[usize]| {
        shots.iter().filter_map(|&s| labels[s][moving]).collect::<BTreeSet<_>>().len()
    };
    let groups: Vec<(usize, Vec<usize>)> = groups
        .into_iter()
        .map(|((moving, _), shots)| (moving, shots))
        .filter(|(moving, shots)| steps(*moving, shots) >= FEWEST)
        .collect();
    let fitting = |s: usize| (0..groups.len()).filter(|&g| groups[g].1.contains(&s)).collect::<Vec<_>>();
    let mut owners: Vec<Vec<usize>> = (0..shots.len()).map(fitting).collect();
    let sole: Vec<Option<usize>> =
        owners.iter().map(|o| if o.len() == 1 { Some(o[0]) } else { None }).collect();
    let mut between = vec![];
    for shot in (0..shots.len()).filter(|&s| owners[s].len() > 1).collect::<Vec<_>>() {
        let fits = |g: &usize| owners[shot].contains(g);
        let before = sole[..shot].iter().rev().flatten().next().copied().filter(fits);
        let after = sole[shot + 1..].iter().flatten().next().copied().filter(fits);
        match (before, after) {
            (Some(a), Some(b)) if a != b => between.push((shot, [a, b])),
            (Some(g), _) | (None, Some(g)) => owners[shot] = vec![g],
            (None, None) => {}
        }
    }
    for (shot, sides) in between {
        let step = |s: usize, g: usize| labels[s][groups[g].0];
        let has = |g: &usize| {
            (0..shots.len())
                .any(|other| other != shot && owners[other] == [*g] && step(other, *g) == step(shot, *g))
        };
        let lacking: Vec<usize> = sides.into_iter().filter(|g| !has(g)).collect();
        owners[shot] = if lacking.is_empty() { sides.to_vec() } else { lacking };
    }
    let own = |g: usize| (0..shots.len()).filter(|&s| owners[s].contains(&g)).collect::<Vec<_>>();
    let all = groups.iter().enumerate().map(|(g, (moving, _))| (*moving, own(g)));
    all.filter(|(moving, shots)| steps(*moving, shots) >= FEWEST)
        .map(|(moving, shots)| Found { setting: Setting::ALL[moving], shots })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shot(iso: f64, shutter: f64, aperture: f64) -> Settings {
        Settings {
            iso: Some(Iso(iso)),
            shutter: Some(Seconds(1.0 / shutter)),
            aperture: Some(FNumber(aperture)),
            ..Settings::default()
        }
    }

    fn cross() -> Vec<Settings> {
        let apertures = [22.0, 20.0, 18.0, 16.0, 14.0].map(|n| shot(400.0, 60.0, n));
        let isos = [200.0, 250.0, 320.0, 400.0, 500.0].map(|iso| shot(iso, 60.0, 16.0));
        let shutters = [100.0, 80.0, 60.0, 50.0].map(|t| shot(400.0, t, 16.0));
        [apertures.to_vec(), isos.to_vec(), shutters.to_vec()].concat()
    }

    #[test]
    fn three_ladders_that_cross_are_taken_apart_by_their_order() {
        let found = find(&cross());
        let expected = [
            (Setting::Iso, (5..10).collect::<Vec<_>>()),
            (Setting::Shutter, (10..14).collect()),
            (Setting::Aperture, (0..5).collect()),
        ];
        assert_eq!(found, expected.map(|(setting, shots)| Found { setting, shots }));
    }

    #[test]
    fn a_shot_between_two_ladders_goes_where_its_step_is_lacking() {
        let mut shots = cross();
        // The shutter's ladder now begins with the shot that all three share.
        let shared = shots.remove(12);
        shots.insert(10, shared);
        let found = find(&shots);
        assert_eq!(found[0].shots, (5..10).collect::<Vec<_>>());
        assert_eq!(found[1].shots, (10..14).collect::<Vec<_>>());
        // The only one of its labels: in both of the ladders beside it.
        let shots = [
            [200.0, 250.0, 320.0].map(|iso| shot(iso, 60.0, 16.0)).to_vec(),
            vec![shot(400.0, 60.0, 16.0)],
            [50.0, 40.0].map(|t| shot(400.0, t, 16.0)).to_vec(),
        ]
        .concat();
        let found = find(&shots);
        assert_eq!(
            found.iter().map(|f| f.shots.as_slice()).collect::<Vec<_>>(),
            [&[0, 1, 2, 3][..], &[3, 4, 5]]
        );
    }

    #[test]
    fn two_labels_are_no_ladder_and_true_values_are_the_labels_they_stand_for() {
        assert_eq!(find(&[shot(100.0, 60.0, 8.0), shot(200.0, 60.0, 8.0)]), []);
        let found = find(&[shot(100.0, 60.0, 8.0), shot(100.0, 128.0, 8.0), shot(100.0, 30.0, 8.0)]);
        assert_eq!(found.len(), 1);
        assert_eq!(key(Setting::Shutter, 1.0 / 125.0), key(Setting::Shutter, 1.0 / 128.0));
        let untold = Settings { aperture: None, ..shot(100.0, 60.0, 8.0) };
        assert_eq!(find(&[untold.clone(), untold.clone(), untold]), []);
    }
}
