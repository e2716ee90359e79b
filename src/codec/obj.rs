//! Wavefront OBJ: positions, texture coordinates and faces. Normals, colours, groups and materials are left
//! aside: the surface is exactly its triangles, and all groups of a file are one mesh.

use super::asset::AssetError;
use glam::{Vec2, Vec3};
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;

/// What an OBJ file says, polygons cut into triangle fans. Unit and frame are the file's own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Obj {
    /// Vertices that a face uses.
    pub positions: Vec<Vec3>,
    /// Corner indices into `positions`.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates, v up; empty when the faces have none.
    pub uvs: Vec<Vec2>,
    /// Corner indices into `uvs`, one triple a triangle; empty when the faces have none.
    pub uv_triangles: Vec<[u32; 3]>,
}

/// Reads a file; at least one triangle and only finite numbers are accepted.
pub fn read(path: &Path) -> Result<Obj, AssetError> {
    let file = File::open(path).map_err(AssetError::reading(path))?;
    parse(BufReader::new(file)).map_err(|error| match error {
        Fault::Io(source) => AssetError::reading(path)(source),
        Fault::Content(reason) => AssetError::Malformed { path: path.into(), format: "OBJ", reason },
    })
}

enum Fault {
    Io(io::Error),
    Content(String),
}

fn parse(text: impl BufRead) -> Result<Obj, Fault> {
    let mut lines =
        FaceLines { inner: text, number: 0, line: Vec::new(), used: 0, textured: 0, bare: 0, failure: None };
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..Default::default()
    };
    let parsed =
        tobj::load_obj_buf(&mut lines, &options, |_| Ok(Default::default())).map(|(models, _)| models);
    if let Some(failure) = lines.failure {
        return Err(Fault::Io(failure));
    }
    let models = parsed.map_err(|error| {
        Fault::Content(match error {
            tobj::LoadError::FaceVertexOutOfBounds | tobj::LoadError::FaceTexCoordOutOfBounds => {
                format!("a face asks for an index that the file does not have ({error})")
            }
            _ => format!("line {}: {error}", lines.number),
        })
    })?;
    let mut models = models.into_iter().map(|m| m.mesh).filter(|m| !m.indices.is_empty());
    let (Some(mesh), None) = (models.next(), models.next()) else {
        return Err(Fault::Content("it has no faces; export the mesh with its triangles".into()));
    };
    let positions: Vec<Vec3> = mesh.positions.chunks_exact(3).map(Vec3::from_slice).collect();
    if let Some(bad) = positions.iter().find(|p| !p.is_finite()) {
        return Err(Fault::Content(format!("a vertex is at {bad}, which is not a place; clean the mesh")));
    }
    let uvs: Vec<Vec2> = mesh.texcoords.chunks_exact(2).map(Vec2::from_slice).collect();
    if let Some(bad) = uvs.iter().find(|uv| !uv.is_finite()) {
        return Err(Fault::Content(format!("a texture coordinate is {bad}; clean the mesh")));
    }
    // The parser would lend a bare corner the texture coordinate read last.
    if lines.textured > 0 && lines.bare > 0 {
        return Err(Fault::Content(
            "some faces have texture coordinates and others have none; export all with them or all without"
                .into(),
        ));
    }
    let triples = |indices: &[u32]| indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect::<Vec<_>>();
    let (triangles, uv_triangles) = (triples(&mesh.indices), triples(&mesh.texcoord_indices));
    let inside = |list: &[[u32; 3]], n: usize| list.iter().flatten().all(|&i| (i as usize) < n);
    if !inside(&triangles, positions.len()) || !inside(&uv_triangles, uvs.len()) {
        return Err(Fault::Content("a face asks for an index that the file does not have".into()));
    }
    Ok(Obj { positions, triangles, uvs, uv_triangles })
}

/// Passes on only lines that shape the surface (v, vt, f), counts them, and joins lines that end in a
/// backslash, so that groups, materials and the words of other programs cannot split or break the mesh.
struct FaceLines<R> {
    inner: R,
    number: usize,
    line: Vec<u8>,
    used: usize,
    textured: usize,
    bare: usize,
    failure: Option<io::Error>,
}

impl<R: BufRead> FaceLines<R> {
    fn next_line(&mut self) -> io::Result<usize> {
        loop {
            self.line.clear();
            self.used = 0;
            loop {
                let read = self.inner.read_until(b'\n', &mut self.line)?;
                self.number += usize::from(read > 0);
                let trimmed = self.line.trim_ascii_end().len();
                if read == 0 || self.line[..trimmed].last() != Some(&b'\\') {
                    break;
                }
                self.line.truncate(trimmed - 1);
                self.line.push(b' ');
            }
            if self.line.is_empty() {
                return Ok(0);
            }
            let word = self.line.trim_ascii_start().split(u8::is_ascii_whitespace).next();
            if matches!(word, Some(b"v" | b"vt" | b"f")) {
                if let Some(comment) = self.line.iter().position(|&c| c == b'#') {
                    self.line.truncate(comment);
                    self.line.push(b'\n');
                }
                self.count_corners();
                return Ok(self.line.len());
            }
        }
    }

    fn count_corners(&mut self) {
        let mut words = self.line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        if words.next() == Some(b"f") {
            for corner in words {
                let textured = corner.split(|&c| c == b'/').nth(1).is_some_and(|index| !index.is_empty());
                *(if textured { &mut self.textured } else { &mut self.bare }) += 1;
            }
        }
    }
}

impl<R: BufRead> BufRead for FaceLines<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.used >= self.line.len()
            && let Err(error) = self.next_line()
        {
            // The parser flattens every error to one word; the true one is kept for the user.
            let kind = error.kind();
            self.failure = Some(error);
            return Err(kind.into());
        }
        Ok(&self.line[self.used..])
    }

    fn consume(&mut self, amount: usize) {
        self.used += amount;
    }
}

impl<R: BufRead> Read for FaceLines<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(out)?;
        self.consume(count);
        Ok(count)
    }
}

/// A material of a library beside the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Material<'a> {
    /// File name of the library.
    pub library: &'a str,
    /// Name of the material in it.
    pub name: &'a str,
}

/// Writes positions, texture coordinates (when there are any) and faces; `header` lines become comments.
/// The file is complete when this returns, but is neither synced nor renamed into place.
pub fn write(path: &Path, obj: &Obj, header: &[&str]) -> Result<(), AssetError> {
    write_with(path, obj, header, None)
}

/// Writes a material library with one matt material whose colour is a picture.
pub fn write_material(path: &Path, name: &str, picture: &str, header: &[&str]) -> Result<(), AssetError> {
    let mut text: String = header.iter().map(|line| format!("# {line}\n")).collect();
    text += &format!("newmtl {name}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {picture}\n");
    std::fs::write(path, text).map_err(AssetError::writing(path))
}

/// As [`write()`], every face of one material.
pub fn write_with(
    path: &Path,
    obj: &Obj,
    header: &[&str],
    material: Option<Material<'_>>,
) -> Result<(), AssetError> {
    let textured = !obj.uv_triangles.is_empty();
    if textured && obj.uv_triangles.len() != obj.triangles.len() {
        return Err(AssetError::Unwritable {
            path: path.into(),
            reason: format!(
                "{} triangles but {} triples of texture coordinates",
                obj.triangles.len(),
                obj.uv_triangles.len()
            ),
        });
    }
    let write = || -> io::Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        for line in header {
            writeln!(out, "# {line}")?;
        }
        if let Some(Material { library, .. }) = material {
            writeln!(out, "mtllib {library}")?;
        }
        for p in &obj.positions {
            writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
        }
        for uv in &obj.uvs {
            writeln!(out, "vt {} {}", uv.x, uv.y)?;
        }
        if let Some(Material { name, .. }) = material {
            writeln!(out, "usemtl {name}")?;
        }
        for (i, t) in obj.triangles.iter().enumerate() {
            let [a, b, c] = t.map(|i| i + 1);
            if textured {
                let [p, q, r] = obj.uv_triangles[i].map(|i| i + 1);
                writeln!(out, "f {a}/{p} {b}/{q} {c}/{r}")?;
            } else {
                writeln!(out, "f {a} {b} {c}")?;
            }
        }
        out.flush()
    };
    write().map_err(AssetError::writing(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<Obj, String> {
        parse(text.as_bytes()).map_err(|fault| match fault {
            Fault::Io(e) => e.to_string(),
            Fault::Content(reason) => reason,
        })
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";

    #[test]
    fn polygons_become_fans_and_groups_stay_one_mesh() {
        let text = format!(
            "mtllib nowhere.mtl\n{SQUARE}g one\nusemtl a\nf 1/1 2/2 3/3 4/4\ng two\nf -4/2 -3/3 \\\n -2/4\n"
        );
        let mesh = parsed(&text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        assert_eq!(mesh.positions.len(), 4);
        let uv = |t: usize, c: usize| mesh.uvs[mesh.uv_triangles[t][c] as usize];
        assert_eq!(uv(1, 2), Vec2::new(0.0, 1.0));
        assert_eq!([uv(2, 0), uv(2, 1), uv(2, 2)], [Vec2::new(1.0, 0.0), Vec2::ONE, Vec2::new(0.0, 1.0)]);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        let mesh = parsed(&format!("{SQUARE}f 1/4 2/3 3/2\nf 1/4 3/2 4/1\n")).unwrap();
        write(&path, &mesh, &["metres, z up"]).unwrap();
        assert_eq!(read(&path).unwrap(), mesh);
        let bare = Obj { uvs: vec![], uv_triangles: vec![], ..mesh };
        write(&path, &bare, &[]).unwrap();
        assert_eq!(read(&path).unwrap(), bare);
    }

    #[test]
    fn a_material_is_found_by_an_independent_reader() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = parsed(&format!("{SQUARE}f 1/4 2/3 3/2\n")).unwrap();
        let material = Material { library: "a.mtl", name: "reflectance" };
        write_with(&folder.path().join("a.obj"), &mesh, &["metres"], Some(material)).unwrap();
        write_material(&folder.path().join("a.mtl"), "reflectance", "a.png", &["sRGB"]).unwrap();
        let (models, materials) =
            tobj::load_obj(folder.path().join("a.obj"), &tobj::LoadOptions::default()).unwrap();
        let material = &materials.unwrap()[models[0].mesh.material_id.unwrap()];
        assert_eq!(material.diffuse_texture.as_deref(), Some("a.png"));
        assert_eq!((material.diffuse, material.specular), (Some([1.0; 3]), Some([0.0; 3])));
        assert_eq!(read(&folder.path().join("a.obj")).unwrap(), mesh);
    }

    #[test]
    fn broken_meshes_are_refused_with_the_reason() {
        for (text, word) in [
            ("", "no faces"),
            (SQUARE, "no faces"),
            ("l 1 2\nv 0 0 0\nv 1 1 1\n", "no faces"),
            (&format!("{SQUARE}f 1 2\n"), "no faces"),
            (&format!("{SQUARE}f 1 2 9\n"), "index"),
            (&format!("{SQUARE}f 0 1 2\n"), ""),
            (&format!("{SQUARE}f 1/1 2/2 3/77\n"), "index"),
            (&format!("{SQUARE}f -9 -8 -7\n"), "index"),
            (&format!("{SQUARE}f 1 2 x\n"), "line 9"),
            (&format!("{SQUARE}f 1/1 2/2 3/3\nf 1 2 3\n"), "others have none"),
            ("v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a place"),
            ("v 0 inf 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a place"),
            ("v 0 1\n", "line 1"),
        ] {
            let error = parsed(text).expect_err(text);
            assert!(error.contains(word), "{text:?} gives {error:?}");
        }
        assert!(matches!(read(Path::new("/nowhere/a.obj")), Err(AssetError::Io { .. })));
    }
}
