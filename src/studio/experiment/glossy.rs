//! What a varnish does to the diffuse reflectance found under it.
//!
//! The object carries a specular lobe of some weight and width on top of its paint, the photographs go the whole
//! way from raw files to texture, and the texels that ten or more cameras see are held against the paint.

use super::synthetic::lens;
use super::table::Pool;
use super::walk::{Subject, Walk};
use super::{ExperimentError, Options, Outcome, Row, Table};
use crate::codec::exr_image;
use crate::progress::Progress;
use crate::raster::sample::bilinear;
use crate::reflectance::atlas::lay_out;
use crate::reflectance::texture::TextureError;
use crate::studio::world::Varnish;
use crate::studio::world::lab::{self, Circle, Lab, Setting};
use rayon::prelude::*;

/// Texels that fewer cameras see are not counted.
const VIEWS: usize = 10;

/// Least cosine at which a camera is said to see a texel.
const GRAZING: f32 = 0.2;

/// Weight and width of the varnishes; none first.
const COATS: [(f32, f32); 5] = [(0.0, 0.15), (0.05, 0.15), (0.1, 0.25), (0.2, 0.15), (0.2, 0.4)];

const QUICK_COATS: [(f32, f32); 2] = [(0.0, 0.15), (0.2, 0.25)];

fn circles(stops: usize) -> [Circle; 3] {
    [
        Circle { stops, target: 0.15, elevation: 0.30, distance: 0.80, first: -1.5 },
        Circle { stops, target: 0.16, elevation: 0.66, distance: 0.82, first: -1.3 },
        Circle { stops, target: 0.17, elevation: 1.05, distance: 0.82, first: -1.1 },
    ]
}

pub(super) fn varnish(options: Options, progress: &Progress) -> Result<Outcome, ExperimentError> {
    let (stops, width, rays, coats) = if options.quick {
        (9, 200, (4, 2), QUICK_COATS.as_slice())
    } else {
        (12, 300, (8, 4), COATS.as_slice())
    };
    let mut rows = vec![];
    for &(weight, alpha) in coats {
        let coat = (weight > 0.0).then_some(Varnish { weight, alpha });
        let name = match coat {
            None => "no varnish".to_owned(),
            Some(_) => format!("weight {weight}, alpha {alpha}"),
        };
        let lab = Lab::new(Setting { floor: 1.2, varnish: coat, bounces: true });
        let cameras = lab::cameras(&circles(stops), lens(width));
        let walk = Walk::shoot(lab, cameras, rays, options, progress)?;
        let pool = well_seen(&walk, progress)?;
        let ours = pool.figures().ok_or(ExperimentError::Nothing("the varnished object"))?;
        rows.push(Row { name, ours, thesis: None });
    }
    Ok(Outcome {
        about: format!(
            "{} views of {width} x {} pixels, 14-bit raw files to texture; texels that at least {VIEWS} cameras \
             see. Estimate - reflectance of the paint under the varnish.",
            3 * stops,
            lens(width).height
        ),
        tables: vec![Table { title: "Diffuse reflectance under a varnish".into(), rows }],
        notes: vec![
            "Weight: share of the light that the specular lobe sends back; alpha: its GGX width.".into(),
        ],
    })
}

/// Errors of the texels that enough cameras see.
fn well_seen(walk: &Walk, progress: &Progress) -> Result<Pool, ExperimentError> {
    let (session, _) = walk.process(Subject::Object, None, false, progress)?;
    let found = exr_image::read(&session.model_dir().join("reflectance.exr"))?
        .rgb()
        .ok_or(ExperimentError::Nothing("the texture"))?;
    let size = found.width();
    let (mesh, truth) = (&walk.lab.meshes()[0], &walk.lab.textures()[0]);
    let points = lay_out(mesh, size).map_err(TextureError::from)?;
    let side = truth.width() as f32 / size as f32;
    let errors: Vec<[f32; 3]> = points
        .par_iter()
        .filter_map(|p| {
            let [a, b, c] = mesh.corners(p.triangle as usize);
            let point = a * (1.0 - p.u - p.v) + b * p.u + c * p.v;
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let seen = walk.cameras.iter().filter(|camera| walk.lab.sees(camera, point, normal, GRAZING));
            if seen.count() < VIEWS {
                return None;
            }
            let (x, y) = (p.texel as usize % size, p.texel as usize / size);
            let is = bilinear(truth, (x as f32 + 0.5) * side, (y as f32 + 0.5) * side)?;
            let guess = found.at(x, y);
            Some([0, 1, 2].map(|c| guess[c] - is[c]))
        })
        .collect();
    let mut pool = Pool::default();
    pool.add(errors.into_iter().flatten());
    Ok(pool)
}
