//! `unlit shoot --positions N`.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use unlit::session::Session;

fn shoot(folder: &Path, between: &str, positions: u32) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_unlit"));
    command
        .args(["shoot", "--studio", "--between", between, "--positions", &positions.to_string()])
        .arg(folder.join("walk"))
        .env("HOME", folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// Reads what it says until a line has `words` in it.
fn hear(said: &mut impl BufRead, words: &str) -> String {
    let mut all = String::new();
    loop {
        let from = all.len();
        assert!(said.read_line(&mut all).unwrap() > 0, "it ended before it said {words:?}: {all}");
        if all[from..].contains(words) {
            return all;
        }
    }
}

fn interrupt(child: &Child) {
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

#[test]
fn the_return_key_takes_each_pair_and_the_same_command_goes_on_after_an_interruption() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = shoot(folder.path(), "prompt", 2).spawn().unwrap();
    let mut said = BufReader::new(child.stdout.take().unwrap());
    hear(&mut said, "Position 1 of 2: get ready [return]");
    child.stdin.as_mut().unwrap().write_all(b"\n").unwrap();
    hear(&mut said, "Position 2 of 2: move on [return]");
    // The end of input would stop it too.
    let keyboard = child.stdin.take();
    interrupt(&child);
    let output = child.wait_with_output().unwrap();
    drop(keyboard);
    let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{complaint}");
    assert!(complaint.contains("stopped at position 2 of 2; the same command goes on there"), "{complaint}");

    let mut child = shoot(folder.path(), "countdown:0.2", 2).spawn().unwrap();
    let mut said = BufReader::new(child.stdout.take().unwrap());
    let all = hear(&mut said, "All 2 positions are done.");
    assert!(!all.contains("Position 1"), "{all}");
    hear(&mut said, "Pairs: 2 accepted, 0 rejected; positions skipped: 0.");
    assert!(child.wait().unwrap().success());
    // What is done is not begun anew unless that is asked for.
    let run = shoot(folder.path(), "countdown:0", 2).output().unwrap();
    let told = String::from_utf8_lossy(&run.stdout).into_owned();
    assert_eq!(run.status.code(), Some(0), "{told}");
    assert!(told.contains("All 2 positions are done.") && told.contains("--anew begins another"), "{told}");
    let run = shoot(folder.path(), "countdown:0", 1).output().unwrap();
    let complaint = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(1), "{complaint}");
    assert!(complaint.contains("All 2 positions are done. Add --anew"), "{complaint}");
    let session = Session::open(&folder.path().join("walk")).unwrap();
    let record = session.sequence().unwrap().unwrap();
    let pairs: Vec<_> = record.positions.iter().map(|p| p.pairs.clone()).collect();
    assert_eq!((pairs, session.pairs().unwrap().len()), (vec![vec![1], vec![2]], 2));
}

#[test]
fn a_file_of_the_users_own_sets_each_position_off() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("go");
    let mut child = shoot(folder.path(), &format!("file:{}", file.display()), 1).spawn().unwrap();
    let mut said = BufReader::new(child.stdout.take().unwrap());
    hear(&mut said, "waits for the trigger file");
    std::fs::write(&file, "").unwrap();
    hear(&mut said, "The position is done.");
    assert!(child.wait().unwrap().success());
    assert!(!file.exists(), "the file is taken");
}
