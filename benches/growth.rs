//! What `process` costs as views, pixels, texels and triangles grow, and what 104 pairs of 50 megapixels would take:
//! processor seconds by stage and peak memory, on the birdbath's files made larger.
//!
//!     cargo bench --profile dev --bench growth [-- PLOT.svg]
//!
//! Larger photographs are the birdbath's with every 2x2 tile of the filter array repeated: the same scene at finer
//! sampling, without finer detail. Larger meshes have every triangle cut into four.

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
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use unlit::codec::dng::{self, DngContent};
use unlit::codec::raw;
use unlit::pipeline::process::{ProcessOptions, process};
use unlit::progress::Progress;
use unlit::raster::Image;
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
}

const USUAL: Job = Job { views: 24, pixels: 1, texels: 1024, cuts: 0 };

/// What it took.
struct Cost {
    stages: Vec<(String, f64)>,
    gigabytes: f64,
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
    let mut plots = vec![];
    let series: [(&str, Vec<(f64, Job)>); 4] = [
        ("views", [6, 12, 24].map(|n| (n as f64, Job { views: n, ..USUAL })).into()),
        ("megapixels a view", [1, 2, 3].map(|k| (0.24 * (k * k) as f64, Job { pixels: k, ..USUAL })).into()),
        (
            "million texels",
            [512, 1024, 2048].map(|n| ((n * n) as f64 / 1e6, Job { texels: n, ..USUAL })).into(),
        ),
        (
            "thousand triangles",
            [0, 1, 2].map(|n| (122.6 * 4f64.powi(n), Job { cuts: n as usize, ..USUAL })).into(),
        ),
    ];
    let mut by_pixels = vec![];
    for (what, jobs) in series {
        println!(
            "{what:>20} {:>9} {:>7} {:>8} {:>7} {:>7} {:>8} {:>7} {:>6}",
            "scene", "first", "bounces", "second", "texels", "writing", "all s", "GB"
        );
        let mut points = vec![];
        for (amount, job) in jobs {
            let cost = run(folder.path(), job);
            let [scene, first, bounces, second, texels, writing] =
                ["scene", "first", "bounces", "second", "texels", "writing"].map(|s| cost.of(s));
            println!(
                "{amount:>20.2} {scene:>9.1} {first:>7.1} {bounces:>8.1} {second:>7.1} {texels:>7.1} {writing:>8.1} {:>7.1} {:>6.2}",
                cost.all(),
                cost.gigabytes
            );
            points.push((amount, cost.all()));
            if what.starts_with("mega") {
                by_pixels.push((amount * 1e6 * job.views as f64, cost));
            }
        }
        plots.push((what, points));
    }
    estimate(&by_pixels);
    if let Some(path) = std::env::args().skip(1).find(|a| a.ends_with(".svg")) {
        std::fs::write(path, plot(&plots)).unwrap();
    }
}

/// 104 pairs of 50.6 megapixels from the cost by pixel between the least and the largest photographs here.
fn estimate(runs: &[(f64, Cost)]) {
    let (Some((few, small)), Some((many, large))) = (runs.first(), runs.last()) else { return };
    let rate = |stage: &str| (large.of(stage) - small.of(stage)).max(0.0) / (many - few);
    let all = 104.0 * 50.6e6;
    // The texture's pieces look at raws again: about four in ten views see each.
    let pieces: f64 = all * 0.22 * 200.0 / 2e9;
    let [first, second, texels] = ["first", "second", "texels"].map(|s| rate(s) * all / 3600.0);
    let again = rate("first") * all / 3600.0 * (0.4 * pieces - 1.0);
    println!(
        "104 pairs of 50.6 MP, a fifth of each the object, in {pieces:.0} pieces: first look {first:.1}, bounces {:.1}, second look {second:.1}, raws again {again:.1}, texels {texels:.1} CPU-hours",
        small.of("bounces") * 104.0 / 24.0 / 3600.0
    );
    println!("  together {:.1} hours on two cores", (first + second + again + texels) / 2.0);
}

fn run(folder: &Path, job: Job) -> Cost {
    let session = prepared(folder, job);
    forget_peak();
    let options = ProcessOptions { texture_size: Some(job.texels), ..ProcessOptions::default() };
    let summary = process(&Session::open(&session).unwrap(), &options, &Progress::silent()).unwrap();
    let gigabytes = peak_kilobytes("self").unwrap() as f64 / 1e6;
    std::fs::remove_dir_all(&session).unwrap();
    Cost { stages: summary.costs.into_iter().map(|c| (c.stage, c.cpu)).collect(), gigabytes }
}

fn file(path: &str) -> PathBuf {
    samples::shared(&format!("scenes/birdbath/{path}"))
}

fn unlit(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A session with as many and as large photographs and as fine a mesh as the job asks for.
fn prepared(folder: &Path, job: Job) -> PathBuf {
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    for side in ["off", "on"] {
        let to = folder.join(side);
        let _ = std::fs::remove_dir_all(&to);
        std::fs::create_dir(&to).unwrap();
        for view in (0..24).step_by(24 / job.views) {
            let name = format!("{view:03}.dng");
            enlarge(&file(&format!("photos/{side}/{name}")), &to.join(&name), job.pixels);
        }
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

/// The raw file with every 2x2 tile repeated `k` times each way.
fn enlarge(from: &Path, to: &Path, k: usize) {
    if k == 1 {
        std::fs::copy(from, to).unwrap();
        return;
    }
    let mut photo = raw::read(from).unwrap();
    let old = photo.mosaic.dn.clone();
    let source = |i: usize| i / 2 / k * 2 + i % 2;
    photo.mosaic.dn = Image::from_fn(old.width() * k, old.height() * k, |x, y| *old.at(source(x), source(y)));
    let content = DngContent { mosaic: &photo.mosaic, settings: &photo.settings, masked_left: None };
    std::fs::write(to, dng::encode(&content).unwrap()).unwrap();
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
            write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"#2a6f97\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{:.0}</text><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{:.4}</text>", y - 7.0, p.1, y0 + 12.0, p.0).unwrap();
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
