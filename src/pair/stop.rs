//! Signature of a pair by which the very same stop is known again, and its flash light compared.
//!
//! How much flash light comes back is the stop's own nature, so that a weak flash shows only against an earlier
//! pair from the same view. Takes both frames shrunk to cells, gives a [`Stop`]: the room's light and the
//! flash's on a coarse grid. The room's light alone tells whether two pairs are from one stop, its level
//! divided out; nearly every grid cell must agree, since on a turntable the room stays and only the object turns.
//! Two views that agree in that are the same as far as light is concerned.

use super::Limits;
use super::survey::Cells;
use crate::raster::Image;
use serde::{Deserialize, Serialize};

/// Most grid cells across and down.
const GRID: [usize; 2] = [96, 64];
/// Standard deviations of noise that no grid cell of an equal view passes.
const SIGMAS: f32 = 5.0;
/// Share of the mean level below which a grid cell's noise no longer falls: read noise takes over.
const DARK: f32 = 0.05;
/// Share of its own light that a grid cell's noise may blur at most for it to tell anything.
const BLUR: f32 = 0.25;
/// Least share of the grid bright enough to tell a stop by.
const TELLING: f64 = 0.1;
/// Share of the best-lit hundredth's flash light from which on a grid cell counts as lit.
const LIT: f32 = 0.1;
/// Full scale of stored grid values.
const FULL: f32 = u16::MAX as f32;

/// What is kept of an accepted pair to know its stop again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stop {
    /// Sites of the frames, width and height: other sizes are other views.
    size: [usize; 2],
    /// Grid cells across and down.
    grid: [usize; 2],
    /// Room light row by row, `ambient_unit` times its mean each.
    ambient: Vec<u16>,
    ambient_unit: f32,
    /// Standard deviation of a grid cell at the mean level, as a share of it.
    noise: f32,
    /// Flash light row by row, `flash_unit` DN each; negative noise is 0.
    flash: Vec<u16>,
    flash_unit: f32,
    /// ISO / N^2 of the lit frame; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gain: Option<f64>,
}

/// Blocks of a key across and down.
const KEY: [usize; 2] = [12, 8];
/// Key value of a block as bright as the frame's mean; four times as bright is full.
const KEY_MEAN: f32 = 64.0;
/// Share of itself, and key values beyond it, by which a block of one stop's two pairs may differ: far more than
/// the signatures themselves may, so that no match is passed over.
const KEY_TOLERANCE: (f32, f32) = (0.2, 6.0);
/// Blocks that may differ by more: what little may change at one stop can lie in a block or two.
const KEY_MISSES: usize = 2;

/// The gist of a signature, small enough to keep of every pair: where it differs, the stops do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopKey([u8; KEY[0] * KEY[1]]);

impl StopKey {
    /// Whether the stops may be the same one.
    pub fn may_match(&self, other: &StopKey) -> bool {
        let differ = |(a, b): (f32, f32)| (a - b).abs() > KEY_TOLERANCE.0 * a.max(b) + KEY_TOLERANCE.1;
        let blocks = self.0.iter().zip(&other.0).map(|(&a, &b)| (f32::from(a), f32::from(b)));
        blocks.filter(|block| differ(*block)).count() <= KEY_MISSES
    }
}

/// Signatures of earlier accepted pairs, wherever they are kept.
pub trait EarlierStops: std::fmt::Debug {
    /// Those that may be from the stop of `stop`; at least all that are.
    fn candidates(&self, stop: &Stop) -> Vec<Stop>;
}

impl EarlierStops for Vec<Stop> {
    fn candidates(&self, stop: &Stop) -> Vec<Stop> {
        let key = stop.key();
        self.iter().filter(|earlier| earlier.key().may_match(&key)).cloned().collect()
    }
}

impl Stop {
    /// The gist of its room light.
    pub fn key(&self) -> StopKey {
        let [across, down] = self.grid.map(|n| n.max(1));
        let (mut sums, mut counts) = ([0f32; KEY[0] * KEY[1]], [0f32; KEY[0] * KEY[1]]);
        for (i, &value) in self.ambient.iter().enumerate() {
            let (x, y) = (i % across * KEY[0] / across, (i / across).min(down - 1) * KEY[1] / down);
            sums[y * KEY[0] + x] += f32::from(value) * self.ambient_unit;
            counts[y * KEY[0] + x] += 1.0;
        }
        StopKey(std::array::from_fn(|i| (KEY_MEAN * sums[i] / counts[i].max(1.0)).min(255.0) as u8))
    }

    /// `None` for frames too small or too dark to tell one stop from another. `black` is the frames' mean black
    /// in DN, unlit first; `scale` is S_on / S_off, `gain` the lit frame's ISO / N^2.
    pub(super) fn new(
        [off, on]: &[Cells; 2],
        black: [f32; 2],
        scale: f32,
        gain: Option<f64>,
    ) -> Option<Self> {
        let (unlit, lit) = (Grid::new(&off.means, black[0])?, Grid::new(&on.means, black[1])?);
        let mean = unlit.means.iter().sum::<f32>() / unlit.means.len() as f32;
        if mean.is_nan() || mean <= 0.0 {
            return None;
        }
        let room: Vec<f32> = unlit.means.iter().map(|v| (v / mean).max(0.0)).collect();
        // Halves of one grid cell differ by twice its own noise; edges are few enough for a median.
        let mut spreads: Vec<f32> =
            room.iter().zip(&unlit.halves).map(|(v, h)| (h / mean).abs() / v.max(DARK).sqrt()).collect();
        let middle = spreads.len() / 2;
        let noise = 0.5 / 0.6745 * *spreads.select_nth_unstable_by(middle, f32::total_cmp).1;
        let flash: Vec<f32> =
            lit.means.iter().zip(&unlit.means).map(|(on, off)| (on - scale * off).max(0.0)).collect();
        let (ambient, ambient_unit) = stored(&room);
        let (flash, flash_unit) = stored(&flash);
        let stop = Self {
            size: [off.means.width() * off.size, off.means.height() * off.size],
            grid: unlit.grid,
            ambient,
            ambient_unit,
            noise,
            flash,
            flash_unit,
            gain,
        };
        let (telling, _) = stop.compare(&stop, 0.0);
        (telling as f64 >= TELLING * stop.ambient.len() as f64).then_some(stop)
    }

    /// Largest difference of two grid cells at a level that noise alone makes.
    fn blur(noise: f32, level: f32) -> f32 {
        SIGMAS * noise * level.max(DARK).sqrt()
    }

    /// How many grid cells are bright enough to tell one view from another, and how many of them differ by more
    /// than their noise and `tolerance`, a share of their light.
    fn compare(&self, other: &Stop, tolerance: f32) -> (usize, usize) {
        let noise = self.noise.hypot(other.noise);
        let (mut telling, mut differing) = (0, 0);
        for (&a, &b) in self.ambient.iter().zip(&other.ambient) {
            let (a, b) = (f32::from(a) * self.ambient_unit, f32::from(b) * other.ambient_unit);
            let level = a.max(b);
            let blur = Self::blur(noise, level);
            if blur < BLUR * level {
                telling += 1;
                differing += usize::from((a - b).abs() > blur.max(tolerance * level));
            }
        }
        (telling, differing)
    }

    /// Share of the telling grid cells whose room light differs by more than its noise and `tolerance` (a share of
    /// it), its level divided out; `None` where the two cannot be compared.
    fn difference(&self, other: &Stop, tolerance: f32) -> Option<f64> {
        let whole = |s: &Stop| {
            let cells = s.grid[0].checked_mul(s.grid[1]);
            cells == Some(s.ambient.len()) && cells == Some(s.flash.len())
        };
        if (self.size, self.grid) != (other.size, other.grid) || !whole(self) || !whole(other) {
            return None;
        }
        let (telling, differing) = self.compare(other, tolerance);
        (telling as f64 >= TELLING * self.ambient.len() as f64).then(|| differing as f64 / telling as f64)
    }

    /// Whether both were shot from one stop, as far as the room's light tells.
    pub fn is_same_stop(&self, other: &Stop, limits: &Limits) -> bool {
        self.difference(other, limits.stop_tolerance as f32)
            .is_some_and(|share| share <= limits.stop_changed_share)
    }

    /// This pair's flash light as a share of an earlier one's from the same stop, over the cells that were lit,
    /// both brought to one ISO and aperture; `None` if nothing was lit or only one pair tells its settings.
    fn flash_against(&self, earlier: &Stop) -> Option<f64> {
        let gain = match (self.gain, earlier.gain) {
            (Some(now), Some(then)) => now / then,
            (None, None) => 1.0,
            _ => return None,
        };
        let mut sorted = earlier.flash.clone();
        sorted.sort_unstable();
        let best = f32::from(*sorted.get(sorted.len().checked_sub(1)? * 99 / 100)?);
        let lit = || self.flash.iter().zip(&earlier.flash).filter(|(_, e)| f32::from(**e) > LIT * best);
        let sum = |values: &mut dyn Iterator<Item = u16>| values.map(f64::from).sum::<f64>();
        let now = sum(&mut lit().map(|(n, _)| *n)) * f64::from(self.flash_unit);
        let then = sum(&mut lit().map(|(_, e)| *e)) * f64::from(earlier.flash_unit);
        (then > 0.0 && gain > 0.0).then(|| now / then / gain)
    }

    /// Median share of the flash light that earlier pairs from the very same stop had; `None` if none is.
    pub(super) fn flash_against_earlier(&self, earlier: &dyn EarlierStops, limits: &Limits) -> Option<f64> {
        let candidates = earlier.candidates(self);
        let same = candidates.iter().filter(|stop| self.is_same_stop(stop, limits));
        let mut shares: Vec<f64> = same.filter_map(|stop| self.flash_against(stop)).collect();
        shares.sort_by(f64::total_cmp);
        shares.get(shares.len() / 2).copied()
    }
}

/// Values as shares of the largest.
fn stored(values: &[f32]) -> (Vec<u16>, f32) {
    let unit = values.iter().fold(f32::MIN_POSITIVE * FULL, |a, &b| a.max(b)) / FULL;
    (values.iter().map(|v| (v / unit).round() as u16).collect(), unit)
}

/// Means over a coarse grid, and how much the two halves of each grid cell (its cells taken as on a
/// chessboard) differ.
struct Grid {
    grid: [usize; 2],
    means: Vec<f32>,
    halves: Vec<f32>,
}

impl Grid {
    fn new(cells: &Image<f32>, black: f32) -> Option<Self> {
        let (width, height) = (cells.width(), cells.height());
        // Sixteen cells a grid cell at least: its halves are compared to know its noise.
        let grid = [GRID[0].min(width / 4), GRID[1].min(height / 4)];
        if grid.contains(&0) {
            return None;
        }
        let (mut means, mut halves) = (vec![], vec![]);
        let edge = |i: usize, n: usize, whole: usize| i * whole / n;
        for gy in 0..grid[1] {
            for gx in 0..grid[0] {
                let columns = edge(gx, grid[0], width)..edge(gx + 1, grid[0], width);
                let (mut sums, mut counts) = ([0f32; 2], [0f32; 2]);
                for y in edge(gy, grid[1], height)..edge(gy + 1, grid[1], height) {
                    for (x, v) in columns.clone().zip(&cells.pixels()[y * width..][columns.clone()]) {
                        sums[(x + y) & 1] += v - black;
                        counts[(x + y) & 1] += 1.0;
                    }
                }
                means.push((sums[0] + sums[1]) / (counts[0] + counts[1]));
                halves.push(sums[0] / counts[0] - sums[1] / counts[1]);
            }
        }
        Some(Self { grid, means, halves })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// Cells of a frame of `light` DN above a black of 2048; each is the mean of 16 sites with shot noise.
    fn cells(seed: u64, light: impl Fn(f32, f32) -> f32) -> Cells {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let means = Image::from_fn(600, 400, |x, y| {
            let light = light(x as f32 + 0.5, y as f32 + 0.5);
            2048.0 + Normal::new(light, ((0.3 * light + 4.0) / 16.0).sqrt()).unwrap().sample(&mut random)
        });
        Cells { means, size: 4 }
    }

    /// A turntable in a room: a mottled ball 120 cells wide that turns by `degrees` before a still background.
    fn turned(degrees: f32, level: f32) -> impl Fn(f32, f32) -> f32 {
        move |x, y| {
            let (dx, dy) = ((x - 300.0) / 60.0, (y - 200.0) / 60.0);
            let depth = 1.0 - dx * dx - dy * dy;
            if depth <= 0.0 {
                return level * (600.0 + 300.0 * (x / 70.0).sin() * (y / 50.0).cos());
            }
            let longitude = dx.atan2(depth.sqrt()) + degrees.to_radians();
            let mottle = (9.0 * longitude).sin() * (11.0 * dy).cos();
            level * (500.0 + 200.0 * dx + 150.0 * mottle)
        }
    }

    fn stop(seed: u64, degrees: f32, level: f32, flash: f32) -> Stop {
        let room = turned(degrees, level);
        let both =
            [cells(seed, &room), cells(seed + 1, |x, y| room(x, y) + flash * turned(degrees, 1.0)(x, y))];
        Stop::new(&both, [2048.0; 2], 1.0, Some(2.0)).unwrap()
    }

    #[test]
    fn the_same_stop_is_known_again_whatever_its_light_level() {
        let limits = Limits::default();
        for level in [1.0, 0.7, 1.5] {
            assert!(stop(1, 0.0, 1.0, 1.0).is_same_stop(&stop(3, 0.0, level, 1.0), &limits), "{level}");
        }
    }

    #[test]
    fn a_turntable_that_moved_on_is_another_stop_though_the_room_is_the_same() {
        let limits = Limits::default();
        let first = stop(1, 0.0, 1.0, 1.0);
        for degrees in [3.0, 5.0, 10.0, 15.0, 20.0, 90.0] {
            for level in [1.0, 0.8] {
                let next = stop(5, degrees, level, 1.0);
                assert!(!first.is_same_stop(&next, &limits), "{degrees} degrees, {level}");
            }
        }
    }

    #[test]
    fn the_flash_is_compared_with_the_same_stop_alone_and_in_one_unit() {
        let limits = Limits::default();
        let earlier = vec![stop(1, 15.0, 1.0, 3.0), stop(11, 0.0, 1.2, 1.0)];
        let share = stop(21, 0.0, 1.0, 0.8).flash_against_earlier(&earlier, &limits).unwrap();
        assert!((share - 0.8).abs() < 0.005, "{share}");
        assert_eq!(stop(21, 30.0, 1.0, 0.8).flash_against_earlier(&earlier, &limits), None);
        let closed = Stop { gain: Some(1.0), ..stop(21, 0.0, 1.0, 0.5) };
        let share = closed.flash_against_earlier(&earlier, &limits).unwrap();
        assert!((share - 1.0).abs() < 0.01, "{share}");
    }

    #[test]
    fn a_dark_room_tells_no_stops_apart() {
        let both = [cells(1, |_, _| 0.2), cells(2, |_, _| 900.0)];
        assert_eq!(Stop::new(&both, [2048.0; 2], 1.0, None), None);
    }

    #[test]
    fn a_signature_survives_its_file_and_a_torn_one_matches_nothing() {
        let stop = stop(1, 0.0, 1.0, 1.0);
        let json = serde_json::to_vec(&stop).unwrap();
        assert!(json.len() < 120_000, "{}", json.len());
        assert_eq!(serde_json::from_slice::<Stop>(&json).unwrap(), stop);
        let torn = Stop { ambient: vec![1], ..stop.clone() };
        assert!(!stop.is_same_stop(&torn, &Limits::default()));
    }
}
