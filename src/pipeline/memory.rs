//! What memory solving a texture takes, and what of it is left for the views of one piece of the texture.
//!
//! Figures are those of the birdbath with photographs, texture and mesh made larger (`benches/growth.rs`).

use super::process::{ProcessError, ProcessOptions};
use crate::pair::PairRecord;
use crate::reflectance::pieces;
use crate::reflectance::stage::Stage;
use crate::scene::{Camera, Mesh};
use std::sync::Arc;

/// What a run may take unless told otherwise, GB.
pub const MEMORY: f64 = 6.0;

/// Share of a photo that shows the object, about.
const OBSERVED: f64 = 0.35;

/// Bytes that the program takes before it does anything.
const PROGRAM: f64 = 50e6;

/// Bytes of a triangle: its elements, the tree for rays, the mesh itself.
const TRIANGLE: f64 = 750.0;

/// Bytes of a texel: its place on the surface; with it the estimate while pieces are solved; and when images are written.
const TEXEL_PLACE: f64 = 16.0;
const TEXEL_SOLVED: f64 = 30.0;
const TEXEL_WRITTEN: f64 = 68.0;

/// Bytes of a pixel of the photograph at hand, at the first and at the second look: raws, known light, variance; and
/// with several frames without flash, their sum.
const PIXEL_FIRST: f64 = 60.0;
const PIXEL_SECOND: f64 = 30.0;

/// Shares of the bounces' memory that are held when all views have been looked through, and when pieces are solved.
const BOUNCES_SEEN: f64 = 0.4;
const BOUNCES_KEPT: f64 = 0.1;

/// Least memory for a piece, bytes; what would be smaller is all rim.
const LEAST_PIECE: f64 = 5e6;

/// What the parts of a run take, bytes, whatever the size of the texture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Needs {
    scene: f64,
    bounces: f64,
    /// Pixels of the largest photograph, and of all.
    photo: f64,
    photos: f64,
}

impl Needs {
    pub(super) fn of(meshes: &[Mesh], matched: &[(Arc<PairRecord>, Camera)]) -> Self {
        let triangles = meshes.iter().map(|mesh| mesh.triangles.len()).sum();
        let pixels = |camera: &Camera| camera.intrinsics.width as f64 * camera.intrinsics.height as f64;
        Self::with(triangles, &matched.iter().map(|(_, camera)| pixels(camera)).collect::<Vec<_>>())
    }

    fn with(triangles: usize, pixels: &[f64]) -> Self {
        Self {
            scene: PROGRAM + TRIANGLE * triangles as f64,
            bounces: Stage::bounce_memory(pixels.len()),
            photo: pixels.iter().copied().fold(0.0, f64::max),
            photos: pixels.iter().sum(),
        }
    }

    /// At the most beside the pieces: while the views are looked through, bounces settled, images written.
    fn otherwise(&self, size: usize) -> f64 {
        let texels = (size * size) as f64;
        let first = BOUNCES_SEEN * self.bounces + PIXEL_FIRST * self.photo;
        self.scene + (TEXEL_PLACE * texels + first.max(self.bounces)).max(TEXEL_WRITTEN * texels)
    }

    /// While pieces are solved, all but the views of the piece itself.
    fn beside_a_piece(&self, size: usize) -> f64 {
        let texels = TEXEL_SOLVED * (size * size) as f64;
        self.scene + texels + BOUNCES_KEPT * self.bounces + PIXEL_SECOND * self.photo
    }

    /// What all views take at once.
    fn all_views(&self) -> f64 {
        OBSERVED * pieces::PIXEL * self.photos
    }

    /// Of `memory` bytes altogether those for the views of one piece; the error is what there must be at least.
    fn piece(&self, size: usize, memory: f64) -> Result<f64, f64> {
        let beside = self.beside_a_piece(size);
        let least = self.otherwise(size).max(beside + LEAST_PIECE.min(self.all_views()));
        if memory < least { Err(least) } else { Ok(memory - beside) }
    }

    /// The most that a run takes if its pieces take up to `piece`.
    fn peak(&self, size: usize, piece: f64) -> f64 {
        self.otherwise(size).max(self.beside_a_piece(size) + piece.min(self.all_views()))
    }

    /// Bytes for the views of one piece of a texture `size` x `size`, so that the run stays within what it may take.
    pub(super) fn for_a_piece(&self, size: usize, options: &ProcessOptions) -> Result<f64, ProcessError> {
        let may = options.memory.unwrap_or(MEMORY);
        let room = self.piece(size, 1e9 * may).map_err(|least| ProcessError::Memory {
            size,
            needs: least / 1e9,
            may,
        })?;
        let piece = options.piece.map_or(room, |piece| room.min(1e9 * piece));
        let (peak, free) = (self.peak(size, piece), free());
        if peak < free {
            Ok(piece)
        } else {
            Err(ProcessError::NotFree { needs: peak / 1e9, free: free / 1e9 })
        }
    }
}

/// Memory that is free now, bytes, as Linux estimates it; where it does not tell, what a small machine has.
fn free() -> f64 {
    let told = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = told.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<f64>().ok());
    kilobytes.map_or(4e9, |k| 1024.0 * k)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 104 photographs of 50 megapixels and a mesh of a million triangles.
    fn large() -> Needs {
        Needs::with(1_000_000, &[50.3e6; 104])
    }

    #[test]
    fn a_run_takes_what_it_may_and_never_more() {
        for size in [1024, 4096, 8192] {
            let piece = large().piece(size, 6e9).unwrap();
            assert!(piece > 0.5e9 && large().peak(size, piece) <= 6e9 + 1.0, "{size}: {piece}");
            assert!(large().piece(size, 8e9).unwrap() > piece + 1.9e9, "more memory makes larger pieces");
        }
    }

    #[test]
    fn too_little_is_told_with_what_suffices() {
        let least = large().piece(8192, 1e9).unwrap_err();
        let piece = large().piece(8192, least).unwrap();
        assert!(piece >= LEAST_PIECE && large().peak(8192, piece) <= least + 1.0, "{piece}");
        let options = ProcessOptions { memory: Some(1.0), ..ProcessOptions::default() };
        let told = large().for_a_piece(8192, &options).unwrap_err().to_string();
        assert!(told.contains("--memory") && told.contains("8192"), "{told}");
    }

    #[test]
    fn a_small_job_needs_no_more_than_it_takes() {
        let small = Needs::with(120_000, &[240e3; 24]);
        assert!(small.peak(1024, small.piece(1024, 6e9).unwrap()) < 1.5e9);
        let smallest = ProcessOptions { piece: Some(0.01), ..ProcessOptions::default() };
        assert_eq!(small.for_a_piece(1024, &smallest).unwrap(), 1e7);
    }
}
