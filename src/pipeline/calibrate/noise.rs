//! Noise and linearity of a session's sensor: pairs of evenly lit frames in, `calibration/noise.json` out.
//!
//! Frames are read twice: once for their means, by which those of one light find each other, and again two by two.

use super::{RecordError, Series, SeriesError};
use crate::calibration::noise::{
    FrameMean, IsoInput, LightLevel, NoTransfer, NoiseFit, OtherSize, PairTiles, SensorValues, compare, fit,
    levels,
};
use crate::calibration::statistics::Z95;
use crate::calibration::{NotMeasured, Record, Verdict};
use crate::export::chart::{self, Chart};
use crate::pair::Settings;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::photometry::{Levels, Mosaic, NoiseModel};
use crate::pipeline::levels as sensor_levels;
use crate::progress::Progress;
use crate::session::Session;
use crate::units::{Iso, Seconds};
use std::path::{Path, PathBuf};

/// The calibration's name: `calibration/noise.json`.
pub(super) const KIND: &str = "noise";

/// The frames of a series.
#[derive(Clone, Copy, Debug)]
pub struct NoiseFrames<'a> {
    /// Evenly lit, two or more of every light level, in any order.
    pub lit: &'a [PathBuf],
    /// With the lens cap on.
    pub dark: &'a [PathBuf],
    /// Stops of light from one level to the next, if the light was changed.
    pub stops: Option<f64>,
}

/// Why noise could not be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NoiseError {
    /// The shots could not be read, or the result not be kept.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A frame does not tell its sensitivity.
    #[error("{} does not tell its ISO; give a raw file as the camera wrote it", .0.display())]
    Untold(PathBuf),
    /// Frames that cannot be compared.
    #[error("{}: {source}", path.display())]
    Size {
        /// The second frame.
        path: PathBuf,
        /// What is wrong.
        source: OtherSize,
    },
    /// Too little to fit.
    #[error("{iso}: {source}")]
    Fit {
        /// The frames' sensitivity.
        iso: Iso,
        /// What is missing.
        source: NoTransfer,
    },
}

/// A frame as it was read first.
struct Frame<'a> {
    path: &'a Path,
    /// Its number in the series.
    shot: usize,
    iso: Iso,
    dark: bool,
    levels: Levels,
    mean: FrameMean,
    /// Mean of every filter position, DN.
    means: [[f64; 2]; 2],
    cfa: crate::photometry::Cfa,
}

/// Measures noise and linearity of every ISO that occurs, and keeps them in the session. An ISO whose frames do not tell
/// them is named with the reason; it is an error if none does.
pub fn calibrate(
    session: &Session,
    given: NoiseFrames<'_>,
    progress: &Progress,
) -> Result<Record<NoiseFit>, NoiseError> {
    let mut series = Series::new(session, KIND)?;
    let total = given.lit.len() + given.dark.len();
    let all = given.lit.iter().map(|path| (path, false)).chain(given.dark.iter().map(|path| (path, true)));
    let mut frames = vec![];
    let mut values: Vec<(Iso, SensorValues)> = vec![];
    for (shot, (path, dark)) in all.enumerate() {
        progress.check().map_err(SeriesError::from)?;
        progress.report("reading the frames", shot, total);
        let photo = series.read(path)?;
        let iso = photo.settings.iso.ok_or_else(|| NoiseError::Untold(path.clone()))?;
        let at = values.iter().position(|own| own.0 == iso).unwrap_or_else(|| {
            values.push((iso, SensorValues::default()));
            values.len() - 1
        });
        values[at].1.add(&photo.mosaic, dark);
        frames.push(frame(path, shot, (iso, dark), &photo.mosaic, &photo.settings));
    }
    let lit = |iso: Iso| frames.iter().any(|frame| !frame.dark && frame.iso == iso);
    values.retain(|(iso, _)| lit(*iso));
    values.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
    for frame in frames.iter().filter(|frame| !lit(frame.iso)) {
        series.leave_out(frame.shot, format!("there are no lit frames at {}", frame.iso));
    }
    let (mut noise, mut not_measured, mut first) = (vec![], vec![], None);
    for (iso, values) in values {
        let own: Vec<&Frame> = frames.iter().filter(|frame| frame.iso == iso).collect();
        let input = input(&mut series, (iso, &values), &own, given.stops, progress);
        let found = input.and_then(|input| fit(&input).map_err(|source| NoiseError::Fit { iso, source }));
        let (why, error) = match found {
            Ok(found) => {
                noise.push(found);
                continue;
            }
            Err(error @ NoiseError::Fit { source, .. }) => (source.to_string(), error),
            Err(error @ NoiseError::Size { .. }) => (error.to_string(), error),
            Err(error) => return Err(error),
        };
        for frame in own {
            series.leave_out_too(frame.shot, &why);
        }
        not_measured.push(NotMeasured { iso, why });
        first.get_or_insert(error);
    }
    if let Some(error) = first.filter(|_| noise.is_empty()) {
        return Err(error);
    }
    let result = NoiseFit { noise, not_measured };
    let verdict = result.verdict();
    let figure = figure(&result, &verdict);
    Ok(series.keep(result, verdict, &figure, progress)?)
}

/// What the session's noise calibration says of frames of these settings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionNoise {
    /// Variance of a site's value; absent if it was not measured, or cannot be relied on.
    pub model: Option<NoiseModel>,
    /// Why there is no model though noise was measured, or why it is but a bound: for people.
    pub remark: Option<String>,
    /// Whether the model was measured at another ISO, and is an upper bound.
    pub scaled: bool,
}

/// The session's noise at these settings. That of another body is an error; that of another ISO is scaled to this one,
/// and said.
pub fn of(session: &Session, settings: &Settings) -> Result<SessionNoise, RecordError> {
    let Some(record) = super::load::<NoiseFit>(session, KIND)? else { return Ok(SessionNoise::default()) };
    let path = super::file(session, KIND);
    let other = |source| RecordError::OtherRig { path: path.clone(), source };
    record.rig.same_body(settings, "the noise calibration").map_err(other)?;
    let without = |why: &str| {
        let remark = format!("The noise calibration is not used for variances: {why}.");
        Ok(SessionNoise { remark: Some(remark), ..SessionNoise::default() })
    };
    if !record.verdict.good {
        return without("its own verdict is that it cannot be relied on; calibrate noise again");
    }
    if settings.model.is_none() {
        return without("a frame does not tell its camera model");
    }
    let Some(iso) = settings.iso else {
        return without("a frame does not tell its ISO");
    };
    let Some(found) = record.fit.at(iso) else {
        return without("it holds no ISO that can be relied on; calibrate noise again");
    };
    let remark = found.scaled.then(|| {
        format!(
            "Noise was not measured at {iso}, or not well: variances are scaled from {}, an upper bound; calibrate noise at {iso} for the true ones.",
            found.measured_at
        )
    });
    Ok(SessionNoise { model: Some(found.model), remark, scaled: found.scaled })
}

fn frame<'a>(
    path: &'a Path,
    shot: usize,
    (iso, dark): (Iso, bool),
    mosaic: &Mosaic,
    settings: &Settings,
) -> Frame<'a> {
    let mut sums = [[0u64; 2]; 2];
    let mut sites = [[0u64; 2]; 2];
    for (y, line) in mosaic.dn.pixels().chunks_exact(mosaic.dn.width().max(1)).enumerate() {
        for (x, &dn) in line.iter().enumerate() {
            sums[y & 1][x & 1] += u64::from(dn);
            sites[y & 1][x & 1] += 1;
        }
    }
    let means = [0, 1].map(|r| [0, 1].map(|c| sums[r][c] as f64 / sites[r][c].max(1) as f64));
    let black: f64 = mosaic.levels.black.as_flattened().iter().map(|b| f64::from(*b)).sum();
    let mean = FrameMean {
        size: (mosaic.dn.width(), mosaic.dn.height()),
        shutter: settings.shutter.map(|s| s.0),
        aperture: settings.aperture.map(|n| n.0),
        mean: 0.25 * (means.as_flattened().iter().sum::<f64>() - black),
    };
    Frame { path, shot, iso, dark, levels: mosaic.levels, mean, means, cfa: mosaic.cfa }
}

/// Compares the frames of one ISO two by two.
fn input(
    series: &mut Series<'_>,
    (iso, values): (Iso, &SensorValues),
    frames: &[&Frame<'_>],
    stops: Option<f64>,
    progress: &Progress,
) -> Result<IsoInput, NoiseError> {
    let (dark, lit): (Vec<&Frame>, Vec<&Frame>) = frames.iter().copied().partition(|frame| frame.dark);
    let cut = values.cut_off();
    let black = cut.map_or_else(|| black(&dark, &lit), |cut| cut.black);
    let means = |frames: &[&Frame]| frames.iter().map(|frame| frame.mean).collect::<Vec<_>>();
    let pairs =
        |members: &[usize], of: &[&Frame], series: &mut Series| -> Result<Vec<PairTiles>, NoiseError> {
            let mut found = vec![];
            for two in members.chunks(2) {
                progress.check().map_err(SeriesError::from)?;
                progress.report("comparing pairs of frames", of[two[0]].shot, of.len());
                let &[first, second] = two else {
                    series.leave_out(
                        of[two[0]].shot,
                        "there is no second frame of the same light and settings".into(),
                    );
                    continue;
                };
                let (first, second) = (of[first], of[second]);
                let read = |frame: &Frame| -> Result<Mosaic, SeriesError> {
                    Ok(sensor_levels::read(frame.path, &series.measured)?.mosaic)
                };
                let tiles = compare(&read(first)?, &read(second)?, black)
                    .map_err(|source| NoiseError::Size { path: second.path.to_owned(), source })?;
                if tiles.tiles.is_empty() {
                    let why = "every part of it clips, at the top or at 0 DN, or it is too small";
                    series.leave_out(first.shot, why.into());
                    series.leave_out(second.shot, why.into());
                } else {
                    found.push(PairTiles {
                        shot_numbers: vec![first.shot.min(second.shot), first.shot.max(second.shot)],
                        ..tiles
                    });
                }
            }
            Ok(found)
        };
    let mut steps = vec![];
    for members in levels(&means(&lit)) {
        let first = lit[members[0]].mean;
        let found = pairs(&members, &lit, series)?;
        if !found.is_empty() {
            let time = first.shutter.map(|label| Nominal.time(Seconds(label)));
            steps.push((first.mean, LightLevel { time, aperture: first.aperture, pairs: found }));
        }
    }
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut dark_pairs = vec![];
    for members in levels(&means(&dark)) {
        match cut {
            Some(cut) => members.iter().for_each(|&dark_frame| {
                let why = format!("its noise is cut off at {:.0} DN: it tells that alone", cut.dn);
                series.leave_out(dark[dark_frame].shot, why);
            }),
            None => dark_pairs.extend(pairs(&members, &dark, series)?),
        }
    }
    let own = lit[0];
    Ok(IsoInput {
        iso,
        levels: steps.into_iter().map(|step| step.1).collect(),
        dark: dark_pairs,
        range: by_colour(own, |r, c| f64::from(own.levels.saturation[r][c]) - black[r][c]),
        black: by_colour(own, |r, c| black[r][c] - cut.map_or(0.0, |cut| cut.dn)),
        cut_off_dn: cut.map(|cut| cut.dn),
        steps: values.steps(),
        saturation_source: own.levels.saturation_source,
        black_error: black_error(&dark),
        stops,
    })
}

/// Black by filter position: mean of the dark frames, else what the frames are read with.
fn black(dark: &[&Frame<'_>], lit: &[&Frame<'_>]) -> [[f64; 2]; 2] {
    if dark.is_empty() {
        return lit[0].levels.black.map(|row| row.map(f64::from));
    }
    let mean = |r: usize, c: usize| dark.iter().map(|d| d.means[r][c]).sum::<f64>() / dark.len() as f64;
    [0, 1].map(|r| [0, 1].map(|c| mean(r, c)))
}

/// Standard error of black as the dark frames' means spread; a tenth of a DN without two of them.
fn black_error(dark: &[&Frame<'_>]) -> f64 {
    if dark.len() < 2 {
        return 0.1;
    }
    let n = dark.len() as f64;
    let mean = dark.iter().map(|d| d.mean.mean).sum::<f64>() / n;
    (dark.iter().map(|d| (d.mean.mean - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt()
}

/// The lowest value of each colour's filter positions.
fn by_colour(frame: &Frame<'_>, value: impl Fn(usize, usize) -> f64) -> [f64; 3] {
    let mut lowest = [f64::INFINITY; 3];
    for (r, c) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let colour = &mut lowest[usize::from(frame.cfa.0[r][c]).min(2)];
        *colour = colour.min(value(r, c));
    }
    lowest
}

/// Variance over signal of the first ISO.
fn figure(fit: &NoiseFit, verdict: &Verdict) -> Chart {
    let first = fit.noise.first();
    let series = ["red", "green", "blue"].map(|colour| {
        let own = first.into_iter().flat_map(|noise| &noise.residuals).filter(|r| r.colour == colour);
        chart::Series {
            name: colour.to_owned(),
            points: own.map(|r| (r.signal_dn, r.variance_dn2, Z95 * r.variance_dn2_standard_error)).collect(),
        }
    });
    let at = first.map_or_else(String::new, |noise| format!(" at {}", noise.iso));
    Chart {
        caption: verdict.sentences.join(" "),
        across: format!("signal above black{at}, DN"),
        up: "variance, DN^2".into(),
        series: series.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::SCHEMA;
    use serde_json::json;

    fn of_model(model: &str, iso: f64) -> Settings {
        Settings { model: Some(model.into()), iso: Some(Iso(iso)), ..Settings::default() }
    }

    fn keep(session: &Session, good: bool) {
        let record = json!({
            "schema": SCHEMA, "measured": "", "software": "", "rig": { "model": "A" }, "shots": [],
            "verdict": { "good": good, "sentences": [] },
            "noise": [{
                "iso": 100.0, "pairs": 8, "dark_pairs": 2, "model": { "gain_dn": 0.25, "floor_dn2": 2.0 },
                "electrons_per_dn": 4.0, "electrons_per_dn_interval_95": [3.9, 4.1], "colours": [],
                "saturation_source": "measured", "residuals": [], "chi_squared": 1.0, "rejected_share": 0.0,
                "colours_apart_in_errors": 0.0
            }]
        });
        session.keep(&session.calibration_dir().join("noise.json"), record.to_string().as_bytes()).unwrap();
    }

    #[test]
    fn noise_counts_for_its_body_is_scaled_aloud_to_other_isos_and_refused_for_other_bodies() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        assert_eq!(of(&session, &of_model("A", 100.0)).unwrap(), SessionNoise::default());
        keep(&session, true);
        let own = of(&session, &of_model("A", 100.0)).unwrap();
        let model = Some(NoiseModel { gain: 0.25, floor: 2.0 });
        assert_eq!(own, SessionNoise { model, remark: None, scaled: false });
        let scaled = of(&session, &of_model("A", 400.0)).unwrap();
        assert_eq!(scaled.model, Some(NoiseModel { gain: 1.0, floor: 32.0 }));
        let remark = scaled.remark.unwrap();
        assert!(remark.contains("not measured at ISO 400") && remark.contains("from ISO 100"), "{remark}");
        let refused = of(&session, &of_model("B", 100.0)).unwrap_err().to_string();
        assert!(refused.contains("its camera model is \"B\"") && refused.contains("noise.json"), "{refused}");
        let untold = of(&session, &Settings { iso: None, ..of_model("A", 1.0) }).unwrap();
        assert!(untold.model.is_none() && untold.remark.unwrap().contains("does not tell its ISO"));
        keep(&session, false);
        let bad = of(&session, &of_model("A", 100.0)).unwrap();
        assert!(bad.model.is_none() && bad.remark.unwrap().contains("cannot be relied on"));
    }
}
