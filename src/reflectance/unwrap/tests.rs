//! Atlases of shapes that are known to be hard: closed, noisy, torn, crossed, without area.

use super::*;
use crate::reflectance::atlas::TexelPoint;
use glam::Vec3;
use proptest::prelude::*;
use std::collections::HashMap;

/// A closed sphere of radius 1 with `rings` x `2 rings` faces; its poles are rings of triangles without area at one
/// vertex each. `push` moves every vertex along its normal.
fn sphere(rings: u32, mut push: impl FnMut(usize) -> f32) -> Mesh {
    let columns = 2 * rings;
    let mut positions = vec![];
    for i in 0..=rings {
        for k in 0..columns {
            let (polar, around) = (
                std::f32::consts::PI * i as f32 / rings as f32,
                std::f32::consts::TAU * k as f32 / columns as f32,
            );
            // The poles are one place, whatever the sine of pi is.
            let sine = if i == 0 || i == rings { 0.0 } else { polar.sin() };
            let at = Vec3::new(sine * around.cos(), sine * around.sin(), polar.cos());
            positions.push(at * (1.0 + if sine == 0.0 { 0.0 } else { push(positions.len()) }));
        }
    }
    let at = |i: u32, k: u32| i * columns + k % columns;
    let mut triangles = vec![];
    for i in 0..rings {
        for k in 0..columns {
            triangles.push([at(i, k), at(i + 1, k), at(i + 1, k + 1)]);
            triangles.push([at(i, k), at(i + 1, k + 1), at(i, k + 1)]);
        }
    }
    Mesh { name: "sphere".into(), positions, triangles, ..Mesh::default() }
}

fn cube() -> Mesh {
    let positions = (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32)).collect();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Mesh { name: "cube".into(), positions, triangles, ..Mesh::default() }
}

/// A cheap noise of its own kind in -1..1.
fn noise(i: usize) -> f32 {
    let mut x = (i as u32).wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
    x = (x ^ (x >> 12)).wrapping_mul(0x297a_2d39);
    ((x ^ (x >> 15)) as f32 / u32::MAX as f32) * 2.0 - 1.0
}

fn atlas(mesh: &Mesh, size: usize) -> (Charts, Packed, Mesh) {
    let charts = Charts::cut(mesh, &Progress::silent()).unwrap();
    let packed = charts.pack(mesh, size).unwrap();
    let textured =
        Mesh { uvs: packed.uvs.clone(), uv_triangles: packed.uv_triangles.clone(), ..mesh.clone() };
    (charts, packed, textured)
}

/// What every atlas must be: coordinates inside, front kept, no texel claimed by two charts or deep inside two
/// triangles, charts far enough apart, lengths kept within bounds. Gives the texels.
fn assert_sound(charts: &Charts, textured: &Mesh, size: usize) -> Vec<TexelPoint> {
    assert!(textured.uvs.iter().flat_map(|p| p.to_array()).all(|x| (0.0..=1.0).contains(&x)));
    let mut chart_of = vec![usize::MAX; textured.triangles.len()];
    for (i, chart) in charts.charts.iter().enumerate() {
        for &t in &chart.triangles {
            assert_eq!(chart_of[t as usize], usize::MAX, "triangle {t} is in two charts");
            chart_of[t as usize] = i;
        }
    }
    let scale = scale(charts, textured);
    let mut worst = 1.0f32;
    for t in 0..textured.triangles.len() {
        let [a, b, c] = textured.corners(t);
        let [p, q, r] = textured.uv_corners(t).unwrap();
        let area = (b - a).cross(c - a).length();
        let flat = (q - p).perp_dot(r - p) / (scale * scale);
        let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
        if area > 1e-3 * longest {
            assert!(flat > 0.0, "triangle {t} lies on its back or has no area: {flat} of {area}");
            worst = worst.max(area / flat);
        }
    }
    assert!(worst < MOST_STRETCH * 1.05, "stretch {worst}");

    let points = lay_out(textured, size).unwrap();
    let mut owner = vec![usize::MAX; size * size];
    points.iter().for_each(|p| owner[p.texel as usize] = chart_of[p.triangle as usize]);
    let reach = 2 * GUTTER as isize - 2;
    let at = |x: isize, y: isize| {
        let n = size as isize;
        ((0..n).contains(&x) && (0..n).contains(&y)).then(|| owner[(y * n + x) as usize])
    };
    for p in &points {
        let (x, y) = ((p.texel as usize % size) as isize, (p.texel as usize / size) as isize);
        let own = owner[p.texel as usize];
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let other = at(x + dx, y + dy).unwrap_or(own);
                assert!(other == own || other == usize::MAX, "two charts meet at texel {x}, {y}");
            }
        }
    }
    points
}

/// Texture units per metre, from the charts themselves.
fn scale(charts: &Charts, textured: &Mesh) -> f32 {
    let chart = charts.charts.iter().max_by(|a, b| a.extent.x.total_cmp(&b.extent.x)).unwrap();
    let of = |f: &dyn Fn(u32, usize) -> Vec2| {
        let corners = chart.triangles.iter().flat_map(|&t| (0..3).map(move |k| (t, k)));
        let points: Vec<Vec2> = corners.map(|(t, k)| f(t, k)).collect();
        points.iter().map(|p| p.x).fold(f32::MIN, f32::max)
            - points.iter().map(|p| p.x).fold(f32::MAX, f32::min)
    };
    let flat = of(&|t, k| chart.points[chart.index(textured.triangles[t as usize][k])]);
    of(&|t, k| textured.uv_corners(t as usize).unwrap()[k]) / flat
}

/// Texels that lie strictly inside two triangles.
fn doubly_covered(mesh: &Mesh, size: usize) -> usize {
    let mut count: HashMap<(usize, usize), usize> = HashMap::new();
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.uv_corners(t).unwrap().map(|p| p * size as f32);
        let area = (b - a).perp_dot(c - a);
        if area <= 0.0 {
            continue;
        }
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        for y in low.y as usize..=high.y as usize {
            for x in low.x as usize..=high.x as usize {
                let p = Vec2::new(x as f32, y as f32) + 0.5 - a;
                let (u, v) = (p.perp_dot(c - a) / area, (b - a).perp_dot(p) / area);
                if u.min(v).min(1.0 - u - v) > 1e-2 {
                    *count.entry((x, y)).or_default() += 1;
                }
            }
        }
    }
    count.values().filter(|&&n| n > 1).count()
}

#[test]
fn a_cube_becomes_six_squares() {
    let mesh = cube();
    let (charts, packed, textured) = atlas(&mesh, 256);
    assert_eq!(charts.len(), 6);
    assert!((charts.stretch[0] - 1.0).abs() < 1e-4);
    assert!(packed.coverage > 0.55, "{}", packed.coverage);
    let points = assert_sound(&charts, &textured, 256);
    assert!(points.len() as f64 > packed.coverage * 256.0 * 256.0);
    assert_eq!(doubly_covered(&textured, 256), 0);
    check_own(&textured).unwrap();
}

#[test]
fn a_closed_sphere_with_poles_is_cut_into_few_charts() {
    let mesh = sphere(48, |_| 0.0);
    let (charts, packed, textured) = atlas(&mesh, 512);
    assert!((3..=24).contains(&charts.len()), "{}", charts.len());
    assert!(packed.coverage > 0.4, "{}", packed.coverage);
    assert_sound(&charts, &textured, 512);
    assert_eq!(doubly_covered(&textured, 512), 0);
    check_own(&textured).unwrap();
}

#[test]
fn a_noisy_mesh_of_200_000_triangles_ends_and_is_sound() {
    // 224 rings make 200 704 triangles; each vertex is off by a quarter of an edge.
    let mesh = sphere(224, |i| 0.0035 * noise(i));
    assert!(mesh.triangles.len() > 200_000);
    let started = std::time::Instant::now();
    let _ = Charts::cut(&mesh, &Progress::silent()).unwrap();
    println!("cut in {:.2} s", started.elapsed().as_secs_f64());
    let (charts, packed, textured) = atlas(&mesh, 2048);
    println!("{} charts, stretch {:?}, coverage {:.3}", charts.len(), charts.stretch, packed.coverage);
    assert!(packed.coverage > 0.35, "{}", packed.coverage);
    assert_sound(&charts, &textured, 2048);
    assert_eq!(doubly_covered(&textured, 2048), 0);
}

#[test]
fn crossed_torn_and_collapsed_triangles_are_no_obstacle() {
    let mut mesh = cube();
    // A third triangle on an edge, one through the cube's middle, one turned over, three without area (a point, an
    // edge, three in a row), one alone, and the cube's first triangle once more.
    mesh.positions.extend([
        Vec3::new(0.5, -1.0, 0.0),
        Vec3::new(0.5, 0.0, 0.0),
        Vec3::new(7.0, 7.0, 7.0),
        Vec3::new(8.0, 7.0, 7.0),
        Vec3::new(7.0, 8.0, 7.0),
    ]);
    let odd = [[0, 1, 8], [0, 7, 3], [0, 1, 2], [5, 5, 5], [0, 1, 1], [0, 9, 1], [10, 11, 12], [10, 10, 11]];
    mesh.triangles.extend(odd);
    mesh.triangles.push(mesh.triangles[0]);
    let (charts, _, textured) = atlas(&mesh, 256);
    assert_sound(&charts, &textured, 256);
    assert_eq!(doubly_covered(&textured, 256), 0);
    check_own(&textured).unwrap();
}

#[test]
fn a_helix_that_would_lie_on_itself_is_parted() {
    // A ramp of three turns, nearly level: every triangle faces up, so that only its folding tells it from a disc.
    let steps = 180_u32;
    let positions = (0..=steps)
        .flat_map(|i| {
            let angle = 3.0 * std::f32::consts::TAU * i as f32 / steps as f32;
            let at = Vec3::new(angle.cos(), angle.sin(), 0.0);
            [at * 0.5 + Vec3::Z * angle * 0.02, at + Vec3::Z * angle * 0.02]
        })
        .collect();
    let triangles =
        (0..steps).flat_map(|i| [[2 * i, 2 * i + 1, 2 * i + 3], [2 * i, 2 * i + 3, 2 * i + 2]]).collect();
    let mesh = Mesh { name: "ramp".into(), positions, triangles, ..Mesh::default() };
    let (charts, _, textured) = atlas(&mesh, 512);
    assert!(charts.len() >= 3, "{}", charts.len());
    assert_sound(&charts, &textured, 512);
    assert_eq!(doubly_covered(&textured, 512), 0);
}

#[test]
fn the_atlas_does_not_depend_on_the_number_of_threads() {
    let mesh = sphere(40, |i| 0.02 * noise(i));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| atlas(&mesh, 512).2)
    };
    assert!(with(1) == with(5));
}

#[test]
fn own_coordinates_are_kept_or_refused_with_the_reason() {
    let (_, _, good) = atlas(&cube(), 256);
    assert_eq!(check_own(&good), Ok(()));
    let refused = |mesh: Mesh| check_own(&mesh).unwrap_err().to_string();
    assert!(refused(cube()).contains("no texture coordinates"));
    let stacked = Mesh { uv_triangles: vec![good.uv_triangles[0]; 12], ..good.clone() };
    assert!(refused(stacked).contains("several triangles"));
    let tiled = Mesh { uvs: good.uvs.iter().map(|p| *p * 4.0).collect(), ..good.clone() };
    assert!(refused(tiled).contains("outside 0..1"));
    let mut collapsed = good.clone();
    collapsed.uv_triangles[3] = [0; 3];
    assert!(refused(collapsed).contains("no area in its texture"));
}

#[test]
fn a_texture_too_small_for_the_charts_is_refused_with_their_number() {
    let mesh = sphere(24, |i| 0.1 * noise(i));
    let charts = Charts::cut(&mesh, &Progress::silent()).unwrap();
    let error = charts.pack(&mesh, 16).err().unwrap();
    assert!(matches!(error, UnwrapError::Crowded { charts: n, size: 16, .. } if n == charts.len()));
    let flat = Mesh { triangles: vec![[0, 0, 0]], ..cube() };
    assert!(matches!(Charts::cut(&flat, &Progress::silent()), Err(UnwrapError::NoSurface(_))));
    let progress = Progress::silent();
    progress.cancel();
    assert!(matches!(Charts::cut(&mesh, &progress), Err(UnwrapError::Cancelled(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_soup_of_triangles_gets_a_sound_atlas(
        places in prop::collection::vec(prop::array::uniform3(-1.0f32..1.0), 4..24),
        picks in prop::collection::vec(prop::array::uniform3(0usize..1000), 1..60),
    ) {
        let positions: Vec<Vec3> = places.into_iter().map(Vec3::from).collect();
        let triangles = picks.into_iter().map(|t| t.map(|i| (i % positions.len()) as u32)).collect();
        let mesh = Mesh { name: "soup".into(), positions, triangles, ..Mesh::default() };
        match Charts::cut(&mesh, &Progress::silent()) {
            Ok(charts) => {
                let packed = charts.pack(&mesh, 1024).unwrap();
                let textured = Mesh { uvs: packed.uvs, uv_triangles: packed.uv_triangles, ..mesh };
                assert_sound(&charts, &textured, 1024);
                prop_assert_eq!(doubly_covered(&textured, 1024), 0);
            }
            Err(error) => prop_assert!(matches!(error, UnwrapError::NoSurface(_)), "{}", error),
        }
    }
}
