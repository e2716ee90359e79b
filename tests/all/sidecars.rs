//! Sidecars of originals, read by a program that shares nothing with us.

use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use unlit::pair::{Reason, ReasonCode, Settings};
use unlit::progress::Progress;
use unlit::session::{More, NewFrame, NewPair, Session};

fn store(session: &Session, name: &str, reasons: Vec<Reason>) {
    let frame = |bytes, original_name| NewFrame {
        bytes,
        original_name,
        settings: Settings::default(),
        prepared: None,
        jpeg: None,
    };
    let (off, on) = (frame(b"off".as_slice(), "a.CR2"), frame(b"on", "b.DNG"));
    session
        .commit_pair(NewPair { name: Some(name), off, on, reasons, flash: None, more: More::default() })
        .unwrap();
}

fn read(file: &Path) -> Value {
    let run =
        Command::new("exiftool").args(["-j", "-G1", "-validate", "-all:all"]).arg(file).output().unwrap();
    serde_json::from_slice::<Value>(&run.stdout).unwrap()[0].take()
}

#[test]
fn a_rejected_frame_is_rated_so_and_says_why_and_an_accepted_one_is_not_rated() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(home.path(), "bath").unwrap();
    let reason = |code, sentence: &str| Reason { code, figure: 2.0, limit: 1.0, sentence: sentence.into() };
    let reasons = vec![
        reason(ReasonCode::Moved, "It moved by 2.0 > 1.0 px & \"more\" <there>."),
        reason(ReasonCode::Weak, "Zu wenig Licht: näher heran."),
    ];
    store(&session, "a & b", vec![]);
    store(&session, "c", reasons);

    let good = read(&session.pair_dir(1).join("off.xmp"));
    assert_eq!((&good["XMP-xmp:Rating"], &good["XMP-xmp:Label"]), (&Value::Null, &Value::Null), "{good}");
    assert_eq!(good["XMP-dc:Description"], "Pair a & b, frame off: accepted.");
    let bad = read(&session.pair_dir(2).join("on.xmp"));
    assert_eq!((&bad["XMP-xmp:Rating"], &bad["XMP-xmp:Label"]), (&json!(-1), &json!("Red")), "{bad}");
    let told = "Pair c, frame on: rejected. It moved by 2.0 > 1.0 px & \"more\" <there>. Zu wenig Licht: näher heran.";
    assert_eq!(bad["XMP-dc:Description"], told);
    assert_eq!((&bad["XMP-unlit:Verdict"], &bad["XMP-unlit:Pair"]), (&json!("rejected"), &json!(2)));
    assert_eq!(bad["XMP-unlit:Reasons"], json!(["moved", "weak"]));
    for told in [&good, &bad] {
        assert_eq!(told["ExifTool:Validate"], "OK", "{told}");
    }
    let found = session.verify(&Progress::silent()).unwrap();
    assert!(found.findings.is_empty() && found.originals == 4, "{:?}", found.findings);
}
