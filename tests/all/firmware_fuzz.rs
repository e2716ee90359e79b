//! A million lines, edges among them, against the firmware's core under sanitizers; `firmware/fuzz/fuzz.c` says what
//! must hold after each.

use super::avr::firmware;
use std::path::Path;
use std::process::Command;

/// What a million frames must at least have brought about, some half of what they do: a core that refuses everything,
/// or a bench that tries nothing, keeps every promise, too.
const AT_LEAST: [(&str, u64); 10] = [
    ("answers", 900_000),
    ("events", 50_000),
    ("edges", 400_000),
    ("interrupts inside the core", 350_000),
    ("windows measured", 30_000),
    ("arms", 3000),
    ("syncs let through", 2500),
    ("fires", 600),
    ("too late", 300),
    ("boots", 200),
];

/// The number before a word in what the harness prints.
fn count(said: &str, what: &str) -> u64 {
    let before = said.split([',', ':', '(', ')']).map(str::trim).find_map(|part| part.strip_suffix(what));
    let number = before.and_then(|number| number.trim_end().parse().ok());
    number.unwrap_or_else(|| panic!("the harness does not print how many {what}: {said}"))
}

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
        let said = String::from_utf8_lossy(&run.stdout);
        println!("seed {seed}: {}", said.trim_end());
        assert!(run.status.success(), "seed {seed}: {}", String::from_utf8_lossy(&run.stderr));
        for (what, least) in AT_LEAST {
            let got = count(&said, what);
            assert!(got >= least, "seed {seed}: {got} {what}, fewer than {least}");
        }
    }
}
