//! The firmware's C core behind a safe face. The only file of the studio with `unsafe` in it.
//!
//! Takes bytes, edges, light samples and the time; gives bytes and the trigger pin. `firmware/core/core.h`
//! is what the declarations below repeat.

use std::ffi::{c_char, c_void};
use std::pin::Pin;

/// `struct core_config`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(super) struct Config {
    /// Silence of the host after which the board goes safe, in ms.
    pub(super) sil_ms: u16,
    /// Length of the trigger pulse, in us.
    pub(super) pulse_us: u16,
    /// After an edge, further ones are bounce for so long, in ms.
    pub(super) lock_ms: u16,
    /// How long light is gathered after an edge, in us.
    pub(super) win_us: u16,
    /// Recycle time, in ms.
    pub(super) rec_ms: u16,
    /// 1 if the flash has a ready output.
    pub(super) rdy: u8,
}

impl Default for Config {
    fn default() -> Self {
        Self { sil_ms: 1500, pulse_us: 1000, lock_ms: 30, win_us: 20_000, rec_ms: 150, rdy: 0 }
    }
}

/// `struct core_hal`.
#[repr(C)]
struct Hal {
    ctx: *mut c_void,
    send: unsafe extern "C" fn(*mut c_void, *const c_char, u8, bool),
    trigger: unsafe extern "C" fn(*mut c_void, bool),
    gate: unsafe extern "C" fn(*mut c_void, bool),
    hold: unsafe extern "C" fn(*mut c_void, bool),
    adc: unsafe extern "C" fn(*mut c_void, u8) -> u16,
    sync_closed: unsafe extern "C" fn(*mut c_void) -> bool,
    charged: unsafe extern "C" fn(*mut c_void) -> bool,
    mcu: *const c_char,
    adc_channels: u8,
}

unsafe extern "C" {
    fn core_init(core: *mut c_void, hal: *const Hal, cfg: *const Config, boot: u16, rst: u8, now_us: u32);
    fn core_poll(core: *mut c_void, now_us: u32);
    fn core_rx(core: *mut c_void, byte: u8, now_us: u32);
    fn core_sync_edge(core: *mut c_void, now_us: u32, gated: bool);
    fn core_light_sample(core: *mut c_void, counts: u16);
    fn core_dark_sample(core: *mut c_void, counts: u16);
    fn core_size() -> usize;
}

/// The pins of the board, as the core sees and sets them.
#[derive(Debug, Default)]
pub(super) struct Pins {
    /// Bytes sent and not yet fetched.
    sent: Vec<u8>,
    /// The gate between the sync contact and the trigger.
    pub(super) gate_open: bool,
    /// Level of the trigger.
    trigger_high: bool,
    /// How often the trigger rose.
    rises: u32,
    /// What the ADC reads, in counts.
    pub(super) adc: u16,
    /// Level of the sync contact.
    pub(super) sync_closed: bool,
    /// Level of the flash's ready output.
    pub(super) charged: bool,
}

impl Pins {
    fn set_trigger(&mut self, high: bool) {
        self.rises += u32::from(high && !self.trigger_high);
        self.trigger_high = high;
    }
}

/// SAFETY of the callbacks: `ctx` is `Core::pins`, alive as long as the core, and the core calls them only
/// from inside a method that holds `&mut Core` and no reference to the pins.
unsafe extern "C" fn on_send(ctx: *mut c_void, line: *const c_char, length: u8, _event: bool) {
    // SAFETY: the core passes a buffer of its own that holds `length` bytes and lasts beyond this call.
    let line = unsafe { std::slice::from_raw_parts(line.cast::<u8>(), usize::from(length)) };
    unsafe { &mut *ctx.cast::<Pins>() }.sent.extend_from_slice(line);
}

unsafe extern "C" fn on_trigger(ctx: *mut c_void, high: bool) {
    unsafe { &mut *ctx.cast::<Pins>() }.set_trigger(high);
}

unsafe extern "C" fn on_gate(ctx: *mut c_void, open: bool) {
    unsafe { &mut *ctx.cast::<Pins>() }.gate_open = open;
}

/// Nothing interrupts the simulated board: it calls the core from one place at a time.
unsafe extern "C" fn on_hold(_ctx: *mut c_void, _on: bool) {}

unsafe extern "C" fn on_adc(ctx: *mut c_void, _channel: u8) -> u16 {
    unsafe { &*ctx.cast::<Pins>() }.adc
}

unsafe extern "C" fn on_sync_closed(ctx: *mut c_void) -> bool {
    unsafe { &*ctx.cast::<Pins>() }.sync_closed
}

unsafe extern "C" fn on_charged(ctx: *mut c_void) -> bool {
    unsafe { &*ctx.cast::<Pins>() }.charged
}

/// One controller. Times are in us, modulo 2^32.
pub(super) struct Core {
    /// `struct core`, in words so that it is aligned for pointers; not moved while the core lives.
    memory: Box<[u64]>,
    /// What the core keeps a pointer to.
    _hal: Pin<Box<Hal>>,
    /// Owned; a raw pointer, because the callbacks come back through it.
    pins: *mut Pins,
}

// SAFETY: all pointers lead to memory that this value alone owns, and nothing in the core knows threads.
unsafe impl Send for Core {}

impl Core {
    /// Starts a board; its boot event waits in [`Core::sent`].
    pub(super) fn new(config: Config, boot: u16, now_us: u32) -> Self {
        let pins = Box::into_raw(Box::new(Pins { charged: true, ..Pins::default() }));
        let hal = Box::pin(Hal {
            ctx: pins.cast(),
            send: on_send,
            trigger: on_trigger,
            gate: on_gate,
            hold: on_hold,
            adc: on_adc,
            sync_closed: on_sync_closed,
            charged: on_charged,
            mcu: c"native".as_ptr(),
            adc_channels: 1,
        });
        // SAFETY: takes nothing, returns a constant.
        let size = unsafe { core_size() };
        let mut memory = vec![0u64; size.div_ceil(size_of::<u64>())].into_boxed_slice();
        // SAFETY: memory holds core_size() bytes, aligned; hal is pinned and lives as long; config is copied.
        unsafe { core_init(memory.as_mut_ptr().cast(), &*hal, &config, boot, 1, now_us) };
        Self { memory, _hal: hal, pins }
    }

    fn pointer(&mut self) -> *mut c_void {
        self.memory.as_mut_ptr().cast()
    }

    /// Lets the core do what is due.
    pub(super) fn poll(&mut self, now_us: u32) {
        // SAFETY: initialised in `new`.
        unsafe { core_poll(self.pointer(), now_us) }
    }

    /// Bytes from the host.
    pub(super) fn receive(&mut self, bytes: &[u8], now_us: u32) {
        for byte in bytes {
            // SAFETY: initialised in `new`.
            unsafe { core_rx(self.pointer(), *byte, now_us) }
        }
    }

    /// The sync contact closes. True if the trigger was raised.
    pub(super) fn sync_edge(&mut self, now_us: u32) -> bool {
        let pins = self.pins();
        let gated = std::mem::take(&mut pins.gate_open);
        if gated {
            pins.set_trigger(true);
        }
        // SAFETY: initialised in `new`.
        unsafe { core_sync_edge(self.pointer(), now_us, gated) }
        gated
    }

    /// One photodiode sample in counts: of the window of a shot, if there is one, or of the darkness between.
    pub(super) fn light_sample(&mut self, counts: u16) {
        // SAFETY: initialised in `new`.
        unsafe {
            core_light_sample(self.pointer(), counts);
            core_dark_sample(self.pointer(), counts);
        }
    }

    /// The input pins.
    pub(super) fn pins(&mut self) -> &mut Pins {
        // SAFETY: owned by self; the core uses it only inside the methods above, which hold `&mut self`.
        unsafe { &mut *self.pins }
    }

    /// Bytes for the host since the last call.
    pub(super) fn sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.pins().sent)
    }

    /// How often the trigger rose so far.
    pub(super) fn rises(&mut self) -> u32 {
        self.pins().rises
    }

    /// Level of the trigger pin.
    #[cfg(test)]
    pub(super) fn trigger_high(&mut self) -> bool {
        self.pins().trigger_high
    }
}

impl Drop for Core {
    fn drop(&mut self) {
        // SAFETY: made by Box::into_raw in `new`, freed only here.
        drop(unsafe { Box::from_raw(self.pins) });
    }
}
