//! How exact simulated light is and what it costs: irradiance maps and surface points of the birdbath and of the
//! studio's object against a path trace; processor seconds of every part.
//!
//!     cargo bench --profile dev --bench light
//!
//! UNLIT_LIGHT_STRIDE (default 3) sets how many pixels apart the path trace is asked.

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
            run(&timed("loading", load), stride);
        }
    }
}

fn run(scene: &Scene, stride: usize) {
    let stage = timed("elements and tree", || scene.stage());
    println!("    {} elements", stage.elements.len());
    let transport = timed("transport, once a scene", || stage.transport(&Progress::silent()).unwrap());
    for camera in scene.cameras.iter().step_by(scene.cameras.len().div_ceil(3)) {
        println!("  camera {}", camera.name);
        let lamp = scene.lamp();
        let light = timed("the view's free sight", || stage.illuminate(camera, &lamp));
        let shade = |s: &Spot| (s.facing > 0.0).then(|| [light.glimpsed(s.point, s.normal) as f32, 0.0, 0.0]);
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
        if std::env::var_os("UNLIT_LIGHT_DIRECT").is_some() {
            continue;
        }
        let direct = timed("direct on elements", || stage.direct(&light));
        for (name, rho, materials) in scene.materials(&stage) {
            let bounced = timed("bounces on elements", || {
                simulate(&transport, &direct, lamp.radiance, &rho, &Progress::silent()).unwrap()
            });
            let corners = timed("smoothed", || stage.elements.smooth(&bounced));
            let shade = |s: &Spot| {
                let b = interpolate(&corners[s.element], s.at);
                (s.facing > 0.0).then(|| b.map(|b| b + light.glimpsed(s.point, s.normal) as f32))
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
