//! The only caller of file decoders and encoders.

pub mod asset;
pub mod exr_image;
pub mod obj;
pub mod png;
pub mod tiff16;
pub mod dng;
pub mod exif;
pub mod raw;
