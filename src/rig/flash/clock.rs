//! The board's clock on the host's: which moment a time stamp of the board was.
//!
//! The board counts microseconds modulo 2^32 by a resonator that may be off by half a per cent. Every ping brings a
//! stamp that was taken between its sending and its answer, so that its host time is known to half the round trip.
//! Of each stretch of the sliding window only the fastest ping is used, and a line is fitted through those, each
//! weighted by its round trip: offset and drift. All host times are seconds on a monotonic clock, so that a step of
//! the time of day moves nothing; whoever wants UTC converts once, at the end.

use std::cmp::Ordering;
use std::collections::VecDeque;

/// How much of the past the fit looks at, seconds.
const WINDOW: f64 = 120.0;
/// Of each stretch of so many seconds, the fastest ping counts.
const STRETCH: f64 = 5.0;
/// A shorter span of pings says nothing on the drift, seconds.
const SPAN: f64 = 8.0;
/// How far a ceramic resonator may be off, relative; assumed where the drift is not known.
const RESONATOR: f64 = 5e-3;
/// Microseconds until the board's clock starts again.
const WRAP: f64 = 4_294_967_296.0;

/// One ping.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// The board's clock, seconds since the first ping, unwrapped.
    board: f64,
    /// Middle of the round trip on the host's clock, seconds.
    host: f64,
    /// Half the round trip, seconds.
    half: f64,
}

/// host = `host` + `rate` (board - `board`).
#[derive(Clone, Copy, Debug)]
struct Line {
    board: f64,
    host: f64,
    rate: f64,
    /// Half the round trip of the fastest ping, seconds: what no fit can tell.
    half: f64,
    /// Variances of the line at its middle (s^2) and of its rate.
    variance: (f64, f64),
}

/// A moment on the host's monotonic clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    /// Seconds.
    pub(super) host: f64,
    /// How far it may be off, seconds.
    pub(super) uncertainty: f64,
}

/// How a board's clock runs.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ClockState {
    /// By how much the board's clock runs faster than the host's, parts per million; absent before it is known.
    pub drift_ppm: Option<f64>,
    /// How far the host time of an event of this moment may be off, seconds.
    pub uncertainty_s: f64,
}

/// The fit, of one boot.
#[derive(Clone, Debug, Default)]
pub(super) struct BoardClock {
    samples: VecDeque<Sample>,
    /// The last stamp: as it came, and unwrapped in seconds, with the host's time.
    last: Option<(u32, f64, f64)>,
    line: Option<Line>,
}

impl BoardClock {
    /// Takes the stamp `board_us` that was taken between `sent` and `heard` (host, seconds).
    pub(super) fn note(&mut self, sent: f64, heard: f64, board_us: u32) {
        let (host, half) = ((sent + heard) / 2.0, (heard - sent).max(0.0) / 2.0);
        let board = self.unwrap(board_us, host);
        self.last = Some((board_us, board, host));
        self.samples.push_back(Sample { board, host, half });
        while self.samples.front().is_some_and(|s| s.host < host - WINDOW) {
            self.samples.pop_front();
        }
        self.line = fit(&self.fastest());
    }

    /// When the board's clock showed `board_us`, which was around `near` (host, seconds; off by half an hour at
    /// most). `None` before the first ping.
    pub(super) fn moment(&self, board_us: u32, near: f64) -> Option<Moment> {
        let line = self.line?;
        let away = self.unwrap(board_us, near) - line.board;
        let (at_middle, of_rate) = line.variance;
        let fitted = 2.0 * (at_middle + of_rate * away * away).sqrt();
        Some(Moment { host: line.host + line.rate * away, uncertainty: line.half + fitted })
    }

    /// How `board_us`, read at `host`, compares with what the clock seen so far should show then, give or take
    /// `slack` seconds and what the resonator may have drifted since. A board that restarted counts from 0 again and
    /// is behind (`Less`).
    pub(super) fn compare(&self, board_us: u32, host: f64, slack: f64) -> Ordering {
        let (Some(moment), Some((_, _, last))) = (self.moment(board_us, host), self.last) else {
            return Ordering::Equal;
        };
        let ahead = moment.host - host;
        if ahead.abs() <= slack + RESONATOR * (host - last).abs() {
            Ordering::Equal
        } else {
            ahead.total_cmp(&0.0)
        }
    }

    /// How the clock runs, for an event at `host`.
    pub(super) fn state(&self) -> Option<ClockState> {
        let (line, (us, _, host)) = (self.line?, self.last?);
        let known = line.variance.1 < RESONATOR * RESONATOR / 4.0;
        let drift_ppm = known.then(|| (1.0 / line.rate - 1.0) * 1e6);
        Some(ClockState { drift_ppm, uncertainty_s: self.moment(us, host)?.uncertainty })
    }

    /// `board_us` in seconds since the first stamp: of all that it may mean, what is nearest to `near`.
    fn unwrap(&self, board_us: u32, near: f64) -> f64 {
        let Some((last_us, board, host)) = self.last else { return 0.0 };
        let since = f64::from(board_us) - f64::from(last_us);
        let turns = (((near - host) * 1e6 - since) / WRAP).round();
        board + (since + turns * WRAP) * 1e-6
    }

    fn fastest(&self) -> Vec<Sample> {
        let mut chosen: Vec<Sample> = Vec::new();
        let mut stretch = f64::NAN;
        for sample in &self.samples {
            let this = (sample.host / STRETCH).floor();
            match chosen.last_mut() {
                Some(best) if this == stretch => {
                    if sample.half < best.half {
                        *best = *sample;
                    }
                }
                _ => chosen.push(*sample),
            }
            stretch = this;
        }
        chosen
    }
}

/// Weighted least squares through the pings; one ping alone, with the resonator's tolerance, where they span too
/// little.
fn fit(pings: &[Sample]) -> Option<Line> {
    let best = pings.iter().min_by(|a, b| a.half.total_cmp(&b.half))?;
    let span = pings.last()?.host - pings.first()?.host;
    if span < SPAN || pings.len() < 3 {
        let variance = (0.0, RESONATOR * RESONATOR / 4.0);
        return Some(Line { board: best.board, host: best.host, rate: 1.0, half: best.half, variance });
    }
    // A round trip of nothing would have all the weight; no ping is that good.
    let weight = |s: &Sample| s.half.max(1e-5).powi(-2);
    let total: f64 = pings.iter().map(weight).sum();
    let board = pings.iter().map(|s| weight(s) * s.board).sum::<f64>() / total;
    let host = pings.iter().map(|s| weight(s) * s.host).sum::<f64>() / total;
    let spread: f64 = pings.iter().map(|s| weight(s) * (s.board - board).powi(2)).sum();
    let common: f64 = pings.iter().map(|s| weight(s) * (s.board - board) * (s.host - host)).sum();
    if spread <= 0.0 {
        return None;
    }
    let rate = common / spread;
    let misfit: f64 =
        pings.iter().map(|s| weight(s) * (s.host - host - rate * (s.board - board)).powi(2)).sum();
    // Half a round trip is a bound and no deviation: the pings' own scatter says what one weighs.
    let scale = (misfit / (pings.len() as f64 - 2.0)).max(0.01);
    Some(Line { board, host, rate, half: best.half, variance: (scale / total, scale / spread) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A board whose clock started at `start_us` and runs `ppm` too fast; the wire takes 1 ms each way and, at random,
    /// more.
    struct Bench {
        start_us: f64,
        ppm: f64,
        random: ChaCha8Rng,
    }

    impl Bench {
        fn stamp(&self, host: f64) -> u32 {
            ((self.start_us + host * (1e6 + self.ppm)) % WRAP) as u32
        }

        fn delay(&mut self) -> f64 {
            let uniform: f64 = self.random.random_range(1e-6..1.0);
            0.001 - 0.003 * uniform.ln()
        }

        fn ping(&mut self, clock: &mut BoardClock, sent: f64) {
            let at = sent + self.delay();
            let heard = at + self.delay();
            clock.note(sent, heard, self.stamp(at));
        }
    }

    fn bench(start_us: f64, ppm: f64) -> Bench {
        Bench { start_us, ppm, random: ChaCha8Rng::seed_from_u64(7) }
    }

    #[test]
    fn drift_and_moments_are_found_through_jitter_and_wrap() {
        for ppm in [-4000.0, -80.0, 0.0, 500.0, 4000.0] {
            let mut bench = bench(WRAP - 60e6, ppm); // wraps after a minute
            let mut clock = BoardClock::default();
            let (mut worst, mut outside, mut asked): (f64, u32, u32) = (0.0, 0, 0);
            for k in 0..900 {
                let now = 0.4 * f64::from(k);
                bench.ping(&mut clock, now);
                let event = now + 0.2;
                let moment = clock.moment(bench.stamp(event), now + 0.3).unwrap();
                let error = (moment.host - event).abs();
                asked += 1;
                outside += u32::from(error > moment.uncertainty);
                if now > 30.0 {
                    worst = worst.max(error);
                    assert!(moment.uncertainty < 0.006, "{moment:?}");
                }
            }
            assert!(worst < 0.002, "{ppm} ppm: off by {worst}");
            assert!(f64::from(outside) < 0.01 * f64::from(asked), "{ppm} ppm: {outside} of {asked} outside");
            let drift = clock.state().unwrap().drift_ppm.unwrap();
            assert!((drift - ppm).abs() < 20.0, "{drift} of {ppm}");
        }
    }

    #[test]
    fn the_first_ping_gives_a_moment_that_owns_up_to_the_resonator() {
        let mut bench = bench(5e6, 4000.0);
        let mut clock = BoardClock::default();
        assert_eq!(clock.moment(1, 0.0), None);
        bench.ping(&mut clock, 10.0);
        let moment = clock.moment(bench.stamp(12.0), 12.0).unwrap();
        assert!((moment.host - 12.0).abs() <= moment.uncertainty, "{moment:?}");
        assert!(moment.uncertainty > 0.009, "{moment:?}");
        assert_eq!(clock.state().unwrap().drift_ppm, None);
    }

    #[test]
    fn a_restart_is_behind_a_sleeping_host_ahead_and_a_long_silence_neither() {
        let mut bench = bench(100e6, 3000.0);
        let mut clock = BoardClock::default();
        (0..100).for_each(|k| bench.ping(&mut clock, 0.4 * f64::from(k)));
        for later in [41.0, 60.0, 3600.0, 3.0 * 3600.0] {
            assert_eq!(clock.compare(bench.stamp(later), later, 2.0), Ordering::Equal, "{later}");
        }
        assert_eq!(clock.compare(1_500_000, 42.0, 2.0), Ordering::Less, "restarted");
        assert_eq!(clock.compare(bench.stamp(642.0), 42.0, 2.0), Ordering::Greater, "the host slept");
    }

    #[test]
    fn a_slow_ping_moves_nothing() {
        let mut bench = bench(0.0, 0.0);
        let mut clock = BoardClock::default();
        (0..100).for_each(|k| bench.ping(&mut clock, 0.4 * f64::from(k)));
        let before = clock.moment(bench.stamp(40.2), 40.2).unwrap();
        clock.note(40.3, 41.2, bench.stamp(40.3)); // its answer was lost and came again
        let after = clock.moment(bench.stamp(40.2), 40.2).unwrap();
        assert!((after.host - before.host).abs() < 1e-3, "{before:?} {after:?}");
    }
}
