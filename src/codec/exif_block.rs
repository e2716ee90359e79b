//! EXIF of a developed picture: camera, lens and exposure as its raw told them.

use super::dng::write_exif;
use crate::pair::Settings;
use std::io::{Cursor, Seek, Write};
use tiff::encoder::{DirectoryEncoder, TiffEncoder, TiffKindStandard};
use tiff::tags::Tag;

/// The block that a JPEG carries: a TIFF file without a picture.
pub(super) fn encode(settings: &Settings) -> tiff::TiffResult<Vec<u8>> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file)?;
    let exif = write_exif(encoder.extra_directory()?, settings)?;
    let mut directory = encoder.image_directory()?;
    write_camera(&mut directory, settings, exif)?;
    directory.finish()?;
    Ok(file.into_inner())
}

/// What stands in a picture's own directory: the camera, and where its EXIF lies.
pub(super) fn write_camera<W: Write + Seek>(
    directory: &mut DirectoryEncoder<'_, W, TiffKindStandard>,
    settings: &Settings,
    exif: u32,
) -> tiff::TiffResult<()> {
    for (tag, text) in [(Tag::Make, &settings.make), (Tag::Model, &settings.model)] {
        if let Some(text) = text {
            directory.write_tag(tag, text.as_str())?;
        }
    }
    // Rows as the sensor gave them, whichever way the camera was held: so the scene's cameras have them.
    directory.write_tag(Tag::Orientation, 1u16)?;
    directory.write_tag(Tag::Unknown(34665), exif)
}
