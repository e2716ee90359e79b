//! The texture: which surface point each texel is, and what fills the texels between charts.
//!
//! Texel (i, j) of a texture of n x n stands at u = (i + 0.5) / n, v = 1 - (j + 0.5) / n: row 0 is at v = 1.

use crate::raster::Image;
use crate::scene::Mesh;
use glam::Vec2;
use std::collections::HashMap;

/// A texel on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelPoint {
    /// Index in the texture, row-major.
    pub texel: u32,
    /// Triangle of the mesh.
    pub triangle: u32,
    /// Barycentric weight of the second corner.
    pub u: f32,
    /// Barycentric weight of the third corner.
    pub v: f32,
}

/// The mesh cannot carry a texture.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AtlasError {
    /// No texture coordinates.
    #[error(
        "mesh {0} has no texture coordinates: process it with --uvs auto to have them made, or export it with UVs from the photogrammetry program"
    )]
    NoUvs(String),
    /// Coordinates outside the unit square.
    #[error(
        "mesh {mesh} has texture coordinates outside 0..1 on {share:.0} % of its triangles: several texture pages or tiling are not supported, export it with one page"
    )]
    Outside {
        /// Mesh.
        mesh: String,
        /// Per cent.
        share: f64,
    },
    /// Charts on top of one another.
    #[error(
        "mesh {mesh}: {share:.0} % of its texels belong to several triangles: its UVs overlap, unwrap it without overlaps"
    )]
    Overlap {
        /// Mesh.
        mesh: String,
        /// Per cent.
        share: f64,
    },
}

/// Share of texels that may be claimed twice (chart borders are, by rounding) before it is called overlap.
const MOST_OVERLAP: f64 = 0.02;

/// Lays the triangles out in a texture of `size` x `size`: all texels whose centre lies in a triangle, and
/// those within a texel of one, which bilinear look-ups at the chart's border read; these stand for the
/// nearest point of their triangle. In the order of texels.
pub fn lay_out(mesh: &Mesh, size: usize) -> Result<Vec<TexelPoint>, AtlasError> {
    if mesh.uv_triangles.len() != mesh.triangles.len() || mesh.triangles.is_empty() {
        return Err(AtlasError::NoUvs(mesh.name.clone()));
    }
    let mut owner: Vec<Option<TexelPoint>> = vec![None; size * size];
    let mut charts = vec![];
    let (mut outside, mut claimed, mut twice) = (0usize, 0usize, 0usize);
    for t in 0..mesh.triangles.len() {
        let Some(uv) = mesh.uv_corners(t) else { continue };
        if uv.iter().any(|p| !p.is_finite() || p.min_element() < -1e-4 || p.max_element() > 1.0 + 1e-4) {
            outside += 1;
            continue;
        }
        let corners = uv.map(|p| Vec2::new(p.x, 1.0 - p.y) * size as f32);
        rasterise(corners, size, |x, y, u, v| {
            let texel = y * size + x;
            claimed += 1;
            match &owner[texel] {
                // A texel exactly on a shared edge is claimed by both sides; that is no overlap.
                Some(_) if u.min(v).min(1.0 - u - v) > 1e-3 => twice += 1,
                Some(_) => {}
                None => {
                    owner[texel] = Some(TexelPoint { texel: texel as u32, triangle: t as u32, u, v });
                }
            }
        });
        // One that has no area in the texture has nothing to lend to a border.
        if (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]) != 0.0 {
            charts.push((t as u32, corners));
        }
    }
    claim_borders(&charts, size, &mut owner);
    if outside * 100 > mesh.triangles.len() {
        let share = 100.0 * outside as f64 / mesh.triangles.len() as f64;
        return Err(AtlasError::Outside { mesh: mesh.name.clone(), share });
    }
    if claimed > 0 && twice as f64 > MOST_OVERLAP * claimed as f64 {
        let share = 100.0 * twice as f64 / claimed as f64;
        return Err(AtlasError::Overlap { mesh: mesh.name.clone(), share });
    }
    Ok(owner.into_iter().flatten().collect())
}

/// How far from a triangle, in texels, bilinear look-ups inside it read: a diagonal.
const REACH: f32 = 1.42;

/// Gives free texels within [`REACH`] of a triangle to the nearest point of the nearest such triangle.
fn claim_borders(charts: &[(u32, [Vec2; 3])], size: usize, owner: &mut [Option<TexelPoint>]) {
    let mut nearest: HashMap<usize, (f32, TexelPoint)> = HashMap::new();
    for &(triangle, corners) in charts {
        let (low, high) = bounds(&corners, REACH, size);
        for y in low.1..high.1 {
            for x in low.0..high.0 {
                let texel = y * size + x;
                if owner[texel].is_some() {
                    continue;
                }
                let (distance, u, v) = nearest_point(&corners, Vec2::new(x as f32, y as f32) + 0.5);
                if distance <= REACH && nearest.get(&texel).is_none_or(|(d, _)| distance < *d) {
                    nearest.insert(texel, (distance, TexelPoint { texel: texel as u32, triangle, u, v }));
                }
            }
        }
    }
    for (texel, (_, point)) in nearest {
        owner[texel] = Some(point);
    }
}

/// Columns and rows of the pixels whose centres lie in the triangle's box widened by `margin`, ends excluded.
fn bounds([a, b, c]: &[Vec2; 3], margin: f32, size: usize) -> ((usize, usize), (usize, usize)) {
    let (low, high) = (a.min(*b).min(*c) - margin, a.max(*b).max(*c) + margin);
    let first = |x: f32| (x - 0.5).ceil().max(0.0) as usize;
    let end = |x: f32| ((x - 0.5).floor() + 1.0).clamp(0.0, size as f32) as usize;
    ((first(low.x), first(low.y)), (end(high.x), end(high.y)))
}

/// Distance from `p` to the triangle's nearest point on its border, and that point's barycentric weights.
fn nearest_point(corners: &[Vec2; 3], p: Vec2) -> (f32, f32, f32) {
    let mut best = (f32::INFINITY, 0.0, 0.0);
    for edge in 0..3 {
        let (a, b) = (corners[edge], corners[(edge + 1) % 3]);
        let along = b - a;
        let s = ((p - a).dot(along) / along.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        let distance = (a + along * s - p).length();
        if distance < best.0 {
            let mut weights = [0.0; 3];
            weights[edge] = 1.0 - s;
            weights[(edge + 1) % 3] = s;
            best = (distance, weights[1], weights[2]);
        }
    }
    best
}

/// Calls `hit(x, y, u, v)` for every pixel whose centre lies in the triangle (pixel coordinates, y down).
fn rasterise([a, b, c]: [Vec2; 3], size: usize, mut hit: impl FnMut(usize, usize, f32, f32)) {
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let (low, high) = bounds(&[a, b, c], 0.0, size);
    for y in low.1..high.1 {
        for x in low.0..high.0 {
            let p = Vec2::new(x as f32, y as f32) + 0.5 - a;
            let (u, v) = (p.perp_dot(c - a) / area, (b - a).perp_dot(p) / area);
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                hit(x, y, u, v);
            }
        }
    }
}

/// Side of the square texture, a power of two from 256 to 8192, whose texels are about as large as the finest
/// pixel footprint on the object: `triangles` gives each triangle's area in square metres, `footprint` the
/// metres that a pixel covers on the surface.
pub fn fitting_size(mesh: &Mesh, footprint: f64) -> usize {
    let (mut surface, mut chart) = (0.0f64, 0.0f64);
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        let Some([p, q, r]) = mesh.uv_corners(t) else { continue };
        surface += f64::from((b - a).cross(c - a).length());
        chart += f64::from((q - p).perp_dot(r - p).abs());
    }
    if surface <= 0.0 || chart <= 0.0 || footprint <= 0.0 {
        return 1024;
    }
    // Texel edge on the surface at size n: sqrt(surface / chart) / n.
    let wanted = (surface / chart).sqrt() / footprint;
    (wanted.clamp(256.0, 8192.0) as usize).next_power_of_two()
}

/// Fills unknown texels from known ones, near ones first (push and pull over a pyramid of halved images, after
/// Gortler et al., "The Lumigraph", 1996): gutters get their chart's colour, so that mip levels do not bleed.
pub fn fill(texture: &Image<Option<[f32; 3]>>) -> Image<[f32; 3]> {
    let (width, height) = (texture.width(), texture.height());
    if width <= 1 && height <= 1 {
        return texture.map(|p| p.unwrap_or([0.0; 3]));
    }
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let halved = Image::from_fn(half_width, half_height, |x, y| {
        let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            if let Some(Some(p)) = texture.get((2 * x + dx) as isize, (2 * y + dy) as isize) {
                count += 1.0;
                for c in 0..3 {
                    sum[c] += p[c];
                }
            }
        }
        (count > 0.0).then(|| sum.map(|s| s / count))
    });
    let filled = fill(&halved);
    Image::from_fn(width, height, |x, y| texture.at(x, y).unwrap_or_else(|| *filled.at(x / 2, y / 2)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn square() -> Mesh {
        Mesh {
            name: "square".into(),
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            uvs: vec![
                Vec2::new(0.25, 0.25),
                Vec2::new(0.75, 0.25),
                Vec2::new(0.75, 0.75),
                Vec2::new(0.25, 0.75),
            ],
            uv_triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    #[test]
    fn texels_stand_where_their_coordinates_say() {
        let mesh = square();
        let points = lay_out(&mesh, 64).unwrap();
        let inside = |x: u32| (16..48).contains(&x);
        let inner: Vec<_> = points.iter().filter(|p| inside(p.texel % 64) && inside(p.texel / 64)).collect();
        assert_eq!((inner.len(), points.len()), (32 * 32, 32 * 32 + 4 * 32 + 4));
        for p in inner {
            let [a, b, c] = mesh.corners(p.triangle as usize);
            let at = a * (1.0 - p.u - p.v) + b * p.u + c * p.v;
            let (x, y) = (p.texel % 64, p.texel / 64);
            let want = Vec3::new((x as f32 + 0.5) / 32.0 - 0.5, 1.5 - (y as f32 + 0.5) / 32.0, 0.0);
            assert!((at - want).length() < 1e-5, "{at} {want}");
        }
    }

    #[test]
    fn meshes_that_cannot_carry_a_texture_say_why() {
        let bare = Mesh { uvs: vec![], uv_triangles: vec![], ..square() };
        assert!(matches!(lay_out(&bare, 64), Err(AtlasError::NoUvs(_))));
        let doubled = Mesh { triangles: vec![[0, 1, 2]; 2], uv_triangles: vec![[0, 1, 2]; 2], ..square() };
        assert!(matches!(lay_out(&doubled, 64), Err(AtlasError::Overlap { .. })));
        let tiled = Mesh { uvs: square().uvs.iter().map(|p| *p * 3.0).collect(), ..square() };
        assert!(matches!(lay_out(&tiled, 64), Err(AtlasError::Outside { .. })));
    }

    #[test]
    fn gutters_take_the_colour_of_their_chart() {
        let texture = Image::from_fn(16, 16, |x, _| match x {
            0..=5 => Some([1.0, 0.0, 0.0]),
            12.. => Some([0.0, 0.0, 1.0]),
            _ => None,
        });
        let filled = fill(&texture);
        assert_eq!(filled.at(6, 8), &[1.0, 0.0, 0.0]);
        assert_eq!(filled.at(11, 8), &[0.0, 0.0, 1.0]);
        assert_eq!(filled.at(2, 2), &[1.0, 0.0, 0.0]);
        assert_eq!(*fill(&Image::filled(4, 4, None)).at(1, 1), [0.0; 3]);
    }

    #[test]
    fn texture_size_follows_the_pixel_footprint() {
        // 1 m over half the texture: at 1 mm a pixel 2000 texels are wanted.
        assert_eq!(fitting_size(&square(), 1e-3), 2048);
        assert_eq!(fitting_size(&square(), 0.1), 256);
    }
}
