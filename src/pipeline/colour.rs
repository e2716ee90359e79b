//! What a session's camera RGB is worth in colour: the matrix of a chart that was shot with this very body
//! (`calibration/colour.json`), else the maker's for the model, which the raws or the decoder's table tell.

use super::calibrate::colour::{KIND, SessionColour, load};
use super::calibrate::{self, RecordError};
use crate::calibration::colour::{Lab, lab, matrix, rows};
use crate::calibration::{OtherRig, Record};
use crate::codec::raw::RawError;
use crate::codec::raw::colour::{self as raw_colour, CameraColour};
use crate::export::colour::{Space, of_maker};
use crate::pair::PairRecord;
use crate::session::{Session, store};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Why nothing can be said of a session's colours.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ColoursError {
    /// The chart's calibration cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// It is another camera's.
    #[error(
        "the colours of pair {pair} cannot be told by {}: {source}; shoot the chart with the camera and the polariser of the pairs (`unlit calibrate colour`), or remove that file to go by the maker's matrix", file.display()
    )]
    OtherRig {
        /// The pair.
        pair: String,
        /// The calibration.
        file: PathBuf,
        /// What differs.
        source: Box<OtherRig>,
    },
    /// A photo's colour tags cannot be read.
    #[error(transparent)]
    Raw(#[from] RawError),
}

/// Where a matrix comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "from", rename_all = "snake_case")]
pub enum Basis {
    /// A chart, shot with this body.
    Chart {
        /// The calibration, from the session's folder.
        file: String,
        /// Its digest.
        blake3: String,
        /// When it was made, UTC.
        measured: String,
        /// The chart.
        chart: String,
        /// Mean CIEDE2000 of patches that were not fitted.
        leave_one_out_delta_e_2000_mean: f64,
        /// The largest of them.
        leave_one_out_delta_e_2000_max: f64,
    },
    /// The maker's, for the model.
    Maker {
        /// As file or table have it.
        camera: CameraColour,
    },
}

impl Basis {
    /// In words.
    pub fn words(&self) -> String {
        match self {
            Self::Chart { chart, measured, leave_one_out_delta_e_2000_mean: mean, .. } => format!(
                "measured with a chart ({chart}, {} UTC; CIEDE2000 of patches that were not fitted {mean:.2} on average)",
                measured.get(..16).unwrap_or(measured).replace('T', " ")
            ),
            Self::Maker { .. } => "the maker's matrix for the camera model, not measured on this body".into(),
        }
    }
}

/// From camera RGB, white being (1, 1, 1), to CIE XYZ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionMatrix {
    /// CIE XYZ under D50, white Y = 1; rows.
    pub xyz_d50_from_camera: [[f64; 3]; 3],
    /// What a white surface reads on the sensor, green being 1.
    pub white: [f64; 3],
    /// Where it comes from.
    pub basis: Basis,
}

impl SessionMatrix {
    /// CIE XYZ under D50 of camera RGB.
    pub fn xyz_from_camera(&self) -> DMat3 {
        matrix(&self.xyz_d50_from_camera)
    }

    /// A space's values of camera RGB; white stays white.
    pub fn to(&self, space: &Space) -> DMat3 {
        space.from_pcs() * self.xyz_from_camera()
    }

    /// CIELAB under D50 of camera RGB.
    pub fn lab(&self, rgb: [f64; 3]) -> Lab {
        lab(self.xyz_from_camera() * DVec3::from_array(rgb))
    }
}

/// What is known of a session's colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionColours {
    /// The matrix; absent where nobody knows one.
    pub matrix: Option<SessionMatrix>,
    /// What people must be told, if anything.
    pub note: Option<String>,
}

impl SessionColours {
    /// By a chart alone; refuses one of another body than the pairs', or through another polariser.
    pub fn measured(session: &Session, pairs: &[&PairRecord]) -> Result<Self, ColoursError> {
        let Some(record) = load(session)? else { return Ok(Self::default()) };
        let file = calibrate::file(session, KIND);
        for pair in pairs {
            let fits = SessionColour::fits(&record, &pair.on.settings, &pair.lighting);
            fits.map_err(|source| ColoursError::OtherRig {
                pair: pair.name.clone(),
                file: file.clone(),
                source: Box::new(source),
            })?;
        }
        let blake3 = store::digest_file(&file).map_err(|source| RecordError::Io { path: file, source })?;
        Ok(Self::of(record, blake3))
    }

    fn of(record: Record<SessionColour>, blake3: String) -> Self {
        if !record.verdict.good {
            let why = record.verdict.sentences.into_iter().next().unwrap_or_default();
            let note = format!("the session's colour calibration is not good enough and was not used: {why}");
            return Self { matrix: None, note: Some(note) };
        }
        let note = (!record.rig.tells_body()).then(|| {
            "THE CHART'S SHOT TELLS NO CAMERA: the colours are taken to be those of the body that took the photos, which \
             nobody checked."
                .to_owned()
        });
        let (measured, fit) = (record.measured, record.fit.fit);
        let white = DVec3::from_array(fit.white_dn);
        let basis = Basis::Chart {
            file: "calibration/colour.json".into(),
            blake3,
            measured,
            chart: fit.chart.name().into(),
            leave_one_out_delta_e_2000_mean: fit.leave_one_out.mean,
            leave_one_out_delta_e_2000_max: fit.leave_one_out.max,
        };
        let white = (white / white.y).to_array();
        let matrix = SessionMatrix { xyz_d50_from_camera: fit.xyz_d50_from_camera, white, basis };
        Self { matrix: Some(matrix), note }
    }

    /// By a chart, else by the maker's matrix.
    pub fn known(session: &Session, pairs: &[&PairRecord]) -> Result<Self, ColoursError> {
        let measured = Self::measured(session, pairs)?;
        // All pairs of a session are one camera's; one file tells what the others do.
        let Some(pair) = pairs.first().filter(|_| measured.matrix.is_none()) else { return Ok(measured) };
        let file = session.pair_dir(*pair).join(&pair.on.file);
        let matrix = raw_colour::read(&file)?.map(|camera| {
            let (white, xyz_d50_from_camera) = of_maker(&camera);
            SessionMatrix {
                xyz_d50_from_camera: rows(&xyz_d50_from_camera),
                white: white.to_array(),
                basis: Basis::Maker { camera },
            }
        });
        Ok(Self { matrix, note: measured.note })
    }
}
