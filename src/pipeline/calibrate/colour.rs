//! Colour of a session, from a frame of a chart: `calibration/colour.json`, its figure, and `calibration/colour.png`,
//! which shows where the patches were found.

use super::{RecordError, Series, SeriesError};
use crate::calibration::colour::{
    self, ChartFrame, ChartKind, ColourError, ColourFit, Found, FramesDiffer, fit_colour, overlay,
};
use crate::calibration::{OtherRig, Record};
use crate::codec::png::{PngError, encode_rgb8};
use crate::export::chart::{Chart, Series as Points};
use crate::export::colour::{ACESCG, LINEAR_SRGB};
use crate::pair::{Lighting, Settings};
use crate::pipeline::scale::{RatioError, SessionScale};
use crate::progress::{Cancelled, Progress};
use crate::session::Session;
use crate::units::{FNumber, Iso, Seconds};
use glam::{DMat3, DVec2};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

pub(in crate::pipeline) const KIND: &str = "colour";

const OF: &str = "the colour calibration";

/// Longest sides in pixels of the pictures in which a chart is sought, one after the other: a large chart is found in
/// the first, a small one in the last.
const SIZES: [usize; 3] = [420, 900, 1800];

/// Why there is no colour calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ColourCalibrationError {
    /// The shots or the session.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// The chart.
    #[error(transparent)]
    Colour(#[from] ColourError),
    /// Lit and unlit frame do not fit together.
    #[error("{}: {source}", path.display())]
    Differ {
        /// The unlit frame.
        path: PathBuf,
        /// What does not fit.
        source: FramesDiffer,
    },
    /// Lit and unlit frame cannot be scaled to each other.
    #[error("{}: {source}", path.display())]
    Ratio {
        /// The lit frame.
        path: PathBuf,
        /// Why.
        source: RatioError,
    },
    /// The picture of the patches.
    #[error(transparent)]
    Png(#[from] PngError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// What is to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ChartShot {
    /// The frame with the chart.
    pub on: PathBuf,
    /// The same without flash, to be taken off.
    pub off: Option<PathBuf>,
    /// Which chart it is; without it any that is known.
    pub chart: Option<ChartKind>,
    /// Outer corners of the four corner patches in any order, pixels from the top left corner; without them they
    /// are found.
    pub corners: Option<[[f64; 2]; 4]>,
}

/// A colour calibration as it is kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionColour {
    /// Fit, with `xyz_d50_from_camera`.
    #[serde(flatten)]
    pub fit: ColourFit,
    /// Linear sRGB (IEC 61966-2-1 primaries, D65, adapted by Bradford) of camera RGB in which white is (1, 1, 1).
    pub linear_srgb_from_camera: [[f64; 3]; 3],
    /// ACEScg (AP1, ACES white, adapted by Bradford) of camera RGB in which white is (1, 1, 1).
    pub acescg_from_camera: [[f64; 3]; 3],
    /// Whether the light is that of the flash alone, the room's taken off.
    pub room_light_taken_off: bool,
    /// Whether the chart was found without its corners being given.
    pub found_without_help: bool,
    /// Regions of patches that the finder saw; 0 where corners were given.
    pub patches_seen: usize,
    /// Exposure of the chart's shot: time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Seconds>,
    /// Exposure of the chart's shot: aperture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aperture: Option<FNumber>,
    /// Exposure of the chart's shot: sensitivity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<Iso>,
}

/// Finds the chart, fits the matrices and keeps them in the session.
pub fn calibrate(
    session: &Session,
    shot: &ChartShot,
    progress: &Progress,
) -> Result<Record<SessionColour>, ColourCalibrationError> {
    progress.report("reading the chart's frame", 0, 1);
    let mut series = Series::new(session, KIND)?;
    let on = series.read(&shot.on)?;
    progress.check()?;
    let off = shot.off.as_deref().map(|path| series.read(path)).transpose()?;
    let pair = match &off {
        Some(photo) => {
            let scale = SessionScale::load(session).map_err(SeriesError::from)?;
            let ratio = scale
                .room_ratio(&on.settings, &photo.settings)
                .map_err(|source| ColourCalibrationError::Ratio { path: shot.on.clone(), source })?;
            Some((&photo.mosaic, ratio as f32))
        }
        None => None,
    };
    let differ = |source| ColourCalibrationError::Differ {
        path: shot.off.clone().unwrap_or_else(|| shot.on.clone()),
        source,
    };
    let frame = ChartFrame::new(&on.mosaic, pair).map_err(differ)?;
    let found = seek(&frame, shot, progress)?;
    progress.report("fitting the matrix", 0, 1);
    let readings = frame.readings(&found.image_from_chart);
    let fit = fit_colour(found.kind, &readings, &found.image_from_chart)?;
    progress.check()?;
    let picture = picture(&frame, &fit)?;
    let verdict = fit.verdict();
    let figure = figure(&fit);
    let xyz_from_camera = colour::matrix(&fit.xyz_d50_from_camera);
    let Settings { shutter, aperture, iso, .. } = on.settings;
    let kept = SessionColour {
        linear_srgb_from_camera: colour::rows(&(LINEAR_SRGB.from_pcs() * xyz_from_camera)),
        acescg_from_camera: colour::rows(&(ACESCG.from_pcs() * xyz_from_camera)),
        room_light_taken_off: shot.off.is_some(),
        found_without_help: shot.corners.is_none(),
        patches_seen: found.patches_seen,
        shutter,
        aperture,
        iso,
        fit,
    };
    series.figure("png", picture);
    Ok(series.keep(kept, verdict, &figure, progress)?)
}

/// The session's colour calibration; `None` if it was not made.
pub fn load(session: &Session) -> Result<Option<Record<SessionColour>>, RecordError> {
    super::load(session, KIND)
}

impl SessionColour {
    /// Refuses a frame of another body or seen through another polariser: a matrix is of one sensor and all filters
    /// before it.
    pub fn fits(record: &Record<Self>, settings: &Settings, lighting: &Lighting) -> Result<(), OtherRig> {
        record.rig.same_body(settings, OF)?;
        record.rig.same_polariser(lighting, OF)
    }
}

/// Finds the chart; its plane maps to sensor sites.
fn seek(frame: &ChartFrame, shot: &ChartShot, progress: &Progress) -> Result<Found, ColourCalibrationError> {
    let kinds: Vec<ChartKind> = shot.chart.map_or_else(|| ChartKind::ALL.to_vec(), |kind| vec![kind]);
    let (width, height) = frame.size();
    let long = width.max(height);
    let mut last = 0;
    for (done, size) in SIZES.into_iter().enumerate() {
        progress.check()?;
        progress.report("seeking the chart", done, SIZES.len());
        let block = long.div_ceil(size).max(2);
        if block == last {
            continue;
        }
        last = block;
        let preview = frame.preview(block);
        let scale = block as f64;
        let found = match shot.corners {
            Some(corners) => {
                let corners = corners.map(|p| DVec2::from_array(p) / scale);
                colour::between(&preview, corners, &kinds)
            }
            None => colour::find(&preview, &kinds),
        };
        if let Some(found) = found {
            let image_from_chart = DMat3::from_scale(DVec2::splat(scale)) * found.image_from_chart;
            return Ok(Found { image_from_chart, ..found });
        }
    }
    let name = label(&shot.on);
    Err(match shot.corners {
        Some(_) => ColourError::NotBetween(name),
        None => ColourError::NoChart(name),
    }
    .into())
}

fn label(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// PNG of the frame, made small, with the patches' outlines.
fn picture(frame: &ChartFrame, fit: &ColourFit) -> Result<Vec<u8>, PngError> {
    let (width, height) = frame.size();
    let block = width.max(height).div_ceil(1200).max(2);
    let preview = frame.preview(block);
    let outlines: Vec<([DVec2; 4], bool)> = fit
        .patch_corners_px
        .iter()
        .zip(&fit.patches)
        .map(|(corners, patch)| {
            (corners.map(|p| DVec2::from_array(p) / block as f64), patch.left_out.is_none())
        })
        .collect();
    encode_rgb8(&overlay(&preview, fit.white_dn, &outlines))
}

pub(super) fn figure(fit: &ColourFit) -> Chart {
    let numbered = || fit.patches.iter().enumerate().map(|(k, patch)| ((k + 1) as f64, patch));
    Chart {
        caption: "Colour difference of each patch of the chart".into(),
        across: "patch, row by row".into(),
        up: "CIEDE2000".into(),
        series: vec![
            Points {
                name: "fitted".into(),
                points: numbered()
                    .filter(|(_, p)| p.left_out.is_none())
                    .map(|(k, p)| (k, p.delta_e_2000, 0.0))
                    .collect(),
            },
            Points {
                name: "fitted without it".into(),
                points: numbered()
                    .filter_map(|(k, p)| Some((k, p.leave_one_out_delta_e_2000?, 0.0)))
                    .collect(),
            },
        ],
    }
}
