//! The only caller of file decoders and encoders.

pub mod dng;
pub mod exif;
pub mod jpeg;
pub mod raw;
