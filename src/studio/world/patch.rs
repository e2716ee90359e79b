//! Surfaces built of parametric patches, each with a rectangle of its own in the texture.
//!
//! A [`Patch`] maps the unit square to points in metres; [`assemble`] turns a list of them into one mesh whose
//! shared edges are closed, packs their rectangles into a square atlas without overlap and paints every texel,
//! a margin round each rectangle included, from the patch's own glaze. Positions are rounded to 0.1 um and
//! reflectances to 1/65535, so that exported files carry exactly what was rendered and digests do not hang on
//! the last bit of a sine.

use crate::scene::Mesh;
use glam::{DVec2, DVec3, Vec2};
use std::collections::HashMap;

/// Margin round each chart, texels.
const MARGIN: usize = 4;

/// Coordinates are multiples of one part in this, metres.
const GRID: f64 = 1e7;

/// Reflectance in camera RGB of a surface point: world position in metres and place in the unit square.
pub(super) type Glaze = fn(DVec3, DVec2) -> DVec3;

/// One smooth piece of a surface.
pub(super) struct Patch {
    /// Facet pairs along the first and the second coordinate.
    pub(super) cells: (usize, usize),
    /// Size that the chart stands for, metres.
    pub(super) size: (f64, f64),
    /// Point in metres at (s, t) in the unit square; the partial derivatives' cross product points outwards.
    /// Must continue smoothly a little past the square, for the chart's margin.
    pub(super) surface: Box<dyn Fn(DVec2) -> DVec3 + Send + Sync>,
    /// Its colour.
    pub(super) glaze: Glaze,
}

/// A square texture of reflectance, 1/65535 a step; row 0 is at v = 1.
#[derive(Clone)]
pub(super) struct Texture {
    /// Texels a side.
    pub(super) size: usize,
    /// Row-major camera RGB.
    pub(super) texels: Vec<[u16; 3]>,
}

impl Texture {
    /// A texture of one reflectance.
    #[cfg(test)]
    pub(super) fn plain(value: f32) -> Self {
        Self { size: 1, texels: vec![[(value * 65535.0).round() as u16; 3]] }
    }

    /// Reflectance at texture coordinates, bilinear between texel centres, clamped at the border.
    pub(super) fn at(&self, uv: Vec2) -> [f32; 3] {
        let last = (self.size - 1) as f32;
        let x = (uv.x * self.size as f32 - 0.5).clamp(0.0, last);
        let y = ((1.0 - uv.y) * self.size as f32 - 0.5).clamp(0.0, last);
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.size - 1), (y0 + 1).min(self.size - 1));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let texel = |x: usize, y: usize| self.texels[y * self.size + x];
        let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
        std::array::from_fn(|k| {
            let top = f32::from(a[k]) * (1.0 - fx) + f32::from(b[k]) * fx;
            let bottom = f32::from(c[k]) * (1.0 - fx) + f32::from(d[k]) * fx;
            (top * (1.0 - fy) + bottom * fy) / 65535.0
        })
    }
}

/// Where a patch's chart lies: left edge, lower edge, width and height in texels, margin not counted.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Chart {
    left: usize,
    bottom: usize,
    width: usize,
    height: usize,
}

/// Makes one mesh and its texture of `texels` a side.
pub(super) fn assemble(name: &str, patches: &[Patch], texels: usize) -> (Mesh, Texture) {
    let charts = pack(patches, texels);
    let mut mesh = Mesh { name: name.to_owned(), ..Mesh::default() };
    let mut known = HashMap::new();
    let mut texture = Texture { size: texels, texels: vec![[0; 3]; texels * texels] };
    for (patch, chart) in patches.iter().zip(&charts) {
        add_facets(&mut mesh, &mut known, patch, chart, texels);
        paint(&mut texture, patch, chart);
    }
    (mesh, texture)
}

fn add_facets(
    mesh: &mut Mesh,
    known: &mut HashMap<[i64; 3], u32>,
    patch: &Patch,
    chart: &Chart,
    texels: usize,
) {
    let (columns, rows) = patch.cells;
    let first_uv = mesh.uvs.len() as u32;
    let mut corner = Vec::with_capacity((columns + 1) * (rows + 1));
    for j in 0..=rows {
        for i in 0..=columns {
            let st = DVec2::new(i as f64 / columns as f64, j as f64 / rows as f64);
            let key = (patch.surface)(st).to_array().map(|x| (x * GRID).round() as i64);
            corner.push(*known.entry(key).or_insert_with(|| {
                mesh.positions.push(DVec3::from(key.map(|x| x as f64 / GRID)).as_vec3());
                (mesh.positions.len() - 1) as u32
            }));
            let texel = DVec2::new(chart.left as f64, chart.bottom as f64)
                + st * DVec2::new(chart.width as f64, chart.height as f64);
            mesh.uvs.push((texel / texels as f64).as_vec2());
        }
    }
    let at = |i: usize, j: usize| (j * (columns + 1) + i) as u32;
    for j in 0..rows {
        for i in 0..columns {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            for facet in [[a, b, c], [a, c, d]] {
                mesh.triangles.push(facet.map(|k| corner[k as usize]));
                mesh.uv_triangles.push(facet.map(|k| first_uv + k));
            }
        }
    }
}

fn paint(texture: &mut Texture, patch: &Patch, chart: &Chart) {
    let size = texture.size;
    for v in chart.bottom - MARGIN..chart.bottom + chart.height + MARGIN {
        for u in chart.left - MARGIN..chart.left + chart.width + MARGIN {
            let st = DVec2::new(
                (u as f64 + 0.5 - chart.left as f64) / chart.width as f64,
                (v as f64 + 0.5 - chart.bottom as f64) / chart.height as f64,
            );
            let colour = (patch.glaze)((patch.surface)(st), st);
            texture.texels[(size - 1 - v) * size + u] =
                colour.to_array().map(|c| (c.clamp(0.05, 0.85) * 65535.0).round() as u16);
        }
    }
}

/// Places all charts on shelves, tallest first, at the finest scale that fits.
fn pack(patches: &[Patch], texels: usize) -> Vec<Chart> {
    let area: f64 = patches.iter().map(|p| p.size.0 * p.size.1).sum();
    let mut per_metre = texels as f64 / area.sqrt();
    loop {
        if let Some(charts) = shelve(patches, texels, per_metre) {
            return charts;
        }
        per_metre *= 0.99;
    }
}

fn shelve(patches: &[Patch], texels: usize, per_metre: f64) -> Option<Vec<Chart>> {
    let extent = |metres: f64| ((metres * per_metre) as usize).max(1);
    let mut order: Vec<usize> = (0..patches.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(extent(patches[i].size.1)));
    let mut charts = vec![Chart { left: 0, bottom: 0, width: 0, height: 0 }; patches.len()];
    let (mut x, mut y, mut shelf) = (0, 0, 0);
    for i in order {
        let (width, height) = (extent(patches[i].size.0), extent(patches[i].size.1));
        if x + width + 2 * MARGIN > texels {
            (x, y, shelf) = (0, y + shelf, 0);
        }
        if x + width + 2 * MARGIN > texels || y + height + 2 * MARGIN > texels {
            return None;
        }
        charts[i] = Chart { left: x + MARGIN, bottom: y + MARGIN, width, height };
        x += width + 2 * MARGIN;
        shelf = shelf.max(height + 2 * MARGIN);
    }
    Some(charts)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: f64, height: f64) -> Patch {
        Patch {
            cells: (2, 3),
            size: (width, height),
            surface: Box::new(move |st| DVec3::new(st.x * width, st.y * height, 0.0)),
            glaze: |p, _| DVec3::new(0.2 + p.x, 0.2 + p.y, 0.5),
        }
    }

    #[test]
    fn charts_with_their_margins_do_not_overlap() {
        let patches: Vec<Patch> =
            [(0.3, 0.2), (0.1, 0.5), (0.2, 0.2), (0.4, 0.05)].map(|(w, h)| flat(w, h)).into();
        let charts = pack(&patches, 128);
        let mut owner = vec![0; 128 * 128];
        for chart in &charts {
            for y in chart.bottom - MARGIN..chart.bottom + chart.height + MARGIN {
                for x in chart.left - MARGIN..chart.left + chart.width + MARGIN {
                    owner[y * 128 + x] += 1;
                }
            }
        }
        assert!(owner.iter().all(|&n| n <= 1));
    }

    #[test]
    fn the_texture_holds_the_glaze_at_the_mesh_s_own_coordinates() {
        let (mesh, texture) = assemble("flat", &[flat(0.3, 0.2), flat(0.1, 0.4)], 256);
        for (triangle, corners) in mesh.triangles.iter().enumerate() {
            for (&i, uv) in corners.iter().zip(mesh.uv_corners(triangle).unwrap()) {
                let p = mesh.positions[i as usize];
                let found = texture.at(uv);
                let expected = [0.2 + p.x, 0.2 + p.y, 0.5];
                for k in 0..3 {
                    assert!((found[k] - expected[k]).abs() < 1e-4, "{found:?} for {expected:?}");
                }
            }
        }
    }
}
