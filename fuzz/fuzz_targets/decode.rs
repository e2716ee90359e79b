//! Whatever the bytes, decoding them in this process neither panics nor asks for more than the limit given.
//!
//! The second decoder runs in a process of its own and is left out: without its program, files for it are refused.

#![no_main]

use libfuzzer_sys::fuzz_target;
use unlit::codec::{exif, raw};

fuzz_target!(|bytes: &[u8]| {
    let _ = exif::settings(bytes);
    if let Ok(photo) = raw::decode(bytes, "fuzzed") {
        assert!(photo.mosaic.dn.pixels().len() <= bytes.len() * 8);
    }
});
