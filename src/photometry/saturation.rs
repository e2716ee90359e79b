//! Where each body clips: a table per body, ISO and filter position, because decoders' own tables are often
//! wrong and files seldom tell.
//!
//! [`SaturationTable::built_in`] has published measurements (`saturation.json`); [`super::levels`] says when they
//! count. [`measure`] finds saturation in a deliberately blown frame: clipped sites pile up in one spike of the
//! histogram.

use super::Mosaic;
use crate::units::Iso;
use serde::{Deserialize, Serialize};

/// DN below the spike's foot from which a site counts as clipped: read noise behind the clipping amplifier.
const BELOW_SPIKE: usize = 2;
/// Least share of a position's sites that must lie in the spike.
const LEAST_SPIKE: f64 = 0.01;
/// Half width of the spike, DN; the amplifier's noise after clipping and column offsets are some DN.
const SPIKE_REACH: usize = 24;
/// The spike stands this many times above the mean of the values between a tenth below it and its foot.
const PROMINENCE: f64 = 20.0;
/// Least share of the range of 2^bits at which a spike can be saturation: lower ones are dark or flat frames.
const LEAST_LEVEL: f32 = 0.15;

/// One body's saturation at some ISOs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Camera model as EXIF gives it, with or without the maker's name.
    pub model: String,
    /// ISO labels; none for all ISOs that have no entry of their own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub isos: Vec<f64>,
    /// DN from which a site is clipped, by filter position from the active area's first site.
    pub saturation: [[f32; 2]; 2],
    /// Where the figure is from, in words.
    pub origin: String,
}

/// Saturation of bodies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SaturationTable {
    /// Entries; the first that fits counts.
    pub entries: Vec<Entry>,
}

impl SaturationTable {
    /// Published measurements that come with the program.
    pub fn built_in() -> &'static SaturationTable {
        static TABLE: std::sync::LazyLock<SaturationTable> = std::sync::LazyLock::new(|| {
            // Read by a test, so that a wrong file never leaves the house; an empty table would only mean the next
            // source.
            serde_json::from_str(include_str!("saturation.json")).unwrap_or_default()
        });
        &TABLE
    }

    /// Saturation of a body at an ISO: its own entry, else the body's for any ISO.
    pub fn find(&self, model: &str, iso: Option<Iso>) -> Option<&Entry> {
        let of_body = || self.entries.iter().filter(|entry| same_model(&entry.model, model));
        let at =
            |entry: &&Entry| iso.is_some_and(|iso| entry.isos.iter().any(|e| (e / iso.0 - 1.0).abs() < 0.01));
        of_body().find(at).or_else(|| of_body().find(|entry| entry.isos.is_empty()))
    }
}

/// Models are the same with or without the maker before them ("Canon EOS 5DS", "EOS 5DS").
pub(super) fn same_model(a: &str, b: &str) -> bool {
    let plain = |name: &str| {
        let name = name.trim().to_lowercase();
        name.strip_prefix("canon ").map_or(name.clone(), str::to_owned)
    };
    plain(a) == plain(b)
}

/// A frame from which no saturation can be measured.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotBlown {
    /// No spike of clipped sites.
    #[error(
        "the {colour} sites are not blown: their brightest value {maximum} is no spike ({share:.2} % of them lie there, {needed:.0} % and a gap below are needed); over-expose a bright, even surface by three stops or more, with the same ISO"
    )]
    NoSpike {
        /// Colour of the filter position.
        colour: &'static str,
        /// Its largest value, DN.
        maximum: u16,
        /// Sites in the would-be spike, percent.
        share: f64,
        /// Sites needed, percent.
        needed: f64,
    },
    /// The spike lies too low.
    #[error(
        "the {colour} sites pile up at {maximum} DN, too close to black to be saturation; over-expose a bright surface, not a dark one"
    )]
    Dark {
        /// Colour of the filter position.
        colour: &'static str,
        /// Where the sites pile up, DN.
        maximum: u16,
    },
}

/// Where the sites of one filter position pile up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spike {
    /// The value that most clipped sites have, DN: the saturation.
    pub level: f32,
    /// DN from which a site counts as clipped: the spike's foot less its noise.
    pub clipped_from: f32,
}

/// Saturation by filter position of a deliberately blown frame, or why a position does not tell it: a lamp seldom blows
/// all colours at once.
pub fn measure(mosaic: &Mosaic) -> [[Result<Spike, NotBlown>; 2]; 2] {
    let at = |row: usize, column: usize| {
        let colour = ["red", "green", "blue"][usize::from(mosaic.cfa.0[row][column]).min(2)];
        let spike = spike(&histogram(mosaic, row, column), colour)?;
        // A 12-bit body's saturation is at 4095 at most, a 14-bit one's at 16383.
        if spike.level - mosaic.levels.black[row][column] < LEAST_LEVEL * 4096.0 {
            return Err(NotBlown::Dark { colour, maximum: spike.level as u16 });
        }
        Ok(spike)
    };
    [0, 1].map(|row| [0, 1].map(|column| at(row, column)))
}

fn histogram(mosaic: &Mosaic, row: usize, column: usize) -> Vec<u64> {
    let mut counts = vec![0u64; 1 << 16];
    let width = mosaic.dn.width().max(1);
    for line in mosaic.dn.pixels().chunks_exact(width).skip(row).step_by(2) {
        for &dn in line.iter().skip(column).step_by(2) {
            counts[usize::from(dn)] += 1;
        }
    }
    counts
}

/// The spike is the fullest bin near the top; its foot is where it falls below a thousandth of its height.
fn spike(counts: &[u64], colour: &'static str) -> Result<Spike, NotBlown> {
    let sites: u64 = counts.iter().sum();
    let maximum = counts.iter().rposition(|&n| n > 0).unwrap_or(0);
    // Hot sites may lie above the spike: up to a ten-thousandth of all.
    let mut above = 0;
    let top = (0..=maximum).rev().find(|&dn| {
        above += counts[dn];
        above * 10_000 > sites
    });
    let top = top.unwrap_or(maximum);
    let from = top.saturating_sub(2 * SPIKE_REACH);
    let peak = (from..=top).max_by_key(|&dn| counts[dn]).unwrap_or(top);
    let foot = (peak.saturating_sub(SPIKE_REACH)..=peak)
        .rev()
        .take_while(|&dn| counts[dn] * 1000 >= counts[peak].max(1))
        .last()
        .unwrap_or(peak);
    let held: u64 = counts[foot..].iter().sum();
    let share = held as f64 / sites.max(1) as f64;
    let end = foot.saturating_sub(1);
    let below = (foot - foot / 10).min(end)..end;
    let beside = counts[below.clone()].iter().sum::<u64>() as f64 / below.len().max(1) as f64;
    let height = held as f64 / (top + 1).saturating_sub(foot).max(1) as f64;
    if share < LEAST_SPIKE || height < PROMINENCE * beside {
        let maximum = u16::try_from(maximum).unwrap_or(u16::MAX);
        return Err(NotBlown::NoSpike { colour, maximum, share: 100.0 * share, needed: 100.0 * LEAST_SPIKE });
    }
    Ok(Spike { level: peak as f32, clipped_from: foot.saturating_sub(BELOW_SPIKE) as f32 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};
    use crate::raster::Image;
    use crate::units::Iso;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    fn frame(source: LevelSource) -> Mosaic {
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[14466.0; 2]; 2],
            black_source: LevelSource::MaskedPixels,
            saturation_source: source,
        };
        Mosaic { dn: Image::filled(4, 4, 3000), cfa: Cfa::RGGB, levels }
    }

    /// A ramp of light that passes saturation (by position) for `blown` of the columns.
    fn ramp(blown: f64, clips: [[f64; 2]; 2]) -> Mosaic {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut noise = |sd: f64| Normal::new(0.0, sd).unwrap().sample(&mut random);
        let dn = Image::from_fn(600, 200, |x, y| {
            let clip = clips[y & 1][x & 1];
            let light = 2048.0 + (clip - 2048.0) * (x as f64 / 600.0) / (1.0 - blown);
            let dn = (light + noise(12.0)).min(clip) + noise(0.6);
            dn.round() as u16
        });
        Mosaic { dn, ..frame(LevelSource::DecoderTable) }
    }

    #[test]
    fn the_built_in_table_is_read_and_finds_bodies_by_iso() {
        let table = SaturationTable::built_in();
        assert!(!table.entries.is_empty() && table.entries.iter().all(|e| !e.origin.is_empty()));
        let at = |model: &str, iso: f64| table.find(model, Some(Iso(iso))).map(|e| e.saturation[1][0]);
        assert_eq!(at("Canon EOS 5DS", 100.0), Some(14733.0));
        assert_eq!(at("EOS 5DS", 1000.0), Some(15383.0));
        assert_eq!(at("Canon EOS 5DS R", 400.0), Some(15181.0));
        assert_eq!(at("Canon EOS 6D", 125.0), Some(13225.0));
        assert_eq!(at("Canon EOS 6D", 2500.0), Some(13225.0));
        assert_eq!(at("Canon EOS 6D", 200.0), None);
        assert_eq!(at("Canon EOS 5DS", 400.0), None);
    }

    #[test]
    fn a_blown_frame_tells_the_saturation_of_each_position() {
        let clips = [[14733.0, 14600.0], [14610.0, 14733.0]];
        for (found, clip) in measure(&ramp(0.3, clips)).concat().into_iter().zip(clips.concat()) {
            let (found, clip) = (found.unwrap(), clip as f32);
            assert!((found.level - clip).abs() <= 1.0, "{found:?} for {clip}");
            assert!((clip - 9.0..=clip).contains(&found.clipped_from), "{found:?} for {clip}");
        }
    }

    #[test]
    fn a_colour_that_never_clips_does_not_hide_the_others() {
        let red_never = [[60_000.0, 14_600.0], [14_610.0, 14_733.0]];
        let mut frame = ramp(0.3, red_never);
        let red = ramp(0.0, [[14_733.0; 2]; 2]);
        frame.dn = Image::from_fn(600, 200, |x, y| {
            *if x & 1 == 0 && y & 1 == 0 { &red } else { &frame }.dn.at(x, y)
        });
        let [[red, green], [_, blue]] = measure(&frame);
        assert!(matches!(red, Err(NotBlown::NoSpike { colour: "red", .. })), "{red:?}");
        assert!(green.is_ok() && blue.is_ok());
    }

    #[test]
    fn a_frame_that_is_not_blown_is_refused_in_words() {
        // A ramp that ends below saturation, an even grey card, a dark frame.
        let below = Mosaic {
            dn: ramp(0.3, [[60_000.0; 2]; 2]).dn.map(|v| (*v).min(20_000) / 2),
            ..ramp(0.0, [[1e4; 2]; 2])
        };
        let first = |frame: &Mosaic| measure(frame).concat().remove(0);
        assert!(first(&below).is_ok(), "cut at 10000, it is a spike");
        let ramp = ramp(0.0, [[14_733.0; 2]; 2]);
        assert!(matches!(first(&ramp), Err(NotBlown::NoSpike { .. })), "{:?}", first(&ramp));
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut grey = |mean: f64, sd: f64| {
            let dn = Image::from_fn(600, 200, |_, _| {
                Normal::new(mean, sd).unwrap().sample(&mut random).round() as u16
            });
            Mosaic { dn, ..frame(LevelSource::DecoderTable) }
        };
        let error = first(&grey(9000.0, 60.0)).unwrap_err();
        assert!(error.to_string().contains("not blown"), "{error}");
        assert!(first(&grey(2048.0, 2.0)).is_err());
    }
}
