//! USD as text (usda): one mesh with a matt material whose colour is a picture file beside it.
//!
//! Follows the UsdGeom and UsdPreviewSurface specifications: lengths in metres, polygons exactly as given (no
//! subdivision), texture coordinates face-varying with indices of their own, so that seams stay seams.

use super::asset::AssetError;
use super::obj::Obj;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// What goes beside the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene<'a> {
    /// File name of the picture, relative to the file.
    pub picture: &'a str,
    /// The axis that points up: 'Y' or 'Z', which is all that USD knows.
    pub up: char,
    /// Rows of a rotation that brings the mesh's axes to the file's; `None` where they are the same.
    pub rotation: Option<[[f32; 3]; 3]>,
    /// What is to be known of the file: name and value.
    pub facts: &'a [(&'a str, String)],
}

/// Writes a textured mesh. The picture's values are taken as linear.
pub fn write(path: &Path, mesh: &Obj, scene: &Scene<'_>) -> Result<(), AssetError> {
    let unwritable = |reason: String| Err(AssetError::Unwritable { path: path.into(), reason });
    if mesh.triangles.is_empty() || mesh.uv_triangles.len() != mesh.triangles.len() {
        let (triangles, textured) = (mesh.triangles.len(), mesh.uv_triangles.len());
        return unwritable(format!("{textured} of {triangles} triangles have texture coordinates; all must"));
    }
    if scene.picture.contains('@') {
        return unwritable(format!("a picture's name must not hold an @, but it is {}", scene.picture));
    }
    let write = || -> io::Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        head(&mut out, scene)?;
        geometry(&mut out, mesh)?;
        material(&mut out, scene.picture)?;
        out.flush()
    };
    write().map_err(AssetError::writing(path))
}

fn head(out: &mut impl Write, scene: &Scene<'_>) -> io::Result<()> {
    writeln!(
        out,
        "#usda 1.0\n(\n    defaultPrim = \"model\"\n    metersPerUnit = 1\n    upAxis = \"{}\"",
        scene.up
    )?;
    writeln!(out, "    customLayerData = {{")?;
    for (name, value) in scene.facts {
        writeln!(out, "        string {name} = {}", quoted(value))?;
    }
    writeln!(out, "    }}\n)\n\ndef Xform \"model\" (\n    kind = \"component\"\n)\n{{")?;
    if let Some(rows) = scene.rotation {
        // USD multiplies row vectors from the left, so its matrix is the transpose.
        let column = |c: usize| format!("({}, {}, {}, 0)", rows[0][c], rows[1][c], rows[2][c]);
        writeln!(
            out,
            "    matrix4d xformOp:transform = ( {}, {}, {}, (0, 0, 0, 1) )\n    uniform token[] xformOpOrder = [\"xformOp:transform\"]\n",
            column(0),
            column(1),
            column(2)
        )?;
    }
    Ok(())
}

fn geometry(out: &mut impl Write, mesh: &Obj) -> io::Result<()> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in &mesh.positions {
        for (c, v) in p.to_array().into_iter().enumerate() {
            (low[c], high[c]) = (low[c].min(v), high[c].max(v));
        }
    }
    let place = |[x, y, z]: [f32; 3]| format!("({x}, {y}, {z})");
    writeln!(
        out,
        "    def Mesh \"surface\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {{"
    )?;
    writeln!(out, "        float3[] extent = [{}, {}]", place(low), place(high))?;
    writeln!(out, "        uniform token orientation = \"rightHanded\"")?;
    writeln!(out, "        uniform token subdivisionScheme = \"none\"")?;
    list(out, "int[] faceVertexCounts", mesh.triangles.iter().map(|_| 3))?;
    list(out, "int[] faceVertexIndices", mesh.triangles.iter().flatten())?;
    list(out, "point3f[] points", mesh.positions.iter().map(|p| place(p.to_array())))?;
    let pairs = mesh.uvs.iter().map(|p| format!("({}, {})", p.x, p.y));
    write!(out, "        texCoord2f[] primvars:st = ")?;
    values(out, pairs)?;
    writeln!(out, " (\n            interpolation = \"faceVarying\"\n        )")?;
    list(out, "int[] primvars:st:indices", mesh.uv_triangles.iter().flatten())?;
    writeln!(out, "        rel material:binding = </model/reflectance>\n    }}\n")
}

fn material(out: &mut impl Write, picture: &str) -> io::Result<()> {
    let shader = |out: &mut dyn Write, name: &str, id: &str, lines: &[String]| -> io::Result<()> {
        writeln!(
            out,
            "        def Shader \"{name}\"\n        {{\n            uniform token info:id = \"{id}\""
        )?;
        lines.iter().try_for_each(|line| writeln!(out, "            {line}"))?;
        writeln!(out, "        }}\n")
    };
    writeln!(out, "    def Material \"reflectance\"\n    {{")?;
    writeln!(out, "        token outputs:surface.connect = </model/reflectance/surface.outputs:surface>\n")?;
    let lines = [
        "color3f inputs:diffuseColor.connect = </model/reflectance/picture.outputs:rgb>",
        "float inputs:metallic = 0",
        "float inputs:roughness = 1",
        "color3f inputs:specularColor = (0, 0, 0)",
        "int inputs:useSpecularWorkflow = 1",
        "token outputs:surface",
    ];
    shader(out, "surface", "UsdPreviewSurface", &lines.map(String::from))?;
    let lines = [
        format!("asset inputs:file = @./{picture}@"),
        "float2 inputs:st.connect = </model/reflectance/coordinates.outputs:result>".into(),
        "token inputs:sourceColorSpace = \"raw\"".into(),
        "token inputs:wrapS = \"clamp\"".into(),
        "token inputs:wrapT = \"clamp\"".into(),
        "float3 outputs:rgb".into(),
    ];
    shader(out, "picture", "UsdUVTexture", &lines)?;
    let lines = ["string inputs:varname = \"st\"", "float2 outputs:result"];
    shader(out, "coordinates", "UsdPrimvarReader_float2", &lines.map(String::from))?;
    writeln!(out, "    }}\n}}")
}

fn list<T: Display>(out: &mut impl Write, name: &str, items: impl Iterator<Item = T>) -> io::Result<()> {
    write!(out, "        {name} = ")?;
    values(out, items)?;
    writeln!(out)
}

fn values<T: Display>(out: &mut impl Write, items: impl Iterator<Item = T>) -> io::Result<()> {
    write!(out, "[")?;
    for (i, item) in items.enumerate() {
        write!(out, "{}{item}", if i == 0 { "" } else { ", " })?;
    }
    write!(out, "]")
}

/// A string in quotes; what would end it or the line is escaped, other control characters are left out.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            '\n' => out.push_str("\\n"),
            c if c.is_control() => {}
            c => out.push(c),
        }
    }
    out + "\""
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    fn square() -> Obj {
        Obj {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::ONE - Vec3::Z, Vec3::new(0.0, 1.0, -0.25)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            uvs: vec![Vec2::ZERO, Vec2::new(0.4, 0.0), Vec2::new(0.4, 0.5), Vec2::new(0.6, 0.5), Vec2::ONE],
            uv_triangles: vec![[0, 1, 2], [3, 4, 2]],
        }
    }

    fn written(scene: &Scene<'_>) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.usda");
        write(&path, &square(), scene).unwrap();
        std::fs::read_to_string(&path).unwrap()
    }

    /// The numbers of an attribute's list.
    fn numbers(text: &str, name: &str) -> Vec<f32> {
        let line = text.lines().find(|l| l.contains(&format!("{name} = ["))).unwrap();
        let list = &line[line.find("= [").unwrap() + 2..];
        list.split(|c: char| !"0123456789.-e".contains(c)).filter_map(|n| n.parse().ok()).collect()
    }

    #[test]
    fn a_reader_that_knows_only_the_format_finds_the_mesh_again() {
        let facts = [("colourSpace", "linear \"sRGB\"\nsecond\\line".to_owned())];
        let text = written(&Scene { picture: "model.exr", up: 'Z', rotation: None, facts: &facts });
        assert!(text.starts_with("#usda 1.0\n"));
        for words in [
            "metersPerUnit = 1",
            "upAxis = \"Z\"",
            "@./model.exr@",
            "\"linear \\\"sRGB\\\"\\nsecond\\\\line\"",
            "sourceColorSpace = \"raw\"",
            "subdivisionScheme = \"none\"",
        ] {
            assert!(text.contains(words), "no {words}: {text}");
        }
        assert!(!text.contains("xformOp"));
        let mesh = square();
        assert_eq!(numbers(&text, "faceVertexCounts"), [3.0, 3.0]);
        let flat = |list: &[[u32; 3]]| list.iter().flatten().map(|&i| i as f32).collect::<Vec<_>>();
        assert_eq!(numbers(&text, "faceVertexIndices"), flat(&mesh.triangles));
        assert_eq!(numbers(&text, "primvars:st:indices"), flat(&mesh.uv_triangles));
        assert_eq!(
            numbers(&text, "points"),
            mesh.positions.iter().flat_map(|p| p.to_array()).collect::<Vec<_>>()
        );
        assert_eq!(
            numbers(&text, "primvars:st"),
            mesh.uvs.iter().flat_map(|p| p.to_array()).collect::<Vec<_>>()
        );
    }

    #[test]
    fn brackets_close_and_every_path_that_is_named_exists() {
        let rotation = Some([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]);
        let text = written(&Scene { picture: "a.exr", up: 'Y', rotation, facts: &[] });
        for (open, close) in [('{', '}'), ('(', ')'), ('[', ']')] {
            assert_eq!(text.matches(open).count(), text.matches(close).count(), "{open}");
        }
        // Rows of the transpose: x stays, y goes to -z, z to y.
        assert!(text.contains("( (1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1) )"), "{text}");
        let names: Vec<&str> = text.split("def ").skip(1).filter_map(|d| d.split('"').nth(1)).collect();
        let paths: Vec<&str> =
            text.split("</").skip(1).map(|p| p.split(['>', '.']).next().unwrap()).collect();
        assert!(!paths.is_empty(), "{text}");
        for path in paths {
            assert!(path.split('/').all(|part| names.contains(&part)), "{path} of {names:?}");
        }
    }

    #[test]
    fn what_cannot_be_written_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.usda");
        let scene = Scene { picture: "a.exr", up: 'Y', rotation: None, facts: &[] };
        let bare = Obj { uvs: vec![], uv_triangles: vec![], ..square() };
        assert!(matches!(write(&path, &bare, &scene), Err(AssetError::Unwritable { .. })));
        let named = Scene { picture: "a@b.exr", ..scene };
        assert!(matches!(write(&path, &square(), &named), Err(AssetError::Unwritable { .. })));
    }
}
