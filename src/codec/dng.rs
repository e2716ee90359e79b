//! Writing a 16-bit CFA DNG (DNG 1.4) that rawloader, dcraw, LibRaw and ExifTool read.
//!
//! Takes a mosaic and settings, gives the file's bytes: sensor data uncompressed in one strip of IFD0,
//! levels as tags, EXIF beside it. The colour matrix says that camera RGB is linear sRGB under D65 with a
//! neutral white balance: a preview's colours, nothing that the sensor values depend on.

use crate::pair::Settings;
use crate::photometry::Mosaic;
use crate::raster::Image;
use std::io::{Cursor, Seek, Write};
use tiff::encoder::{DirectoryEncoder, Rational, SRational, TiffEncoder, TiffKindStandard, TiffValue};
use tiff::tags::{Tag, Type};

/// What a DNG is made from.
#[derive(Clone, Copy, Debug)]
pub struct DngContent<'a> {
    /// Sensor values of the active area, even in width and height. `saturation` must be one value for all
    /// positions, since the format has but one white level.
    pub mosaic: &'a Mosaic,
    /// Settings; `make` and `model` must be known, the rest is written where it is.
    pub settings: &'a Settings,
    /// Masked columns to the left of the active area: as high as it is, even in width.
    pub masked_left: Option<&'a Image<u16>>,
}

/// Why no DNG could be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DngError {
    /// Size that does not fit the 2x2 array or the masked border.
    #[error(
        "a DNG needs an even, non-empty frame and a masked border of the same height and even width; got {frame:?} and {masked:?}"
    )]
    Size {
        /// Width and height of the active area.
        frame: (usize, usize),
        /// Width and height of the masked border.
        masked: Option<(usize, usize)>,
    },
    /// Levels that the format cannot hold.
    #[error(
        "a DNG holds one whole white level from 1 to 65535 and black levels from 0 up; got saturation {saturation:?}, black {black:?}"
    )]
    Levels {
        /// Saturation of the mosaic.
        saturation: [[f32; 2]; 2],
        /// Black of the mosaic.
        black: [[f32; 2]; 2],
    },
    /// Readers refuse a DNG without maker and model.
    #[error("a DNG needs the camera's make and model, but the settings do not tell them; fill in both")]
    NoCamera,
    /// The encoder library failed, or the file would pass 4 GiB.
    #[error("the DNG could not be encoded: {0}")]
    Encoder(#[from] tiff::TiffError),
}

type Directory<'a, 'b> = DirectoryEncoder<'a, &'b mut Cursor<Vec<u8>>, TiffKindStandard>;

/// Encodes a DNG.
pub fn encode(content: &DngContent) -> Result<Vec<u8>, DngError> {
    let &DngContent { mosaic, settings, masked_left } = content;
    let (width, height) = (mosaic.dn.width(), mosaic.dn.height());
    let masked_size = masked_left.map(|m| (m.width(), m.height()));
    let border = masked_size.map_or(0, |(w, _)| w);
    let fits = masked_size.is_none_or(|(w, h)| w > 0 && w % 2 == 0 && h == height);
    if width == 0 || height == 0 || width % 2 != 0 || height % 2 != 0 || !fits {
        return Err(DngError::Size { frame: (width, height), masked: masked_size });
    }
    let white = one_white(mosaic)?;
    let (Some(make), Some(model)) = (&settings.make, &settings.model) else {
        return Err(DngError::NoCamera);
    };

    let full_width = border + width;
    let mut file = Cursor::new(Vec::with_capacity(full_width * height * 2 + 4096));
    let mut encoder = TiffEncoder::new(&mut file)?;
    let exif = write_exif(encoder.extra_directory()?, settings)?;

    let mut ifd = encoder.image_directory()?;
    let strip = match masked_left {
        None => ifd.write_data(mosaic.dn.pixels())?,
        Some(masked) => {
            let rows = masked.pixels().chunks_exact(border).zip(mosaic.dn.pixels().chunks_exact(width));
            let joined: Vec<u16> = rows.flat_map(|(dark, lit)| dark.iter().chain(lit).copied()).collect();
            ifd.write_data(joined.as_slice())?
        }
    };
    let full = [full_width as u32, height as u32];
    ifd.write_tag(Tag::NewSubfileType, 0u32)?;
    ifd.write_tag(Tag::ImageWidth, full[0])?;
    ifd.write_tag(Tag::ImageLength, full[1])?;
    ifd.write_tag(Tag::BitsPerSample, 16u16)?;
    ifd.write_tag(Tag::Compression, 1u16)?;
    ifd.write_tag(Tag::PhotometricInterpretation, 32803u16)?;
    ifd.write_tag(Tag::Make, make.as_str())?;
    ifd.write_tag(Tag::Model, model.as_str())?;
    ifd.write_tag(Tag::StripOffsets, strip as u32)?;
    ifd.write_tag(Tag::Orientation, 1u16)?;
    ifd.write_tag(Tag::SamplesPerPixel, 1u16)?;
    ifd.write_tag(Tag::RowsPerStrip, full[1])?;
    ifd.write_tag(Tag::StripByteCounts, full[0] * full[1] * 2)?;
    ifd.write_tag(Tag::PlanarConfiguration, 1u16)?;
    ifd.write_tag(Tag::Software, concat!("unlit ", env!("CARGO_PKG_VERSION")))?;
    ifd.write_tag(Tag::Unknown(33421), [2u16, 2].as_slice())?;
    ifd.write_tag(Tag::Unknown(33422), mosaic.cfa.0.concat().as_slice())?;
    ifd.write_tag(Tag::Unknown(34665), exif)?;
    ifd.write_tag(Tag::Unknown(50706), [1u8, 4, 0, 0].as_slice())?;
    ifd.write_tag(Tag::Unknown(50707), [1u8, 3, 0, 0].as_slice())?;
    ifd.write_tag(Tag::Unknown(50708), format!("{make} {model}").as_str())?;
    ifd.write_tag(Tag::Unknown(50710), [0u8, 1, 2].as_slice())?;
    ifd.write_tag(Tag::Unknown(50711), 1u16)?;
    write_black(&mut ifd, mosaic)?;
    ifd.write_tag(Tag::Unknown(50717), u32::from(white))?;
    let matrix = XYZ_TO_LINEAR_SRGB.map(|n| SRational { n, d: 10_000 });
    ifd.write_tag(Tag::Unknown(50721), matrix.as_slice())?;
    ifd.write_tag(Tag::Unknown(50728), [1, 1, 1].map(|n| Rational { n, d: 1 }).as_slice())?;
    ifd.write_tag(Tag::Unknown(50778), 21u16)?;
    ifd.write_tag(Tag::Unknown(50829), [0, border as u32, full[1], full[0]].as_slice())?;
    if border > 0 {
        ifd.write_tag(Tag::Unknown(50830), [0, 0, full[1], border as u32].as_slice())?;
    }
    ifd.finish()?;
    Ok(file.into_inner())
}

/// Ten-thousandths of the matrix from CIE XYZ (D65) to linear sRGB, IEC 61966-2-1.
const XYZ_TO_LINEAR_SRGB: [i32; 9] = [32405, -15371, -4985, -9693, 18760, 416, 556, -2040, 10572];

fn one_white(mosaic: &Mosaic) -> Result<u16, DngError> {
    let levels = mosaic.levels;
    let white = levels.saturation[0][0];
    let whole = white.fract() == 0.0 && (1.0..=65535.0).contains(&white);
    let same = levels.saturation.concat().into_iter().all(|v| v == white);
    let blacks = levels.black.concat().into_iter().all(|v| v >= 0.0 && v < white);
    if whole && same && blacks {
        Ok(white as u16)
    } else {
        Err(DngError::Levels { saturation: levels.saturation, black: levels.black })
    }
}

/// One black level where all four are the same, else four; whole numbers where they are.
fn write_black(ifd: &mut Directory, mosaic: &Mosaic) -> Result<(), DngError> {
    let levels = mosaic.levels.black.concat();
    let same = levels.iter().all(|&v| v == levels[0]);
    let levels = if same { &levels[..1] } else { &levels[..] };
    let repeat: u16 = if same { 1 } else { 2 };
    ifd.write_tag(Tag::Unknown(50713), [repeat, repeat].as_slice())?;
    if levels.iter().all(|v| v.fract() == 0.0) {
        let whole: Vec<u32> = levels.iter().map(|&v| v as u32).collect();
        ifd.write_tag(Tag::Unknown(50714), whole.as_slice())?;
    } else {
        let exact: Vec<Rational> = levels.iter().map(|&v| rational(f64::from(v))).collect();
        ifd.write_tag(Tag::Unknown(50714), exact.as_slice())?;
    }
    Ok(())
}

/// The EXIF directory of these settings; gives where it lies.
pub(super) fn write_exif<W: Write + Seek>(
    mut ifd: DirectoryEncoder<'_, W, TiffKindStandard>,
    settings: &Settings,
) -> tiff::TiffResult<u32> {
    fn put<W: Write + Seek, T: TiffValue>(
        ifd: &mut DirectoryEncoder<'_, W, TiffKindStandard>,
        tag: u16,
        value: Option<T>,
    ) -> tiff::TiffResult<()> {
        value.map_or(Ok(()), |value| ifd.write_tag(Tag::Unknown(tag), value))
    }
    put(&mut ifd, 33434, settings.shutter.map(|t| rational(t.0)))?;
    put(&mut ifd, 33437, settings.aperture.map(|n| rational(n.0)))?;
    let program = settings.exposure_program.as_deref();
    put(&mut ifd, 34850, program.and_then(super::exif::program_number))?;
    if let Some(iso) = settings.iso {
        let fits = iso.0 < 65535.0;
        put(&mut ifd, 34855, Some(if fits { iso.0.round() as u16 } else { u16::MAX }))?;
        put(&mut ifd, 34866, (!fits).then_some(iso.0.round() as u32))?;
    }
    let version = ifd.write_entry_bytes(Type::UNDEFINED, b"0232")?;
    ifd.extend_from(&[(Tag::Unknown(36864), version)].into_iter().collect());
    put(&mut ifd, 36867, settings.taken_at.as_deref().map(exif_date).as_deref())?;
    put(&mut ifd, 37386, settings.focal_length_mm.map(rational))?;
    put(&mut ifd, 41987, settings.white_balance.as_deref().and_then(super::exif::white_balance_number))?;
    put(&mut ifd, 42033, settings.serial.as_deref())?;
    put(&mut ifd, 42036, settings.lens.as_deref())?;
    Ok(ifd.finish_with_offsets()?.offset)
}

/// A fraction as a camera would write it: 1/n for reciprocals of whole numbers, else millionths reduced to
/// what 32 bits hold.
pub(super) fn rational(value: f64) -> Rational {
    let reciprocal = 1.0 / value;
    if value < 1.0 && (reciprocal - reciprocal.round()).abs() < 1e-6 * reciprocal {
        return Rational { n: 1, d: reciprocal.round() as u32 };
    }
    let d = [1u32, 10, 100, 1000, 10_000, 100_000, 1_000_000];
    let exact = |&d: &u32| {
        let scaled = value * f64::from(d);
        (scaled - scaled.round()).abs() < 1e-6 || scaled * 10.0 > f64::from(u32::MAX)
    };
    let d = d.into_iter().find(exact).unwrap_or(1_000_000);
    Rational { n: (value * f64::from(d)).round() as u32, d }
}

/// `YYYY-MM-DDTHH:MM:SS` as EXIF writes it.
pub(super) fn exif_date(iso: &str) -> String {
    let (date, time) = iso.split_once('T').unwrap_or((iso, "00:00:00"));
    format!("{} {time}", date.replace('-', ":"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::raw;
    use crate::photometry::{Cfa, LevelSource, Levels};
    use crate::units::{FNumber, Iso, Seconds};

    fn mosaic(black: [[f32; 2]; 2]) -> Mosaic {
        Mosaic {
            dn: Image::from_fn(64, 48, |x, y| (2000 + 131 * x + 17 * y) as u16),
            cfa: Cfa([[1, 2], [0, 1]]),
            levels: Levels {
                black,
                saturation: [[15380.0; 2]; 2],
                black_source: LevelSource::FileTag,
                saturation_source: LevelSource::FileTag,
            },
        }
    }

    fn settings() -> Settings {
        Settings {
            make: Some("Simulated".into()),
            model: Some("Bayer 14".into()),
            serial: Some("SIM0001".into()),
            lens: Some("45 mm".into()),
            shutter: Some(Seconds(1.0 / 125.0)),
            aperture: Some(FNumber(11.0)),
            iso: Some(Iso(100.0)),
            focal_length_mm: Some(45.5),
            exposure_program: Some("Manual".into()),
            white_balance: Some("Manual".into()),
            taken_at: Some("2026-05-04T10:00:04".into()),
            ..Settings::default()
        }
    }

    #[test]
    fn what_is_written_is_read_back_site_by_site_with_its_settings() {
        for black in [[[2048.0; 2]; 2], [[2047.0, 2048.0], [2046.0, 2049.0]], [[2048.25; 2]; 2]] {
            let (mosaic, settings) = (mosaic(black), settings());
            let content = DngContent { mosaic: &mosaic, settings: &settings, masked_left: None };
            let photo = raw::decode(&encode(&content).unwrap(), "made.dng").unwrap();
            assert_eq!(photo.mosaic, mosaic);
            assert_eq!(photo.settings, settings);
            assert_eq!(photo.masked, None);
        }
    }

    #[test]
    fn a_masked_border_gives_the_black_level() {
        let (mosaic, settings) = (mosaic([[2048.0; 2]; 2]), settings());
        let masked = Image::from_fn(32, 48, |x, y| (2040 + 2 * (x & 1) + 4 * (y & 1)) as u16);
        let content = DngContent { mosaic: &mosaic, settings: &settings, masked_left: Some(&masked) };
        let photo = raw::decode(&encode(&content).unwrap(), "made.dng").unwrap();
        assert_eq!(photo.mosaic.dn, mosaic.dn);
        assert_eq!(photo.mosaic.cfa, mosaic.cfa);
        assert_eq!(photo.mosaic.levels.black, [[2040.0, 2042.0], [2044.0, 2046.0]]);
        assert_eq!(photo.mosaic.levels.black_source, LevelSource::MaskedPixels);
    }

    #[test]
    fn settings_without_a_camera_are_refused() {
        let mosaic = mosaic([[2048.0; 2]; 2]);
        let content = DngContent { mosaic: &mosaic, settings: &Settings::default(), masked_left: None };
        assert!(matches!(encode(&content), Err(DngError::NoCamera)));
    }

    #[test]
    fn fractions_are_written_as_cameras_do() {
        let pair = |r: Rational| (r.n, r.d);
        assert_eq!(pair(rational(1.0 / 125.0)), (1, 125));
        assert_eq!(pair(rational(0.4)), (4, 10));
        assert_eq!(pair(rational(6.3)), (63, 10));
        assert_eq!(pair(rational(30.0)), (30, 1));
    }
}
