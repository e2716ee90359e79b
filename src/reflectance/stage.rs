//! The meshes made ready for light: surface elements, patches, and a camera with its flash before them.

use super::observe::{Illumination, Lamp};
use crate::light::{Elements, Patches, SPOTS, Transport};
use crate::progress::{Cancelled, Progress};
use crate::scene::{Camera, Mesh};
use glam::Vec3;
use rayon::prelude::*;

/// Longest edge of an element of the object, and of the other meshes, relative to the object's diagonal.
const OBJECT_EDGE: f32 = 0.01;
const OTHER_EDGE: f32 = 0.04;

/// Largest patch of the object, and of the other meshes, likewise.
const OBJECT_PATCH: f32 = 0.012;
const OTHER_PATCH: f32 = 0.08;

/// Most patches, and memory that the bounced light on them may take, bytes, of which a patch takes so many for each
/// view that sees it: with very many views there are fewer, so that memory does not grow with their number.
const MOST_PATCHES: usize = 120_000;
const BOUNCE_MEMORY: usize = 2_000_000_000;
const PATCH_VIEW: usize = 152;

/// Distance by which rays start off the surface, relative to the object's diagonal.
const OFFSET: f64 = 1e-4;

/// Rays per patch for the bounces, and the bound on all of them together (4 bytes each).
const RAYS: usize = 256;
const MOST_RAYS: usize = 40_000_000;

/// The meshes made ready for light.
pub struct Stage {
    /// Surface elements and ray kernel of all meshes.
    pub elements: Elements,
    /// Groups of elements that share bounced light.
    pub patches: Patches,
    /// Metres by which rays start off a surface.
    pub offset: f64,
}

impl Stage {
    /// Cuts the meshes into elements and groups these; the first mesh is the object and sets the scale. `views` are to be
    /// looked at together.
    pub fn build(meshes: &[Mesh], views: usize) -> Self {
        let diagonal = meshes.first().map_or(1.0, diagonal).max(1e-6);
        let sizes = |object: f32, other: f32| -> Vec<f32> {
            (0..meshes.len()).map(|i| diagonal * if i == 0 { object } else { other }).collect()
        };
        let elements = Elements::build(&meshes.iter().collect::<Vec<_>>(), &sizes(OBJECT_EDGE, OTHER_EDGE));
        let most = most_patches(views);
        let patches = Patches::build(&elements, &sizes(OBJECT_PATCH, OTHER_PATCH), most);
        Self { elements, patches, offset: OFFSET * f64::from(diagonal) }
    }

    /// Bytes that bounced light takes at most for so many views.
    pub fn bounce_memory(views: usize) -> f64 {
        (most_patches(views) * PATCH_VIEW * views) as f64
    }

    /// Traces the bounces' transport.
    pub fn transport(&self, progress: &Progress) -> Result<Transport, Cancelled> {
        let rays = RAYS.min(MOST_RAYS / self.patches.len().max(1)).max(8);
        Transport::trace(&self.elements, &self.patches, rays, progress)
    }

    /// A camera and its flash before this stage.
    pub fn illuminate<'a>(&'a self, camera: &'a Camera, lamp: &'a Lamp) -> Illumination<'a> {
        Illumination::new(camera, lamp, &self.elements, self.offset)
    }

    /// The flash's irradiance per unit radiance on every patch: unbiased, from few rays where shadows fall, because
    /// whoever takes it up (bounces, a patch's mean over views) takes the mean of many.
    pub fn direct(&self, light: &Illumination) -> Vec<f32> {
        self.mean(&self.direct_at_spots(light))
    }

    /// The same at each of the patches' spots, in their order.
    pub fn direct_at_spots(&self, light: &Illumination) -> Vec<[f32; SPOTS]> {
        let of = |p| {
            let mut lit = [0.0; SPOTS];
            for (lit, e) in lit.iter_mut().zip(self.patches.spots(p)) {
                *lit = light.glimpsed(self.elements.centroid(e), self.elements.normal(e)) as f32;
            }
            lit
        };
        (0..self.patches.len()).into_par_iter().map(of).collect()
    }

    /// From one value a spot to one a patch.
    pub fn mean(&self, spots: &[[f32; SPOTS]]) -> Vec<f32> {
        let mean = |(p, lit): (usize, &[f32; SPOTS])| {
            let count = self.patches.spots(p).count().max(1);
            lit[..count].iter().sum::<f32>() / count as f32
        };
        spots.iter().enumerate().map(mean).collect()
    }

    /// From one value a patch to one a corner of each element.
    pub fn smooth(&self, values: &[[f32; 3]]) -> Vec<[[f32; 3]; 3]> {
        self.patches.smooth(&self.elements, values)
    }
}

fn most_patches(views: usize) -> usize {
    MOST_PATCHES.min(BOUNCE_MEMORY / (PATCH_VIEW * views.max(1)))
}

fn diagonal(mesh: &Mesh) -> f32 {
    let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
    for p in mesh.positions.iter().filter(|p| p.is_finite()) {
        (low, high) = (low.min(*p), high.max(*p));
    }
    if low.x <= high.x { (high - low).length() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounces_take_a_bounded_memory_whatever_the_number_of_views() {
        for views in [1, 24, 104, 500, 10_000] {
            assert!(Stage::bounce_memory(views) <= BOUNCE_MEMORY as f64, "{views}");
        }
        assert_eq!(most_patches(24), MOST_PATCHES);
        let plate = |x: f32, side: f32| Mesh {
            positions: [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]]
                .map(|[u, v]| Vec3::new(x + u, v, x))
                .into(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let meshes = [plate(0.0, 1.0), plate(-3.0, 7.0)];
        assert!(Stage::build(&meshes, 24).patches.len() > 2 * most_patches(10_000));
        assert!(Stage::build(&meshes, 10_000).patches.len() <= most_patches(10_000));
    }
}
