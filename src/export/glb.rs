//! glTF 2.0 binary (GLB): the mesh with its reflectance as base colour, for any viewer.
//!
//! Base colour is a PNG in sRGB, embedded; the material is metallic-roughness with metallic 0 and roughness
//! 1, glTF's nearest to a Lambertian surface. Lengths are metres. glTF's up is +y: when the caller knows the
//! world's up axis, the node turns it there; else the world is left as it is, and `extras` say so. Vertices
//! are split where texture coordinates part; normals are area-weighted over the unsplit vertices.

use crate::codec::png::{self, PngError};
use crate::raster::{Image, Rgb, srgb};
use crate::scene::Mesh;
use glam::{Mat3, Quat, Vec2, Vec3};
use serde_json::{Value, json};
use std::collections::HashMap;

/// Why no GLB could be made.
#[derive(Debug, thiserror::Error)]
pub enum GlbError {
    /// The mesh lacks what a textured model needs.
    #[error("{mesh} cannot become a GLB: {reason}")]
    Mesh {
        /// The mesh's name.
        mesh: String,
        /// What is missing or wrong.
        reason: &'static str,
    },
    /// The texture cannot be encoded.
    #[error(transparent)]
    Texture(#[from] PngError),
    /// The container counts bytes in 32 bits.
    #[error("the model needs {0} bytes, but a GLB holds less than 4 GiB; use a smaller texture or mesh")]
    TooLarge(usize),
}

/// How the reflectance becomes colour.
#[derive(Clone, Debug, PartialEq)]
pub enum Colour {
    /// The texture is linear sRGB already.
    LinearSrgb,
    /// The texture is camera RGB; this matrix takes it to linear sRGB.
    CameraRgb(Mat3),
    /// The texture is camera RGB and no colour calibration exists: it is shown as if it were linear sRGB.
    Uncalibrated,
}

/// A textured model to be written.
pub struct Model<'a> {
    /// Geometry in metres, with texture coordinates.
    pub mesh: &'a Mesh,
    /// Linear reflectance, row 0 at v = 1.
    pub texture: &'a Rgb,
    /// How the reflectance becomes colour.
    pub colour: Colour,
    /// The world's up axis (unit length), if it is known.
    pub up: Option<Vec3>,
    /// Provenance, put into the file's `extras` as it is.
    pub provenance: Value,
}

/// Encodes the model.
pub fn encode(model: &Model<'_>) -> Result<Vec<u8>, GlbError> {
    let corners = Corners::of(model.mesh)?;
    let picture = png::encode_rgb8(&displayed(model.texture, &model.colour))?;

    let mut binary = Binary::default();
    let low = corners.positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = corners.positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    let count = corners.positions.len();
    binary
        .view(corners.positions.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes), Some(VERTICES));
    binary.view(corners.normals.iter().flat_map(|n| n.to_array()).flat_map(f32::to_le_bytes), Some(VERTICES));
    // glTF counts v downwards from the picture's first row.
    let uvs = corners.uvs.iter().flat_map(|uv| [uv.x, 1.0 - uv.y]);
    binary.view(uvs.flat_map(f32::to_le_bytes), Some(VERTICES));
    binary.view(corners.indices.iter().flat_map(|i| i.to_le_bytes()), Some(INDICES));
    binary.view(picture, None);

    let mut node = json!({ "mesh": 0, "name": model.mesh.name });
    let up_word = match model.up {
        Some(up) => {
            node["rotation"] = json!(Quat::from_rotation_arc(up.normalize_or(Vec3::Y), Vec3::Y).to_array());
            "turned to +y from the world's up axis"
        }
        None => "not known; the world's axes are kept",
    };
    let space = match model.colour {
        Colour::LinearSrgb => "linear sRGB",
        Colour::CameraRgb(_) => "camera RGB, taken to linear sRGB by calibration",
        Colour::Uncalibrated => "camera RGB, uncalibrated",
    };
    let accessor = |view: usize, kind: &str, count: usize, component: u32| json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
    let mut positions = accessor(0, "VEC3", count, FLOAT);
    positions["min"] = json!(low.to_array());
    positions["max"] = json!(high.to_array());
    let document = json!({
        "asset": {
            "version": "2.0",
            "generator": concat!("unlit ", env!("CARGO_PKG_VERSION")),
            "extras": { "reflectance": space, "up": up_word, "unit": "metre", "provenance": model.provenance },
        },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{
            "name": model.mesh.name,
            "primitives": [{
                "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 },
                "indices": 3,
                "material": 0,
            }],
        }],
        "materials": [{
            "name": "diffuse reflectance",
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": 0 },
                "metallicFactor": 0.0,
                "roughnessFactor": 1.0,
            },
        }],
        "textures": [{ "source": 0, "sampler": 0 }],
        "samplers": [{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }],
        "images": [{ "bufferView": 4, "mimeType": "image/png" }],
        "accessors": [
            positions,
            accessor(1, "VEC3", count, FLOAT),
            accessor(2, "VEC2", count, FLOAT),
            accessor(3, "SCALAR", corners.indices.len(), UNSIGNED_INT),
        ],
        "bufferViews": binary.views,
        "buffers": [{ "byteLength": binary.bytes.len() }],
    });
    pack(document.to_string().into_bytes(), binary.bytes)
}

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// The buffer and its views, each at a multiple of four bytes.
#[derive(Default)]
struct Binary {
    bytes: Vec<u8>,
    views: Vec<Value>,
}

impl Binary {
    fn view(&mut self, bytes: impl IntoIterator<Item = u8>, target: Option<u32>) {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }
}

/// Header, JSON chunk padded with spaces, binary chunk padded with zeros.
fn pack(mut document: Vec<u8>, binary: Vec<u8>) -> Result<Vec<u8>, GlbError> {
    document.resize(document.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + document.len() + 8 + binary.len();
    let length = |n: usize| u32::try_from(n).map(u32::to_le_bytes).map_err(|_| GlbError::TooLarge(total));
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    out.extend(2_u32.to_le_bytes());
    out.extend(length(total)?);
    out.extend(length(document.len())?);
    out.extend(b"JSON");
    out.extend(document);
    out.extend(length(binary.len())?);
    out.extend(b"BIN\0");
    out.extend(binary);
    Ok(out)
}

/// The texture in sRGB, 8 bits.
fn displayed(texture: &Rgb, colour: &Colour) -> Image<[u8; 3]> {
    match colour {
        Colour::CameraRgb(srgb_from_camera) => {
            texture.map(|&p| (*srgb_from_camera * Vec3::from(p)).to_array().map(srgb::encode_u8))
        }
        Colour::LinearSrgb | Colour::Uncalibrated => texture.map(|p| p.map(srgb::encode_u8)),
    }
}

/// Vertices as glTF wants them: one index list for position, normal and texture coordinate.
#[derive(Default)]
struct Corners {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    indices: Vec<u32>,
}

impl Corners {
    fn of(mesh: &Mesh) -> Result<Self, GlbError> {
        let wrong = |reason| GlbError::Mesh { mesh: mesh.name.clone(), reason };
        if mesh.triangles.is_empty() {
            return Err(wrong("it has no triangles"));
        }
        if mesh.uv_triangles.len() != mesh.triangles.len() {
            return Err(wrong("it has no texture coordinates; export it with UVs"));
        }
        let normals = smooth_normals(mesh);
        let mut out = Self::default();
        let mut known = HashMap::new();
        for (triangle, uv_triangle) in mesh.triangles.iter().zip(&mesh.uv_triangles) {
            for pair in triangle.iter().copied().zip(uv_triangle.iter().copied()) {
                let index = *known.entry(pair).or_insert(out.positions.len());
                if index == out.positions.len() {
                    out.positions.push(mesh.positions[pair.0 as usize]);
                    out.normals.push(normals[pair.0 as usize]);
                    out.uvs.push(mesh.uvs[pair.1 as usize]);
                }
                let index = u32::try_from(index).map_err(|_| wrong("it has more than 2^32 corners"))?;
                out.indices.push(index);
            }
        }
        Ok(out)
    }
}

/// Unit normals at the vertices: the sum of the adjoining triangles' normals, each as long as twice its area.
/// A vertex whose triangles have no area points up the z axis, because glTF allows no zero normal.
fn smooth_normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; mesh.positions.len()];
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = mesh.corners(i);
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|&v| normals[v as usize] += normal);
    }
    normals.into_iter().map(|n| n.normalize_or(Vec3::Z)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles that share an edge in space but not in the texture.
    fn seamed() -> Mesh {
        Mesh {
            name: "seamed".into(),
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE - Vec3::Z],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
            uvs: [(0.0, 0.0), (0.4, 0.0), (0.0, 0.4), (0.6, 0.6), (1.0, 1.0), (0.6, 1.0)]
                .map(Vec2::from)
                .to_vec(),
            uv_triangles: vec![[0, 1, 2], [3, 4, 5]],
        }
    }

    fn model<'a>(mesh: &'a Mesh, texture: &'a Rgb, colour: Colour, up: Option<Vec3>) -> Model<'a> {
        Model { mesh, texture, colour, up, provenance: json!({ "pairs": 12 }) }
    }

    #[test]
    fn an_independent_reader_finds_geometry_texture_and_provenance() {
        let mesh = seamed();
        let texture = Image::from_fn(4, 2, |x, y| [x as f32 / 4.0, y as f32 / 2.0, 0.18]);
        let bytes = encode(&model(&mesh, &texture, Colour::Uncalibrated, Some(Vec3::Z))).unwrap();
        let (document, buffers, images) = gltf::import_slice(&bytes).unwrap();
        let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
        let reader = primitive.reader(|b| Some(&buffers[b.index()]));
        let positions: Vec<_> = reader.read_positions().unwrap().collect();
        let uvs: Vec<_> = reader.read_tex_coords(0).unwrap().into_f32().collect();
        let indices: Vec<_> = reader.read_indices().unwrap().into_u32().collect();
        assert_eq!((positions.len(), indices.len()), (6, 6), "corners part at the seam");
        for (corner, &i) in indices.iter().enumerate() {
            let (triangle, k) = (corner / 3, corner % 3);
            assert_eq!(Vec3::from(positions[i as usize]), mesh.corners(triangle)[k]);
            let uv = mesh.uv_corners(triangle).unwrap()[k];
            assert!((Vec2::from(uvs[i as usize]) - Vec2::new(uv.x, 1.0 - uv.y)).length() < 1e-6);
        }
        assert!(reader.read_normals().unwrap().all(|n| (Vec3::from(n) - Vec3::Z).length() < 1e-6));
        assert_eq!((images[0].width, images[0].height), (4, 2));
        assert_eq!(images[0].pixels[3..6], [0.25, 0.0, 0.18].map(srgb::encode_u8));
        let material = primitive.material().pbr_metallic_roughness();
        assert_eq!((material.metallic_factor(), material.roughness_factor()), (0.0, 1.0));
        let (_, rotation, _) = document.nodes().next().unwrap().transform().decomposed();
        assert!((Quat::from_array(rotation) * Vec3::Z - Vec3::Y).length() < 1e-6);
        let extras: Value =
            serde_json::from_str(document.as_json().asset.extras.as_ref().unwrap().get()).unwrap();
        assert_eq!(extras["reflectance"], "camera RGB, uncalibrated");
        assert_eq!(extras["provenance"]["pairs"], 12);
    }

    #[test]
    fn the_colour_matrix_is_applied_before_the_curve() {
        let mesh = seamed();
        let texture = Image::filled(1, 1, [0.5, 0.25, 0.125]);
        let swap = Mat3::from_cols(Vec3::Z, Vec3::Y, Vec3::X * 2.0);
        let bytes = encode(&model(&mesh, &texture, Colour::CameraRgb(swap), None)).unwrap();
        let (document, _, images) = gltf::import_slice(&bytes).unwrap();
        assert_eq!(images[0].pixels, [0.25, 0.25, 0.5].map(srgb::encode_u8));
        let (_, rotation, _) = document.nodes().next().unwrap().transform().decomposed();
        assert_eq!(rotation, [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_mesh_without_texture_coordinates_is_refused() {
        let texture = Image::filled(1, 1, [0.5; 3]);
        let bare = Mesh { uvs: vec![], uv_triangles: vec![], ..seamed() };
        assert!(matches!(
            encode(&model(&bare, &texture, Colour::LinearSrgb, None)),
            Err(GlbError::Mesh { .. })
        ));
    }
}
