//! The report of a session's calibrations: one page that needs nothing else, on which every figure leads to its shots.

use crate::calibrate_levels::{file, succeed};
use crate::raw::sample;
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

const EVIL: &str = "<b onload=alert(1)>\"&'";

fn names(folder: &str, wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let entries = std::fs::read_dir(file(folder)).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<PathBuf> = entries.collect();
    files.retain(|path| wanted(&path.file_name().unwrap().to_string_lossy()));
    files.sort();
    files.into_iter().map(|path| path.display().to_string()).collect()
}

fn run(words: &[&str], session: &str, files: Vec<String>) {
    let mut arguments: Vec<String> = vec!["calibrate".into(), words[0].into(), session.into()];
    arguments.extend(words[1..].iter().map(|word| (*word).to_owned()));
    arguments.extend(files);
    succeed(&arguments);
}

fn session(folder: &Path, name: &str) -> String {
    let path = folder.join(name).display().to_string();
    succeed(&["new".into(), path.clone()]);
    path
}

fn report(session: &str) -> String {
    std::fs::read_to_string(Path::new(session).join("calibration/report.html")).unwrap()
}

fn page(html: &str) -> Document<'_> {
    let options = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
    Document::parse_with_options(html, options).unwrap()
}

fn text(node: Node<'_, '_>) -> String {
    node.descendants().filter(|n| n.is_text()).filter_map(|n| n.text()).collect()
}

/// No link leads nowhere, nothing is loaded from elsewhere, nothing runs.
fn stands_alone(page: &Document<'_>) {
    let all = || page.descendants().filter(|n| n.is_element());
    let ids: Vec<&str> = all().filter_map(|n| n.attribute("id")).collect();
    assert_eq!(ids.iter().collect::<HashSet<_>>().len(), ids.len(), "ids are unique");
    for link in all().filter_map(|n| n.attribute("href")) {
        assert!(link.strip_prefix('#').is_some_and(|id| ids.contains(&id)), "{link}");
    }
    for source in all().filter_map(|n| n.attribute("src")) {
        assert!(source.starts_with("data:image/"), "{source:.60}");
    }
    for style in all().filter(|n| n.has_tag_name("style")).map(text) {
        assert!(!style.contains("url(") && !style.contains("@import"));
    }
    for name in ["script", "link", "iframe", "object", "embed", "base"] {
        assert!(!all().any(|n| n.has_tag_name(name)), "{name}");
    }
    for attribute in all().flat_map(|n| n.attributes()) {
        assert!(!attribute.name().starts_with("on"), "{}", attribute.name());
    }
}

/// A calibration's part has every shot with its picture and its reason, a figure, links and the whole verdict.
fn tells_all(page: &Document<'_>, session: &str, kind: &str) {
    let record = std::fs::read(Path::new(session).join(format!("calibration/{kind}.json"))).unwrap();
    let record: serde_json::Value = serde_json::from_slice(&record).unwrap();
    let part = page.descendants().find(|n| n.attribute("id") == Some(kind)).unwrap();
    let inside = text(part);
    let shots = record["shots"].as_array().unwrap();
    for shot in shots {
        let [name, digest] = ["file", "blake3"].map(|field| shot[field].as_str().unwrap());
        let titled = |n: Node<'_, '_>| n.attribute("title") == Some(digest);
        assert!(inside.contains(name) && part.descendants().any(titled), "{kind}: {name}");
        let why = shot["left_out"].as_str().map(|why| why.replace(" %", "\u{a0}%"));
        assert!(why.is_none_or(|why| inside.contains(&why)), "{kind}: {shot}");
    }
    let thumbs = part.descendants().filter(|n| n.attribute("class") == Some("thumb")).count();
    assert_eq!(thumbs, shots.len(), "{kind}: every shot has its picture");
    assert!(part.descendants().any(|n| n.has_tag_name("figure")), "{kind} has a figure");
    assert!(
        part.descendants().any(|n| n.attribute("class") == Some("from")),
        "{kind} names the shots of figures"
    );
    for sentence in record["verdict"]["sentences"].as_array().unwrap() {
        let sentence = sentence.as_str().unwrap().replace(" %", "\u{a0}%");
        assert!(inside.contains(&sentence), "{kind}: {sentence}");
    }
}

#[test]
fn a_bird_baths_calibrations_are_on_one_page_and_every_figure_leads_to_its_shots() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path(), EVIL);
    let dark = || names("calibration/dark", |_| true);
    let blown = || names("calibration/linearity", |name| name.starts_with("13"));
    run(&["levels", "--blown"], &session, [blown(), vec!["--dark".into()], dark()].concat());
    let first = report(&session);
    stands_alone(&page(&first));
    assert!(
        first.contains("not measured</b>: in its place: what the labels of ISO"),
        "what is missing is said"
    );

    let even = names("calibration/linearity", |_| true);
    run(&["noise", "--stops", "0.75"], &session, [even.clone(), vec!["--dark".into()], dark()].concat());
    run(&["exposure"], &session, names("calibration/exposure", |_| true));
    run(&["flat"], &session, even);
    let cards = [("0.5", "d0500"), ("0.8", "d0800"), ("1.0", "d1000"), ("1.3", "d1300"), ("1.7", "d1700")];
    let cards = cards.into_iter().flat_map(|(metres, name)| {
        names("calibration/white", |file| file.starts_with(name))
            .into_iter()
            .map(move |file| format!("{metres}={file}"))
    });
    let flash = [
        "flash",
        "--ring-radii",
        "0.035,0.085",
        "--focal-px",
        "758.3333",
        "--target-reflectance",
        "0.94",
        "--shots",
    ];
    run(&flash, &session, cards.collect());
    run(&["repeatability", "--frames"], &session, names("calibration/repeat", |_| true));

    let html = report(&session);
    println!("{} bytes", html.len());
    let page = page(&html);
    stands_alone(&page);
    assert!(html.contains("Calibration of &lt;b onload=alert(1)&gt;&quot;&amp;&#39;"));
    for kind in ["levels", "noise", "exposure", "flat", "flash", "steadiness"] {
        tells_all(&page, &session, kind);
    }
    // The thesis's table 3.2 beside ours.
    for figure in ["0.0451", "0.0915", "0.0236", "-0.0056"] {
        assert!(html.contains(&format!("<td class=\"n\">{figure}</td>")), "{figure}");
    }
    // A step of the ISO ladder comes from its own shot and step 00's.
    let step = page.descendants().find(|n| n.has_tag_name("td") && text(*n) == "ISO 6400").unwrap();
    let links: Vec<&str> = step.parent().unwrap().descendants().filter_map(|n| n.attribute("href")).collect();
    assert_eq!(links, ["#E20", "#E38"]);
    let shot = page.descendants().find(|n| n.attribute("id") == Some("E38")).unwrap();
    assert!(
        text(shot).contains("iso_18.dng") && text(shot).contains("ISO ladder, step 18"),
        "{}",
        text(shot)
    );
}

#[test]
fn colours_are_shown_measured_and_meant() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path(), "chart");
    run(&["colour"], &session, vec![sample("tinydng_colorchart.dng").display().to_string()]);
    let html = report(&session);
    let page = page(&html);
    stands_alone(&page);
    tells_all(&page, &session, "colour");
    let swatches = page.descendants().find(|n| n.attribute("class") == Some("swatches")).unwrap();
    assert_eq!(swatches.children().filter(|n| n.has_tag_name("rect")).count(), 48);
}

#[test]
fn a_report_is_written_anew_without_pictures_and_says_what_is_gone_or_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path(), "bath");
    run(&["levels", "--dark"], &session, names("calibration/dark", |name| name < "2"));
    let root = Path::new(&session);
    std::fs::remove_dir_all(root.join("derived/calibration")).unwrap();
    std::fs::remove_file(root.join("calibration/report.html")).unwrap();
    let shots: Vec<PathBuf> =
        std::fs::read_dir(root.join("calibration/levels")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(shots.len(), 2);
    std::fs::remove_file(&shots[0]).unwrap();
    std::fs::write(root.join("calibration/noise.json"), "{").unwrap();
    std::fs::create_dir_all(root.join("model")).unwrap();
    let certificate = serde_json::json!({
        "made": "2026-11-23T14:00:00Z",
        "inputs": {"reflectance_blake3": "0123"},
        "verdict": {"good": true, "sentences": ["All patches are within 2 %."]},
        "patches": [{"name": EVIL, "comparison": {"error": [0.01, 0.02, 0.03]}}]
    });
    std::fs::write(root.join("model/certificate.json"), certificate.to_string()).unwrap();
    run(&["report"], &session, vec![]);
    let html = report(&session);
    stands_alone(&page(&html));
    assert_eq!(html.matches("class=\"thumb\"").count(), 1, "the other picture was made again");
    assert!(html.contains("NOT SHOWN: its file cannot be read any more"));
    assert!(html.contains("noise.json is damaged"));
    assert!(
        html.contains("It is of another model than the one that is there now") && html.contains("0.0100")
    );
}
