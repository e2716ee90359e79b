//! The committed renders: noise-free images of all stops, kept under the digest of everything that made them.
//!
//! One half-float OpenEXR file a stop with the channels `ambient.*`, `flash.*` (radiance), `albedo.*`
//! (reflectance) and `object` (share of the pixel), and a manifest. They lie inside the program. A stop whose
//! digest is not the one that the present code would give is rendered anew.

use super::WorldError;
use super::path::{self, Seen, Surface};
use super::render::{self, Effort, Render};
use super::stage;
use crate::codec::exr_half::{self, Planes};
use crate::progress::Progress;
use crate::raster::Image;
use crate::scene::Camera;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Where `unlit studio render` keeps the renders, seen from the root of the source tree.
pub const SOURCE_FOLDER: &str = "studio/renders";

const MANIFEST: &str = "manifest.json";

#[derive(rust_embed::Embed)]
#[folder = "studio/renders"]
struct Embedded;

/// What is known of one stop's file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Entry {
    /// Digest of what made it.
    made_from: String,
    /// Digest of the file itself.
    file: String,
    /// Standard error of a pixel of the object by flash light over the mean; see [`Render::noise`].
    noise: f64,
}

type Manifest = std::collections::BTreeMap<String, Entry>;

fn file_name(camera: &Camera) -> String {
    format!("{}.exr", camera.name)
}

/// BLAKE3 of everything that a stop's render depends on: surfaces, lamps, ring, camera, tracer and effort.
pub(super) fn digest(surfaces: &[Surface], camera: &Camera, effort: Effort) -> String {
    let mut hasher = blake3::Hasher::new();
    // Poses come from sines; rounded to a nanometre, they are the same on every machine.
    let pose = camera.world_from_camera.to_cols_array().map(|x| (x * 1e9).round() as i64);
    let plain = format!(
        "{} {effort:?} {:?} {:?} {:?} {:?} {pose:?}",
        path::VERSION,
        stage::GLOW,
        stage::LAMPS,
        stage::RING,
        camera.intrinsics
    );
    hasher.update(plain.as_bytes());
    for surface in surfaces {
        let mesh = &surface.mesh;
        let counts = [mesh.positions.len(), mesh.triangles.len(), mesh.uvs.len(), surface.reflectance.size];
        hasher.update(format!("surface {counts:?} {:?}", surface.emission).as_bytes());
        if let Some(varnish) = surface.varnish {
            hasher.update(format!("{varnish:?}").as_bytes());
        }
        for position in &mesh.positions {
            for x in position.to_array() {
                hasher.update(&x.to_le_bytes());
            }
        }
        for uv in &mesh.uvs {
            hasher.update(&uv.x.to_le_bytes());
            hasher.update(&uv.y.to_le_bytes());
        }
        for index in mesh.triangles.iter().chain(&mesh.uv_triangles).flatten() {
            hasher.update(&index.to_le_bytes());
        }
        for value in surface.reflectance.texels.iter().flatten() {
            hasher.update(&value.to_le_bytes());
        }
    }
    hasher.finalize().to_hex().to_string()
}

fn manifest(bytes: Option<&[u8]>) -> Manifest {
    // No manifest, or one of another kind, means that nothing is known: all is rendered.
    bytes.and_then(|b| serde_json::from_slice(b).ok()).unwrap_or_default()
}

/// The render in `bytes`, if the manifest's entry says that it is of this digest and whole.
fn stored(
    entry: Option<&Entry>,
    bytes: Option<&[u8]>,
    digest: &str,
    camera: &Camera,
) -> Result<Option<Render>, WorldError> {
    let (Some(entry), Some(bytes)) = (entry, bytes) else { return Ok(None) };
    if entry.made_from != digest || entry.file != blake3::hash(bytes).to_hex().to_string() {
        return Ok(None);
    }
    let image = unpack(bytes, camera)?;
    Ok(Some(Render { image, noise: entry.noise }))
}

/// The renders of all stops: from inside the program where they fit it, else traced now, which takes minutes.
pub(super) fn load(
    surfaces: &[Surface],
    cameras: &[Camera],
    progress: &Progress,
) -> Result<Vec<Render>, WorldError> {
    let embedded = Embedded::get(MANIFEST);
    let manifest = manifest(embedded.as_ref().map(|f| f.data.as_ref()));
    let mut tracer = None;
    let mut renders = Vec::new();
    for camera in cameras {
        progress.check()?;
        let file = Embedded::get(&file_name(camera));
        let digest = digest(surfaces, camera, render::FULL);
        let bytes = file.as_ref().map(|f| f.data.as_ref());
        if let Some(render) = stored(manifest.get(&camera.name), bytes, &digest, camera)? {
            renders.push(render);
            continue;
        }
        tracing::warn!(
            "the stored render of stop {} does not fit this program; rendering it now. \
             `unlit studio render` renews all stored renders",
            camera.name
        );
        let tracer = tracer.get_or_insert_with(|| stage::tracer(surfaces));
        let rows = 0..camera.intrinsics.height;
        renders.push(render::render(tracer, &stage::RING, camera, render::FULL, rows, progress)?);
    }
    Ok(renders)
}

/// One line about a stored stop.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredStop {
    /// Name of the stop.
    pub name: String,
    /// Whether it was rendered now; otherwise the stored one still fitted.
    pub rendered: bool,
    /// Standard error of one pixel of the object by flash light, over the mean.
    pub noise: f64,
    /// Bytes of the file.
    pub bytes: usize,
}

/// Renders the stops whose file in `folder` does not fit the present code, and writes them there: those numbered
/// in `only`, or all when it is empty. May be stopped and started again: finished stops stay.
pub fn renew(folder: &Path, only: &[usize], progress: &Progress) -> Result<Vec<StoredStop>, WorldError> {
    let io = |source| WorldError::Folder { folder: folder.to_owned(), source };
    std::fs::create_dir_all(folder).map_err(io)?;
    let surfaces = stage::surfaces();
    let in_folder = || manifest(std::fs::read(folder.join(MANIFEST)).ok().as_deref());
    let mut tracer = None;
    let mut summary = Vec::new();
    for (k, camera) in stage::cameras().into_iter().enumerate() {
        if !only.is_empty() && !only.contains(&(k + 1)) {
            continue;
        }
        let digest = digest(&surfaces, &camera, render::FULL);
        let place = folder.join(file_name(&camera));
        let old = std::fs::read(&place).ok();
        if let (Some(entry), Some(bytes)) = (in_folder().get(&camera.name), &old)
            && stored(Some(entry), Some(bytes), &digest, &camera)?.is_some()
        {
            summary.push(StoredStop {
                name: camera.name.clone(),
                rendered: false,
                noise: entry.noise,
                bytes: bytes.len(),
            });
            continue;
        }
        let tracer = tracer.get_or_insert_with(|| stage::tracer(&surfaces));
        let rows = 0..camera.intrinsics.height;
        let render = render::render(tracer, &stage::RING, &camera, render::FULL, rows, progress)?;
        let bytes = pack(&render.image)?;
        let file = blake3::hash(&bytes).to_hex().to_string();
        // Read again: another program may have finished other stops meanwhile.
        let mut manifest = in_folder();
        manifest.insert(camera.name.clone(), Entry { made_from: digest, file, noise: render.noise });
        std::fs::write(&place, &bytes).map_err(io)?;
        let text = serde_json::to_vec_pretty(&manifest).map_err(|e| io(e.into()))?;
        std::fs::write(folder.join(MANIFEST), text).map_err(io)?;
        summary.push(StoredStop {
            name: camera.name.clone(),
            rendered: true,
            noise: render.noise,
            bytes: bytes.len(),
        });
    }
    Ok(summary)
}

type Channel = (&'static str, fn(&mut Seen) -> &mut f32);

/// The channels of a stored render, in OpenEXR's layer.channel names.
const CHANNELS: [Channel; 10] = [
    ("albedo.R", |s| &mut s.albedo[0]),
    ("albedo.G", |s| &mut s.albedo[1]),
    ("albedo.B", |s| &mut s.albedo[2]),
    ("ambient.R", |s| &mut s.ambient[0]),
    ("ambient.G", |s| &mut s.ambient[1]),
    ("ambient.B", |s| &mut s.ambient[2]),
    ("flash.R", |s| &mut s.flash[0]),
    ("flash.G", |s| &mut s.flash[1]),
    ("flash.B", |s| &mut s.flash[2]),
    ("object", |s| &mut s.object),
];

fn pack(image: &Image<Seen>) -> Result<Vec<u8>, WorldError> {
    let channels = CHANNELS
        .iter()
        .map(|(name, pick)| {
            ((*name).to_owned(), image.pixels().iter().map(|p| *pick(&mut p.clone())).collect())
        })
        .collect();
    Ok(exr_half::encode(&Planes { width: image.width(), height: image.height(), channels })?)
}

fn unpack(bytes: &[u8], camera: &Camera) -> Result<Image<Seen>, WorldError> {
    let planes = exr_half::decode(bytes)?;
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut image = Image::filled(width, height, Seen::default());
    for (name, pick) in CHANNELS {
        let values = planes
            .channel(name)
            .filter(|v| v.len() == width * height)
            .ok_or_else(|| WorldError::Stored { stop: camera.name.clone(), channel: name })?;
        for (pixel, value) in image.pixels_mut().iter_mut().zip(values) {
            *pick(pixel) = *value;
        }
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::studio::world::render::render;

    #[test]
    fn committed_renders_are_those_of_the_present_code() {
        let surfaces = stage::surfaces();
        let manifest = manifest(Embedded::get(MANIFEST).as_ref().map(|f| f.data.as_ref()));
        for camera in stage::cameras() {
            let file = Embedded::get(&file_name(&camera));
            let digest = digest(&surfaces, &camera, render::FULL);
            let bytes = file.as_ref().map(|f| f.data.as_ref());
            let render = stored(manifest.get(&camera.name), bytes, &digest, &camera).unwrap();
            let render = render.unwrap_or_else(|| {
                panic!("no fitting render of stop {}; mend it: cargo run -- studio render", camera.name)
            });
            assert!(render.noise < 0.01, "stop {} has noise of {}", camera.name, render.noise);
        }
    }

    #[test]
    fn any_change_of_the_scene_changes_the_digest() {
        let surfaces = stage::surfaces();
        let cameras = stage::cameras();
        let base = digest(&surfaces, &cameras[0], render::FULL);
        assert_eq!(base, digest(&surfaces, &cameras[0], render::FULL));
        assert_ne!(base, digest(&surfaces, &cameras[1], render::FULL));
        assert_ne!(base, digest(&surfaces, &cameras[0], Effort { seed: 2, ..render::FULL }));
        let mut changed = surfaces.clone();
        changed[0].mesh.positions[7].x += 1e-6;
        assert_ne!(base, digest(&changed, &cameras[0], render::FULL));
        let mut changed = surfaces;
        changed[1].reflectance.texels[5][2] ^= 1;
        assert_ne!(base, digest(&changed, &cameras[0], render::FULL));
    }

    /// Same seed, same light: all that remains is the rounding of the stored file's half floats.
    #[test]
    fn a_matt_stage_renders_as_committed_to_the_last_digit_stored() {
        let camera = &stage::cameras()[0];
        let tracer = stage::tracer(&stage::surfaces());
        let bytes = Embedded::get(&file_name(camera)).expect("committed renders").data;
        let stored = unpack(&bytes, camera).unwrap();
        let rows = 110..111;
        let fresh =
            render(&tracer, &stage::RING, camera, render::FULL, rows, &Progress::silent()).unwrap().image;
        for x in 0..camera.intrinsics.width {
            let (a, b) = (fresh.at(x, 110), stored.at(x, 110));
            let values = |s: &Seen| [s.ambient, s.flash, s.albedo].concat();
            for (a, b) in values(a).into_iter().zip(values(b)) {
                assert!((a - b).abs() <= 6e-4 * b.abs() + 1e-6, "{a} for {b} in column {x}");
            }
        }
    }

    /// Fresh seeds on a few rows of one stop must give the stored radiances within the noise of the fresh ones.
    #[test]
    fn committed_renders_agree_with_fresh_ones_within_noise() {
        let surfaces = stage::surfaces();
        let cameras = stage::cameras();
        let tracer = stage::tracer(&surfaces);
        for (stop, rows) in [(0, 60..66), (9, 90..96)] {
            let camera = &cameras[stop];
            let bytes = Embedded::get(&file_name(camera)).expect("committed renders").data;
            let stored = unpack(&bytes, camera).unwrap();
            let fresh = |seed| {
                let effort = Effort { object: 32, elsewhere: 8, seed };
                render(&tracer, &stage::RING, camera, effort, rows.clone(), &Progress::silent())
                    .unwrap()
                    .image
            };
            let (a, b) = (fresh(1000), fresh(2000));
            for pick in [|s: &Seen| s.flash[1], |s: &Seen| s.ambient[1], |s: &Seen| s.albedo[1]] {
                let (mut off, mut own, mut bias, mut count) = (0.0, 0.0, 0.0, 0.0);
                for y in rows.clone() {
                    for x in 0..camera.intrinsics.width {
                        if stored.at(x, y).object < 1.0 {
                            continue;
                        }
                        let (a, b, c) =
                            (pick(a.at(x, y)), pick(b.at(x, y)), pick(stored.at(x, y))).into_f64();
                        off += ((a + b) / 2.0 - c).powi(2);
                        own += ((a - b) / 2.0).powi(2);
                        bias += (a + b) / 2.0 - c;
                        count += 1.0;
                    }
                }
                assert!(count > 300.0);
                let sigma = f64::max((own / count).sqrt(), 2e-4);
                assert!((off / count).sqrt() < 1.5 * sigma, "{} > {sigma}", (off / count).sqrt());
                assert!((bias / count).abs() < 5.0 * sigma / f64::sqrt(count), "bias {}", bias / count);
            }
        }
    }

    trait IntoF64 {
        fn into_f64(self) -> (f64, f64, f64);
    }

    impl IntoF64 for (f32, f32, f32) {
        fn into_f64(self) -> (f64, f64, f64) {
            (self.0.into(), self.1.into(), self.2.into())
        }
    }
}
