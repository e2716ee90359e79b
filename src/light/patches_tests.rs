//! Patches of plates and corners.

use super::*;
use crate::scene::Mesh;

const MOST: usize = 120_000;

fn plate(corner: Vec3, a: Vec3, b: Vec3) -> Mesh {
    Mesh {
        positions: vec![corner, corner + a, corner + a + b, corner + b],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// A floor and a wall that meet along an edge.
fn corner() -> (Elements, Patches) {
    let meshes = [plate(Vec3::ZERO, Vec3::X, Vec3::Y), plate(Vec3::ZERO, Vec3::Y, Vec3::Z)];
    let elements = Elements::build(&[&meshes[0], &meshes[1]], &[0.02, 0.02]);
    let patches = Patches::build(&elements, &[0.2, 0.2], MOST);
    (elements, patches)
}

#[test]
fn every_element_has_one_patch_and_areas_add_up() {
    let (elements, patches) = corner();
    assert!(patches.len() * 5 < elements.len(), "{} of {}", patches.len(), elements.len());
    let all: f32 = (0..patches.len()).map(|p| patches.area(p)).sum();
    assert!((all - 2.0).abs() < 1e-3, "{all}");
    for e in 0..elements.len() {
        assert_eq!(patches.mesh_of(patches.of(e)), elements.mesh_of(e));
    }
}

#[test]
fn patches_are_smaller_where_another_surface_is_near() {
    let (elements, patches) = corner();
    let mean_area = |low: f32, high: f32| {
        let within = |p: &usize| {
            let x = patches.all[*p].centre.x;
            elements.mesh_of(patches.all[*p].members[0] as usize) == 0 && x >= low && x < high
        };
        let found: Vec<f32> = (0..patches.len()).filter(within).map(|p| patches.area(p)).collect();
        found.iter().sum::<f32>() / found.len() as f32
    };
    assert!(mean_area(0.0, 0.1) < 0.2 * mean_area(0.6, 1.0));
}

#[test]
fn interpolation_keeps_a_constant_and_follows_a_slope() {
    let (elements, patches) = corner();
    let even = patches.smooth(&elements, &vec![[3.0; 3]; patches.len()]);
    assert!(even.iter().flatten().flatten().all(|v| (v - 3.0).abs() < 1e-4));
    let slope: Vec<[f32; 3]> = patches.all.iter().map(|p| p.centre.to_array()).collect();
    let corners = patches.smooth(&elements, &slope);
    for e in (0..elements.len()).filter(|&e| elements.mesh_of(e) == 0) {
        let place = elements.centroid(e);
        let got: f32 = corners[e].iter().map(|c| c[1]).sum::<f32>() / 3.0;
        let inside = place.y > 0.2 && place.y < 0.8 && place.x > 0.2 && place.x < 0.8;
        assert!(!inside || (got - place.y).abs() < 0.04, "{got} at {place}");
    }
}

#[test]
fn values_spread_to_the_whole_of_a_connected_surface() {
    let (_, patches) = corner();
    let mut values = vec![None; patches.len()];
    values[0] = Some([0.25, 0.5, 0.75]);
    patches.spread(&mut values);
    for (p, value) in values.iter().enumerate() {
        let want = (patches.mesh_of(p) == patches.mesh_of(0)).then_some([0.25, 0.5, 0.75]);
        assert_eq!(*value, want, "patch {p}");
    }
}

#[test]
fn a_large_floor_does_not_take_the_patches_of_the_object() {
    let object = plate(Vec3::ZERO, Vec3::X, Vec3::Y);
    let floor = plate(Vec3::new(-50.0, -50.0, -1.0), Vec3::X * 100.0, Vec3::Y * 100.0);
    let meshes = [Elements::build(&[&object], &[0.02]), Elements::build(&[&object, &floor], &[0.02, 0.2])];
    let own = |elements: &Elements| {
        let patches = Patches::build(elements, &[0.04, 0.2], MOST);
        assert!(patches.len() <= MOST, "{}", patches.len());
        (0..patches.len()).filter(|&p| patches.mesh_of(p) == 0).count()
    };
    assert_eq!(own(&meshes[0]), own(&meshes[1]));
}

#[test]
fn there_are_never_more_patches_than_memory_is_for() {
    let mesh = plate(Vec3::ZERO, Vec3::X, Vec3::Y);
    let elements = Elements::build(&[&mesh], &[0.002]);
    assert!(elements.len() > 2 * MOST);
    let patches = Patches::build(&elements, &[0.001], MOST);
    assert!(patches.len() <= MOST, "{}", patches.len());
}
