//! The program itself: its size, its stack, the instructions that the gate rests on, and the hex that is packed.

use crate::avr::{Desk, Sim, built, firmware};
use std::process::Command;

/// Memories of the ATmega328P, bytes.
const FLASH: usize = 32_768;
const RAM: usize = 2048;

fn section_sizes() -> impl Fn(&str) -> usize {
    let said = Command::new("avr-size").arg("-A").arg(&built().elf).output().unwrap().stdout;
    let said = String::from_utf8(said).unwrap();
    move |name| {
        let row = said.lines().find(|line| line.split_whitespace().next() == Some(name));
        row.map_or(0, |row| row.split_whitespace().nth(1).unwrap().parse().unwrap())
    }
}

#[test]
fn program_and_data_leave_room() {
    let size = section_sizes();
    let flash = size(".text") + size(".data");
    let ram = size(".data") + size(".bss") + size(".noinit");
    let share = |used: usize, of: usize| 100.0 * used as f64 / of as f64;
    println!("flash {flash} of {FLASH} bytes ({:.1} %)", share(flash, FLASH));
    println!("RAM {ram} of {RAM} bytes ({:.1} %)", share(ram, RAM));
    assert!(share(flash, FLASH) < 60.0);
    assert!(share(ram, RAM) < 85.0);
}

#[test]
fn the_stack_stays_clear_of_the_data() {
    let mut desk = Desk::greeted();
    for tag in 1..=20 {
        desk.lit_frame(tag, 100.0);
        desk.ok(&format!("get n={tag}"));
        desk.ok("cfg sil=1500 pulse=1000 lock=30 win=20000 rec=20 rdy=0");
        desk.raw("nonsense *1");
    }
    // Bytes come in while a shot is reported and light is gathered: the interrupts nest deepest then.
    desk.sim.command("contact 0=1 5000=0 34000=1 40000=0");
    for _ in 0..60 {
        let ping = desk.numbered("ping");
        desk.sim.command(&format!("say {ping}"));
    }
    desk.sim.run_us(400_000.0);
    let free: usize = desk.sim.command("stack").parse().unwrap();
    let size = section_sizes();
    let room = RAM - size(".data") - size(".bss") - size(".noinit");
    println!("stack {} of {room} bytes at its deepest, {free} never used", room - free);
    assert!(free >= 150, "{free} bytes between stack and data");
}

/// The program that is packed into `unlit` is what the sources give, if the compiler is the one that made it.
#[test]
fn the_packed_program_is_what_its_sources_give() {
    let packed = std::fs::read(firmware().join("avr/unlit-uno.hex")).unwrap();
    let recorded = std::fs::read_to_string(firmware().join("avr/unlit-uno.compiler")).unwrap();
    let here = Command::new("avr-gcc").arg("--version").output().unwrap().stdout;
    let here = String::from_utf8(here).unwrap();
    let here = here.lines().next().unwrap();
    if here != recorded.trim_end() {
        println!("NOT COMPARED: unlit-uno.hex was made by {}; here is {here}", recorded.trim_end());
        return;
    }
    assert!(
        std::fs::read(&built().hex).unwrap() == packed,
        "firmware/avr/unlit-uno.hex is not what its sources give: run make -C firmware/avr package, and commit it"
    );
}

/// With whatever compiler is here: what is shipped is what takes these.
#[test]
fn the_packed_program_keeps_a_dark_frame_dark_and_lights_a_lit_one() {
    let mut desk = Desk::on(Sim::with(&[&firmware().join("avr/unlit-uno.hex")]));
    desk.greet();
    let dark = desk.frame(100.0);
    let shot = |key| dark.shot.int(key);
    assert_eq!((dark.latencies.len(), shot("g"), shot("tag"), shot("w")), (0, 0, 0, 0));
    let lit = desk.lit_frame(7, 100.0);
    let shot = |key| lit.shot.int(key);
    assert_eq!((lit.latencies.len(), lit.energy, shot("g"), shot("tag")), (1, 1.0, 1, 7));
    assert!(shot("w") > 400 && lit.latencies[0] <= 40, "{lit:?}");
}

/// Registers of bits that both the main loop and an interrupt change, by their I/O address.
const GPIOR0: u8 = 0x1E;
const PORTD: u8 = 0x0B;

/// The instructions of a disassembly that touch an I/O register, without what follows their operands.
fn touching(disassembly: &str, register: u8) -> Vec<String> {
    let (io, memory) = (format!("0x{register:02x}"), format!("0x{:04X}", register + 0x20));
    let mut found = Vec::new();
    for line in disassembly.lines() {
        let Some(instruction) = line.split('\t').nth(2) else { continue };
        let operands =
            line.split('\t').nth(3).unwrap_or_default().split(';').next().unwrap_or_default().trim();
        let operand = |name: &str| operands.split(", ").any(|o| o.eq_ignore_ascii_case(name));
        let touches = match instruction.trim() {
            "sbi" | "cbi" | "sbis" | "sbic" | "in" | "out" => operand(&io),
            "lds" | "sts" => operand(&memory),
            _ => false,
        };
        if touches {
            found.push(format!("{} {operands}", instruction.trim()));
        }
    }
    found
}

/// Those that write the whole register.
fn whole_writes(found: &[String]) -> Vec<&String> {
    found.iter().filter(|i| i.starts_with("out ") || i.starts_with("sts ")).collect()
}

/// An interrupt between the reading of a whole register and its writing back would be undone: a gate that a sync has
/// closed would be open again.
#[test]
fn gate_and_trigger_are_changed_bit_by_bit_with_single_instructions() {
    let said = Command::new("avr-objdump").arg("-d").arg(&built().elf).output().unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    let said = String::from_utf8(said.stdout).unwrap();
    for (name, register, needed) in [
        (
            "GPIOR0",
            GPIOR0,
            ["sbi 0x1e, 0", "cbi 0x1e, 0", "sbi 0x1e, 1", "cbi 0x1e, 1", "sbi 0x1e, 2", "cbi 0x1e, 2"]
                .as_slice(),
        ),
        ("PORTD", PORTD, ["sbi 0x0b, 4", "cbi 0x0b, 4"].as_slice()),
    ] {
        let found = touching(&said, register);
        println!("{name}: {}", found.join("; "));
        assert_eq!(whole_writes(&found).len(), 1, "{name} is written whole by start() alone: {found:?}");
        // Bits that are changed in some other way, through a pointer say, would be missing here.
        for instruction in needed {
            assert!(found.iter().any(|i| i == instruction), "{name} without {instruction}");
        }
    }
    // One closes the gate in the sync's interrupt, one in the main loop.
    assert_eq!(touching(&said, GPIOR0).iter().filter(|i| *i == "cbi 0x1e, 0").count(), 2);
}

#[test]
fn a_register_that_is_read_and_written_back_is_found() {
    let by_io = " 1d4:\t8e b3       \tin\tr24, 0x1e\t; 30\n 1d6:\t8e 7f       \tandi\tr24, 0xFE\t; 254\n \
                 1d8:\t8e bb       \tout\t0x1e, r24\t; 30\n";
    assert_eq!(whole_writes(&touching(by_io, GPIOR0)), ["out 0x1e, r24"]);
    let by_memory =
        " 1d4:\t80 91 3e 00 \tlds\tr24, 0x003E\t; 0x80003e\n 1da:\t80 93 3e 00 \tsts\t0x003E, r24\n";
    assert_eq!(whole_writes(&touching(by_memory, GPIOR0)), ["sts 0x003E, r24"]);
    let bit = " 200:\tf0 98       \tcbi\t0x1e, 0\t; 30\n";
    assert_eq!(touching(bit, GPIOR0), ["cbi 0x1e, 0"]);
    assert!(whole_writes(&touching(bit, GPIOR0)).is_empty());
}
