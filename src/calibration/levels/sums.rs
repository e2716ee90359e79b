//! Frames of one ISO, reduced to what their levels need as they come: never more than two whole frames are held.

use super::histogram::{Centre, Histogram};
use super::{BlackSource, IsoLevels, SiteLevels};
use crate::codec::raw::Masked;
use crate::photometry::saturation::{self, NotBlown, Spike};
use crate::photometry::{Cfa, Mosaic};
use crate::raster::Image;
use crate::units::Iso;

/// The filter positions, row and column.
const POSITIONS: [(usize, usize); 4] = [(0, 0), (0, 1), (1, 0), (1, 1)];
/// Values that a site can have.
const VALUES: usize = 1 << 16;
/// Standard deviations above the median from which a site is hot: of pure noise, not one in 10^15 sites.
const HOT: f64 = 8.0;
/// Share of the range from black to saturation below which a frame's median must lie to be dark.
const DARK: f64 = 0.05;
/// Variance of rounding to whole DN, DN^2.
const ROUNDING: f64 = 1.0 / 12.0;

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
type Four = [Histogram; 4];

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

/// Sums over dark frames.
struct Dark {
    frames: usize,
    values: Four,
    /// Each frame's own means.
    means: Vec<[f64; 4]>,
    /// Least value of every site.
    lowest: Image<u16>,
    /// A frame that waits for its partner.
    held: Option<Image<u16>>,
    pairs: usize,
    differences: Four,
}

/// Weighted sums over masked borders.
#[derive(Clone, Copy, Default)]
struct MaskedSums {
    sites: f64,
    sum: f64,
    /// Of the squares of the single frames' standard errors, times their sites squared.
    variance: f64,
}

fn four(base: i32, values: usize) -> Four {
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
        let size = |image: &Image<u16>| (image.width(), image.height());
        if let Some(dark) = &self.dark
            && size(&dark.lowest) != size(&frame.dn)
        {
            return Err(UnfitFrame::Size { got: size(&frame.dn), expected: size(&dark.lowest) });
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
        let dark = self.dark.get_or_insert_with(|| Dark {
            frames: 0,
            values: four(0, VALUES),
            means: vec![],
            lowest: frame.dn.clone(),
            held: None,
            pairs: 0,
            differences: four(-(VALUES as i32), 2 * VALUES),
        });
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
        let dark: Option<[Option<Centre>; 4]> =
            self.dark.as_ref().map(|dark| std::array::from_fn(|p| dark.values[p].centre()));
        let masked = self.masked.map(|sums| sums.black());
        let black_source = match (&dark, masked[0]) {
            (Some(_), _) => Some(BlackSource::DarkFrames),
            (None, Some(_)) => Some(BlackSource::MaskedPixels),
            (None, None) => None,
        };
        let site = |position: usize| {
            let (row, column) = POSITIONS[position];
            let own = self.dark.as_ref().zip(dark).and_then(|(sums, centres)| {
                let centre = centres[position]?;
                Some((centre.mean, sums.error(position, centre)))
            });
            let black = own.or(masked[position]);
            let noise = self.dark.as_ref().and_then(|sums| sums.read_noise(position));
            let spike = self.spikes[position];
            let not_reached = self.not_reached[position].as_ref().filter(|_| spike.is_none());
            SiteLevels {
                row,
                column,
                colour: colour(self.cfa, position).to_owned(),
                black_dn: black.map(|b| b.0),
                black_error_dn: black.map(|b| b.1),
                masked_black_dn: masked[position].map(|m| m.0),
                masked_black_error_dn: masked[position].map(|m| m.1),
                read_noise_dn: noise.map(|n| n.0),
                read_noise_error_dn: noise.map(|n| n.1),
                saturation_dn: spike.map(|s| s.level.into()),
                clipped_from_dn: spike.map(|s| s.clipped_from.into()),
                not_reached: not_reached.map(ToString::to_string),
            }
        };
        IsoLevels {
            iso: self.iso,
            dark_frames: self.dark.as_ref().map_or(0, |dark| dark.frames),
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
        dark.values.iter().map(near).collect()
    }
}

/// The value that a position reaches which is not blown, DN.
fn maximum(why: &NotBlown) -> u16 {
    match why {
        NotBlown::NoSpike { maximum, .. } | NotBlown::Dark { maximum, .. } => *maximum,
    }
}

impl MaskedSums {
    /// Black and its standard error.
    fn black(self) -> Option<(f64, f64)> {
        (self.sites > 0.0).then(|| (self.sum / self.sites, self.variance.sqrt() / self.sites))
    }
}

impl Dark {
    fn add(&mut self, frame: &Image<u16>, values: &Four, means: [f64; 4]) {
        self.frames += 1;
        self.means.push(means);
        for (sums, values) in self.values.iter_mut().zip(values) {
            sums.merge(values);
        }
        for (lowest, &dn) in self.lowest.pixels_mut().iter_mut().zip(frame.pixels()) {
            *lowest = dn.min(*lowest);
        }
        let Some(first) = self.held.take() else {
            self.held = Some(frame.clone());
            return;
        };
        self.pairs += 1;
        let width = frame.width().max(1);
        let lines = first.pixels().chunks_exact(width).zip(frame.pixels().chunks_exact(width));
        for (y, (first, second)) in lines.enumerate() {
            for (x, (&a, &b)) in first.iter().zip(second).enumerate() {
                self.differences[2 * (y & 1) + (x & 1)].add(i32::from(a) - i32::from(b));
            }
        }
    }

    /// Standard error of black: as sites scatter, or as whole frames do, whichever is larger.
    fn error(&self, position: usize, centre: Centre) -> f64 {
        let of_sites = centre.variance / centre.count as f64;
        let n = self.frames as f64;
        let mean = self.means.iter().map(|m| m[position]).sum::<f64>() / n;
        let squares: f64 = self.means.iter().map(|m| (m[position] - mean).powi(2)).sum();
        let of_frames = if self.frames > 1 { squares / (n - 1.0) / n } else { 0.0 };
        of_sites.max(of_frames).sqrt()
    }

    /// Standard deviation of one frame's site and its standard error, DN; `None` without a pair of frames.
    fn read_noise(&self, position: usize) -> Option<(f64, f64)> {
        if self.pairs == 0 {
            return None;
        }
        let centre = self.differences[position].centre()?;
        let variance = 0.5 * centre.variance - ROUNDING;
        // Less noise than rounding leaves nothing to tell.
        let noise = Some(variance).filter(|v| *v > 0.0)?.sqrt();
        let error_of_variance = 0.5 * centre.variance * (2.0 / (centre.count as f64 - 1.0).max(1.0)).sqrt();
        Some((noise, 0.5 * error_of_variance / noise))
    }

    fn hot(&self, centres: &[Option<Centre>; 4]) -> u64 {
        let limits = centres.map(|c| c.map_or(f64::INFINITY, |c| c.mean + HOT * c.variance.sqrt().max(0.5)));
        let mut hot = 0;
        for (y, line) in self.lowest.pixels().chunks_exact(self.lowest.width().max(1)).enumerate() {
            for (x, &dn) in line.iter().enumerate() {
                hot += u64::from(f64::from(dn) > limits[2 * (y & 1) + (x & 1)]);
            }
        }
        hot
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{LevelsFit, Rig};
    use crate::photometry::{LevelSource, Levels};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    const BLACK: [f64; 4] = [2047.2, 2048.0, 2048.4, 2049.1];

    fn frame(dn: Image<u16>) -> Mosaic {
        let levels = Levels {
            black: [[2000.0; 2]; 2],
            saturation: [[15_000.0; 2]; 2],
            black_source: LevelSource::DecoderTable,
            saturation_source: LevelSource::DecoderTable,
        };
        Mosaic { dn, cfa: Cfa::RGGB, levels }
    }

    /// A dark frame: read noise, three hot sites of which one flickers.
    fn dark(random: &mut ChaCha8Rng, noise: f64, index: usize) -> Mosaic {
        let normal = Normal::new(0.0, noise).unwrap();
        let mut dn = Image::from_fn(160, 120, |x, y| {
            (BLACK[2 * (y & 1) + (x & 1)] + normal.sample(random)).round() as u16
        });
        *dn.at_mut(10, 10) = 9000;
        *dn.at_mut(31, 7) = 2400;
        if index == 0 {
            *dn.at_mut(80, 81) = 5000;
        }
        frame(dn)
    }

    #[test]
    fn black_and_read_noise_of_random_sensors_lie_within_their_errors() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let (mut black, mut noise, mut all) = (0, 0, 0);
        for rig in 0..40 {
            let truth = 0.8 + 0.2 * f64::from(rig);
            let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
            (0..2).for_each(|i| sums.add_dark(&dark(&mut random, truth, i)).unwrap());
            let levels = sums.levels();
            assert_eq!(levels.hot_sites, Some(2));
            for (site, truth_black) in levels.sites.iter().zip(BLACK) {
                let off = |value: Option<f64>, error: Option<f64>, truth: f64| {
                    (value.unwrap() - truth).abs() < 1.96 * error.unwrap()
                };
                all += 1;
                black += usize::from(off(site.black_dn, site.black_error_dn, truth_black));
                noise += usize::from(off(site.read_noise_dn, site.read_noise_error_dn, truth));
            }
        }
        let share = |n: usize| n as f64 / f64::from(all);
        assert!((0.90..=0.995).contains(&share(black)), "black: {}", share(black));
        assert!((0.90..=0.985).contains(&share(noise)), "read noise: {}", share(noise));
    }

    #[test]
    fn a_lit_frame_and_one_of_another_size_are_refused_in_words() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
        let lit = frame(Image::filled(160, 120, 4000));
        let error = sums.add_dark(&lit).unwrap_err().to_string();
        assert!(error.contains("not dark") && error.contains("lens cap"), "{error}");
        sums.add_dark(&dark(&mut random, 2.0, 0)).unwrap();
        let small = frame(Image::filled(80, 60, 2048));
        assert!(matches!(sums.add_dark(&small), Err(UnfitFrame::Size { .. })));
        assert!(matches!(sums.add_blown(&lit), Err(UnfitFrame::NotBlown(_)) | Ok(())));
        assert_eq!(sums.levels().sites[0].read_noise_dn, None, "one frame tells no read noise");
    }

    #[test]
    fn green_alone_is_measured_where_green_alone_is_blown() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let normal = Normal::new(0.0f64, 40.0).unwrap();
        let dn = Image::from_fn(160, 120, |x, y| match (x & 1) + (y & 1) {
            1 => 14_733,
            _ => (9000.0 + normal.sample(&mut random)).round() as u16,
        });
        let mut sums = IsoSums::new(Iso(400.0), Cfa::RGGB);
        sums.add_blown(&frame(dn)).unwrap();
        let fit = LevelsFit { levels: vec![sums.levels()] };
        let told: Vec<Option<f64>> = fit.levels[0].sites.iter().map(|s| s.saturation_dn).collect();
        assert_eq!(told, [None, Some(14_733.0), Some(14_733.0), None]);
        let why = fit.levels[0].sites[0].not_reached.as_deref().unwrap();
        assert!(why.contains("the red sites are not blown"), "{why}");
        let verdict = fit.verdict();
        assert!(verdict.good && verdict.sentences[1].contains("red and blue never clips"), "{verdict:?}");
        let measured = fit.measured(&Rig::default());
        assert_eq!(measured.isos[0].saturation, [[None, Some(14_731.0)], [Some(14_731.0), None]]);
        assert_eq!(measured.isos[0].black, [[None; 2]; 2]);
    }

    #[test]
    fn a_border_that_parts_from_the_dark_frames_is_told() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut sums = IsoSums::new(Iso(100.0), Cfa::RGGB);
        sums.add_masked(&Masked {
            mean: [[2044.0; 2]; 2],
            standard_deviation: [[2.0; 2]; 2],
            sites: [[4000; 2]; 2],
        });
        assert_eq!(sums.levels().black_source, Some(BlackSource::MaskedPixels));
        assert_eq!(sums.levels().sites[0].black_dn, Some(2044.0));
        sums.add_dark(&dark(&mut random, 2.0, 0)).unwrap();
        let fit = LevelsFit { levels: vec![sums.levels()] };
        assert_eq!(fit.levels[0].black_source, Some(BlackSource::DarkFrames));
        let verdict = fit.verdict();
        assert!(verdict.sentences.iter().any(|s| s.contains("masked border reads up to -5.")), "{verdict:?}");
    }
}
