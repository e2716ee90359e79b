//! The AVR's program in simavr: what `firmware/PROTOCOL.md` promises, one by one, in simulated time.

mod energy;
mod program;

use super::avr::{Desk, MHZ, Report, built, rises};
use std::process::Command;

fn median_and_max(mut cycles: Vec<u64>) -> (u64, u64) {
    cycles.sort_unstable();
    (cycles[cycles.len() / 2], cycles[cycles.len() - 1])
}

/// simavr serves an interrupt without the chip's four cycles of response; the chip also takes up to two to notice
/// the edge.
const CHIP_EXTRA: u64 = 6;

#[test]
fn the_trigger_follows_the_sync_within_cycles() {
    let mut desk = Desk::greeted();
    desk.ok("cfg win=200"); // light is not the subject, and takes the simulator long
    let mut idle = Vec::new();
    for tag in 1..=150 {
        idle.extend(desk.lit_frame(tag, f64::from(tag) * 7.0625).latencies);
    }
    // Requests at full line rate, answers at full line rate, and the edge at every third cycle of a byte's time.
    let mut loaded = Vec::new();
    for step in 0..463 {
        desk.ok("arm tag=1 ttl=5000");
        for _ in 0..4 {
            let ping = desk.numbered("ping");
            desk.sim.command(&format!("say {ping}"));
        }
        let edge = 2000.0 + f64::from(step) * 3.0 / MHZ;
        let reports = desk.contact(&format!("{edge}=1 {}=0", edge + 10_000.0));
        let closed = reports.iter().find_map(|r| match r {
            Report::Contact { cycle, closed: true } => Some(*cycle),
            _ => None,
        });
        loaded.extend(rises(&reports).iter().map(|rise| rise - closed.unwrap()));
    }
    let ((idle_median, idle_max), (median, max)) =
        (median_and_max(idle.clone()), median_and_max(loaded.clone()));
    let us = |cycles: u64| (cycles + CHIP_EXTRA) as f64 / MHZ;
    println!("sync to trigger, idle: median {idle_median}, max {idle_max} cycles of {}", idle.len());
    println!("sync to trigger, UART loaded: median {median}, max {max} cycles of {}", loaded.len());
    println!("on the chip, with {CHIP_EXTRA} more: median {:.2} us, max {:.2} us", us(median), us(max));
    assert_eq!((idle.len(), loaded.len()), (150, 463));
    assert!(idle_median <= 8 && median <= 8, "{idle_median} {median}");
    assert!(idle_max <= 40 && max <= 40, "{idle_max} {max}");
}

#[test]
fn two_hundred_dark_and_two_hundred_lit_frames() {
    let mut desk = Desk::greeted();
    let (mut dark, mut lit) = (Vec::new(), Vec::new());
    for tag in 1..=200 {
        desk.ok("disarm");
        dark.push(desk.frame(100.0));
        lit.push(desk.lit_frame(tag, 100.0));
    }
    let count = |frames: &[super::avr::Frame]| frames.iter().map(|f| f.latencies.len()).sum::<usize>();
    println!(
        "{} dark frames: {} triggers; {} lit frames: {} triggers",
        dark.len(),
        count(&dark),
        lit.len(),
        count(&lit)
    );
    assert!(dark.iter().all(|f| f.latencies.is_empty() && f.energy == 0.0));
    assert!(dark.iter().all(|f| (f.shot.int("g"), f.shot.int("tag"), f.shot.int("w")) == (0, 0, 0)));
    assert!(lit.iter().all(|f| f.latencies.len() == 1 && f.energy == 1.0));
    assert!(lit.iter().zip(1..).all(|(f, tag)| (f.shot.int("g"), f.shot.int("tag")) == (1, tag)));
    assert!(lit.iter().all(|f| f.shot.int("w") > 400));
    let numbers: Vec<u16> = desk.events.iter().map(|(number, ..)| *number).collect();
    assert!(numbers.windows(2).all(|w| w[0] < w[1]), "{numbers:?}");
}

#[test]
fn contact_bounce_gives_one_trigger_and_one_shot() {
    let mut desk = Desk::greeted();
    for gap in [1.0, 3.0, 10.0, 50.0, 170.0] {
        desk.ok("arm tag=1 ttl=1000");
        let closing: String = (0..12).map(|i| format!("{}={} ", f64::from(i) * gap, 1 - i % 2)).collect();
        let opening: String =
            (0..9).map(|i| format!("{}={} ", 12_000.0 + f64::from(i) * gap, i % 2)).collect();
        let reports = desk.contact(&format!("{closing}4000=1 {opening}15000=0"));
        let shots = desk.take_events("shot");
        assert_eq!((rises(&reports).len(), shots.len()), (1, 1), "bounces {gap} us apart");
        println!("bounces {gap} us apart: 1 trigger, bn={}", shots[0].word("bn"));
        assert!(shots[0].int("bn") > 0);
        assert!(desk.contact("0=1 150=0 300=1 10000=0").iter().all(|r| !matches!(r, Report::Trigger { .. })));
        desk.take_events("shot");
    }
}

/// A sync that came just before the gate opened must not light the flash by its bounce, wherever in the handling of
/// `arm` it falls.
#[test]
fn no_bounce_of_an_earlier_sync_uses_a_gate_that_opens_meanwhile() {
    let mut desk = Desk::greeted();
    desk.ok("cfg win=200");
    let say_arm = |desk: &mut Desk| -> u64 {
        desk.take_reports();
        let arm = desk.numbered("arm tag=1 ttl=40");
        let now = desk.sim.command("run 0").parse().unwrap();
        desk.sim.command(&format!("say {arm}"));
        now
    };
    let begun = say_arm(&mut desk);
    desk.wait_ms(60.0);
    let lit = desk.take_reports().into_iter().find_map(|r| match r {
        Report::Armed { cycle, lit: true } => Some((cycle - begun) as f64 / MHZ),
        _ => None,
    });
    let lit = lit.expect("it was armed");
    let (mut before, mut after) = (0, 0);
    for step in 0..600 {
        say_arm(&mut desk);
        let edge = lit + 150.0 - f64::from(step) * 0.4375;
        let bounces = format!("{edge}=1 {}=0 {}=1 {}=0", edge + 15.0, edge + 40.0, edge + 9000.0);
        desk.sim.command(&format!("contact {bounces}"));
        desk.wait_ms(60.0);
        let reports = desk.take_reports();
        let closing = reports.iter().find_map(|r| match r {
            Report::Contact { cycle, closed: true } => Some(*cycle),
            _ => None,
        });
        let closing = closing.expect("the contact closed");
        match rises(&reports)[..] {
            [] => before += 1,
            // Within what the board holds interrupts off for, long before the bounce.
            [rise] if rise - closing < 160 => after += 1,
            ref rises => panic!("step {step}: edge at {closing}, trigger at {rises:?}"),
        }
        assert_eq!(desk.take_events("shot").len(), 1);
        desk.ok("disarm");
    }
    println!("edges before the gate opened: {before}, after: {after}");
    assert!(before > 20 && after > 20, "{before} {after}: the sweep missed the opening");
}

#[test]
fn a_stuck_contact_is_told_once_and_not_armed_on() {
    let mut desk = Desk::greeted();
    desk.sim.command("contact 0=1");
    for _ in 0..5 {
        desk.wait_ms(1000.0);
    }
    assert_eq!(desk.take_events("stuck").len(), 1);
    assert_eq!(desk.refused("arm tag=1 ttl=1000"), 11);
    assert_eq!(desk.refused("fire"), 11);
    desk.sim.command("contact 0=0");
    desk.wait_ms(50.0);
    assert_eq!(desk.take_events("shot").len(), 1);
    assert_eq!(desk.lit_frame(2, 100.0).latencies.len(), 1);
}

#[test]
fn arm_and_fire_are_refused_until_hello_in_this_boot() {
    let mut desk = Desk::booted();
    assert_eq!((desk.refused("arm tag=1 ttl=1000"), desk.refused("fire")), (7, 7));
    desk.ok("hello v=1 strict=1");
    desk.ok("arm tag=1 ttl=1000");
    desk.sim.command("reset");
    desk.wait_ms(300.0);
    assert_eq!((desk.refused("arm tag=1 ttl=1000"), desk.refused("fire")), (7, 7));
    assert!(desk.frame(10.0).latencies.is_empty());
}

#[test]
fn a_request_repeated_across_a_reset_arms_nothing() {
    let mut desk = Desk::greeted();
    let boot = desk.ok("hello v=1 strict=1").int("boot");
    let arm = desk.numbered("arm tag=9 ttl=5000");
    assert_eq!(desk.raw(&arm).len(), 1);
    assert_eq!(desk.raw(&arm).len(), 1, "the answer again");
    desk.sim.command("reset");
    desk.wait_ms(300.0);
    let number = arm.split(' ').next().unwrap();
    assert_eq!(desk.raw(&arm), [format!("{number} err 7 hello")]);
    assert!(desk.frame(10.0).latencies.is_empty());
    let booted = &desk.take_events("boot")[0];
    assert_eq!((booted.int("boot"), booted.int("rst")), (boot + 1, 2), "the next boot, by the reset pin");
}

#[test]
fn every_start_has_another_number() {
    let mut desk = Desk::booted();
    let mut boots = vec![desk.take_events("boot")[0].int("boot")];
    for _ in 0..70 {
        desk.sim.command("reset");
        desk.wait_ms(150.0);
        boots.push(desk.take_events("boot")[0].int("boot"));
    }
    assert_eq!(boots, (1..=71).collect::<Vec<_>>());
}

#[test]
fn silence_and_time_to_live_close_the_gate() {
    let mut desk = Desk::greeted();
    desk.ok("arm tag=1 ttl=60000");
    for _ in 0..4 {
        desk.wait_ms(1400.0);
        desk.ok("ping");
    }
    assert!(desk.take_events("disarm").is_empty());
    desk.wait_ms(1600.0);
    assert_eq!(desk.take_events("disarm")[0].word("why"), "silence");
    assert!(desk.frame(10.0).latencies.is_empty());
    desk.ok("arm tag=2 ttl=200");
    desk.wait_ms(210.0);
    assert_eq!(desk.take_events("disarm")[0].word("why"), "ttl");
    assert!(desk.frame(10.0).latencies.is_empty());
}

#[test]
fn disarm_hello_and_silence_cancel_a_delayed_fire() {
    let mut desk = Desk::greeted();
    for cancel in ["disarm", "hello v=1 strict=1"] {
        desk.ok("fire d=200000 tag=3");
        desk.wait_ms(50.0);
        desk.ok(cancel);
        desk.wait_ms(500.0);
    }
    desk.ok("fire d=5000000 tag=3");
    desk.wait_ms(8000.0);
    assert_eq!(desk.take_events("disarm")[0].word("why"), "silence");
    assert_eq!(desk.rises(), 0);
    desk.ok("fire d=200000 tag=4");
    desk.wait_ms(300.0);
    assert_eq!(desk.rises(), 1, "one that nobody cancels comes");
    assert_eq!(desk.take_events("shot")[0].int("tag"), 4);
}

#[test]
fn a_fire_that_a_stuck_contact_holds_up_does_not_come_when_it_opens() {
    let mut desk = Desk::greeted();
    desk.ok("fire d=200000 tag=3");
    desk.sim.command("contact 100000=1 3000000=0");
    desk.wait_ms(300.0);
    assert_eq!(desk.take_events("disarm")[0].word("why"), "late");
    for _ in 0..8 {
        desk.wait_ms(400.0);
        desk.ok("ping");
    }
    assert_eq!((desk.rises(), desk.ok("stat").int("closed")), (0, 0));
    assert_eq!(desk.take_events("stuck").len(), 1);
    // Held up by a bounce's time alone, it comes, late by less than 50 ms.
    desk.take_reports();
    desk.ok("fire d=20000 tag=4");
    desk.contact("10000=1 15000=0");
    desk.wait_ms(60.0);
    let shots = desk.take_events("shot");
    let triggers: Vec<_> = shots.iter().rev().take(2).map(|shot| (shot.int("g"), shot.int("tag"))).collect();
    assert_eq!(triggers, [(1, 4), (0, 0)]);
    assert!(
        (15_000..25_000)
            .contains(&(shots[shots.len() - 1].int("t") - shots[shots.len() - 2].int("t") - 10_000))
    );
}

#[test]
fn a_fire_asks_the_ready_output_again_when_its_moment_comes() {
    let mut desk = Desk::greeted();
    desk.ok("cfg rdy=1");
    desk.sim.command("ready 1");
    desk.ok("fire d=100000 tag=3");
    desk.sim.command("ready 0");
    desk.wait_ms(170.0);
    assert_eq!(desk.take_events("disarm")[0].word("why"), "late");
    desk.sim.command("ready 1");
    desk.wait_ms(300.0);
    assert_eq!(desk.rises(), 0);
    desk.ok("fire d=100000 tag=4");
    desk.wait_ms(150.0);
    assert_eq!(desk.rises(), 1);
}

#[test]
fn a_recycling_flash_is_neither_armed_nor_fired() {
    let mut desk = Desk::greeted();
    desk.ok("cfg rec=500");
    desk.lit_frame(1, 10.0);
    desk.take_events("ready");
    assert_eq!((desk.refused("arm tag=2 ttl=1000"), desk.refused("fire")), (10, 10));
    let wait = desk.ok("stat").int("wait");
    assert!((400..=445).contains(&wait), "{wait} ms");
    desk.wait_ms(wait as f64 - 15.0);
    assert_eq!(desk.refused("arm tag=2 ttl=1000"), 10);
    assert!(desk.take_events("ready").is_empty());
    desk.wait_ms(20.0);
    assert_eq!(desk.take_events("ready").len(), 1);
    assert_eq!(desk.lit_frame(2, 10.0).latencies.len(), 1);
}

#[test]
fn a_wired_ready_output_is_waited_for() {
    let mut desk = Desk::greeted();
    desk.ok("cfg rdy=1");
    desk.sim.command("ready 0");
    desk.wait_ms(5.0);
    assert_eq!((desk.refused("arm tag=2 ttl=1000"), desk.refused("fire")), (10, 10));
    desk.sim.command("ready 1");
    assert_eq!(desk.lit_frame(1, 10.0).latencies.len(), 1);
    desk.take_events("ready");
    desk.sim.command("ready 0");
    desk.ok("cfg rdy=0");
    assert_eq!(desk.lit_frame(2, 10.0).latencies.len(), 1, "not asked when it is not wired");
}

#[test]
fn the_pulse_keeps_its_length_whatever_the_board_is_busy_with() {
    let mut desk = Desk::greeted();
    let mut worst = (f64::MAX, 0.0f64);
    for (pulse, step) in [(10.0, 0), (1000.0, 1), (1000.0, 2), (5000.0, 3), (20_000.0, 4)] {
        desk.ok(&format!("cfg pulse={pulse} lock=21 win=20000"));
        desk.ok("arm tag=1 ttl=5000");
        for _ in 0..10 {
            let request = desk.numbered("stat");
            desk.sim.command(&format!("say {request}"));
        }
        let reports = desk.contact(&format!("{}=1 {}=0", 500 * step, 30_000 + 500 * step));
        let level = |high: bool| {
            let at = reports.iter().find_map(|r| match r {
                Report::Trigger { cycle, high: h } if *h == high => Some(*cycle),
                _ => None,
            });
            at.unwrap() as f64 / MHZ
        };
        let length = level(false) - level(true);
        println!("pulse of {pulse} us: {length:.1} us");
        worst = (worst.0.min(length - pulse), worst.1.max(length - pulse));
        desk.wait_ms(200.0);
        desk.raw("");
    }
    assert!(worst.0 > -2.0 && worst.1 < 60.0, "{worst:?}");
}

#[test]
fn the_watchdog_resets_a_board_that_hangs_while_armed() {
    let mut desk = Desk::greeted();
    let symbols = Command::new("avr-nm").arg(&built().elf).output().unwrap().stdout;
    let symbols = String::from_utf8(symbols).unwrap();
    let poll = symbols.lines().find(|line| line.ends_with(" T core_poll")).expect("core_poll is linked");
    let poll = &poll[..8];
    desk.ok("arm tag=1 ttl=60000");
    desk.take_reports();
    // `rjmp .-2` where the main loop comes by: it never leaves.
    let word = desk.sim.command(&format!("flash {poll} cfff"));
    let hung_at: u64 = desk.sim.command("run 1").parse().unwrap();
    desk.wait_ms(400.0);
    let reports = desk.take_reports();
    let reset =
        reports.iter().find_map(|r| if let Report::Reset { cycle } = r { Some(*cycle) } else { None });
    let after = (reset.expect("a reset") - hung_at) as f64 / MHZ / 1000.0;
    println!("hung while armed: reset after {after:.0} ms");
    assert!(after < 300.0);
    // Mended, the next bite of the watchdog starts a board that has forgotten that it was armed.
    desk.sim.command(&format!("flash {poll} {word}"));
    desk.wait_ms(600.0);
    assert_eq!(desk.frame(10.0).latencies.len(), 0);
    let boot = desk.take_events("boot").pop().expect("it boots");
    assert_eq!(boot.int("rst") & 8, 8, "by the watchdog");
    assert_eq!(desk.refused("arm tag=1 ttl=1000"), 7);
    desk.ok("hello v=1 strict=1");
    assert_eq!(desk.lit_frame(1, 10.0).latencies.len(), 1);
}

#[test]
fn a_board_that_hangs_with_the_trigger_up_lets_it_fall_in_time() {
    let mut desk = Desk::greeted();
    let symbols = Command::new("avr-nm").arg(&built().elf).output().unwrap().stdout;
    let symbols = String::from_utf8(symbols).unwrap();
    let poll = symbols.lines().find(|line| line.ends_with(" T core_poll")).unwrap()[..8].to_owned();
    desk.ok("arm tag=1 ttl=60000");
    desk.sim.command(&format!("flash {poll} cfff"));
    desk.wait_ms(5.0);
    let reports = desk.contact("0=1 10000=0 20000=1 30000=0");
    let edges: Vec<(u64, bool)> = reports
        .iter()
        .filter_map(|r| if let Report::Trigger { cycle, high } = r { Some((*cycle, *high)) } else { None })
        .collect();
    assert_eq!(edges.len(), 2, "up once, down once: {edges:?}");
    let length = (edges[1].0 - edges[0].0) as f64 / MHZ;
    assert!((1000.0..1050.0).contains(&length), "{length} us");
}

#[test]
fn a_host_that_does_not_wait_gets_whole_lines_or_none() {
    let mut desk = Desk::greeted();
    for _ in 0..100 {
        let request = desk.numbered("stat");
        desk.sim.command(&format!("say {request}"));
    }
    desk.sim.command("contact 0=1 10000=0");
    // Every line's checksum is proved as it comes in.
    desk.wait_ms(1000.0);
    let answered = desk.take_answers().len();
    println!("100 requests in one go: {answered} answered, the others left out whole");
    assert!((10..100).contains(&answered), "{answered}");
    desk.raw(""); // ends the line of which the middle was lost
    let (events, shots) = (desk.events.len() as i64, desk.take_events("shot").len());
    let ping = desk.ok("ping");
    println!("{shots} of {} shots told", ping.int("n"));
    assert_eq!(ping.int("n"), 1);
    assert!(ping.int("ev") >= events, "a lost event shows in their number");
    assert_eq!(desk.ok("get n=1").int("g"), 0, "what was not told can be fetched");
}

#[test]
fn a_storm_of_syncs_costs_events_but_no_answers() {
    let mut desk = Desk::greeted();
    desk.ok("cfg lock=1 win=200");
    let storm: String = (0..150).map(|i| format!("{}=1 {}=0 ", i * 3000, i * 3000 + 500)).collect();
    desk.sim.command(&format!("contact {}", storm.trim_end()));
    for _ in 0..10 {
        desk.wait_ms(30.0);
        desk.ok("ping"); // as long as a host waits, 300 ms
    }
    desk.wait_ms(400.0);
    // A lock ends in the main loop, so a busy board takes the odd sync for a bounce of the one before.
    let shots = desk.ok("ping").int("n");
    let told = desk.take_events("shot").len();
    println!("150 syncs 3 ms apart: {shots} shots, {told} told at once, the others left out whole");
    assert!((140..=150).contains(&shots) && (10..140).contains(&told), "{shots} {told}");
    for n in shots - 15..=shots {
        assert_eq!(desk.ok(&format!("get n={n}")).int("n"), n);
    }
}

#[test]
fn noise_on_the_line_opens_nothing_and_counts_as_silence() {
    let mut desk = Desk::greeted();
    desk.ok("arm tag=1 ttl=60000");
    for round in 0..20u32 {
        let noise: String = (0..90).map(|i| format!("\\x{:02x}", (i * 37 + round * 101) % 256)).collect();
        desk.raw(&noise);
        desk.wait_ms(100.0);
    }
    assert_eq!(desk.take_events("disarm")[0].word("why"), "silence");
    assert!(desk.frame(10.0).latencies.is_empty());
    desk.raw("");
    desk.ok("ping");
}
