//! Do the imported cameras look at the imported object? Figures, and a warning in words when they do not.

use crate::scene::{Camera, Mesh};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What one camera sees of the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewCheck {
    /// The camera.
    pub name: String,
    /// Share of the object's vertices in front of the camera, 0 to 1.
    pub in_front: f64,
    /// Share of the object's vertices inside the frame, 0 to 1; nothing is said about what hides them.
    pub in_frame: f64,
}

/// How cameras and object fit together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SelfCheck {
    /// Diagonal of the object's bounding box, metres.
    pub object_size: f64,
    /// Median distance from the cameras to the middle of the object's bounding box, metres.
    pub distance: f64,
    /// A line a camera.
    pub views: Vec<ViewCheck>,
    /// What looks wrong, in words; empty when nothing does.
    pub warnings: Vec<String>,
}

/// Vertices that are looked at; more would not change the figures.
const SAMPLES: usize = 20_000;

/// Below this share of vertices in frame the object counts as missed.
const MISSED: f64 = 0.5;

pub(super) fn check(cameras: &[Camera], object: &Mesh) -> SelfCheck {
    let step = object.positions.len().div_ceil(SAMPLES).max(1);
    let points: Vec<DVec3> = object.positions.iter().step_by(step).map(|p| p.as_dvec3()).collect();
    let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let middle = (low + high) / 2.0;
    let mut distances: Vec<f64> = cameras.iter().map(|c| c.centre().distance(middle)).collect();
    distances.sort_by(f64::total_cmp);
    let views: Vec<_> = cameras.iter().map(|camera| view(camera, &points)).collect();
    let mut check = SelfCheck {
        object_size: low.distance(high),
        distance: distances.get(distances.len() / 2).copied().unwrap_or(0.0),
        views,
        warnings: Vec::new(),
    };
    check.warnings = warnings(&check, object);
    check
}

fn view(camera: &Camera, points: &[DVec3]) -> ViewCheck {
    let (mut front, mut frame) = (0_usize, 0_usize);
    for &point in points {
        if let Some((pixel, _)) = camera.project(point) {
            front += 1;
            let inside = pixel.x >= 0.0
                && pixel.y >= 0.0
                && pixel.x < camera.intrinsics.width as f64
                && pixel.y < camera.intrinsics.height as f64;
            frame += usize::from(inside);
        }
    }
    let share = |n: usize| n as f64 / points.len() as f64;
    ViewCheck { name: camera.name.clone(), in_front: share(front), in_frame: share(frame) }
}

fn warnings(check: &SelfCheck, object: &Mesh) -> Vec<String> {
    let mut warnings = Vec::new();
    let missed = check.views.iter().filter(|v| v.in_frame < MISSED).count();
    if 2 * missed > check.views.len() {
        warnings.push(format!(
            "in {missed} of {} views less than half of {} is in the frame: cameras and mesh seem to be in \
             different coordinate systems; export both from the same project",
            check.views.len(),
            object.name
        ));
    }
    if !(0.005..=50.0).contains(&check.object_size) {
        warnings.push(format!(
            "{} measures {:.4} m across: check --unit and --scale",
            object.name, check.object_size
        ));
    }
    if object.uv_triangles.is_empty() {
        warnings.push(format!(
            "{} has no texture coordinates: they will be made; to have your own, export it with UVs",
            object.name
        ));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Distortion, Intrinsics};
    use glam::{DAffine3, DVec2, Vec3};

    fn camera(name: &str, z: f64) -> Camera {
        Camera {
            name: name.into(),
            intrinsics: Intrinsics {
                width: 100,
                height: 100,
                focal: DVec2::splat(100.0),
                principal: DVec2::splat(50.0),
                distortion: Distortion::default(),
            },
            world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, z)),
        }
    }

    #[test]
    fn cameras_that_look_away_are_told_apart_and_warned_of() {
        let object = Mesh {
            name: "cup".into(),
            positions: vec![Vec3::ZERO, Vec3::new(0.1, 0.0, 0.0), Vec3::new(3.0, 0.1, 0.0)],
            triangles: vec![[0, 1, 2]],
            uvs: vec![],
            uv_triangles: vec![],
        };
        let check = check(&[camera("a", -1.0), camera("b", 1.0), camera("c", 2.0)], &object);
        assert_eq!(check.views[0].in_front, 1.0);
        assert!((check.views[0].in_frame - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(check.views[1].in_front, 0.0);
        assert!(check.warnings[0].contains("2 of 3 views"), "{:?}", check.warnings);
        assert!(check.warnings.iter().any(|w| w.contains("no texture coordinates")));
    }
}
