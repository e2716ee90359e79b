//! Frames of one ISO, reduced to what their levels need as they come: one whole frame at most is held beside the new one.

use super::dark::{Dark, Known, ReadNoise};
use super::{BlackSource, IsoLevels, SiteLevels};
use crate::calibration::histogram::{Centre, CutOff, Histogram, WHOLE_STEP};
use crate::calibration::statistics::Z95;
use crate::codec::raw::Masked;
use crate::photometry::saturation::{self, NotBlown, Spike};
use crate::photometry::{Cfa, Mosaic};
use crate::units::Iso;

/// The filter positions, row and column.
pub(super) const POSITIONS: [(usize, usize); 4] = [(0, 0), (0, 1), (1, 0), (1, 1)];
/// Values that a site can have.
pub(super) const VALUES: usize = 1 << 16;
/// Share of the range from black to saturation below which a frame's median must lie to be dark.
const DARK: f64 = 0.05;

/// Why a frame does not tell levels.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnfitFrame {
    /// Light fell on it.
    #[error(
        "it is not dark: half of its {colour} sites lie above {median:.0} DN, where black is about {black:.0}; put the lens cap on, cover the viewfinder, and shoot again"
    )]
    NotDark {
        /// Colour of the filter position.
        colour: &'static str,
        /// Its median, DN.
        median: f64,
        /// Black as the file or the decoder's table has it, DN.
        black: f64,
    },
    /// Dark frames that cannot be laid over each other.
    #[error(
        "it is {got:?} sites but the dark frames before it are {expected:?}; give full frames of one size"
    )]
    Size {
        /// Width and height.
        got: (usize, usize),
        /// Of the first dark frame.
        expected: (usize, usize),
    },
    /// No position clips.
    #[error(transparent)]
    NotBlown(NotBlown),
}

/// Histograms of the four positions.
pub(super) type Four = [Histogram; 4];

/// What the frames of one ISO amount to.
pub struct IsoSums {
    iso: Iso,
    cfa: Cfa,
    dark: Option<Dark>,
    masked: [MaskedSums; 4],
    blown: usize,
    spikes: [Option<Spike>; 4],
    /// What the brightest of the frames that do not blow a position shows.
    not_reached: [Option<NotBlown>; 4],
}

/// Weighted sums over masked borders.
#[derive(Clone, Copy, Default)]
struct MaskedSums {
    sites: f64,
    sum: f64,
    /// Of the squares of the single frames' standard errors, times their sites squared.
    variance: f64,
}

pub(super) fn four(base: i32, values: usize) -> Four {
    std::array::from_fn(|_| Histogram::new(base, values))
}

fn colour(cfa: Cfa, position: usize) -> &'static str {
    let (row, column) = POSITIONS[position];
    ["red", "green", "blue"][usize::from(cfa.0[row][column]).min(2)]
}

impl IsoSums {
    /// Nothing yet; `cfa` is the frames' filter array.
    pub fn new(iso: Iso, cfa: Cfa) -> Self {
        Self {
            iso,
            cfa,
            dark: None,
            masked: [MaskedSums::default(); 4],
            blown: 0,
            spikes: [None; 4],
            not_reached: [const { None }; 4],
        }
    }

    /// ISO label of the frames.
    pub fn iso(&self) -> Iso {
        self.iso
    }

    /// Whether any frame was fit to be added.
    pub fn is_measured(&self) -> bool {
        self.dark.is_some() || self.blown > 0
    }

    /// Lets go of what is held for frames to come, should none be expected. They may come still.
    pub fn let_go(&mut self) {
        if let Some(dark) = &mut self.dark {
            dark.let_go();
        }
    }

    /// Adds the masked border of a frame, dark or blown.
    pub fn add_masked(&mut self, masked: &Masked) {
        for (sums, (row, column)) in self.masked.iter_mut().zip(POSITIONS) {
            let sites = masked.sites[row][column] as f64;
            sums.sites += sites;
            sums.sum += sites * f64::from(masked.mean[row][column]);
            sums.variance += sites * f64::from(masked.standard_deviation[row][column]).powi(2);
        }
    }

    /// Adds a dark frame.
    pub fn add_dark(&mut self, frame: &Mosaic) -> Result<(), UnfitFrame> {
        let got = (frame.dn.width(), frame.dn.height());
        if let Some(expected) = self.dark.as_ref().map(Dark::size).filter(|expected| *expected != got) {
            return Err(UnfitFrame::Size { got, expected });
        }
        let mut values = four(0, VALUES);
        for (y, line) in frame.dn.pixels().chunks_exact(frame.dn.width().max(1)).enumerate() {
            for (x, &dn) in line.iter().enumerate() {
                values[2 * (y & 1) + (x & 1)].add(dn.into());
            }
        }
        let mut means = [0.0; 4];
        for (position, (row, column)) in POSITIONS.into_iter().enumerate() {
            let Some(centre) = values[position].centre() else { continue };
            let black = f64::from(frame.levels.black[row][column]);
            let range = f64::from(frame.levels.saturation[row][column]) - black;
            if centre.mean > black + DARK * range {
                let colour = colour(self.cfa, position);
                return Err(UnfitFrame::NotDark { colour, median: centre.mean, black });
            }
            means[position] = centre.mean;
        }
        let dark = self.dark.get_or_insert_with(|| Dark::new(&frame.dn));
        dark.add(&frame.dn, &values, means);
        Ok(())
    }

    /// Adds a blown frame; an error if no position clips in it. Of several, the lowest values count.
    pub fn add_blown(&mut self, frame: &Mosaic) -> Result<(), UnfitFrame> {
        let mut refused = None;
        let mut any = false;
        for (position, found) in saturation::measure(frame).concat().into_iter().enumerate() {
            match (found, &mut self.spikes[position]) {
                (Ok(found), Some(spike)) => {
                    spike.level = spike.level.min(found.level);
                    spike.clipped_from = spike.clipped_from.min(found.clipped_from);
                    any = true;
                }
                (Ok(found), empty) => {
                    *empty = Some(found);
                    any = true;
                }
                (Err(why), _) => {
                    if self.not_reached[position].as_ref().is_none_or(|old| maximum(&why) > maximum(old)) {
                        self.not_reached[position] = Some(why.clone());
                    }
                    refused.get_or_insert(why);
                }
            }
        }
        match refused {
            Some(why) if !any => Err(UnfitFrame::NotBlown(why)),
            _ => {
                self.blown += 1;
                Ok(())
            }
        }
    }

    /// The levels that come of it.
    pub fn levels(&self) -> IsoLevels {
        let dark: Option<[Option<Centre>; 4]> = self.dark.as_ref().map(Dark::centres);
        let cuts: [Option<CutOff>; 4] = self.dark.as_ref().map(Dark::cut_offs).unwrap_or_default();
        let masked = self.masked.map(|sums| sums.black());
        let black_source = match (&dark, masked[0]) {
            (Some(_), _) => Some(BlackSource::DarkFrames),
            (None, Some(_)) => Some(BlackSource::MaskedPixels),
            (None, None) => None,
        };
        let site = |position: usize| {
            let (row, column) = POSITIONS[position];
            let own = self.dark.as_ref().zip(dark).and_then(|(sums, centres)| {
                Some(sums.black(position, centres[position]?, cuts[position].is_some()))
            });
            let black = own.or(masked[position]);
            // Black is there or below, and nothing tells where.
            let bounded = black.filter(|_| !cuts[position].is_some_and(CutOff::hides_black));
            let step = self.dark.as_ref().map_or(1.0, |sums| sums.steps(position).low);
            let (noise, below) = match self.dark.as_ref().and_then(|sums| sums.read_noise(position)) {
                Some(ReadNoise::Told(noise)) => (Some(noise), None),
                Some(ReadNoise::Below(bound)) => (None, Some(bound)),
                None => (None, None),
            };
            let spike = self.spikes[position];
            let not_reached = self.not_reached[position].as_ref().filter(|_| spike.is_none());
            SiteLevels {
                row,
                column,
                colour: colour(self.cfa, position).to_owned(),
                black_dn: black.map(|b| b.value),
                black_dn_standard_error: bounded.map(|b| b.error),
                black_dn_interval_95: bounded.map(|b| b.interval),
                cut_off_dn: cuts[position].map(|cut| cut.dn),
                cut_off_share: cuts[position].map(|cut| cut.share),
                step_dn: (step > WHOLE_STEP).then_some(step),
                masked_black_dn: masked[position].map(|m| m.value),
                masked_black_dn_standard_error: masked[position].map(|m| m.error),
                read_noise_dn: noise.map(|n| n.value),
                read_noise_dn_standard_error: noise.map(|n| n.error),
                read_noise_dn_interval_95: noise.map(|n| n.interval),
                read_noise_below_dn: below,
                saturation_dn: spike.map(|s| s.level.into()),
                clipped_from_dn: spike.map(|s| s.clipped_from.into()),
                not_reached: not_reached.map(ToString::to_string),
            }
        };
        IsoLevels {
            iso: self.iso,
            dark_frames: self.dark.as_ref().map_or(0, Dark::frames),
            blown_frames: self.blown,
            black_source,
            hot_sites: self.dark.as_ref().zip(dark).map(|(sums, centres)| sums.hot(&centres)),
            sites: (0..4).map(site).collect(),
        }
    }

    /// How often each value occurs in the dark frames, as a share of the position's sites in percent, within six
    /// standard deviations of black; by position. Empty without dark frames.
    pub fn dark_histograms(&self) -> Vec<Vec<(f64, f64)>> {
        let Some(dark) = &self.dark else { return vec![] };
        let near = |histogram: &Histogram| {
            let Some(centre) = histogram.centre() else { return vec![] };
            let reach = 6.0 * centre.variance.sqrt().max(0.5);
            let near = histogram.occurring().filter(|(dn, _)| (dn - centre.mean).abs() <= reach);
            near.map(|(dn, n)| (dn, 100.0 * n as f64 / centre.count as f64)).collect()
        };
        dark.values().iter().map(near).collect()
    }
}

/// The value that a position reaches which is not blown, DN.
fn maximum(why: &NotBlown) -> u16 {
    match why {
        NotBlown::NoSpike { maximum, .. } | NotBlown::Dark { maximum, .. } => *maximum,
    }
}

impl MaskedSums {
    /// Black as the border has it.
    fn black(self) -> Option<Known> {
        (self.sites > 0.0).then(|| {
            let (value, error) = (self.sum / self.sites, self.variance.sqrt() / self.sites);
            Known { value, error, interval: [value - Z95 * error, value + Z95 * error] }
        })
    }
}
