//! TIFF: 16-bit RGB for reflectance (value * 65535) and 8-bit grey for masks. Sample files of other programs
//! may be 8 or 16 bits deep in strips or tiles, with any compression that the decoder knows.

use super::asset::{AssetError, MAX_PIXELS};
use super::dng::write_exif;
use super::exif_block::write_camera;
use crate::pair::Settings;
use crate::raster::{Image, Rgb};
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::encoder::{Compression, DeflateLevel, TiffEncoder, colortype};
use tiff::tags::{Tag, Type};

/// Reads RGB (or RGBA, whose fourth channel is left out) of 8 or 16 bits, scaled to 0..1 by the type's
/// largest value, or 32-bit float as it is.
pub fn read_rgb(path: &Path) -> Result<Rgb, AssetError> {
    let (width, height, colour, samples) = decode(path)?;
    let channels = match colour {
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        other => return Err(unsuitable(path, "an RGB picture", other)),
    };
    let gather = |value: &dyn Fn(usize) -> f32| {
        Image::from_fn(width, height, |x, y| [0, 1, 2].map(|c| value((y * width + x) * channels + c)))
    };
    let needed = width * height * channels;
    match &samples {
        DecodingResult::U8(v) if v.len() >= needed => Ok(gather(&|i| f32::from(v[i]) / 255.0)),
        DecodingResult::U16(v) if v.len() >= needed => Ok(gather(&|i| f32::from(v[i]) / 65535.0)),
        DecodingResult::F32(v) if v.len() >= needed => Ok(gather(&|i| v[i])),
        _ => Err(unsuitable(path, "8-bit, 16-bit or 32-bit float samples", colour)),
    }
}

/// Reads one 8-bit channel.
pub fn read_grey8(path: &Path) -> Result<Image<u8>, AssetError> {
    let (width, height, colour, samples) = decode(path)?;
    match (colour, samples) {
        (ColorType::Gray(8), DecodingResult::U8(values)) => Image::from_pixels(width, height, values)
            .ok_or_else(|| AssetError::Malformed {
                path: path.into(),
                format: "TIFF",
                reason: "the number of samples does not fit its size".into(),
            }),
        _ => Err(unsuitable(path, "an 8-bit grey picture", colour)),
    }
}

/// What a picture tells of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Told<'a> {
    /// What its values mean; ASCII.
    pub description: Option<&'a str>,
    /// Program and version; ASCII.
    pub software: Option<&'a str>,
    /// ICC profile of its colours.
    pub profile: Option<&'a [u8]>,
    /// With what it was taken, as EXIF.
    pub settings: Option<&'a Settings>,
}

/// Writes values of 0..1 times 65535, rounded and clamped, deflated. Not-a-number is refused: an unknown
/// value has no number in this format.
pub fn write_rgb16(path: &Path, image: &Rgb) -> Result<(), AssetError> {
    write_rgb16_told(path, image, &Told::default())
}

/// As [`write_rgb16`], with what the picture tells of itself.
pub fn write_rgb16_told(path: &Path, image: &Rgb, told: &Told<'_>) -> Result<(), AssetError> {
    if image.pixels().iter().flatten().any(|v| v.is_nan()) {
        return Err(AssetError::Unwritable {
            path: path.into(),
            reason: "a pixel is not a number; fill unknown pixels or mask them first".into(),
        });
    }
    let samples: Vec<u16> =
        image.pixels().iter().flatten().map(|v| (v.clamp(0.0, 1.0) * 65535.0).round() as u16).collect();
    encode::<colortype::RGB16>(path, image.width(), image.height(), &samples, told)
}

/// Writes one 8-bit channel, deflated.
pub fn write_grey8(path: &Path, image: &Image<u8>) -> Result<(), AssetError> {
    encode::<colortype::Gray8>(path, image.width(), image.height(), image.pixels(), &Told::default())
}

fn decode(path: &Path) -> Result<(usize, usize, ColorType, DecodingResult), AssetError> {
    let fail = |error: tiff::TiffError| AssetError::Malformed {
        path: path.into(),
        format: "TIFF",
        reason: error.to_string(),
    };
    let file = File::open(path).map_err(AssetError::reading(path))?;
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(fail)?;
    let (width, height) = decoder.dimensions().map_err(fail)?;
    let (width, height) = (width as usize, height as usize);
    let colour = decoder.colortype().map_err(fail)?;
    if width.saturating_mul(height) > MAX_PIXELS {
        return Err(AssetError::Unsuitable {
            path: path.into(),
            expected: format!("a picture of at most {MAX_PIXELS} pixels"),
            found: format!("one of {width} x {height}"),
        });
    }
    let mut limits = tiff::decoder::Limits::default();
    limits.decoding_buffer_size = MAX_PIXELS * 8;
    let samples = decoder.with_limits(limits).read_image().map_err(fail)?;
    Ok((width, height, colour, samples))
}

fn encode<C: colortype::ColorType>(
    path: &Path,
    width: usize,
    height: usize,
    samples: &[C::Inner],
    told: &Told<'_>,
) -> Result<(), AssetError>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let fail = |error: tiff::TiffError| match error {
        tiff::TiffError::IoError(source) => AssetError::Io { action: "write", path: path.into(), source },
        other => AssetError::Unwritable { path: path.into(), reason: other.to_string() },
    };
    let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(AssetError::Unwritable {
            path: path.into(),
            reason: format!("{width} x {height} pixels are more than TIFF can name"),
        });
    };
    let mut file = BufWriter::new(File::create(path).map_err(AssetError::writing(path))?);
    let mut encoder = TiffEncoder::new(&mut file)
        .map_err(fail)?
        .with_compression(Compression::Deflate(DeflateLevel::Fast))
        .with_predictor(tiff::tags::Predictor::Horizontal);
    let mut write = || -> tiff::TiffResult<()> {
        let exif =
            told.settings.map(|settings| write_exif(encoder.extra_directory()?, settings)).transpose()?;
        let mut picture = encoder.new_image::<C>(width, height)?;
        let directory = picture.encoder();
        for (tag, text) in [(Tag::ImageDescription, told.description), (Tag::Software, told.software)] {
            if let Some(text) = text {
                directory.write_tag(tag, text)?;
            }
        }
        if let (Some(settings), Some(exif)) = (told.settings, exif) {
            write_camera(directory, settings, exif)?;
        }
        if let Some(profile) = told.profile {
            let entry = directory.write_entry_bytes(Type::UNDEFINED, profile)?;
            directory.extend_from(&[(Tag::IccProfile, entry)].into_iter().collect());
        }
        picture.write_data(samples)
    };
    write().map_err(fail)?;
    file.flush().map_err(AssetError::writing(path))
}

fn unsuitable(path: &Path, expected: &str, found: ColorType) -> AssetError {
    AssetError::Unsuitable {
        path: path.into(),
        expected: expected.into(),
        found: format!("a {found:?} picture"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_come_back_within_half_a_step() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("albedo.tif");
        let image = Image::from_fn(61, 43, |x, y| [x as f32 / 60.0, y as f32 / 42.0, 1.25 - x as f32 / 30.0]);
        write_rgb16(&path, &image).unwrap();
        let back = read_rgb(&path).unwrap();
        assert_eq!((back.width(), back.height()), (61, 43));
        for (a, b) in image.pixels().iter().flatten().zip(back.pixels().iter().flatten()) {
            assert!((a.clamp(0.0, 1.0) - b).abs() <= 0.5001 / 65535.0, "{a} {b}");
        }
    }

    #[test]
    fn what_a_picture_tells_of_itself_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("told.tif");
        let profile: Vec<u8> = (0..=255).collect();
        let told = Told {
            description: Some("linear"),
            software: Some("unlit"),
            profile: Some(&profile),
            settings: None,
        };
        write_rgb16_told(&path, &Image::filled(3, 2, [0.25; 3]), &told).unwrap();
        let mut decoder = Decoder::new(BufReader::new(File::open(&path).unwrap())).unwrap();
        assert_eq!(decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap(), "linear");
        assert_eq!(decoder.get_tag_ascii_string(Tag::Software).unwrap(), "unlit");
        assert_eq!(decoder.get_tag_u8_vec(Tag::IccProfile).unwrap(), profile);
        assert_eq!(read_rgb(&path).unwrap().pixels()[5], [16384.0 / 65535.0; 3]);
    }

    #[test]
    fn masks_come_back_and_kinds_are_not_confused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.tif");
        let mask = Image::from_fn(300, 7, |x, y| (x * 7 + y) as u8);
        write_grey8(&path, &mask).unwrap();
        assert_eq!(read_grey8(&path).unwrap(), mask);
        assert!(matches!(read_rgb(&path), Err(AssetError::Unsuitable { .. })));
        std::fs::write(&path, b"II*\0 not a picture").unwrap();
        assert!(matches!(read_grey8(&path), Err(AssetError::Malformed { .. })));
    }

    #[test]
    fn an_unknown_value_is_refused_not_written_as_black() {
        let folder = tempfile::tempdir().unwrap();
        let image = Image::filled(2, 2, [0.5, f32::NAN, 0.5]);
        assert!(matches!(
            write_rgb16(&folder.path().join("a.tif"), &image),
            Err(AssetError::Unwritable { .. })
        ));
    }
}
