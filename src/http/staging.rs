//! A scene's files, or a calibration's frames, on their way in: each part goes to the disk as it comes, into a folder
//! that is removed with [`SceneFiles`] or [`IncomingFrames`], or at once where anything fails.

use super::problem::Problem;
use super::routes::is_full;
use crate::calibration::guide::Role;
use crate::capture::{IncomingFrames, SceneFiles};
use crate::session::store;
use axum::extract::Multipart;
use axum::extract::multipart::Field;
use axum::http::StatusCode;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};
use tokio::fs::File;
use tokio::io::AsyncWriteExt;

/// Uploads that may come in at the same time.
pub(super) const AT_ONCE: usize = 2;
/// Parts of one upload.
const MOST_PARTS: usize = 100;
/// Longest part that is no file, in bytes.
const TEXT_LIMIT: usize = 4096;
/// Longest file name in bytes.
const NAME_LIMIT: usize = 200;

/// Writes the form's files to a folder of their own in `place`, meshes numbered so that equal names do not collide.
pub(super) async fn stage(mut form: Multipart, place: &Path) -> Result<SceneFiles, Problem> {
    tokio::fs::create_dir_all(place).await.map_err(refused)?;
    let folder =
        tempfile::Builder::new().prefix(store::TEMPORARY_PREFIX).tempdir_in(place).map_err(refused)?;
    let cameras_dir = folder.path().join("cameras");
    tokio::fs::create_dir(&cameras_dir).await.map_err(refused)?;
    let (mut cameras, mut meshes) = (Vec::new(), Vec::new());
    let (mut unit, mut scale) = ("m".to_owned(), 1.0);
    let mut left = MOST_PARTS;
    while let Some(part) = form.next_field().await? {
        left =
            left.checked_sub(1).ok_or_else(|| invalid(format!("there are more than {MOST_PARTS} parts")))?;
        match part.name() {
            Some("cameras") => cameras.push(keep(part, &cameras_dir).await?),
            Some("mesh") => {
                let own = own_folder(&folder, &format!("mesh-{}", meshes.len())).await?;
                meshes.push(keep(part, &own).await?);
            }
            Some("unit") => unit = text(part).await?,
            Some("scale") => {
                let given = text(part).await?;
                scale = given.trim().parse().map_err(|_| unfit("scale", &given, "a number"))?;
            }
            other => {
                return Err(invalid(format!(
                    "part {other:?} is unknown; send cameras, mesh, unit and scale"
                )));
            }
        }
    }
    let cameras = match cameras.as_slice() {
        [] => return Err(invalid("no part named cameras was sent")),
        [one] => one.clone(),
        _ => cameras_dir,
    };
    if meshes.is_empty() {
        return Err(invalid("no part named mesh was sent"));
    }
    Ok(SceneFiles { folder, cameras, meshes, unit, scale })
}

/// Writes a calibration's frames to a folder of their own in `place`, each into one of its own, in their order.
pub(super) async fn stage_frames(mut form: Multipart, place: &Path) -> Result<IncomingFrames, Problem> {
    tokio::fs::create_dir_all(place).await.map_err(refused)?;
    let folder =
        tempfile::Builder::new().prefix(store::TEMPORARY_PREFIX).tempdir_in(place).map_err(refused)?;
    let mut staged = IncomingFrames { folder, role: None, distance_m: None, frames: Vec::new(), off: None };
    let mut left = MOST_PARTS;
    while let Some(part) = form.next_field().await? {
        left =
            left.checked_sub(1).ok_or_else(|| invalid(format!("there are more than {MOST_PARTS} parts")))?;
        match part.name() {
            Some("file") => {
                let own = own_folder(&staged.folder, &format!("file-{}", staged.frames.len())).await?;
                staged.frames.push(keep(part, &own).await?);
            }
            Some("off") if staged.off.is_none() => {
                let own = own_folder(&staged.folder, "off").await?;
                staged.off = Some(keep(part, &own).await?);
            }
            Some("role") => {
                let given = text(part).await?;
                let role = serde_json::from_value::<Role>(given.trim().into());
                staged.role = Some(role.map_err(|_| unfit("role", &given, "one that the guide names"))?);
            }
            Some("distance_m") => {
                let given = text(part).await?;
                let distance = given.trim().parse();
                staged.distance_m = Some(distance.map_err(|_| unfit("distance_m", &given, "a number"))?);
            }
            other => {
                return Err(invalid(format!(
                    "part {other:?} is unknown or came twice; send file, and role, off and distance_m where they belong"
                )));
            }
        }
    }
    match staged.frames.is_empty() {
        true => Err(invalid("no part named file was sent")),
        false => Ok(staged),
    }
}

async fn own_folder(folder: &tempfile::TempDir, name: &str) -> Result<PathBuf, Problem> {
    let own = folder.path().join(name);
    tokio::fs::create_dir(&own).await.map_err(refused)?;
    Ok(own)
}

fn unfit(part: &str, given: &str, wanted: &str) -> Problem {
    Problem::bad_request("value_invalid", format!("{part} is {given:?}, but must be {wanted}"))
}

/// Writes one part under its own file name.
async fn keep(mut part: Field<'_>, folder: &Path) -> Result<PathBuf, Problem> {
    let name = part.file_name().unwrap_or_default().to_owned();
    let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', '\0']);
    if !plain || name.len() > NAME_LIMIT {
        return Err(invalid(format!(
            "file name {name:?} cannot be used; send each file with its plain name"
        )));
    }
    let path = folder.join(&name);
    let mut file = File::create_new(&path).await.map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => invalid(format!("two files are named {name:?}; give each its own name")),
        _ => refused(error),
    })?;
    while let Some(chunk) = part.chunk().await? {
        file.write_all(&chunk).await.map_err(refused)?;
    }
    file.flush().await.map_err(refused)?;
    Ok(path)
}

/// A part that is no file.
async fn text(mut part: Field<'_>) -> Result<String, Problem> {
    let name = part.name().unwrap_or_default().to_owned();
    let mut bytes = Vec::new();
    while let Some(chunk) = part.chunk().await? {
        if bytes.len() + chunk.len() > TEXT_LIMIT {
            let words = format!("part {name} is larger than the {TEXT_LIMIT} bytes that are taken here");
            return Err(Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "body_too_large", words));
        }
        bytes.extend_from_slice(&chunk);
    }
    String::from_utf8(bytes).map_err(|_| invalid(format!("part {name} is no text in UTF-8")))
}

fn invalid(words: impl std::fmt::Display) -> Problem {
    Problem::bad_request("body_invalid", words)
}

/// The disk does not take it.
fn refused(error: Error) -> Problem {
    if is_full(&error) {
        let words = format!("the upload cannot be kept: {error}; make room on the disk of the sessions");
        return Problem::new(StatusCode::CONFLICT, "disk_full", words);
    }
    Problem::internal(error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::{Body, Bytes};
    use axum::extract::{FromRequest, Request};
    use axum::response::IntoResponse;
    use tokio::sync::mpsc;
    use tokio_stream::StreamExt;
    use tokio_stream::wrappers::ReceiverStream;

    async fn form(body: Body) -> Multipart {
        let request = Request::builder().header("Content-Type", "multipart/form-data; boundary=cut");
        Multipart::from_request(request.body(body).unwrap(), &()).await.unwrap()
    }

    fn part(name: &str, file: &str, text: &str) -> String {
        let file = if file.is_empty() { String::new() } else { format!("; filename=\"{file}\"") };
        format!("--cut\r\nContent-Disposition: form-data; name=\"{name}\"{file}\r\n\r\n{text}\r\n")
    }

    fn count(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[tokio::test]
    async fn what_is_refused_leaves_nothing_behind() {
        let place = tempfile::tempdir().unwrap();
        let (cameras, mesh) = (part("cameras", "a.xml", "<a/>"), part("mesh", "o.obj", "v 0 0 0"));
        let large = "x".repeat(TEXT_LIMIT + 1);
        for (wrong, status) in [
            (part("unit", "", &large), 413),
            (part("scale", "", &large), 413),
            (part("scale", "", "much"), 400),
            (part("cameras", "a.xml", "again"), 400),
            (part("mesh", "../o.obj", ""), 400),
            (part("picture", "", ""), 400),
            (part("unit", "", "m").repeat(MOST_PARTS - 1), 400),
        ] {
            let body = format!("{cameras}{mesh}{wrong}--cut--\r\n");
            let problem = stage(form(body.into()).await, place.path()).await.unwrap_err();
            assert_eq!(problem.into_response().status().as_u16(), status, "{wrong:.100}");
            assert_eq!(count(place.path()), 0, "{wrong:.100}");
        }
        let body = format!("{cameras}{mesh}{}--cut--\r\n", part("unit", "", &large[..TEXT_LIMIT]));
        let files = stage(form(body.into()).await, place.path()).await.unwrap();
        assert_eq!((files.unit.len(), count(place.path())), (TEXT_LIMIT, 1));
        drop(files);
        assert_eq!(count(place.path()), 0);
    }

    #[tokio::test]
    async fn a_part_is_on_the_disk_as_far_as_it_came_and_gone_when_it_breaks_off() {
        const PIECE: usize = 1 << 18;
        let place = tempfile::tempdir().unwrap();
        let (send, pieces) = mpsc::channel(1);
        let pieces = ReceiverStream::new(pieces).map(|piece: Option<Bytes>| piece.ok_or("broken off"));
        let (form, staged_in) = (form(Body::from_stream(pieces)).await, place.path().to_owned());
        let staging = tokio::spawn(async move { stage(form, &staged_in).await.map(drop) });
        send.send(Some(part("mesh", "o.obj", "").trim_end().to_owned().into())).await.unwrap();
        send.send(Some("\r\n\r\n".into())).await.unwrap();
        for come in 1..=4 {
            send.send(Some(vec![b'v'; PIECE].into())).await.unwrap();
            let there = || {
                let folder = std::fs::read_dir(place.path()).unwrap().next()?.unwrap().path();
                std::fs::metadata(folder.join("mesh-0/o.obj")).ok().map(|about| about.len() as usize)
            };
            // Of a piece, the end may be the beginning of the boundary.
            let end = std::time::Instant::now() + std::time::Duration::from_secs(20);
            while there().is_none_or(|length| length < (come - 1) * PIECE) {
                assert!(std::time::Instant::now() < end, "piece {come} is nowhere");
                tokio::task::yield_now().await;
            }
        }
        send.send(None).await.unwrap();
        assert!(staging.await.unwrap().is_err());
        assert_eq!(count(place.path()), 0);
    }
}
