//! Which side of a mesh is its outside: the one that the cameras see.
//!
//! Light is thrown on the side that a triangle's winding says. Programs differ in it, and a floor modelled by
//! hand is as often upside down as not.

use crate::light::Elements;
use crate::scene::{Camera, Mesh};
use rayon::prelude::*;

/// Elements of each mesh that are asked.
const ASKED: usize = 2000;

/// Turns every mesh that the cameras mostly see from behind; gives the names of those turned.
pub fn face_cameras(meshes: &mut [Mesh], elements: &Elements, cameras: &[Camera]) -> Vec<String> {
    let mut turned = vec![];
    for (m, mesh) in meshes.iter_mut().enumerate() {
        let own: Vec<usize> = (0..elements.len()).filter(|&e| elements.mesh_of(e) == m).collect();
        let step = own.len().div_ceil(ASKED).max(1);
        let balance: i64 = own
            .par_iter()
            .step_by(step)
            .map(|&e| cameras.iter().map(|c| vote(elements, e, c)).sum::<i64>())
            .sum();
        if balance < 0 {
            for t in mesh.triangles.iter_mut().chain(&mut mesh.uv_triangles) {
                t.swap(1, 2);
            }
            turned.push(mesh.name.clone());
        }
    }
    turned
}

/// 1 if the camera sees the element's front, -1 if its back, 0 if it does not see it.
fn vote(elements: &Elements, element: usize, camera: &Camera) -> i64 {
    let centre = elements.centroid(element);
    let way = camera.centre().as_vec3() - centre;
    let seen =
        camera.project(centre.as_dvec3()).is_some() && !elements.kernel().occluded(centre, way, 1e-3, 1.0);
    let facing = elements.normal(element).dot(way);
    if !seen || facing == 0.0 {
        0
    } else if facing > 0.0 {
        1
    } else {
        -1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Distortion, Intrinsics};
    use glam::{DAffine3, DMat3, DVec2, DVec3, Vec3};

    #[test]
    fn a_floor_that_lies_upside_down_is_turned_and_one_that_does_not_is_left() {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
        let up = Mesh {
            name: "floor".into(),
            positions: corners.to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let mut down = up.clone();
        down.triangles = vec![[0, 2, 1], [0, 3, 2]];
        let camera = Camera {
            name: "1".into(),
            intrinsics: Intrinsics {
                width: 10,
                height: 10,
                focal: DVec2::splat(10.0),
                principal: DVec2::splat(5.0),
                distortion: Distortion::default(),
            },
            world_from_camera: DAffine3::from_mat3_translation(
                DMat3::from_rotation_x(std::f64::consts::PI),
                DVec3::new(0.0, 0.0, 1.0),
            ),
        };
        for (mesh, names) in [(up.clone(), vec![]), (down, vec!["floor".to_owned()])] {
            let elements = Elements::build(&[&mesh], &[0.3]);
            let mut meshes = [mesh];
            assert_eq!(face_cameras(&mut meshes, &elements, std::slice::from_ref(&camera)), names);
            let [a, b, c] = meshes[0].corners(0);
            assert!((b - a).cross(c - a).z > 0.0);
        }
    }
}
