//! Parts of the surface whose texels are solved by themselves, so that memory does not grow with the number of views.
//!
//! The object's patches are halved again and again across the longest side of the box round their centres, where half
//! the photographs' pixels lie on either side, until the pixels that show a part and its rim fit in memory. The rim is the
//! surface round the part, wider than the lens's blur, that is solved with it, and again with its own part; what lies
//! beyond counts as other surfaces do. A part that is hardly more than rim is not halved further.

use super::bounce::ViewLight;
use crate::light::Patches;
use glam::Vec3;

/// Bytes kept of each pixel that shows the object, in each view, about.
pub const PIXEL: f64 = 200.0;

/// Width of the rim, pixels of the view that sees it most coarsely.
const RIM: f32 = 12.0;

/// Least share of what memory has room for that a part's own pixels may be: below, halving makes more rim than it saves.
const LEAST_OWN: f64 = 0.2;

/// One part of the surface.
pub(super) struct Piece {
    /// Patches that are its own.
    pub(super) own: Vec<u32>,
    /// By patch: own or in the rim.
    pub(super) held: Vec<bool>,
    /// By view: whether it sees any of it.
    pub(super) views: Vec<bool>,
}

/// Divides the object (mesh 0) so that each part takes up about `memory` bytes or less; the one that most pixels show
/// comes first.
pub(super) fn divide(patches: &Patches, views: &[ViewLight], memory: f64) -> Vec<Piece> {
    let mut pixels = vec![0.0f64; patches.len()];
    let mut coarsest = 0.0f32;
    for (p, o) in views.iter().flat_map(|view| &view.seen) {
        pixels[*p as usize] += f64::from(o.resolution * patches.area(*p as usize));
        coarsest = coarsest.max((o.facing / o.resolution).sqrt());
    }
    let all: Vec<u32> = (0..patches.len()).filter(|&p| patches.mesh_of(p) == 0).map(|p| p as u32).collect();
    let mut parts = vec![];
    let (shown, most) = (|own: &[u32]| own.iter().map(|&p| pixels[p as usize]).sum::<f64>(), memory / PIXEL);
    let reach = RIM * coarsest;
    let fits = |part: &[u32]| {
        let own = shown(part);
        let with_rim = || {
            let held = with_rim(patches, part, reach);
            held.iter().zip(&pixels).filter(|(held, _)| **held).map(|(_, n)| n).sum::<f64>()
        };
        own <= LEAST_OWN * most || (own <= most && (part.len() == all.len() || with_rim() <= most))
    };
    halve(patches, &pixels, &fits, all.clone(), &mut parts);
    parts.sort_by(|a, b| shown(b).total_cmp(&shown(a)));
    let alone = parts.len() == 1;
    let piece = |own: Vec<u32>| {
        let held = if alone { vec![true; patches.len()] } else { with_rim(patches, &own, reach) };
        let sees = |view: &ViewLight| view.seen.iter().any(|(p, _)| held[*p as usize]);
        Piece { views: views.iter().map(sees).collect(), own, held }
    };
    parts.into_iter().map(piece).collect()
}

fn halve(
    patches: &Patches,
    pixels: &[f64],
    fits: &impl Fn(&[u32]) -> bool,
    mut part: Vec<u32>,
    out: &mut Vec<Vec<u32>>,
) {
    let all: f64 = part.iter().map(|&p| pixels[p as usize]).sum();
    if part.len() < 2 || fits(&part) {
        out.push(part);
        return;
    }
    let (low, high) = bounds(patches, &part);
    let axis = (high - low).max_position();
    part.sort_by(|a, b| {
        let at = |p: &u32| patches.centre(*p as usize)[axis];
        at(a).total_cmp(&at(b)).then(a.cmp(b))
    });
    let mut left = 0.0;
    let half = part.iter().position(|&p| {
        left += pixels[p as usize];
        left >= all / 2.0
    });
    let at = half.unwrap_or(part.len() / 2).clamp(1, part.len() - 1);
    let rest = part.split_off(at);
    halve(patches, pixels, fits, part, out);
    halve(patches, pixels, fits, rest, out);
}

fn bounds(patches: &Patches, part: &[u32]) -> (Vec3, Vec3) {
    let centres = part.iter().map(|&p| patches.centre(p as usize));
    centres.fold((Vec3::MAX, Vec3::MIN), |(low, high), c| (low.min(c), high.max(c)))
}

/// Patches of the object that are its own or lie within `reach` metres of the box round them.
fn with_rim(patches: &Patches, own: &[u32], reach: f32) -> Vec<bool> {
    let (low, high) = bounds(patches, own);
    let mut held: Vec<bool> = (0..patches.len())
        .map(|p| {
            let c = patches.centre(p);
            let away = (low - c).max(c - high).max_element();
            patches.mesh_of(p) == 0 && away <= reach + 2.0 * patches.area(p).sqrt()
        })
        .collect();
    own.iter().for_each(|&p| held[p as usize] = true);
    held
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Elements;
    use crate::reflectance::observe::Observation;
    use crate::scene::Mesh;

    /// A plate of 1 m before one view that shows it in a million pixels.
    fn plate() -> (Patches, Vec<ViewLight>) {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let elements = Elements::build(&[&mesh], &[0.02]);
        let patches = Patches::build(&elements, &[0.05], 120_000);
        let look = Observation {
            known: [0.0; 3],
            variance: [1.0; 3],
            white: [1.0; 3],
            resolution: 1e6,
            response: 1.0,
            facing: 1.0,
            gloss: 0.0,
        };
        let view = |from: f32, to: f32| ViewLight {
            eye: Vec3::Z,
            direct: vec![],
            radiance: [1.0; 3],
            seen: (0..patches.len())
                .filter(|&p| (from..to).contains(&patches.centre(p).x))
                .map(|p| (p as u32, look))
                .collect(),
        };
        let views = vec![view(0.0, 0.5), view(0.5, 1.0)];
        (patches, views)
    }

    #[test]
    fn pieces_fit_in_memory_share_nothing_and_leave_nothing_out() {
        let (patches, views) = plate();
        let pieces = divide(&patches, &views, 1e6 * PIXEL / 5.0);
        assert!((8..=24).contains(&pieces.len()), "{}", pieces.len());
        let mut owners = vec![0; patches.len()];
        for piece in &pieces {
            piece.own.iter().for_each(|&p| owners[p as usize] += 1);
            let area = |of: &mut dyn Iterator<Item = usize>| of.map(|p| patches.area(p)).sum::<f32>();
            let own = area(&mut piece.own.iter().map(|&p| p as usize));
            let held = area(&mut (0..patches.len()).filter(|&p| piece.held[p]));
            assert!(held <= 0.2 + 1e-3 || own <= 0.2 * 0.2 + 1e-3, "{own} {held}");
        }
        assert!(owners.iter().all(|&n| n == 1));
    }

    #[test]
    fn a_piece_holds_a_rim_and_asks_only_views_that_see_it() {
        let (patches, views) = plate();
        let pieces = divide(&patches, &views, 1e6 * PIXEL / 5.0);
        for piece in &pieces {
            let (low, high) = bounds(&patches, &piece.own);
            for p in 0..patches.len() {
                let c = patches.centre(p);
                let away = (low - c).max(c - high).max_element();
                // A pixel is a millimetre.
                assert!(away > 0.012 || piece.held[p], "{c} beside {low} {high}");
                assert!(away < 0.15 || !piece.held[p], "{c} beside {low} {high}");
            }
            // The views part at x = 0.5; the rim reaches 0.012 and two patches farther.
            let (left, right) = (low.x < 0.5, high.x > 0.5);
            assert!(piece.views[0] >= left && piece.views[1] >= right, "{low} {high}");
            assert!(!piece.views[0] || low.x < 0.64, "{low} {high}");
            assert!(!piece.views[1] || high.x > 0.36, "{low} {high}");
        }
    }

    #[test]
    fn what_fits_is_one_piece() {
        let (patches, views) = plate();
        let pieces = divide(&patches, &views, 2e6 * PIXEL);
        assert_eq!(pieces.len(), 1);
        assert!(pieces[0].held.iter().all(|held| *held));
    }
}
