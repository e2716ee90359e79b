//! The processing that `unlit serve` sets off, as the desk wants it.

use crate::calibration::Plane;
use crate::calibration::guide::Kind;
use crate::capture::{FlashCard, SceneFiles, Works, calibration_frames};
use crate::jobs::WorkError;
use crate::pipeline::calibrate::guided::{self, FitOrder};
use crate::pipeline::calibrate::waiting;
use crate::pipeline::flash::{self, CardFiles};
use crate::pipeline::process::{self, ProcessError, ProcessOptions};
use crate::pipeline::scene::{self, Lengths, SceneError, Unit};
use crate::pipeline::standing;
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
        calibrate: on_pool(&pool, calibrate),
        import_scene: Arc::new(import_scene),
        has_scene: Arc::new(|session| session.scene_dir().join("scene.json").is_file()),
        has_flash_calibration: Arc::new(flash::exists),
        // What lacks something to be made from is told by whoever asks for it.
        needs_processing: Arc::new(|session| standing::is_due(session).unwrap_or(false)),
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
    let FlashCard { order, shots } = card;
    let failed = |error| WorkError::failed("calibration_failed", error);
    let mut sent = waiting::list(session, Kind::Flash).map_err(failed)?;
    let wanted = |id: &str| order.one_shot.as_ref().is_none_or(|one| one == id);
    sent.retain(|shot| wanted(&shot.number.to_string()));
    let mut files = vec![];
    for shot in shots.iter().filter(|shot| wanted(&shot.name)) {
        let (off, on) = calibration_frames(session, shot);
        let held_out = order.held_out.contains(&shot.name);
        let plane = Some(Plane::facing(shot.distance_m));
        files.push(CardFiles { plane, on, off: Some(off), held_out });
    }
    for shot in &sent {
        let (on, off) = waiting::card_frames(session, shot).map_err(failed)?;
        let plane = shot.distance_m.map(Plane::facing);
        files.push(CardFiles { plane, on, off, held_out: order.held_out.contains(&shot.number.to_string()) });
    }
    let facts = order.facts();
    let record = match order.one_shot {
        Some(_) => flash::correct(session, &files, &facts, progress),
        None => flash::calibrate(session, &files, &facts, progress),
    };
    let record = record.map_err(stopped_or_failed(progress))?;
    if record.verdict.good {
        guided::settle(session, Kind::Flash, sent.iter().map(|shot| shot.number)).map_err(failed)?;
    }
    Ok(json!(record))
}

fn calibrate(session: &Session, order: FitOrder, progress: &Progress) -> Result<Value, WorkError> {
    guided::fit(session, &order, progress).map_err(stopped_or_failed(progress))
}

fn stopped_or_failed<E: std::fmt::Display>(progress: &Progress) -> impl FnOnce(E) -> WorkError {
    let cancelled = progress.is_cancelled();
    move |error| if cancelled { WorkError::Cancelled } else { WorkError::failed("calibration_failed", error) }
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
