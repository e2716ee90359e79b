//! libgphoto2's own log. Its error codes often say no more than "unspecified error"; why the camera would not
//! (no focus, mirror up, card full) stands in the log alone.

use gphoto2::libgphoto2_sys::{GPLogLevel, gp_log_add_func};
use std::ffi::{CStr, c_char, c_void};
use std::sync::{Mutex, Once, PoisonError};

/// Lines kept between two calls of [`take`]; the first ones tell most.
const LINES: usize = 4;

static ERRORS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// From now on, collects what the library logs as errors.
pub(super) fn listen() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: `collect` has the type that the library calls, needs no data, and lives as long as the program.
        #[allow(unsafe_code)]
        let id = unsafe { gp_log_add_func(GPLogLevel::GP_LOG_ERROR, Some(collect), std::ptr::null_mut()) };
        tracing::trace!("libgphoto2 log listener {id}");
    });
}

/// The errors logged since the last call, in one line; empty when there were none.
pub(super) fn take() -> String {
    let mut lines = std::mem::take(&mut *ERRORS.lock().unwrap_or_else(PoisonError::into_inner));
    lines.dedup();
    lines.join("; ")
}

#[allow(unsafe_code)]
unsafe extern "C" fn collect(_: GPLogLevel, _: *const c_char, line: *const c_char, _: *mut c_void) {
    if line.is_null() {
        return;
    }
    // SAFETY: the library passes a string that ends with a zero and outlives this call.
    let line = unsafe { CStr::from_ptr(line) }.to_string_lossy().trim().to_owned();
    let mut lines = ERRORS.lock().unwrap_or_else(PoisonError::into_inner);
    if lines.len() < LINES {
        lines.push(line);
    }
}
