//! Tables 12.1 and 12.2: 45 views on three circles, raw files to texture.
//!
//! The renders go through the studio's lens, filter array and noisy 14-bit sensor into raw files; flash calibrated
//! from shots of a white card; `process`; scored by `evaluate`. The floor is a small platform, as the thesis's
//! scene had one; its texture is solved for in a second session of the same files.

use super::table::Pool;
use super::walk::{Subject, Walk};
use super::{ExperimentError, Figures, Options, Outcome, Row, Table};
use crate::pipeline::evaluate::{Errors, Estimate, Evaluation, evaluate};
use crate::progress::Progress;
use crate::scene::{Distortion, Intrinsics};
use crate::studio::world::lab::{self, Circle, Lab, Setting};
use glam::DVec2;

/// Half the platform's width, metres.
const PLATFORM: f64 = 0.45;

/// Three circles of 15 stops (the thesis's groups hold 18, 18 and 9).
fn circles(stops: usize) -> [Circle; 3] {
    [
        Circle { stops, target: 0.15, elevation: 0.26, distance: 0.80, first: -1.5 },
        Circle { stops, target: 0.16, elevation: 0.62, distance: 0.82, first: -1.4 },
        Circle { stops, target: 0.17, elevation: 1.00, distance: 0.82, first: -1.3 },
    ]
}

/// A lens of the studio's angle on a frame of this width.
pub(super) fn lens(width: usize) -> Intrinsics {
    let height = (width * 2 / 3) & !1;
    Intrinsics {
        width,
        height,
        focal: DVec2::splat(1.25 * width as f64),
        principal: DVec2::new(width as f64, height as f64) / 2.0,
        distortion: Distortion::default(),
    }
}

/// Table 12.2, of 1.
const THESIS_TEXTURE: [f64; 2] = [-0.0816, 0.1156];

/// Table 12.1, of 1: means over its three groups of images (1-18, 19-36, 37-45) of mean and standard deviation.
const THESIS_CIRCLES: [[f64; 2]; 3] = [[-0.0698, 0.2312], [-0.0365, 0.1676], [-0.0061, 0.0816]];

pub(super) fn synthetic(options: Options, progress: &Progress) -> Result<Outcome, ExperimentError> {
    let (stops, width, rays) = if options.quick { (5, 168, (16, 8)) } else { (15, 300, (32, 16)) };
    let cameras = lab::cameras(&circles(stops), lens(width));
    let lab = Lab::new(Setting { floor: PLATFORM, varnish: None, bounces: true });
    let walk = Walk::shoot(lab, cameras, rays, options, progress)?;
    let (session, summary) = walk.process(Subject::Object, None, true, progress)?;
    let object = evaluate(&session, &walk.truth(Subject::Object)?, progress)?;
    drop(session);
    let size = (width * 4).next_power_of_two().min(1024) / 2;
    let (session, _) = walk.process(Subject::Floor, Some(size), true, progress)?;
    let floor = evaluate(&session, &walk.truth(Subject::Floor)?, progress)?;
    tracing::debug!("the experiment's sessions were in {}", walk.folder().display());

    let Evaluation { views: Some(views), texture: Some(texture) } = object else {
        return Err(ExperimentError::Nothing("the processed walk"));
    };
    let with = |name: &str, ours: Figures, thesis| Row { name: name.into(), ours, thesis };
    let mut rows = vec![with("texture, object only", figures(&texture.full), Some(THESIS_TEXTURE))];
    if let Some(blocks) = &texture.blocks {
        rows.push(with("texture, object only, 4 x 4 pixels", figures(blocks), None));
    }
    if let Some(floor) = &floor.texture {
        rows.push(with("texture, floor only", figures(&floor.full), None));
        let both = joined([&texture, floor])?;
        rows.push(with("texture, object and floor", both, Some(THESIS_TEXTURE)));
    }
    let tables = vec![
        by_circle(&views, floor.views.as_ref(), stops)?,
        Table { title: "Table 12.2, the texture as the cameras see it".into(), rows },
    ];
    Ok(Outcome {
        about: format!(
            "{} views on three circles, {width} x {} pixels, 14-bit raw files with noise and filter array, flash \
             calibrated from card shots; texture of {} texels a side. Estimate - truth; pixels within 3 of an edge \
             of the surface are not counted.",
            3 * stops,
            lens(width).height,
            summary.texture_size
        ),
        tables,
        notes: vec![format!(
            "Known of the object: {:.2} % in the images, {:.2} % in the texture.",
            100.0 * views.known,
            100.0 * texture.known
        )],
    })
}

fn figures(errors: &Errors) -> Figures {
    Figures { count: errors.count as u64, mean: errors.mean, sd: errors.standard_deviation }
}

fn joined<'a>(parts: impl IntoIterator<Item = &'a Estimate>) -> Result<Figures, ExperimentError> {
    let mut pool = Pool::default();
    parts.into_iter().for_each(|part| pool.merge(figures(&part.full)));
    pool.figures().ok_or(ExperimentError::Nothing("the texture"))
}

fn by_circle(object: &Estimate, floor: Option<&Estimate>, stops: usize) -> Result<Table, ExperimentError> {
    let mut rows = vec![];
    for (circle, name) in ["low", "middle", "high"].into_iter().enumerate() {
        let of_circle = |name: &str| {
            let number = name.parse::<usize>().ok();
            number.and_then(|n| n.checked_sub(1)).is_some_and(|n| n / stops == circle)
        };
        let pool = |estimates: &[&Estimate]| {
            let mut pool = Pool::default();
            for view in estimates.iter().flat_map(|e| &e.by_view).filter(|v| of_circle(&v.name)) {
                pool.merge(figures(&view.full));
            }
            pool.figures().ok_or(ExperimentError::Nothing("a circle of views"))
        };
        let both: Vec<&Estimate> = std::iter::once(object).chain(floor).collect();
        rows.push(Row {
            name: format!("{name} circle, object and floor"),
            ours: pool(&both)?,
            thesis: Some(THESIS_CIRCLES[circle]),
        });
        rows.push(Row { name: format!("{name} circle, object only"), ours: pool(&[object])?, thesis: None });
    }
    Ok(Table { title: "Table 12.1, image by image, pooled over each circle".into(), rows })
}
