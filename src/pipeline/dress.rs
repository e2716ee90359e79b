//! What shows a finished texture: `model/model.glb` and `model/report.html`.
//!
//! Made anew without solving when the colour calibration or the certificate changes.

use super::certify::{CertificateError, Standing};
use super::manifest::{StageManifest, digest};
use super::output::up;
use super::process::{Inputs, ProcessError, ProcessSummary, io};
use super::report::{self, Estimates, Told};
use super::scene::SceneError;
use crate::codec::exr_image;
use crate::export::colour::LINEAR_SRGB;
use crate::export::glb::{self, Colour, Model};
use crate::raster::Rgb;
use crate::reflectance::solve::Estimate;
use crate::session::{Session, store};
use serde_json::json;
use std::path::Path;

const STAGE: &str = "model";

/// Makes what is not made yet from the texture whose inputs have the digest `texture`; tells whether anything was.
pub(super) fn dress(
    session: &Session,
    inputs: &Inputs,
    summary: &ProcessSummary,
    texture: &str,
    manifest: &mut StageManifest,
) -> Result<bool, ProcessError> {
    let (certificate, _) = certificate(session)?;
    let key = key(inputs, texture, certificate.as_ref());
    if manifest.is_done(session, STAGE, &key) {
        return Ok(false);
    }
    make(session, inputs, summary, certificate.as_ref())?;
    let outputs = ["model/model.glb", "model/report.html"].map(str::to_owned);
    manifest.note(session, STAGE, &key, &outputs).map_err(io(&session.derived_dir()))?;
    Ok(true)
}

/// Whether [`dress`] would have nothing to do.
pub(super) fn is_done(
    session: &Session,
    inputs: &Inputs,
    texture: &str,
    manifest: &StageManifest,
) -> Result<bool, ProcessError> {
    let (certificate, _) = certificate(session)?;
    Ok(manifest.is_done(session, STAGE, &key(inputs, texture, certificate.as_ref())))
}

/// The session's certificate. One of an earlier version of unlit counts as none, and what is to be said of it comes second.
pub(super) fn certificate(session: &Session) -> Result<(Option<Standing>, Option<String>), CertificateError> {
    match Standing::load(session) {
        Err(older @ CertificateError::Older(_)) => Ok((None, Some(older.to_string()))),
        found => Ok((found?, None)),
    }
}

fn key(inputs: &Inputs, texture: &str, certificate: Option<&Standing>) -> String {
    let (colours, certificate) = (format!("{:?}", inputs.colours), format!("{certificate:?}"));
    digest(&[texture, &colours, &certificate].map(str::as_bytes))
}

fn make(
    session: &Session,
    inputs: &Inputs,
    summary: &ProcessSummary,
    certificate: Option<&Standing>,
) -> Result<(), ProcessError> {
    let model = session.model_dir();
    let reflectance = read(&model.join("reflectance.exr"))?;
    let mut object = inputs.scene.meshes.first().ok_or(SceneError::NoMesh)?.clone();
    if summary.turned.contains(&object.name) {
        object.triangles.iter_mut().chain(&mut object.uv_triangles).for_each(|t| t.swap(1, 2));
    }
    let mut provenance = super::export::provenance(session, summary, certificate);
    let matrix = inputs.colours.matrix.as_ref();
    if let Some(matrix) = matrix {
        provenance["colour"] = json!({ "space": LINEAR_SRGB.name, "basis": matrix.basis });
    }
    let glb = glb::encode(&Model {
        mesh: &object,
        texture: &reflectance,
        colour: matrix
            .map_or(Colour::Uncalibrated, |matrix| Colour::CameraRgb(matrix.to(&LINEAR_SRGB).as_mat3())),
        up: up(&inputs.scene.cameras),
        provenance,
    })?;
    let path = model.join("model.glb");
    store::write_atomic(&path, &glb).map_err(io(&path))?;
    let deviation = read(&model.join("stddev.exr"))?;
    let counts = exr_image::read(&model.join("views.exr"))?;
    let (width, height) = (reflectance.width(), reflectance.height());
    let views = counts.channel("Y").filter(|views| views.len() == width * height);
    let views = views.ok_or_else(|| ProcessError::Stale(model.join("views.exr")))?;
    let at = |x: usize, y: usize| {
        let seen = views[y * width + x];
        (seen > 0.0).then(|| Estimate {
            rho: *reflectance.at(x, y),
            sd: *deviation.at(x, y),
            views: seen as u16,
        })
    };
    let report = report::html(&Told {
        manifest: &session.manifest(),
        calibration: &inputs.calibration,
        pairs: inputs.matched.iter().map(|(pair, _)| &**pair).collect(),
        summary,
        flash: &inputs.flash,
        colours: &inputs.colours,
        certificate,
        estimates: Estimates { size: (width, height), at: &at },
    })?;
    let path = model.join("report.html");
    store::write_atomic(&path, report.as_bytes()).map_err(io(&path))
}

/// A square RGB picture of the model.
fn read(path: &Path) -> Result<Rgb, ProcessError> {
    let found = exr_image::read(path)?.rgb().filter(|image| image.width() == image.height());
    found.ok_or_else(|| ProcessError::Stale(path.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_of_an_earlier_version_counts_as_none_and_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        std::fs::create_dir_all(session.model_dir()).unwrap();
        let of = |text: &str| {
            std::fs::write(session.model_dir().join("certificate.json"), text).unwrap();
            certificate(&session)
        };
        let (none, told) = of(r#"{ "schema": 1, "patches": [] }"#).unwrap();
        assert_eq!(none, None);
        assert!(told.unwrap().contains("certify again"));
        assert!(matches!(of(r#"{ "schema": 1000 }"#), Err(CertificateError::TooNew { .. })));
        assert!(matches!(of("{"), Err(CertificateError::Damaged { .. })));
    }
}
