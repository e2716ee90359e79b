//! The board's drawing, its bill of materials, the firmware's pins and the pages agree. The schematic is read here
//! anew, apart from `render.py`, which draws the SVG: what both derive must be the same.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// Of an S-expression.
enum Node {
    Atom(String),
    List(Vec<Node>),
}

impl Node {
    fn list(&self) -> &[Node] {
        match self {
            Node::List(nodes) => nodes,
            Node::Atom(_) => &[],
        }
    }

    fn text(&self) -> &str {
        match self {
            Node::Atom(text) => text,
            Node::List(_) => "",
        }
    }

    fn name(&self) -> &str {
        self.list().first().map_or("", Node::text)
    }

    fn every<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Node> {
        self.list().iter().filter(move |node| node.name() == name)
    }

    fn first(&self, name: &str) -> &Node {
        self.list()
            .iter()
            .find(|node| node.name() == name)
            .unwrap_or_else(|| panic!("no ({name} ...) in ({} ...)", self.name()))
    }

    /// The atom at `index`; 0 is the list's name.
    fn word(&self, index: usize) -> &str {
        self.list()[index].text()
    }

    /// The atom at `index` in thousandths: coordinates are millimetres, and hundredths suffice.
    fn number(&self, index: usize) -> i64 {
        let value: f64 = self.word(index).parse().unwrap();
        (value * 1000.0).round() as i64
    }

    fn point(&self) -> Point {
        (self.number(1), self.number(2))
    }
}

type Point = (i64, i64);

fn parse(text: &str) -> Node {
    let mut stack = vec![Vec::new()];
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '(' => stack.push(Vec::new()),
            ')' => {
                let done = stack.pop().unwrap();
                stack.last_mut().expect("a bracket closes that none opened").push(Node::List(done));
            }
            '"' => {
                let mut word = String::new();
                while let Some(c) = chars.next() {
                    match c {
                        '"' => break,
                        '\\' => word.extend(chars.next()),
                        c => word.push(c),
                    }
                }
                stack.last_mut().unwrap().push(Node::Atom(word));
            }
            c if c.is_whitespace() => {}
            c => {
                let mut word = String::from(c);
                while let Some(c) = chars.next_if(|c| !c.is_whitespace() && *c != '(' && *c != ')') {
                    word.push(c);
                }
                stack.last_mut().unwrap().push(Node::Atom(word));
            }
        }
    }
    assert_eq!(stack.len(), 1, "a bracket stays open");
    stack.pop().unwrap().pop().unwrap()
}

/// Sets of names that grow together.
#[derive(Default)]
struct Groups {
    index: HashMap<String, usize>,
    parent: Vec<usize>,
}

impl Groups {
    fn root(&mut self, key: &str) -> usize {
        let next = self.parent.len();
        let mut at = *self.index.entry(key.to_owned()).or_insert(next);
        if at == next {
            self.parent.push(next);
        }
        while self.parent[at] != at {
            at = self.parent[at];
        }
        at
    }

    fn join(&mut self, a: &str, b: &str) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a] = b;
    }
}

/// What a schematic says: parts with their values, and nets, each a set of pins such as `R101.1`.
struct Schematic {
    values: BTreeMap<String, String>,
    nets: Vec<BTreeSet<String>>,
    net_names: Vec<BTreeSet<String>>,
}

impl Schematic {
    fn read(text: &str) -> Self {
        let root = parse(text);
        let library: HashMap<&str, &Node> =
            root.first("lib_symbols").every("symbol").map(|part| (part.word(1), part)).collect();
        let wires: Vec<(Point, Point)> = root
            .every("wire")
            .map(|wire| {
                let ends = wire.first("pts").list();
                (ends[1].point(), ends[2].point())
            })
            .collect();

        let key = |(x, y): Point| format!("@{x},{y}");
        let mut groups = Groups::default();
        let attach = |groups: &mut Groups, point: Point, name: Option<&str>| {
            for &(a, b) in wires.iter().filter(|wire| lies_on(point, **wire)) {
                groups.join(&key(point), &key(a));
                groups.join(&key(a), &key(b));
            }
            if let Some(name) = name {
                groups.join(&key(point), name);
            }
        };
        for &(a, b) in &wires {
            groups.join(&key(a), &key(b));
        }
        for junction in root.every("junction") {
            attach(&mut groups, junction.first("at").point(), None);
        }
        for label in root.every("label").chain(root.every("global_label")) {
            attach(&mut groups, label.first("at").point(), Some(label.word(1)));
        }
        let mut values = BTreeMap::new();
        for symbol in root.every("symbol") {
            let field =
                |name| symbol.every("property").find(|p| p.word(1) == name).unwrap().word(2).to_owned();
            let (reference, value) = (field("Reference"), field("Value"));
            let part = library[symbol.first("lib_id").word(1)];
            let names_a_net = part.every("power").next().is_some();
            for pin in part.every("symbol").flat_map(|unit| unit.every("pin")) {
                let end = placed(symbol, pin.first("at").point());
                let number = pin.first("number").word(1);
                let name = if names_a_net { value.clone() } else { format!("{reference}.{number}") };
                attach(&mut groups, end, Some(&name));
            }
            if !names_a_net {
                assert!(values.insert(reference.clone(), value).is_none(), "{reference} is there twice");
            }
        }

        let mut members: BTreeMap<usize, (BTreeSet<String>, BTreeSet<String>)> = BTreeMap::new();
        let names: Vec<String> = groups.index.keys().filter(|name| !name.starts_with('@')).cloned().collect();
        for name in names {
            let (pins, labels) = members.entry(groups.root(&name)).or_default();
            if name.contains('.') {
                pins.insert(name)
            } else {
                labels.insert(name)
            };
        }
        let (nets, net_names) = members.into_values().filter(|(pins, _)| pins.len() > 1).unzip();
        Self { values, nets, net_names }
    }

    /// Which net a pin is on.
    fn net(&self, pin: &str) -> Result<usize, String> {
        self.nets
            .iter()
            .position(|net| net.contains(pin))
            .ok_or_else(|| format!("{pin} is connected to nothing"))
    }

    fn joined(&self, pins: &[&str]) -> Result<(), String> {
        let net = self.net(pins[0])?;
        match pins.iter().find(|pin| !self.nets[net].contains(**pin)) {
            Some(pin) => Err(format!("{pin} is not connected to {}", pins[0])),
            None => Ok(()),
        }
    }

    fn on(&self, pin: &str, name: &str) -> Result<(), String> {
        let net = self.net(pin)?;
        if self.net_names[net].contains(name) { Ok(()) } else { Err(format!("{pin} is not on {name}")) }
    }
}

/// From a symbol's coordinates (y up) to the sheet's (y down).
fn placed(symbol: &Node, (x, y): Point) -> Point {
    let at = symbol.first("at");
    let (x, y) = match at.number(3) / 1000 {
        0 => (x, y),
        90 => (-y, x),
        180 => (-x, -y),
        270 => (y, -x),
        angle => panic!("a symbol is turned by {angle} degrees"),
    };
    let mirrored = symbol.every("mirror").next().map_or("", |mirror| mirror.word(1));
    let (x, y) = match mirrored {
        "x" => (x, -y),
        "y" => (-x, y),
        _ => (x, y),
    };
    (at.number(1) + x, at.number(2) - y)
}

fn lies_on((x, y): Point, ((x1, y1), (x2, y2)): (Point, Point)) -> bool {
    (x2 - x1) * (y - y1) == (y2 - y1) * (x - x1)
        && (x1.min(x2)..=x1.max(x2)).contains(&x)
        && (y1.min(y2)..=y1.max(y2)).contains(&y)
}

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    let path = repository().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn schematic_text() -> String {
    read("firmware/hardware/unlit-flash.kicad_sch")
}

fn schematic() -> Schematic {
    Schematic::read(&schematic_text())
}

fn sync_path(board: &Schematic) -> Result<(), String> {
    // Contact, series resistor, filter and clamps, pin.
    board.joined(&["J101.1", "R101.2", "R103.1"])?;
    board.joined(&["U1.D2", "R103.2", "C102.1", "D101.2", "D102.1"])?;
    board.on("D101.1", "+5V")?;
    board.on("D102.2", "GND")?;
    // The charge that the contact switches, and what brings it back.
    board.joined(&["C101.1", "R101.1", "R102.2"])?;
    board.on("R102.1", "+5V")?;
    board.on("C101.2", "GND")?;
    board.on("J101.2", "GND")
}

fn trigger_path(board: &Schematic) -> Result<(), String> {
    board.joined(&["U1.D4", "R202.1", "R201.1", "R204.1"])?;
    board.on("R202.2", "GND").map_err(|error| format!("no pull-down: {error}"))?;
    board.joined(&["R201.2", "U201.1"])?;
    board.joined(&["R204.2", "U202.1"])?;
    board.on("U201.2", "GND")?;
    board.on("U202.2", "GND")?;
    board.joined(&["U201.5", "D201.1", "J201.1"])?;
    board.joined(&["U201.4", "D201.2", "J201.2"])
}

fn light_path(board: &Schematic) -> Result<(), String> {
    // What the photodiode and the dark level live on comes from the supply through the shunt reference alone.
    board.on("R301.1", "+5V")?;
    board.joined(&["R301.2", "D302.1", "C301.1", "D301.1", "R303.1"])?;
    board.on("D302.2", "GND")?;
    board.on("C301.2", "GND")?;
    let bias = board.net("D301.1")?;
    if board.net_names[bias].contains("+5V") {
        return Err("the photodiode's bias is the supply".to_owned());
    }
    board.joined(&["D301.2", "R302.1", "C302.1", "R303.2", "R304.1"])?;
    board.on("R302.2", "GND")?;
    board.on("C302.2", "GND")?;
    board.joined(&["R304.2", "U1.A0"])
}

fn ready_path(board: &Schematic) -> Result<(), String> {
    board.joined(&["U1.D7", "R402.1", "U401.4"])?;
    board.on("R402.2", "GND")?;
    board.on("U401.5", "+5V")
}

/// Nothing conducts between what the flash's cables touch and what the camera and the PC touch: an opto-coupler's two
/// sides count as two parts.
fn isolation(board: &Schematic) -> Result<(), String> {
    let side = |pin: &str| {
        let (part, number) = pin.split_once('.').unwrap();
        match part {
            "U201" | "U202" | "U401" if matches!(number, "1" | "2") => format!("{part} LED"),
            _ => part.to_owned(),
        }
    };
    let mut groups = Groups::default();
    for (pins, names) in board.nets.iter().zip(&board.net_names) {
        let first = pins.first().unwrap();
        for pin in pins {
            groups.join(&side(first), &side(pin));
        }
        for name in names {
            groups.join(&side(first), name);
        }
    }
    for terminal in ["J201", "J202", "J401"] {
        for other in ["GND", "+5V", "U1", "J101"] {
            if groups.root(terminal) == groups.root(other) {
                return Err(format!("{terminal} has a path to {other}"));
            }
        }
    }
    Ok(())
}

#[test]
fn the_sync_contact_reaches_its_pin_through_its_resistor_and_is_recharged() {
    sync_path(&schematic()).unwrap();
}

#[test]
fn the_trigger_drives_an_opto_led_and_is_pulled_down() {
    trigger_path(&schematic()).unwrap();
}

#[test]
fn the_photodiode_reaches_the_converter() {
    light_path(&schematic()).unwrap();
}

#[test]
fn a_ready_wire_that_came_off_reads_as_not_ready() {
    ready_path(&schematic()).unwrap();
}

#[test]
fn the_flash_is_isolated_from_camera_and_computer() {
    isolation(&schematic()).unwrap();
}

type Check = fn(&Schematic) -> Result<(), String>;

#[test]
fn each_wire_and_junction_that_a_path_needs_is_missed_when_it_is_cut() {
    let whole = schematic_text();
    let cuts: Vec<&str> =
        whole.lines().filter(|line| line.starts_with("(wire") || line.starts_with("(junction")).collect();
    let boards: Vec<Schematic> = cuts.iter().map(|cut| Schematic::read(&whole.replace(*cut, ""))).collect();
    let paths: [(&str, Check); 4] =
        [("sync", sync_path), ("trigger", trigger_path), ("light", light_path), ("ready", ready_path)];
    for (name, check) in paths {
        let seen = boards.iter().filter(|board| check(board).is_err()).count();
        assert!(seen >= 4, "{name}: only {seen} of {} cuts were seen", cuts.len());
    }
}

#[test]
fn a_bridge_over_the_isolation_is_seen() {
    let mut board = schematic();
    let (flash, ground) = (board.net("J201.2").unwrap(), board.net("U201.2").unwrap());
    let pins = board.nets[flash].clone();
    board.nets[ground].extend(pins);
    assert!(isolation(&board).unwrap_err().contains("GND"));
}

#[test]
fn schematic_and_bill_of_materials_name_the_same_parts() {
    let table = read("firmware/hardware/bom.csv");
    let mut lines = table.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    assert_eq!(head, ["reference", "quantity", "fit", "value", "part", "reason", "alternatives"]);
    let mut listed = BTreeMap::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(cells.len(), head.len(), "cells of: {line}");
        assert!(!cells[4].is_empty() && !cells[5].is_empty(), "part and reason of: {line}");
        let references: Vec<&str> = cells[0].split(' ').filter(|reference| *reference != "-").collect();
        if !references.is_empty() {
            assert_eq!(cells[1].parse(), Ok(references.len()), "quantity of: {line}");
        }
        for reference in references {
            let twice = listed.insert(reference.to_owned(), cells[3].to_owned());
            assert!(twice.is_none(), "{reference} is listed twice");
        }
    }
    assert_eq!(listed, schematic().values);
}

#[test]
fn the_drawing_shows_the_schematic_as_it_is() {
    let drawing = read("firmware/hardware/unlit-flash.svg");
    let board = schematic();
    for (reference, value) in &board.values {
        for word in [reference, value] {
            assert!(drawing.contains(&format!(">{word}</text>")), "{word} is not drawn; run render.py");
        }
    }
    let listed = drawing.split_once("<metadata id=\"nets\">").unwrap().1.split_once("</metadata>").unwrap().0;
    let drawn: BTreeSet<BTreeSet<String>> = listed
        .trim()
        .lines()
        .map(|line| line.split_once(": ").unwrap().1.split(' ').map(str::to_owned).collect())
        .collect();
    let derived: BTreeSet<BTreeSet<String>> = board.nets.into_iter().collect();
    assert_eq!(drawn, derived, "the drawing is of another schematic; run firmware/hardware/render.py");
}

#[test]
fn firmware_and_schematic_agree_on_the_pins() {
    let board_h = read("firmware/avr/board.h").to_uppercase();
    let board = schematic();
    for (pin, function, label) in [
        ("D2", "SYNC", "SYNC"),
        ("D4", "TRIGGER", "TRIG"),
        ("D7", "READY", "READY"),
        ("D13", "ARMED", "ARMED"),
        ("A0", "LIGHT", "LIGHT"),
    ] {
        board.on(&format!("U1.{pin}"), label).unwrap();
        let told = board_h.lines().any(|line| {
            let words: Vec<&str> = line.split(|c: char| !c.is_ascii_alphanumeric()).collect();
            words.contains(&pin) && words.iter().any(|word| word.starts_with(function))
        });
        assert!(told, "firmware/avr/board.h has no line with {pin} and {function}");
    }
}

/// The chip drives its reference out of AREF, and the light's network ends at its full scale, not at the supply's.
#[test]
fn light_is_measured_against_the_chips_own_reference_and_nothing_is_wired_to_it() {
    assert!(schematic().net("U1.AREF").is_err());
    let board_h = read("firmware/avr/board.h");
    let chosen =
        board_h.lines().find_map(|line| line.strip_prefix("#define REFERENCE ")).expect("a reference");
    assert_eq!(chosen, "(_BV(REFS1) | _BV(REFS0))");
    let main_c = read("firmware/avr/main.c");
    let writes: Vec<&str> = main_c.lines().map(str::trim).filter(|line| line.starts_with("ADMUX")).collect();
    assert_eq!(writes, ["ADMUX = REFERENCE | LIGHT_CHANNEL;"], "chosen once");
}

/// Volts and ohms from a part's value such as `LM4040-2.5`, `4k7`, `220` or `4u7 film`.
fn quantity(value: &str) -> f64 {
    let word = value.split(' ').next().unwrap().rsplit('-').next().unwrap();
    let scales = [('k', 1e3), ('M', 1e6), ('u', 1e-6), ('n', 1e-9)];
    match scales.iter().find(|(letter, _)| word.contains(*letter)) {
        Some((letter, scale)) => {
            let digits = word.replace(*letter, ".");
            digits.trim_end_matches('.').parse::<f64>().unwrap() * scale
        }
        None => word.parse().unwrap(),
    }
}

#[test]
fn darkness_and_smoothing_fit_the_reference() {
    let values = schematic().values;
    let of = |part: &str| quantity(&values[part]);
    let (bias, load, lift) = (of("D302"), of("R302"), of("R303"));
    for reference in [1.0, 1.1, 1.2] {
        let dark = 1024.0 / reference * bias * load / (load + lift);
        assert!((15.0..40.0).contains(&dark), "{dark} counts of darkness at {reference} V");
    }
    let smoothing = load * of("C302");
    assert!((0.5e-3..=1.1e-3).contains(&smoothing), "{smoothing} s");
    // The shunt reference rules even at the peak of a pulse and with a poor supply.
    let peak = 800.0 / 1024.0 * 1.1 / load;
    assert!((4.5 - bias) / of("R301") > peak + bias / lift, "{peak} A at 800 counts");
}

#[test]
fn links_of_the_hardware_pages_resolve() {
    let folder = repository().join("firmware/hardware");
    let pages: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    let mut links = 0;
    for page in &pages {
        let text = std::fs::read_to_string(page).unwrap();
        for rest in text.split("](").skip(1) {
            let target = rest.split(')').next().unwrap();
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            if file.contains("://") {
                continue;
            }
            links += 1;
            let path = if file.is_empty() { page.clone() } else { folder.join(file) };
            assert!(path.exists(), "{}: {target} leads nowhere", page.display());
            if !anchor.is_empty() {
                let aim = std::fs::read_to_string(&path).unwrap();
                assert!(
                    headings(&aim).any(|heading| heading == anchor),
                    "{}: no heading {target}",
                    page.display()
                );
            }
        }
    }
    assert!(links >= 5, "only {links} links in {} pages", pages.len());
}

/// Headings of a page as a link names them.
fn headings(page: &str) -> impl Iterator<Item = String> + '_ {
    page.lines().filter(|line| line.starts_with('#')).map(|line| {
        let words = line.trim_start_matches('#').trim().to_lowercase();
        words
            .chars()
            .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-'))
            .collect::<String>()
            .replace(' ', "-")
    })
}

#[test]
fn the_udev_rules_run_after_the_links_are_made_and_before_access_is_given() {
    let serial = ["TAG+=\"uaccess\"", "GROUP=\"dialout\"", "ENV{ID_MM_DEVICE_IGNORE}=\"1\""];
    let camera = ["TAG+=\"uaccess\"", "GROUP=\"plugdev\"", "ENV{ID_USB_INTERFACES}==\"*:060101:*\""];
    let expected = [("60-unlit-camera.rules", camera), ("60-unlit-flash.rules", serial)];
    let mut names: Vec<String> = std::fs::read_dir(repository().join("packaging/udev"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, expected.map(|(name, _)| name));
    for (rule, parts) in expected {
        assert!(rule > "60-serial.rules" && rule < "73-seat-late.rules", "{rule}");
        let text = read(&format!("packaging/udev/{rule}"));
        for part in parts {
            assert!(text.contains(part), "{rule}: {part}");
        }
    }
}
