//! The only caller of file decoders and encoders.

pub mod apriltag;
pub mod asset;
mod canon;
pub mod cr2;
pub mod dng;
pub mod exif;
mod exif_block;
pub mod exr_half;
pub mod exr_image;
pub mod icc;
pub mod jpeg;
mod ljpeg;
pub mod markup;
pub mod obj;
pub mod png;
pub mod raw;
pub mod tiff16;
pub mod usd;
pub mod xmp;
