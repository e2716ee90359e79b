//! The delayed fire: when it comes, and what cancels it.

use super::*;

#[test]
fn disarm_and_silence_cancel_a_pending_fire() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=100000 tag=1");
    bed.wait_ms(50);
    bed.ok("disarm");
    bed.wait_ms(200);
    assert_eq!(bed.core.rises(), 0);

    bed.ok("fire d=5000000 tag=1");
    bed.wait_ms(1600);
    assert_eq!(bed.disarm_reasons(), ["silence"]);
    bed.wait_ms(5000);
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn fire_triggers_after_its_delay() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=100000 tag=9");
    assert_eq!(bed.refused("arm tag=1 ttl=1000"), (11, "busy".into()));
    bed.wait_us(99_500);
    assert_eq!(bed.core.rises(), 0);
    bed.wait_us(1000);
    assert_eq!(bed.core.rises(), 1);
    bed.wait_ms(60);
    let shots = bed.take_events("shot");
    assert_eq!(
        (shots[0].word("src"), shots[0].uint("g"), shots[0].uint("tag")),
        (Some("fire"), Some(1), Some(9))
    );
}

#[test]
fn a_sync_beside_a_pending_fire_stays_dark_and_the_fire_waits_its_turn() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=1000 tag=9");
    assert!(!bed.edge());
    bed.wait_ms(20);
    assert_eq!(bed.core.rises(), 0);
    bed.wait_ms(80);
    assert_eq!(bed.core.rises(), 1);
    let shots = bed.take_events("shot");
    assert_eq!(shots.iter().map(|s| s.uint("g").unwrap()).collect::<Vec<_>>(), [0, 1]);
}

#[test]
fn a_fire_that_a_closed_contact_holds_up_is_cancelled_and_does_not_come_when_it_opens() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=100000 tag=9");
    bed.core.pins().sync_closed = true;
    assert!(!bed.edge());
    bed.wait_us(149_500);
    assert!(bed.disarm_reasons().is_empty());
    bed.wait_us(1000);
    assert_eq!(bed.disarm_reasons(), ["late"]);
    assert_eq!(bed.ok("stat").uint("fire"), Some(0));
    for _ in 0..3 {
        bed.wait_ms(1000);
        bed.ok("ping");
    }
    bed.core.pins().sync_closed = false;
    bed.wait_ms(1000);
    assert_eq!(bed.core.rises(), 0);
    bed.ok("fire");
    bed.wait_ms(1);
    assert_eq!(bed.core.rises(), 1);
}

#[test]
fn a_fire_asks_the_ready_output_again_when_its_moment_comes() {
    let mut bed = Bed::greeted();
    bed.ok("cfg rdy=1");
    bed.ok("fire d=100000 tag=1");
    bed.core.pins().charged = false;
    bed.wait_ms(151);
    assert_eq!((bed.disarm_reasons(), bed.core.rises()), (vec!["late".to_owned()], 0));
    bed.core.pins().charged = true;
    bed.wait_ms(500);
    assert_eq!(bed.core.rises(), 0, "cancelled for good");
    bed.ok("fire d=100000 tag=2");
    bed.core.pins().charged = false;
    bed.wait_ms(120);
    bed.core.pins().charged = true;
    bed.wait_ms(1);
    assert_eq!(bed.core.rises(), 1, "charged 20 ms late is in time");
}

#[test]
fn a_fire_that_waited_for_a_shot_keeps_its_pulse() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=1000 tag=9");
    bed.edge();
    bed.now += 30_000;
    bed.core.poll(bed.now); // tells the shot, and would be late by its writing
    bed.now += 4000;
    bed.core.poll(bed.now);
    assert!(bed.core.trigger_high());
    bed.now += 900;
    bed.core.poll(bed.now);
    assert!(bed.core.trigger_high(), "a pulse of 1 ms");
    bed.heard();
    assert_eq!(bed.core.rises(), 1);
}
