//! The two scripts of docs/api.md do what the page says: as they stand there, against a daemon in the simulated studio.

use crate::daemon::Daemon;
use std::path::Path;
use std::process::Command;
use unlit::progress::Progress;

const PAIRS: usize = 2;

/// The fenced block of `docs/api.md` that begins with this line.
fn script(first_line: &str) -> String {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/api.md")).unwrap();
    let at = page.find(&format!("\n{first_line}\n")).unwrap_or_else(|| panic!("no script with {first_line}"));
    let rest = &page[at + 1..];
    rest[..rest.find("\n```").unwrap() + 1].to_owned()
}

#[test]
fn the_scripts_of_the_page_shoot_a_session_and_fetch_its_model() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage");
    unlit::studio::truth::export(&stage, &Progress::silent()).unwrap();
    let daemon = Daemon::start(folder.path());
    for (program, first_line) in [("bash", "#!/usr/bin/env bash"), ("python3", "#!/usr/bin/env python3")] {
        let file = folder.path().join(program);
        std::fs::write(&file, script(first_line)).unwrap();
        let session = format!("by_{program}");
        let output = Command::new(program)
            .arg(&file)
            .current_dir(folder.path())
            .envs([("UNLIT", daemon.url.as_str()), ("SESSION", &session), ("DISTANCES", "0.8 1.2")])
            .envs([("GEOMETRY", "stage/geometry"), ("PAIRS", &PAIRS.to_string())])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        println!("{said}");
        assert!(output.status.success(), "{program}: {said}{}", String::from_utf8_lossy(&output.stderr));
        let (document, _, images) = gltf::import(folder.path().join(format!("{session}.glb"))).unwrap();
        assert_eq!((document.meshes().count(), images.len()), (1, 1));
        let about = daemon.client().get(&format!("/sessions/{session}")).unwrap();
        assert_eq!((about["pairs"].as_u64(), about["accepted"].as_u64()), (Some(2), Some(2)), "{about}");
    }
}
