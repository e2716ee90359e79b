//! Whoever reads the program's output goes away: `unlit ... | head`.

use std::process::{Command, Stdio};

#[test]
fn a_reader_that_goes_away_ends_the_program_without_a_word() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .arg("openapi")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(complained.is_empty(), "{complained}");
    assert_eq!(output.status.code(), Some(141));
}
