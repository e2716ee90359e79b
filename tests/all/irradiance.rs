//! Simulated light against the studio's path trace: the map as a camera would see it, and the surface's own points.
//! The benchmark `light` does the same over more views and pixels.

#[path = "../../benches/shared/against_path.rs"]
mod against_path;

use against_path::{Error, Scene};
use unlit::light::{Finish, Spot, expose, interpolate};
use unlit::progress::Progress;
use unlit::reflectance::bounce::simulate;

/// Pixels apart.
const STRIDE: usize = 6;

fn within(name: &str, error: &Error, bias: f64, rmse: f64) {
    error.print(name);
    assert!(error.count > 500 && error.missing == 0, "{name}: {error:?}");
    // Three standard errors of the reference.
    assert!(error.bias.abs() <= bias + 3.0 * error.bias_noise, "{name}: {error:?}");
    assert!(error.rmse <= rmse, "{name}: {error:?}");
}

fn agrees(scene: &Scene, camera: usize) {
    let (stage, camera, lamp) = (scene.stage(), &scene.cameras[camera], scene.lamp());
    let light = stage.illuminate(camera, &lamp);
    let progress = Progress::silent();
    let shade = |s: &Spot| Some([light.at_spot(s) as f32; 3]);
    let map = expose(camera, &stage.elements, light.sight(), Finish::Fine, shade, &progress).unwrap();
    let reference = scene.direct_reference(camera, STRIDE);
    let straight =
        reference.iter().map(|(x, y, [a, b])| (map.at(*x, *y).map(|m| f64::from(m[0])), a.direct, b.direct));
    within("direct", &Error::of(straight), 0.001, 0.01);

    let transport = stage.transport(&progress).unwrap();
    let direct = stage.direct(&light);
    for (name, rho, materials) in scene.materials(&stage) {
        let bounced = simulate(&transport, &direct, lamp.radiance, &rho, &progress).unwrap();
        let corners = stage.smooth(&bounced);
        let shade = |s: &Spot| {
            let unit = light.at_spot(s) as f32;
            Some(interpolate(&corners[s.element], s.at).map(|b| b + unit))
        };
        let map = expose(camera, &stage.elements, light.sight(), Finish::Fine, shade, &progress).unwrap();
        let reference = scene.bounced_reference(&materials, camera, STRIDE);
        let all = reference.iter().flat_map(|(x, y, [a, b])| {
            let map = *map.at(*x, *y);
            (0..3).map(move |c| {
                (map.map(|m| f64::from(m[c])), a.direct + a.bounced[c], b.direct + b.bounced[c])
            })
        });
        within(name, &Error::of(all), 0.005, 0.02);
        // The bounced part by itself, where the texture takes it: nothing of it is lost between near surfaces.
        let points = scene.points(&materials, &stage, camera, 1500);
        let alone = points.iter().flat_map(|p| {
            let (b, [r, s]) = (interpolate(&corners[p.element], p.at), p.reference);
            (0..3).map(move |c| (Some(f64::from(b[c])), r.bounced[c], s.bounced[c]))
        });
        within("bounced alone", &Error::of(alone), 0.015, 0.15);
        let straight = points.iter().map(|p| {
            let [r, s] = p.reference;
            (Some(light.direct(p.point, p.normal)), r.direct, s.direct)
        });
        within("direct at points", &Error::of(straight), 0.001, 0.01);
    }
}

#[test]
fn the_birdbaths_light_is_the_path_traces_light() {
    agrees(&Scene::birdbath(), 8);
}

#[test]
fn the_studios_light_is_the_path_traces_light() {
    agrees(&Scene::studio(), 3);
}
