//! A million lines, edges among them, against the firmware's core under sanitizers; `firmware/fuzz/fuzz.c` says what
//! must hold after each.

use super::avr::firmware;
use std::path::Path;
use std::process::Command;

#[test]
fn a_million_frames_break_no_promise_of_the_core() {
    let build = Path::new(env!("CARGO_TARGET_TMPDIR")).join("firmware/fuzz");
    let made = Command::new("make")
        .arg("-s")
        .arg("-C")
        .arg(firmware().join("fuzz"))
        .arg(format!("BUILD={}", build.display()))
        .output()
        .unwrap_or_else(|e| panic!("make does not start ({e}): run script/setup test"));
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let soak = std::env::var_os("UNLIT_SOAK").is_some();
    for seed in 1..=if soak { 20 } else { 1 } {
        let run =
            Command::new(build.join("unlit-fuzz")).arg(seed.to_string()).arg("1000000").output().unwrap();
        println!("seed {seed}: {}", String::from_utf8_lossy(&run.stdout).trim_end());
        assert!(run.status.success(), "seed {seed}: {}", String::from_utf8_lossy(&run.stderr));
    }
}
