//! Requests and answers: numbers, checksums, form, repetition, and any bytes at all.

use super::*;

fn refusal(seq: u8, code: u32, word: &str) -> Vec<Line> {
    vec![Line::Err { seq, code, word: word.into() }]
}

#[test]
fn a_repeated_request_replays_its_answer_and_is_not_carried_out_again() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    let request = line::request(bed.seq, "arm tag=1 ttl=1000");
    assert_eq!(bed.raw(&request), [Line::Ok { seq: bed.seq, fields: Fields::default() }]);
    assert!(bed.edge());
    bed.wait_ms(500);
    assert_eq!(bed.raw(&request), [Line::Ok { seq: bed.seq, fields: Fields::default() }]);
    assert_eq!(bed.ok("ping").uint("g"), Some(0), "the replay armed nothing");
}

#[test]
fn the_same_number_with_other_bytes_is_refused() {
    let mut bed = Bed::greeted();
    bed.ok("ping");
    let request = line::request(bed.seq, "arm tag=1 ttl=1000");
    assert_eq!(bed.raw(&request), refusal(bed.seq, 6, "seq"));
    assert!(!bed.edge());
    let repeated = line::request(bed.seq, "ping");
    assert!(matches!(bed.raw(&repeated)[0], Line::Ok { .. }), "the first answer is still there");
}

#[test]
fn hello_is_carried_out_even_if_its_bytes_were_seen_before() {
    let mut bed = Bed::new();
    let hello = line::request(1, "hello v=1 strict=1");
    bed.raw(&hello);
    bed.now += 1_000_000;
    let Line::Ok { fields, .. } = &bed.raw(&hello)[0] else { panic!("refused") };
    assert_eq!(fields.uint("t"), Some(1_000_000));
    assert_eq!((fields.uint("boot"), fields.word("mcu")), (Some(7), Some("native")));
}

#[test]
fn numbered_requests_need_a_right_checksum_in_upper_case() {
    let mut bed = Bed::new();
    let whole = line::request(10, "ping");
    for damaged in
        ["#10 ping\n".to_owned(), whole.replace("ping", "pinh"), whole.to_lowercase(), "#1 ping*\n".into()]
    {
        assert_eq!(bed.raw(&damaged), refusal(0, 1, "crc"), "{damaged}");
    }
    assert!(matches!(bed.raw(&whole)[0], Line::Ok { seq: 10, .. }));
}

#[test]
fn a_person_may_type_until_strict() {
    let mut bed = Bed::new();
    assert!(matches!(bed.raw("ping\r\n")[0], Line::Ok { seq: 0, .. }));
    assert!(bed.raw("\n\r\n").is_empty());
    assert!(matches!(bed.raw("hello v=1\n")[0], Line::Ok { seq: 0, .. }));
    assert!(matches!(bed.raw("arm tag=5 ttl=1000\n")[0], Line::Ok { seq: 0, .. }));
    assert!(bed.edge());
    bed.ok("hello v=1 strict=1");
    assert_eq!(bed.raw("ping\n"), refusal(0, 7, "strict"));
}

#[test]
fn sloppy_requests_are_refused() {
    let mut bed = Bed::greeted();
    for (body, code) in [
        ("ping ", 2),
        ("ping  x=1", 2),
        ("PING", 2),
        ("", 2),
        ("arm tag=1 ttl", 2),
        ("arm tag=1 ttl=", 2),
        ("arm tag=1 ttl=-1", 2),
        ("arm tag=1 ttl=1x", 2),
        ("launch", 4),
        ("ping x=1", 5),
        ("arm tag=1", 5),
        ("arm tag=0 ttl=100", 5),
        ("arm tag=1 ttl=0", 5),
        ("arm tag=1 ttl=60001", 5),
        ("arm tag=1 tag=1 ttl=10", 5),
        ("arm tag=4294967296 ttl=10", 5),
        ("arm tag=1 ttl=10 x=1", 5),
        ("fire d=10000001", 5),
        ("adc ch=1", 5),
        ("hello v=2", 5),
        ("cfg lock=10", 5),
        ("cfg win=60001", 5),
        ("get n=1", 13),
    ] {
        assert_eq!(bed.refused(body).0, code, "{body:?}");
    }
    assert_eq!(bed.raw("#0 ping*A7DC\n").len(), 1);
    assert!(!bed.edge(), "none of it armed");
}

#[test]
fn an_overlong_line_is_refused_whole() {
    let mut bed = Bed::new();
    let longest = format!("{:<96}\n", "ping").replace(' ', "x");
    assert_eq!(longest.len(), 97);
    assert_eq!(bed.raw(&longest), refusal(0, 4, "verb"));
    let too_long = format!("{}\n", "x".repeat(97));
    assert_eq!(bed.raw(&too_long), refusal(0, 3, "long"));
    assert!(matches!(bed.raw("ping\n")[0], Line::Ok { .. }));
}

#[test]
fn the_last_sixteen_shots_are_kept() {
    let mut bed = Bed::greeted();
    for _ in 0..20 {
        bed.edge();
        bed.wait_ms(60);
    }
    let reported = bed.take_events("shot");
    assert_eq!(bed.refused("get n=4"), (13, "gone".into()));
    assert_eq!(bed.refused("get n=21"), (13, "gone".into()));
    for n in 5..=20 {
        assert_eq!(bed.ok(&format!("get n={n}")), reported[n - 1]);
    }
}

#[test]
fn events_are_numbered_without_a_gap() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    bed.edge();
    bed.wait_ms(200);
    let numbers: Vec<u16> = bed.events.iter().map(|e| e.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as u16).collect::<Vec<_>>());
    assert_eq!(bed.ok("ping").uint("ev"), Some(numbers.len() as u32));
}

#[test]
fn settings_are_taken_whole_or_not_at_all() {
    let mut bed = Bed::greeted();
    let before = bed.ok("cfg");
    assert_eq!(bed.refused("cfg rec=300 sil=1").0, 5);
    assert_eq!(bed.ok("cfg"), before);
    assert_eq!(bed.ok("cfg rec=300 sil=800").uint("rec"), Some(300));
    bed.ok("arm tag=1 ttl=500");
    assert_eq!(bed.refused("cfg rec=0").0, 11);
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(300))]

    #[test]
    fn no_bytes_upset_the_core_nor_open_its_gate(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
        let mut bed = Bed::greeted();
        bed.core.receive(&bytes, bed.now);
        bed.core.receive(b"\n", bed.now);
        bed.heard();
        proptest::prop_assert!(!bed.edge());
        bed.wait_ms(60);
        bed.ok("ping");
    }
}
