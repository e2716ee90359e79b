//! One function a format. Every file appears whole or not at all, under the names that docs/export.md lists.

use super::colour::{name, space, transformed};
use super::{Colour, ExportError, Exported, Model, clipped};
use crate::codec::asset::AssetError;
use crate::codec::exr_image::{self, Exr, Meta};
use crate::codec::icc::{self, LinearRgb};
use crate::codec::obj::{self, Material, Obj};
use crate::codec::tiff16::{self, Told};
use crate::codec::{png, usd};
use crate::export::colour::{PCS_WHITE, adapt};
use crate::export::glb;
use crate::pipeline::output::whole;
use crate::pipeline::process::{ProcessError, io};
use crate::progress::Progress;
use crate::raster::{Image, Rgb, srgb};
use crate::session::Session;
use glam::{DMat3, Quat, Vec3};
use std::path::Path;

const SOFTWARE: &str = concat!("unlit ", env!("CARGO_PKG_VERSION"));

/// Depth of per-view images.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Depth {
    Sixteen,
    Float,
}

fn file<E>(
    to: &Path,
    name: &str,
    exported: &mut Exported,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), ExportError>
where
    ProcessError: From<E>,
{
    let path = to.join(name);
    whole(&path, write)?;
    exported.files.push(path);
    Ok(())
}

fn bytes(path: &Path, bytes: &[u8]) -> Result<(), ProcessError> {
    std::fs::write(path, bytes).map_err(io(path))
}

fn meta(colour: Colour, what: &str) -> Meta {
    Meta {
        colour_space: Some(name(colour).into()),
        software: Some(SOFTWARE.into()),
        comments: Some(what.into()),
    }
}

pub(super) fn glb(model: &Model, to: &Path, exported: &mut Exported) -> Result<(), ExportError> {
    let colour = match model.colour {
        Colour::Camera => glb::Colour::Uncalibrated,
        Colour::Srgb | Colour::AcesCg => glb::Colour::LinearSrgb,
    };
    let encoded = glb::encode(&glb::Model {
        mesh: &model.mesh,
        texture: &model.shown(),
        colour,
        up: model.up,
        provenance: model.provenance.clone(),
    })?;
    file(to, "model.glb", exported, |path| bytes(path, &encoded))
}

pub(super) fn exr(model: &Model, to: &Path, exported: &mut Exported) -> Result<(), ExportError> {
    file(to, "reflectance.exr", exported, |path| {
        let meta = meta(model.colour, "diffuse reflectance, 0 to 1; row 0 at v = 1");
        exr_image::write_rgb(path, &model.reflectance, &meta)
    })?;
    let deviation = model.deviation()?;
    file(to, "stddev.exr", exported, |path| {
        let meta =
            meta(model.colour, "standard deviation of the reflectance; 0 where no view saw the surface");
        exr_image::write_rgb(path, &deviation, &meta)
    })?;
    file(to, "views.exr", exported, |path| {
        // Counts have no colours.
        let meta = Meta { colour_space: None, ..model.counts.meta.clone() };
        exr_image::write(path, Exr { meta, ..model.counts.clone() })
    })
}

pub(super) fn tiff(model: &Model, to: &Path, exported: &mut Exported) -> Result<(), ExportError> {
    let found = clipped(&model.reflectance, model.on_surface());
    exported.notes.extend(told_clipped("reflectance.tif", found));
    file(to, "reflectance.tif", exported, |path| {
        sixteen(path, &model.reflectance, model.colour, "row 0 at v = 1")
    })
}

fn told_clipped(what: &str, [below, above, of]: [usize; 3]) -> Option<String> {
    (below + above > 0).then(|| {
        format!(
            "{what}: 16 bits hold 0 to 1, so that {below} values below 0 and {above} above 1 of {of} were clipped; EXR keeps them"
        )
    })
}

fn sixteen(path: &Path, image: &Rgb, colour: Colour, more: &str) -> Result<(), AssetError> {
    let description =
        format!("diffuse reflectance, linear, value = reflectance * 65535, {}; {more}", name(colour));
    let profile = profile(colour);
    let told = Told {
        description: Some(&description),
        software: Some(SOFTWARE),
        profile: profile.as_deref(),
        settings: None,
    };
    tiff16::write_rgb16_told(path, image, &told)
}

/// The colour space as a profile; a camera's own has none.
fn profile(colour: Colour) -> Option<Vec<u8>> {
    let space = space(colour)?;
    let adaptation = adapt(space.white_xyz(), PCS_WHITE);
    let colorants = (adaptation * space.xyz_from_rgb()).to_cols_array_2d();
    let adaptation = adaptation.transpose().to_cols_array_2d();
    Some(icc::encode(&LinearRgb { name: space.name, colorants, adaptation }))
}

fn as_obj(model: &Model) -> Obj {
    let mesh = model.mesh.clone();
    Obj {
        positions: mesh.positions,
        triangles: mesh.triangles,
        uvs: mesh.uvs,
        uv_triangles: mesh.uv_triangles,
    }
}

pub(super) fn obj(model: &Model, to: &Path, exported: &mut Exported) -> Result<(), ExportError> {
    let encoded = png::encode_rgb8(&model.shown().map(|p| p.map(srgb::encode_u8)))?;
    file(to, "model.png", exported, |path| bytes(path, &encoded))?;
    let space = match model.colour {
        Colour::Camera => "camera RGB shown as sRGB, uncalibrated",
        Colour::Srgb | Colour::AcesCg => "sRGB",
    };
    let header = [format!("{SOFTWARE}: metres; model.png is {space}, 8 bits")];
    let header = header.each_ref().map(String::as_str);
    file(to, "model.mtl", exported, |path| obj::write_material(path, "reflectance", "model.png", &header))?;
    let material = Material { library: "model.mtl", name: "reflectance" };
    file(to, "model.obj", exported, |path| obj::write_with(path, &as_obj(model), &header, Some(material)))
}

pub(super) fn usd(model: &Model, to: &Path, exported: &mut Exported) -> Result<(), ExportError> {
    let picture = "model_reflectance.exr";
    file(to, picture, exported, |path| {
        let meta = meta(model.colour, "diffuse reflectance, 0 to 1; row 0 at v = 1");
        exr_image::write_rgb(path, &model.reflectance, &meta)
    })?;
    let (up, rotation, word) = match model.up {
        None => ('Y', None, "not known; the world's axes are kept"),
        Some(Vec3::Y) => ('Y', None, "the world's"),
        Some(Vec3::Z) => ('Z', None, "the world's"),
        Some(other) => {
            let turn = glam::Mat3::from_quat(Quat::from_rotation_arc(other, Vec3::Y));
            ('Y', Some(turn.transpose().to_cols_array_2d()), "turned to +y from the world's")
        }
    };
    let facts = [
        ("colourSpace", name(model.colour).to_owned()),
        ("provenance", model.provenance.to_string()),
        ("software", SOFTWARE.to_owned()),
        ("up", word.to_owned()),
    ];
    let scene = usd::Scene { picture, up, rotation, facts: &facts };
    file(to, "model.usda", exported, |path| usd::write(path, &as_obj(model), &scene))
}

pub(super) fn views(
    session: &Session,
    model: &Model,
    to: &Path,
    depth: Depth,
    exported: &mut Exported,
    progress: &Progress,
) -> Result<(), ExportError> {
    let mut sum = [0; 3];
    let total = model.summary.used.len();
    for (i, name) in model.summary.used.iter().enumerate() {
        progress.check()?;
        progress.report("exporting per-view images", i, total);
        let path = session.derived_dir().join("views").join(name).join("reflectance.exr");
        let read = exr_image::read(&path)?;
        let Some(image) = read.rgba() else {
            return Err(ExportError::Unfit {
                path,
                found: format!("{} channels", read.channels.len()),
                expected: "R, G, B and A".into(),
            });
        };
        let known = image.map(|p| p[3] > 0.5);
        let image = coloured(&image, model.matrix);
        if depth == Depth::Float {
            let meta = meta(model.colour, "diffuse reflectance of this view; A = 1 where known");
            file(to, &format!("views/{name}.exr"), exported, |path| {
                exr_image::write_rgba(path, &image, &meta)
            })?;
            continue;
        }
        let rgb = image.map(|&[r, g, b, _]| [r, g, b]);
        let found = clipped(&rgb, known.pixels().iter().copied());
        sum.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
        file(to, &format!("views/{name}.tif"), exported, |path| {
            sixteen(path, &rgb, model.colour, "0 where not known, see the mask of the same name")
        })?;
        let mask: Image<u8> = known.map(|k| if *k { 255 } else { 0 });
        file(to, &format!("masks/{name}.tif"), exported, |path| tiff16::write_grey8(path, &mask))?;
    }
    exported.notes.extend(told_clipped("views", sum));
    Ok(())
}

fn coloured(image: &Image<[f32; 4]>, matrix: Option<DMat3>) -> Image<[f32; 4]> {
    let Some(matrix) = matrix else { return image.clone() };
    let rgb = transformed(&image.map(|&[r, g, b, _]| [r, g, b]), matrix);
    Image::from_fn(image.width(), image.height(), |x, y| {
        let [r, g, b] = *rgb.at(x, y);
        [r, g, b, image.at(x, y)[3]]
    })
}

pub(super) fn provenance(model: &Model, to: &Path, exported: &mut Exported) -> Result<(), ExportError> {
    let mut told = model.provenance.clone();
    told["notes"] = exported.notes.clone().into();
    let names = exported.files.iter().filter_map(|f| f.strip_prefix(to).ok());
    told["files"] = names.map(|f| f.display().to_string()).collect::<Vec<_>>().into();
    let text = format!("{told:#}\n");
    file(to, "export.json", exported, |path| bytes(path, text.as_bytes()))
}
