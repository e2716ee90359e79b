//! The processing that `unlit serve` sets off, as the desk wants it.

use crate::calibration::{Plane, Target};
use crate::capture::{CalibrationShot, FlashCard, SceneFiles, Works};
use crate::jobs::WorkError;
use crate::pipeline::flash::{self, CardFacts, CardFiles, FlashError};
use crate::pipeline::process::{self, ProcessError, ProcessOptions};
use crate::pipeline::scene::{self, Lengths, SceneError, Unit};
use crate::progress::Progress;
use crate::session::Session;
use serde_json::{Value, json};
use std::sync::Arc;

/// The daemon's processing, on threads of its own, one fewer than cores but two at least, so that the checks of
/// the pair being shot never wait behind a long computation.
pub(super) fn works() -> Result<Works, rayon::ThreadPoolBuildError> {
    let cores = std::thread::available_parallelism().map_or(2, |n| n.get());
    let threads = (cores - 1).max(2);
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("processing {i}"));
    let pool = Arc::new(pool.build()?);
    Ok(Works {
        process: on_pool(&pool, process),
        calibrate_flash: on_pool(&pool, calibrate_flash),
        import_scene: Arc::new(import_scene),
        has_scene: Arc::new(|session| session.scene_dir().join("scene.json").is_file()),
        has_flash_calibration: Arc::new(flash::exists),
        // What lacks something to be made from is told by whoever asks for it.
        needs_processing: Arc::new(|session| process::is_due(session).unwrap_or(false)),
    })
}

type Work<T> = Arc<dyn Fn(&Session, T, &Progress) -> Result<Value, WorkError> + Send + Sync>;

fn on_pool<T: Send + 'static>(
    pool: &Arc<rayon::ThreadPool>,
    work: fn(&Session, T, &Progress) -> Result<Value, WorkError>,
) -> Work<T> {
    let pool = pool.clone();
    Arc::new(move |session, what, progress| pool.install(|| work(session, what, progress)))
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
        CardFiles {
            plane: Some(Plane::facing(shot.distance_m)),
            on: place.join(&shot.on.file),
            off,
            held_out: false,
        }
    };
    let shots: Vec<CardFiles> = card.shots.into_iter().map(files).collect();
    let facts = CardFacts::plain(Target::lambertian(card.target_reflectance), card.ring_radii);
    let fit = flash::calibrate(session, &shots, &facts, progress).map_err(|error| match error {
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
