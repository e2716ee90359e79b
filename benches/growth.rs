//! What `process` costs as views, pixels, texels and triangles grow, and what 104 pairs of 50 megapixels would take:
//! processor seconds by stage and peak memory, on the birdbath's files made larger.
//!
//!     cargo bench --profile dev --bench growth [-- PLOT.svg] [-- views] [-- megapixels] [-- texels] [-- triangles] [-- large]
//!
//! Without a name all are run. `large` is up to three views of 54 megapixels, in pieces of 1.5 GB (what 6 GB leave for
//! them) and of half of that: 20 minutes on two cores. Larger photographs are the birdbath's, interpolated and given
//! noise of their own: the same scene at finer sampling, without finer detail. Larger meshes have every triangle cut into
//! four.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark stops at the first thing that is wrong"
)]

#[path = "../tests/all/processes.rs"]
#[allow(dead_code, reason = "other benchmarks use the rest")]
mod processes;
#[path = "../tests/all/samples.rs"]
mod samples;

use processes::{forget_peak, peak_kilobytes};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use unlit::codec::dng::{self, DngContent};
use unlit::codec::raw;
use unlit::pipeline::process::{ProcessOptions, process};
use unlit::progress::Progress;
use unlit::raster::Image;
use unlit::reflectance::pieces::PIXEL;
use unlit::reflectance::stage::Stage;
use unlit::scene::read_obj;
use unlit::session::Session;

/// A job made larger in one way or another.
#[derive(Clone, Copy)]
struct Job {
    views: usize,
    /// Factor on the photographs' width.
    pixels: usize,
    texels: usize,
    /// How often every triangle is cut into four.
    cuts: usize,
    /// Memory for the views of one piece, GB, where it is to be less than there is room for.
    piece: Option<f64>,
}

const USUAL: Job = Job { views: 24, pixels: 1, texels: 1024, cuts: 0, piece: None };
const LARGE: Job = Job { views: 3, pixels: 15, texels: 8192, cuts: 0, piece: None };

/// Memory for the views of one piece, GB: what 6 GB leave for it with a million triangles, and half of that.
const PIECES: [f64; 2] = [1.5, 0.75];

/// Share of the views that see a piece: of the birdbath's 24 in 8 pieces.
const SEEN: f64 = 0.45;

/// What rims add across a piece in every view, pixels: on either side 12 and two patches of some 17.
const RIM_ACROSS: f64 = 92.0;

/// The birdbath's sensor: variance per DN of light, and noise in the dark, DN.
const GAIN: f32 = 0.295;
const FLOOR: f32 = 1.61;

/// What it took.
struct Cost {
    stages: Vec<(String, f64)>,
    gigabytes: f64,
    pieces: usize,
    looks: usize,
    /// Views that went in: of enlarged ones, which are blurred, `import` may call some moved.
    used: usize,
}

impl Cost {
    fn of(&self, stage: &str) -> f64 {
        self.stages.iter().find(|(name, _)| name.contains(stage)).map_or(0.0, |(_, cpu)| *cpu)
    }

    fn all(&self) -> f64 {
        self.stages.iter().map(|(_, cpu)| cpu).sum()
    }
}

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let asked: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let (plots_to, names): (Vec<_>, Vec<_>) = asked.iter().partition(|a| a.ends_with(".svg"));
    let wanted = |name: &str| names.is_empty() || names.iter().any(|n| name.contains(n.as_str()));
    let mut plots = vec![];
    let series: [(&str, Vec<(f64, Job)>); 4] = [
        ("views", [6, 12, 24].map(|n| (n as f64, Job { views: n, ..USUAL })).into()),
        ("megapixels", [1, 2, 3].map(|k| (0.24 * (k * k) as f64, Job { pixels: k, ..USUAL })).into()),
        (
            "million texels",
            [512, 1024, 2048].map(|n| ((n * n) as f64 / 1e6, Job { texels: n, ..USUAL })).into(),
        ),
        (
            "thousand triangles",
            [0, 1, 2].map(|n| (122.6 * 4f64.powi(n), Job { cuts: n as usize, ..USUAL })).into(),
        ),
    ];
    for (what, jobs) in series.into_iter().filter(|(what, _)| wanted(what)) {
        heading(what);
        let mut points = vec![];
        for (amount, job) in jobs {
            let cost = told(amount, run(folder.path(), job));
            let amount = if what == "megapixels" { amount * cost.used as f64 } else { amount };
            points.push((amount, cost.all()));
        }
        plots.push((what, points));
    }
    if wanted("large") {
        heading("large, GB a piece");
        let [few, many] =
            PIECES.map(|piece| told(piece, run(folder.path(), Job { piece: Some(piece), ..LARGE })));
        estimate(&few, &many);
    }
    if let Some(path) = plots_to.first().filter(|_| !plots.is_empty()) {
        std::fs::write(path, plot(&plots)).unwrap();
    }
}

fn heading(what: &str) {
    println!(
        "{what:>20} {:>9} {:>7} {:>8} {:>7} {:>7} {:>8} {:>7} {:>6} {:>6} {:>6} {:>6}",
        "scene", "first", "bounces", "second", "texels", "writing", "all s", "GB", "pieces", "looks", "used"
    );
}

fn told(amount: f64, cost: Cost) -> Cost {
    let [scene, first, bounces, second, texels, writing] =
        ["scene", "first", "bounces", "second", "texels", "writing"].map(|s| cost.of(s));
    println!(
        "{amount:>20.2} {scene:>9.1} {first:>7.1} {bounces:>8.1} {second:>7.1} {texels:>7.1} {writing:>8.1} {:>7.1} {:>6.2} {:>6} {:>6} {:>6}",
        cost.all(),
        cost.gigabytes,
        cost.pieces,
        cost.looks,
        cost.used,
    );
    cost
}

/// 104 pairs of 50.6 megapixels, from a few large ones solved in fewer and in more pieces. A first look costs by the
/// view, a second one by the look and by the pixels that show the object, texels by those pixels. A piece holds as many
/// pixels however many views share them; the more views, the smaller its part of the surface and the more of it is rim.
fn estimate(few: &Cost, many: &Cost) {
    let (views, pixels) = (few.used as f64, (600 * 400 * LARGE.pixels * LARGE.pixels) as f64);
    let more = 104.0 * 50.6e6 / (views * pixels);
    assert!(many.looks > few.looks, "smaller pieces must need more looks");
    let a_look = (many.of("second") - few.of("second")) / (many.looks as f64 - few.looks as f64);
    let by_pixels = few.of("second") - a_look * few.looks as f64;
    let with_rim = |views: f64| {
        let side = (1e9 * PIECES[0] / PIXEL / views).sqrt();
        (side / (side - RIM_ACROSS)).powi(2)
    };
    let again = with_rim(104.0 * SEEN) / with_rim(views);
    let pieces = few.pieces as f64 * more * again;
    let looks = pieces * SEEN * 104.0;
    let hours = |seconds: f64| seconds / 3600.0;
    let parts = [
        ("first look", few.of("first") * more),
        ("bounces", few.of("bounces") * 104.0 / views),
        ("raws again", a_look * looks),
        ("second look", by_pixels * more * again),
        ("texels", few.of("texels") * more * again),
        ("writing", few.of("writing")),
    ];
    println!("104 pairs of 50.6 MP in {pieces:.0} pieces, {looks:.0} looks of {a_look:.1} CPU-s:");
    for (name, seconds) in parts {
        println!("  {name:<12} {:>6.2} CPU-hours", hours(seconds));
    }
    let all: f64 = parts.iter().map(|p| p.1).sum();
    println!("  together {:.1} CPU-hours, {:.1} hours on two cores", hours(all), hours(all) / 2.0);
    let bounces = Stage::bounce_memory(104) - Stage::bounce_memory(few.used);
    // When texels are solved, a tenth of it is still needed.
    println!(
        "  {:.1} GB at the most: {:.1} here, and what is kept of {:.1} for the bounces of more views",
        few.gigabytes + 0.1 * bounces / 1e9,
        few.gigabytes,
        bounces / 1e9
    );
}

fn run(folder: &Path, job: Job) -> Cost {
    let session = prepared(folder, job);
    forget_peak();
    let options =
        ProcessOptions { texture_size: Some(job.texels), piece: job.piece, ..ProcessOptions::default() };
    let summary = process(&Session::open(&session).unwrap(), &options, &Progress::silent()).unwrap();
    let gigabytes = peak_kilobytes("self").unwrap() as f64 / 1e6;
    std::fs::remove_dir_all(&session).unwrap();
    Cost {
        stages: summary.costs.into_iter().map(|c| (c.stage, c.cpu)).collect(),
        gigabytes,
        pieces: summary.pieces,
        looks: summary.looks,
        used: summary.used.len(),
    }
}

fn file(path: &str) -> PathBuf {
    samples::shared(&format!("scenes/birdbath/{path}"))
}

fn unlit(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    let told = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b));
    // 3: some pairs were rejected.
    assert!(matches!(output.status.code(), Some(0 | 3)), "{arguments:?}: {told:?}");
}

/// A session with as many and as large photographs and as fine a mesh as the job asks for.
fn prepared(folder: &Path, job: Job) -> PathBuf {
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    for side in ["off", "on"] {
        let to = folder.join(side);
        let _ = std::fs::remove_dir_all(&to);
        std::fs::create_dir(&to).unwrap();
    }
    for view in (0..24).step_by(24 / job.views) {
        let name = format!("{view:03}.dng");
        let files =
            ["off", "on"].map(|side| (file(&format!("photos/{side}/{name}")), folder.join(side).join(&name)));
        enlarge(&files, job.pixels);
    }
    let cameras = std::fs::read_to_string(file("geometry/cameras.xml")).unwrap();
    let k = job.pixels;
    let cameras = cameras
        .replace("<Width>600<", &format!("<Width>{}<", 600 * k))
        .replace("<Height>400<", &format!("<Height>{}<", 400 * k))
        .replace(
            "<x>299.5</x><y>199.5</y>",
            &format!("<x>{}</x><y>{}</y>", 300.0 * k as f64 - 0.5, 200.0 * k as f64 - 0.5),
        );
    let xml = folder.join("cameras.xml");
    std::fs::write(&xml, cameras).unwrap();
    let object = folder.join("object.obj");
    std::fs::write(&object, finer(&file("geometry/object.obj"), job.cuts)).unwrap();
    let session = folder.join("session");
    let name = text(&session);
    unlit(&["new", &name]);
    unlit(&[
        "import",
        "pairs",
        &name,
        "--off",
        &text(&folder.join("off")),
        "--on",
        &text(&folder.join("on")),
    ]);
    let floor = text(&file("geometry/floor.obj"));
    unlit(&["import", "scene", &name, "--cameras", &text(&xml), "--mesh", &text(&object), "--mesh", &floor]);
    let shots: Vec<String> =
        [("0.5", "d0500"), ("0.8", "d0800"), ("1.0", "d1000"), ("1.3", "d1300"), ("1.7", "d1700")]
            .iter()
            .map(|(metres, stem)| {
                format!("{metres}={}", text(&file(&format!("calibration/white/{stem}_0.dng"))))
            })
            .collect();
    let mut calibrate = vec!["calibrate", "flash", &name, "--target-reflectance", "0.94"];
    // The card was shot at the usual size: 45.5 mm before 36 mm.
    calibrate.extend(["--ring-radii", "0.035,0.085", "--focal-px", "758.333", "--shots"]);
    calibrate.extend(shots.iter().map(String::as_str));
    unlit(&calibrate);
    session
}

/// An unlit and a lit raw file `k` times as wide: each colour's sites, freed of much of their noise by the mean over
/// 5x5 of them, are interpolated, and get noise of their own. The lit one is nowhere darker than the unlit one, which
/// what is left of the old noise, now in large blots, would make it.
fn enlarge(files: &[(PathBuf, PathBuf); 2], k: usize) {
    if k == 1 {
        for (from, to) in files {
            std::fs::copy(from, to).unwrap();
        }
        return;
    }
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(k as u64);
    let plain = Normal::new(0.0f32, 1.0).unwrap();
    let mut before: Option<Image<f32>> = None;
    for (from, to) in files {
        let mut photo = raw::read(from).unwrap();
        let mut calm = calmed(&photo.mosaic.dn);
        if let Some(before) = &before {
            calm = Image::from_fn(calm.width(), calm.height(), |x, y| calm.at(x, y).max(*before.at(x, y)));
        }
        let (width, height) = (calm.width(), calm.height());
        // The places between two sites of one colour.
        let split = |i: usize, most: usize| {
            let at = ((i / 2) as f32 / k as f32).min((most / 2 - 1) as f32);
            let low = at as usize;
            (2 * low + i % 2, 2 * (low + 1).min(most / 2 - 1) + i % 2, at - low as f32)
        };
        let (black, range) = (photo.mosaic.levels.black, photo.mosaic.levels.saturation);
        photo.mosaic.dn = Image::from_fn(width * k, height * k, |x, y| {
            let ((x0, x1, u), (y0, y1, v)) = (split(x, width), split(y, height));
            let row = |y: usize| (1.0 - u) * calm.at(x0, y) + u * calm.at(x1, y);
            let value = (1.0 - v) * row(y0) + v * row(y1);
            let (black, most) = (black[y % 2][x % 2], range[y % 2][x % 2]);
            let noise = (GAIN * (value - black).max(0.0) + FLOOR * FLOOR).sqrt() * plain.sample(&mut random);
            (value + noise).round().clamp(0.0, most) as u16
        });
        before = Some(calm);
        let content = DngContent { mosaic: &photo.mosaic, settings: &photo.settings, masked_left: None };
        std::fs::write(to, dng::encode(&content).unwrap()).unwrap();
    }
}

/// The mean over 5x5 sites of one colour.
fn calmed(dn: &Image<u16>) -> Image<f32> {
    let beside = |i: usize, step: isize, most: usize| {
        let (first, last) = ((i % 2) as isize, (most - 2 + i % 2) as isize);
        (i as isize + 2 * step).clamp(first, last) as usize
    };
    Image::from_fn(dn.width(), dn.height(), |x, y| {
        let steps = (-2..=2).flat_map(|v| (-2..=2).map(move |u| (u, v)));
        let at = |(u, v)| f32::from(*dn.at(beside(x, u, dn.width()), beside(y, v, dn.height())));
        steps.map(at).sum::<f32>() / 25.0
    })
}

/// The mesh as an OBJ, every triangle cut into four `cuts` times.
fn finer(path: &Path, cuts: usize) -> String {
    let mesh = read_obj(path, 1.0).unwrap();
    let mut triangles: Vec<_> =
        (0..mesh.triangles.len()).map(|t| (mesh.corners(t), mesh.uv_corners(t).unwrap())).collect();
    for _ in 0..cuts {
        triangles = triangles
            .into_iter()
            .flat_map(|([a, b, c], [u, v, w])| {
                let ([d, e, f], [x, y, z]) = (
                    [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0],
                    [(u + v) / 2.0, (v + w) / 2.0, (w + u) / 2.0],
                );
                [
                    ([a, d, f], [u, x, z]),
                    ([d, b, e], [x, v, y]),
                    ([f, e, c], [z, y, w]),
                    ([d, e, f], [x, y, z]),
                ]
            })
            .collect();
    }
    let mut obj = String::new();
    for (corners, uvs) in &triangles {
        corners.iter().for_each(|p| writeln!(obj, "v {} {} {}", p.x, p.y, p.z).unwrap());
        uvs.iter().for_each(|p| writeln!(obj, "vt {} {}", p.x, p.y).unwrap());
    }
    for t in 0..triangles.len() {
        let [a, b, c] = [1, 2, 3].map(|i| 3 * t + i);
        writeln!(obj, "f {a}/{a} {b}/{b} {c}/{c}").unwrap();
    }
    obj
}

/// Processor seconds against each amount, both from zero; a straight line through the last point and what would be
/// spent on nothing is what linear growth looks like.
fn plot(series: &[(&str, Vec<(f64, f64)>)]) -> String {
    let (width, height, left, low) = (260.0, 170.0, 44.0, 30.0);
    let most = series.iter().flat_map(|s| &s.1).map(|p| p.1).fold(0.0, f64::max) * 1.1;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"11\"><rect width=\"100%\" height=\"100%\" fill=\"white\"/>",
        width * series.len() as f64
    );
    for (i, (name, points)) in series.iter().enumerate() {
        let far = points.iter().map(|p| p.0).fold(0.0, f64::max) * 1.1;
        let place = |(x, y): (f64, f64)| {
            let right = i as f64 * width + left + x / far * (width - left - 16.0);
            (right, height - low - y / most * (height - low - 12.0))
        };
        let ((x0, y0), (x1, _)) = (place((0.0, 0.0)), place((far, 0.0)));
        let (_, top) = place((0.0, most));
        write!(svg, "<path d=\"M{x0} {top}V{y0}H{x1}\" fill=\"none\" stroke=\"black\"/>").unwrap();
        let path: Vec<String> = points
            .iter()
            .map(|p| {
                let (x, y) = place(*p);
                format!("{x:.1},{y:.1}")
            })
            .collect();
        write!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"#2a6f97\" stroke-width=\"2\"/>",
            path.join(" ")
        )
        .unwrap();
        for p in points {
            let (x, y) = place(*p);
            write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"#2a6f97\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{:.0}</text><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>", y - 7.0, p.1, y0 + 12.0, brief(p.0)).unwrap();
        }
        write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{name}</text>",
            (x0 + x1) / 2.0,
            y0 + 26.0
        )
        .unwrap();
        write!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">CPU-s</text>", x0 - 4.0, top + 8.0)
            .unwrap();
    }
    svg + "</svg>\n"
}

/// An amount as short as it still tells.
fn brief(amount: f64) -> String {
    if amount < 10.0 { format!("{amount:.1}") } else { format!("{amount:.0}") }
}
