use super::*;
use crate::export::chart::{Chart, Curve, Series};

const EVIL: &str = "\"><script>alert('x')</script>&\u{7}";

fn shot(used: bool) -> ShotRow {
    ShotRow {
        thumbnail: used.then(|| vec![1, 2, 3]),
        file: EVIL.into(),
        blake3: "0123456789abcdef".into(),
        exposure: EVIL.into(),
        role: EVIL.into(),
        used,
    }
}

fn everything() -> CalibrationReport {
    let evil = || EVIL.to_owned();
    let chart = Chart {
        caption: evil(),
        across: evil(),
        up: evil(),
        series: vec![Series { name: evil(), points: vec![(1.0, 2.0, 0.5)] }],
    };
    let plot = Plot {
        curves: vec![Curve { name: evil(), points: vec![(1.0, 1.0), (2.0, 2.0)] }],
        ..Plot::from(chart)
    };
    let patch = || Patch { name: evil(), measured: [1, 2, 3], meant: [250, 251, 252], words: evil() };
    let row = |first: &str, from: &[usize]| Row {
        cells: vec![first.into(), evil(), "-1.5".into()],
        from: from.to_vec(),
    };
    let pieces = vec![
        Piece::Block(Block::Text(evil())),
        Piece::Plot(plot),
        Piece::Map(Map {
            caption: evil(),
            rows: vec![vec![Some(-0.5), None], vec![Some(9.0), Some(-0.0001)]],
            digits: 1,
            full: 1.0,
        }),
        Piece::Swatches(Swatches { caption: evil(), columns: 2, patches: vec![patch(), patch(), patch()] }),
        Piece::Table(Table {
            caption: evil(),
            head: ["a", "b", "c"].map(String::from).into(),
            rows: vec![row(EVIL, &[0, 1, 2, 4]), row("b", &[])],
        }),
        Piece::Picture { kind: "image/png", bytes: vec![4, 5], caption: evil() },
    ];
    CalibrationReport {
        title: evil(),
        subtitle: evil(),
        facts: vec![(evil(), evil())],
        summary: [(Mark::Good, Some("flash")), (Mark::Bad, None), (Mark::Missing, None)]
            .map(|(mark, part)| Line {
                name: "Flash",
                part,
                mark,
                words: evil(),
                valid_for: evil(),
                measured: evil(),
            })
            .into(),
        parts: vec![Part {
            id: "flash",
            letter: 'F',
            heading: "Flash",
            mark: Mark::Bad,
            sentences: vec![evil(), evil()],
            facts: vec![(evil(), evil())],
            pieces,
            shots: [true, true, true, false, true].map(shot).into(),
        }],
    }
}

#[test]
fn the_page_is_well_formed_its_links_lead_somewhere_and_hostile_text_stays_text() {
    let html = html(&everything());
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let page = roxmltree::Document::parse_with_options(&html, options).unwrap();
    let all = || page.descendants().filter(|n| n.is_element());
    assert!(all().all(|n| n.tag_name().name() != "script"));
    let ids: Vec<&str> = all().filter_map(|n| n.attribute("id")).collect();
    let links: Vec<&str> = all().filter_map(|n| n.attribute("href")).collect();
    assert_eq!(links, ["#flash", "#F1", "#F3", "#F5"]);
    assert!(links.iter().all(|link| ids.contains(&&link[1..])), "{links:?} {ids:?}");
    assert!(all().filter_map(|n| n.attribute("src")).all(|src| src.starts_with("data:image/")));
    assert!(!html.contains("http") && !html.contains("url(") && !html.contains("@import"));
    let words: Vec<&str> = all().filter(|n| n.has_tag_name("b")).filter_map(|n| n.text()).collect();
    assert_eq!(words[..4], ["good", "do not rely on it", "not measured", "do not rely on it"]);
}

#[test]
fn figures_stand_right_and_runs_of_shots_are_short() {
    for (cell, figure) in
        [("-1.5", true), ("\u{b1}0.2", true), ("-", true), ("", true), ("red", false), ("f/8", false)]
    {
        assert_eq!(is_figure(cell), figure, "{cell}");
    }
    let plain = |from: &[usize]| {
        let text = links(from, 'E');
        text.split('<').map(|part| part.rsplit('>').next().unwrap_or_default()).collect::<String>()
    };
    assert_eq!(plain(&[0, 1, 2, 3, 7, 9, 10]), "E1 to E4, E8, E10, E11");
    assert_eq!(plain(&[]), "");
}
