//! The processing that `unlit serve` sets off, as the desk wants it.

use crate::capture::{CalibrationShot, FlashCard, SceneFiles, Works};
use crate::jobs::WorkError;
use crate::pipeline::flash::{self, CardFacts, CardFiles, FlashError};
use crate::pipeline::process::{self, ProcessError, ProcessOptions};
use crate::pipeline::scene::{self, Lengths, SceneError, Unit};
use crate::progress::Progress;
use crate::session::Session;
use serde_json::{Value, json};
use std::sync::Arc;

pub(super) fn works() -> Works {
    Works {
        process: Arc::new(process),
        calibrate_flash: Arc::new(calibrate_flash),
        import_scene: Arc::new(import_scene),
        has_scene: Arc::new(|session| session.scene_dir().join("scene.json").is_file()),
        has_flash_calibration: Arc::new(flash::exists),
    }
}

fn process(session: &Session, (): (), progress: &Progress) -> Result<Value, WorkError> {
    let summary =
        process::process(session, &ProcessOptions::default(), progress).map_err(|error| match error {
            ProcessError::Cancelled(_) => WorkError::Cancelled,
            other => WorkError::failed("process_failed", other),
        })?;
    Ok(json!(summary))
}

fn calibrate_flash(session: &Session, card: FlashCard, progress: &Progress) -> Result<Value, WorkError> {
    let folder = session.calibration_dir().join("flash");
    let files = |shot: CalibrationShot| {
        let place = folder.join(&shot.name);
        let off = Some(place.join(&shot.off.file));
        CardFiles { distance: shot.distance_m, on: place.join(&shot.on.file), off }
    };
    let shots: Vec<CardFiles> = card.shots.into_iter().map(files).collect();
    let facts = CardFacts {
        target_reflectance: card.target_reflectance,
        ring_radii: card.ring_radii,
        focal_px: None,
    };
    let fit = flash::calibrate(session, &shots, facts, progress).map_err(|error| match error {
        FlashError::Cancelled(_) => WorkError::Cancelled,
        other => WorkError::failed("calibration_failed", other),
    })?;
    Ok(json!(fit))
}

fn import_scene(session: &Session, files: SceneFiles, progress: &Progress) -> Result<Value, WorkError> {
    let unit = match files.unit.trim() {
        "m" => Unit::Metre,
        "cm" => Unit::Centimetre,
        "mm" => Unit::Millimetre,
        other => {
            return Err(WorkError::failed("value_invalid", format!("unit is {other:?}; give m, cm or mm")));
        }
    };
    let lengths = Lengths { unit, scale: files.scale };
    let file =
        scene::import(session, &files.cameras, &files.meshes, lengths, progress).map_err(
            |error| match error {
                SceneError::Cancelled(_) => WorkError::Cancelled,
                other => WorkError::failed("scene_failed", other),
            },
        )?;
    Ok(json!({
        "cameras": file.cameras.len(),
        "without_pose": file.without_pose,
        "meshes": file.meshes.iter().map(|m| &m.name).collect::<Vec<_>>(),
        "warnings": file.check.warnings,
    }))
}
