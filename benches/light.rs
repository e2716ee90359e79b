//! How exact simulated light is and what it costs: irradiance maps and surface points of the birdbath and of the
//! studio's object against a path trace; processor seconds of every part.
//!
//!     cargo bench --profile dev --bench light
//!
//! UNLIT_LIGHT_STRIDE (default 3) sets how many pixels apart the path trace is asked, UNLIT_LIGHT_SCENE one scene alone.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark stops at the first thing that is wrong"
)]

#[path = "shared/against_path.rs"]
mod against_path;
#[path = "../tests/all/processes.rs"]
#[allow(dead_code, reason = "other benchmarks use the rest")]
mod processes;
#[path = "../tests/all/samples.rs"]
mod samples;

use against_path::{Error, Scene};
use processes::cpu_seconds;
use unlit::light::{Finish, Spot, expose, interpolate};
use unlit::progress::Progress;
use unlit::reflectance::bounce::simulate;
use unlit::reflectance::stage::Stage;
use unlit::scene::Mesh;

fn timed<T>(name: &str, work: impl FnOnce() -> T) -> T {
    let begun = cpu_seconds();
    let result = work();
    println!("    {name:<44} {:>7.2} CPU-s", cpu_seconds() - begun);
    result
}

fn main() {
    let stride = std::env::var("UNLIT_LIGHT_STRIDE").ok().and_then(|s| s.parse().ok()).unwrap_or(3);
    let only = std::env::var("UNLIT_LIGHT_SCENE").unwrap_or_default();
    for (name, load) in [("birdbath", Scene::birdbath as fn() -> Scene), ("studio", Scene::studio)] {
        if name.contains(&only) {
            println!("{name}");
            let scene = timed("loading", load);
            growth(&scene);
            run(&scene, stride);
        }
    }
}

/// Cost of direct maps against views, pixels and triangles: a million pixels should cost the same throughout.
fn growth(scene: &Scene) {
    println!("    views     pixels  elements |  tree | sight and maps | CPU-s a million pixels");
    let mut meshes = scene.meshes.clone();
    for (views, pixels, refined) in
        [(1, 1.0, false), (3, 1.0, false), (9, 1.0, false), (3, 0.5, false), (3, 2.0, false), (3, 1.0, true)]
    {
        if refined {
            meshes = meshes.iter().map(halved).collect();
        }
        let begun = cpu_seconds();
        let stage = Stage::build(&meshes, 1);
        let built = cpu_seconds();
        let mut seen = 0;
        for k in 0..views {
            let mut camera = scene.cameras[(3 * k + 1) * scene.cameras.len() / (3 * views)].clone();
            let lens = &mut camera.intrinsics;
            let scaled = |n: usize| (n as f64 * pixels) as usize;
            (lens.width, lens.height) = (scaled(lens.width), scaled(lens.height));
            (lens.focal, lens.principal) = (lens.focal * pixels, lens.principal * pixels);
            seen += lens.width * lens.height;
            let lamp = scene.lamp();
            let light = stage.illuminate(&camera, &lamp);
            let shade = |s: &Spot| Some([light.at_spot(s) as f32; 3]);
            let _ = expose(&camera, &stage.elements, light.sight(), Finish::Fast, shade, &Progress::silent());
        }
        let cost = cpu_seconds() - built;
        println!(
            "    {views:>5} {seen:>10} {:>9} | {:>5.2} | {cost:>14.2} | {:>6.2}",
            stage.elements.len(),
            built - begun,
            cost / seen as f64 * 1e6
        );
    }
}

/// Every triangle cut into four.
fn halved(mesh: &Mesh) -> Mesh {
    let mut fine = Mesh::default();
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        let (d, e, f) = ((a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0);
        let first = fine.positions.len() as u32;
        fine.positions.extend([a, b, c, d, e, f]);
        fine.triangles.extend([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]].map(|t| t.map(|i| i + first)));
    }
    fine
}

fn run(scene: &Scene, stride: usize) {
    let stage = timed("elements and tree", || scene.stage());
    println!("    {} elements, {} patches", stage.elements.len(), stage.patches.len());
    let transport = timed("transport, once a scene", || stage.transport(&Progress::silent()).unwrap());
    for camera in scene.cameras.iter().step_by(scene.cameras.len().div_ceil(3)) {
        println!("  camera {}", camera.name);
        let lamp = scene.lamp();
        let light = timed("the view's free sight", || stage.illuminate(camera, &lamp));
        let shade = |s: &Spot| (s.facing > 0.0).then(|| [light.at_spot(s) as f32, 0.0, 0.0]);
        let maps = [Finish::Fast, Finish::Fine].map(|finish| {
            timed(&format!("direct map, {finish:?}"), || {
                expose(camera, &stage.elements, light.sight(), finish, shade, &Progress::silent()).unwrap()
            })
        });
        let reference = timed("(path trace, direct)", || scene.direct_reference(camera, stride));
        for (map, finish) in maps.iter().zip(["Fast", "Fine"]) {
            Error::of(
                reference
                    .iter()
                    .map(|(x, y, [a, b])| (map.at(*x, *y).map(|m| f64::from(m[0])), a.direct, b.direct)),
            )
            .print(&format!("direct map, {finish}"));
        }
        let alone = |s: &Spot| if stage.elements.mesh_of(s.element) == 0 { shade(s) } else { None };
        let map = timed("direct map, Fast, of the object alone", || {
            expose(camera, &stage.elements, light.sight(), Finish::Fast, alone, &Progress::silent()).unwrap()
        });
        let seen = map.pixels().iter().flatten().count();
        println!("    {seen} pixels show the object alone");
        let direct = timed("direct on patches", || stage.direct(&light));
        for (name, rho, materials) in scene.materials(&stage) {
            let bounced = timed("bounces on patches", || {
                simulate(&transport, &direct, lamp.radiance, &rho, &Progress::silent()).unwrap()
            });
            let corners = timed("smoothed", || stage.smooth(&bounced));
            let shade = |s: &Spot| {
                let b = interpolate(&corners[s.element], s.at);
                (s.facing > 0.0).then(|| b.map(|b| b + light.at_spot(s) as f32))
            };
            let maps = [Finish::Fast, Finish::Fine].map(|finish| {
                timed(&format!("map with bounces, {finish:?}"), || {
                    expose(camera, &stage.elements, light.sight(), finish, shade, &Progress::silent())
                        .unwrap()
                })
            });
            let reference =
                timed("(path trace, bounces)", || scene.bounced_reference(&materials, camera, 2 * stride));
            for (map, finish) in maps.iter().zip(["Fast", "Fine"]) {
                Error::of(reference.iter().flat_map(|(x, y, [a, b])| {
                    let map = *map.at(*x, *y);
                    (0..3).map(move |c| {
                        (map.map(|m| f64::from(m[c])), a.direct + a.bounced[c], b.direct + b.bounced[c])
                    })
                }))
                .print(&format!("{name}: map with bounces, {finish}"));
            }
            let points = timed("(path trace, points)", || scene.points(&materials, &stage, camera, 4000));
            Error::of(points.iter().flat_map(|p| {
                let b = interpolate(&corners[p.element], p.at);
                let [r, s] = p.reference;
                (0..3).map(move |c| (Some(f64::from(b[c])), r.bounced[c], s.bounced[c]))
            }))
            .print(&format!("{name}: bounced alone at points"));
            Error::of(points.iter().map(|p| {
                let [r, s] = p.reference;
                (Some(light.direct(p.point, p.normal)), r.direct, s.direct)
            }))
            .print("direct at points");
        }
    }
}
