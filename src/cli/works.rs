//! The processing that `unlit serve` sets off, as the desk wants it.

use crate::capture::{FlashCard, SceneFiles, Works};
use crate::jobs::WorkError;
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
        has_flash_calibration: Arc::new(|session| session.calibration_dir().join("flash.json").is_file()),
    }
}

fn process(_session: &Session, (): (), _progress: &Progress) -> Result<Value, WorkError> {
    Err(WorkError::failed("unavailable", "this build cannot process; use one that has `unlit process`"))
}

fn calibrate_flash(_session: &Session, _card: FlashCard, _progress: &Progress) -> Result<Value, WorkError> {
    Err(WorkError::failed("unavailable", "this build cannot calibrate; use one that has `unlit calibrate`"))
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
        scene::import(session.path(), &files.cameras, &files.meshes, lengths, progress).map_err(|error| {
            match error {
                SceneError::Cancelled(_) => WorkError::Cancelled,
                other => WorkError::failed("scene_failed", other),
            }
        })?;
    Ok(json!({
        "cameras": file.cameras.len(),
        "without_pose": file.without_pose,
        "meshes": file.meshes.iter().map(|m| &m.name).collect::<Vec<_>>(),
        "warnings": file.check.warnings,
    }))
}
